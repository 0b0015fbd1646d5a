// SPDX-License-Identifier: MIT
// The robot as the bus sees it: frames in, frames out. Frames are made and read by the generated codec, which
// test_messages.c holds against the definition; trajectory bytes and their CRC are made here.
#include "app.h"

#include "crc.h"
#include "faults.h"
#include "messages.h"
#include "unity.h"

#include <string.h>

enum { NODE = 3, SEGMENTS = 3, UPLOAD_BYTES = 100 * SEGMENTS, TICK_GAP_MAX = 10 };

static const app_port_t lockstep_only = {.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP};

static app_t app;
static uint8_t upload[UPLOAD_BYTES];
static uint8_t requests; // sent: their counter
static uint16_t key;     // of the last CHALLENGE

static uint32_t host_tick; // of the last timer_tick

/// Sensor frames that go out with the next SYNC.
static struct {
    bool has_pose, has_wheel_speed;
    vec3_t pose, wheel_speed;
} sensors;

/// What came out since the last look.
static struct {
    frame_t frame[OUTBOX_FRAMES + 1]; // a STATUS that was owed comes on top
    int count;
    int torques, slips, statuses, acks, values, texts, stores, identities, timings, healths, crashes;
    int drop_reports, records, challenges;
    frame_t torque_frame, slip_frame;
    torque_message_t torque;
    slip_message_t slip;
    status_message_t status;
    trajectory_ack_message_t ack;
    parameter_value_message_t value;
    identity_message_t identity;
    timing_message_t timing;
    health_message_t health;
    crash_message_t crash;
    drops_message_t drops;
    fault_record_message_t record;
    challenge_message_t challenge;
    parameter_text_message_t text;
    parameter_store_message_t store;
} got;

static void note(const frame_t *frame)
{
    TEST_ASSERT_EQUAL_UINT16(NODE, frame->id & FRAME_NODE_MASK);
    switch (frame->id >> FRAME_NODE_BITS) {
    case TORQUE_FUNCTION:
        got.torques++;
        got.torque_frame = *frame;
        TEST_ASSERT_EQUAL(DECODE_OK, torque_decode(&got.torque, frame));
        break;
    case SLIP_FUNCTION:
        got.slips++;
        got.slip_frame = *frame;
        TEST_ASSERT_EQUAL(DECODE_OK, slip_decode(&got.slip, frame));
        break;
    case STATUS_FUNCTION:
        got.statuses++;
        TEST_ASSERT_EQUAL(DECODE_OK, status_decode(&got.status, frame));
        break;
    case TRAJECTORY_ACK_FUNCTION:
        got.acks++;
        TEST_ASSERT_EQUAL(DECODE_OK, trajectory_ack_decode(&got.ack, frame));
        break;
    case PARAMETER_VALUE_FUNCTION:
        got.values++;
        TEST_ASSERT_EQUAL(DECODE_OK, parameter_value_decode(&got.value, frame));
        break;
    case IDENTITY_FUNCTION:
        got.identities++;
        TEST_ASSERT_EQUAL(DECODE_OK, identity_decode(&got.identity, frame));
        break;
    case TIMING_FUNCTION:
        got.timings++;
        TEST_ASSERT_EQUAL(DECODE_OK, timing_decode(&got.timing, frame));
        break;
    case HEALTH_FUNCTION:
        got.healths++;
        TEST_ASSERT_EQUAL(DECODE_OK, health_decode(&got.health, frame));
        break;
    case CRASH_FUNCTION:
        got.crashes++;
        TEST_ASSERT_EQUAL(DECODE_OK, crash_decode(&got.crash, frame));
        break;
    case DROPS_FUNCTION:
        got.drop_reports++;
        TEST_ASSERT_EQUAL(DECODE_OK, drops_decode(&got.drops, frame));
        break;
    case FAULT_RECORD_FUNCTION:
        got.records++;
        TEST_ASSERT_EQUAL(DECODE_OK, fault_record_decode(&got.record, frame));
        break;
    case CHALLENGE_FUNCTION:
        got.challenges++;
        TEST_ASSERT_EQUAL(DECODE_OK, challenge_decode(&got.challenge, frame));
        key = got.challenge.key;
        break;
    case PARAMETER_TEXT_FUNCTION:
        got.texts++;
        TEST_ASSERT_EQUAL(DECODE_OK, parameter_text_decode(&got.text, frame));
        break;
    case PARAMETER_STORE_FUNCTION:
        got.stores++;
        TEST_ASSERT_EQUAL(DECODE_OK, parameter_store_decode(&got.store, frame));
        break;
    default:
        TEST_FAIL_MESSAGE("a frame that the robot does not send");
    }
}

/// Takes everything out of the outbox.
static void look(void)
{
    memset(&got, 0, sizeof got);
    frame_t frame;
    while (app_transmit(&app, &frame)) {
        TEST_ASSERT_LESS_THAN(OUTBOX_FRAMES + 1, got.count);
        got.frame[got.count++] = frame;
        note(&frame);
    }
}

// ---- what the host sends

static void hello(uint32_t hash)
{
    frame_t frame;
    hello_encode(&frame, NODE, &(hello_message_t){hash});
    app_receive(&app, &frame);
    look();
}

static uint8_t next_request(void)
{
    requests = (uint8_t)((requests + 1) & 0xFu);
    return requests;
}

static void send_command(command_message_t message)
{
    frame_t frame;
    command_encode(&frame, NODE, &message);
    app_receive(&app, &frame);
    look();
}

/// START is sent with the key of the last CHALLENGE.
static void command(uint8_t operation)
{
    send_command((command_message_t){.operation = operation, .counter = next_request(), .key = key});
}

static void start(void)
{
    command(OPERATION_ARM);
    command(OPERATION_START);
}

static void pose(float x1, float x2, float heading)
{
    sensors.has_pose = true;
    sensors.pose = (vec3_t){x1, x2, heading};
}

static void wheel_speed(float wheel1, float wheel2, float wheel3)
{
    sensors.has_wheel_speed = true;
    sensors.wheel_speed = (vec3_t){wheel1, wheel2, wheel3};
}

/// Gives a sensor frame to the robot; returns what SYNC must say of it.
static uint8_t receive_sensor(const frame_t *frame)
{
    app_receive(&app, frame);
    return crc8_frame(frame, frame->length);
}

static uint8_t send_pose(uint32_t number)
{
    const vec3_t p = sensors.pose;
    frame_t frame;
    pose_encode(&frame, NODE, &(pose_message_t){p.x, p.y, p.z, (uint8_t)(number & 0xFu)});
    return receive_sensor(&frame);
}

static uint8_t send_wheel_speed(uint32_t number)
{
    const vec3_t w = sensors.wheel_speed;
    frame_t frame;
    wheel_speed_encode(&frame, NODE, &(wheel_speed_message_t){w.x, w.y, w.z, (uint8_t)(number & 0xFu)});
    return receive_sensor(&frame);
}

static void send_sync(sync_message_t sync)
{
    frame_t frame;
    sync_encode(&frame, NODE, &sync);
    app_receive(&app, &frame);
}

/// The sensor frames of a tick and its SYNC.
static void sync_only(uint32_t number)
{
    sync_message_t sync = {.tick = number};
    sync.pose_crc = sensors.has_pose ? send_pose(number) : 0;
    sync.wheel_speed_crc = sensors.has_wheel_speed ? send_wheel_speed(number) : 0;
    memset(&sensors, 0, sizeof sensors);
    send_sync(sync);
}

static void sync(uint32_t tick)
{
    sync_only(tick);
    look();
}

enum { TICK_FRAMES = 3 };

/// The frames of a tick, for whoever takes them: the robot 1 cm behind the trajectory's start.
static void make_tick_frames(uint32_t number, frame_t frame[TICK_FRAMES])
{
    const uint8_t counter = (uint8_t)(number & 0xFu);
    pose_encode(&frame[0], NODE, &(pose_message_t){-0.01f, 0.0f, 0.0f, counter});
    wheel_speed_encode(&frame[1], NODE, &(wheel_speed_message_t){.counter = counter});
    const sync_message_t sync = {number, crc8_frame(&frame[0], 8), crc8_frame(&frame[1], 8)};
    sync_encode(&frame[2], NODE, &sync);
}

/// A whole tick: the robot 1 cm behind the trajectory's start.
static void tick(uint32_t number)
{
    pose(-0.01f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(number);
}

static void set_parameter(uint8_t index, float value)
{
    frame_t frame;
    const parameter_set_message_t set = {.index = index, .value = value, .counter = next_request()};
    parameter_set_encode(&frame, NODE, &set);
    app_receive(&app, &frame);
    look();
}

static void get_parameter(uint8_t index)
{
    frame_t frame;
    parameter_get_encode(&frame, NODE, &(parameter_get_message_t){.index = index});
    app_receive(&app, &frame);
    look();
}

// ---- a trajectory: the point ahead of the origin moves along x at 0.5 m/s for 10, 20 and 30 ms

static void write_word(uint8_t *byte, uint32_t word)
{
    for (int i = 0; i < 4; i++) {
        byte[i] = (uint8_t)(word >> 8 * i);
    }
}

static void write_float(uint8_t *byte, float value)
{
    uint32_t word;
    memcpy(&word, &value, sizeof word);
    write_word(byte, word);
}

static uint32_t crc32_bitwise(const uint8_t *byte, uint32_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (uint32_t i = 0; i < count; i++) {
        crc ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1u) != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
        }
    }
    return crc ^ 0xFFFFFFFFu;
}

static const float start_m[SEGMENTS] = {0.0f, 0.005f, 0.015f};

static void make_upload(void)
{
    memset(upload, 0, sizeof upload);
    for (uint32_t i = 0; i < SEGMENTS; i++) {
        const uint32_t duration_us = 10000u * (i + 1);
        write_word(&upload[100 * i], duration_us);
        write_float(&upload[100 * i + 4], start_m[i]);
        write_float(&upload[100 * i + 8], 0.5e-6f * (float)duration_us);
        write_float(&upload[100 * i + 36], 0.12f);
    }
}

static void begin_upload(uint32_t crc32)
{
    frame_t frame;
    const trajectory_begin_message_t begin = {UPLOAD_BYTES, crc32, next_request()};
    trajectory_begin_encode(&frame, NODE, &begin);
    app_receive(&app, &frame);
    look();
}

static void send_data(uint16_t offset)
{
    const uint8_t *b = &upload[offset];
    frame_t frame;
    trajectory_data_encode(&frame, NODE, &(trajectory_data_message_t){offset, b[0], b[1], b[2], b[3], b[4], b[5]});
    app_receive(&app, &frame);
    look();
}

static void upload_trajectory(void)
{
    make_upload();
    begin_upload(crc32_bitwise(upload, UPLOAD_BYTES));
    TEST_ASSERT_EQUAL(1, got.acks);
    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_RECEIVING, got.ack.result);
    for (uint16_t offset = 0; offset < UPLOAD_BYTES; offset += 6) {
        send_data(offset);
    }
    TEST_ASSERT_EQUAL(1, got.acks);
    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_COMPLETE, got.ack.result);
    TEST_ASSERT_EQUAL_UINT16(UPLOAD_BYTES, got.ack.offset_bytes);
}

/// Ready to drive, in IDLE.
static void make_ready(void)
{
    hello(PROTOCOL_HASH);
    upload_trajectory();
}

static void make_tracking(void)
{
    make_ready();
    start();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
}

/// Tracking, with tick 1000 answered at trajectory time 0.
static void make_moving(void)
{
    make_tracking();
    tick(1000);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.torque.mode);
}

static void make_faulty(void)
{
    make_tracking();
    sync(1000); // no sensors yet
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.torque.mode);
}

static void assert_no_torque(void)
{
    TEST_ASSERT_EQUAL(1, got.torques);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, got.torque.wheel1_Nm);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, got.torque.wheel2_Nm);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, got.torque.wheel3_Nm);
}

