// SPDX-License-Identifier: MIT
// The generated codec against the bit positions of protocol/omnibot.dbc, written out here: rounding, saturation, 'not
// available', round trips, and what the length and the CRC refuse.
#include "messages.h"

#include "unity.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

enum { NODE = 5 };

void setUp(void)
{
}

void tearDown(void)
{
}

/// Little-endian bit field, one bit at a time.
static uint32_t bits_of(const frame_t *frame, int start, int length)
{
    uint32_t value = 0;
    for (int i = 0; i < length; i++) {
        const int bit = start + i;
        value |= ((uint32_t)frame->data[bit / 8] >> (bit % 8) & 1u) << i;
    }
    return value;
}

static void put_bits(frame_t *frame, int start, int length, uint32_t value)
{
    for (int i = 0; i < length; i++) {
        const int bit = start + i;
        const uint8_t mask = (uint8_t)(1u << (bit % 8));
        frame->data[bit / 8] =
            (uint8_t)((value >> i & 1u) != 0 ? frame->data[bit / 8] | mask : frame->data[bit / 8] & (uint8_t)~mask);
    }
}

// ---- physical signals: one channel each

/// Encodes a message whose other fields are zero; decodes one field.
#define CHANNEL(message, field)                                                                                        \
    static void put_##message##_##field(frame_t *frame, float value)                                                   \
    {                                                                                                                  \
        message##_message_t made = {0};                                                                                \
        made.field = value;                                                                                            \
        message##_encode(frame, NODE, &made);                                                                          \
    }                                                                                                                  \
    static float get_##message##_##field(const frame_t *frame)                                                         \
    {                                                                                                                  \
        message##_message_t read = {0};                                                                                \
        TEST_ASSERT_EQUAL(DECODE_OK, message##_decode(&read, frame));                                                  \
        return read.field;                                                                                             \
    }

CHANNEL(pose, x1_m)
CHANNEL(pose, x2_m)
CHANNEL(pose, heading_rad)
CHANNEL(wheel_speed, wheel1_rad_per_s)
CHANNEL(wheel_speed, wheel2_rad_per_s)
CHANNEL(wheel_speed, wheel3_rad_per_s)
CHANNEL(torque, wheel1_Nm)
CHANNEL(torque, wheel2_Nm)
CHANNEL(torque, wheel3_Nm)
CHANNEL(slip, mu1_m_per_s)
CHANNEL(slip, mu2_m_per_s)
CHANNEL(slip, mu3_m_per_s)

typedef struct {
    const char *name;
    int start, length;
    double step;
    void (*put)(frame_t *frame, float value);
    float (*get)(const frame_t *frame);
} channel_t;

static const channel_t channels[] = {
    {"POSE.x1", 0, 22, 1e-5, put_pose_x1_m, get_pose_x1_m},
    {"POSE.x2", 22, 22, 1e-5, put_pose_x2_m, get_pose_x2_m},
    {"POSE.heading", 44, 16, 1e-4, put_pose_heading_rad, get_pose_heading_rad},
    {"WHEEL_SPEED.1", 0, 20, 5e-4, put_wheel_speed_wheel1_rad_per_s, get_wheel_speed_wheel1_rad_per_s},
    {"WHEEL_SPEED.2", 20, 20, 5e-4, put_wheel_speed_wheel2_rad_per_s, get_wheel_speed_wheel2_rad_per_s},
    {"WHEEL_SPEED.3", 40, 20, 5e-4, put_wheel_speed_wheel3_rad_per_s, get_wheel_speed_wheel3_rad_per_s},
    {"TORQUE.1", 0, 16, 1e-5, put_torque_wheel1_Nm, get_torque_wheel1_Nm},
    {"TORQUE.2", 16, 16, 1e-5, put_torque_wheel2_Nm, get_torque_wheel2_Nm},
    {"TORQUE.3", 32, 16, 1e-5, put_torque_wheel3_Nm, get_torque_wheel3_Nm},
    {"SLIP.1", 0, 20, 2e-4, put_slip_mu1_m_per_s, get_slip_mu1_m_per_s},
    {"SLIP.2", 20, 20, 2e-4, put_slip_mu2_m_per_s, get_slip_mu2_m_per_s},
    {"SLIP.3", 40, 20, 2e-4, put_slip_mu3_m_per_s, get_slip_mu3_m_per_s},
};

enum { CHANNELS = sizeof channels / sizeof channels[0] };

static int32_t raw_max(const channel_t *channel)
{
    return (int32_t)(1u << (channel->length - 1)) - 1;
}

/// The field's raw value, two's complement.
static int32_t raw_of(const channel_t *channel, const frame_t *frame)
{
    const uint32_t bits = bits_of(frame, channel->start, channel->length);
    const uint32_t sign = 1u << (channel->length - 1);
    return (bits & sign) != 0 ? -(int32_t)(2u * sign - bits) : (int32_t)bits;
}

static void assert_encodes(const channel_t *channel, double value, int32_t raw)
{
    frame_t frame;
    channel->put(&frame, (float)value);
    char message[64];
    (void)snprintf(message, sizeof message, "%s of %.9g", channel->name, value);
    TEST_ASSERT_EQUAL_INT32_MESSAGE(raw, raw_of(channel, &frame), message);
}

static void test_encode_rounds_to_the_nearest_step(void)
{
    static const int32_t at[] = {0, 1, 2, 9, 100, 12345, 30000};
    for (int i = 0; i < CHANNELS; i++) {
        for (size_t k = 0; k < sizeof at / sizeof at[0]; k++) {
            const channel_t *c = &channels[i];
            assert_encodes(c, (at[k] + 0.4) * c->step, at[k]);
            assert_encodes(c, (at[k] + 0.6) * c->step, at[k] + 1);
            assert_encodes(c, -(at[k] + 0.4) * c->step, -at[k]);
            assert_encodes(c, -(at[k] + 0.6) * c->step, -at[k] - 1);
        }
    }
}

static void test_encode_does_not_truncate_what_falls_just_short_of_a_step(void)
{
    // 0.3 / 0.1 is 2.9999…: the classic victim of truncation.
    assert_encodes(&channels[0], 0.29999, 29999);
    assert_encodes(&channels[2], 0.3, 3000);
    assert_encodes(&channels[6], 0.00003, 3);
}

static void test_encode_beyond_both_ends_saturates_symmetrically(void)
{
    static const double beyond[] = {1.0000001, 1.5, 2.0, 1e9, 1e30};
    for (int i = 0; i < CHANNELS; i++) {
        const channel_t *c = &channels[i];
        const int32_t largest = raw_max(c);
        for (size_t k = 0; k < sizeof beyond / sizeof beyond[0]; k++) {
            assert_encodes(c, (largest + 1) * c->step * beyond[k], largest);
            assert_encodes(c, -(largest + 1) * c->step * beyond[k], -largest);
        }
        assert_encodes(c, (double)INFINITY, largest);
        assert_encodes(c, -(double)INFINITY, -largest);
    }
}

static void test_encode_nan_is_the_most_negative_raw_value(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        assert_encodes(&channels[i], (double)NAN, -raw_max(&channels[i]) - 1);
    }
}

