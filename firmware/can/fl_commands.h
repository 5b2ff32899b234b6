/* The command table: what each number means, how long its payload is, where it may be sent. */
#ifndef FL_COMMANDS_H
#define FL_COMMANDS_H

#include "fl_codes.h"
#include "fl_command_list.h"
#include "fl_positioner.h"

/* FL_COMMAND_<name>: the number of a command. */
enum {
#define X(name, number, least, most, flags, input, axes, arg, handler) FL_COMMAND_##name = (number),
    FL_COMMANDS(X)
#undef X
};

/* Flags of a command: may be addressed to every positioner at once, is known to the bootloader. */
enum { FL_CMD_PLAIN = 0, FL_CMD_BROADCAST = 1, FL_CMD_BOOTLOADER = 2, FL_CMD_EVERYWHERE = 3 };
/* Axes as bits. */
enum { FL_ON_ALPHA = 1 << FL_ALPHA, FL_ON_BETA = 1 << FL_BETA, FL_ON_BOTH = FL_ON_ALPHA | FL_ON_BETA };

typedef struct fl_request {
    const uint8_t *data;
    uint8_t len;
    uint8_t axes;       /* FL_ON_..., from the command's row */
    uint8_t arg, input; /* likewise */
} fl_request_t;

typedef struct fl_reply {
    uint8_t data[8];
    uint8_t len;
} fl_reply_t;

/* Checks values and acts. Anything but FL_ACCEPTED must leave the positioner as it was; 12 and 201 alone
 * differ: they end a bad trajectory and a bad image.
 * @pre the payload has the length of the row; the supervisor has accepted the command */
typedef fl_code_t (*fl_handler_t)(fl_positioner_t *p, const fl_request_t *rq, fl_reply_t *re);

typedef struct fl_command_row {
    uint8_t number;
    uint8_t len_min, len_max;
    uint8_t flags; /* FL_CMD_... */
    uint8_t input; /* fl_input_t */
    uint8_t axes;  /* FL_ON_... */
    uint8_t arg;
    fl_handler_t handler;
} fl_command_row_t;

/* The row of a command number; NULL if unknown. */
const fl_command_row_t *fl_command_find(uint8_t number);

/* All rows, ascending by number; `count` of them. For tests and manuals. */
const fl_command_row_t *fl_command_table(unsigned *count);

/* Little-endian integers of a payload.
 * @pre four bytes at b */
static inline uint32_t fl_get_u32(const uint8_t *b) {
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}
static inline int32_t fl_get_i32(const uint8_t *b) { return (int32_t)fl_get_u32(b); }

/* Appends a little-endian integer to a reply.
 * @pre re->len <= 4 */
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

/* fl_handle_bench.c */
FL_HANDLER(fl_handle_trace_start);
FL_HANDLER(fl_handle_trace_state);
FL_HANDLER(fl_handle_trace_read);
FL_HANDLER(fl_handle_torque_step);

/* fl_handle_boot.c */
FL_HANDLER(fl_handle_upgrade);
FL_HANDLER(fl_handle_image);

#endif
