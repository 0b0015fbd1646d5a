// SPDX-License-Identifier: MIT
#include "board.h"

#include "board_header.h"
#include "gpio.h"

static const gpio_pin_t pins[] = BOARD_PINS;

/// A peripheral answers two cycles after its clock is on (erratum 2.1.13 of the STM32F405): reading back takes longer.
static void enable_clock(reg_t *enable, uint32_t clocks)
{
    reg_set(enable, clocks);
    (void)reg_read(enable);
}

void board_bridges_off(void)
{
    static const gpio_pin_t enable = {&BOARD_BRIDGE_ENABLE_PORT, BOARD_BRIDGE_ENABLE_PIN, GPIO_OUTPUT, GPIO_FLOATING,
                                      0};
    enable_clock(&rcc.ahb1enr, BOARD_AHB1_CLOCKS);
    gpio_configure(&enable);
}

static void start_tick(uint32_t core_Hz, uint32_t rate_Hz)
{
    reg_write(&systick.load, core_Hz / rate_Hz - 1u);
    reg_write(&systick.val, 0);
    reg_write(&systick.ctrl, SYSTICK_CTRL_CLKSOURCE_CORE | SYSTICK_CTRL_TICKINT | SYSTICK_CTRL_ENABLE);
}

static void enable_interrupt(uint32_t number)
{
    reg_write(&nvic.iser[number / 32u], 1u << (number % 32u)); // zeros change nothing
}

void board_start(board_t *board)
{
    board->clock = clock_start(&rcc, &flash_interface, BOARD_CRYSTAL_MHz);
    enable_clock(&rcc.apb1enr, BOARD_APB1_CLOCKS);
    enable_clock(&rcc.apb2enr, BOARD_APB2_CLOCKS);
    for (uint32_t i = 0; i < sizeof pins / sizeof pins[0]; i++) {
        gpio_configure(&pins[i]);
    }
    usart_start(&board->usart, &usart1, board->clock.apb2_Hz, BOARD_UART_BITS_PER_S);
    link_init(&board->link, &board->usart);
    enable_interrupt(IRQ_USART1);
    start_tick(board->clock.core_Hz, 1000);
}

uint32_t board_periods(board_t *board)
{
    const uint32_t now = atomic_load_explicit(&board->ticks, memory_order_relaxed);
    const uint32_t passed = now - board->ticks_done;
    board->ticks_done = now;
    return passed;
}

void board_pump(board_t *board)
{
    __asm__ volatile("cpsid i" ::: "memory");
    usart_interrupt(&board->usart);
    __asm__ volatile("cpsie i" ::: "memory");
}

void board_sleep(void)
{
    __asm__ volatile("wfi" ::: "memory");
}
