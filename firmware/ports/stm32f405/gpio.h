// SPDX-License-Identifier: MIT
// Pins (RM0090 8.4). A board's pins are a table of gpio_pin_t in its header.
#ifndef OMNIBOT_STM32F405_GPIO_H
#define OMNIBOT_STM32F405_GPIO_H

#include "registers.h"

typedef enum { GPIO_INPUT, GPIO_OUTPUT, GPIO_ALTERNATE, GPIO_ANALOG } gpio_mode_t; // MODER's values
typedef enum { GPIO_FLOATING, GPIO_PULL_UP, GPIO_PULL_DOWN } gpio_pull_t;          // PUPDR's values

typedef struct {
    gpio_registers_t *port;
    uint8_t pin; // 0 … 15
    gpio_mode_t mode;
    gpio_pull_t pull;
    uint8_t function; // AF0 … AF15, of GPIO_ALTERNATE
} gpio_pin_t;

/// One access that leaves the port's other pins alone; safe against interrupts.
void gpio_write(gpio_registers_t *port, uint8_t pin, bool high);

/// An output starts low: its level is set before the pin is made one. The port's clock must be on.
void gpio_configure(const gpio_pin_t *pin);

#endif
