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
/* The same, signed. */
static inline int32_t fl_get_i32(const uint8_t *b) { return (int32_t)fl_get_u32(b); }

/* Appends a little-endian integer to a reply.
 * @pre re->len <= 4 */
static inline void fl_reply_u32(fl_reply_t *re, uint32_t v) {
    for (int i = 0; i < 4; ++i) re->data[re->len++] = (uint8_t)(v >> 8 * i);
}

/* Handlers (fl_handler_t), by the file they are in, with the numbers of their commands. */
#define FL_HANDLER(name) fl_code_t name(fl_positioner_t *p, const fl_request_t *rq, fl_reply_t *re)

/* fl_handle_info.c */
/* 1: the number of the positioner. */
FL_HANDLER(fl_handle_id);
/* 2: of the firmware, or of the bootloader. */
FL_HANDLER(fl_handle_version);
/* 3: the status word, 64 bits; the bootloader's has 32. */
FL_HANDLER(fl_handle_status);
/* 32: both positions, counts. */
FL_HANDLER(fl_handle_position);
/* 45: rms residual of the last hall calibration, motor millidegrees. */
FL_HANDLER(fl_handle_hall_error);
/* 104, 105: largest and smallest counts of both channels. */
FL_HANDLER(fl_handle_hall_range);
/* 132: raw. */
FL_HANDLER(fl_handle_temperature);
/* 139: how many were started. */
FL_HANDLER(fl_handle_trajectories);

/* fl_handle_motion.c */
/* 10: announces the points of both axes. */
FL_HANDLER(fl_handle_new_trajectory);
/* 11: a point, first those of alpha, then those of beta; counts and ticks. */
FL_HANDLER(fl_handle_point);
/* 12: judges the trajectory. */
FL_HANDLER(fl_handle_end);
/* 14: sets out, where a trajectory is loaded. */
FL_HANDLER(fl_handle_start);
/* 13, 15: phases off; 15 forgets a collision, too. */
FL_HANDLER(fl_handle_stop);
/* 30, 31: to positions, or by ways, counts; answers with the ticks it takes. */
FL_HANDLER(fl_handle_goto);
/* 20..28, 47..49: datum search and calibrations. */
FL_HANDLER(fl_handle_calibrate);

/* fl_handle_settings.c */
/* 33: declares both positions, counts. */
FL_HANDLER(fl_handle_set_position);
/* 34: offsets of the datum, counts. */
FL_HANDLER(fl_handle_get_offsets);
/* 35: the same; within 10 degrees of the output. */
FL_HANDLER(fl_handle_set_offsets);
/* 40: of go-to moves, rpm. */
FL_HANDLER(fl_handle_set_speed);
/* 41, 112: in open loop, at standstill; percent of the full field. */
FL_HANDLER(fl_handle_set_current);
/* 56, 113: the same. */
FL_HANDLER(fl_handle_get_current);
/* 111: motor degrees, -60..360. */
FL_HANDLER(fl_handle_collision_margin);
/* 118..125: closed or open loop, with or without collision detection. */
FL_HANDLER(fl_handle_loop);
/* 128..131: approach from one side. */
FL_HANDLER(fl_handle_precise);
/* 116, 117: remembered only. */
FL_HANDLER(fl_handle_hall_power);
/* 126, 127: remembered only. */
FL_HANDLER(fl_handle_led);
/* 53: calibrations into the storage. */
FL_HANDLER(fl_handle_save);
/* 140: sets what 139 tells. */
FL_HANDLER(fl_handle_set_trajectories);

/* fl_handle_bench.c */
/* 240: ticks per sample, 0 for off. */
FL_HANDLER(fl_handle_trace_start);
/* 241, 242: samples, ticks per sample, position of rotor angle zero. */
FL_HANDLER(fl_handle_trace_state);
/* 243, 244: a sample by its index. */
FL_HANDLER(fl_handle_trace_read);
/* 245, 246: two voltages and their ticks. */
FL_HANDLER(fl_handle_torque_step);

/* fl_handle_boot.c */
/* 200: size and CRC-32 of an image. */
FL_HANDLER(fl_handle_upgrade);
/* 201: its next bytes, 1 to 8. */
FL_HANDLER(fl_handle_image);

#endif