static void assert_pushes_ahead(void)
{
    TEST_ASSERT_EQUAL(1, got.torques);
    TEST_ASSERT_LESS_THAN_FLOAT(-0.001f, got.torque.wheel1_Nm);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.001f, got.torque.wheel3_Nm);
}

/// In FAULT by a cause, without torque, and said so.
static void assert_fault(uint8_t cause)
{
    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.torque.mode);
    TEST_ASSERT_EQUAL(1, got.statuses);
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(cause, got.status.fault);
    TEST_ASSERT_EQUAL_UINT16(1u << cause, got.status.fault_mask);
}

/// On its way to a stop, by a cause, and said so.
static void assert_brakes(uint8_t cause)
{
    TEST_ASSERT_EQUAL(1, got.torques);
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.torque.mode);
    TEST_ASSERT_EQUAL(1, got.statuses);
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(cause, got.status.fault);
    TEST_ASSERT_EQUAL_UINT16(1u << cause, got.status.fault_mask);
}

enum { REST_TICKS_MAX = 2600 }; // 2 s of braking at most, 0.5 s at rest, and the STATUS between

/// Ticks with all sensors until the robot no longer brakes; returns the one that ended it.
static uint32_t come_to_rest(uint32_t next_tick)
{
    for (uint32_t k = next_tick; k < next_tick + REST_TICKS_MAX; k++) {
        tick(k);
        if (got.torque.mode != MODE_STOPPING) {
            return k;
        }
    }
    TEST_FAIL_MESSAGE("still STOPPING");
    return 0;
}

static void assert_still_tracking(void)
{
    assert_pushes_ahead();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.torque.mode);
}

static void assert_cursor(uint16_t segment, uint32_t time_us)
{
    TEST_ASSERT_EQUAL_UINT16(segment, app.cursor.segment);
    TEST_ASSERT_EQUAL_UINT32(time_us, app.cursor.time_us);
}

void setUp(void)
{
    app_init(&app, &omnibot, NODE, lockstep_only);
    look();
}

void tearDown(void)
{
}

// ---- start-up

static void test_init_is_idle_and_says_so(void)
{
    app_init(&app, &omnibot, NODE, lockstep_only);
    look();

    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL(1, got.statuses);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, got.status.fault);
    TEST_ASSERT_EQUAL_UINT16(0, got.status.fault_mask);
    TEST_ASSERT_EQUAL_UINT16(0, got.status.dropped_frames);
}

static void test_init_over_an_old_instance_forgets_everything(void)
{
    make_faulty();

    app_init(&app, &omnibot, NODE, lockstep_only);
    look();
    command(OPERATION_ARM);

    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, got.status.fault);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_UNKNOWN_PEER, got.status.refusal);
}

// ---- HELLO

static void test_hello_with_our_hash_is_answered_by_a_matching_identity(void)
{
    hello(PROTOCOL_HASH);

    TEST_ASSERT_EQUAL(2, got.count);
    TEST_ASSERT_EQUAL(1, got.stores);
    TEST_ASSERT_EQUAL_UINT8(PARAMETER_COUNT, got.store.count);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_NO_MEMORY, got.store.origin);
    TEST_ASSERT_EQUAL(1, got.identities);
    TEST_ASSERT_EQUAL_HEX32(PROTOCOL_HASH, got.identity.protocol_hash);
    TEST_ASSERT_EQUAL_UINT8(1, got.identity.peer_matches);
    TEST_ASSERT_EQUAL_UINT8(APP_VERSION_MAJOR, got.identity.major);
    TEST_ASSERT_EQUAL_UINT8(APP_VERSION_MINOR, got.identity.minor);
    TEST_ASSERT_EQUAL_UINT8(APP_VERSION_PATCH, got.identity.patch);
}

static void test_hello_with_another_hash_is_answered_by_ours_and_no_match(void)
{
    hello(PROTOCOL_HASH ^ 1u);

    TEST_ASSERT_EQUAL(1, got.identities);
    TEST_ASSERT_EQUAL_HEX32(PROTOCOL_HASH, got.identity.protocol_hash);
    TEST_ASSERT_EQUAL_UINT8(0, got.identity.peer_matches);
}

// ---- START

static void assert_start_refused(uint8_t refusal, uint8_t mode)
{
    command(OPERATION_ARM);
    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL(1, got.statuses);
    TEST_ASSERT_EQUAL_UINT8(refusal, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(mode, got.status.mode);
}

static void test_start_without_hello_is_refused_unknown_peer(void)
{
    upload_trajectory();
    assert_start_refused(REFUSAL_UNKNOWN_PEER, MODE_IDLE);
}

static void test_start_after_a_wrong_hash_is_refused_unknown_peer(void)
{
    hello(PROTOCOL_HASH + 1u);
    upload_trajectory();
    assert_start_refused(REFUSAL_UNKNOWN_PEER, MODE_IDLE);
}

static void test_start_after_a_right_and_then_a_wrong_hash_is_refused_unknown_peer(void)
{
    make_ready();
    hello(0u);
    assert_start_refused(REFUSAL_UNKNOWN_PEER, MODE_IDLE);
}

static void test_start_without_a_trajectory_is_refused(void)
{
    hello(PROTOCOL_HASH);
    assert_start_refused(REFUSAL_NO_TRAJECTORY, MODE_IDLE);
}

static void test_start_during_an_upload_is_refused_no_trajectory(void)
{
    make_ready();
    begin_upload(0u);
    assert_start_refused(REFUSAL_NO_TRAJECTORY, MODE_IDLE);
}

static void test_start_while_tracking_is_refused_wrong_mode(void)
{
    make_moving();
    tick(1001);
    assert_start_refused(REFUSAL_WRONG_MODE, MODE_TRACKING);
    assert_cursor(0, 1000);
}

static void test_start_in_fault_is_refused_wrong_mode(void)
{
    make_faulty();
    assert_start_refused(REFUSAL_WRONG_MODE, MODE_FAULT);
}

static void test_start_when_ready_tracks(void)
{
    make_ready();
    start();

    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, got.status.refusal);
}

static void test_command_of_any_kind_is_answered_by_one_status_alone(void)
{
    static const uint8_t operation[] = {OPERATION_START, OPERATION_START, OPERATION_CLEAR, OPERATION_STOP,
                                        OPERATION_STOP,  OPERATION_CLEAR, OPERATION_NONE};
    make_ready();
    for (size_t i = 0; i < sizeof operation / sizeof operation[0]; i++) {
        command(operation[i]);

        TEST_ASSERT_EQUAL(1, got.count);
        TEST_ASSERT_EQUAL(1, got.statuses);
    }
    make_faulty();
    command(OPERATION_CLEAR);
    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL(1, got.statuses);
}

static void test_start_taken_after_a_refusal_no_longer_shows_it_in_any_status(void)
{
    hello(PROTOCOL_HASH);
    start(); // refused: no trajectory
    upload_trajectory();

    start();

    TEST_ASSERT_GREATER_THAN(0, got.count);
    for (int i = 0; i < got.count; i++) {
        status_message_t status;
        TEST_ASSERT_EQUAL(DECODE_OK, status_decode(&status, &got.frame[i]));
        TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, status.refusal);
        TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, status.mode);
    }
}

static void test_start_takes_any_tick_number_as_the_first(void)
{
    make_ready();
    tick(5000);
    start();

    tick(7);
    assert_still_tracking();
    assert_cursor(0, 0);

    tick(8);
    assert_still_tracking();
    assert_cursor(0, 1000);
}

static void test_start_between_two_syncs_of_one_tick_steps_it_anew(void)
{
    make_ready();
    tick(50);
    assert_no_torque();
    start();

    tick(50);

    assert_still_tracking();
}

static void test_start_after_stop_begins_the_trajectory_again(void)
{
    make_moving();
    tick(1001);
    command(OPERATION_STOP);
    const uint32_t last = come_to_rest(1002);
    start();

    tick(last + 1);

    assert_still_tracking();
    assert_cursor(0, 0);
}

static void test_unknown_operations_are_refused(void)
{
    static const uint8_t unknown[] = {OPERATION_NONE, 10, 100, 255};
    make_moving();
    for (size_t i = 0; i < sizeof unknown / sizeof unknown[0]; i++) {
        command(unknown[i]);

        TEST_ASSERT_EQUAL(1, got.statuses);
        TEST_ASSERT_EQUAL_UINT8(REFUSAL_UNKNOWN_OPERATION, got.status.refusal);
        TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
    }
}

// ---- SYNC

static void test_sync_in_every_mode_is_answered_by_one_torque_and_one_slip(void)
{
    for (int mode = MODE_IDLE; mode <= MODE_FAULT; mode++) {
        setUp();
        if (mode == MODE_TRACKING || mode == MODE_STOPPING) {
            make_moving();
        } else if (mode == MODE_FAULT) {
            make_faulty();
        } else if (mode == MODE_ARMED) {
            make_ready();
            command(OPERATION_ARM);
        }
        if (mode == MODE_STOPPING) {
            command(OPERATION_STOP);
        }
        tick(1001); // in FAULT each with a FAULT_RECORD: two causes
        tick(1002);
        for (uint32_t k = 1003; k < 1050; k++) {
            tick(k);

            TEST_ASSERT_EQUAL(2, got.count);
            TEST_ASSERT_EQUAL(1, got.torques);
            TEST_ASSERT_EQUAL(1, got.slips);
            TEST_ASSERT_EQUAL_UINT8(mode, got.torque.mode);
            TEST_ASSERT_EQUAL_UINT8(k & 0xFu, got.torque.counter);
            TEST_ASSERT_EQUAL_UINT8(k & 0xFu, got.slip.counter);
        }
    }
}

static void test_sync_in_idle_and_fault_gives_no_torque(void)
{
    make_ready();
    tick(1);
    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.torque.mode);

    setUp();
    make_faulty();
    tick(1001);
    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.torque.mode);
}

static void test_sync_in_idle_without_sensors_is_no_fault(void)
{
    for (uint32_t k = 1; k < 50; k++) {
        sync(k);
        TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.torque.mode);
    }
}

static void test_sync_while_tracking_gives_the_torque_of_the_control_step(void)
{
    make_tracking();
    control_state_t state = {0};
    for (uint32_t k = 0; k < 65; k++) {
        const float x = -0.01f + 0.0004f * (float)k, heading = 0.002f * (float)k;
        pose(x, 0.003f, heading);
        wheel_speed(-10.0f, 0.5f, 12.0f);
        sync(2000 + k);

        // The reference by hand: 0.5 m/s, at rest from 60 ms on. The wire's resolution is below the tolerance.
        const bool at_end = k >= 60;
        const control_input_t input = {
            .pose_is_new = true,
            .pose = {x, 0.003f, heading},
            .wheel_speed_rad_per_s = {-10.0f, 0.5f, 12.0f},
            .reference = {.position = {at_end ? 0.03f : 0.0005f * (float)k, 0.12f, 0.0f},
                          .velocity = {at_end ? 0.0f : 0.5f, 0.0f, 0.0f}},
        };
        control_output_t expected;
        TEST_ASSERT_TRUE(control_step(&app.control, &state, &input, &expected));
        TEST_ASSERT_FLOAT_WITHIN(6e-5f, expected.torque_Nm.x, got.torque.wheel1_Nm);
        TEST_ASSERT_FLOAT_WITHIN(6e-5f, expected.torque_Nm.y, got.torque.wheel2_Nm);
        TEST_ASSERT_FLOAT_WITHIN(6e-5f, expected.torque_Nm.z, got.torque.wheel3_Nm);
        TEST_ASSERT_FLOAT_WITHIN(2e-3f, expected.mu_mps.x, got.slip.mu1_m_per_s);
        TEST_ASSERT_FLOAT_WITHIN(2e-3f, expected.mu_mps.y, got.slip.mu2_m_per_s);
        TEST_ASSERT_FLOAT_WITHIN(2e-3f, expected.mu_mps.z, got.slip.mu3_m_per_s);
    }
}

