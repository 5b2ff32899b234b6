/* What the rig needs of the machine it runs on: lines in, text out, a clock that counts instructions. */
#ifndef RIG_IO_H
#define RIG_IO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The next line without its end; false at the end of the input. Waits. */
bool io_read_line(char *line, size_t size);
void io_write(const char *text);

/* Counts up, modulo IO_CLOCK_MASK + 1. */
uint32_t io_clock(void);
#define IO_CLOCK_MASK 0xffffffu

/* How many instructions a count is; 0 where they are not counted. */
extern const uint32_t io_instructions_per_count;

/* How deep a call goes: marks the free stack, then tells how many bytes of it are no longer as marked. 0
 * where it is not measured. */
void io_stack_mark(void);
uint32_t io_stack_used(void);

#ifdef __cplusplus
}
#endif
#endif
