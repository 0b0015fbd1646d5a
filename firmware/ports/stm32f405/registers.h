// SPDX-License-Identifier: MIT
// The registers that this port uses, declared from the facts of RM0090 (STM32F405/407 reference manual, revision 19)
// and, for the core, of PM0214 (Cortex-M4 programming manual). Each block names its section. The instances are symbols
// whose addresses stand in stm32f405.ld; drivers are given a pointer to theirs.
#ifndef OMNIBOT_STM32F405_REGISTERS_H
#define OMNIBOT_STM32F405_REGISTERS_H

#include "access.h"

#include <assert.h>
#include <stddef.h>

#define RESERVED_WORDS(from, to) (((to) - (from)) / 4u)
#define BIT(number) ((uint32_t)1u << (number))
#define FIELD(value, first_bit) ((uint32_t)(value) << (first_bit))
#define REGISTER_AT(type, member, offset) static_assert(offsetof(type, member) == (offset), #type "." #member)

// ---- RM0090 7.3 RCC registers

typedef struct {
    reg_t cr, pllcfgr, cfgr, cir;
    reg_t ahb1rstr, ahb2rstr, ahb3rstr, reserved_1c, apb1rstr, apb2rstr, reserved_28[2];
    reg_t ahb1enr, ahb2enr, ahb3enr, reserved_3c, apb1enr, apb2enr, reserved_48[2];
    reg_t ahb1lpenr, ahb2lpenr, ahb3lpenr, reserved_5c, apb1lpenr, apb2lpenr, reserved_68[2];
    reg_t bdcr, csr;
} rcc_registers_t;
REGISTER_AT(rcc_registers_t, cir, 0x0C);
REGISTER_AT(rcc_registers_t, apb2rstr, 0x24);
REGISTER_AT(rcc_registers_t, ahb1enr, 0x30);
REGISTER_AT(rcc_registers_t, apb1enr, 0x40);
REGISTER_AT(rcc_registers_t, apb2enr, 0x44);
REGISTER_AT(rcc_registers_t, bdcr, 0x70);
REGISTER_AT(rcc_registers_t, csr, 0x74);

#define RCC_CR_HSION BIT(0)
#define RCC_CR_HSIRDY BIT(1)
#define RCC_CR_HSEON BIT(16)
#define RCC_CR_HSERDY BIT(17)
#define RCC_CR_HSEBYP BIT(18)
#define RCC_CR_CSSON BIT(19)
#define RCC_CR_PLLON BIT(24)
#define RCC_CR_PLLRDY BIT(25)
#define RCC_PLLCFGR_M(division) FIELD(division, 0)
#define RCC_PLLCFGR_N(multiplier) FIELD(multiplier, 6)
#define RCC_PLLCFGR_P(division) FIELD((division) / 2u - 1u, 16) // 2, 4, 6 or 8
#define RCC_PLLCFGR_SRC_HSE BIT(22)
#define RCC_PLLCFGR_Q(division) FIELD(division, 24)
#define RCC_CFGR_SW_MASK FIELD(3, 0)
#define RCC_CFGR_SW_HSI FIELD(0, 0)
#define RCC_CFGR_SW_PLL FIELD(2, 0)
#define RCC_CFGR_SWS_MASK FIELD(3, 2)
#define RCC_CFGR_SWS_HSI FIELD(0, 2)
#define RCC_CFGR_SWS_PLL FIELD(2, 2)
#define RCC_CFGR_HPRE_MASK FIELD(15, 4) // 0: not divided
#define RCC_CFGR_PPRE1_MASK FIELD(7, 10)
#define RCC_CFGR_PPRE1_BY_4 FIELD(5, 10)
#define RCC_CFGR_PPRE2_MASK FIELD(7, 13)
#define RCC_CFGR_PPRE2_BY_2 FIELD(4, 13)
#define RCC_CIR_CSSF BIT(7)
#define RCC_CIR_CSSC BIT(23)
#define RCC_AHB1ENR_GPIO(port) BIT((uint32_t)(port)) // A is 0
#define RCC_APB1ENR_TIM2 BIT(0)
#define RCC_APB1ENR_TIM3 BIT(1)
#define RCC_APB1ENR_TIM4 BIT(2)
#define RCC_APB1ENR_TIM5 BIT(3)
#define RCC_APB1ENR_CAN1 BIT(25)
#define RCC_APB1ENR_PWR BIT(28)
#define RCC_APB2ENR_TIM1 BIT(0)
#define RCC_APB2ENR_TIM8 BIT(1)
#define RCC_APB2ENR_USART1 BIT(4)
#define RCC_APB2ENR_ADC1 BIT(8)
#define RCC_CSR_RMVF BIT(24)
#define RCC_CSR_BORRSTF BIT(25)
#define RCC_CSR_PINRSTF BIT(26)
#define RCC_CSR_PORRSTF BIT(27)
#define RCC_CSR_SFTRSTF BIT(28)
#define RCC_CSR_IWDGRSTF BIT(29)
#define RCC_CSR_WWDGRSTF BIT(30)
#define RCC_CSR_LPWRRSTF BIT(31)

