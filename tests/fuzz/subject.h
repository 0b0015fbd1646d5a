// SPDX-License-Identifier: MIT
// The app under judgement: each call of app.h, and after it everything that must hold. Node SUBJECT_NODE.
#ifndef OMNIBOT_FUZZ_SUBJECT_H
#define OMNIBOT_FUZZ_SUBJECT_H

#include "app.h"
#include "model.h"

enum { SUBJECT_NODE = 3 };

typedef struct {
    app_t app;
    app_t before; // as it was, but for the trajectory
    model_t model;
    bool holding;    // nobody takes frames out of the outbox
    uint64_t frames; // given to the app
    uint64_t steps;  // made while TRACKING, without a fault
} subject_t;

void subject_init(subject_t *subject, app_port_t port);
void subject_receive(subject_t *subject, const frame_t *frame);
void subject_tick(subject_t *subject);
void subject_note_overrun(subject_t *subject, uint32_t periods);
void subject_set_wheel_speed(subject_t *subject, vec3_t rad_per_s);
void subject_note_motor_fault(subject_t *subject, uint8_t fault);
void subject_note_step_time(subject_t *subject, uint32_t step_ns);
void subject_note_health(subject_t *subject, const app_health_t *health);
void subject_note_crash(subject_t *subject, uint32_t pc, uint32_t lr);

/// A bus that takes no frames, until it does again.
void subject_hold(subject_t *subject, bool holding);

#endif
