// SPDX-License-Identifier: MIT
// What the core does out of reset: bridges off before anything else, then the FPU, then memory as C expects it.
#include "board.h"
#include "core.h"
#include "interrupts.h"
#include "registers.h"

#include <stddef.h>
#include <stdint.h>

int main(void);

// Placed by stm32f405.ld.
extern uint32_t stack_bottom[], stack_top[];
extern uint32_t data_start[], data_end[], bss_start[], bss_end[];
extern const uint32_t data_image[];

typedef void (*handler_t)(void);

enum { EXCEPTION_COUNT = 16, EXCEPTION_SYSTICK = 15 };

typedef struct {
    uint32_t *initial_stack;
    handler_t handler[EXCEPTION_COUNT + IRQ_COUNT - 1];
} vectors_t;

static_assert(sizeof(handler_t) != 4 || sizeof(vectors_t) / 4 == EXCEPTION_COUNT + IRQ_COUNT, "vector table");

/// The end of every fault: bridges off before anything else, then the record, then a new start. Called by fault_entry.
__attribute__((used)) void fault_handle(const exception_frame_t *frame);

void fault_handle(const exception_frame_t *frame)
{
    board_bridges_off();
    // A stack that has run out of the memory holds no frame.
    const uintptr_t address = (uintptr_t)frame;
    const bool whole = address >= (uintptr_t)stack_bottom && address <= (uintptr_t)stack_top - sizeof *frame;
    crash_record(&board_crash, &scb, whole ? frame : NULL);
    for (;;) {
        board_reset(); // takes effect within some cycles; the watchdog stands behind it
    }
}

/// With a stack of its own, since the fault may be that the other is used up. Bit 2 of the return value in lr says on
/// which stack the core has put the registers (PM0214 2.3.7).
__attribute__((naked)) void fault_entry(void)
{
    __asm__ volatile("tst lr, #4\n\t"
                     "ite eq\n\t"
                     "mrseq r0, msp\n\t"
                     "mrsne r0, psp\n\t"
                     "ldr r1, =fault_stack_top\n\t"
                     "mov sp, r1\n\t"
                     "b fault_handle\n\t"
                     ".ltorg");
}

#define EXCEPTION(number) [(number)-1]
#define INTERRUPT(number) [EXCEPTION_COUNT + (number)-1]

__attribute__((section(".vectors"), used, aligned(512))) static const vectors_t vectors = {
    stack_top,
    {
        EXCEPTION(1) = reset_handler,
        EXCEPTION(2) = fault_entry, // NMI: the crystal has stopped
        EXCEPTION(3) = fault_entry,
        EXCEPTION(4) = fault_entry,
        EXCEPTION(5) = fault_entry,
        EXCEPTION(6) = fault_entry,
        EXCEPTION(EXCEPTION_SYSTICK) = systick_interrupt,
        INTERRUPT(IRQ_CAN1_RX0) = can1_rx0_interrupt,
        INTERRUPT(IRQ_CAN1_RX1) = can1_rx1_interrupt,
        INTERRUPT(IRQ_USART1) = usart1_interrupt,
    },
};

/// As numbers, since C compares no pointers to two objects, and for C the ends of a section are two.
static uint32_t words_between(const uint32_t *start, const uint32_t *end)
{
    return (uint32_t)(((uintptr_t)end - (uintptr_t)start) / sizeof *start);
}

void reset_handler(void)
{
    board_bridges_off();
    reg_write(&scb.vtor, (uint32_t)(uintptr_t)&vectors); // a boot loader leaves its own
    reg_set(&scb.cpacr, SCB_CPACR_CP10_CP11);
    core_synchronise();
    for (uint32_t i = 0; i < words_between(data_start, data_end); i++) {
        data_start[i] = data_image[i];
    }
    for (uint32_t i = 0; i < words_between(bss_start, bss_end); i++) {
        bss_start[i] = 0;
    }
    (void)main();
}
