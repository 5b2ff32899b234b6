#include "fl_commands.h"

#include <stddef.h>

#define B FL_CMD_BROADCAST
#define L FL_CMD_BOOTLOADER
#define A1 FL_AXIS_ALPHA_BIT
#define A2 FL_AXIS_BETA_BIT
#define A12 FL_AXIS_BOTH_BITS

/* Number, payload bytes least and most, flags, class for the supervisor, axes, argument, handler;
 * ascending. Arguments: loop modes 1 = closed, 2 = collision detection; a plan's own class. 26 is both
 * motors, 27 alpha, 28 beta, as three EPFL lists have it (jaeger names 26 alpha and 27 beta). */
/* clang-format off */
#define ROW(number, least, most, flags, input, axes, arg, handler)                                     \
    {number, least, most, flags, FL_IN_##input, axes, arg, handler}

static const fl_command_row_t rows[] = {
    ROW(1, 0, 0, B | L, QUERY, A12, 0, fl_handle_id),
    ROW(2, 0, 0, B | L, QUERY, A12, 0, fl_handle_version),
    ROW(3, 0, 0, B | L, QUERY, A12, 0, fl_handle_status),
    ROW(10, 8, 8, 0, NEW, A12, 0, fl_handle_new_trajectory),
    ROW(11, 8, 8, 0, POINT, A12, 0, fl_handle_point),
    ROW(12, 0, 0, 0, END, A12, 0, fl_handle_end),
    ROW(13, 0, 0, 0, STOP, A12, 0, fl_handle_stop),
    ROW(14, 0, 0, B, START, A12, 0, fl_handle_start),
    ROW(15, 0, 0, B, STOP, A12, 1, fl_handle_stop),
    ROW(18, 0, 8, 0, IMPOSSIBLE, A12, 0, NULL),
    ROW(20, 0, 0, 0, HOME, A12, FL_IN_HOME, fl_handle_calibrate),
    ROW(21, 0, 0, 0, HOME, A1, FL_IN_HOME, fl_handle_calibrate),
    ROW(22, 0, 0, 0, HOME, A2, FL_IN_HOME, fl_handle_calibrate),
    ROW(23, 0, 0, 0, CALIBRATE_DATUM, A12, FL_IN_CALIBRATE_DATUM, fl_handle_calibrate),
    ROW(24, 0, 0, 0, CALIBRATE_DATUM, A1, FL_IN_CALIBRATE_DATUM, fl_handle_calibrate),
    ROW(25, 0, 0, 0, CALIBRATE_DATUM, A2, FL_IN_CALIBRATE_DATUM, fl_handle_calibrate),
    ROW(26, 0, 0, 0, CALIBRATE_HALL, A12, FL_IN_CALIBRATE_HALL, fl_handle_calibrate),
    ROW(27, 0, 0, 0, CALIBRATE_HALL, A1, FL_IN_CALIBRATE_HALL, fl_handle_calibrate),
    ROW(28, 0, 0, 0, CALIBRATE_HALL, A2, FL_IN_CALIBRATE_HALL, fl_handle_calibrate),
    ROW(30, 8, 8, 0, GOTO, A12, 0, fl_handle_goto),
    ROW(31, 8, 8, 0, GOTO, A12, 1, fl_handle_goto),
    ROW(32, 0, 0, 0, QUERY, A12, 0, fl_handle_position),
    ROW(33, 8, 8, 0, SETTING, A12, 0, fl_handle_set_position),
    ROW(34, 0, 0, 0, QUERY, A12, 0, fl_handle_get_offsets),
    ROW(35, 8, 8, 0, SETTING, A12, 0, fl_handle_set_offsets),
    ROW(40, 8, 8, 0, SETTING, A12, 0, fl_handle_set_speed),
    ROW(41, 8, 8, 0, SETTING, A12, 0, fl_handle_set_current),
    ROW(45, 0, 0, 0, QUERY, A12, 0, fl_handle_hall_error),
    ROW(47, 0, 0, 0, CALIBRATE_COGGING, A12, FL_IN_CALIBRATE_COGGING, fl_handle_calibrate),
    ROW(48, 0, 0, 0, CALIBRATE_COGGING, A1, FL_IN_CALIBRATE_COGGING, fl_handle_calibrate),
    ROW(49, 0, 0, 0, CALIBRATE_COGGING, A2, FL_IN_CALIBRATE_COGGING, fl_handle_calibrate),
    ROW(53, 0, 0, 0, SETTING, A12, 0, fl_handle_save),
    ROW(56, 0, 0, 0, QUERY, A12, 0, fl_handle_get_current),
    ROW(104, 0, 0, 0, QUERY, A1, 0, fl_handle_hall_range),
    ROW(105, 0, 0, 0, QUERY, A2, 0, fl_handle_hall_range),
    ROW(111, 4, 4, 0, SETTING, A12, 0, fl_handle_collision_margin),
    ROW(112, 8, 8, 0, SETTING, A12, 1, fl_handle_set_current),
    ROW(113, 0, 0, 0, QUERY, A12, 1, fl_handle_get_current),
    ROW(116, 0, 0, 0, QUERY, A12, 1, fl_handle_hall_power),
    ROW(117, 0, 0, 0, QUERY, A12, 0, fl_handle_hall_power),
    ROW(118, 0, 0, 0, SETTING, A1, 3, fl_handle_loop),
    ROW(119, 0, 0, 0, SETTING, A1, 1, fl_handle_loop),
    ROW(120, 0, 0, 0, SETTING, A1, 2, fl_handle_loop),
    ROW(121, 0, 0, 0, SETTING, A1, 0, fl_handle_loop),
    ROW(122, 0, 0, 0, SETTING, A2, 3, fl_handle_loop),
    ROW(123, 0, 0, 0, SETTING, A2, 1, fl_handle_loop),
    ROW(124, 0, 0, 0, SETTING, A2, 2, fl_handle_loop),
    ROW(125, 0, 0, 0, SETTING, A2, 0, fl_handle_loop),
    ROW(126, 0, 0, 0, QUERY, A12, 1, fl_handle_led),
    ROW(127, 0, 0, 0, QUERY, A12, 0, fl_handle_led),
    ROW(128, 0, 0, 0, QUERY, A1, 1, fl_handle_precise),
    ROW(129, 0, 0, 0, QUERY, A1, 0, fl_handle_precise),
    ROW(130, 0, 0, 0, QUERY, A2, 1, fl_handle_precise),
    ROW(131, 0, 0, 0, QUERY, A2, 0, fl_handle_precise),
    ROW(132, 0, 0, 0, QUERY, A12, 0, fl_handle_temperature),
    ROW(139, 0, 0, 0, QUERY, A12, 0, fl_handle_trajectories),
    ROW(140, 4, 4, 0, QUERY, A12, 0, fl_handle_set_trajectories),
    ROW(200, 8, 8, L, BOOT, A12, 0, fl_handle_upgrade),
    ROW(201, 1, 8, L, BOOT, A12, 0, fl_handle_image),
    ROW(230, 0, 0, 0, SETTING, A12, 0, fl_handle_params_table),
    ROW(231, 4, 4, 0, SETTING, A12, 0, fl_handle_params_begin),
    ROW(232, 5, 5, 0, SETTING, A1, 0, fl_handle_param_set),
    ROW(233, 5, 5, 0, SETTING, A2, 0, fl_handle_param_set),
    ROW(234, 4, 4, 0, SETTING, A12, 0, fl_handle_params_commit),
    ROW(235, 1, 1, 0, QUERY, A1, 0, fl_handle_param_get),
    ROW(236, 1, 1, 0, QUERY, A2, 0, fl_handle_param_get),
    ROW(240, 2, 2, 0, SETTING, A12, 0, fl_handle_trace_start),
    ROW(241, 0, 0, 0, QUERY, A1, 0, fl_handle_trace_state),
    ROW(242, 0, 0, 0, QUERY, A2, 0, fl_handle_trace_state),
    ROW(243, 2, 2, 0, QUERY, A1, 0, fl_handle_trace_read),
    ROW(244, 2, 2, 0, QUERY, A2, 0, fl_handle_trace_read),
    ROW(245, 8, 8, 0, GOTO, A1, 0, fl_handle_torque_step),
    ROW(246, 8, 8, 0, GOTO, A2, 0, fl_handle_torque_step),
};
/* clang-format on */

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