// ---- RM0090 3.9 Flash interface registers

typedef struct {
    reg_t acr, keyr, optkeyr, sr, cr, optcr;
} flash_registers_t;
REGISTER_AT(flash_registers_t, optcr, 0x14);

#define FLASH_ACR_LATENCY_MASK FIELD(7, 0)
#define FLASH_ACR_PRFTEN BIT(8)
#define FLASH_ACR_ICEN BIT(9)
#define FLASH_ACR_DCEN BIT(10)
#define FLASH_ACR_DCRST BIT(12)
#define FLASH_KEY1 0x45670123u
#define FLASH_KEY2 0xCDEF89ABu
#define FLASH_SR_EOP BIT(0)
#define FLASH_SR_ERRORS (BIT(1) | FIELD(15, 4)) // OPERR, WRPERR, PGAERR, PGPERR, PGSERR
#define FLASH_SR_BSY BIT(16)
#define FLASH_CR_PG BIT(0)
#define FLASH_CR_SER BIT(1)
#define FLASH_CR_SNB(sector) FIELD(sector, 3)
#define FLASH_CR_PSIZE_32 FIELD(2, 8)
#define FLASH_CR_STRT BIT(16)
#define FLASH_CR_LOCK BIT(31)

/// A sector of 128 kB, as words (RM0090 3.3, table 5).
typedef struct {
    reg_t words[32768];
} flash_sector_t;

// ---- RM0090 5.4 Power control registers

typedef struct {
    reg_t cr, csr;
} pwr_registers_t;
REGISTER_AT(pwr_registers_t, csr, 0x04);

#define PWR_CR_PVDE BIT(4)
#define PWR_CR_PLS_MASK FIELD(7, 5)
#define PWR_CR_PLS_2V9 FIELD(7, 5)
#define PWR_CR_VOS BIT(14) // scale 1: 168 MHz; its value after reset
#define PWR_CSR_PVDO BIT(2)

// ---- RM0090 8.4 GPIO registers

typedef struct {
    reg_t moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afr[2];
} gpio_registers_t;
REGISTER_AT(gpio_registers_t, bsrr, 0x18);
REGISTER_AT(gpio_registers_t, afr, 0x20);

// ---- RM0090 13.13 ADC registers; the common ones follow the third converter's

typedef struct {
    reg_t sr, cr1, cr2, smpr1, smpr2, jofr[4], htr, ltr, sqr1, sqr2, sqr3, jsqr, jdr[4], dr;
} adc_registers_t;
REGISTER_AT(adc_registers_t, smpr1, 0x0C);
REGISTER_AT(adc_registers_t, sqr1, 0x2C);
REGISTER_AT(adc_registers_t, sqr3, 0x34);
REGISTER_AT(adc_registers_t, dr, 0x4C);

typedef struct {
    reg_t csr, ccr, cdr;
} adc_common_registers_t;
REGISTER_AT(adc_common_registers_t, ccr, 0x04);

