// SPDX-License-Identifier: MIT
// Kept parameters on a flash that behaves as one: programming only clears bits and only in erased words, erasing is by
// the page, and the power may go at every byte of either. What is loaded is compared with sets that the test remembers;
// the bytes of a record with a record that the test puts together itself.
#include "settings.h"

#include "unity.h"

#include <math.h>
#include <string.h>

enum { SLOTS = 4, PAGE_BYTES = SLOTS * SETTINGS_SLOT_BYTES, RECORD_BYTES = 4 * (4 + PARAMETER_COUNT + 1) };

typedef struct {
    uint8_t byte[SETTINGS_PAGES][PAGE_BYTES];
} flash_t;

typedef enum { HEALTHY, NO_READ, NO_ERASE, NO_PROGRAM, ERASE_LEAVES_A_BIT, PROGRAM_LEAVES_A_BIT } defect_t;

static flash_t flash;
static defect_t defect;
static bool cut_leaves_noise; // what an erase cut short has not come to yet is no longer what it was
static uint32_t bytes_left;   // of writing or erasing until the power goes
static uint32_t bytes_done, erases[SETTINGS_PAGES], programs;
static uint32_t noise;

static uint32_t any(void)
{
    noise = noise * 1664525u + 1013904223u;
    return noise >> 8;
}

// ---- the flash

static bool has_power(void)
{
    return bytes_left > 0;
}

static bool spend(void)
{
    bytes_left -= bytes_left == UINT32_MAX ? 0 : 1;
    bytes_done++;
    return has_power();
}

static bool flash_read(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length)
{
    const flash_t *self = context;
    TEST_ASSERT_LESS_THAN(SETTINGS_PAGES, page);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGE_BYTES, offset + length);
    memcpy(bytes, &self->byte[page][offset], length);
    return has_power() && defect != NO_READ;
}

static bool flash_erase(void *context, uint8_t page)
{
    flash_t *self = context;
    TEST_ASSERT_LESS_THAN(SETTINGS_PAGES, page);
    if (!has_power() || defect == NO_ERASE) {
        return false;
    }
    erases[page]++;
    for (uint32_t i = 0; i < PAGE_BYTES; i++) {
        if (!spend()) {
            for (uint32_t k = i; k < PAGE_BYTES && cut_leaves_noise; k++) {
                self->byte[page][k] = (uint8_t)any();
            }
            return false;
        }
        self->byte[page][i] = 0xFF;
    }
    if (defect == ERASE_LEAVES_A_BIT) {
        self->byte[page][PAGE_BYTES - 1] = 0xFE;
    }
    return true;
}

/// The byte at which the power goes has got some of its zeros.
static bool flash_program(void *context, uint8_t page, uint32_t offset, const uint8_t *bytes, uint32_t length)
{
    flash_t *self = context;
    TEST_ASSERT_LESS_THAN(SETTINGS_PAGES, page);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGE_BYTES, offset + length);
    TEST_ASSERT_EQUAL_UINT32_MESSAGE(0, offset % 4 + length % 4, "only whole words can be programmed");
    TEST_ASSERT_EACH_EQUAL_HEX8_MESSAGE(0xFF, &self->byte[page][offset], length, "programmed what is not erased");
    if (!has_power() || defect == NO_PROGRAM) {
        return defect == NO_PROGRAM;
    }
    programs++;
    for (uint32_t i = 0; i < length; i++) {
        const bool goes_on = spend();
        self->byte[page][offset + i] &= goes_on ? bytes[i] : (uint8_t)(bytes[i] | any());
        if (!goes_on) {
            return false;
        }
    }
    if (defect == PROGRAM_LEAVES_A_BIT) {
        self->byte[page][offset + 20] ^= 1u;
    }
    return true;
}

static const settings_memory_t memory = {
    .context = &flash,
    .page_bytes = PAGE_BYTES,
    .read = flash_read,
    .erase = flash_erase,
    .program = flash_program,
};

static void switch_on(void)
{
    bytes_left = UINT32_MAX;
}

void setUp(void)
{
    memset(&flash, 0xFF, sizeof flash);
    defect = HEALTHY;
    cut_leaves_noise = false;
    bytes_done = 0;
    programs = 0;
    memset(erases, 0, sizeof erases);
    noise = 1;
    switch_on();
}

void tearDown(void)
{
}

// ---- sets

/// The n-th of many sets that are all different, in every real value.
static parameters_t set_number(uint32_t n)
{
    parameters_t set;
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        const parameter_description_t *row = &parameter_table[i];
        const float share = (float)(n % 9973u + 1u) / 9974.0f;
        set.value[i] = row->integer ? (n % 2 == 0 ? row->minimum : row->maximum)
                                    : row->minimum + share * (row->maximum - row->minimum);
    }
    return set;
}

