// SPDX-License-Identifier: MIT
// What outlives what: a change of drive, a new host, a new start, a fault that comes again. Time is told by STATUS,
// which comes at each hundredth tick.
#include "app.h"

#include "crc.h"
#include "faults.h"
#include "messages.h"
#include "unity.h"

#include <string.h>

enum { NODE = 3, FUNCTIONS = 1 << (11 - FRAME_NODE_BITS), STATUS_TICKS = 100 };

static const app_port_t board = {
    .drives = 1u << DRIVE_LOCKSTEP | 1u << DRIVE_REALTIME | 1u << DRIVE_MOTORS,
    .drive = DRIVE_LOCKSTEP,
};

static app_t app;
static uint8_t requests;
static uint32_t host_tick;

/// What came out since the last look, by function: how many, and the last.
static int count[FUNCTIONS];
static frame_t last[FUNCTIONS];

static void look(void)
{
    memset(count, 0, sizeof count);
    frame_t frame;
    while (app_transmit(&app, &frame)) {
        const uint16_t function = frame.id >> FRAME_NODE_BITS;
        count[function]++;
        last[function] = frame;
    }
}

static status_message_t status(void)
{
    status_message_t message;
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, status_decode(&message, &last[STATUS_FUNCTION]));
    return message;
}

static torque_message_t torque(void)
{
    torque_message_t message;
    TEST_ASSERT_EQUAL(1, count[TORQUE_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, torque_decode(&message, &last[TORQUE_FUNCTION]));
    return message;
}

static void hello(void)
{
    frame_t frame;
    hello_encode(&frame, NODE, &(hello_message_t){PROTOCOL_HASH});
    app_receive(&app, &frame);
    look();
}

static void command(uint8_t operation)
{
    frame_t frame;
    requests = (uint8_t)((requests + 1) & 0xFu);
    const command_message_t message = {.operation = operation, .counter = requests, .key = app.key};
    command_encode(&frame, NODE, &message);
    app_receive(&app, &frame);
    look();
}

/// A SYNC without sensors.
static void sync(uint32_t tick)
{
    frame_t frame;
    host_tick = tick;
    sync_encode(&frame, NODE, &(sync_message_t){.tick = tick});
    app_receive(&app, &frame);
    look();
}

/// The sensor frames and the SYNC of a tick; `damage` is what is wrong with each CRC that SYNC tells.
static void sync_at(uint32_t tick, vec3_t at, uint8_t damage)
{
    frame_t pose, speed, frame;
    host_tick = tick;
    const uint8_t counter = (uint8_t)(tick & 0xFu);
    pose_encode(&pose, NODE, &(pose_message_t){at.x, at.y, at.z, counter});
    wheel_speed_encode(&speed, NODE, &(wheel_speed_message_t){.counter = counter});
    app_receive(&app, &pose);
    app_receive(&app, &speed);
    const sync_message_t message = {tick, crc8_frame(&pose, 8) ^ damage, crc8_frame(&speed, 8) ^ damage};
    sync_encode(&frame, NODE, &message);
    app_receive(&app, &frame);
}

/// A whole tick: the robot 1 cm behind the trajectory's start.
static void tick(uint32_t number)
{
    sync_at(number, (vec3_t){-0.01f, 0.0f, 0.0f}, 0);
    look();
}

/// A period by the robot's timer, with a host that says so but sends no sensors.
static void timer_tick_without_sensors(void)
{
    sync(host_tick + 1);
    app_tick(&app);
    look();
}

static void timer_tick(void)
{
    sync_at(host_tick + 1, (vec3_t){-0.01f, 0.0f, 0.0f}, 0);
    app_set_wheel_speed(&app, (vec3_t){0}); // where it has encoders
    app_tick(&app);
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

/// A path along x at 0.5 m/s, a minute long; uploads are test_app.c's and test_store.c's.
static void make_ready(void)
{
    hello();
    trajectory_segment_t path = {.duration_us = 60000000};
    path.coefficient[0][1] = 30.0f;
    path.coefficient[1][0] = 0.12f;
    app.store.segment[0] = path;
    app.store.segment_count = 1;
}

static void start(void)
{
    command(OPERATION_ARM);
    command(OPERATION_START);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, status().mode);
}

static void make_drive(uint8_t drive)
{
    command(drive);
    make_ready();
    timer_tick();
    start();
}

/// Lockstep, with tick 1000 answered.
static void make_moving(void)
{
    make_ready();
    start();
    tick(1000);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, torque().mode);
}

