// SPDX-License-Identifier: MIT
// The instructions that C has no words for (PM0214 3.11). The host's tests bring their own.
#ifndef OMNIBOT_STM32F405_CORE_H
#define OMNIBOT_STM32F405_CORE_H

#ifdef OMNIBOT_REGISTER_MODEL
void core_mask_interrupts(void);
void core_unmask_interrupts(void);
void core_wait_for_interrupt(void);
void core_synchronise(void);
#else
static inline void core_mask_interrupts(void)
{
    __asm__ volatile("cpsid i" ::: "memory");
}

static inline void core_unmask_interrupts(void)
{
    __asm__ volatile("cpsie i" ::: "memory");
}

static inline void core_wait_for_interrupt(void)
{
    __asm__ volatile("wfi" ::: "memory");
}

/// What was written before is in force after.
static inline void core_synchronise(void)
{
    __asm__ volatile("dsb\n\tisb" ::: "memory");
}
#endif

#endif
