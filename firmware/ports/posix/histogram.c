// SPDX-License-Identifier: MIT
#include "histogram.h"

#include <inttypes.h>

void histogram_add(histogram_t *histogram, uint64_t time_ns)
{
    const uint64_t place = time_ns / HISTOGRAM_CLASS_NS;
    histogram->in_class[place < HISTOGRAM_CLASSES ? place : HISTOGRAM_CLASSES - 1]++;
    histogram->min_ns = histogram->count == 0 || time_ns < histogram->min_ns ? time_ns : histogram->min_ns;
    histogram->max_ns = time_ns > histogram->max_ns ? time_ns : histogram->max_ns;
    histogram->sum_ns += time_ns;
    histogram->count++;
}

static int classes_in_use(const histogram_t *histogram)
{
    int classes = HISTOGRAM_CLASSES;
    while (classes > 0 && histogram->in_class[classes - 1] == 0) {
        classes--;
    }
    return classes;
}

void histogram_write(const histogram_t *histogram, FILE *file)
{
    const double mean_ns = histogram->count > 0 ? (double)histogram->sum_ns / (double)histogram->count : 0.0;
    fprintf(file,
            "{\"count\": %" PRIu64 ", \"min_us\": %.3f, \"mean_us\": %.3f, \"max_us\": %.3f, \"class_us\": %.3f, ",
            histogram->count, (double)histogram->min_ns * 1e-3, mean_ns * 1e-3, (double)histogram->max_ns * 1e-3,
            HISTOGRAM_CLASS_NS * 1e-3);
    fputs("\"classes\": [", file);
    for (int i = 0; i < classes_in_use(histogram); i++) {
        fprintf(file, "%s%" PRIu32, i > 0 ? ", " : "", histogram->in_class[i]);
    }
    fputs("]}", file);
}