static parameters_t defaults(void)
{
    parameters_t set;
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        set.value[i] = parameter_table[i].initial;
    }
    return set;
}

static bool same(const parameters_t *a, const parameters_t *b)
{
    return memcmp(a, b, sizeof *a) == 0;
}

static void assert_loads(settings_result_t result, parameters_t wanted)
{
    parameters_t loaded;
    memset(&loaded, 0x5A, sizeof loaded);
    TEST_ASSERT_EQUAL(result, settings_load(&memory, &loaded));
    TEST_ASSERT_EQUAL_MEMORY(&wanted, &loaded, sizeof wanted);
}

static bool save(uint32_t n)
{
    const parameters_t set = set_number(n);
    return settings_save(&memory, &set);
}

static void assert_saves(uint32_t n)
{
    TEST_ASSERT_TRUE(save(n));
    assert_loads(SETTINGS_OK, set_number(n));
}

// ---- a record of the test's own

static void put(uint8_t *byte, uint32_t word)
{
    for (int i = 0; i < 4; i++) {
        byte[i] = (uint8_t)(word >> 8 * i);
    }
}

/// Bit by bit, by the definition (ISO-HDLC).
static uint32_t crc32_of(const uint8_t *bytes, uint32_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (uint32_t i = 0; i < 8 * length; i++) {
        const uint32_t bit = ((uint32_t)bytes[i / 8] >> i % 8 ^ crc) & 1u;
        crc = crc >> 1 ^ (bit != 0 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

typedef struct {
    uint32_t table, sequence, count;
    const parameters_t *set;
} record_t;

static void place(uint8_t page, uint32_t slot, record_t record)
{
    uint8_t *byte = &flash.byte[page][slot * SETTINGS_SLOT_BYTES];
    memset(byte, 0xFF, SETTINGS_SLOT_BYTES);
    memcpy(byte, "OBS1", 4);
    put(byte + 4, record.table);
    put(byte + 8, record.sequence);
    put(byte + 12, record.count);
    for (uint32_t i = 0; i < record.count; i++) {
        uint32_t bits = 0;
        memcpy(&bits, &record.set->value[i % PARAMETER_COUNT], 4);
        put(byte + 16 + 4 * i, bits);
    }
    put(byte + 16 + 4 * record.count, crc32_of(byte, 16 + 4 * record.count));
}

static record_t our_record(uint32_t sequence, const parameters_t *set)
{
    return (record_t){PARAMETER_TABLE_HASH, sequence, PARAMETER_COUNT, set};
}

// ---- nothing goes wrong

static void test_load_of_blank_pages_is_empty_with_defaults(void)
{
    assert_loads(SETTINGS_EMPTY, defaults());
    TEST_ASSERT_EQUAL_UINT32(0, bytes_done);
}

static void test_load_gives_what_was_saved_last(void)
{
    for (uint32_t n = 0; n < 5 * SLOTS; n++) {
        assert_saves(n);
    }
}

static void test_record_has_the_bytes_of_its_description(void)
{
    const parameters_t first = set_number(1), second = set_number(2);
    TEST_ASSERT_TRUE(save(1));
    TEST_ASSERT_TRUE(save(2));
    const flash_t written = flash;
    memset(&flash, 0xFF, sizeof flash);
    place(0, 0, our_record(1, &first));
    place(0, 1, our_record(2, &second));
    TEST_ASSERT_EQUAL_HEX8_ARRAY(flash.byte[0], written.byte[0], PAGE_BYTES);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(flash.byte[1], written.byte[1], PAGE_BYTES);
}

static void test_save_of_what_is_held_writes_nothing(void)
{
    for (uint32_t n = 0; n < 2 * SLOTS + 1; n++) {
        assert_saves(n);
        const uint32_t before = bytes_done;
        assert_saves(n);
        TEST_ASSERT_EQUAL_UINT32(before, bytes_done);
    }
}

static void test_save_of_defaults_into_blank_pages_is_kept(void)
{
    const parameters_t set = defaults();
    TEST_ASSERT_TRUE(settings_save(&memory, &set));
    TEST_ASSERT_EQUAL_UINT32(1, programs);
    assert_loads(SETTINGS_OK, set);
}

static void test_save_of_an_older_set_is_a_new_one(void)
{
    assert_saves(1);
    assert_saves(2);
    assert_saves(1);
}

static void test_save_tells_zero_from_negative_zero(void)
{
    parameters_t set = defaults();
    set.value[PARAMETER_EPSILON] = 0.0f;
    TEST_ASSERT_TRUE(settings_save(&memory, &set));
    set.value[PARAMETER_EPSILON] = -0.0f;
    TEST_ASSERT_TRUE(settings_save(&memory, &set));
    assert_loads(SETTINGS_OK, set);
}

static void test_thousands_of_saves_wear_both_pages_alike(void)
{
    enum { SAVES = 5000 };
    for (uint32_t n = 0; n < SAVES; n++) {
        assert_saves(n);
    }
    TEST_ASSERT_EQUAL_UINT32(SAVES, programs);
    TEST_ASSERT_EQUAL_UINT32((SAVES - 1) / SLOTS, erases[0] + erases[1]);
    TEST_ASSERT_UINT32_WITHIN(1, erases[0], erases[1]);
}

static void test_sequence_that_runs_over_keeps_the_order(void)
{
    const parameters_t set = set_number(0);
    place(0, 0, our_record(UINT32_MAX - 2u, &set));
    for (uint32_t n = 1; n < 4 * SLOTS; n++) {
        assert_saves(n);
    }
}

static void test_newer_by_sequence_is_loaded_from_either_page(void)
{
    static const struct {
        uint32_t first, second;
        bool second_is_newer;
    } cases[] = {{1, 2, true},
                 {2, 1, false},
                 {UINT32_MAX, 0, true},
                 {0, UINT32_MAX, false},
                 {0x7FFFFFFFu, 0x80000000u, true},
                 {0x80000000u, 0x7FFFFFFFu, false},
                 {UINT32_MAX - 3u, 3, true}};
    const parameters_t first = set_number(1), second = set_number(2);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        place(0, 0, our_record(cases[i].first, &first));
        place(1, 0, our_record(cases[i].second, &second));
        assert_loads(SETTINGS_OK, cases[i].second_is_newer ? second : first);
    }
}

// ---- the power goes

static void assert_whole_after_cut(uint32_t saves)
{
    const parameters_t new = set_number(saves), old = saves == 0 ? defaults() : set_number(saves - 1);
    parameters_t loaded;
    const settings_result_t result = settings_load(&memory, &loaded);
    const bool is_new = same(&loaded, &new);
    TEST_ASSERT_TRUE_MESSAGE(is_new || same(&loaded, &old), "neither the old set nor the new one");
    if (saves > 0 || is_new) {
        TEST_ASSERT_EQUAL(SETTINGS_OK, result);
    } else {
        TEST_ASSERT_NOT_EQUAL(SETTINGS_OK, result);
    }
}

/// The save after so many, cut at each of its bytes; then one more that is cut, and one that is not.
static void cut_everywhere(uint32_t saves)
{
    const flash_t before = flash;
    bool done = false;
    for (uint32_t cut = 1; !done; cut++) {
        flash = before;
        noise = cut;
        bytes_left = cut;
        done = save(saves);
        switch_on();
        assert_whole_after_cut(saves);

        parameters_t after_first;
        settings_load(&memory, &after_first);
        bytes_left = 1 + any() % (PAGE_BYTES + RECORD_BYTES);
        const bool second_done = save(1000);
        switch_on();
        parameters_t after_second;
        settings_load(&memory, &after_second);
        const parameters_t second = set_number(1000);
        TEST_ASSERT_TRUE(same(&after_second, &second) || (!second_done && same(&after_second, &after_first)));

        assert_saves(2000);
    }
    flash = before;
}

static void cut_in_each_of_many_saves(void)
{
    for (uint32_t saves = 0; saves <= 3 * SLOTS; saves++) {
        cut_everywhere(saves);
        TEST_ASSERT_TRUE(save(saves));
    }
    TEST_ASSERT_GREATER_THAN_UINT32(2 * PAGE_BYTES, erases[0]); // the page changes were among them, at every byte
    TEST_ASSERT_GREATER_THAN_UINT32(PAGE_BYTES, erases[1]);
}

static void test_power_cut_at_any_byte_leaves_the_old_set_or_the_new(void)
{
    cut_in_each_of_many_saves();
}

static void test_power_cut_in_an_erase_that_leaves_noise_does_too(void)
{
    cut_leaves_noise = true;
    cut_in_each_of_many_saves();
}

static void test_saves_cut_one_after_the_other_never_lose_the_last_whole_one(void)
{
    cut_leaves_noise = true;
    uint32_t kept = 0;
    assert_saves(kept);
    for (uint32_t n = 1; n < 20000; n++) {
        bytes_left = 1 + any() % (PAGE_BYTES + RECORD_BYTES);
        const bool done = save(n);
        switch_on();
        const parameters_t old = set_number(kept), new = set_number(n);
        parameters_t loaded;
        TEST_ASSERT_EQUAL(SETTINGS_OK, settings_load(&memory, &loaded));
        kept = same(&loaded, &new) ? n : kept;
        TEST_ASSERT_TRUE(kept == n || (!done && same(&loaded, &old)));
    }
    TEST_ASSERT_GREATER_THAN_UINT32(100, erases[0]);
}

// ---- what is there is not ours, or damaged

static void assert_lost_and_saved_again(void)
{
    assert_loads(SETTINGS_LOST, defaults());
    assert_saves(7);
}

static void test_set_of_another_table_is_lost(void)
{
    const parameters_t set = set_number(1);
    record_t record = our_record(1, &set);
    record.table ^= 0x100u;
    place(0, 0, record);
    assert_lost_and_saved_again();
}

static void test_newest_of_another_table_is_lost_though_an_older_one_is_ours(void)
{
    const parameters_t set = set_number(1);
    assert_saves(1);
    record_t record = our_record(2, &set);
    record.table++;
    place(0, 1, record);
    assert_lost_and_saved_again();
}

static void test_other_number_of_values_is_lost(void)
{
    const parameters_t set = set_number(1);
    static const uint32_t counts[] = {0, PARAMETER_COUNT - 1, PARAMETER_COUNT + 1, (SETTINGS_SLOT_BYTES - 20) / 4};
    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
        setUp();
        record_t record = our_record(1, &set);
        record.count = counts[i];
        place(0, 0, record);
        assert_lost_and_saved_again();
    }
}

static void test_more_values_than_a_slot_holds_are_not_read(void)
{
    static const uint32_t counts[] = {(SETTINGS_SLOT_BYTES - 20) / 4 + 1, 0x3FFFFFFFu, 0x40000000u, UINT32_MAX};
    const parameters_t set = set_number(1);
    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
        setUp();
        place(0, 0, our_record(1, &set));
        put(&flash.byte[0][12], counts[i]);
        assert_lost_and_saved_again();
    }
}

