#include "fl_commands.h"

#include <stddef.h>

#define B FL_CMD_BROADCAST
#define L FL_CMD_BOOTLOADER
#define A1 FL_AXIS_ALPHA_BIT
#define A2 FL_AXIS_BETA_BIT
#define A12 FL_AXIS_BOTH_BITS

/* number, payload min and max, flags, input, axes, argument, handler; ascending */
static const fl_command_row_t rows[] = {
    {1, 0, 0, B | L, FL_IN_QUERY, A12, 0, fl_handle_id},
    {2, 0, 0, B | L, FL_IN_QUERY, A12, 0, fl_handle_version},
    {3, 0, 0, B | L, FL_IN_QUERY, A12, 0, fl_handle_status},
    {10, 8, 8, 0, FL_IN_NEW, A12, 0, fl_handle_new_trajectory},
    {11, 8, 8, 0, FL_IN_POINT, A12, 0, fl_handle_point},
    {12, 0, 0, 0, FL_IN_END, A12, 0, fl_handle_end},
    {13, 0, 0, 0, FL_IN_STOP, A12, 0, fl_handle_stop},
    {14, 0, 0, B, FL_IN_START, A12, 0, fl_handle_start},
    {15, 0, 0, B, FL_IN_STOP, A12, 1, fl_handle_stop},
    {18, 0, 8, 0, FL_IN_IMPOSSIBLE, A12, 0, NULL},
    {20, 0, 0, 0, FL_IN_HOME, A12, 0, fl_handle_home},
    {21, 0, 0, 0, FL_IN_HOME, A1, 0, fl_handle_home},
    {22, 0, 0, 0, FL_IN_HOME, A2, 0, fl_handle_home},
    {30, 8, 8, 0, FL_IN_GOTO, A12, 0, fl_handle_goto},
    {31, 8, 8, 0, FL_IN_GOTO, A12, 1, fl_handle_goto},
    {32, 0, 0, 0, FL_IN_QUERY, A12, 0, fl_handle_position},
    {33, 8, 8, 0, FL_IN_SETTING, A12, 0, fl_handle_set_position},
    {40, 8, 8, 0, FL_IN_SETTING, A12, 0, fl_handle_set_speed},
    /* argument: 1 closed loop, 2 collision detection */
    {118, 0, 0, 0, FL_IN_SETTING, A1, 3, fl_handle_loop},
    {119, 0, 0, 0, FL_IN_SETTING, A1, 1, fl_handle_loop},
    {120, 0, 0, 0, FL_IN_SETTING, A1, 2, fl_handle_loop},
    {121, 0, 0, 0, FL_IN_SETTING, A1, 0, fl_handle_loop},
    {122, 0, 0, 0, FL_IN_SETTING, A2, 3, fl_handle_loop},
    {123, 0, 0, 0, FL_IN_SETTING, A2, 1, fl_handle_loop},
    {124, 0, 0, 0, FL_IN_SETTING, A2, 2, fl_handle_loop},
    {125, 0, 0, 0, FL_IN_SETTING, A2, 0, fl_handle_loop},
    {128, 0, 0, 0, FL_IN_QUERY, A1, 1, fl_handle_precise},
    {129, 0, 0, 0, FL_IN_QUERY, A1, 0, fl_handle_precise},
    {130, 0, 0, 0, FL_IN_QUERY, A2, 1, fl_handle_precise},
    {131, 0, 0, 0, FL_IN_QUERY, A2, 0, fl_handle_precise},
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