static void test_decode_most_negative_raw_value_is_nan(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        frame_t frame;
        channels[i].put(&frame, NAN);

        TEST_ASSERT_TRUE_MESSAGE(isnan(channels[i].get(&frame)), channels[i].name);
    }
}

static void test_encode_of_one_field_touches_no_other(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        frame_t frame, empty;
        channels[i].put(&empty, 0.0f);
        channels[i].put(&frame, (float)(-channels[i].step)); // all ones
        const int data_bits = i >= 6 && i <= 8 ? 56 : 64;    // TORQUE ends in its CRC
        for (int bit = 0; bit < data_bits; bit++) {
            const bool inside = bit >= channels[i].start && bit < channels[i].start + channels[i].length;
            TEST_ASSERT_EQUAL_UINT32_MESSAGE(inside ? 1u : 0u, bits_of(&frame, bit, 1), channels[i].name);
        }
    }
}

static void assert_round_trip(const channel_t *channel, int32_t raw)
{
    const double value = raw * channel->step;
    frame_t frame;
    channel->put(&frame, (float)value);
    if (raw_of(channel, &frame) != raw) {
        assert_encodes(channel, value, raw);
    }
    const float back = channel->get(&frame);
    TEST_ASSERT_FLOAT_WITHIN((float)(1.5e-7 * fabs(value)), (float)value, back);
    frame_t again;
    channel->put(&again, back);
    TEST_ASSERT_EQUAL_INT32_MESSAGE(raw, raw_of(channel, &again), channel->name);
}

