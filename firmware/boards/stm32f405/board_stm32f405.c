/* A board, worked out: an STM32F405 at 168 MHz with two three-phase bridges, four hall channels, bxCAN and
 * a ferroelectric memory on SPI. docs/firmware/porting.md walks through it.
 *
 * It is compiled, linked, measured and its vectors are checked; there is no such board here to run it on.
 *
 *   PA8..10   TIM1 CH1..3   phases A, B, C of alpha        PA0..3   ADC1 0..3   alpha A, B, beta A, B
 *   PC6..8    TIM8 CH1..3   phases A, B, C of beta         PB8, 9   CAN1 RX, TX
 *   PA5..7    SPI1          memory                         PA4      its select line
 *   PB0, 1    enable lines of the drivers of alpha and beta, pulled up: low opens a bridge
 */
#include <stddef.h>

#include "factory.h"
#include "fl_dispatch.h"
#include "fl_positioner.h"
#include "fl_storage.h"
#include "stm32f405.h"

enum { PWM_STEPS = 4200 }; /* 168 MHz / 40 kHz */
enum { TICK_COUNTS = 84000000 / FL_TICK_HZ };
#define TIMER_NO_UPDATE (1u << 1)
enum { ADC_CYCLES_15 = 1 };         /* of sampling */
enum { WATCHDOG_8KHZ_COUNTS = 80 }; /* 10 ms */

static fl_positioner_t positioner;
static timer_t *const bridge[FL_AXES] = {TIM1, TIM8};

/* -- clocks and pins ----------------------------------------------------------------------------- */

/* 8 MHz crystal; PLL 8 / 8 * 336 / 2 = 168 MHz; buses at 84 and 42 MHz. */
static void start_clocks(void) {
    FLASH_INTERFACE->acr = 5 | 7u << 8; /* five wait states, caches on */
    RCC->cr |= 1u << 16;
    while (!(RCC->cr & 1u << 17)) {}
    RCC->pllcfgr = 8 | 336u << 6 | 0u << 16 | 1u << 22 | 7u << 24;
    RCC->cr |= 1u << 24;
    while (!(RCC->cr & 1u << 25)) {}
    RCC->cfgr = 5u << 10 | 4u << 13 | 2;                    /* APB1 / 4, APB2 / 2, PLL as the clock */
    RCC->ahb1enr |= 7;                                      /* GPIO A to C */
    RCC->apb1enr |= 1u << 0 | 1u << 25;                     /* TIM2, CAN1 */
    RCC->apb2enr |= 1u << 0 | 1u << 1 | 1u << 8 | 1u << 12; /* TIM1, TIM8, ADC1, SPI1 */
}

static void pin_alternate(gpio_t *port, unsigned pin, uint32_t function) {
    port->moder = (port->moder & ~(3u << 2 * pin)) | 2u << 2 * pin;
    port->ospeedr |= 2u << 2 * pin;
    port->afr[pin / 8] |= function << 4 * (pin % 8);
}

static void start_pins(void) {
    for (unsigned pin = 0; pin < 4; ++pin) GPIOA->moder |= 3u << 2 * pin; /* analogue */
    GPIOA->bsrr = 1u << 4;
    GPIOA->moder |= 1u << 8; /* select line: output, high */
    GPIOB->bsrr = 3u;        /* both bridges enabled, before the pins are outputs */
    GPIOB->moder |= 1u << 0 | 1u << 2;
    for (unsigned pin = 5; pin < 8; ++pin) pin_alternate(GPIOA, pin, 5);
    for (unsigned pin = 8; pin < 11; ++pin) pin_alternate(GPIOA, pin, 1);
    for (unsigned pin = 6; pin < 9; ++pin) pin_alternate(GPIOC, pin, 3);
    for (unsigned pin = 8; pin < 10; ++pin) pin_alternate(GPIOB, pin, 9);
}

/* -- PWM: set_phases, open_phases ---------------------------------------------------------------- */