static void test_value_that_may_not_be_set_is_lost(void)
{
    for (uint32_t i = 0; i < PARAMETER_COUNT; i++) {
        const parameter_description_t *row = &parameter_table[i];
        const float bad[] = {nextafterf(row->maximum, INFINITY), nextafterf(row->minimum, -INFINITY), NAN, INFINITY,
                             row->integer ? row->minimum + 0.5f : -INFINITY};
        for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
            setUp();
            parameters_t set = set_number(1);
            set.value[i] = bad[k];
            place(0, 0, our_record(1, &set));
            assert_lost_and_saved_again();
        }
    }
}

static void test_both_pages_full_of_anything_are_lost(void)
{
    for (uint32_t seed = 0; seed < 200; seed++) {
        setUp();
        noise = seed;
        for (uint32_t i = 0; i < sizeof flash; i++) {
            flash.byte[i / PAGE_BYTES][i % PAGE_BYTES] = (uint8_t)any();
        }
        assert_lost_and_saved_again();
    }
}

static void test_one_byte_in_either_page_is_lost(void)
{
    for (uint32_t at = 0; at < sizeof flash; at++) {
        setUp();
        flash.byte[at / PAGE_BYTES][at % PAGE_BYTES] = 0xFE;
        assert_lost_and_saved_again();
    }
}

