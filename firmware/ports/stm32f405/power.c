// SPDX-License-Identifier: MIT
#include "power.h"

#include "messages.h"

uint8_t power_reset_cause(rcc_registers_t *clocks)
{
    // A power-on sets the brown-out flag too, and every cause sets the pin's: the chip pulls its own pin.
    static const struct {
        uint32_t flag;
        uint8_t cause;
    } most_telling_first[] = {
        {RCC_CSR_IWDGRSTF | RCC_CSR_WWDGRSTF, RESET_CAUSE_WATCHDOG},
        {RCC_CSR_SFTRSTF, RESET_CAUSE_SOFTWARE},
        {RCC_CSR_PORRSTF, RESET_CAUSE_POWER},
        {RCC_CSR_BORRSTF, RESET_CAUSE_BROWN_OUT},
        {RCC_CSR_PINRSTF, RESET_CAUSE_PIN},
    };
    const uint32_t flags = reg_read(&clocks->csr);
    reg_set(&clocks->csr, RCC_CSR_RMVF);
    for (uint32_t i = 0; i < sizeof most_telling_first / sizeof most_telling_first[0]; i++) {
        if ((flags & most_telling_first[i].flag) != 0) {
            return most_telling_first[i].cause;
        }
    }
    return RESET_CAUSE_UNKNOWN;
}

void power_start(pwr_registers_t *power)
{
    reg_change(&power->cr, PWR_CR_PLS_MASK, PWR_CR_PLS_2V9 | PWR_CR_PVDE);
}

bool power_is_low(const pwr_registers_t *power)
{
    return (reg_read(&power->csr) & PWR_CSR_PVDO) != 0;
}
