// SPDX-License-Identifier: MIT
// The upload and parameter protocols through app_receive.
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
        program_step_setup(&subject, &source);
    }
    return 0;
}
