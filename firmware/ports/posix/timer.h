// SPDX-License-Identifier: MIT
// The process's own control tick: instants on an absolute grid of the monotonic clock, so that lateness never adds up.
#ifndef OMNIBOT_PORTS_POSIX_TIMER_H
#define OMNIBOT_PORTS_POSIX_TIMER_H

#include <stdint.h>

typedef struct {
    int handle; // a timerfd; −1: none
    uint64_t next_ns;
    uint64_t period_ns;
} period_timer_t;

/// Now on the monotonic clock.
uint64_t timer_now_ns(void);

/// Starts a timer; handle −1 and errno on failure.
period_timer_t timer_start(uint32_t period_us);

/// How many periods have ended since the last call, 0 if none; `late_ns` is how long ago the last of them did.
uint64_t timer_expired(period_timer_t *timer, uint64_t *late_ns);

#endif
