// SPDX-License-Identifier: MIT
#include "board.h"

#include "board_header.h"
#include "core.h"
#include "gpio.h"
#include "led.h"
#include "messages.h"
#include "power.h"
#include "watchdog.h"

static const gpio_pin_t pins[] = BOARD_PINS;
static const wheels_wiring_t wheels_wiring = BOARD_WHEELS;
static const adc_wiring_t adc_wiring = BOARD_ADC;

__attribute__((section(".noinit"))) crash_t board_crash;

/// A peripheral answers two cycles after its clock is on (erratum 2.1.13 of the STM32F405): reading back takes longer.
static void enable_clock(reg_t *enable, uint32_t clocks)
{
    reg_set(enable, clocks);
    (void)reg_read(enable);
}

void board_bridges_off(void)
{
    const wheel_pin_t *pin = &wheels_wiring.enable;
    const gpio_pin_t enable = {.port = pin->port, .pin = pin->pin, .mode = GPIO_OUTPUT};
    enable_clock(&rcc.ahb1enr, BOARD_AHB1_CLOCKS);
    gpio_configure(&enable);
}

// ---- set-up

static void start_pins(void)
{
    enable_clock(&rcc.apb1enr, BOARD_APB1_CLOCKS);
    enable_clock(&rcc.apb2enr, BOARD_APB2_CLOCKS);
    for (uint32_t i = 0; i < sizeof pins / sizeof pins[0]; i++) {
        gpio_configure(&pins[i]);
    }
}

static void start_tick(uint32_t core_Hz, uint32_t period_us)
{
    reg_write(&systick.load, core_Hz / 1000000u * period_us - 1u); // 24 bits: up to 99 ms at 168 MHz
    reg_write(&systick.val, 0);
    reg_write(&systick.ctrl, SYSTICK_CTRL_CLKSOURCE_CORE | SYSTICK_CTRL_TICKINT | SYSTICK_CTRL_ENABLE);
}

static void enable_interrupt(uint32_t number)
{
    reg_write(&nvic.iser[number / 32u], 1u << (number % 32u)); // zeros change nothing
}

/// All of one priority: none interrupts another.
static void start_interrupts(void)
{
    enable_interrupt(IRQ_USART1);
    enable_interrupt(IRQ_CAN1_RX0);
    enable_interrupt(IRQ_CAN1_RX1);
}

/// Faults have handlers of their own, and a debugger that halts the core halts watchdog and PWM too.
static void start_core(void)
{
    reg_set(&scb.shcsr, SCB_SHCSR_MEMFAULTENA | SCB_SHCSR_BUSFAULTENA | SCB_SHCSR_USGFAULTENA);
    reg_set(&scb.ccr, SCB_CCR_DIV_0_TRP);
    reg_set(&dbgmcu.apb1_fz, DBGMCU_APB1_FZ_IWDG_STOP);
    reg_set(&dbgmcu.apb2_fz, DBGMCU_APB2_FZ_TIM8_STOP);
}

/// CAN wants the crystal: the internal oscillator's 1 % is twice what 1 Mbit/s bears.
static void start_lines(board_t *board, uint8_t node)
{
    usart_start(&board->usart, &usart1, board->clock.apb2_Hz, BOARD_UART_BITS_PER_S);
    const bool exact = board->clock.source == CLOCK_SOURCE_HSE_PLL;
    can_start(&board->can, &can1, exact ? board->clock.apb1_Hz : 0, node);
    link_init(&board->link, &board->can, &board->usart, node);
}

static void start_settings(board_t *board)
{
    board->flash = (flash_t){
        .registers = &flash_interface,
        .watchdog = &iwdg,
        .power = &pwr,
        .sector = settings_sectors,
        .first_sector = 10, // settings_sectors of stm32f405.ld
    };
    board->settings = flash_memory(&board->flash);
    board->keeps_settings = flash_answers(&flash_interface);
}

const settings_memory_t *board_settings(const board_t *board)
{
    return board->keeps_settings ? &board->settings : NULL;
}