#define ADC_SR_EOC BIT(1)
#define ADC_SR_STRT BIT(4)
#define ADC_SR_OVR BIT(5)
#define ADC_CR2_ADON BIT(0)
#define ADC_CR2_SWSTART BIT(30)
#define ADC_SMPR_480_CYCLES 7u
#define ADC_CCR_ADCPRE_BY_4 BIT(16) // at most 36 MHz

// ---- RM0090 17.4 (TIM1, TIM8) and 18.4 (TIM2 … TIM5) registers: one layout, the latter without rcr and bdtr

typedef struct {
    reg_t cr1, cr2, smcr, dier, sr, egr, ccmr1, ccmr2, ccer, cnt, psc, arr, rcr, ccr[4], bdtr, dcr, dmar;
} timer_registers_t;
REGISTER_AT(timer_registers_t, smcr, 0x08);
REGISTER_AT(timer_registers_t, egr, 0x14);
REGISTER_AT(timer_registers_t, ccmr1, 0x18);
REGISTER_AT(timer_registers_t, ccer, 0x20);
REGISTER_AT(timer_registers_t, cnt, 0x24);
REGISTER_AT(timer_registers_t, arr, 0x2C);
REGISTER_AT(timer_registers_t, ccr, 0x34);
REGISTER_AT(timer_registers_t, bdtr, 0x44);

#define TIM_CR1_CEN BIT(0)
#define TIM_CR1_ARPE BIT(7)
#define TIM_SMCR_SMS_ENCODER_BOTH FIELD(3, 0) // counts the edges of both inputs
#define TIM_SR_BIF BIT(7)
#define TIM_EGR_UG BIT(0)
#define TIM_CCMR1_CC1S_TI1 BIT(0)
#define TIM_CCMR1_IC1F(filter) FIELD(filter, 4)
#define TIM_CCMR1_CC2S_TI2 BIT(8)
#define TIM_CCMR1_IC2F(filter) FIELD(filter, 12)
#define TIM_CCMR_PWM1_PRELOAD 0x68u // OCxM = 110: high while below the compare value; OCxPE
#define TIM_CCER_CC1E BIT(0)
#define TIM_CCER_CC2E BIT(4)
#define TIM_CCER_CC3E BIT(8)
#define TIM_BDTR_OSSI BIT(10)
#define TIM_BDTR_OSSR BIT(11)
#define TIM_BDTR_BKE BIT(12)
#define TIM_BDTR_BKP BIT(13) // 0: the break input is active low
#define TIM_BDTR_MOE BIT(15)

// ---- RM0090 21.4 IWDG registers

typedef struct {
    reg_t kr, pr, rlr, sr;
} iwdg_registers_t;
REGISTER_AT(iwdg_registers_t, sr, 0x0C);

#define IWDG_KR_RELOAD 0xAAAAu
#define IWDG_KR_UNLOCK 0x5555u
#define IWDG_KR_START 0xCCCCu
#define IWDG_PR_BY_4 0u
#define IWDG_PR_BY_64 4u
#define IWDG_SR_PVU BIT(0)
#define IWDG_SR_RVU BIT(1)

// ---- RM0090 30.6 USART registers

typedef struct {
    reg_t sr, dr, brr, cr1, cr2, cr3, gtpr;
} usart_registers_t;
REGISTER_AT(usart_registers_t, brr, 0x08);
REGISTER_AT(usart_registers_t, cr3, 0x14);

#define USART_SR_PE BIT(0)
#define USART_SR_FE BIT(1)
#define USART_SR_NF BIT(2)
#define USART_SR_ORE BIT(3)
#define USART_SR_RXNE BIT(5)
#define USART_SR_TXE BIT(7)
#define USART_CR1_RE BIT(2)
#define USART_CR1_TE BIT(3)
#define USART_CR1_RXNEIE BIT(5)
#define USART_CR1_TXEIE BIT(7)
#define USART_CR1_UE BIT(13)

// ---- RM0090 32.9 CAN registers

typedef struct {
    reg_t ir, dtr, dlr, dhr;
} can_mailbox_registers_t;

typedef struct {
    reg_t r1, r2;
} can_filter_registers_t;

