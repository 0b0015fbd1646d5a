// SPDX-License-Identifier: MIT
// Parameters kept in a flash that is played by RM0090, chapter 3: locked until it has its keys, programmed by the word
// where it is erased, erased by the sector, busy for a while, and sure to complain of anything else.
#include "flash.h"

#include "model.h"
#include "unity.h"

#include <string.h>

#define LOCK (1u << 31)
#define BSY (1u << 16)
#define STRT (1u << 16)
#define PGSERR (1u << 7)
#define WRPERR (1u << 4)

enum { PG = 1, SER = 2, PSIZE_32 = 2 << 8, BUSY_POLLS = 5 };

static flash_t flash;
static settings_memory_t memory;
static uint32_t keys;          // of the two, so many have come
static uint32_t busy;          // polls until it is no longer
static uint32_t busy_for;      // polls of an operation
static bool dead, protected;   // nothing answers; the sectors are write-protected
static bool settles, restores; // the watchdog takes more time, and takes it back
static uint32_t erases[2];
static bool patient_when_erased; // the watchdog was

// ---- the hardware

static uint32_t on_key(uint32_t value)
{
    const uint32_t wanted = keys == 0 ? 0x45670123u : 0xCDEF89ABu;
    TEST_ASSERT_BITS_HIGH_MESSAGE(LOCK, model_get(&flash_interface.cr), "a key for what is open is a bus error");
    TEST_ASSERT_EQUAL_HEX32_MESSAGE(wanted, value, "a wrong key is a bus error");
    keys++;
    if (keys == 2) {
        keys = 0;
        model_set(&flash_interface.cr, 0);
    }
    return 0;
}

static void erase(uint32_t control)
{
    const uint32_t sector = control >> 3 & 15u;
    TEST_ASSERT_EQUAL_HEX32(STRT | SER | PSIZE_32 | sector << 3, control);
    TEST_ASSERT_TRUE_MESSAGE(sector == 10 || sector == 11, "that is the image's");
    patient_when_erased = model_get(&iwdg.pr) == 4 && model_get(&iwdg.rlr) == 0xFFF;
    if (protected) {
        model_set(&flash_interface.sr, WRPERR);
        return;
    }
    erases[sector - 10]++;
    for (uint32_t i = 0; i < 32768; i++) {
        model_set(&settings_sectors[sector - 10].words[i], UINT32_MAX);
    }
}

static uint32_t on_control(uint32_t value)
{
    const uint32_t before = model_get(&flash_interface.cr);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, busy, "written to while it is busy");
    if ((before & LOCK) != 0) {
        return before;
    }
    if ((value & STRT) != 0) {
        busy = busy_for;
        erase(value);
    }
    return value & ~STRT;
}

static uint32_t on_word(reg_t *word, uint32_t value)
{
    const uint32_t before = model_get(word);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, busy, "programmed while it is busy");
    TEST_ASSERT_EQUAL_HEX32_MESSAGE(UINT32_MAX, before, "programmed what is not erased");
    if (model_get(&flash_interface.cr) != (PG | PSIZE_32)) {
        model_set(&flash_interface.sr, model_get(&flash_interface.sr) | PGSERR);
        return before;
    }
    if (protected) {
        model_set(&flash_interface.sr, WRPERR);
        return before;
    }
    busy = busy_for;
    return before & value;
}

static bool is_sector(const reg_t *reg)
{
    return (uintptr_t)reg - (uintptr_t)settings_sectors < sizeof settings_sectors;
}

static uint32_t on_write(reg_t *reg, uint32_t value)
{
    if (dead) {
        return is_sector(reg) ? model_get(reg) : 0;
    }
    if (reg == &flash_interface.keyr) {
        return on_key(value);
    }
    if (reg == &flash_interface.cr) {
        return on_control(value);
    }
    if (reg == &flash_interface.sr) {
        return model_get(reg) & ~value;
    }
    return is_sector(reg) ? on_word(reg, value) : value;
}

static uint32_t on_read(reg_t *reg, uint32_t value)
{
    if (reg == &iwdg.sr) {
        return (model_get(&iwdg.pr) == 4 ? settles : restores) ? 0 : 3;
    }
    if (reg == &flash_interface.sr && busy > 0) {
        busy--;
        return value | BSY;
    }
    return value;
}