void setUp(void)
{
    requests = 0;
    host_tick = 0;
    app_init(&app, &omnibot, NODE, board);
    look();
}

void tearDown(void)
{
}

// ---- a change of drive

static void test_use_of_a_timer_counts_ticks_anew(void)
{
    sync(1042);
    command(OPERATION_USE_REALTIME);
    timer_tick_without_sensors(); // 0
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
    for (int k = 1; k < STATUS_TICKS; k++) {
        timer_tick_without_sensors();
        TEST_ASSERT_EQUAL(0, count[STATUS_FUNCTION]);
    }
    timer_tick_without_sensors();
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
}

static void test_use_of_lockstep_takes_a_tick_that_came_before_as_new(void)
{
    command(OPERATION_USE_REALTIME);
    sync(100);
    command(OPERATION_USE_LOCKSTEP);
    sync(100);
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
    TEST_ASSERT_EQUAL(1, count[TORQUE_FUNCTION]);
}

static void test_use_of_a_timer_waits_for_its_host_before_it_speaks(void)
{
    sync(5);
    command(OPERATION_USE_REALTIME);
    app_tick(&app);
    app_tick(&app);
    look();
    TEST_ASSERT_EQUAL(0, count[TORQUE_FUNCTION]);

    timer_tick_without_sensors();
    TEST_ASSERT_EQUAL(1, count[TORQUE_FUNCTION]);
}

static void test_use_of_another_drive_forgets_what_was_read_by_the_old_one(void)
{
    make_ready();
    tick(1);
    command(OPERATION_USE_REALTIME);
    start();
    timer_tick_without_sensors();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, torque().mode);
}

static void test_robot_that_was_never_told_anything_does_not_drive_by_timer(void)
{
    app_init(&app, &omnibot, NODE, (app_port_t){.drives = 1u << DRIVE_REALTIME, .drive = DRIVE_REALTIME});
    make_ready();
    start();
    timer_tick_without_sensors();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, torque().mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_POSE, app.fault);
}

// ---- a new host

static void test_hello_tells_that_nothing_waits_to_be_kept(void)
{
    parameter_store_message_t store;
    hello();
    TEST_ASSERT_EQUAL(1, count[PARAMETER_STORE_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, parameter_store_decode(&store, &last[PARAMETER_STORE_FUNCTION]));
    TEST_ASSERT_EQUAL_UINT8(0, store.unsaved);
}

static void test_hello_tells_which_robot_file_the_firmware_is_of(void)
{
    parameter_store_message_t store;
    hello();
    TEST_ASSERT_EQUAL(DECODE_OK, parameter_store_decode(&store, &last[PARAMETER_STORE_FUNCTION]));
    TEST_ASSERT_EQUAL_HEX32(omnibot.file_checksum, store.robot_checksum);
}

static void test_hello_in_lockstep_takes_any_tick_as_new(void)
{
    sync(100);
    hello();
    sync(100);
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
}

static void test_hello_while_braking_with_a_fault_ends_in_fault(void)
{
    make_moving();
    app_note_health(&app, &(app_health_t){.can_state = CAN_STATE_BUS_OFF});
    look();
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, status().mode);

    hello();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, status().mode);
}

static void test_tick_that_comes_again_at_rest_is_answered_without_a_step(void)
{
    tick(100);
    TEST_ASSERT_EQUAL(1, count[STATUS_FUNCTION]);
    sync(100);
    TEST_ASSERT_EQUAL(1, count[TORQUE_FUNCTION]);
    TEST_ASSERT_EQUAL(0, count[STATUS_FUNCTION]);
}

static void test_readings_of_any_later_tick_are_taken(void)
{
    // The counters are the low four bits of the ticks.
    for (uint32_t first = 1000; first < 1016; first++) {
        for (uint32_t ahead = 1; ahead < 16; ahead++) {
            setUp();
            tick(first);
            tick(first + ahead);
            TEST_ASSERT_EQUAL_UINT16(0, app.drops.all);
            TEST_ASSERT_EQUAL_UINT32(0, app.pose.age_ticks);
            TEST_ASSERT_EQUAL_UINT32(0, app.wheel_speed.age_ticks);
        }
    }
}