typedef struct {
    reg_t mcr, msr, tsr, rfr[2], ier, esr, btr;
    reg_t reserved_20[RESERVED_WORDS(0x20, 0x180)];
    can_mailbox_registers_t tx[3], rx[2];
    reg_t reserved_1d0[RESERVED_WORDS(0x1D0, 0x200)];
    reg_t fmr, fm1r, reserved_208, fs1r, reserved_210, ffa1r, reserved_218, fa1r;
    reg_t reserved_220[RESERVED_WORDS(0x220, 0x240)];
    can_filter_registers_t filter[28];
} can_registers_t;
REGISTER_AT(can_registers_t, tsr, 0x08);
REGISTER_AT(can_registers_t, ier, 0x14);
REGISTER_AT(can_registers_t, esr, 0x18);
REGISTER_AT(can_registers_t, btr, 0x1C);
REGISTER_AT(can_registers_t, tx, 0x180);
REGISTER_AT(can_registers_t, rx, 0x1B0);
REGISTER_AT(can_registers_t, fmr, 0x200);
REGISTER_AT(can_registers_t, fm1r, 0x204);
REGISTER_AT(can_registers_t, fs1r, 0x20C);
REGISTER_AT(can_registers_t, ffa1r, 0x214);
REGISTER_AT(can_registers_t, fa1r, 0x21C);
REGISTER_AT(can_registers_t, filter, 0x240);

#define CAN_MCR_INRQ BIT(0)
#define CAN_MCR_SLEEP BIT(1)
#define CAN_MCR_TXFP BIT(2)
#define CAN_MCR_RFLM BIT(3)
#define CAN_MCR_NART BIT(4)
#define CAN_MCR_ABOM BIT(6)
#define CAN_MCR_DBF BIT(16)
#define CAN_MSR_INAK BIT(0)
#define CAN_MSR_SLAK BIT(1)
#define CAN_TSR_RQCP(mailbox) BIT(8u * (mailbox))
#define CAN_TSR_TXOK(mailbox) FIELD(2, 8u * (mailbox))
#define CAN_TSR_ABRQ(mailbox) BIT(8u * (mailbox) + 7u)
#define CAN_TSR_TME(mailbox) BIT(26u + (mailbox))
#define CAN_RFR_FMP_MASK FIELD(3, 0)
#define CAN_RFR_FULL BIT(3)
#define CAN_RFR_FOVR BIT(4)
#define CAN_RFR_RFOM BIT(5)
#define CAN_IER_FMPIE0 BIT(1)
#define CAN_IER_FMPIE1 BIT(4)
#define CAN_ESR_EWGF BIT(0)
#define CAN_ESR_EPVF BIT(1)
#define CAN_ESR_BOFF BIT(2)
#define CAN_ESR_TEC(word) ((uint8_t)(((word) >> 16) & 0xFFu))
#define CAN_ESR_REC(word) ((uint8_t)(((word) >> 24) & 0xFFu))
#define CAN_BTR_BRP(quanta) FIELD((quanta)-1u, 0)
#define CAN_BTR_TS1(quanta) FIELD((quanta)-1u, 16)
#define CAN_BTR_TS2(quanta) FIELD((quanta)-1u, 20)
#define CAN_BTR_SJW(quanta) FIELD((quanta)-1u, 24)
#define CAN_IR_TXRQ BIT(0)
#define CAN_IR_RTR BIT(1)
#define CAN_IR_IDE BIT(2)
#define CAN_IR_STID(id) FIELD(id, 21)
#define CAN_IR_STID_OF(word) ((uint16_t)((word) >> 21))
#define CAN_DTR_DLC_MASK FIELD(15, 0)
#define CAN_FMR_FINIT BIT(0)

// ---- RM0090 38.16 MCU debug component registers

typedef struct {
    reg_t idcode, cr, apb1_fz, apb2_fz;
} dbgmcu_registers_t;
REGISTER_AT(dbgmcu_registers_t, apb2_fz, 0x0C);

#define DBGMCU_APB1_FZ_IWDG_STOP BIT(12)
#define DBGMCU_APB2_FZ_TIM8_STOP BIT(1)