static void test_round_trip_of_boundary_values_is_exact_in_raw(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        const int32_t largest = raw_max(&channels[i]);
        const int32_t raw[] = {-largest, -largest + 1, -largest / 2 - 1, -1, 0, 1, largest / 2, largest - 1, largest};
        for (size_t k = 0; k < sizeof raw / sizeof raw[0]; k++) {
            assert_round_trip(&channels[i], raw[k]);
        }
    }
}

static void test_round_trip_of_every_third_value_of_every_signal_is_exact_in_raw(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        const int32_t largest = raw_max(&channels[i]);
        for (int32_t raw = -largest + i % 3; raw <= largest; raw += 3) {
            assert_round_trip(&channels[i], raw);
        }
    }
}

static void test_resolution_is_what_the_control_needs(void)
{
    // Position 10 µm over ±20 m, heading 0.1 mrad over ±π, wheel speed 0.5 mrad/s, torque 10 µN·m over the motor's 0.2.
    assert_encodes(&channels[0], 20.0, 2000000);
    assert_encodes(&channels[1], -20.0, -2000000);
    assert_encodes(&channels[2], 3.14159265, 31416);
    assert_encodes(&channels[3], 100.0, 200000);
    assert_encodes(&channels[6], 0.2, 20000);
}

// ---- identifiers and lengths

/// Decodes into a struct full of a pattern; `untouched` tells whether the pattern is still there.
#define DECODER(message)                                                                                               \
    static decode_result_t decode_##message(const frame_t *frame, bool *untouched)                                     \
    {                                                                                                                  \
        message##_message_t read, pattern;                                                                             \
        memset(&pattern, 0xA5, sizeof pattern);                                                                        \
        memcpy(&read, &pattern, sizeof read);                                                                          \
        const decode_result_t result = message##_decode(&read, frame);                                                 \
        *untouched = memcmp(&read, &pattern, sizeof read) == 0;                                                        \
        return result;                                                                                                 \
    }                                                                                                                  \
    static void encode_##message(frame_t *frame, uint8_t node)                                                         \
    {                                                                                                                  \
        message##_message_t made;                                                                                      \
        memset(&made, 0x35, sizeof made);                                                                              \
        message##_encode(frame, node, &made);                                                                          \
    }

DECODER(command)
DECODER(pose)
DECODER(wheel_speed)
DECODER(sync)
DECODER(torque)
DECODER(slip)
DECODER(status)
DECODER(drops)
DECODER(fault_record)
DECODER(challenge)
DECODER(parameter_set)
DECODER(parameter_get)
DECODER(parameter_value)
DECODER(parameter_text)
DECODER(parameter_store)
DECODER(trajectory_begin)
DECODER(trajectory_data)
DECODER(trajectory_ack)
DECODER(hello)
DECODER(identity)

static const struct {
    uint16_t id; // of node 0, from the DBC
    uint8_t length;
    bool has_crc;
    void (*encode)(frame_t *frame, uint8_t node);
    decode_result_t (*decode)(const frame_t *frame, bool *untouched);
} messages[] = {
    {16, 5, true, encode_command, decode_command},
    {32, 8, false, encode_pose, decode_pose},
    {48, 8, false, encode_wheel_speed, decode_wheel_speed},
    {64, 7, true, encode_sync, decode_sync},
    {80, 8, true, encode_torque, decode_torque},
    {96, 8, false, encode_slip, decode_slip},
    {256, 8, false, encode_status, decode_status},
    {320, 8, false, encode_drops, decode_drops},
    {336, 8, false, encode_fault_record, decode_fault_record},
    {352, 4, false, encode_challenge, decode_challenge},
    {512, 7, true, encode_parameter_set, decode_parameter_set},
    {528, 2, false, encode_parameter_get, decode_parameter_get},
    {544, 6, false, encode_parameter_value, decode_parameter_value},
    {560, 8, false, encode_parameter_text, decode_parameter_text},
    {576, 7, false, encode_parameter_store, decode_parameter_store},
    {768, 8, true, encode_trajectory_begin, decode_trajectory_begin},
    {784, 8, false, encode_trajectory_data, decode_trajectory_data},
    {800, 3, false, encode_trajectory_ack, decode_trajectory_ack},
    {1024, 4, false, encode_hello, decode_hello},
    {1040, 8, false, encode_identity, decode_identity},
};

