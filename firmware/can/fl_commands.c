#include "fl_commands.h"

#include <stddef.h>

#include "fl_identifier.h"

_Static_assert((int)FL_COMMAND_COLLISION_DETECTED == FL_ID_COLLISION,
               "the frame of a collision has its number");

static const fl_command_row_t rows[] = {
#define X(name, number, least, most, flags, input, axes, arg, handler)                                       \
    {number, least, most, FL_CMD_##flags, FL_IN_##input, FL_ON_##axes, arg, handler},
    FL_COMMANDS(X)
#undef X
};

const fl_command_row_t *fl_command_table(unsigned *count) {
    *count = sizeof rows / sizeof *rows;
    return rows;
}

const fl_command_row_t *fl_command_find(uint8_t number) {
    unsigned low = 0, high = sizeof rows / sizeof *rows;
    while (low < high) {
        const unsigned middle = (low + high) / 2;
        if (rows[middle].number < number)
            low = middle + 1;
        else
            high = middle;
    }
    return low < sizeof rows / sizeof *rows && rows[low].number == number ? &rows[low] : NULL;
}