static void test_sync_steps_walk_over_the_joints_and_rest_at_the_end(void)
{
    make_moving();
    for (uint32_t k = 1; k <= 70; k++) {
        tick(1000 + k);

        const uint32_t segment = k < 10 ? 0 : k < 30 ? 1 : 2;
        const uint32_t since = k < 10 ? 0 : k < 30 ? 10 : 30;
        const uint32_t time_us = k < 60 ? 1000 * (k - since) : 30000;
        assert_cursor((uint16_t)segment, time_us);
        TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.torque.mode);
    }
}

static void test_sync_repeated_gets_the_same_bytes_and_no_second_step(void)
{
    make_moving();
    tick(1001);
    const frame_t torque = got.torque_frame, slip = got.slip_frame;
    for (int i = 0; i < 5; i++) {
        pose(0.5f, -0.3f, 0.2f); // would give another torque
        wheel_speed(1.0f, 2.0f, 3.0f);
        sync(1001);

        TEST_ASSERT_EQUAL(2, got.count);
        TEST_ASSERT_EQUAL_UINT16(torque.id, got.torque_frame.id);
        TEST_ASSERT_EQUAL_HEX8_ARRAY(torque.data, got.torque_frame.data, 8);
        TEST_ASSERT_EQUAL_HEX8_ARRAY(slip.data, got.slip_frame.data, 8);
        assert_cursor(0, 1000);
    }
    tick(1002);
    assert_still_tracking();
    assert_cursor(0, 2000);
    TEST_ASSERT_EQUAL_UINT16(0, app.missed_ticks);
}

static void test_sync_repeated_after_a_fault_gives_no_torque(void)
{
    app_init(&app, &omnibot, NODE, lockstep_only);
    look();
    make_moving();
    assert_pushes_ahead();
    hello(PROTOCOL_HASH); // a new host: the robot lets go

    sync(1000);

    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.torque.mode);
    TEST_ASSERT_EQUAL_UINT8(1000 & 0xF, got.torque.counter);
}

static void test_sync_repeated_after_stop_gives_the_same_bytes(void)
{
    make_moving();
    const frame_t torque = got.torque_frame;
    command(OPERATION_STOP);

    sync(1000);

    TEST_ASSERT_EQUAL_HEX8_ARRAY(torque.data, got.torque_frame.data, 8);
}

static void test_sync_repeated_in_fault_gives_the_same_bytes(void)
{
    make_faulty();
    const frame_t torque = got.torque_frame;

    sync(1000);

    TEST_ASSERT_EQUAL_HEX8_ARRAY(torque.data, got.torque_frame.data, 8);
    assert_no_torque();
}

static void test_sync_going_back_while_tracking_is_a_replay_and_not_answered(void)
{
    make_moving();

    tick(999);

    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_EQUAL_UINT16(1, app.drops.replayed);
    tick(1001);
    assert_still_tracking();
    assert_cursor(0, 1000);
}

static void test_sync_going_back_in_idle_is_a_host_that_begins_anew(void)
{
    make_ready();
    tick(1000);

    tick(3);

    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(3, got.torque.counter);
    TEST_ASSERT_EQUAL_UINT16(0, app.drops.replayed);
}

static void test_sync_going_back_in_fault_stays_in_fault(void)
{
    make_faulty();

    tick(1);

    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.torque.mode);
}

static void test_sync_at_the_largest_tick_is_a_tick_like_any_other(void)
{
    make_tracking();
    tick(UINT32_MAX - 1);
    tick(UINT32_MAX);

    assert_still_tracking();
    assert_cursor(0, 1000);
}

static void test_sync_wrapping_to_zero_goes_on(void)
{
    // After 49.7 days at 1 kHz.
    make_tracking();
    tick(UINT32_MAX);

    tick(0);

    assert_still_tracking();
    assert_cursor(0, 1000);
    TEST_ASSERT_EQUAL_UINT16(0, app.missed_ticks);
}

static void test_status_comes_every_hundredth_tick(void)
{
    make_ready();
    int statuses = 0;
    for (uint32_t k = 1; k <= 1000; k++) {
        tick(k);
        TEST_ASSERT_EQUAL(k % 100 == 0 ? 1 : 0, got.statuses);
        statuses += got.statuses;
    }
    TEST_ASSERT_EQUAL(10, statuses);
}

// ---- gaps

static void test_gap_small_moves_the_trajectory_by_it_and_is_counted(void)
{
    make_moving();

    tick(1004);

    assert_still_tracking();
    assert_cursor(0, 4000);
    TEST_ASSERT_EQUAL_UINT16(3, app.missed_ticks);
}

static void test_gap_as_long_as_allowed_is_no_fault(void)
{
    make_moving();

    tick(1000 + 1 + TICK_GAP_MAX);

    assert_still_tracking();
    assert_cursor(1, 1000); // 11 ms
    TEST_ASSERT_EQUAL_UINT16(TICK_GAP_MAX, app.missed_ticks);
}

static void test_gap_just_too_long_is_a_fault(void)
{
    make_moving();

    tick(1000 + 2 + TICK_GAP_MAX);

    assert_fault(FAULT_TICK_GAP);
    assert_cursor(0, 0);
    TEST_ASSERT_EQUAL_UINT16(TICK_GAP_MAX + 1, got.status.missed_ticks);
}

static void test_gap_of_the_largest_size_is_a_fault_and_its_count_saturates(void)
{
    make_tracking();
    tick(0);

    tick(INT32_MAX);

    assert_fault(FAULT_TICK_GAP);
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, app.missed_ticks);
}

static void test_gaps_in_idle_are_not_counted(void)
{
    make_ready();
    tick(1);
    tick(500);

    TEST_ASSERT_EQUAL_UINT16(0, app.missed_ticks);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.torque.mode);
}

static void test_gaps_add_up_and_start_forgets_them(void)
{
    make_moving();
    tick(1003);
    tick(1006);
    TEST_ASSERT_EQUAL_UINT16(4, app.missed_ticks);

    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT16(4, got.status.missed_ticks);
    (void)come_to_rest(1007);
    start();

    TEST_ASSERT_EQUAL_UINT16(0, got.status.missed_ticks);
}

// ---- faults

/// From tick 1001 on only the wheel speeds; the pose of tick 1000 was the last.
static void drive_without_pose(uint32_t ticks, float ahead_mps)
{
    const vec3_t wheels = wheels_of_body(&omnibot.wheel_rate_of_twist, (vec3_t){ahead_mps, 0.0f, 0.0f});
    for (uint32_t k = 1; k <= ticks; k++) {
        wheel_speed(wheels.x, wheels.y, wheels.z);
        sync(1000 + k);
        TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.torque.mode);
    }
}

static void test_pose_missing_until_its_timeout_is_borne_and_then_a_fault(void)
{
    make_moving();
    drive_without_pose(500, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1501);

    assert_brakes(FAULT_STALE_POSE);
}

static void test_pose_timeout_may_be_set(void)
{
    make_ready();
    set_parameter(PARAMETER_POSE_TIMEOUT_S, 0.02f);
    start();
    tick(1000);
    drive_without_pose(20, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1021);

    assert_brakes(FAULT_STALE_POSE);
}

static void test_pose_timeout_of_zero_is_a_fault_at_the_first_tick_without_a_pose(void)
{
    make_ready();
    set_parameter(PARAMETER_POSE_TIMEOUT_S, 0.0f);
    start();
    tick(1000);
    assert_still_tracking();
    tick(1001);
    assert_still_tracking();
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1002);

    assert_brakes(FAULT_STALE_POSE);
}

static void test_pose_missing_is_dead_reckoned_from_the_wheels(void)
{
    make_ready();
    set_parameter(PARAMETER_ORDER, 0.0f);
    start();
    tick(1000);
    drive_without_pose(200, 0.5f);

    // Order 0 believes the wheels: 0.5 m/s ahead for 0.2 s, from 1 cm behind. Half a period of the speed that it asks
    // for and these wheels do not gain comes on top: at most 3.5 N's worth, 3 m/s² · T/2 · 0.2 s.
    TEST_ASSERT_FLOAT_WITHIN(3.5e-4f, 0.09f, app.state.pose.value.x);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.0f, app.state.pose.value.y);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.0f, app.state.pose.value.z);
}

static void test_pose_that_comes_again_replaces_the_dead_reckoned_one(void)
{
    make_moving();
    drive_without_pose(100, 0.5f);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.03f, app.state.pose.value.x);

    tick(1101);

    TEST_ASSERT_FLOAT_WITHIN(1e-4f, -0.01f, app.state.pose.value.x);
    for (uint32_t k = 0; k < 500; k++) {
        wheel_speed(0.0f, 0.0f, 0.0f);
        sync(1102 + k);
        assert_still_tracking();
    }
}

static void test_start_forgets_the_state_of_the_last_drive(void)
{
    make_moving();
    tick(1001);
    TEST_ASSERT_GREATER_THAN_FLOAT(0.01f, vec3_max_abs(app.state.force_estimate_N));
    command(OPERATION_STOP);
    (void)come_to_rest(1002);

    start();

    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(app.state.force_estimate_N));
}

static void test_start_does_not_drive_on_what_was_read_before_it(void)
{
    make_moving();
    tick(1001);
    command(OPERATION_STOP);
    const uint32_t last = come_to_rest(1002);

    start();
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(last + 1);

    assert_fault(FAULT_STALE_POSE);
}

static void test_missed_ticks_move_the_dead_reckoned_pose_as_far_as_driven_ones(void)
{
    make_moving();
    drive_without_pose(100, 0.5f);
    const float before_m = app.state.pose.value.x;
    const vec3_t wheels = wheels_of_body(&omnibot.wheel_rate_of_twist, (vec3_t){0.5f, 0.0f, 0.0f});
    sync(1101);
    const float a_tick_m = app.state.pose.value.x - before_m;

    wheel_speed(wheels.x, wheels.y, wheels.z);
    sync(1107);

    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.torque.mode);
    TEST_ASSERT_FLOAT_WITHIN(0.3f * a_tick_m, before_m + 7.0f * a_tick_m, app.state.pose.value.x);
}

static void test_wheel_speed_missing_for_five_ticks_is_borne_and_for_six_a_fault(void)
{
    make_moving();
    for (uint32_t k = 1; k <= 5; k++) {
        pose(-0.01f, 0.0f, 0.0f);
        sync(1000 + k);
        assert_still_tracking();
    }
    pose(-0.01f, 0.0f, 0.0f);
    sync(1006);

    assert_fault(FAULT_STALE_WHEEL_SPEED);
}

static void test_sensor_data_after_five_missing_ticks_are_fresh_again(void)
{
    make_moving();
    for (uint32_t round = 0; round < 4; round++) {
        for (uint32_t k = 1; k <= 5; k++) {
            sync(1000 + 6 * round + k);
        }
        tick(1006 + 6 * round);
        assert_still_tracking();
    }
}

static void test_ticks_lost_in_a_gap_make_sensor_data_older(void)
{
    make_ready();
    set_parameter(PARAMETER_POSE_TIMEOUT_S, 0.005f);
    start();
    tick(1000);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1006); // the pose is six ticks old

    assert_brakes(FAULT_STALE_POSE);

    setUp();
    make_moving();
    pose(-0.01f, 0.0f, 0.0f);
    sync(1006);

    assert_fault(FAULT_STALE_WHEEL_SPEED);
}

static void test_pose_that_never_came_is_a_fault(void)
{
    make_tracking();
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1);

    assert_fault(FAULT_STALE_POSE);
}

static void test_wheel_speed_that_never_came_is_a_fault(void)
{
    make_tracking();
    pose(0.0f, 0.0f, 0.0f);
    sync(1);

    assert_fault(FAULT_STALE_WHEEL_SPEED);
}