static void start_bridge(timer_t *t) {
    t->arr = PWM_STEPS - 1;
    t->ccmr1 = 0x6868; /* PWM mode 1, compare values taken over together at the end of a period */
    t->ccmr2 = 0x0068;
    t->ccer = 0x0111;
    t->bdtr = 1u << 15; /* outputs on: all at ground until a duty is set */
    t->egr = 1;
    t->cr1 = 1u << 7 | 1;
}

/* A compare value of PWM_STEPS is full voltage: the output never falls. No update between the three, so that
 * they change together. */
static void set_phases(void *ctx, int axis, const float duty[3]) {
    (void)ctx;
    timer_t *t = bridge[axis];
    t->cr1 |= TIMER_NO_UPDATE;
    for (int k = 0; k < 3; ++k) t->ccr[k] = (uint32_t)(duty[k] * (float)PWM_STEPS + 0.5f);
    t->cr1 &= ~TIMER_NO_UPDATE;
    GPIOB->bsrr = 1u << axis;
}

/* The drivers hold both switches of their phases off while their enable line is low. */
static void open_phases(void *ctx, int axis) {
    (void)ctx;
    GPIOB->bsrr = 1u << (16 + axis);
}

/* -- ADC: read_hall, and the tick ---------------------------------------------------------------- */

/* TIM2 starts the injected group, four conversions of 27 cycles at 21 MHz: 5 us; its end is the tick. */
static void start_adc(void) {
    ADC_COMMON_CCR = 1u << 16; /* 84 MHz / 4 */
    ADC1->smpr2 = ADC_CYCLES_15 | ADC_CYCLES_15 << 3 | ADC_CYCLES_15 << 6 | ADC_CYCLES_15 << 9;
    ADC1->jsqr = 3u << 20 | 0u << 0 | 1u << 5 | 2u << 10 | 3u << 15;
    ADC1->cr1 = 1u << 8 | 1u << 7;        /* scan, interrupt at the end of the group */
    ADC1->cr2 = 1u << 20 | 3u << 16 | 1u; /* by the rising edge of TIM2's TRGO */
    TIM2->arr = TICK_COUNTS - 1;
    TIM2->cr2 = 2u << 4; /* TRGO at the update */
    TIM2->cr1 = 1;
}

static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    (void)ctx;
    adc_cnt[0] = (uint16_t)ADC1->jdr[2 * axis];
    adc_cnt[1] = (uint16_t)ADC1->jdr[2 * axis + 1];
}

static void start_watchdog(void) {
    IWDG->kr = 0x5555;
    IWDG->pr = 0;
    IWDG->rlr = WATCHDOG_8KHZ_COUNTS;
    IWDG->kr = 0xCCCC;
}

/* Without ticks the watchdog resets the processor, which switches the bridges off. */
static void adc_handler(void) {
    ADC1->sr = 0;
    IWDG->kr = 0xAAAA;
    fl_positioner_tick(&positioner);
}

/* -- CAN: send_frame, and what arrives ----------------------------------------------------------- */

/* Extended data frames to this positioner, or to all: what others are told never reaches the FIFO. */
static void set_filter(unsigned bank, uint32_t positioner_bits) {
    CAN1->filter[bank][0] = positioner_bits << 21 | 1u << 2;
    CAN1->filter[bank][1] = 0x7ffu << 21 | 1u << 2 | 1u << 1;
    CAN1->fs1r |= 1u << bank;
    CAN1->fa1r |= 1u << bank;
}

/* 42 MHz / 3 / (1 + 10 + 3) = 1 Mbit/s, sampled at 79 %. */
static void start_can(uint16_t id) {
    CAN1->mcr = 1;
    while (!(CAN1->msr & 1)) {}
    CAN1->btr = 2 | 9u << 16 | 2u << 20;
    CAN1->mcr = 1u << 6 | 1u << 2 | 1; /* recovers from bus-off by itself; sends in the order of requests */
    CAN1->fmr |= 1;
    set_filter(0, id);
    set_filter(1, 0);
    CAN1->fmr &= ~1u;
    CAN1->ier = 1u << 1;
    CAN1->mcr &= ~1u;
}