void board_start(board_t *board, uint8_t node)
{
    board_bridges_off();
    start_core();
    const uint8_t cause = power_reset_cause(&rcc);
    board->reset_cause = crash_is_there(&board_crash) ? RESET_CAUSE_CRASH : cause;
    board->clock = clock_start(&rcc, &flash_interface, BOARD_CRYSTAL_MHz);
    start_pins();
    power_start(&pwr);
    start_settings(board);
    cycles_start(&board->cycles, &scb, &dwt, board->clock.core_Hz);
    wheels_start(&board->wheels, &wheels_wiring, &omnibot_motor, board->clock.timer_Hz);
    adc_start(&board->adc, &adc1, &adc_common, &adc_wiring);
    supply_init(&board->supply, BOARD_SUPPLY_MINIMUM_V);
    start_lines(board, node);
    start_interrupts();
    start_tick(board->clock.core_Hz, omnibot.control_period_us);
    (void)watchdog_start(&iwdg);
}

// ---- a period

void board_count_tick(board_t *board)
{
    atomic_fetch_add_explicit(&board->ticks, 1u, memory_order_relaxed);
}

uint32_t board_periods(board_t *board)
{
    const uint32_t now = atomic_load_explicit(&board->ticks, memory_order_relaxed);
    const uint32_t passed = now - board->ticks_done;
    board->ticks_done = now;
    return passed;
}

/// An emulator without a clock tree makes its conversions up: there the voltage stays unknown, and the motors off.
void board_tick(board_t *board)
{
    can_tick(&board->can);
    if (board->clock.source != CLOCK_SOURCE_UNKNOWN) {
        adc_tick(&board->adc);
    }
    supply_tick(&board->supply, board->adc.battery_V);
}

uint8_t board_motor_fault(const board_t *board)
{
    if (wheels_have_tripped(&board->wheels)) {
        return FAULT_BRIDGE;
    }
    return board->supply.low || power_is_low(&pwr) ? FAULT_SUPPLY : FAULT_NONE;
}

static uint8_t capped(uint32_t count)
{
    return (uint8_t)(count < UINT8_MAX ? count : UINT8_MAX);
}

app_health_t board_health(board_t *board)
{
    const can_condition_t can = can_condition(&board->can);
    return (app_health_t){
        .reset_cause = board->reset_cause,
        .clock_source = board->clock.source,
        .can_state = can.state,
        .can_tx_errors = can.transmit_errors,
        .can_rx_errors = can.receive_errors,
        .can_bus_offs = capped(board->can.bus_offs),
        .can_rx_lost = capped(atomic_load_explicit(&board->can.lost, memory_order_relaxed)),
        .supply_V = board->adc.battery_V,
    };
}

void board_feed_watchdog(uint32_t periods, bool app_in_order)
{
    watchdog_tick(&iwdg, &(tick_health_t){.periods = periods, .app_in_order = app_in_order});
}

void board_show(const board_t *board, uint8_t mode, uint8_t fault)
{
    const bool on_crystal = board->clock.source == CLOCK_SOURCE_HSE_PLL;
    const uint32_t time_ms = (uint32_t)((uint64_t)board->ticks_done * omnibot.control_period_us / 1000u);
    gpio_write(&BOARD_LED_PORT, BOARD_LED_PIN, led_is_on(mode, fault, on_crystal, time_ms));
}

// ---- the core

void board_pump(board_t *board)
{
    core_mask_interrupts();
    usart_interrupt(&board->usart);
    core_unmask_interrupts();
}

/// With interrupts masked: one that comes after the look ends the wait all the same.
void board_sleep(board_t *board)
{
    core_mask_interrupts();
    const bool idle = atomic_load_explicit(&board->ticks, memory_order_relaxed) == board->ticks_done;
    if (idle && !link_has_input(&board->link)) {
        core_wait_for_interrupt();
    }
    core_unmask_interrupts();
}

void board_reset(void)
{
    core_synchronise();
    reg_write(&scb.aircr, SCB_AIRCR_RESET);
    core_synchronise();
}