enum { MESSAGES = sizeof messages / sizeof messages[0] };

static void test_encode_gives_the_identifier_and_length_of_the_definition(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (uint8_t node = 0; node < FRAME_NODE_COUNT; node++) {
            frame_t frame;
            messages[i].encode(&frame, node);

            TEST_ASSERT_EQUAL_UINT16(messages[i].id + node, frame.id);
            TEST_ASSERT_EQUAL_UINT8(messages[i].length, frame.length);
        }
    }
}

static void test_encode_for_a_node_out_of_range_keeps_the_function(void)
{
    frame_t frame;
    for (int i = 0; i < MESSAGES; i++) {
        messages[i].encode(&frame, 0xF3);

        TEST_ASSERT_EQUAL_UINT16(messages[i].id + 3, frame.id);
    }
}

static void test_decode_of_any_other_length_is_refused_untouched(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (uint8_t length = 0; length <= 9; length++) {
            frame_t frame;
            messages[i].encode(&frame, NODE);
            frame.length = length;
            bool untouched = false;

            const decode_result_t result = messages[i].decode(&frame, &untouched);

            const bool right = length == messages[i].length;
            TEST_ASSERT_EQUAL(right ? DECODE_OK : DECODE_WRONG_LENGTH, result);
            TEST_ASSERT_EQUAL(!right, untouched);
        }
    }
}

// ---- the CRC

static void assert_crc_refuses(int message, const frame_t *frame)
{
    bool untouched = false;
    TEST_ASSERT_EQUAL(DECODE_WRONG_CRC, messages[message].decode(frame, &untouched));
    TEST_ASSERT_TRUE(untouched);
}

static void test_decode_with_any_single_bit_flipped_is_refused(void)
{
    int checked = 0;
    for (int i = 0; i < MESSAGES; i++) {
        for (int bit = 0; messages[i].has_crc && bit < 8 * messages[i].length; bit++) {
            frame_t frame;
            messages[i].encode(&frame, NODE);
            frame.data[bit / 8] ^= (uint8_t)(1u << (bit % 8));

            assert_crc_refuses(i, &frame);
            checked++;
        }
    }
    TEST_ASSERT_EQUAL(8 * (5 + 7 + 8 + 7 + 8), checked);
}

static void test_decode_with_any_two_bits_flipped_is_refused(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (int first = 0; messages[i].has_crc && first < 8 * messages[i].length; first++) {
            for (int second = 0; second < first; second++) {
                frame_t frame;
                messages[i].encode(&frame, NODE);
                frame.data[first / 8] ^= (uint8_t)(1u << (first % 8));
                frame.data[second / 8] ^= (uint8_t)(1u << (second % 8));

                assert_crc_refuses(i, &frame);
            }
        }
    }
}

static void test_decode_under_another_nodes_identifier_is_refused(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (uint16_t node = 0; messages[i].has_crc && node < FRAME_NODE_COUNT; node++) {
            frame_t frame;
            messages[i].encode(&frame, NODE);
            frame.id = (uint16_t)(messages[i].id + node);
            if (node != NODE) {
                assert_crc_refuses(i, &frame);
            }
        }
    }
}

static void test_decode_under_another_functions_identifier_is_refused(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        for (uint16_t function = 0; messages[i].has_crc && function < 128; function++) {
            frame_t frame;
            messages[i].encode(&frame, NODE);
            frame.id = (uint16_t)(function << FRAME_NODE_BITS | NODE);
            if (function != messages[i].id >> FRAME_NODE_BITS) {
                assert_crc_refuses(i, &frame);
            }
        }
    }
}

static void test_decode_of_nothing_but_zeros_or_ones_is_refused(void)
{
    for (int i = 0; i < MESSAGES; i++) {
        if (messages[i].has_crc) {
            frame_t frame = {.id = (uint16_t)(messages[i].id + NODE), .length = messages[i].length};
            assert_crc_refuses(i, &frame);
            memset(frame.data, 0xFF, sizeof frame.data);
            assert_crc_refuses(i, &frame);
        }
    }
}

// ---- whole messages: place and round trip of the fields that are not physical

