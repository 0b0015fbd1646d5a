// SPDX-License-Identifier: MIT
// The firmware as a shared library: an instance per caller, in the caller's memory. host_sim/inproc.py is its user.
#ifndef OMNIBOT_PORTS_POSIX_INPROC_H
#define OMNIBOT_PORTS_POSIX_INPROC_H

#include "frame.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// Bytes of memory an instance needs, aligned for any type.
size_t omnibot_size(void);

/// Makes an instance of node 0 … 15 in `memory`; in lockstep, and able to step by omnibot_tick where the host asks for
/// real time.
void omnibot_init(void *memory, uint8_t node);

/// Gives the instance one frame off the bus; it acts on it at once.
void omnibot_receive(void *instance, const frame_t *frame);

/// Takes the instance's next frame for the bus; false when there is none.
bool omnibot_transmit(void *instance, frame_t *frame);

/// Tells the instance that a control period has passed.
void omnibot_tick(void *instance);

/// What a robot reads at a tick.
typedef struct {
    float pose[3];                  // x1, x2 (m), θ (rad, −π … π)
    float wheel_speed_rad_per_s[3]; // φ̇
} omnibot_sensors_t;

/// What the firmware answers to a tick.
typedef struct {
    float torque_Nm[3];
    float mu_m_per_s[3]; // µ of (2)
} omnibot_answer_t;

/// One lockstep tick without a bus: the instance gets POSE, WHEEL_SPEED and SYNC, its TORQUE and SLIP are the answer.
/// Other frames that it has for the bus are lost. Returns the mode of TORQUE, or -1 without both answers.
int32_t omnibot_lockstep(void *instance, uint32_t tick, const omnibot_sensors_t *sensors, omnibot_answer_t *answer);

#endif