static void test_pose_from_long_before_start_is_a_fault(void)
{
    make_ready();
    tick(1);
    tick(2);
    for (uint32_t k = 3; k < 650; k++) {
        wheel_speed(0.0f, 0.0f, 0.0f);
        sync(k);
    }
    start();
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(650);

    assert_fault(FAULT_STALE_POSE);
}

static void test_sensor_value_not_available_is_no_reading(void)
{
    for (int i = 0; i < 6; i++) {
        setUp();
        make_moving();
        for (uint32_t k = 1; k <= 5; k++) {
            pose(i == 0 ? NAN : -0.01f, i == 1 ? NAN : 0.0f, i == 2 ? NAN : 0.0f);
            wheel_speed(i == 3 ? NAN : 0.0f, i == 4 ? NAN : 0.0f, i == 5 ? NAN : 0.0f);
            sync(1000 + k);
            assert_still_tracking();
        }
        pose(-0.01f, 0.0f, 0.0f);
        wheel_speed(NAN, NAN, NAN);
        sync(1006);
        if (i < 3) {
            assert_still_tracking(); // the wheel speeds are one tick old
        } else {
            assert_fault(FAULT_STALE_WHEEL_SPEED);
        }
    }
}

static void test_sensor_value_not_available_in_idle_is_no_fault(void)
{
    pose(NAN, NAN, NAN);
    wheel_speed(NAN, NAN, NAN);
    sync(1);

    assert_no_torque();
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.torque.mode);
}

static void test_fault_keeps_the_first_cause_and_collects_the_others(void)
{
    make_ready();
    set_parameter(PARAMETER_POSE_TIMEOUT_S, 0.005f);
    start();
    tick(1000);
    for (uint32_t k = 1; k <= 6; k++) {
        sync(1000 + k); // both sensors missing
    }
    tick(1007);
    tick(1100); // what would be a gap, too

    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_POSE, got.status.fault);
    TEST_ASSERT_EQUAL_UINT16(1u << FAULT_STALE_POSE | 1u << FAULT_STALE_WHEEL_SPEED, got.status.fault_mask);
}

static void test_fault_outlives_good_data_stop_and_start(void)
{
    make_faulty();
    for (uint32_t k = 1; k < 20; k++) {
        tick(1000 + k);
        assert_no_torque();
    }
    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    start();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_POSE, got.status.fault);
}

static void test_clear_returns_from_fault_to_idle_without_causes(void)
{
    make_faulty();

    command(OPERATION_CLEAR);

    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, got.status.fault);
    TEST_ASSERT_EQUAL_UINT16(0, got.status.fault_mask);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, got.status.refusal);
    tick(1001);
    assert_no_torque();
}

static void test_clear_keeps_the_trajectory_and_start_drives_again(void)
{
    make_faulty();
    command(OPERATION_CLEAR);
    start();

    tick(1001);

    assert_still_tracking();
}

static void test_clear_while_tracking_goes_on_tracking(void)
{
    make_moving();

    command(OPERATION_CLEAR);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);

    tick(1001);
    assert_still_tracking();
}

static void test_stop_while_tracking_brakes_and_ends_in_idle_without_torque(void)
{
    make_moving();

    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.status.mode);
    tick(1001);
    assert_pushes_ahead();
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.torque.mode);

    const uint32_t last = come_to_rest(1002);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    assert_no_torque();
    // 0.5 m/s at 1.5 m/s² take a third of a second, the trajectory's 60 ms or not; then half a second at rest.
    TEST_ASSERT_UINT32_WITHIN(400, 1500, last);
}

static void make_motors_run(void);

// ---- arming

static void test_start_with_a_wrong_key_disarms(void)
{
    make_ready();
    command(OPERATION_ARM);
    TEST_ASSERT_EQUAL(1, got.challenges);
    TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, got.status.mode);

    key ^= 1u;
    command(OPERATION_START);

    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_KEY, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    key ^= 1u;
    command(OPERATION_START); // the right one is of no use any more
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
}

static void test_no_single_command_starts_motion(void)
{
    make_ready();
    for (uint32_t operation = 0; operation < 256; operation++) {
        for (uint32_t bits = 0; bits < 65536; bits += 257) {
            key = (uint16_t)bits;
            command((uint8_t)operation);
            TEST_ASSERT_FALSE(app.mode == MODE_TRACKING || app.mode == MODE_STOPPING);
            command(OPERATION_STOP); // an ARM among them stays alone
        }
    }
}

static void test_start_of_an_earlier_arming_is_refused(void)
{
    make_moving();
    const uint16_t earlier = key;
    command(OPERATION_STOP);
    (void)come_to_rest(1001);

    command(OPERATION_ARM);
    TEST_ASSERT_NOT_EQUAL(earlier, key);
    key = earlier;
    command(OPERATION_START);

    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_KEY, got.status.refusal);
}

static void test_key_is_another_for_what_was_stirred_in(void)
{
    make_ready();
    app_stir(&app, 0x12345678u);
    command(OPERATION_ARM);
    const uint16_t stirred = key;

    setUp();
    make_ready();
    command(OPERATION_ARM);

    TEST_ASSERT_NOT_EQUAL(stirred, key);
}

static void test_key_lapses_after_its_ticks(void)
{
    make_ready();
    tick(1);
    command(OPERATION_ARM);
    TEST_ASSERT_EQUAL_UINT16(APP_KEY_TICKS, got.challenge.ticks);
    tick(APP_KEY_TICKS);
    TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, app.mode);

    tick(1 + APP_KEY_TICKS);

    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
    command(OPERATION_START);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
}

static void test_key_of_a_robot_that_counts_ticks_anew_does_not_lapse_at_once(void)
{
    make_ready();
    tick(90000);
    hello(PROTOCOL_HASH); // ticks begin anew, at any number
    command(OPERATION_ARM);

    tick(3);

    TEST_ASSERT_EQUAL_UINT8(MODE_ARMED, app.mode);
}

static void test_armed_robot_takes_neither_parameters_nor_a_trajectory(void)
{
    make_ready();
    command(OPERATION_ARM);

    set_parameter(PARAMETER_ORDER, 0.0f);
    TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_IN_MOTION, got.value.result);
    begin_upload(0);
    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_IN_MOTION, got.ack.result);
}

// ---- requests that repeat

static void test_command_repeated_is_a_replay(void)
{
    make_ready();
    send_command((command_message_t){.operation = OPERATION_ARM, .counter = next_request()});
    TEST_ASSERT_EQUAL(1, got.statuses);

    send_command((command_message_t){.operation = OPERATION_ARM, .counter = requests});

    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_EQUAL_UINT16(1, app.drops.replayed);
}

static void test_command_after_two_lost_ones_is_taken_and_after_three_not(void)
{
    make_ready();
    requests = (uint8_t)(requests + 2);
    command(OPERATION_NONE);
    TEST_ASSERT_EQUAL(1, got.statuses);

    requests = (uint8_t)(requests + 3);
    command(OPERATION_NONE);
    TEST_ASSERT_EQUAL(0, got.statuses);
    TEST_ASSERT_EQUAL_UINT16(1, app.drops.replayed);

    hello(PROTOCOL_HASH); // a session begins
    command(OPERATION_NONE);
    TEST_ASSERT_EQUAL(1, got.statuses);
}

static void test_stop_is_obeyed_whatever_its_counter(void)
{
    make_moving();

    send_command((command_message_t){.operation = OPERATION_STOP, .counter = requests});

    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.status.mode);
    TEST_ASSERT_EQUAL_UINT16(1, app.drops.replayed);
}

static void test_parameter_set_and_trajectory_begin_repeated_are_replays(void)
{
    make_ready();
    set_parameter(PARAMETER_ORDER, 1.0f);
    requests = (uint8_t)(requests - 1);
    set_parameter(PARAMETER_ORDER, 2.0f);
    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 1.0f, app.parameters.value[PARAMETER_ORDER]);

    requests = (uint8_t)(requests - 1);
    begin_upload(0);
    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_EQUAL_UINT16(SEGMENTS, app.store.segment_count);
    TEST_ASSERT_EQUAL_UINT16(2, app.drops.replayed);
}

// ---- sensor frames that are not vouched for

static void send_late_sensors(uint32_t number)
{
    pose(1.0f, 1.0f, 1.0f);
    wheel_speed(9.0f, 9.0f, 9.0f);
    (void)send_pose(number);
    (void)send_wheel_speed(number);
    memset(&sensors, 0, sizeof sensors);
}

static void test_sensor_frames_of_the_tick_before_do_not_replace_those_of_this_one(void)
{
    make_moving();
    pose(-0.01f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync_message_t sync_of_tick = {.tick = 1001};
    sync_of_tick.pose_crc = send_pose(1001);
    sync_of_tick.wheel_speed_crc = send_wheel_speed(1001);
    send_late_sensors(1000);
    send_sync(sync_of_tick);
    look();

    assert_still_tracking();
    TEST_ASSERT_EQUAL_UINT32(0, app.pose.age_ticks);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, app.wheel_speed.value.x);
    TEST_ASSERT_EQUAL_UINT16(2, app.drops.replayed);
}

static void test_sensor_frames_of_another_tick_are_not_taken(void)
{
    make_moving();
    send_late_sensors(1005);
    sync(1001);

    TEST_ASSERT_EQUAL_UINT16(2, app.drops.replayed);
    TEST_ASSERT_EQUAL_UINT32(1, app.pose.age_ticks);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, app.wheel_speed.value.x);
}

static void test_sensor_frame_with_any_bit_flipped_is_not_taken(void)
{
    for (uint32_t bit = 0; bit < 64; bit++) {
        setUp();
        make_moving();
        frame_t frame[TICK_FRAMES];
        make_tick_frames(1001, frame);
        frame[0].data[bit / 8] ^= (uint8_t)(1u << bit % 8);
        frame[1].data[bit / 8] ^= (uint8_t)(1u << bit % 8);
        for (int i = 0; i < TICK_FRAMES; i++) {
            app_receive(&app, &frame[i]);
        }
        look();

        const uint16_t drops =
            (uint16_t)(app.drops.damaged + app.drops.replayed); // in the counter they are of another tick
        TEST_ASSERT_EQUAL_UINT16(2, drops);
        TEST_ASSERT_EQUAL_UINT32(1, app.pose.age_ticks);
        TEST_ASSERT_EQUAL_UINT32(1, app.wheel_speed.age_ticks);
    }
}

static void test_frames_under_the_robots_own_identifiers_are_counted(void)
{
    make_moving();
    frame_t frame;
    torque_encode(&frame, NODE, &(torque_message_t){.mode = MODE_IDLE});
    app_receive(&app, &frame);
    status_encode(&frame, NODE, &(status_message_t){0});
    app_receive(&app, &frame);

    TEST_ASSERT_EQUAL_UINT16(2, app.drops.masqueraded);
    tick(1001);
    assert_still_tracking();
    for (uint32_t k = 1002; k <= 1050; k++) {
        tick(k);
    }
    TEST_ASSERT_EQUAL(1, got.drop_reports);
    TEST_ASSERT_EQUAL_UINT16(2, got.drops.masqueraded);
}

// ---- faults: reaction, record and count

static void test_fault_is_recorded_with_its_tick_reaction_and_count(void)
{
    for (uint16_t times = 1; times <= 3; times++) {
        make_moving();
        for (uint32_t k = 1001; k <= 1006; k++) {
            pose(-0.01f, 0.0f, 0.0f);
            sync(k);
        }
        TEST_ASSERT_EQUAL(0, got.records);
        tick(1007);
        TEST_ASSERT_EQUAL(1, got.records);
        TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_WHEEL_SPEED, got.record.fault);
        TEST_ASSERT_EQUAL_UINT8(REACTION_CUT, got.record.reaction);
        TEST_ASSERT_EQUAL_UINT16(times, got.record.count);
        TEST_ASSERT_EQUAL_UINT32(1006, got.record.tick);
        for (uint32_t k = 1008; k <= 1051; k++) {
            tick(k);
            TEST_ASSERT_EQUAL(k == 1051 ? 1 : 0, got.records); // again while it is latched
        }
        command(OPERATION_CLEAR);
    }
}