static void test_pages_of_zeros_are_lost(void)
{
    memset(&flash, 0, sizeof flash);
    assert_lost_and_saved_again();
}

static void test_any_bit_wrong_in_a_record_is_noticed(void)
{
    assert_saves(1);
    assert_saves(2);
    const flash_t good = flash;
    for (uint32_t bit = 0; bit < 8 * RECORD_BYTES; bit++) {
        flash = good;
        flash.byte[0][SETTINGS_SLOT_BYTES + bit / 8] ^= (uint8_t)(1u << bit % 8);
        assert_loads(SETTINGS_OK, set_number(1));
    }
}

/// Some whole set of those that were saved, or the defaults as LOST; and it can be saved again.
static void test_damage_anywhere_gives_a_whole_set_or_none(void)
{
    for (uint32_t trial = 0; trial < 5000; trial++) {
        setUp();
        noise = trial;
        const uint32_t saves = 1 + any() % (3 * SLOTS);
        for (uint32_t n = 0; n < saves; n++) {
            TEST_ASSERT_TRUE(save(n));
        }
        for (uint32_t flips = 1 + any() % 64; flips > 0; flips--) {
            const uint32_t at = any() % sizeof flash;
            flash.byte[at / PAGE_BYTES][at % PAGE_BYTES] ^= (uint8_t)(1u << any() % 8);
        }
        parameters_t loaded;
        const settings_result_t result = settings_load(&memory, &loaded);
        bool known = false;
        for (uint32_t n = 0; n < saves && result == SETTINGS_OK; n++) {
            const parameters_t set = set_number(n);
            known = known || same(&loaded, &set);
        }
        const parameters_t initial = defaults();
        TEST_ASSERT_TRUE(result == SETTINGS_OK ? known : result == SETTINGS_LOST && same(&loaded, &initial));
        assert_saves(500);
    }
}

