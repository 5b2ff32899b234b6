/* The rig on an emulated Cortex-M: Arm semihosting for lines, SysTick for instructions.
 *
 * With -icount shift=0 an instruction takes one nanosecond of QEMU's virtual time and SysTick counts the
 * 25 MHz of the mps2 boards: one count is 40 instructions, on every machine the same.
 */
#include <string.h>

#include "io.h"

enum { SYS_OPEN = 0x01, SYS_WRITE = 0x05, SYS_READ = 0x06 };
enum { OPEN_READ = 0, OPEN_WRITE = 4 };

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018)

const uint32_t io_instructions_per_count = 40;

/* Arguments as words: the ABI's size_t and pointers are 32 bits. */
static int32_t semihost(int32_t operation, const uint32_t *arguments) {
    register int32_t r0 __asm__("r0") = operation;
    register const uint32_t *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static int32_t open_console(uint32_t mode) {
    static const char name[] = ":tt";
    const uint32_t arguments[3] = {(uint32_t)name, mode, sizeof name - 1};
    return semihost(SYS_OPEN, arguments);
}

static struct {
    int32_t in, out;
    char buffer[256];
    uint32_t next, filled;
    bool open;
} console;

static void open_once(void) {
    if (console.open) return;
    console.in = open_console(OPEN_READ);
    console.out = open_console(OPEN_WRITE);
    SYSTICK_RELOAD = IO_CLOCK_MASK;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5; /* runs on the processor's clock, no interrupt */
    console.open = true;
}

/* -1 at the end of the input. */
static int next_character(void) {
    if (console.next == console.filled) {
        const uint32_t arguments[3] = {(uint32_t)console.in, (uint32_t)console.buffer, sizeof console.buffer};
        const uint32_t missing = (uint32_t)semihost(SYS_READ, arguments);
        if (missing >= sizeof console.buffer) return -1;
        console.next = 0;
        console.filled = sizeof console.buffer - missing;
    }
    return console.buffer[console.next++];
}

bool io_read_line(char *line, size_t size) {
    open_once();
    for (size_t n = 0;;) {
        const int c = next_character();
        if (c < 0) return false;
        if (c == '\n') {
            line[n] = '\0';
            return true;
        }
        if (c != '\r' && n + 1 < size) line[n++] = (char)c;
    }
}

void io_write(const char *text) {
    open_once();
    const uint32_t arguments[3] = {(uint32_t)console.out, (uint32_t)text, strlen(text)};
    semihost(SYS_WRITE, arguments);
}

uint32_t io_clock(void) { return IO_CLOCK_MASK - SYSTICK_VALUE; }

enum { MARKED_WORDS = 1024 }; /* more than the firmware ever takes */
#define MARK 0xa5a5a5a5u

static inline uint32_t *stack_pointer(void) {
    uint32_t *sp;
    __asm__ volatile("mov %0, sp" : "=r"(sp));
    return sp;
}

static uint32_t *marked;

/* Not inlined: both look from a caller's frame that is the same. */
__attribute__((noinline)) void io_stack_mark(void) {
    marked = stack_pointer();
    for (int i = 1; i <= MARKED_WORDS; ++i) *(volatile uint32_t *)(marked - i) = MARK;
}

__attribute__((noinline)) uint32_t io_stack_used(void) {
    int free = 0;
    while (free < MARKED_WORDS && *(volatile uint32_t *)(marked - MARKED_WORDS + free) == MARK) ++free;
    return (uint32_t)(MARKED_WORDS - free) * (uint32_t)sizeof *marked;
}