void setUp(void)
{
    model_reset();
    memset(settings_sectors, 0xFF, sizeof settings_sectors);
    model_on_write(on_write);
    model_on_read(on_read);
    model_set(&flash_interface.cr, LOCK);
    model_set(&flash_interface.acr, 0x705);
    model_set(&iwdg.rlr, 400);
    keys = 0;
    busy = 0;
    busy_for = BUSY_POLLS;
    dead = false;
    protected = false;
    settles = true;
    restores = true;
    memset(erases, 0, sizeof erases);
    patient_when_erased = false;
    flash = (flash_t){&flash_interface, &iwdg, &pwr, settings_sectors, 10};
    memory = flash_memory(&flash);
}

void tearDown(void)
{
    static const char *const own[] = {"flash_interface", "iwdg", "settings_sectors", NULL};
    model_assert_wrote_only(own);
    TEST_ASSERT_TRUE_MESSAGE(dead || model_get(&flash_interface.cr) == LOCK, "left open");
}

// ---- sets

static parameters_t set_number(uint32_t n)
{
    parameters_t set;
    parameters_reset(&set);
    set.value[PARAMETER_EPSILON] = (float)n / 1024.0f;
    return set;
}

static bool save(uint32_t n)
{
    const parameters_t set = set_number(n);
    model_forget();
    return settings_save(&memory, &set);
}

static void assert_loads(uint32_t n)
{
    const parameters_t wanted = set_number(n);
    parameters_t loaded;
    model_forget();
    TEST_ASSERT_EQUAL(SETTINGS_OK, settings_load(&memory, &loaded));
    TEST_ASSERT_EQUAL_MEMORY(&wanted, &loaded, sizeof wanted);
}

/// So many that the next one changes the page.
static void fill_a_page(void)
{
    for (uint32_t n = 0; n < 32; n++) {
        TEST_ASSERT_TRUE(save(n));
    }
    model_forget();
}

// ---- it works

static void test_saved_sets_are_loaded_over_page_changes(void)
{
    for (uint32_t n = 0; n < 100; n++) {
        TEST_ASSERT_TRUE(save(n));
        assert_loads(n);
    }
    TEST_ASSERT_EQUAL_UINT32(1, erases[0]);
    TEST_ASSERT_EQUAL_UINT32(2, erases[1]);
}

