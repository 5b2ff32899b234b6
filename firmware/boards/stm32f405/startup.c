/* From reset to main, for any Cortex-M4F: vector table, memory, floating-point unit.
 *
 * Boards name their interrupts in `board_vectors`; what has no handler stops here.
 */
#include <stdint.h>

extern uint32_t link_stack_top[], link_data_begin[], link_data_end[], link_bss_begin[], link_bss_end[];
extern const uint32_t link_data_image[];
extern int main(void);
extern void (*const link_init_begin[])(void), (*const link_init_end[])(void);

#define CPACR (*(volatile uint32_t *)0xE000ED88)

void reset_handler(void);
void startup_exit(int code);

static void halt(void) {
    for (;;) __asm__ volatile("wfi");
}

/* A board without an exit: main does not return. */
__attribute__((weak)) void startup_exit(int code) {
    (void)code;
    halt();
}

__attribute__((weak)) void fault_handler(void) { halt(); }
__attribute__((weak)) void systick_handler(void) { halt(); }

typedef void (*vector_t)(void);

/* Exceptions of the core; the board's interrupts follow in .vectors.board. */
__attribute__((section(".vectors.core"), used)) static const vector_t vectors[16] = {
    (vector_t)link_stack_top,
    reset_handler,
    fault_handler, /* NMI */
    fault_handler, /* hard fault */
    fault_handler, /* memory management */
    fault_handler, /* bus fault */
    fault_handler, /* usage fault */
    0,
    0,
    0,
    0,
    fault_handler, /* SVCall */
    fault_handler, /* debug */
    0,
    fault_handler, /* PendSV */
    systick_handler,
};

void reset_handler(void) {
    CPACR |= 0xFu << 20; /* both halves of the floating-point unit, before anything uses it */
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    const uint32_t *from = link_data_image;
    for (uint32_t *to = link_data_begin; to != link_data_end;) *to++ = *from++;
    for (uint32_t *to = link_bss_begin; to != link_bss_end;) *to++ = 0;
    for (void (*const *init)(void) = link_init_begin; init != link_init_end; ++init) (*init)();
    startup_exit(main());
}