static void test_frames_past_the_identifiers_of_the_bus_are_ignored(void)
{
    for (uint32_t function = FUNCTIONS; function < 0x10000u >> FRAME_NODE_BITS; function++) {
        const frame_t frame = {.id = (uint16_t)(function << FRAME_NODE_BITS | NODE), .length = 8};
        app_receive(&app, &frame);
    }
    look();
    TEST_ASSERT_EQUAL_UINT16(0, app.drops.all);
}

// ---- drops, each by its reason

static drops_message_t drops(void)
{
    drops_message_t message;
    sync(host_tick + STATUS_TICKS / 2 - host_tick % STATUS_TICKS);
    TEST_ASSERT_EQUAL(1, count[DROPS_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, drops_decode(&message, &last[DROPS_FUNCTION]));
    return message;
}

static void test_readings_that_sync_does_not_vouch_for_are_damaged(void)
{
    sync_at(1, (vec3_t){0}, 0x40);
    const drops_message_t dropped = drops();
    TEST_ASSERT_EQUAL_UINT32(2, (uint32_t)dropped.damaged);
    TEST_ASSERT_EQUAL_UINT32(0, (uint32_t)dropped.replayed);
    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT16(2, status().dropped_frames);
}

// ---- commands

static void test_command_that_is_obeyed_shows_no_refusal(void)
{
    make_ready();
    command(OPERATION_ARM);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, status().refusal);
    TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, status().mode);
    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, status().refusal);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, status().mode);
}

static void test_keys_are_those_of_the_published_generator(void)
{
    // Numerical Recipes' quick and dirty generator, from 0 on: its upper half.
    uint64_t state = 0;
    make_ready();
    for (int i = 0; i < 1000; i++) {
        state = (state * 1664525u + 1013904223u) % 4294967296u;
        command(OPERATION_ARM);
        challenge_message_t challenge;
        TEST_ASSERT_EQUAL(DECODE_OK, challenge_decode(&challenge, &last[CHALLENGE_FUNCTION]));
        TEST_ASSERT_EQUAL_UINT16(state / 65536u, challenge.key);
        command(OPERATION_STOP);
    }
}

static void test_parameter_set_in_motion_names_an_unknown_index_first(void)
{
    const struct {
        uint8_t index, result;
    } expected[] = {
        {PARAMETER_COUNT - 1, PARAMETER_VALUE_RESULT_IN_MOTION},
        {PARAMETER_COUNT, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX},
    };
    make_moving();
    for (int i = 0; i < 2; i++) {
        set_parameter(expected[i].index, 1.0f);
        parameter_value_message_t value;
        TEST_ASSERT_EQUAL(1, count[PARAMETER_VALUE_FUNCTION]);
        TEST_ASSERT_EQUAL(DECODE_OK, parameter_value_decode(&value, &last[PARAMETER_VALUE_FUNCTION]));
        TEST_ASSERT_EQUAL_UINT8(expected[i].result, value.result);
    }
}

// ---- a new start

static void test_start_forgets_the_ticks_missed_in_a_row(void)
{
    make_moving();
    tick(1009); // 8 are missed, 10 may be
    hello();
    start();
    tick(1);
    tick(10);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, torque().mode);
}

static void test_start_forgets_the_overruns(void)
{
    make_drive(OPERATION_USE_REALTIME);
    app_note_overrun(&app, 3);
    timer_tick();
    command(OPERATION_STOP);
    while (app.mode == MODE_STOPPING) {
        timer_tick();
    }
    start();
    timing_message_t timing;
    app_note_step_time(&app, 1000);
    timer_tick(); // tick 0: it is told
    TEST_ASSERT_EQUAL(1, count[TIMING_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, timing_decode(&timing, &last[TIMING_FUNCTION]));
    TEST_ASSERT_EQUAL_UINT16(0, timing.overruns);
}

static void test_start_forgets_the_periods_without_a_step_before_it(void)
{
    command(OPERATION_USE_REALTIME);
    make_ready();
    timer_tick();
    app_note_overrun(&app, APP_HEARTBEAT_TICKS_MAX + 1);
    start();
    timer_tick();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, torque().mode);
}

