/* The rig as a program of the host. */
#include <stdio.h>
#include <string.h>

#include "io.h"

const uint32_t io_instructions_per_count = 0;

bool io_read_line(char *line, size_t size) {
    if (!fgets(line, (int)size, stdin)) return false;
    line[strcspn(line, "\r\n")] = '\0';
    return true;
}

void io_write(const char *text) {
    fputs(text, stdout);
    fflush(stdout);
}

uint32_t io_clock(void) { return 0; }

void io_stack_mark(void) {}

uint32_t io_stack_used(void) { return 0; }
