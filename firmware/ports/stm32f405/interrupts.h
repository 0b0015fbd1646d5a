// SPDX-License-Identifier: MIT
// The handlers that the vector table of startup.c names.
#ifndef OMNIBOT_STM32F405_INTERRUPTS_H
#define OMNIBOT_STM32F405_INTERRUPTS_H

void reset_handler(void);
void usart1_interrupt(void);
void systick_interrupt(void);

#endif
