// SPDX-License-Identifier: MIT
// What the robot must do by protocol/README.md, written a second time and without its control law: modes, refusals,
// faults, parameters, uploads, what is dropped. Exact but for three things: whether the law's numbers stay finite and
// near the path, readings whose age is within rounding of their timeout, and when braking comes to rest.
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
    bool waits, available; // a frame that no SYNC has vouched for; it has a value
    uint8_t counter, crc;  // of that frame
} model_reading_t;

typedef struct {
    uint8_t drives, drive; // what the port can do, and does
    uint8_t mode, fault;
    uint16_t fault_mask;
    bool peer_matches;
    bool requests_known;
    uint8_t request_counter;
    uint64_t armed_ticks;    // since ARM
    bool located;            // has made a step since START
    uint32_t stopping_ticks; // since braking began
    uint64_t damaged, replayed, masqueraded;
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
    bool sync_known;
    uint32_t sync_tick; // of the last SYNC
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

bool model_drives(const model_t *model);
bool model_is_safe(const model_t *model);

/// The counter of a request; false, and a replay, unless it follows.
bool model_request(model_t *model, uint8_t counter);

/// Does what a COMMAND says; returns the refusal. `key_fits`: it carries the key of the last CHALLENGE.
uint8_t model_command(model_t *model, uint8_t operation, bool key_fits);

/// A HELLO with the robot's hash.
void model_hello(model_t *model);

/// A sensor frame of some tick, with its CRC-8; `available`: it carries a value.
void model_arrive(model_t *model, model_reading_t *reading, uint8_t counter, uint8_t crc, bool available);

typedef enum { SYNC_REPLAYED, SYNC_AGAIN, SYNC_NEW } model_sync_t;

/// What a SYNC is; a new one vouches for the readings.
model_sync_t model_sync(model_t *model, uint32_t tick, uint8_t pose_crc, uint8_t wheel_speed_crc);

/// Where an axis of a segment ends: the sum of its coefficients, the highest power first, in single precision.
float model_end(const uint8_t *segment, int axis);

/// Takes a PARAMETER_SET; returns the result.
uint8_t model_set(model_t *model, uint8_t index, float value);

model_ack_t model_begin(model_t *model, uint16_t length_bytes, uint32_t crc32);
model_ack_t model_data(model_t *model, uint16_t offset_bytes, const uint8_t data[6]);

/// Moves time on to a tick.
model_faults_t model_step(model_t *model, uint32_t tick);

/// What came out of a step that drove, or of a fault that a port told.
void model_note_faults(model_t *model, uint8_t fault, uint16_t fault_mask);

/// Braking came to rest.
void model_rest(model_t *model);

#endif
