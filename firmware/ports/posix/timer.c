// SPDX-License-Identifier: MIT
#define _DEFAULT_SOURCE
#include "timer.h"

#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define NS_PER_S 1000000000u

static struct timespec instant(uint64_t time_ns)
{
    return (struct timespec){.tv_sec = (time_t)(time_ns / NS_PER_S), .tv_nsec = (long)(time_ns % NS_PER_S)};
}

uint64_t timer_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * NS_PER_S + (uint64_t)now.tv_nsec;
}

period_timer_t timer_start(uint32_t period_us)
{
    period_timer_t timer = {.handle = -1, .period_ns = (uint64_t)period_us * 1000u};
    timer.next_ns = timer_now_ns() + timer.period_ns;
    const struct itimerspec times = {.it_value = instant(timer.next_ns), .it_interval = instant(timer.period_ns)};
    timer.handle = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    if (timer.handle >= 0 && timerfd_settime(timer.handle, TFD_TIMER_ABSTIME, &times, NULL) != 0) {
        close(timer.handle);
        timer.handle = -1;
    }
    return timer;
}

uint64_t timer_expired(period_timer_t *timer, uint64_t *late_ns)
{
    uint64_t periods = 0;
    if (read(timer->handle, &periods, sizeof periods) != (ssize_t)sizeof periods) {
        return 0;
    }
    const uint64_t now_ns = timer_now_ns();
    timer->next_ns += periods * timer->period_ns;
    const uint64_t last_ns = timer->next_ns - timer->period_ns;
    *late_ns = now_ns > last_ns ? now_ns - last_ns : 0;
    return periods;
}
