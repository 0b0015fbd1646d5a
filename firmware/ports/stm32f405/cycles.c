// SPDX-License-Identifier: MIT
#include "cycles.h"

void cycles_start(cycles_t *cycles, scb_registers_t *core, dwt_registers_t *registers, uint32_t core_Hz)
{
    cycles->registers = registers;
    cycles->core_Hz = core_Hz;
    reg_set(&core->demcr, SCB_DEMCR_TRCENA); // the counter has no clock without
    reg_write(&registers->cyccnt, 0);
    reg_set(&registers->ctrl, DWT_CTRL_CYCCNTENA);
    const uint32_t first = reg_read(&registers->cyccnt);
    cycles->works = reg_read(&registers->cyccnt) != first;
}

uint32_t cycles_now(const cycles_t *cycles)
{
    return cycles->works ? reg_read(&cycles->registers->cyccnt) : 0;
}

uint32_t cycles_to_ns(const cycles_t *cycles, uint32_t count)
{
    const uint64_t ns = (uint64_t)count * 1000u / (cycles->core_Hz / 1000000u);
    return ns < UINT32_MAX ? (uint32_t)ns : UINT32_MAX;
}
