// SPDX-License-Identifier: MIT
// The whole app: the input is a program of frames, ticks and notes.
#include "program.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static subject_t subject;
    source_t source = {.data = data, .size = size};
    if (size > 0) {
        program_start(&subject, &source);
    }
    while (!source_is_empty(&source)) {
        program_step(&subject, &source);
    }
    return 0;
}
