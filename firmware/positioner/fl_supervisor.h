/* What a positioner may do: a table of rules and one pure matcher. First match wins.
 *
 * The supervisor sits above the laws and receives only states, inputs and conditions. It answers
 * with a response code and the next state; whoever asked acts on it.
 */
#ifndef FL_SUPERVISOR_H
#define FL_SUPERVISOR_H

#include <stdint.h>

#include "fl_codes.h"

typedef enum fl_state {
    FL_STATE_IDLE,     /* at rest, nothing loaded */
    FL_STATE_LOADING,  /* between commands 10 and 12 */
    FL_STATE_LOADED,   /* a trajectory waits for START */
    FL_STATE_REFUSED,  /* the trajectory was bad: START must say so again */
    FL_STATE_MOVING,   /* trajectory or go-to */
    FL_STATE_STOPPING, /* phases off, not yet at a standstill */
    FL_STATE_HOMING,   /* datum search */
    FL_STATE_HALL_CALIBRATION,
    FL_STATE_DATUM_CALIBRATION,
    FL_STATE_COGGING_CALIBRATION,
    FL_STATE_BOOTLOADER,
    FL_STATE_COUNT
} fl_state_t;

/* What can happen: classes of commands, then events from inside. */
typedef enum fl_input {
    FL_IN_QUERY,   /* reads, and settings that are always allowed */
    FL_IN_SETTING, /* settings that need the axes at rest */
    FL_IN_NEW,     /* 10 */
    FL_IN_POINT,   /* 11 */
    FL_IN_END,     /* 12 */
    FL_IN_START,   /* 14 */
    FL_IN_STOP,    /* 13, 15 */
    FL_IN_GOTO,    /* 30, 31 */
    FL_IN_HOME,    /* 20 - 22 */
    FL_IN_CALIBRATE_HALL,
    FL_IN_CALIBRATE_DATUM,
    FL_IN_CALIBRATE_COGGING,
    FL_IN_BOOT,       /* 200, 201 */
    FL_IN_IMPOSSIBLE, /* 18: known, never a request */
    FL_IN_DONE,       /* all axes rest */
    FL_IN_COLLISION,
    FL_IN_BAD_TRAJECTORY,
    FL_IN_COUNT
} fl_input_t;

/* Conditions, as bits. */
enum {
    FL_IF_COLLIDED = 1 << 0,
    FL_IF_HALL_UNCALIBRATED = 1 << 1,
    FL_IF_DATUM_UNCALIBRATED = 1 << 2,
    FL_IF_DATUM_UNKNOWN = 1 << 3,
    FL_IF_BAD_PARAMETERS = 1 << 4,
    FL_IF_COUNT = 5
};

typedef struct fl_verdict {
    uint8_t next; /* the state if the command is carried out */
    uint8_t code; /* fl_code_t; the state does not change unless it is FL_ACCEPTED */
} fl_verdict_t;

fl_verdict_t fl_supervisor_match(fl_state_t state, fl_input_t input, uint32_t conditions);

#endif