static void test_error_beyond_its_limit_cuts_the_torque(void)
{
    make_moving();
    pose(-1.99f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1001);
    assert_still_tracking();
    pose(-2.01f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1002);
    assert_fault(FAULT_ERROR_LIMIT);
}

static void test_bus_off_while_driving_brakes(void)
{
    make_motors_run();
    app_note_health(&app, &(app_health_t){.can_state = CAN_STATE_ACTIVE});
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, app.mode);
    app_note_health(&app, &(app_health_t){.can_state = CAN_STATE_BUS_OFF});
    look();
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_BUS_OFF, got.status.fault);
}

static void test_bus_off_of_a_robot_at_rest_is_no_fault(void)
{
    app_note_health(&app, &(app_health_t){.can_state = CAN_STATE_BUS_OFF});
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, app.fault);
}

static void test_braking_robot_with_a_fault_that_cuts_lets_go(void)
{
    make_moving();
    command(OPERATION_STOP);
    for (uint32_t k = 1001; k <= 1006; k++) {
        pose(-0.01f, 0.0f, 0.0f);
        sync(k);
    }
    assert_fault(FAULT_STALE_WHEEL_SPEED);
}

static void test_fault_while_armed_ends_in_fault_and_not_in_motion(void)
{
    make_ready();
    command(OPERATION_ARM);
    faults_raise(&app, FAULT_HOST_SILENT);
    look();
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    command(OPERATION_START);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
}

static void test_clear_while_braking_is_refused(void)
{
    make_moving();
    command(OPERATION_STOP);
    command(OPERATION_CLEAR);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.status.mode);
}

static void test_hello_in_lockstep_ends_motion_and_elsewhere_not(void)
{
    make_moving();
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, app.mode);

    make_motors_run();
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, app.mode);
}

static void test_hello_of_another_protocol_does_not_end_motion(void)
{
    make_moving();
    hello(PROTOCOL_HASH ^ 1u);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, app.mode);
}

static void test_status_that_found_no_room_is_sent_when_there_is_some(void)
{
    make_moving();
    for (uint32_t k = 1001; k <= 1008; k++) {
        sync_only(k); // fills the outbox, and the fault comes with the sixth
    }
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, app.mode);
    for (uint32_t k = 1009; k <= 1020; k++) {
        sync_only(k);
    }
    command(OPERATION_NONE); // its STATUS finds none
    TEST_ASSERT_EQUAL(OUTBOX_FRAMES + 1, got.count);
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_WHEEL_SPEED, got.status.fault);
    TEST_ASSERT_FALSE(app.status_owed);
}

static void test_wheel_speed_that_no_wheel_has_is_none(void)
{
    make_motors_run();
    app_set_wheel_speed(&app, (vec3_t){1.0e32f, 0.0f, 0.0f});
    app_tick(&app);
    look();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, app.mode);
    TEST_ASSERT_EQUAL_UINT32(1, app.wheel_speed.age_ticks);
}

// ---- parameters that outlive a reset: in a memory of two pages that works; settings.c's own tests cut its power

enum { PAGE_BYTES = 1024 };
static uint8_t pages[SETTINGS_PAGES][PAGE_BYTES];
static bool memory_works;

static bool read_page(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length)
{
    (void)context;
    memcpy(bytes, &pages[page][offset], length);
    return true;
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
    memcpy(&pages[page][offset], bytes, memory_works ? length : 0);
    return true;
}

static const settings_memory_t memory = {
    .page_bytes = PAGE_BYTES, .read = read_page, .erase = erase_page, .program = program_page};

static void restart_with_memory(void)
{
    setUp();
    app_use_settings(&app, &memory);
    look();
}

static void make_blank_memory(void)
{
    memory_works = true;
    (void)erase_page(NULL, 0);
    (void)erase_page(NULL, 1);
    restart_with_memory();
}

static void test_first_start_has_the_defaults_and_says_so(void)
{
    make_blank_memory();
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_DEFAULTS, got.store.origin);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, app.fault);
}

static void test_saved_parameters_are_in_force_after_a_restart(void)
{
    make_blank_memory();
    set_parameter(PARAMETER_EPSILON, 0.25f);
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(1, got.store.unsaved);
    command(OPERATION_SAVE_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(0, got.store.unsaved);
    set_parameter(PARAMETER_EPSILON, 0.5f); // not saved

    restart_with_memory();

    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.25f, app.parameters.value[PARAMETER_EPSILON]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.25f * omnibot.normalised_compliance_per_N, app.control.floor.compliance_per_N);
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_KEPT, got.store.origin);
}

static void test_reset_puts_defaults_in_force_and_keeps_what_is_kept(void)
{
    make_blank_memory();
    set_parameter(PARAMETER_EPSILON, 0.25f);
    command(OPERATION_SAVE_PARAMETERS);

    command(OPERATION_RESET_PARAMETERS);

    TEST_ASSERT_EQUAL(1, got.stores);
    TEST_ASSERT_EQUAL_UINT8(1, got.store.unsaved);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.01f, app.parameters.value[PARAMETER_EPSILON]);
    restart_with_memory();
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.25f, app.parameters.value[PARAMETER_EPSILON]);
}

static void test_lost_parameters_are_a_fault_until_it_is_cleared(void)
{
    make_blank_memory();
    command(OPERATION_SAVE_PARAMETERS);
    memset(pages, 0x5A, sizeof pages);

    restart_with_memory();

    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, app.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_PARAMETERS_LOST, app.fault);
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_LOST, got.store.origin);
    command(OPERATION_CLEAR);
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, got.status.mode);
}

static void test_save_that_fails_is_refused(void)
{
    make_blank_memory();
    memory_works = false;
    set_parameter(PARAMETER_EPSILON, 0.25f);

    command(OPERATION_SAVE_PARAMETERS);

    TEST_ASSERT_EQUAL_UINT8(REFUSAL_NOT_SAVED, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(1, got.store.unsaved);
}

static void test_save_without_a_memory_is_refused_unable(void)
{
    command(OPERATION_SAVE_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_UNABLE, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(ORIGIN_NO_MEMORY, got.store.origin);
}

static void test_save_and_reset_in_motion_are_refused(void)
{
    make_moving();
    command(OPERATION_SAVE_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
    command(OPERATION_RESET_PARAMETERS);
    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
}

// ---- frames that are not for us, or damaged

static void test_frames_of_other_nodes_are_ignored(void)
{
    make_moving();
    for (uint8_t node = 0; node < FRAME_NODE_COUNT; node++) {
        if (node != NODE) {
            frame_t frame;
            command_encode(&frame, node, &(command_message_t){.operation = OPERATION_STOP});
            app_receive(&app, &frame);
            sync_encode(&frame, node, &(sync_message_t){.tick = 2000});
            app_receive(&app, &frame);
            pose_encode(&frame, node, &(pose_message_t){5.0f, 5.0f, 1.0f, 0});
            app_receive(&app, &frame);
            hello_encode(&frame, node, &(hello_message_t){0});
            app_receive(&app, &frame);
        }
    }
    look();
    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_EQUAL_UINT16(0, app.drops.damaged);

    tick(1001);
    assert_still_tracking();
}

static void test_frames_of_functions_that_the_robot_does_not_take_are_ignored(void)
{
    for (uint16_t function = 0; function < 128; function++) {
        static const uint16_t taken[] = {1, 2, 3, 4, 32, 33, 48, 49, 64};
        bool known = false;
        for (size_t i = 0; i < sizeof taken / sizeof taken[0]; i++) {
            known = known || function == taken[i];
        }
        if (!known) {
            const frame_t frame = {.id = (uint16_t)(function << FRAME_NODE_BITS | NODE), .length = 8};
            app_receive(&app, &frame);
        }
    }
    look();
    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_EQUAL_UINT16(0, app.drops.damaged);
}

static void test_frames_of_a_wrong_length_are_counted_and_do_nothing(void)
{
    static const uint16_t taken[] = {1, 2, 3, 4, 32, 33, 48, 49, 64};
    make_moving();
    const app_t before = app;
    for (uint16_t i = 0; i < 9; i++) {
        const frame_t frame = {.id = (uint16_t)(taken[i] << FRAME_NODE_BITS | NODE), .length = 0};
        app_receive(&app, &frame);

        TEST_ASSERT_EQUAL_UINT16(i + 1, app.drops.damaged);
    }
    app.drops = before.drops;
    TEST_ASSERT_EQUAL_MEMORY(&before, &app, sizeof app);
}

static void test_frames_with_a_wrong_crc_are_counted_and_do_nothing(void)
{
    make_moving();
    const app_t before = app;
    frame_t frame;
    sync_encode(&frame, NODE, &(sync_message_t){.tick = 1001});
    frame.data[0] ^= 0x40; // another tick
    app_receive(&app, &frame);
    command_encode(&frame, NODE, &(command_message_t){.operation = OPERATION_CLEAR});
    frame.data[0] ^= 1u; // STOP
    app_receive(&app, &frame);
    parameter_set_encode(&frame, NODE, &(parameter_set_message_t){.index = 0, .value = 0.0f});
    frame.data[4] ^= 0x80;
    app_receive(&app, &frame);

    TEST_ASSERT_EQUAL_UINT16(3, app.drops.damaged);
    app.drops = before.drops;
    TEST_ASSERT_EQUAL_MEMORY(&before, &app, sizeof app);
}

static void test_count_of_damaged_frames_stops_at_its_largest_value(void)
{
    const frame_t frame = {.id = SYNC_FUNCTION << FRAME_NODE_BITS | NODE, .length = 1};
    for (uint32_t i = 0; i < 70000; i++) {
        app_receive(&app, &frame);
    }

    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, app.drops.damaged);
    command(OPERATION_STOP);
    TEST_ASSERT_EQUAL_UINT16(UINT16_MAX, got.status.dropped_frames);
}

// ---- parameters

static void assert_value(uint8_t index, uint8_t result, float value)
{
    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL(1, got.values);
    TEST_ASSERT_EQUAL_UINT8(index, got.value.index);
    TEST_ASSERT_EQUAL_UINT8(result, got.value.result);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, value, got.value.value);
}

static void test_parameter_get_gives_the_default(void)
{
    get_parameter(PARAMETER_FORCE_BOUND_N);
    assert_value(PARAMETER_FORCE_BOUND_N, PARAMETER_VALUE_RESULT_OK, 3.5f);
}

static void test_parameter_get_of_an_unknown_index_gives_nan(void)
{
    get_parameter(PARAMETER_COUNT);
    assert_value(PARAMETER_COUNT, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX, NAN);
    get_parameter(255);
    assert_value(255, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX, NAN);
}

static void test_parameter_set_in_idle_is_taken_and_kept(void)
{
    set_parameter(PARAMETER_EPSILON, 0.125f);
    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_OK, 0.125f);

    get_parameter(PARAMETER_EPSILON);
    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_OK, 0.125f);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.125f, app.control.floor.compliance_per_N);
}

static void test_parameter_set_reaches_the_torque(void)
{
    set_parameter(PARAMETER_TORQUE_BOUND_NM, 0.002f);
    make_moving();

    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.002f, got.torque.wheel3_Nm);
}

static void test_parameter_set_out_of_range_answers_the_value_in_force(void)
{
    set_parameter(PARAMETER_EPSILON, 2.0f);
    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_OUT_OF_RANGE, 0.01f);
    set_parameter(PARAMETER_EPSILON, NAN);
    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_OUT_OF_RANGE, 0.01f);
}