static void test_program_opens_writes_words_and_locks(void)
{
    static const uint8_t bytes[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    TEST_ASSERT_TRUE(memory.program(&flash, 1, 256, bytes, sizeof bytes));
    TEST_ASSERT_EQUAL_HEX32(0x45670123, model_written(&flash_interface.keyr, 0));
    TEST_ASSERT_EQUAL_HEX32(0xCDEF89AB, model_written(&flash_interface.keyr, 1));
    TEST_ASSERT_EQUAL_HEX32(0x201, model_written(&flash_interface.cr, 0));
    TEST_ASSERT_EQUAL_HEX32(0x80000000, model_written(&flash_interface.cr, 1));
    TEST_ASSERT_EQUAL_UINT32(2, model_writes_to(&flash_interface.cr));
    TEST_ASSERT_EQUAL_HEX32(0x04030201, model_get(&settings_sectors[1].words[64]));
    TEST_ASSERT_EQUAL_HEX32(0x08070605, model_get(&settings_sectors[1].words[65]));
    TEST_ASSERT_EQUAL_HEX32(UINT32_MAX, model_get(&settings_sectors[1].words[66]));
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(2 * BUSY_POLLS, model_reads_of(&flash_interface.sr));
    TEST_ASSERT_EQUAL_STRING("ss", model_core_log());
}

static void test_read_gives_the_bytes_in_order(void)
{
    uint8_t bytes[8];
    model_set(&settings_sectors[0].words[3], 0x44332211);
    model_set(&settings_sectors[0].words[4], 0x88776655);
    TEST_ASSERT_TRUE(memory.read(&flash, 0, 12, bytes, sizeof bytes));
    TEST_ASSERT_EQUAL_HEX8_ARRAY(((uint8_t[]){0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88}), bytes, 8);
}

static void test_erase_takes_the_sector_of_its_page(void)
{
    for (uint8_t page = 0; page < 2; page++) {
        setUp();
        model_set(&settings_sectors[page].words[32767], 0);
        TEST_ASSERT_TRUE(memory.erase(&flash, page));
        TEST_ASSERT_EQUAL_UINT32(1, erases[page]);
        TEST_ASSERT_EQUAL_UINT32(0, erases[1 - page]);
        TEST_ASSERT_EQUAL_HEX32(0x202u | (10u + page) << 3, model_written(&flash_interface.cr, 0));
        TEST_ASSERT_EQUAL_HEX32(0x10202u | (10u + page) << 3, model_written(&flash_interface.cr, 1));
        TEST_ASSERT_EQUAL_HEX32(0x80000000, model_written(&flash_interface.cr, 2));
    }
}

static void test_erase_that_takes_long_is_waited_for(void)
{
    busy_for = 200000;
    TEST_ASSERT_TRUE(memory.erase(&flash, 0));
    TEST_ASSERT_EQUAL_UINT32(0, busy);
}

/// RM0090 21.4: prescaler 64 and 4096 counts of at most 47 kHz are 5.5 s, an erase is 2 s; then 50 ms as before.
static void test_watchdog_is_patient_while_it_erases_and_only_then(void)
{
    TEST_ASSERT_TRUE(memory.erase(&flash, 1));
    TEST_ASSERT_TRUE(patient_when_erased);
    TEST_ASSERT_EQUAL_UINT32(0, model_get(&iwdg.pr));
    TEST_ASSERT_EQUAL_UINT32(400, model_get(&iwdg.rlr));
    static const uint32_t wanted[] = {0x5555, 0xAAAA, 0x5555, 0xAAAA}; // each followed by a full count
    TEST_ASSERT_EQUAL_UINT32(4, model_writes_to(&iwdg.kr));
    for (uint32_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_HEX32(wanted[i], model_written(&iwdg.kr, i));
    }
}

static void test_program_leaves_the_watchdog_alone(void)
{
    TEST_ASSERT_TRUE(save(1));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&iwdg.kr));
}

/// RM0090 3.9.1: reset by bit 12, which works only while bit 10 is off.
static void test_erase_empties_the_data_cache(void)
{
    static const uint32_t wanted[] = {0x305, 0x1305, 0x305, 0x705};
    TEST_ASSERT_TRUE(memory.erase(&flash, 0));
    TEST_ASSERT_EQUAL_UINT32(4, model_writes_to(&flash_interface.acr));
    for (uint32_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_HEX32(wanted[i], model_written(&flash_interface.acr, i));
    }
}

static void test_cache_that_is_off_stays_off(void)
{
    model_set(&flash_interface.acr, 0);
    TEST_ASSERT_TRUE(memory.erase(&flash, 0));
    TEST_ASSERT_EQUAL_HEX32(0, model_get(&flash_interface.acr));
}

static void test_what_is_open_already_gets_no_keys(void)
{
    model_set(&flash_interface.cr, 0);
    TEST_ASSERT_TRUE(save(1));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&flash_interface.keyr));
}

static void test_complaint_of_one_before_is_cleared(void)
{
    model_set(&flash_interface.sr, PGSERR | 1u);
    TEST_ASSERT_TRUE(save(1));
    assert_loads(1);
}

static void test_flash_that_locks_answers(void)
{
    TEST_ASSERT_TRUE(flash_answers(&flash_interface));
    model_set(&flash_interface.cr, 0); // a loader left it open
    TEST_ASSERT_TRUE(flash_answers(&flash_interface));
}

// ---- it does not

static void test_registers_that_read_0_do_not_answer(void)
{
    dead = true;
    model_set(&flash_interface.cr, 0);
    TEST_ASSERT_FALSE(flash_answers(&flash_interface));
    TEST_ASSERT_FALSE(save(1));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&settings_sectors[0].words[0]));
    TEST_ASSERT_FALSE(memory.erase(&flash, 0));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&iwdg.kr));
}

