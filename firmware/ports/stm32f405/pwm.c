// SPDX-License-Identifier: MIT
#include "pwm.h"

#define OFF (TIM_BDTR_OSSI | TIM_BDTR_OSSR | TIM_BDTR_BKE) // break input active low, driven low while off

void pwm_start(pwm_t *pwm, timer_registers_t *timer, uint32_t timer_Hz)
{
    pwm->timer = timer;
    pwm->period = timer_Hz / PWM_RATE_HZ;
    reg_write(&timer->bdtr, OFF);
    reg_write(&timer->arr, pwm->period - 1u);
    for (uint32_t channel = 0; channel < PWM_CHANNELS; channel++) {
        reg_write(&timer->ccr[channel], 0);
    }
    reg_write(&timer->ccmr1, TIM_CCMR_PWM1_PRELOAD | TIM_CCMR_PWM1_PRELOAD << 8);
    reg_write(&timer->ccmr2, TIM_CCMR_PWM1_PRELOAD);
    reg_write(&timer->ccer, TIM_CCER_CC1E | TIM_CCER_CC2E | TIM_CCER_CC3E);
    reg_write(&timer->egr, TIM_EGR_UG); // takes over what is preloaded
    reg_write(&timer->cr1, TIM_CR1_ARPE | TIM_CR1_CEN);
}

void pwm_enable(pwm_t *pwm)
{
    reg_write(&pwm->timer->sr, ~TIM_SR_BIF); // cleared by writing 0; ones change nothing
    reg_write(&pwm->timer->bdtr, OFF | TIM_BDTR_MOE);
}

void pwm_disable(pwm_t *pwm)
{
    reg_write(&pwm->timer->bdtr, OFF);
}

void pwm_set(pwm_t *pwm, uint32_t channel, float share)
{
    const float counts = share * (float)pwm->period + 0.5f;
    reg_write(&pwm->timer->ccr[channel], (uint32_t)counts);
}

bool pwm_has_tripped(const pwm_t *pwm)
{
    return (reg_read(&pwm->timer->sr) & TIM_SR_BIF) != 0;
}