static void test_start_by_timer_keeps_the_age_of_what_was_read(void)
{
    make_drive(OPERATION_USE_REALTIME); // the last tick had wheel speeds
    for (int k = 1; k <= 5; k++) {
        timer_tick_without_sensors();
        TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, torque().mode);
    }
    timer_tick_without_sensors(); // 6 ms old, 5 are allowed
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, torque().mode);
}

static void test_start_gives_the_motors_nothing_of_the_drive_before(void)
{
    make_drive(OPERATION_USE_MOTORS);
    timer_tick();
    vec3_t torque_Nm;
    TEST_ASSERT_TRUE(app_motor_torque(&app, &torque_Nm));
    TEST_ASSERT_GREATER_THAN_FLOAT(1e-3f, vec3_max_abs(torque_Nm));
    app_note_motor_fault(&app, FAULT_BRIDGE);
    command(OPERATION_CLEAR);
    start(); // and no tick since
    TEST_ASSERT_TRUE(app_motor_torque(&app, &torque_Nm));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(torque_Nm));
}

/// Ticks until the robot rests after a STOP at 0.5 m/s, half a second at rest included; the robot is where it should
/// be.
static int ticks_to_rest(void)
{
    uint32_t now = host_tick;
    command(OPERATION_STOP);
    for (int k = 1; k < 5000; k++) {
        const reference_t here = trajectory_reference(app.store.segment, 1, &app.cursor);
        sync_at(++now, (vec3_t){here.position.x, 0.0f, 0.0f}, 0);
        look();
        if (torque().mode != MODE_STOPPING) {
            return k;
        }
    }
    TEST_FAIL_MESSAGE("still STOPPING");
    return 0;
}

static void test_stop_brakes_by_its_parameter(void)
{
    make_ready();
    set_parameter(PARAMETER_BRAKING_M_PER_S2, 0.5f);
    start();
    tick(1000);
    TEST_ASSERT_INT_WITHIN(2, 1000 + 500, ticks_to_rest());
}

static void test_stop_after_another_start_brakes_as_the_first_did(void)
{
    make_moving();
    const int first = ticks_to_rest();
    TEST_ASSERT_INT_WITHIN(2, 333 + 500, first);
    start();
    tick(host_tick + 1);
    TEST_ASSERT_EQUAL(first, ticks_to_rest());
}

// ---- faults

static void test_robot_too_far_to_a_side_is_lost(void)
{
    set_parameter(PARAMETER_ERROR_LIMIT_M, 0.1f);
    make_moving();
    sync_at(1001, (vec3_t){0.0f, 0.11f, 0.0f}, 0);
    look();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, torque().mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_ERROR_LIMIT, app.fault);
}

static void test_state_that_is_no_number_cuts_the_torque(void)
{
    make_moving();
    app.state.force_estimate_N.y = NAN; // as by a bit that flips
    tick(1001);
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, torque().mode);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, torque().wheel1_Nm);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, torque().wheel3_Nm);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NOT_FINITE, app.fault);
    TEST_ASSERT_EQUAL_UINT16(1u << FAULT_NOT_FINITE, app.fault_mask);
}

/// firmware/app/faults.toml, read by eye.
static bool brakes(uint8_t fault)
{
    return fault == FAULT_STALE_POSE || fault == FAULT_HOST_SILENT || fault == FAULT_BUS_OFF;
}

static fault_record_message_t record(void)
{
    fault_record_message_t message;
    TEST_ASSERT_EQUAL(1, count[FAULT_RECORD_FUNCTION]);
    TEST_ASSERT_EQUAL(DECODE_OK, fault_record_decode(&message, &last[FAULT_RECORD_FUNCTION]));
    return message;
}

static void test_each_fault_is_recorded_with_its_own_reaction_and_again_while_it_lasts(void)
{
    for (uint8_t fault = 1; fault < FAULT_COUNT; fault++) {
        setUp();
        sync(7);
        faults_raise(&app, fault);
        look();
        sync(8);
        TEST_ASSERT_EQUAL_UINT8(fault, record().fault);
        TEST_ASSERT_EQUAL_UINT8(brakes(fault) ? REACTION_BRAKE : REACTION_CUT, record().reaction);
        TEST_ASSERT_EQUAL_UINT32(7, record().tick);
        for (uint32_t k = 9; k <= STATUS_TICKS / 2; k++) {
            sync(k);
            TEST_ASSERT_EQUAL(0, count[FAULT_RECORD_FUNCTION]);
        }
        sync(STATUS_TICKS / 2 + 1);
        TEST_ASSERT_EQUAL_UINT8(fault, record().fault);
    }
}