static void test_busy_without_end_is_not_waited_for_without_end(void)
{
    TEST_ASSERT_TRUE(save(1));
    busy_for = UINT32_MAX;
    static const uint8_t bytes[4] = {0};
    model_forget();
    model_on_write(NULL); // the lock is not closed while it is busy, nor could it be
    busy = UINT32_MAX;
    TEST_ASSERT_FALSE(memory.program(&flash, 0, 512, bytes, 4));
    TEST_ASSERT_UINT32_WITHIN(100, 42000, model_reads_of(&flash_interface.sr)); // 1 ms at 168 MHz
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&settings_sectors[0].words[128]));
    TEST_ASSERT_FALSE(memory.erase(&flash, 0));
}

static void test_write_protection_keeps_the_old_set(void)
{
    TEST_ASSERT_TRUE(save(1));
    protected = true;
    TEST_ASSERT_FALSE(save(2));
    assert_loads(1);
}

static void test_complaint_fails_the_operation(void)
{
    static const uint8_t zeros[4] = {0};
    protected = true;
    TEST_ASSERT_FALSE(memory.program(&flash, 0, 0, zeros, sizeof zeros));
    TEST_ASSERT_FALSE(memory.erase(&flash, 0));
}

static void test_erase_that_is_refused_gives_the_watchdog_its_time_back(void)
{
    fill_a_page();
    protected = true;
    TEST_ASSERT_FALSE(save(100));
    TEST_ASSERT_TRUE(patient_when_erased);
    TEST_ASSERT_EQUAL_UINT32(0, model_get(&iwdg.pr));
    TEST_ASSERT_EQUAL_UINT32(400, model_get(&iwdg.rlr));
    assert_loads(31);
}

static void test_nothing_is_erased_under_an_impatient_watchdog(void)
{
    fill_a_page();
    settles = false;
    TEST_ASSERT_FALSE(save(100));
    TEST_ASSERT_EQUAL_UINT32(0, erases[1]);
    TEST_ASSERT_EQUAL_UINT32(400, model_get(&iwdg.rlr));
    assert_loads(31);
}

static void test_watchdog_that_stays_patient_is_no_save(void)
{
    fill_a_page();
    restores = false;
    TEST_ASSERT_FALSE(save(100));
    assert_loads(31);
}

static void test_nothing_is_written_at_low_voltage(void)
{
    model_set(&pwr.csr, 1u << 2);
    TEST_ASSERT_FALSE(save(1));
    TEST_ASSERT_FALSE(memory.erase(&flash, 0));
    TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&flash_interface.keyr));
    TEST_ASSERT_EQUAL_UINT32(0, erases[0]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_saved_sets_are_loaded_over_page_changes);
    RUN_TEST(test_program_opens_writes_words_and_locks);
    RUN_TEST(test_read_gives_the_bytes_in_order);
    RUN_TEST(test_erase_takes_the_sector_of_its_page);
    RUN_TEST(test_erase_that_takes_long_is_waited_for);
    RUN_TEST(test_watchdog_is_patient_while_it_erases_and_only_then);
    RUN_TEST(test_program_leaves_the_watchdog_alone);
    RUN_TEST(test_erase_empties_the_data_cache);
    RUN_TEST(test_cache_that_is_off_stays_off);
    RUN_TEST(test_what_is_open_already_gets_no_keys);
    RUN_TEST(test_complaint_of_one_before_is_cleared);
    RUN_TEST(test_flash_that_locks_answers);
    RUN_TEST(test_registers_that_read_0_do_not_answer);
    RUN_TEST(test_busy_without_end_is_not_waited_for_without_end);
    RUN_TEST(test_write_protection_keeps_the_old_set);
    RUN_TEST(test_complaint_fails_the_operation);
    RUN_TEST(test_erase_that_is_refused_gives_the_watchdog_its_time_back);
    RUN_TEST(test_nothing_is_erased_under_an_impatient_watchdog);
    RUN_TEST(test_watchdog_that_stays_patient_is_no_save);
    RUN_TEST(test_nothing_is_written_at_low_voltage);
    return UNITY_END();
}
