/* The end of the rig's program, and what newlib asks of a system: memory for the plant, nothing else. The
 * firmware itself needs none of it. */
#include <errno.h>
#include <stddef.h>
#include <stdint.h>

enum { SYS_EXIT_EXTENDED = 0x20, APPLICATION_EXIT = 0x20026 };

extern char end[], link_heap_end[];

void startup_exit(int code);
void fault_handler(void);
void *_sbrk(ptrdiff_t bytes);

void startup_exit(int code) {
    const uint32_t arguments[2] = {APPLICATION_EXIT, (uint32_t)code};
    register int32_t r0 __asm__("r0") = SYS_EXIT_EXTENDED;
    register const uint32_t *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    for (;;) {}
}

/* A test that ends with this code met a fault of the processor, or abort(). */
void fault_handler(void) { startup_exit(99); }

void _exit(int code) {
    startup_exit(code);
    for (;;) {}
}

void *_sbrk(ptrdiff_t bytes) {
    static char *top = end;
    if (top + bytes > link_heap_end) {
        errno = ENOMEM;
        return (void *)-1;
    }
    top += bytes;
    return top - bytes;
}

void *__dso_handle;

/* No files, no processes: whatever they are called with, they fail. */
#define NOTHING(name)                                                                                        \
    int name(void);                                                                                          \
    int name(void) { return -1; }
NOTHING(_close)
NOTHING(_fstat)
NOTHING(_getpid)
NOTHING(_isatty)
NOTHING(_kill)
NOTHING(_lseek)
NOTHING(_read)
NOTHING(_write)