static void test_command_round_trip(void)
{
    for (uint32_t operation = 0; operation < 256; operation++) {
        for (uint8_t counter = 0; counter < 16; counter++) {
            const command_message_t sent = {(uint8_t)operation, counter, (uint16_t)(operation * 257u ^ 0x1234u)};
            frame_t frame;
            command_message_t got;

            command_encode(&frame, NODE, &sent);

            TEST_ASSERT_EQUAL(DECODE_OK, command_decode(&got, &frame));
            TEST_ASSERT_EQUAL_UINT8(operation, got.operation);
            TEST_ASSERT_EQUAL_UINT8(counter, got.counter);
            TEST_ASSERT_EQUAL_UINT32(operation, bits_of(&frame, 0, 8));
            TEST_ASSERT_EQUAL_UINT16(sent.key, got.key);
            TEST_ASSERT_EQUAL_UINT32(counter, bits_of(&frame, 8, 4));
            TEST_ASSERT_EQUAL_UINT32(sent.key, bits_of(&frame, 16, 16));
        }
    }
}

static void test_counter_of_sensor_frames_sits_in_the_last_four_bits(void)
{
    for (uint8_t counter = 0; counter < 16; counter++) {
        frame_t frame;
        pose_message_t pose;
        pose_encode(&frame, NODE, &(pose_message_t){.counter = counter});
        TEST_ASSERT_EQUAL_UINT32(counter, bits_of(&frame, 60, 4));
        TEST_ASSERT_EQUAL(DECODE_OK, pose_decode(&pose, &frame));
        TEST_ASSERT_EQUAL_UINT8(counter, pose.counter);

        wheel_speed_message_t speed;
        wheel_speed_encode(&frame, NODE, &(wheel_speed_message_t){.counter = counter});
        TEST_ASSERT_EQUAL_UINT32(counter, bits_of(&frame, 60, 4));
        TEST_ASSERT_EQUAL(DECODE_OK, wheel_speed_decode(&speed, &frame));
        TEST_ASSERT_EQUAL_UINT8(counter, speed.counter);

        slip_message_t slip;
        slip_encode(&frame, NODE, &(slip_message_t){.counter = counter});
        TEST_ASSERT_EQUAL_UINT32(counter, bits_of(&frame, 60, 4));
        TEST_ASSERT_EQUAL(DECODE_OK, slip_decode(&slip, &frame));
        TEST_ASSERT_EQUAL_UINT8(counter, slip.counter);
    }
}

static void test_counter_too_large_spoils_no_neighbour(void)
{
    frame_t frame;
    torque_encode(&frame, NODE, &(torque_message_t){.counter = 0xF7, .mode = 0});
    TEST_ASSERT_EQUAL_UINT32(7, bits_of(&frame, 48, 4));
    TEST_ASSERT_EQUAL_UINT32(0, bits_of(&frame, 52, 4));
}

static void test_pose_all_fields_together_round_trip(void)
{
    const pose_message_t sent = {-20.97151f, 20.97151f, -3.2767f, 15};
    frame_t frame;
    pose_message_t got;

    pose_encode(&frame, NODE, &sent);

    TEST_ASSERT_EQUAL(DECODE_OK, pose_decode(&got, &frame));
    TEST_ASSERT_FLOAT_WITHIN(4e-6f, sent.x1_m, got.x1_m);
    TEST_ASSERT_FLOAT_WITHIN(4e-6f, sent.x2_m, got.x2_m);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, sent.heading_rad, got.heading_rad);
    TEST_ASSERT_EQUAL_UINT8(15, got.counter);
}

