// SPDX-License-Identifier: MIT
// The app fuzzer's programs and oracles without the fuzzer: random programs, one after the other, as fast as they go.
//   flood FRAMES [SEED]    until so many frames went in; a program is its own seed, so that one alone can be run again
#include "program.h"

#include <errno.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { INSTRUCTIONS_A_PROGRAM = 1000, REPORT_EVERY_S = 60 };

static uint64_t seed; // of the program that runs, for the handler

const char *__asan_default_options(void);
const char *__ubsan_default_options(void);

// The sanitizers end by abort too, so that every find names its program.
const char *__asan_default_options(void)
{
    return "abort_on_error=1";
}

const char *__ubsan_default_options(void)
{
    return "abort_on_error=1:print_stacktrace=1";
}

static void name_program(int number)
{
    (void)number;
    (void)fprintf(stderr, "flood: found by program %" PRIu64 "; again: flood 1 %" PRIu64 "\n", seed, seed);
    _Exit(EXIT_FAILURE);
}

static double now_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1.0e-9 * (double)now.tv_nsec;
}

static uint64_t parse(const char *text)
{
    char *end = NULL;
    errno = 0;
    const uint64_t value = strtoull(text, &end, 10);
    if (errno != 0 || end == text || *end != '\0' || *text == '-') {
        (void)fprintf(stderr, "flood: %s is no whole number; say: flood FRAMES [SEED]\n", text);
        exit(2);
    }
    return value;
}

static void report(const subject_t *subject, uint64_t first, double begun_s)
{
    const double spent_s = now_s() - begun_s;
    (void)printf("%" PRIu64 " frames, %" PRIu64 " steps while TRACKING, programs %" PRIu64 " to %" PRIu64
                 ", %.1f s, %.0f frames/s: nothing found\n",
                 subject->frames, subject->steps, first, seed, spent_s, (double)subject->frames / spent_s);
    (void)fflush(stdout);
}

static void run_program(subject_t *subject)
{
    source_t source = {.random = seed * 0xD1342543DE82EF95u};
    program_start(subject, &source);
    for (int i = 0; i < INSTRUCTIONS_A_PROGRAM; i++) {
        program_step(subject, &source);
    }
}

int main(int argc, char **argv)
{
    if (argc < 2 || argc > 3) {
        (void)fprintf(stderr, "usage: flood FRAMES [SEED]\n");
        return 2;
    }
    static subject_t subject;
    const uint64_t frames = parse(argv[1]), first = argc > 2 ? parse(argv[2]) : 1;
    const double begun_s = now_s();
    double reported_s = begun_s;
    (void)signal(SIGABRT, name_program);
    for (seed = first;; seed++) {
        run_program(&subject);
        if (subject.frames >= frames) {
            report(&subject, first, begun_s);
            return EXIT_SUCCESS;
        }
        if (now_s() - reported_s > REPORT_EVERY_S) {
            reported_s = now_s();
            report(&subject, first, begun_s);
        }
    }
}