static void test_parameter_set_of_an_unknown_index_is_refused(void)
{
    set_parameter(PARAMETER_COUNT, 0.5f);
    assert_value(PARAMETER_COUNT, PARAMETER_VALUE_RESULT_UNKNOWN_INDEX, NAN);
}

static void test_parameter_set_in_motion_is_refused_and_changes_nothing(void)
{
    make_moving();
    const control_params_t before = app.control;

    set_parameter(PARAMETER_EPSILON, 0.5f);

    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_IN_MOTION, 0.01f);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, before.floor.compliance_per_N, app.control.floor.compliance_per_N);
    get_parameter(PARAMETER_EPSILON);
    assert_value(PARAMETER_EPSILON, PARAMETER_VALUE_RESULT_OK, 0.01f);
}

// ---- uploads

static void test_upload_of_a_wrong_crc_leaves_no_trajectory(void)
{
    hello(PROTOCOL_HASH);
    make_upload();
    begin_upload(crc32_bitwise(upload, UPLOAD_BYTES) + 1u);
    for (uint16_t offset = 0; offset < UPLOAD_BYTES; offset += 6) {
        send_data(offset);
    }

    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_WRONG_CRC, got.ack.result);
    assert_start_refused(REFUSAL_NO_TRAJECTORY, MODE_IDLE);
}

static void test_upload_is_acknowledged_every_16_frames_with_the_next_offset(void)
{
    make_upload();
    begin_upload(crc32_bitwise(upload, UPLOAD_BYTES));
    for (uint16_t frame = 1; frame < UPLOAD_BYTES / 6; frame++) {
        send_data((uint16_t)(6 * (frame - 1)));

        TEST_ASSERT_EQUAL(frame % 16 == 0 ? 1 : 0, got.count);
        if (got.acks > 0) {
            TEST_ASSERT_EQUAL_UINT16(6 * frame, got.ack.offset_bytes);
        }
    }
}

static void test_upload_behind_a_gap_is_told_the_offset_to_go_on_from(void)
{
    make_upload();
    begin_upload(crc32_bitwise(upload, UPLOAD_BYTES));
    send_data(0);
    send_data(12);

    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_WRONG_OFFSET, got.ack.result);
    TEST_ASSERT_EQUAL_UINT16(6, got.ack.offset_bytes);
}

static void test_upload_in_motion_is_refused_and_the_running_trajectory_untouched(void)
{
    make_moving();
    const store_t before = app.store;
    upload[4] ^= 0xFF;

    begin_upload(crc32_bitwise(upload, UPLOAD_BYTES));
    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_IN_MOTION, got.ack.result);
    send_data(0);
    TEST_ASSERT_EQUAL(1, got.count);
    TEST_ASSERT_EQUAL_UINT8(TRAJECTORY_ACK_RESULT_IN_MOTION, got.ack.result);

    TEST_ASSERT_EQUAL_MEMORY(&before, &app.store, sizeof before);
    tick(1001);
    assert_still_tracking();
    assert_cursor(0, 1000);
}

static void test_upload_in_fault_is_taken(void)
{
    make_faulty();
    upload_trajectory();
    command(OPERATION_CLEAR);
    start();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
}

// ---- the outbox

static void test_outbox_full_counts_what_is_lost_and_keeps_the_first(void)
{
    for (uint32_t k = 1; k <= 20; k++) {
        sync_only(k); // two frames each, sixteen fit
    }
    look();

    TEST_ASSERT_EQUAL(OUTBOX_FRAMES, got.count);
    TEST_ASSERT_EQUAL_UINT16(2 * 20 - OUTBOX_FRAMES, app.drops.unsent);
    for (uint8_t i = 0; i < OUTBOX_FRAMES; i++) {
        torque_message_t torque;
        if (i % 2 == 0) {
            TEST_ASSERT_EQUAL(DECODE_OK, torque_decode(&torque, &got.frame[i]));
            TEST_ASSERT_EQUAL_UINT8((1 + i / 2) & 0xF, torque.counter);
        }
    }
    sync(21);
    TEST_ASSERT_EQUAL(2, got.count);
}

static void test_outbox_keeps_the_order_over_its_end(void)
{
    for (uint32_t k = 1; k <= 50; k++) {
        sync_only(2 * k);
        sync_only(2 * k + 1);
        look();

        const int others = k == 25 || k == 50 ? 1 : 0; // DROPS at tick 50, STATUS at tick 100, after their answers
        TEST_ASSERT_EQUAL(4 + others, got.count);
        TEST_ASSERT_EQUAL_UINT16(TORQUE_FUNCTION << FRAME_NODE_BITS | NODE, got.frame[0].id);
        TEST_ASSERT_EQUAL_UINT16(SLIP_FUNCTION << FRAME_NODE_BITS | NODE, got.frame[1].id);
        TEST_ASSERT_EQUAL_UINT8((2 * k + 1) & 0xFu, got.torque.counter);
    }
}

static void test_transmit_of_nothing_is_false(void)
{
    frame_t frame;
    TEST_ASSERT_FALSE(app_transmit(&app, &frame));
}

// ---- several robots

static void test_two_instances_on_one_bus_are_independent(void)
{
    static app_t other;
    app_init(&other, &omnibot, NODE + 1, lockstep_only);
    frame_t frame;
    while (app_transmit(&other, &frame)) {
    }
    make_moving();
    const app_t untouched = other;

    // Every frame reaches both.
    for (uint32_t k = 1; k <= 20; k++) {
        frame_t of_tick[TICK_FRAMES];
        make_tick_frames(1000 + k, of_tick);
        for (int i = 0; i < TICK_FRAMES; i++) {
            app_receive(&app, &of_tick[i]);
            app_receive(&other, &of_tick[i]);
        }
        look();
        assert_still_tracking();
    }
    TEST_ASSERT_EQUAL_MEMORY(&untouched, &other, sizeof other);

    sync_encode(&frame, NODE + 1, &(sync_message_t){.tick = 5});
    app_receive(&app, &frame);
    app_receive(&other, &frame);
    look();
    TEST_ASSERT_EQUAL(0, got.count);
    TEST_ASSERT_TRUE(app_transmit(&other, &frame));
    TEST_ASSERT_EQUAL_UINT16(TORQUE_FUNCTION << FRAME_NODE_BITS | (NODE + 1), frame.id);
    torque_message_t torque;
    TEST_ASSERT_EQUAL(DECODE_OK, torque_decode(&torque, &frame));
    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, torque.mode);
}

static void test_two_instances_with_the_same_frames_give_the_same_bytes(void)
{
    static app_t other;
    make_moving();
    other = app;
    for (uint32_t k = 1; k <= 100; k++) {
        tick(1000 + k);
        const frame_t torque = got.torque_frame;
        frame_t frame, of_tick[TICK_FRAMES];
        make_tick_frames(1000 + k, of_tick);
        for (int i = 0; i < TICK_FRAMES; i++) {
            app_receive(&other, &of_tick[i]);
        }
        TEST_ASSERT_TRUE(app_transmit(&other, &frame));
        TEST_ASSERT_EQUAL_HEX8_ARRAY(torque.data, frame.data, 8);
        while (app_transmit(&other, &frame)) {
        }
    }
}

// ---- drives: what paces and moves the robot

static const app_port_t board = {
    .drives = 1u << DRIVE_LOCKSTEP | 1u << DRIVE_REALTIME | 1u << DRIVE_MOTORS,
    .drive = DRIVE_MOTORS,
};

/// A period by the port's timer, with fresh sensors and a host that is there.
static void timer_tick(void)
{
    pose(-0.01f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync_only(++host_tick);
    app_set_wheel_speed(&app, (vec3_t){0}); // where it has encoders
    app_tick(&app);
    look();
}

/// A board that drives with sensors from the bus, by its own timer; its first tick is done.
static void make_realtime(void)
{
    app_init(&app, &omnibot, NODE, board);
    look();
    command(OPERATION_USE_REALTIME);
    make_ready();
    timer_tick();
    start();
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
    timer_tick();
    assert_pushes_ahead();
}

/// A board that drives its own motors; the wheels stand still.
static void make_motors_run(void)
{
    app_init(&app, &omnibot, NODE, board);
    look();
    make_ready();
    app_set_wheel_speed(&app, (vec3_t){0});
    timer_tick();
    start();
    app_set_wheel_speed(&app, (vec3_t){0});
    timer_tick();
    assert_pushes_ahead();
}

static uint8_t drive_told(void)
{
    hello(PROTOCOL_HASH);
    TEST_ASSERT_EQUAL(1, got.identities);
    return got.identity.drive;
}

static void test_use_of_a_drive_that_the_port_lacks_is_refused(void)
{
    static const uint8_t lacking[] = {OPERATION_USE_REALTIME, OPERATION_USE_MOTORS};
    for (size_t i = 0; i < sizeof lacking; i++) {
        command(lacking[i]);

        TEST_ASSERT_EQUAL_UINT8(REFUSAL_UNABLE, got.status.refusal);
        TEST_ASSERT_EQUAL_UINT8(DRIVE_LOCKSTEP, drive_told());
    }
}

static void test_use_changes_the_drive_that_identity_tells(void)
{
    static const uint8_t operation[] = {OPERATION_USE_LOCKSTEP, OPERATION_USE_REALTIME, OPERATION_USE_MOTORS};
    static const uint8_t drive[] = {DRIVE_LOCKSTEP, DRIVE_REALTIME, DRIVE_MOTORS};
    app_init(&app, &omnibot, NODE, board);
    look();
    TEST_ASSERT_EQUAL_UINT8(DRIVE_MOTORS, drive_told());
    for (size_t i = 0; i < sizeof drive; i++) {
        command(operation[i]);

        TEST_ASSERT_EQUAL_UINT8(REFUSAL_NONE, got.status.refusal);
        TEST_ASSERT_EQUAL_UINT8(drive[i], drive_told());
    }
}

static void test_use_of_another_drive_while_tracking_is_refused(void)
{
    make_motors_run();

    command(OPERATION_USE_REALTIME);

    TEST_ASSERT_EQUAL_UINT8(REFUSAL_WRONG_MODE, got.status.refusal);
    TEST_ASSERT_EQUAL_UINT8(DRIVE_MOTORS, drive_told());
    vec3_t torque;
    TEST_ASSERT_TRUE(app_motor_torque(&app, &torque));
}

static void test_timer_tick_in_lockstep_does_nothing(void)
{
    make_moving();

    app_tick(&app);
    look();

    TEST_ASSERT_EQUAL(0, got.count);
    assert_cursor(0, 0);
}

static void test_sync_in_real_time_steps_nothing(void)
{
    make_realtime();

    sync(500);

    TEST_ASSERT_EQUAL(0, got.count);
    assert_cursor(0, 0);
}

static void test_timer_tick_answers_with_the_last_sync(void)
{
    make_realtime();
    sync_only(0x123);

    app_tick(&app);
    look();

    TEST_ASSERT_EQUAL_UINT8(3, got.torque.counter);
    TEST_ASSERT_EQUAL_UINT8(3, got.slip.counter);
    assert_cursor(0, 1000);
}

static void test_timer_tick_without_a_host_is_not_answered(void)
{
    app_init(&app, &omnibot, NODE, board);
    look();

    for (int i = 0; i < 3; i++) {
        app_tick(&app);
        look();

        TEST_ASSERT_EQUAL(0, got.torques);
        TEST_ASSERT_EQUAL(i == 0 ? 1 : 0, got.statuses); // tick 0 is a multiple of a hundred
    }
}

static void test_overrun_moves_the_reference_on_and_is_counted(void)
{
    make_realtime();
    app_note_overrun(&app, 4);

    timer_tick();

    assert_still_tracking();
    assert_cursor(0, 5000);
    TEST_ASSERT_EQUAL_UINT16(4, app.missed_ticks);
    TEST_ASSERT_EQUAL_UINT16(4, app.overruns);
}

static void test_overruns_with_ticks_on_time_between_them_are_borne(void)
{
    make_realtime();
    for (int i = 0; i < 3; i++) {
        app_note_overrun(&app, TICK_GAP_MAX);
        timer_tick();
        assert_still_tracking();
        timer_tick();
        assert_still_tracking();
    }
    TEST_ASSERT_EQUAL_UINT16(3 * TICK_GAP_MAX, app.overruns);
}

static void test_a_run_of_overruns_is_a_fault(void)
{
    make_realtime();
    for (int i = 0; i < TICK_GAP_MAX; i++) {
        app_note_overrun(&app, 1);
        timer_tick();
        assert_still_tracking();
    }
    app_note_overrun(&app, 1);
    timer_tick();

    assert_fault(FAULT_OVERRUN);
}

static void test_one_overrun_too_long_is_a_fault(void)
{
    make_realtime();
    app_note_overrun(&app, TICK_GAP_MAX + 1);

    timer_tick();

    assert_fault(FAULT_OVERRUN);
}

/// A period by the timer with wheel speeds that stand, and nothing from the host.
static void timer_tick_alone(void)
{
    app_set_wheel_speed(&app, (vec3_t){0});
    app_tick(&app);
    look();
}

static void test_host_silent_for_more_than_a_tenth_of_a_second_is_a_fault(void)
{
    make_motors_run();
    for (int i = 1; i < APP_HEARTBEAT_TICKS_MAX; i++) {
        timer_tick_alone();
        assert_still_tracking();
    }
    timer_tick_alone();

    TEST_ASSERT_EQUAL_UINT8(MODE_STOPPING, got.torque.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_HOST_SILENT, got.status.fault);
    for (int i = 0; i < REST_TICKS_MAX && app.mode == MODE_STOPPING; i++) {
        timer_tick_alone();
    }
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, app.mode);
    timer_tick_alone();
    TEST_ASSERT_EQUAL(0, got.torques); // there is nobody to tell
}

