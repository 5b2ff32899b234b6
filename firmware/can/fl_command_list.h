/* Every command, once: the dispatcher's table, the numbers and the names are made of this list.
 *
 * X(name, number, least and most payload bytes, flags, class for the supervisor, axes, argument, handler);
 * ascending. Names are the protocol's. Arguments: loop modes 1 = closed, 2 = collision detection; 15 forgets
 * a collision, 31 is relative, 112 and 113 are of standstill. 26 is both motors, 27 alpha, 28 beta, as three
 * EPFL lists have it (jaeger names 26 alpha and 27 beta). 18 is never a request. From 240 on: for a bench,
 * numbers that no host of an instrument uses. */
#ifndef FL_COMMAND_LIST_H
#define FL_COMMAND_LIST_H

/* clang-format off */
#define FL_COMMANDS(X)                                                                                       \
    X(GET_ID, 1, 0, 0, EVERYWHERE, QUERY, BOTH, 0, fl_handle_id)                                             \
    X(GET_FIRMWARE_VERSION, 2, 0, 0, EVERYWHERE, QUERY, BOTH, 0, fl_handle_version)                          \
    X(GET_STATUS, 3, 0, 0, EVERYWHERE, QUERY, BOTH, 0, fl_handle_status)                                     \
    X(SEND_NEW_TRAJECTORY, 10, 8, 8, PLAIN, NEW, BOTH, 0, fl_handle_new_trajectory)                          \
    X(SEND_TRAJECTORY_DATA, 11, 8, 8, PLAIN, POINT, BOTH, 0, fl_handle_point)                                \
    X(TRAJECTORY_DATA_END, 12, 0, 0, PLAIN, END, BOTH, 0, fl_handle_end)                                     \
    X(SEND_TRAJECTORY_ABORT, 13, 0, 0, PLAIN, STOP, BOTH, 0, fl_handle_stop)                                 \
    X(START_TRAJECTORY, 14, 0, 0, BROADCAST, START, BOTH, 0, fl_handle_start)                                \
    X(STOP_TRAJECTORY, 15, 0, 0, BROADCAST, STOP, BOTH, 1, fl_handle_stop)                                   \
    X(COLLISION_DETECTED, 18, 0, 8, PLAIN, IMPOSSIBLE, BOTH, 0, NULL)                                        \
    X(GO_TO_DATUMS, 20, 0, 0, PLAIN, HOME, BOTH, 0, fl_handle_calibrate)                                     \
    X(GO_TO_DATUM_ALPHA, 21, 0, 0, PLAIN, HOME, ALPHA, 0, fl_handle_calibrate)                               \
    X(GO_TO_DATUM_BETA, 22, 0, 0, PLAIN, HOME, BETA, 0, fl_handle_calibrate)                                 \
    X(START_DATUM_CALIBRATION, 23, 0, 0, PLAIN, CALIBRATE_DATUM, BOTH, 0, fl_handle_calibrate)               \
    X(START_DATUM_CALIBRATION_ALPHA, 24, 0, 0, PLAIN, CALIBRATE_DATUM, ALPHA, 0, fl_handle_calibrate)        \
    X(START_DATUM_CALIBRATION_BETA, 25, 0, 0, PLAIN, CALIBRATE_DATUM, BETA, 0, fl_handle_calibrate)          \
    X(START_MOTOR_CALIBRATION, 26, 0, 0, PLAIN, CALIBRATE_HALL, BOTH, 0, fl_handle_calibrate)                \
    X(START_MOTOR_CALIBRATION_ALPHA, 27, 0, 0, PLAIN, CALIBRATE_HALL, ALPHA, 0, fl_handle_calibrate)         \
    X(START_MOTOR_CALIBRATION_BETA, 28, 0, 0, PLAIN, CALIBRATE_HALL, BETA, 0, fl_handle_calibrate)           \
    X(GO_TO_ABSOLUTE_POSITION, 30, 8, 8, PLAIN, GOTO, BOTH, 0, fl_handle_goto)                               \
    X(GO_TO_RELATIVE_POSITION, 31, 8, 8, PLAIN, GOTO, BOTH, 1, fl_handle_goto)                               \
    X(GET_ACTUAL_POSITION, 32, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_position)                              \
    X(SET_ACTUAL_POSITION, 33, 8, 8, PLAIN, SETTING, BOTH, 0, fl_handle_set_position)                        \
    X(GET_OFFSETS, 34, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_get_offsets)                                   \
    X(SET_OFFSETS, 35, 8, 8, PLAIN, SETTING, BOTH, 0, fl_handle_set_offsets)                                 \
    X(SET_SPEED, 40, 8, 8, PLAIN, SETTING, BOTH, 0, fl_handle_set_speed)                                     \
    X(SET_CURRENT, 41, 8, 8, PLAIN, SETTING, BOTH, 0, fl_handle_set_current)                                 \
    X(GET_HALL_CALIB_ERROR, 45, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_hall_error)                           \
    X(START_COGGING_CALIBRATION, 47, 0, 0, PLAIN, CALIBRATE_COGGING, BOTH, 0, fl_handle_calibrate)           \
    X(START_COGGING_CALIBRATION_ALPHA, 48, 0, 0, PLAIN, CALIBRATE_COGGING, ALPHA, 0, fl_handle_calibrate)    \
    X(START_COGGING_CALIBRATION_BETA, 49, 0, 0, PLAIN, CALIBRATE_COGGING, BETA, 0, fl_handle_calibrate)      \
    X(SAVE_INTERNAL_CALIBRATION, 53, 0, 0, PLAIN, SETTING, BOTH, 0, fl_handle_save)                          \
    X(GET_CURRENT, 56, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_get_current)                                   \
    X(GET_ALPHA_HALL_CALIB, 104, 0, 0, PLAIN, QUERY, ALPHA, 0, fl_handle_hall_range)                         \
    X(GET_BETA_HALL_CALIB, 105, 0, 0, PLAIN, QUERY, BETA, 0, fl_handle_hall_range)                           \
    X(SET_INCREASE_COLLISION_MARGIN, 111, 4, 4, PLAIN, SETTING, BOTH, 0, fl_handle_collision_margin)         \
    X(SET_HOLDING_CURRENT, 112, 8, 8, PLAIN, SETTING, BOTH, 1, fl_handle_set_current)                        \
    X(GET_HOLDING_CURRENT, 113, 0, 0, PLAIN, QUERY, BOTH, 1, fl_handle_get_current)                          \
    X(HALL_ON, 116, 0, 0, PLAIN, QUERY, BOTH, 1, fl_handle_hall_power)                                       \
    X(HALL_OFF, 117, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_hall_power)                                      \
    X(ALPHA_CLOSED_LOOP_COLLISION_DETECTION, 118, 0, 0, PLAIN, SETTING, ALPHA, 3, fl_handle_loop)            \
    X(ALPHA_CLOSED_LOOP_WITHOUT_COLLISION_DETECTION, 119, 0, 0, PLAIN, SETTING, ALPHA, 1, fl_handle_loop)    \
    X(ALPHA_OPEN_LOOP_COLLISION_DETECTION, 120, 0, 0, PLAIN, SETTING, ALPHA, 2, fl_handle_loop)              \
    X(ALPHA_OPEN_LOOP_WITHOUT_COLLISION_DETECTION, 121, 0, 0, PLAIN, SETTING, ALPHA, 0, fl_handle_loop)      \
    X(BETA_CLOSED_LOOP_COLLISION_DETECTION, 122, 0, 0, PLAIN, SETTING, BETA, 3, fl_handle_loop)              \
    X(BETA_CLOSED_LOOP_WITHOUT_COLLISION_DETECTION, 123, 0, 0, PLAIN, SETTING, BETA, 1, fl_handle_loop)      \
    X(BETA_OPEN_LOOP_COLLISION_DETECTION, 124, 0, 0, PLAIN, SETTING, BETA, 2, fl_handle_loop)                \
    X(BETA_OPEN_LOOP_WITHOUT_COLLISION_DETECTION, 125, 0, 0, PLAIN, SETTING, BETA, 0, fl_handle_loop)        \
    X(SWITCH_LED_ON, 126, 0, 0, PLAIN, QUERY, BOTH, 1, fl_handle_led)                                        \
    X(SWITCH_LED_OFF, 127, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_led)                                       \
    X(SWITCH_ON_PRECISE_MOVE_ALPHA, 128, 0, 0, PLAIN, QUERY, ALPHA, 1, fl_handle_precise)                    \
    X(SWITCH_OFF_PRECISE_MOVE_ALPHA, 129, 0, 0, PLAIN, QUERY, ALPHA, 0, fl_handle_precise)                   \
    X(SWITCH_ON_PRECISE_MOVE_BETA, 130, 0, 0, PLAIN, QUERY, BETA, 1, fl_handle_precise)                      \
    X(SWITCH_OFF_PRECISE_MOVE_BETA, 131, 0, 0, PLAIN, QUERY, BETA, 0, fl_handle_precise)                     \
    X(GET_RAW_TEMPERATURE, 132, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_temperature)                          \
    X(GET_NUMBER_TRAJECTORIES, 139, 0, 0, PLAIN, QUERY, BOTH, 0, fl_handle_trajectories)                     \
    X(SET_NUMBER_TRAJECTORIES, 140, 4, 4, PLAIN, QUERY, BOTH, 0, fl_handle_set_trajectories)                 \
    X(START_FIRMWARE_UPGRADE, 200, 8, 8, BOOTLOADER, BOOT, BOTH, 0, fl_handle_upgrade)                       \
    X(SEND_FIRMWARE_DATA, 201, 1, 8, BOOTLOADER, BOOT, BOTH, 0, fl_handle_image)                             \
    X(BENCH_TRACE_START, 240, 2, 2, PLAIN, SETTING, BOTH, 0, fl_handle_trace_start)                          \
    X(BENCH_TRACE_STATE_ALPHA, 241, 0, 0, PLAIN, QUERY, ALPHA, 0, fl_handle_trace_state)                     \
    X(BENCH_TRACE_STATE_BETA, 242, 0, 0, PLAIN, QUERY, BETA, 0, fl_handle_trace_state)                       \
    X(BENCH_TRACE_READ_ALPHA, 243, 2, 2, PLAIN, QUERY, ALPHA, 0, fl_handle_trace_read)                       \
    X(BENCH_TRACE_READ_BETA, 244, 2, 2, PLAIN, QUERY, BETA, 0, fl_handle_trace_read)                         \
    X(BENCH_TORQUE_STEP_ALPHA, 245, 8, 8, PLAIN, GOTO, ALPHA, 0, fl_handle_torque_step)                      \
    X(BENCH_TORQUE_STEP_BETA, 246, 8, 8, PLAIN, GOTO, BETA, 0, fl_handle_torque_step)
/* clang-format on */

#endif
