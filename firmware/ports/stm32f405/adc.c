// SPDX-License-Identifier: MIT
#include "adc.h"

#include <math.h>

void adc_start(adc_t *adc, adc_registers_t *registers, adc_common_registers_t *common, const adc_wiring_t *wiring)
{
    adc->registers = registers;
    adc->wiring = *wiring;
    adc->battery_V = NAN;
    const uint32_t channel = wiring->channel;
    reg_write(&common->ccr, ADC_CCR_ADCPRE_BY_4); // 21 MHz of APB2's 84
    // The longest sampling, 23 µs: the divider has a source resistance of some kΩ. Three bits a channel, ten channels
    // in smpr2, the rest in smpr1.
    reg_t *const sampling = channel < 10 ? &registers->smpr2 : &registers->smpr1;
    reg_write(sampling, ADC_SMPR_480_CYCLES << (3u * (channel % 10u)));
    reg_write(&registers->sqr1, 0); // one conversion
    reg_write(&registers->sqr3, channel);
    reg_write(&registers->cr2, ADC_CR2_ADON);
}

static void take(adc_t *adc, float voltage_V)
{
    const bool first = !(adc->battery_V >= 0.0f);
    adc->battery_V = first ? voltage_V : adc->battery_V + (voltage_V - adc->battery_V) / (float)ADC_SMOOTHING;
}

void adc_tick(adc_t *adc)
{
    if ((reg_read(&adc->registers->sr) & ADC_SR_EOC) != 0) {
        const uint32_t reading = reg_read(&adc->registers->dr) & 0xFFFu;
        take(adc, (float)reading * adc->wiring.volt_per_bit);
    }
    reg_write(&adc->registers->cr2, ADC_CR2_ADON | ADC_CR2_SWSTART);
}
