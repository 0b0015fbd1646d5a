// SPDX-License-Identifier: MIT
// What the robot must do by protocol/README.md, written a second time and without its control law: modes, refusals,
// faults, parameters, uploads. Exact but for two things: whether the law's numbers stay finite, and readings whose age
// is within rounding of their timeout.
#ifndef OMNIBOT_FUZZ_MODEL_H
#define OMNIBOT_FUZZ_MODEL_H

#include "parameter_table.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MODEL_BYTES_PER_SEGMENT = 100, MODEL_SEGMENTS_MAX = 128 };
enum { MODEL_BYTES_MAX = MODEL_BYTES_PER_SEGMENT * MODEL_SEGMENTS_MAX };

typedef struct {
    uint64_t age_ticks;
    bool fresh;
} model_reading_t;

typedef struct {
    uint8_t drives, drive; // what the port can do, and does
    uint8_t mode, fault;
    uint16_t fault_mask;
    bool peer_matches;
    float parameter[PARAMETER_COUNT];

    uint8_t byte[MODEL_BYTES_MAX]; // of the upload
    uint16_t length_bytes, received_bytes;
    uint32_t crc32;
    bool receiving;
    uint16_t held_bytes; // of a trajectory that may be driven

    bool tick_known;
    uint32_t tick;          // of the last step
    uint64_t missed_in_row; // ticks
    uint64_t overdue_ticks; // told by the port, not yet passed
    uint64_t silent_ticks;  // since the last SYNC
    uint8_t sync_counter;   // low bits of the last SYNC's tick
    model_reading_t pose, wheel_speed;
} model_t;

/// An answer to an upload's frame.
typedef struct {
    bool is_due;
    uint8_t result;
} model_ack_t;

/// The faults of a step: those that must come up, and those that may.
typedef struct {
    uint16_t certain, possible;
} model_faults_t;

void model_init(model_t *model, uint8_t drives, uint8_t drive);

/// Takes a COMMAND; returns the refusal.
uint8_t model_command(model_t *model, uint8_t operation);

/// Takes a PARAMETER_SET; returns the result.
uint8_t model_set(model_t *model, uint8_t index, float value);

model_ack_t model_begin(model_t *model, uint16_t length_bytes, uint32_t crc32);
model_ack_t model_data(model_t *model, uint16_t offset_bytes, const uint8_t data[6]);

/// Moves time on to a tick.
model_faults_t model_step(model_t *model, uint32_t tick);

/// What came out of a step while TRACKING.
void model_note_faults(model_t *model, uint8_t fault, uint16_t fault_mask);

#endif
