// SPDX-License-Identifier: MIT
// What the LED says. Pure.
//
//   IDLE      a flash of 50 ms every second; two of them when the clock is not the crystal's
//   TRACKING  on
//   FAULT n   n flashes of 200 ms, then a second of dark
//   BOOT      dark
#ifndef OMNIBOT_STM32F405_LED_H
#define OMNIBOT_STM32F405_LED_H

#include <stdbool.h>
#include <stdint.h>

/// Whether it is on at a time, in a MODE_… with a FAULT_… of the wire.
bool led_is_on(uint8_t mode, uint8_t fault, bool on_crystal, uint32_t time_ms);

#endif
