// SPDX-License-Identifier: MIT
// The reference board, an STM32F405RGT6 in LQFP64: its pins, its crystal, its rates. Another board is another header of
// this form beside this one, chosen with -DOMNIBOT_BOARD=NAME. Alternate functions: data sheet DS8626, table 9.
#ifndef OMNIBOT_STM32F405_BOARD_OMNIBOT_H
#define OMNIBOT_STM32F405_BOARD_OMNIBOT_H

#define BOARD_NAME "omnibot"
#define BOARD_REVISION 1

#define BOARD_CRYSTAL_MHz 8
#define BOARD_UART_BITS_PER_S 1000000

// Below it the motors are not driven: 12 V nominal, three lithium cells at 3.0 V.
#define BOARD_SUPPLY_MINIMUM_V 9.0f

// The battery through 100 kOhm and 10 kOhm, 12 bits for 3.3 V.
#define BOARD_ADC                                                                                                      \
    {                                                                                                                  \
        .channel = 10, .volt_per_bit = 3.3f / 4096.0f * (100.0f + 10.0f) / 10.0f                                       \
    }

#define BOARD_LED_PORT gpio_c
#define BOARD_LED_PIN 5

// The bridges are off while the enable line is low; a resistor on the board holds it low through a reset. Signs: see
// 'One wheel at a time' in README.md.
#define BOARD_WHEELS                                                                                                   \
    {                                                                                                                  \
        .encoder = {{&tim5, 32, 1}, {&tim3, 16, 1}, {&tim4, 16, 1}},                                                   \
        .direction = {{&gpio_b, 12}, {&gpio_b, 13}, {&gpio_b, 14}}, .forwards = {1, 1, 1}, .enable = {&gpio_b, 15},    \
        .pwm = &tim8, .duty_max = 0.95f,                                                                               \
    }

// The clocks of everything that is named here.
#define BOARD_AHB1_CLOCKS (RCC_AHB1ENR_GPIO(0) | RCC_AHB1ENR_GPIO(1) | RCC_AHB1ENR_GPIO(2))
#define BOARD_APB1_CLOCKS (RCC_APB1ENR_TIM3 | RCC_APB1ENR_TIM4 | RCC_APB1ENR_TIM5 | RCC_APB1ENR_CAN1 | RCC_APB1ENR_PWR)
#define BOARD_APB2_CLOCKS (RCC_APB2ENR_TIM8 | RCC_APB2ENR_USART1 | RCC_APB2ENR_ADC1)

// clang-format off
#define BOARD_PINS                                                                 \
    {                                                                              \
        /* port, pin, mode, pull, function */                                      \
        {&gpio_a, 0, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM5_CH1, encoder 1 A */ \
        {&gpio_a, 1, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM5_CH2, encoder 1 B */ \
        {&gpio_b, 4, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM3_CH1, encoder 2 A */ \
        {&gpio_b, 5, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM3_CH2, encoder 2 B */ \
        {&gpio_b, 6, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM4_CH1, encoder 3 A */ \
        {&gpio_b, 7, GPIO_ALTERNATE, GPIO_PULL_UP, 2},   /* TIM4_CH2, encoder 3 B */ \
        {&gpio_a, 6, GPIO_ALTERNATE, GPIO_PULL_UP, 3},   /* TIM8_BKIN, bridges' fault, low */ \
        {&gpio_c, 6, GPIO_ALTERNATE, GPIO_PULL_DOWN, 3}, /* TIM8_CH1, PWM 1 */     \
        {&gpio_c, 7, GPIO_ALTERNATE, GPIO_PULL_DOWN, 3}, /* TIM8_CH2, PWM 2 */     \
        {&gpio_c, 8, GPIO_ALTERNATE, GPIO_PULL_DOWN, 3}, /* TIM8_CH3, PWM 3 */     \
        {&gpio_b, 12, GPIO_OUTPUT, GPIO_FLOATING, 0},    /* direction 1 */         \
        {&gpio_b, 13, GPIO_OUTPUT, GPIO_FLOATING, 0},    /* direction 2 */         \
        {&gpio_b, 14, GPIO_OUTPUT, GPIO_FLOATING, 0},    /* direction 3 */         \
        {&gpio_c, 0, GPIO_ANALOG, GPIO_FLOATING, 0},     /* ADC1_IN10, battery */  \
        {&gpio_c, 5, GPIO_OUTPUT, GPIO_FLOATING, 0},     /* LED */                 \
        {&gpio_b, 8, GPIO_ALTERNATE, GPIO_PULL_UP, 9},   /* CAN1_RX */             \
        {&gpio_b, 9, GPIO_ALTERNATE, GPIO_FLOATING, 9},  /* CAN1_TX */             \
        {&gpio_a, 9, GPIO_ALTERNATE, GPIO_FLOATING, 7},  /* USART1_TX */           \
        {&gpio_a, 10, GPIO_ALTERNATE, GPIO_PULL_UP, 7},  /* USART1_RX */           \
    }
// clang-format on

#endif