// ---- PM0214 4.5 SysTick

typedef struct {
    reg_t ctrl, load, val, calib;
} systick_registers_t;
REGISTER_AT(systick_registers_t, calib, 0x0C);

#define SYSTICK_CTRL_ENABLE BIT(0)
#define SYSTICK_CTRL_TICKINT BIT(1)
#define SYSTICK_CTRL_CLKSOURCE_CORE BIT(2)

// ---- PM0214 4.3 NVIC; the byte-wide priorities as words

typedef struct {
    reg_t iser[8], reserved_20[24], icer[8], reserved_a0[24], ispr[8], reserved_120[24], icpr[8];
    reg_t reserved_1a0[24], iabr[8], reserved_220[RESERVED_WORDS(0x220, 0x300)], ipr[21];
} nvic_registers_t;
REGISTER_AT(nvic_registers_t, icer, 0x80);
REGISTER_AT(nvic_registers_t, ipr, 0x300);

// ---- PM0214 4.4 System control block, 4.6 FPU: from CPUID on

typedef struct {
    reg_t cpuid, icsr, vtor, aircr, scr, ccr, shpr[3], shcsr, cfsr, hfsr, dfsr, mmfar, bfar, afsr;
    reg_t reserved_40[RESERVED_WORDS(0x40, 0x88)], cpacr;
    reg_t reserved_8c[RESERVED_WORDS(0x8C, 0xFC)], demcr;
} scb_registers_t;
REGISTER_AT(scb_registers_t, vtor, 0x08);
REGISTER_AT(scb_registers_t, aircr, 0x0C);
REGISTER_AT(scb_registers_t, ccr, 0x14);
REGISTER_AT(scb_registers_t, shpr, 0x18);
REGISTER_AT(scb_registers_t, shcsr, 0x24);
REGISTER_AT(scb_registers_t, cfsr, 0x28);
REGISTER_AT(scb_registers_t, hfsr, 0x2C);
REGISTER_AT(scb_registers_t, bfar, 0x38);
REGISTER_AT(scb_registers_t, cpacr, 0x88);
REGISTER_AT(scb_registers_t, demcr, 0xFC); // Armv7-M manual, C1.6.5

#define SCB_AIRCR_RESET (0x05FA0000u | BIT(2)) // the key, SYSRESETREQ
#define SCB_CCR_DIV_0_TRP BIT(4)
#define SCB_SHCSR_MEMFAULTENA BIT(16)
#define SCB_SHCSR_BUSFAULTENA BIT(17)
#define SCB_SHCSR_USGFAULTENA BIT(18)
#define SCB_CPACR_CP10_CP11 FIELD(15, 20)
#define SCB_DEMCR_TRCENA BIT(24)

// ---- Armv7-M architecture manual, C1.8: data watchpoint and trace

typedef struct {
    reg_t ctrl, cyccnt;
} dwt_registers_t;
REGISTER_AT(dwt_registers_t, cyccnt, 0x04);

#define DWT_CTRL_CYCCNTENA BIT(0)

// ---- RM0090 2.3 Memory map: the instances, placed by stm32f405.ld

extern rcc_registers_t rcc;
extern flash_registers_t flash_interface;
extern flash_sector_t settings_sectors[2];
extern pwr_registers_t pwr;
extern gpio_registers_t gpio_a, gpio_b, gpio_c, gpio_d;
extern adc_registers_t adc1;
extern adc_common_registers_t adc_common;
extern timer_registers_t tim1, tim2, tim3, tim4, tim5, tim8;
extern iwdg_registers_t iwdg;
extern usart_registers_t usart1;
extern can_registers_t can1;
extern dbgmcu_registers_t dbgmcu;
extern systick_registers_t systick;
extern nvic_registers_t nvic;
extern scb_registers_t scb;
extern dwt_registers_t dwt;

// Positions in the vector table (RM0090 12.1.3): the number of an interrupt in the NVIC.
enum { IRQ_CAN1_RX0 = 20, IRQ_CAN1_RX1 = 21, IRQ_USART1 = 37, IRQ_COUNT = 82 };

#endif
