// SPDX-License-Identifier: MIT
// Times in equal classes, with what lies beyond the last one counted there; fixed size, constant time an entry.
#ifndef OMNIBOT_PORTS_POSIX_HISTOGRAM_H
#define OMNIBOT_PORTS_POSIX_HISTOGRAM_H

#include <stdint.h>
#include <stdio.h>

enum { HISTOGRAM_CLASSES = 1000, HISTOGRAM_CLASS_NS = 2000 };

typedef struct {
    uint64_t count, sum_ns, min_ns, max_ns;
    uint32_t in_class[HISTOGRAM_CLASSES];
} histogram_t;

void histogram_add(histogram_t *histogram, uint64_t time_ns);

/// Writes it as a JSON object: count, min_us, mean_us, max_us, class_us and the classes up to the last that is not
/// empty.
void histogram_write(const histogram_t *histogram, FILE *file);

#endif