static void test_robot_without_a_fault_records_none(void)
{
    for (uint32_t k = 1; k < 2 * STATUS_TICKS; k++) {
        sync(k);
        TEST_ASSERT_EQUAL(0, count[FAULT_RECORD_FUNCTION]);
    }
}

// ---- the board

static void test_wheel_speed_is_taken_up_to_what_a_wheel_can_have(void)
{
    command(OPERATION_USE_MOTORS);
    app_set_wheel_speed(&app, (vec3_t){1000.0f, -1000.0f, 0.0f});
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 1000.0f, app.wheel_speed.value.x);
    app_set_wheel_speed(&app, (vec3_t){0.0f, 1001.0f, 0.0f});
    TEST_ASSERT_FLOAT_WITHIN(0.0f, -1000.0f, app.wheel_speed.value.y);
}

static void test_health_tells_whether_the_bridges_are_on(void)
{
    for (int moving = 0; moving <= 1; moving++) {
        setUp();
        if (moving == 1) {
            make_drive(OPERATION_USE_MOTORS);
        } else {
            command(OPERATION_USE_MOTORS);
        }
        app_note_health(&app, &(app_health_t){.supply_V = 12.0f});
        timer_tick(); // tick 0
        health_message_t health;
        TEST_ASSERT_EQUAL(1, count[HEALTH_FUNCTION]);
        TEST_ASSERT_EQUAL(DECODE_OK, health_decode(&health, &last[HEALTH_FUNCTION]));
        TEST_ASSERT_EQUAL_UINT8(moving, health.bridges);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_use_of_a_timer_counts_ticks_anew);
    RUN_TEST(test_use_of_lockstep_takes_a_tick_that_came_before_as_new);
    RUN_TEST(test_use_of_a_timer_waits_for_its_host_before_it_speaks);
    RUN_TEST(test_use_of_another_drive_forgets_what_was_read_by_the_old_one);
    RUN_TEST(test_robot_that_was_never_told_anything_does_not_drive_by_timer);
    RUN_TEST(test_hello_tells_that_nothing_waits_to_be_kept);
    RUN_TEST(test_hello_tells_which_robot_file_the_firmware_is_of);
    RUN_TEST(test_hello_in_lockstep_takes_any_tick_as_new);
    RUN_TEST(test_hello_while_braking_with_a_fault_ends_in_fault);
    RUN_TEST(test_tick_that_comes_again_at_rest_is_answered_without_a_step);
    RUN_TEST(test_readings_of_any_later_tick_are_taken);
    RUN_TEST(test_frames_past_the_identifiers_of_the_bus_are_ignored);
    RUN_TEST(test_readings_that_sync_does_not_vouch_for_are_damaged);
    RUN_TEST(test_command_that_is_obeyed_shows_no_refusal);
    RUN_TEST(test_keys_are_those_of_the_published_generator);
    RUN_TEST(test_parameter_set_in_motion_names_an_unknown_index_first);
    RUN_TEST(test_start_forgets_the_ticks_missed_in_a_row);
    RUN_TEST(test_start_forgets_the_overruns);
    RUN_TEST(test_start_forgets_the_periods_without_a_step_before_it);
    RUN_TEST(test_start_by_timer_keeps_the_age_of_what_was_read);
    RUN_TEST(test_start_gives_the_motors_nothing_of_the_drive_before);
    RUN_TEST(test_stop_brakes_by_its_parameter);
    RUN_TEST(test_stop_after_another_start_brakes_as_the_first_did);
    RUN_TEST(test_robot_too_far_to_a_side_is_lost);
    RUN_TEST(test_state_that_is_no_number_cuts_the_torque);
    RUN_TEST(test_each_fault_is_recorded_with_its_own_reaction_and_again_while_it_lasts);
    RUN_TEST(test_robot_without_a_fault_records_none);
    RUN_TEST(test_wheel_speed_is_taken_up_to_what_a_wheel_can_have);
    RUN_TEST(test_health_tells_whether_the_bridges_are_on);
    return UNITY_END();
}
