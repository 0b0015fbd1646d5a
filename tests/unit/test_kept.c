// SPDX-License-Identifier: MIT
// Parameters that are kept, in pages as large as the board's: SAVE and RESET over the bus, and a memory that gives or
// takes a byte wrongly. How a power cut ends is test_settings.c's.
#include "app.h"

#include "messages.h"
#include "unity.h"

#include <string.h>

enum { NODE = 3, PAGE_BYTES = 128 * 1024, SLOT_VALUES_MAX = SETTINGS_SLOT_BYTES / 4 - 5 };

static uint8_t pages[SETTINGS_PAGES][PAGE_BYTES];
static int32_t damaged_byte; // of a slot, by programming; none below 0
static uint32_t reads, reads_that_work;

static app_t app;
static uint8_t requests;
static status_message_t status;
static parameter_store_message_t store;

// ---- the memory

static bool read_page(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length)
{
    (void)context;
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(PAGE_BYTES, offset + length);
    memcpy(bytes, &pages[page][offset], length);
    return reads++ < reads_that_work;
}

static bool erase_page(void *context, uint8_t page)
{
    (void)context;
    memset(pages[page], 0xFF, PAGE_BYTES);
    return true;
}

static bool program_page(void *context, uint8_t page, uint32_t offset, const uint8_t *bytes, uint32_t length)
{
    (void)context;
    memcpy(&pages[page][offset], bytes, length);
    if (damaged_byte >= 0) {
        pages[page][offset + (uint32_t)damaged_byte] ^= 1u;
    }
    return true;
}

static const settings_memory_t memory = {
    .page_bytes = PAGE_BYTES, .read = read_page, .erase = erase_page, .program = program_page};

// ---- the bus

static void look(void)
{
    frame_t frame;
    while (app_transmit(&app, &frame)) {
        if (frame.id >> FRAME_NODE_BITS == STATUS_FUNCTION) {
            TEST_ASSERT_EQUAL(DECODE_OK, status_decode(&status, &frame));
        } else if (frame.id >> FRAME_NODE_BITS == PARAMETER_STORE_FUNCTION) {
            TEST_ASSERT_EQUAL(DECODE_OK, parameter_store_decode(&store, &frame));
        }
    }
}

static void command(uint8_t operation)
{
    frame_t frame;
    requests = (uint8_t)((requests + 1) & 0xFu);
    command_encode(&frame, NODE, &(command_message_t){.operation = operation, .counter = requests});
    app_receive(&app, &frame);
    look();
}

static void set_parameter(uint8_t index, float value)
{
    frame_t frame;
    requests = (uint8_t)((requests + 1) & 0xFu);
    parameter_set_encode(&frame, NODE, &(parameter_set_message_t){.index = index, .value = value, .counter = requests});
    app_receive(&app, &frame);
    look();
}

static void restart(void)
{
    const app_port_t port = {.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP};
    requests = 0;
    app_init(&app, &omnibot, NODE, port);
    app_use_settings(&app, &memory);
    look();
}

void setUp(void)
{
    (void)erase_page(NULL, 0);
    (void)erase_page(NULL, 1);
    damaged_byte = -1;
    reads = 0;
    reads_that_work = UINT32_MAX;
    restart();
}

void tearDown(void)
{
}

// ---- over the bus

static void test_each_parameter_that_differs_from_what_is_kept_is_counted(void)
{
    for (uint8_t index = 0; index < PARAMETER_COUNT; index++) {
        restart();
        const parameter_description_t *description = &parameter_table[index];
        const bool at_most = description->initial < description->maximum;
        set_parameter(index, at_most ? description->maximum : description->minimum);
        frame_t frame;
        hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
        app_receive(&app, &frame);
        look();
        TEST_ASSERT_EQUAL_UINT8(1, store.unsaved);
    }
}

static void test_start_with_kept_parameters_has_nothing_unsaved(void)
{
    set_parameter(PARAMETER_EPSILON, 0.25f);
    command(OPERATION_SAVE_PARAMETERS);
    restart();
    set_parameter(PARAMETER_ORDER, 2.0f);
    command(OPERATION_SAVE_PARAMETERS);
    command(OPERATION_RESET_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(2, store.unsaved);

    restart();
    frame_t frame;
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    app_receive(&app, &frame);
    look();
    TEST_ASSERT_EQUAL_UINT8(0, store.unsaved);
}

static void test_save_tells_that_what_is_in_force_is_kept(void)
{
    command(OPERATION_SAVE_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_KEPT, store.origin);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, status.refusal);
}

static void test_reset_is_no_refusal_and_reaches_the_controller(void)
{
    set_parameter(PARAMETER_FORCE_BOUND_N, 1.0f);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 1.0f, app.control.force_bound_N);
    command(OPERATION_RESET_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, status.refusal);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 3.5f, app.control.force_bound_N);
}

// ---- a memory that errs

static void test_save_finds_a_wrong_bit_anywhere_in_its_slot(void)
{
    for (int32_t byte = 0; byte < SETTINGS_SLOT_BYTES; byte++) {
        setUp();
        damaged_byte = byte;
        command(OPERATION_SAVE_PARAMETERS);
        TEST_ASSERT_EQUAL_UINT8(REFUSAL_NOT_SAVED, status.refusal);
    }
}

static void test_load_does_not_trust_a_read_that_failed(void)
{
    command(OPERATION_SAVE_PARAMETERS);
    parameters_t loaded;
    reads = 0;
    TEST_ASSERT_EQUAL(SETTINGS_OK, settings_load(&memory, &loaded));
    const uint32_t needed = reads;
    for (uint32_t back = 1; back <= 3; back++) {
        reads = 0;
        reads_that_work = needed - back;
        TEST_ASSERT_EQUAL(SETTINGS_LOST, settings_load(&memory, &loaded));
    }
}

// ---- another firmware's set

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

static void test_save_goes_on_behind_a_set_that_fills_its_slot(void)
{
    uint8_t *byte = pages[1];
    memcpy(byte, "OBS1", 4);
    put(byte + 4, 0x12345678u); // no table of ours
    put(byte + 8, 7);
    put(byte + 12, SLOT_VALUES_MAX);
    memset(byte + 16, 0, 4 * SLOT_VALUES_MAX);
    put(byte + SETTINGS_SLOT_BYTES - 4, crc32_of(byte, SETTINGS_SLOT_BYTES - 4));

    const parameters_t set = app.parameters;
    TEST_ASSERT_TRUE(settings_save(&memory, &set));

    TEST_ASSERT_EACH_EQUAL_HEX8(0xFF, pages[0], SETTINGS_SLOT_BYTES);
    TEST_ASSERT_EQUAL_MEMORY("OBS1", &pages[1][SETTINGS_SLOT_BYTES], 4);
    TEST_ASSERT_EQUAL_UINT8(8, pages[1][SETTINGS_SLOT_BYTES + 8]); // the next number
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_each_parameter_that_differs_from_what_is_kept_is_counted);
    RUN_TEST(test_start_with_kept_parameters_has_nothing_unsaved);
    RUN_TEST(test_save_tells_that_what_is_in_force_is_kept);
    RUN_TEST(test_reset_is_no_refusal_and_reaches_the_controller);
    RUN_TEST(test_save_finds_a_wrong_bit_anywhere_in_its_slot);
    RUN_TEST(test_load_does_not_trust_a_read_that_failed);
    RUN_TEST(test_save_goes_on_behind_a_set_that_fills_its_slot);
    return UNITY_END();
}
