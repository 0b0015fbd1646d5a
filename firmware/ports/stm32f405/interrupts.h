// SPDX-License-Identifier: MIT
// The handlers that the vector table of startup.c names.
#ifndef OMNIBOT_STM32F405_INTERRUPTS_H
#define OMNIBOT_STM32F405_INTERRUPTS_H

void reset_handler(void);
void fault_entry(void);
void usart1_interrupt(void);
void can1_rx0_interrupt(void);
void can1_rx1_interrupt(void);
void systick_interrupt(void);

#endif
