// SPDX-License-Identifier: MIT
#include "gpio.h"

void gpio_write(gpio_registers_t *port, uint8_t pin, bool high)
{
    reg_write(&port->bsrr, high ? 1u << pin : 1u << (pin + 16u)); // set half, reset half
}

static void set_field(reg_t *reg, uint32_t index, uint32_t bits, uint32_t value)
{
    const uint32_t mask = (1u << bits) - 1u;
    reg_change(reg, mask << (bits * index), value << (bits * index));
}

void gpio_configure(const gpio_pin_t *pin)
{
    if (pin->mode == GPIO_OUTPUT) {
        gpio_write(pin->port, pin->pin, false);
    }
    if (pin->mode == GPIO_ALTERNATE) {
        set_field(&pin->port->afr[pin->pin / 8u], pin->pin % 8u, 4, pin->function);
    }
    set_field(&pin->port->pupdr, pin->pin, 2, pin->pull);
    set_field(&pin->port->moder, pin->pin, 2, pin->mode);
}