static uint32_t word_of(const uint8_t *b) {
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

static bool send_frame(void *ctx, const fl_can_frame_t *frame) {
    (void)ctx;
    if (!(CAN1->tsr & 7u << 26)) return false;
    can_mailbox_t *box = &CAN1->tx[CAN1->tsr >> 24 & 3];
    box->dtr = frame->len;
    box->dlr = word_of(frame->data);
    box->dhr = word_of(frame->data + 4);
    box->ir = frame->id << 3 | 1u << 2 | 1;
    return true;
}

/* The same priority as the tick: neither interrupts the other. */
static void can_handler(void) {
    while (CAN1->rf0r & 3) {
        const can_mailbox_t *box = &CAN1->rx[0];
        const uint32_t words[2] = {box->dlr, box->dhr};
        fl_can_frame_t frame = {box->ir >> 3, (uint8_t)(box->dtr & 15), {0}};
        for (int k = 0; k < 8; ++k) frame.data[k] = (uint8_t)(words[k / 4] >> 8 * (k % 4));
        CAN1->rf0r = 1u << 5; /* the FIFO's place is free */
        fl_positioner_receive(&positioner, &frame);
    }
}

/* -- storage ------------------------------------------------------------------------------------- */

enum { MEMORY_WRITE_ENABLE = 6, MEMORY_READ = 3, MEMORY_WRITE = 2 };

static uint8_t spi_exchange(uint8_t byte) {
    SPI1->dr = byte;
    while (!(SPI1->sr & 1)) {}
    return (uint8_t)SPI1->dr;
}

static void memory_select(bool on) { GPIOA->bsrr = on ? 1u << 20 : 1u << 4; }

static void memory_address(uint8_t command, uint32_t offset) {
    memory_select(true);
    spi_exchange(command);
    spi_exchange((uint8_t)(offset >> 8));
    spi_exchange((uint8_t)offset);
}

/* 21 MHz: a byte in 0.4 us. Ferroelectric memory takes each byte as it comes and needs no erasing. */
static void start_memory(void) { SPI1->cr1 = 1u << 9 | 1u << 8 | 1u << 6 | 1u << 3 | 1u << 2; }

static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    (void)ctx;
    if (offset + len > FL_STORAGE_BYTES) return 0;
    memory_address(MEMORY_READ, offset);
    for (uint32_t k = 0; k < len; ++k) ((uint8_t *)bytes)[k] = spi_exchange(0);
    memory_select(false);
    return len;
}

static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    (void)ctx;
    if (offset + len > FL_STORAGE_BYTES) return 0;
    memory_select(true);
    spi_exchange(MEMORY_WRITE_ENABLE);
    memory_select(false);
    memory_address(MEMORY_WRITE, offset);
    for (uint32_t k = 0; k < len; ++k) spi_exchange(((const uint8_t *)bytes)[k]);
    memory_select(false);
    return len;
}

/* -- from reset ---------------------------------------------------------------------------------- */

typedef void (*vector_t)(void);

__attribute__((section(".vectors.board"), used)) static const vector_t board_vectors[IRQ_COUNT] = {
    [IRQ_ADC] = adc_handler,
    [IRQ_CAN1_RX0] = can_handler,
};

/* The first samples: the firmware looks at the rotors when it starts. */
static void convert_once(void) {
    ADC1->cr2 |= 1u << 22;
    while (!(ADC1->sr & 1u << 2)) {}
    ADC1->sr = 0;
}

int main(void) {
    start_clocks();
    start_pins();
    start_memory();
    for (int axis = 0; axis < FL_AXES; ++axis) start_bridge(bridge[axis]);
    start_adc();
    convert_once(); /* while the converter wakes up: not exact */
    convert_once();
    const fl_port_t port = {0, read_hall,  set_phases, send_frame, storage_read, storage_write,
                            0, open_phases};
    const fl_axis_params_t params[FL_AXES] = {factory.params[FL_ALPHA], factory.params[FL_BETA]};
    fl_positioner_init(&positioner, &port, factory.id, params);
    start_can(factory.id);
    start_watchdog();
    NVIC_ENABLE = 1u << IRQ_ADC | 1u << IRQ_CAN1_RX0;
    for (;;) __asm__ volatile("wfi");
}
