// SPDX-License-Identifier: MIT
// A bare-metal image that runs frames through the firmware and tells how long that took by SysTick. Under QEMU's
// -icount an instruction takes a nanosecond, so this counts instructions. tests/tools/test_step_cost_qemu.py builds and
// runs it.
#include "app.h"
#include "frames.h" // of the test: `frames`, FRAME_COUNT
#include "messages.h"

extern uint32_t bss_begin, bss_end, stack_top;

static app_t app;

/// Everything that is counted.
__attribute__((noinline)) void workload(void)
{
    app_init(&app, &omnibot, 0, (app_port_t){.drives = 1u << DRIVE_LOCKSTEP, .drive = DRIVE_LOCKSTEP});
    frame_t answer;
    for (uint32_t i = 0; i < FRAME_COUNT; i++) {
        app_receive(&app, &frames[i]);
        while (app_transmit(&app, &answer)) {
        }
    }
}

// ---- the outside: semihosting, the FPU's switch, SysTick

static void semihosting(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

static void print(uint32_t number)
{
    char text[10] = {0};
    for (int i = 0; i < 8; i++) {
        text[i] = "0123456789abcdef"[number >> (28 - 4 * i) & 0xFu];
    }
    text[8] = '\n';
    semihosting(0x04, text); // SYS_WRITE0
}

static volatile uint32_t *const systick = (volatile uint32_t *)0xE000E010; // control, reload, value
static volatile uint32_t *const cpacr = (volatile uint32_t *)0xE000ED88;

static uint32_t ticks_of(uint32_t times)
{
    const uint32_t begin = systick[2];
    for (uint32_t i = 0; i < times; i++) {
        workload();
    }
    return (begin - systick[2]) & 0xFFFFFFu;
}

void reset(void)
{
    for (uint32_t *word = &bss_begin; word < &bss_end; word++) {
        *word = 0;
    }
    *cpacr |= 0xFu << 20; // FPU on
    __asm__ volatile("dsb\n isb");
    systick[1] = 0xFFFFFF;
    systick[2] = 0;
    systick[0] = 5; // processor clock, on
    print(ticks_of(1));
    print(ticks_of(3));
    semihosting(0x18, (const void *)0x20026); // SYS_EXIT: the application has ended
}

static void lost(void)
{
    print(0xFFFFFFFF);
    semihosting(0x18, (const void *)0x20023); // a run-time error
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top,         (const void *)reset, (const void *)lost, (const void *)lost,
    (const void *)lost, (const void *)lost,  (const void *)lost,
};