// ---- the memory fails

static void test_memory_that_cannot_be_read_is_lost_and_not_written(void)
{
    assert_saves(1);
    defect = NO_READ;
    assert_loads(SETTINGS_LOST, defaults());
    TEST_ASSERT_FALSE(save(2));
    TEST_ASSERT_EQUAL_UINT32(1, programs);
}

static void assert_page_change_fails_and_old_set_stays(defect_t what)
{
    for (uint32_t n = 0; n < SLOTS; n++) {
        assert_saves(n);
    }
    defect = what;
    TEST_ASSERT_FALSE(save(SLOTS));
    assert_loads(SETTINGS_OK, set_number(SLOTS - 1));
    defect = HEALTHY;
    assert_saves(SLOTS);
}

static void test_erase_that_fails_keeps_the_old_set(void)
{
    assert_page_change_fails_and_old_set_stays(NO_ERASE);
}

static void test_erase_that_leaves_a_bit_keeps_the_old_set(void)
{
    assert_page_change_fails_and_old_set_stays(ERASE_LEAVES_A_BIT);
}

static void test_program_that_does_nothing_is_no_save(void)
{
    assert_saves(1);
    defect = NO_PROGRAM;
    TEST_ASSERT_FALSE(save(2));
    assert_loads(SETTINGS_OK, set_number(1));
}

static void test_program_that_leaves_a_bit_is_no_save(void)
{
    assert_saves(1);
    defect = PROGRAM_LEAVES_A_BIT;
    TEST_ASSERT_FALSE(save(2));
    assert_loads(SETTINGS_OK, set_number(1));
    defect = HEALTHY;
    assert_saves(2);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_load_of_blank_pages_is_empty_with_defaults);
    RUN_TEST(test_load_gives_what_was_saved_last);
    RUN_TEST(test_record_has_the_bytes_of_its_description);
    RUN_TEST(test_save_of_what_is_held_writes_nothing);
    RUN_TEST(test_save_of_defaults_into_blank_pages_is_kept);
    RUN_TEST(test_save_of_an_older_set_is_a_new_one);
    RUN_TEST(test_save_tells_zero_from_negative_zero);
    RUN_TEST(test_thousands_of_saves_wear_both_pages_alike);
    RUN_TEST(test_sequence_that_runs_over_keeps_the_order);
    RUN_TEST(test_newer_by_sequence_is_loaded_from_either_page);
    RUN_TEST(test_power_cut_at_any_byte_leaves_the_old_set_or_the_new);
    RUN_TEST(test_power_cut_in_an_erase_that_leaves_noise_does_too);
    RUN_TEST(test_saves_cut_one_after_the_other_never_lose_the_last_whole_one);
    RUN_TEST(test_set_of_another_table_is_lost);
    RUN_TEST(test_newest_of_another_table_is_lost_though_an_older_one_is_ours);
    RUN_TEST(test_other_number_of_values_is_lost);
    RUN_TEST(test_more_values_than_a_slot_holds_are_not_read);
    RUN_TEST(test_value_that_may_not_be_set_is_lost);
    RUN_TEST(test_both_pages_full_of_anything_are_lost);
    RUN_TEST(test_one_byte_in_either_page_is_lost);
    RUN_TEST(test_pages_of_zeros_are_lost);
    RUN_TEST(test_any_bit_wrong_in_a_record_is_noticed);
    RUN_TEST(test_damage_anywhere_gives_a_whole_set_or_none);
    RUN_TEST(test_memory_that_cannot_be_read_is_lost_and_not_written);
    RUN_TEST(test_erase_that_fails_keeps_the_old_set);
    RUN_TEST(test_erase_that_leaves_a_bit_keeps_the_old_set);
    RUN_TEST(test_program_that_does_nothing_is_no_save);
    RUN_TEST(test_program_that_leaves_a_bit_is_no_save);
    return UNITY_END();
}