static void test_motors_get_the_torque_of_the_last_step_while_driving_only(void)
{
    vec3_t torque;
    make_motors_run();

    TEST_ASSERT_TRUE(app_motor_torque(&app, &torque));
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, got.torque.wheel1_Nm, torque.x);
    TEST_ASSERT_FLOAT_WITHIN(1.0e-5f, got.torque.wheel3_Nm, torque.z);

    command(OPERATION_STOP);
    TEST_ASSERT_TRUE(app_motor_torque(&app, &torque));
    for (int i = 0; i < REST_TICKS_MAX && app.mode == MODE_STOPPING; i++) {
        timer_tick();
    }

    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, app.mode);
    TEST_ASSERT_FALSE(app_motor_torque(&app, &torque));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(torque));
}

static void test_motors_that_cannot_give_the_torque_are_a_fault(void)
{
    static const uint8_t faults[] = {FAULT_SUPPLY, FAULT_BRIDGE};
    for (size_t i = 0; i < sizeof faults; i++) {
        vec3_t torque;
        make_motors_run();

        app_note_motor_fault(&app, faults[i]);
        look();

        TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.status.mode);
        TEST_ASSERT_EQUAL_UINT8(faults[i], got.status.fault);
        TEST_ASSERT_FALSE(app_motor_torque(&app, &torque));
    }
}

static void test_motors_that_nobody_drives_are_no_fault(void)
{
    make_realtime();
    app_note_motor_fault(&app, FAULT_SUPPLY);
    assert_still_tracking();

    app_init(&app, &omnibot, NODE, board);
    app_note_motor_fault(&app, FAULT_SUPPLY);

    TEST_ASSERT_EQUAL_UINT8(MODE_IDLE, app.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_NONE, app.fault);
}

static void test_motors_get_no_torque_of_the_drive_before_after_start(void)
{
    vec3_t torque;
    make_motors_run();
    command(OPERATION_STOP);
    for (int i = 0; i < REST_TICKS_MAX && app.mode == MODE_STOPPING; i++) {
        timer_tick();
    }
    set_parameter(PARAMETER_TORQUE_BOUND_NM, 0.001f);

    start();

    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.status.mode);
    (void)app_motor_torque(&app, &torque);
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(torque));
}

static void test_bus_drives_never_enable_the_motors(void)
{
    vec3_t torque = {1.0f, 1.0f, 1.0f};
    make_realtime();

    TEST_ASSERT_FALSE(app_motor_torque(&app, &torque));
    TEST_ASSERT_FLOAT_WITHIN(0.0f, 0.0f, vec3_max_abs(torque));
}

static void test_wheel_speeds_of_the_bus_are_not_taken_by_a_robot_with_motors(void)
{
    make_motors_run();
    for (int i = 0; i < 6; i++) {
        wheel_speed(0.0f, 0.0f, 0.0f); // by the bus alone
        sync_only(++host_tick);
        app_tick(&app);
        look();
    }
    TEST_ASSERT_EQUAL_UINT8(MODE_FAULT, got.torque.mode);
    TEST_ASSERT_EQUAL_UINT8(FAULT_STALE_WHEEL_SPEED, app.fault);
}

static void test_wheel_speeds_of_the_port_are_not_taken_without_motors(void)
{
    make_moving();
    app_set_wheel_speed(&app, (vec3_t){50.0f, 50.0f, 50.0f});

    tick(1001);

    assert_pushes_ahead(); // as with wheels that stand still
}

// ---- what the port tells of itself

static void test_step_times_are_reported_every_hundred_ticks_and_start_anew(void)
{
    make_realtime();
    app_note_step_time(&app, 7000);
    app_note_step_time(&app, 9000);
    app_note_step_time(&app, 20000);
    app_note_overrun(&app, 2);
    while (app.tick != 99) {
        timer_tick();
        TEST_ASSERT_EQUAL(0, got.timings);
    }
    timer_tick();

    TEST_ASSERT_EQUAL(1, got.timings);
    TEST_ASSERT_FLOAT_WITHIN(0.051f, 7.0f, got.timing.step_min_us);
    TEST_ASSERT_FLOAT_WITHIN(0.051f, 12.0f, got.timing.step_mean_us);
    TEST_ASSERT_FLOAT_WITHIN(0.051f, 20.0f, got.timing.step_max_us);
    TEST_ASSERT_EQUAL_UINT16(2, got.timing.overruns);
    TEST_ASSERT_EQUAL_UINT32(0, app.step_times.count);
}

static void test_port_without_measurements_reports_none(void)
{
    make_realtime();
    while (app.tick != 100) {
        timer_tick();
        TEST_ASSERT_EQUAL(0, got.timings + got.healths + got.crashes);
    }
}

static void test_health_and_crash_are_reported_the_crash_once(void)
{
    const app_health_t health = {RESET_CAUSE_CRASH, CLOCK_SOURCE_HSI_PLL, CAN_STATE_PASSIVE, 130, 5, 2, 9, 11.1f};
    app_init(&app, &omnibot, NODE, board);
    app_note_health(&app, &health);
    app_note_crash(&app, 0x08001234u, 0x08005679u);
    look();

    app_tick(&app);
    look();

    TEST_ASSERT_EQUAL(1, got.healths);
    TEST_ASSERT_EQUAL_UINT8(RESET_CAUSE_CRASH, got.health.reset_cause);
    TEST_ASSERT_EQUAL_UINT8(CLOCK_SOURCE_HSI_PLL, got.health.clock_source);
    TEST_ASSERT_EQUAL_UINT8(CAN_STATE_PASSIVE, got.health.can_state);
    TEST_ASSERT_EQUAL_UINT8(0, got.health.bridges);
    TEST_ASSERT_EQUAL_UINT8(130, got.health.can_tx_errors);
    TEST_ASSERT_EQUAL_UINT8(5, got.health.can_rx_errors);
    TEST_ASSERT_EQUAL_UINT8(2, got.health.can_bus_offs);
    TEST_ASSERT_EQUAL_UINT8(9, got.health.can_rx_lost);
    TEST_ASSERT_FLOAT_WITHIN(0.0006f, 11.1f, got.health.supply_V);
    TEST_ASSERT_EQUAL(1, got.crashes);
    TEST_ASSERT_EQUAL_HEX32(0x08001234u, got.crash.pc);
    TEST_ASSERT_EQUAL_HEX32(0x08005679u, got.crash.lr);

    for (int i = 0; i < 100; i++) {
        app_tick(&app);
        look();
    }
    TEST_ASSERT_EQUAL(1, got.healths);
    TEST_ASSERT_EQUAL(0, got.crashes);
}

// ---- how soon each fault is found

/// Each makes the cause of a fault be there in the ticks from 1 on, after a good tick 0, one tick a call.
static void lack_pose(uint32_t k)
{
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1000 + k);
}

static void lack_wheel_speed(uint32_t k)
{
    pose(-0.01f, 0.0f, 0.0f);
    sync(1000 + k);
}

/// Nothing comes of the ticks before; the one that ends the gap counts those that are missing, not itself.
static void end_a_gap(uint32_t k)
{
    const app_t before = app;
    tick(1000 + k + 1);
    if (app.fault == FAULT_NONE) {
        app = before;
    }
}

static void overrun_by(uint32_t k)
{
    const app_t before = app;
    app_note_overrun(&app, k);
    timer_tick();
    if (app.fault == FAULT_NONE) {
        app = before;
    }
}

static void fall_silent(uint32_t k)
{
    (void)k;
    timer_tick_alone();
}

static void sink_supply(uint32_t k)
{
    (void)k;
    app_note_motor_fault(&app, FAULT_SUPPLY);
}

static void trip_bridge(uint32_t k)
{
    (void)k;
    app_note_motor_fault(&app, FAULT_BRIDGE);
}

static void stray(uint32_t k)
{
    pose(-3.0f, 0.0f, 0.0f);
    wheel_speed(0.0f, 0.0f, 0.0f);
    sync(1000 + k);
}

static void go_bus_off(uint32_t k)
{
    (void)k;
    app_note_health(&app, &(app_health_t){.can_state = CAN_STATE_BUS_OFF});
}

/// Gains and a segment as large as they may be are more than single precision holds.
static void make_endless(uint32_t k)
{
    app.store.segment[0].coefficient[0][7] = INFINITY; // no upload can do this
    tick(1000 + k);
}

static void lose_parameters(uint32_t k)
{
    (void)k;
    memset(pages, 0x5A, sizeof pages);
    app_use_settings(&app, &memory);
}

