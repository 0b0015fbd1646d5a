// SPDX-License-Identifier: MIT
#include "watchdog.h"

enum { LSI_KHz = 32, PRESCALER = 4, RELOAD = WATCHDOG_TIMEOUT_MS * LSI_KHz / PRESCALER, RELOAD_MAX = 0xFFF };
static_assert(RELOAD <= RELOAD_MAX, "the reload register has 12 bits");
static_assert(64 * RELOAD_MAX / LSI_KHz >= WATCHDOG_STRETCHED_MS, "what the header says");

// New settings are taken over within five cycles of the 32 kHz (RM0090 21.4.4), 0.3 ms at the slowest.
#define UPDATE_POLLS WAIT_POLLS(1000, 168)

static bool set_timeout(iwdg_registers_t *registers, uint32_t prescaler, uint32_t reload)
{
    reg_write(&registers->kr, IWDG_KR_UNLOCK);
    reg_write(&registers->pr, prescaler);
    reg_write(&registers->rlr, reload);
    const bool taken = wait_until(&registers->sr, IWDG_SR_PVU | IWDG_SR_RVU, 0, UPDATE_POLLS);
    reg_write(&registers->kr, IWDG_KR_RELOAD);
    return taken;
}

bool watchdog_start(iwdg_registers_t *registers)
{
    reg_write(&registers->kr, IWDG_KR_START);
    return set_timeout(registers, IWDG_PR_BY_4, RELOAD);
}

bool watchdog_stretch(iwdg_registers_t *registers)
{
    return set_timeout(registers, IWDG_PR_BY_64, RELOAD_MAX);
}

bool watchdog_restore(iwdg_registers_t *registers)
{
    return set_timeout(registers, IWDG_PR_BY_4, RELOAD);
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
