// SPDX-License-Identifier: MIT
// Bytes read as a program of frames, ticks and notes to a subject: what a fuzzer mutates, or a generator makes up.
#ifndef OMNIBOT_FUZZ_PROGRAM_H
#define OMNIBOT_FUZZ_PROGRAM_H

#include "subject.h"

/// Where a program's bytes come from: `data`, then no more; or, without any, an endless generator.
typedef struct {
    const uint8_t *data;
    size_t size;
    uint64_t random;
    uint64_t word;  // of the generator
    int bytes_left; // of the word
} source_t;

bool source_is_empty(const source_t *source);

/// A port by the program's first byte.
void program_start(subject_t *subject, source_t *source);

/// One instruction of any kind.
void program_step(subject_t *subject, source_t *source);

/// One instruction of the upload or parameter protocol; now and then START or STOP.
void program_step_setup(subject_t *subject, source_t *source);

#endif
