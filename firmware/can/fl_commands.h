/* The command table: what each number means, how long its payload is, who may be asked at once. */
#ifndef FL_COMMANDS_H
#define FL_COMMANDS_H

#include "fl_codes.h"
#include "fl_positioner.h"

enum { FL_CMD_BROADCAST = 1, FL_CMD_BOOTLOADER = 2 };
enum { FL_AXIS_ALPHA_BIT = 1, FL_AXIS_BETA_BIT = 2, FL_AXIS_BOTH_BITS = 3 };

typedef struct fl_request {
    const uint8_t *data;
    uint8_t len;
    uint8_t axes; /* from the command's row */
    uint8_t arg;
} fl_request_t;

typedef struct fl_reply {
    uint8_t data[8];
    uint8_t len;
} fl_reply_t;

/* Checks values and acts. Anything but FL_ACCEPTED must leave the positioner as it was. */
typedef fl_code_t (*fl_handler_t)(fl_positioner_t *p, const fl_request_t *rq, fl_reply_t *re);

typedef struct fl_command_row {
    uint8_t number;
    uint8_t len_min, len_max;
    uint8_t flags;
    uint8_t input; /* fl_input_t */
    uint8_t axes;
    uint8_t arg;
    fl_handler_t handler;
} fl_command_row_t;

/* NULL if unknown. */
const fl_command_row_t *fl_command_find(uint8_t number);

/* For tests and manuals. */
const fl_command_row_t *fl_command_table(unsigned *count);

static inline uint32_t fl_get_u32(const uint8_t *b) {
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}
static inline int32_t fl_get_i32(const uint8_t *b) { return (int32_t)fl_get_u32(b); }

static inline void fl_reply_u32(fl_reply_t *re, uint32_t v) {
    for (int i = 0; i < 4; ++i) re->data[re->len++] = (uint8_t)(v >> 8 * i);
}

/* Handlers, by the file they live in. */
#define FL_HANDLER(name) fl_code_t name(fl_positioner_t *p, const fl_request_t *rq, fl_reply_t *re)

/* fl_handle_info.c */
FL_HANDLER(fl_handle_id);
FL_HANDLER(fl_handle_version);
FL_HANDLER(fl_handle_status);
FL_HANDLER(fl_handle_position);
FL_HANDLER(fl_handle_hall_error);
FL_HANDLER(fl_handle_hall_range);
FL_HANDLER(fl_handle_temperature);
FL_HANDLER(fl_handle_trajectories);

/* fl_handle_motion.c */
FL_HANDLER(fl_handle_new_trajectory);
FL_HANDLER(fl_handle_point);
FL_HANDLER(fl_handle_end);
FL_HANDLER(fl_handle_start);
FL_HANDLER(fl_handle_stop);
FL_HANDLER(fl_handle_goto);
FL_HANDLER(fl_handle_calibrate);

/* fl_handle_settings.c */
FL_HANDLER(fl_handle_set_position);
FL_HANDLER(fl_handle_get_offsets);
FL_HANDLER(fl_handle_set_offsets);
FL_HANDLER(fl_handle_set_speed);
FL_HANDLER(fl_handle_set_current);
FL_HANDLER(fl_handle_get_current);
FL_HANDLER(fl_handle_collision_margin);
FL_HANDLER(fl_handle_loop);
FL_HANDLER(fl_handle_precise);
FL_HANDLER(fl_handle_hall_power);
FL_HANDLER(fl_handle_led);
FL_HANDLER(fl_handle_save);
FL_HANDLER(fl_handle_set_trajectories);

/* fl_handle_params.c */
FL_HANDLER(fl_handle_params_table);
FL_HANDLER(fl_handle_params_begin);
FL_HANDLER(fl_handle_param_set);
FL_HANDLER(fl_handle_params_commit);
FL_HANDLER(fl_handle_param_get);

/* CRC-32 over each parameter's name and unit (with their NULs) and its range and default (float32, little
 * endian): a host that knows another table must not write to this one. */
uint32_t fl_params_table_crc(void);

/* fl_handle_bench.c */
FL_HANDLER(fl_handle_trace_start);
FL_HANDLER(fl_handle_trace_state);
FL_HANDLER(fl_handle_trace_read);
FL_HANDLER(fl_handle_torque_step);

/* fl_boot.c */
FL_HANDLER(fl_handle_upgrade);
FL_HANDLER(fl_handle_image);

#endif