static void test_each_fault_is_found_after_the_ticks_that_its_table_says(void)
{
    static const struct {
        void (*make)(void);
        void (*cause)(uint32_t k);
    } of_fault[FAULT_COUNT] = {
        [FAULT_STALE_POSE] = {make_moving, lack_pose},
        [FAULT_STALE_WHEEL_SPEED] = {make_moving, lack_wheel_speed},
        [FAULT_TICK_GAP] = {make_moving, end_a_gap},
        [FAULT_NOT_FINITE] = {make_moving, make_endless},
        [FAULT_OVERRUN] = {make_realtime, overrun_by},
        [FAULT_HOST_SILENT] = {make_motors_run, fall_silent},
        [FAULT_SUPPLY] = {make_motors_run, sink_supply},
        [FAULT_BRIDGE] = {make_motors_run, trip_bridge},
        [FAULT_ERROR_LIMIT] = {make_moving, stray},
        [FAULT_BUS_OFF] = {make_motors_run, go_bus_off},
        [FAULT_PARAMETERS_LOST] = {make_ready, lose_parameters},
    };
    for (uint8_t fault = 1; fault < FAULT_COUNT; fault++) {
        setUp();
        of_fault[fault].make();
        uint32_t ticks = 0;
        while (app.fault == FAULT_NONE && ticks < 1000) {
            of_fault[fault].cause(++ticks);
        }
        TEST_ASSERT_EQUAL_UINT8(fault, app.fault);
        const bool brakes = fault_table[fault].reaction == REACTION_BRAKE;
        TEST_ASSERT_EQUAL_UINT8(brakes ? MODE_STOPPING : MODE_FAULT, app.mode);
        TEST_ASSERT_EQUAL_UINT32(fault_table[fault].detection_ticks, ticks - (fault_table[fault].detection_ticks == 0));
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_init_is_idle_and_says_so);
    RUN_TEST(test_init_over_an_old_instance_forgets_everything);
    RUN_TEST(test_hello_with_our_hash_is_answered_by_a_matching_identity);
    RUN_TEST(test_hello_with_another_hash_is_answered_by_ours_and_no_match);
    RUN_TEST(test_start_without_hello_is_refused_unknown_peer);
    RUN_TEST(test_start_after_a_wrong_hash_is_refused_unknown_peer);
    RUN_TEST(test_start_after_a_right_and_then_a_wrong_hash_is_refused_unknown_peer);
    RUN_TEST(test_start_without_a_trajectory_is_refused);
    RUN_TEST(test_start_during_an_upload_is_refused_no_trajectory);
    RUN_TEST(test_start_while_tracking_is_refused_wrong_mode);
    RUN_TEST(test_start_in_fault_is_refused_wrong_mode);
    RUN_TEST(test_start_when_ready_tracks);
    RUN_TEST(test_command_of_any_kind_is_answered_by_one_status_alone);
    RUN_TEST(test_start_taken_after_a_refusal_no_longer_shows_it_in_any_status);
    RUN_TEST(test_start_takes_any_tick_number_as_the_first);
    RUN_TEST(test_start_between_two_syncs_of_one_tick_steps_it_anew);
    RUN_TEST(test_start_after_stop_begins_the_trajectory_again);
    RUN_TEST(test_unknown_operations_are_refused);
    RUN_TEST(test_sync_in_every_mode_is_answered_by_one_torque_and_one_slip);
    RUN_TEST(test_sync_in_idle_and_fault_gives_no_torque);
    RUN_TEST(test_sync_in_idle_without_sensors_is_no_fault);
    RUN_TEST(test_sync_while_tracking_gives_the_torque_of_the_control_step);
    RUN_TEST(test_sync_steps_walk_over_the_joints_and_rest_at_the_end);
    RUN_TEST(test_sync_repeated_gets_the_same_bytes_and_no_second_step);
    RUN_TEST(test_sync_repeated_after_a_fault_gives_no_torque);
    RUN_TEST(test_sync_repeated_after_stop_gives_the_same_bytes);
    RUN_TEST(test_sync_repeated_in_fault_gives_the_same_bytes);
    RUN_TEST(test_sync_going_back_while_tracking_is_a_replay_and_not_answered);
    RUN_TEST(test_sync_going_back_in_idle_is_a_host_that_begins_anew);
    RUN_TEST(test_sync_going_back_in_fault_stays_in_fault);
    RUN_TEST(test_sync_at_the_largest_tick_is_a_tick_like_any_other);
    RUN_TEST(test_sync_wrapping_to_zero_goes_on);
    RUN_TEST(test_status_comes_every_hundredth_tick);
    RUN_TEST(test_gap_small_moves_the_trajectory_by_it_and_is_counted);
    RUN_TEST(test_gap_as_long_as_allowed_is_no_fault);
    RUN_TEST(test_gap_just_too_long_is_a_fault);
    RUN_TEST(test_gap_of_the_largest_size_is_a_fault_and_its_count_saturates);
    RUN_TEST(test_gaps_in_idle_are_not_counted);
    RUN_TEST(test_gaps_add_up_and_start_forgets_them);
    RUN_TEST(test_pose_missing_until_its_timeout_is_borne_and_then_a_fault);
    RUN_TEST(test_pose_timeout_may_be_set);
    RUN_TEST(test_pose_timeout_of_zero_is_a_fault_at_the_first_tick_without_a_pose);
    RUN_TEST(test_pose_missing_is_dead_reckoned_from_the_wheels);
    RUN_TEST(test_pose_that_comes_again_replaces_the_dead_reckoned_one);
    RUN_TEST(test_start_forgets_the_state_of_the_last_drive);
    RUN_TEST(test_start_does_not_drive_on_what_was_read_before_it);
    RUN_TEST(test_missed_ticks_move_the_dead_reckoned_pose_as_far_as_driven_ones);
    RUN_TEST(test_wheel_speed_missing_for_five_ticks_is_borne_and_for_six_a_fault);
    RUN_TEST(test_sensor_data_after_five_missing_ticks_are_fresh_again);
    RUN_TEST(test_ticks_lost_in_a_gap_make_sensor_data_older);
    RUN_TEST(test_pose_that_never_came_is_a_fault);
    RUN_TEST(test_wheel_speed_that_never_came_is_a_fault);
    RUN_TEST(test_pose_from_long_before_start_is_a_fault);
    RUN_TEST(test_sensor_value_not_available_is_no_reading);
    RUN_TEST(test_sensor_value_not_available_in_idle_is_no_fault);
    RUN_TEST(test_fault_keeps_the_first_cause_and_collects_the_others);
    RUN_TEST(test_fault_outlives_good_data_stop_and_start);
    RUN_TEST(test_clear_returns_from_fault_to_idle_without_causes);
    RUN_TEST(test_clear_keeps_the_trajectory_and_start_drives_again);
    RUN_TEST(test_clear_while_tracking_goes_on_tracking);
    RUN_TEST(test_stop_while_tracking_brakes_and_ends_in_idle_without_torque);
    RUN_TEST(test_start_with_a_wrong_key_disarms);
    RUN_TEST(test_no_single_command_starts_motion);
    RUN_TEST(test_start_of_an_earlier_arming_is_refused);
    RUN_TEST(test_key_is_another_for_what_was_stirred_in);
    RUN_TEST(test_key_lapses_after_its_ticks);
    RUN_TEST(test_key_of_a_robot_that_counts_ticks_anew_does_not_lapse_at_once);
    RUN_TEST(test_armed_robot_takes_neither_parameters_nor_a_trajectory);
    RUN_TEST(test_command_repeated_is_a_replay);
    RUN_TEST(test_command_after_two_lost_ones_is_taken_and_after_three_not);
    RUN_TEST(test_stop_is_obeyed_whatever_its_counter);
    RUN_TEST(test_parameter_set_and_trajectory_begin_repeated_are_replays);
    RUN_TEST(test_sensor_frames_of_the_tick_before_do_not_replace_those_of_this_one);
    RUN_TEST(test_sensor_frames_of_another_tick_are_not_taken);
    RUN_TEST(test_sensor_frame_with_any_bit_flipped_is_not_taken);
    RUN_TEST(test_frames_under_the_robots_own_identifiers_are_counted);
    RUN_TEST(test_fault_is_recorded_with_its_tick_reaction_and_count);
    RUN_TEST(test_each_fault_is_found_after_the_ticks_that_its_table_says);
    RUN_TEST(test_error_beyond_its_limit_cuts_the_torque);
    RUN_TEST(test_bus_off_while_driving_brakes);
    RUN_TEST(test_bus_off_of_a_robot_at_rest_is_no_fault);
    RUN_TEST(test_braking_robot_with_a_fault_that_cuts_lets_go);
    RUN_TEST(test_fault_while_armed_ends_in_fault_and_not_in_motion);
    RUN_TEST(test_clear_while_braking_is_refused);
    RUN_TEST(test_hello_in_lockstep_ends_motion_and_elsewhere_not);
    RUN_TEST(test_hello_of_another_protocol_does_not_end_motion);
    RUN_TEST(test_status_that_found_no_room_is_sent_when_there_is_some);
    RUN_TEST(test_wheel_speed_that_no_wheel_has_is_none);
    RUN_TEST(test_first_start_has_the_defaults_and_says_so);
    RUN_TEST(test_saved_parameters_are_in_force_after_a_restart);
    RUN_TEST(test_reset_puts_defaults_in_force_and_keeps_what_is_kept);
    RUN_TEST(test_lost_parameters_are_a_fault_until_it_is_cleared);
    RUN_TEST(test_save_that_fails_is_refused);
    RUN_TEST(test_save_without_a_memory_is_refused_unable);
    RUN_TEST(test_save_and_reset_in_motion_are_refused);
    RUN_TEST(test_frames_of_other_nodes_are_ignored);
    RUN_TEST(test_frames_of_functions_that_the_robot_does_not_take_are_ignored);
    RUN_TEST(test_frames_of_a_wrong_length_are_counted_and_do_nothing);
    RUN_TEST(test_frames_with_a_wrong_crc_are_counted_and_do_nothing);
    RUN_TEST(test_count_of_damaged_frames_stops_at_its_largest_value);
    RUN_TEST(test_parameter_get_gives_the_default);
    RUN_TEST(test_parameter_get_of_an_unknown_index_gives_nan);
    RUN_TEST(test_parameter_set_in_idle_is_taken_and_kept);
    RUN_TEST(test_parameter_set_reaches_the_torque);
    RUN_TEST(test_parameter_set_out_of_range_answers_the_value_in_force);
    RUN_TEST(test_parameter_set_of_an_unknown_index_is_refused);
    RUN_TEST(test_parameter_set_in_motion_is_refused_and_changes_nothing);
    RUN_TEST(test_upload_of_a_wrong_crc_leaves_no_trajectory);
    RUN_TEST(test_upload_is_acknowledged_every_16_frames_with_the_next_offset);
    RUN_TEST(test_upload_behind_a_gap_is_told_the_offset_to_go_on_from);
    RUN_TEST(test_upload_in_motion_is_refused_and_the_running_trajectory_untouched);
    RUN_TEST(test_upload_in_fault_is_taken);
    RUN_TEST(test_outbox_full_counts_what_is_lost_and_keeps_the_first);
    RUN_TEST(test_outbox_keeps_the_order_over_its_end);
    RUN_TEST(test_transmit_of_nothing_is_false);
    RUN_TEST(test_two_instances_on_one_bus_are_independent);
    RUN_TEST(test_two_instances_with_the_same_frames_give_the_same_bytes);
    RUN_TEST(test_use_of_a_drive_that_the_port_lacks_is_refused);
    RUN_TEST(test_use_changes_the_drive_that_identity_tells);
    RUN_TEST(test_use_of_another_drive_while_tracking_is_refused);
    RUN_TEST(test_timer_tick_in_lockstep_does_nothing);
    RUN_TEST(test_sync_in_real_time_steps_nothing);
    RUN_TEST(test_timer_tick_answers_with_the_last_sync);
    RUN_TEST(test_timer_tick_without_a_host_is_not_answered);
    RUN_TEST(test_overrun_moves_the_reference_on_and_is_counted);
    RUN_TEST(test_overruns_with_ticks_on_time_between_them_are_borne);
    RUN_TEST(test_a_run_of_overruns_is_a_fault);
    RUN_TEST(test_one_overrun_too_long_is_a_fault);
    RUN_TEST(test_host_silent_for_more_than_a_tenth_of_a_second_is_a_fault);
    RUN_TEST(test_motors_get_the_torque_of_the_last_step_while_driving_only);
    RUN_TEST(test_motors_that_cannot_give_the_torque_are_a_fault);
    RUN_TEST(test_motors_that_nobody_drives_are_no_fault);
    RUN_TEST(test_motors_get_no_torque_of_the_drive_before_after_start);
    RUN_TEST(test_bus_drives_never_enable_the_motors);
    RUN_TEST(test_wheel_speeds_of_the_bus_are_not_taken_by_a_robot_with_motors);
    RUN_TEST(test_wheel_speeds_of_the_port_are_not_taken_without_motors);
    RUN_TEST(test_step_times_are_reported_every_hundred_ticks_and_start_anew);
    RUN_TEST(test_port_without_measurements_reports_none);
    RUN_TEST(test_health_and_crash_are_reported_the_crash_once);
    return UNITY_END();
}
