// SPDX-License-Identifier: MIT
// What the core does out of reset: bridges off before anything else, then the FPU, then memory as C expects it.
#include "board.h"
#include "interrupts.h"
#include "registers.h"

#include <stdint.h>

int main(void);

// Placed by stm32f405.ld.
extern uint32_t stack_top[];
extern uint32_t data_start[], data_end[], bss_start[], bss_end[];
extern const uint32_t data_image[];

typedef void (*handler_t)(void);

enum { EXCEPTION_COUNT = 16, EXCEPTION_SYSTICK = 15 };

typedef struct {
    uint32_t *initial_stack;
    handler_t handler[EXCEPTION_COUNT + IRQ_COUNT - 1];
} vectors_t;

static_assert(sizeof(handler_t) != 4 || sizeof(vectors_t) == 4 * (EXCEPTION_COUNT + IRQ_COUNT), "vector table");

static void stop(void)
{
    board_bridges_off();
    for (;;) {
    }
}

#define EXCEPTION(number) [(number)-1]
#define INTERRUPT(number) [EXCEPTION_COUNT + (number)-1]

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    .initial_stack = stack_top,
    .handler =
        {
            EXCEPTION(1) = reset_handler,
            EXCEPTION(2) = stop,
            EXCEPTION(3) = stop,
            EXCEPTION(EXCEPTION_SYSTICK) = systick_interrupt,
            INTERRUPT(IRQ_USART1) = usart1_interrupt,
        },
};

void reset_handler(void)
{
    board_bridges_off();
    reg_set(&scb.cpacr, SCB_CPACR_CP10_CP11);
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    for (uint32_t i = 0; data_start + i < data_end; i++) {
        data_start[i] = data_image[i];
    }
    for (uint32_t *word = bss_start; word < bss_end; word++) {
        *word = 0;
    }
    (void)main();
}