static void test_sync_round_trip(void)
{
    static const uint32_t tick[] = {0u, 1u, 0x7FFFFFFFu, 0x80000000u, 0x12345678u, UINT32_MAX};
    for (size_t i = 0; i < sizeof tick / sizeof tick[0]; i++) {
        const sync_message_t sent = {tick[i], 0xA5, 0x3C};
        frame_t frame;
        sync_message_t got;

        sync_encode(&frame, NODE, &sent);

        TEST_ASSERT_EQUAL(DECODE_OK, sync_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT32(tick[i], got.tick);
        TEST_ASSERT_EQUAL_HEX8(0xA5, got.pose_crc);
        TEST_ASSERT_EQUAL_HEX8(0x3C, got.wheel_speed_crc);
        TEST_ASSERT_EQUAL_UINT32(0xA5, bits_of(&frame, 32, 8));
        TEST_ASSERT_EQUAL_UINT32(0x3C, bits_of(&frame, 40, 8));
        TEST_ASSERT_EQUAL_UINT32(tick[i], bits_of(&frame, 0, 32));
    }
}

static void test_torque_counter_and_mode_round_trip(void)
{
    const torque_message_t sent = {0.1f, -0.2f, 0.32767f, 0xA, MODE_TRACKING};
    frame_t frame;
    torque_message_t got;

    torque_encode(&frame, NODE, &sent);

    TEST_ASSERT_EQUAL(DECODE_OK, torque_decode(&got, &frame));
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.1f, got.wheel1_Nm);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, -0.2f, got.wheel2_Nm);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.32767f, got.wheel3_Nm);
    TEST_ASSERT_EQUAL_UINT8(0xA, got.counter);
    TEST_ASSERT_EQUAL_UINT8(MODE_TRACKING, got.mode);
    TEST_ASSERT_EQUAL_UINT32(0xA, bits_of(&frame, 48, 4));
    TEST_ASSERT_EQUAL_UINT32(MODE_TRACKING, bits_of(&frame, 52, 4));
}

