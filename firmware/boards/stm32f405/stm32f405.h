/* The registers of an STM32F405 that the board uses, by reference manual RM0090. */
#ifndef STM32F405_H
#define STM32F405_H

#include <stdint.h>

typedef volatile uint32_t reg_t;

typedef struct rcc {
    reg_t cr, pllcfgr, cfgr, cir, ahb1rstr[8], ahb1enr, ahb2enr, ahb3enr, unused, apb1enr, apb2enr;
} rcc_t;
typedef struct flash {
    reg_t acr;
} flash_t;
typedef struct gpio {
    reg_t moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afr[2];
} gpio_t;
typedef struct timer {
    reg_t cr1, cr2, smcr, dier, sr, egr, ccmr1, ccmr2, ccer, cnt, psc, arr, rcr, ccr[4], bdtr;
} timer_t;
typedef struct adc {
    reg_t sr, cr1, cr2, smpr1, smpr2, jofr[4], htr, ltr, sqr[3], jsqr, jdr[4];
} adc_t;
typedef struct can_mailbox {
    reg_t ir, dtr, dlr, dhr;
} can_mailbox_t;
typedef struct can {
    reg_t mcr, msr, tsr, rf0r, rf1r, ier, esr, btr, unused1[88];
    can_mailbox_t tx[3], rx[2];
    reg_t unused2[12], fmr, fm1r, unused3, fs1r, unused4, ffa1r, unused5, fa1r, unused6[8];
    reg_t filter[28][2];
} can_t;
typedef struct spi {
    reg_t cr1, cr2, sr, dr;
} spi_t;
typedef struct iwdg {
    reg_t kr, pr, rlr, sr;
} iwdg_t;

#define RCC ((rcc_t *)0x40023800)
#define FLASH_INTERFACE ((flash_t *)0x40023C00)
#define GPIOA ((gpio_t *)0x40020000)
#define GPIOB ((gpio_t *)0x40020400)
#define GPIOC ((gpio_t *)0x40020800)
#define TIM1 ((timer_t *)0x40010000)
#define TIM2 ((timer_t *)0x40000000)
#define TIM8 ((timer_t *)0x40010400)
#define ADC1 ((adc_t *)0x40012000)
#define ADC_COMMON_CCR (*(reg_t *)0x40012304)
#define CAN1 ((can_t *)0x40006400)
#define SPI1 ((spi_t *)0x40013000)
#define IWDG ((iwdg_t *)0x40003000)
#define NVIC_ENABLE (*(reg_t *)0xE000E100) /* interrupts 0 to 31 */

enum { IRQ_ADC = 18, IRQ_CAN1_RX0 = 20, IRQ_COUNT = 21 };

_Static_assert(sizeof(can_t) == 0x240 + 28 * 8, "registers of bxCAN, RM0090 table 184");

#endif
