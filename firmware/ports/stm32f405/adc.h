// SPDX-License-Identifier: MIT
// The battery's voltage through a divider on one channel of ADC1 (RM0090 13). A period starts a conversion and reads
// the one before: nothing waits.
#ifndef OMNIBOT_STM32F405_ADC_H
#define OMNIBOT_STM32F405_ADC_H

#include "registers.h"

/// As the board's header says.
typedef struct {
    uint8_t channel;    // 0 … 15
    float volt_per_bit; // at the battery
} adc_wiring_t;

typedef struct {
    adc_registers_t *registers;
    adc_wiring_t wiring;
    float battery_V; // smoothed over some ADC_SMOOTHING periods; NaN until there is one
} adc_t;

enum { ADC_SMOOTHING = 8 };

void adc_start(adc_t *adc, adc_registers_t *registers, adc_common_registers_t *common, const adc_wiring_t *wiring);

/// A period has passed.
void adc_tick(adc_t *adc);

#endif