static void test_status_round_trip(void)
{
    const status_message_t sent[] = {
        {0, 0, 0, 0, 0, 0}, {15, 15, 255, 65535, 65535, 65535}, {2, 9, 4, 0x8001, 0x1234, 0xFEDC}};
    for (size_t i = 0; i < sizeof sent / sizeof sent[0]; i++) {
        frame_t frame;
        status_message_t got;

        status_encode(&frame, NODE, &sent[i]);

        TEST_ASSERT_EQUAL(DECODE_OK, status_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT8(sent[i].mode, got.mode);
        TEST_ASSERT_EQUAL_UINT8(sent[i].refusal, got.refusal);
        TEST_ASSERT_EQUAL_UINT8(sent[i].fault, got.fault);
        TEST_ASSERT_EQUAL_UINT16(sent[i].fault_mask, got.fault_mask);
        TEST_ASSERT_EQUAL_UINT16(sent[i].dropped_frames, got.dropped_frames);
        TEST_ASSERT_EQUAL_UINT16(sent[i].missed_ticks, got.missed_ticks);
        TEST_ASSERT_EQUAL_UINT32(sent[i].mode, bits_of(&frame, 0, 4));
        TEST_ASSERT_EQUAL_UINT32(sent[i].refusal, bits_of(&frame, 4, 4));
        TEST_ASSERT_EQUAL_UINT32(sent[i].fault, bits_of(&frame, 8, 8));
        TEST_ASSERT_EQUAL_UINT32(sent[i].fault_mask, bits_of(&frame, 16, 16));
        TEST_ASSERT_EQUAL_UINT32(sent[i].dropped_frames, bits_of(&frame, 32, 16));
        TEST_ASSERT_EQUAL_UINT32(sent[i].missed_ticks, bits_of(&frame, 48, 16));
    }
}

/// Bits of a float, without the codec.
static uint32_t float_bits(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static const float any_float[] = {0.0f, -0.0f, 1.0f, -1.5f, 3.4e38f, 1e-45f, INFINITY, -INFINITY, NAN, 0.327f};

enum { ANY_FLOATS = sizeof any_float / sizeof any_float[0] };

static void test_parameter_set_round_trip_keeps_every_bit(void)
{
    for (int i = 0; i < ANY_FLOATS; i++) {
        const parameter_set_message_t sent = {(uint8_t)(i * 28), any_float[i], 11};
        frame_t frame;
        parameter_set_message_t got;

        parameter_set_encode(&frame, NODE, &sent);

        TEST_ASSERT_EQUAL(DECODE_OK, parameter_set_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT8(i * 28, got.index);
        TEST_ASSERT_EQUAL_HEX32(float_bits(any_float[i]), float_bits(got.value));
        TEST_ASSERT_EQUAL_UINT8(11, got.counter);
        TEST_ASSERT_EQUAL_HEX32(float_bits(any_float[i]), bits_of(&frame, 8, 32));
        TEST_ASSERT_EQUAL_UINT32(11, bits_of(&frame, 40, 4));
    }
}

static void test_parameter_get_round_trip(void)
{
    for (uint32_t index = 0; index < 256; index++) {
        frame_t frame;
        parameter_get_message_t got;
        parameter_get_encode(&frame, NODE,
                             &(parameter_get_message_t){(uint8_t)index, index & 0xFu, (uint8_t)(index >> 4)});
        TEST_ASSERT_EQUAL(DECODE_OK, parameter_get_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT8(index, got.index);
        TEST_ASSERT_EQUAL_UINT8(index & 0xFu, got.field);
        TEST_ASSERT_EQUAL_UINT8(index >> 4, got.part);
    }
}

static void test_parameter_value_round_trip_keeps_every_bit(void)
{
    for (int i = 0; i < ANY_FLOATS; i++) {
        const parameter_value_message_t sent = {(uint8_t)(255 - i), PARAMETER_VALUE_RESULT_IN_MOTION, FIELD_MAXIMUM,
                                                any_float[i]};
        frame_t frame;
        parameter_value_message_t got;

        parameter_value_encode(&frame, NODE, &sent);

        TEST_ASSERT_EQUAL(DECODE_OK, parameter_value_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT8(255 - i, got.index);
        TEST_ASSERT_EQUAL_UINT8(PARAMETER_VALUE_RESULT_IN_MOTION, got.result);
        TEST_ASSERT_EQUAL_UINT8(FIELD_MAXIMUM, got.field);
        TEST_ASSERT_EQUAL_HEX32(float_bits(any_float[i]), float_bits(got.value));
        TEST_ASSERT_EQUAL_HEX32(float_bits(any_float[i]), bits_of(&frame, 16, 32));
    }
}

static void test_trajectory_begin_round_trip(void)
{
    const trajectory_begin_message_t sent[] = {{0, 0, 0}, {65535, UINT32_MAX, 15}, {12800, 0xCBF43926u, 6}};
    for (size_t i = 0; i < sizeof sent / sizeof sent[0]; i++) {
        frame_t frame;
        trajectory_begin_message_t got;

        trajectory_begin_encode(&frame, NODE, &sent[i]);

        TEST_ASSERT_EQUAL(DECODE_OK, trajectory_begin_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT16(sent[i].length_bytes, got.length_bytes);
        TEST_ASSERT_EQUAL_HEX32(sent[i].crc32, got.crc32);
        TEST_ASSERT_EQUAL_UINT32(sent[i].length_bytes, bits_of(&frame, 0, 16));
        TEST_ASSERT_EQUAL_HEX32(sent[i].crc32, bits_of(&frame, 16, 32));
        TEST_ASSERT_EQUAL_UINT8(sent[i].counter, got.counter);
        TEST_ASSERT_EQUAL_UINT32(sent[i].counter, bits_of(&frame, 48, 4));
    }
}

static void test_trajectory_data_bytes_are_the_last_six_of_the_frame(void)
{
    const trajectory_data_message_t sent = {0xABCD, 1, 2, 253, 4, 255, 6};
    static const uint8_t expected[8] = {0xCD, 0xAB, 1, 2, 253, 4, 255, 6};
    frame_t frame;
    trajectory_data_message_t got;

    trajectory_data_encode(&frame, NODE, &sent);

    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, frame.data, 8);
    TEST_ASSERT_EQUAL(DECODE_OK, trajectory_data_decode(&got, &frame));
    TEST_ASSERT_EQUAL_UINT16(0xABCD, got.offset_bytes);
    const uint8_t bytes[] = {got.byte0, got.byte1, got.byte2, got.byte3, got.byte4, got.byte5};
    TEST_ASSERT_EQUAL_HEX8_ARRAY(&expected[2], bytes, 6);
}

static void test_trajectory_ack_round_trip(void)
{
    const trajectory_ack_message_t sent[] = {{0, 0}, {65535, 255}, {96, TRAJECTORY_ACK_RESULT_COMPLETE}};
    for (size_t i = 0; i < sizeof sent / sizeof sent[0]; i++) {
        frame_t frame;
        trajectory_ack_message_t got;

        trajectory_ack_encode(&frame, NODE, &sent[i]);

        TEST_ASSERT_EQUAL(DECODE_OK, trajectory_ack_decode(&got, &frame));
        TEST_ASSERT_EQUAL_UINT16(sent[i].offset_bytes, got.offset_bytes);
        TEST_ASSERT_EQUAL_UINT8(sent[i].result, got.result);
    }
}

static void test_hello_and_identity_round_trip(void)
{
    frame_t frame;
    hello_message_t hello;
    hello_encode(&frame, NODE, &(hello_message_t){0x89ABCDEFu});
    TEST_ASSERT_EQUAL(DECODE_OK, hello_decode(&hello, &frame));
    TEST_ASSERT_EQUAL_HEX32(0x89ABCDEFu, hello.protocol_hash);

    static const uint8_t expected[8] = {0xEF, 0xCD, 0xAB, 0x89, 1, 20, 255, 0x21};
    identity_message_t identity;
    identity_encode(&frame, NODE, &(identity_message_t){0x89ABCDEFu, 1, 20, 255, 1, DRIVE_MOTORS});
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, frame.data, 8);
    TEST_ASSERT_EQUAL(DECODE_OK, identity_decode(&identity, &frame));
    TEST_ASSERT_EQUAL_HEX32(0x89ABCDEFu, identity.protocol_hash);
    TEST_ASSERT_EQUAL_UINT8(1, identity.major);
    TEST_ASSERT_EQUAL_UINT8(20, identity.minor);
    TEST_ASSERT_EQUAL_UINT8(255, identity.patch);
    TEST_ASSERT_EQUAL_UINT8(1, identity.peer_matches);
    TEST_ASSERT_EQUAL_UINT8(DRIVE_MOTORS, identity.drive);
}

static void test_decode_of_every_bit_pattern_of_a_signal_is_within_its_range(void)
{
    // Patterns that no encoder of ours makes must still decode to something sane.
    for (uint32_t pattern = 0; pattern < 65536; pattern++) {
        frame_t frame;
        pose_encode(&frame, NODE, &(pose_message_t){0});
        put_bits(&frame, 44, 16, pattern);

        const float heading = get_pose_heading_rad(&frame);

        TEST_ASSERT_TRUE(pattern == 0x8000u ? isnan(heading) : fabsf(heading) <= 3.2768f);
    }
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_encode_rounds_to_the_nearest_step);
    RUN_TEST(test_encode_does_not_truncate_what_falls_just_short_of_a_step);
    RUN_TEST(test_encode_beyond_both_ends_saturates_symmetrically);
    RUN_TEST(test_encode_nan_is_the_most_negative_raw_value);
    RUN_TEST(test_decode_most_negative_raw_value_is_nan);
    RUN_TEST(test_encode_of_one_field_touches_no_other);
    RUN_TEST(test_round_trip_of_boundary_values_is_exact_in_raw);
    RUN_TEST(test_round_trip_of_every_third_value_of_every_signal_is_exact_in_raw);
    RUN_TEST(test_resolution_is_what_the_control_needs);
    RUN_TEST(test_encode_gives_the_identifier_and_length_of_the_definition);
    RUN_TEST(test_encode_for_a_node_out_of_range_keeps_the_function);
    RUN_TEST(test_decode_of_any_other_length_is_refused_untouched);
    RUN_TEST(test_decode_with_any_single_bit_flipped_is_refused);
    RUN_TEST(test_decode_with_any_two_bits_flipped_is_refused);
    RUN_TEST(test_decode_under_another_nodes_identifier_is_refused);
    RUN_TEST(test_decode_under_another_functions_identifier_is_refused);
    RUN_TEST(test_decode_of_nothing_but_zeros_or_ones_is_refused);
    RUN_TEST(test_command_round_trip);
    RUN_TEST(test_counter_of_sensor_frames_sits_in_the_last_four_bits);
    RUN_TEST(test_counter_too_large_spoils_no_neighbour);
    RUN_TEST(test_pose_all_fields_together_round_trip);
    RUN_TEST(test_sync_round_trip);
    RUN_TEST(test_torque_counter_and_mode_round_trip);
    RUN_TEST(test_status_round_trip);
    RUN_TEST(test_parameter_set_round_trip_keeps_every_bit);
    RUN_TEST(test_parameter_get_round_trip);
    RUN_TEST(test_parameter_value_round_trip_keeps_every_bit);
    RUN_TEST(test_trajectory_begin_round_trip);
    RUN_TEST(test_trajectory_data_bytes_are_the_last_six_of_the_frame);
    RUN_TEST(test_trajectory_ack_round_trip);
    RUN_TEST(test_hello_and_identity_round_trip);
    RUN_TEST(test_decode_of_every_bit_pattern_of_a_signal_is_within_its_range);
    return UNITY_END();
}
