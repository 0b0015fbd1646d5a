// SPDX-License-Identifier: MIT
// The robot as a state machine on a CAN bus: frames in, frames out, one control step a SYNC. No globals: an instance is
// an app_t, as many as there is memory for. Pure but for its own state: the port moves the frames.
#ifndef OMNIBOT_APP_APP_H
#define OMNIBOT_APP_APP_H

#include "control.h"
#include "frame.h"
#include "outbox.h"
#include "parameters.h"
#include "store.h"

enum {
    APP_STALE_TICKS_MAX = 5, // older wheel speeds are a fault; poses may be as old as pose_timeout_s says
    APP_TICK_GAP_MAX = 10,   // more missing ticks in a row are a fault
    APP_STATUS_EVERY_TICKS = 100,
    APP_VERSION_MAJOR = 0,
    APP_VERSION_MINOR = 1,
    APP_VERSION_PATCH = 0
};

/// A sensor reading and how old it is.
typedef struct {
    vec3_t value;
    uint32_t age_ticks;
    bool fresh; // came since the last tick
} reading_t;

typedef struct {
    const robot_t *robot;
    uint8_t node;
    uint8_t mode;    // MODE_…
    uint8_t fault;   // FAULT_… that came first since the last CLEAR
    uint8_t refusal; // REFUSAL_… of the last COMMAND
    uint16_t fault_mask;
    uint16_t dropped_frames; // damaged, or no room in the outbox; stops at its largest value
    uint16_t missed_ticks;   // likewise
    bool peer_matches;       // HELLO brought our protocol hash
    bool tick_known;         // a SYNC has come since START
    uint32_t tick;           // of the last SYNC
    reading_t pose;          // x1, x2 (m), θ (rad)
    reading_t wheel_speed;   // rad/s
    trajectory_cursor_t cursor;
    control_state_t state;
    parameters_t parameters;
    control_params_t control; // made from the parameters
    frame_t torque_answer;    // to the last SYNC
    frame_t slip_answer;
    store_t store;
    outbox_t outbox;
} app_t;

/// Ready in IDLE with default parameters and no trajectory.
void app_init(app_t *app, const robot_t *robot, uint8_t node);

/// Takes one frame off the bus; frames of other nodes and functions are ignored, damaged ones counted. Answers go to
/// the outbox.
void app_receive(app_t *app, const frame_t *frame);

/// Gives the next frame for the bus; false when there is none.
bool app_transmit(app_t *app, frame_t *frame);

#endif
