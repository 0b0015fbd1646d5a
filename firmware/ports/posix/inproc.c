// SPDX-License-Identifier: MIT
#include "inproc.h"

#include "app.h"
#include "crc.h"
#include "messages.h"

#define EXPORTED __attribute__((visibility("default")))

EXPORTED size_t omnibot_size(void)
{
    return sizeof(app_t);
}

EXPORTED void omnibot_init(void *memory, uint8_t node)
{
    const app_port_t port = {.drives = 1u << DRIVE_LOCKSTEP | 1u << DRIVE_REALTIME, .drive = DRIVE_LOCKSTEP};
    app_init(memory, &omnibot, node, port);
}

EXPORTED void omnibot_receive(void *instance, const frame_t *frame)
{
    app_receive(instance, frame);
}

EXPORTED bool omnibot_transmit(void *instance, frame_t *frame)
{
    return app_transmit(instance, frame);
}

EXPORTED void omnibot_tick(void *instance)
{
    app_tick(instance);
}

/// Returns the CRC-8 by which SYNC vouches for the frame.
static uint8_t receive_sensor(app_t *app, const frame_t *frame)
{
    app_receive(app, frame);
    return crc8_frame(frame, frame->length);
}

static sync_message_t receive_sensors(app_t *app, uint32_t tick, const omnibot_sensors_t *sensors)
{
    const float *x = sensors->pose, *speed = sensors->wheel_speed_rad_per_s;
    const uint8_t counter = (uint8_t)(tick & 0xFu);
    sync_message_t sync = {.tick = tick};
    frame_t frame;
    pose_encode(&frame, app->node, &(pose_message_t){x[0], x[1], x[2], counter});
    sync.pose_crc = receive_sensor(app, &frame);
    wheel_speed_encode(&frame, app->node, &(wheel_speed_message_t){speed[0], speed[1], speed[2], counter});
    sync.wheel_speed_crc = receive_sensor(app, &frame);
    return sync;
}

/// Empties the outbox; -1 unless TORQUE and SLIP are in it.
static int32_t take_answer(app_t *app, omnibot_answer_t *answer)
{
    torque_message_t torque;
    slip_message_t slip;
    bool has_torque = false, has_slip = false;
    frame_t frame;
    while (app_transmit(app, &frame)) {
        const int function = frame.id >> FRAME_NODE_BITS;
        has_torque |= function == TORQUE_FUNCTION && torque_decode(&torque, &frame) == DECODE_OK;
        has_slip |= function == SLIP_FUNCTION && slip_decode(&slip, &frame) == DECODE_OK;
    }
    if (!has_torque || !has_slip) {
        return -1;
    }
    *answer = (omnibot_answer_t){{torque.wheel1_Nm, torque.wheel2_Nm, torque.wheel3_Nm},
                                 {slip.mu1_m_per_s, slip.mu2_m_per_s, slip.mu3_m_per_s}};
    return torque.mode;
}

EXPORTED int32_t omnibot_lockstep(void *instance, uint32_t tick, const omnibot_sensors_t *sensors,
                                  omnibot_answer_t *answer)
{
    app_t *app = instance;
    const sync_message_t sync = receive_sensors(app, tick, sensors);
    frame_t frame;
    sync_encode(&frame, app->node, &sync);
    app_receive(app, &frame);
    return take_answer(app, answer);
}
