// SPDX-License-Identifier: MIT
#include "watchdog.h"

enum { LSI_KHz = 32, PRESCALER = 4, RELOAD = WATCHDOG_TIMEOUT_MS * LSI_KHz / PRESCALER };
static_assert(RELOAD <= 0xFFF, "the reload register has 12 bits");

// New settings are taken over within five cycles of the 32 kHz (RM0090 21.4.4), 0.3 ms at the slowest.
#define UPDATE_POLLS WAIT_POLLS(1000, 168)

bool watchdog_start(iwdg_registers_t *registers)
{
    reg_write(&registers->kr, IWDG_KR_START);
    reg_write(&registers->kr, IWDG_KR_UNLOCK);
    reg_write(&registers->pr, IWDG_PR_BY_4);
    reg_write(&registers->rlr, RELOAD);
    const bool taken = wait_until(&registers->sr, IWDG_SR_PVU | IWDG_SR_RVU, 0, UPDATE_POLLS);
    reg_write(&registers->kr, IWDG_KR_RELOAD);
    return taken;
}

bool tick_is_healthy(const tick_health_t *health)
{
    return health->periods == 1 && health->app_in_order;
}

void watchdog_tick(iwdg_registers_t *registers, const tick_health_t *health)
{
    if (tick_is_healthy(health)) {
        reg_write(&registers->kr, IWDG_KR_RELOAD);
    }
}
