/* What a positioner may do: a table of rules and one pure matcher. First match wins.
 *
 * The supervisor sits above the laws and receives only states, inputs and conditions. It answers
 * with a response code and the next state; the caller acts on it.
 */
#ifndef FL_SUPERVISOR_H
#define FL_SUPERVISOR_H

#include <stdint.h>

#include "fl_codes.h"

/* X(name): what a positioner is at. Up to REFUSED the axes rest. */
#define FL_STATES(X)                                                                                         \
    X(IDLE)     /* at rest, nothing loaded */                                                                \
    X(LOADING)  /* between commands 10 and 12 */                                                             \
    X(LOADED)   /* a trajectory waits for START */                                                           \
    X(REFUSED)  /* the trajectory was bad: START must say so again */                                        \
    X(MOVING)   /* trajectory or go-to */                                                                    \
    X(STOPPING) /* phases off, not yet at a standstill */                                                    \
    X(HOMING)   /* datum search */                                                                           \
    X(HALL_CALIBRATION)                                                                                      \
    X(DATUM_CALIBRATION)                                                                                     \
    X(COGGING_CALIBRATION)                                                                                   \
    X(BOOTLOADER)

typedef enum fl_state {
#define X(name) FL_STATE_##name,
    FL_STATES(X)
#undef X
        FL_STATE_COUNT
} fl_state_t;

/* X(name): what can happen. Classes of commands, then events from inside. */
#define FL_INPUTS(X)                                                                                         \
    X(QUERY)   /* reads, and settings that are always allowed */                                             \
    X(SETTING) /* settings that need the axes at rest */                                                     \
    X(NEW)     /* 10 */                                                                                      \
    X(POINT)   /* 11 */                                                                                      \
    X(END)     /* 12 */                                                                                      \
    X(START)   /* 14 */                                                                                      \
    X(STOP)    /* 13, 15 */                                                                                  \
    X(GOTO)    /* 30, 31 */                                                                                  \
    X(HOME)    /* 20 - 22 */                                                                                 \
    X(CALIBRATE_HALL)                                                                                        \
    X(CALIBRATE_DATUM)                                                                                       \
    X(CALIBRATE_COGGING)                                                                                     \
    X(BOOT)       /* 200, 201 */                                                                             \
    X(IMPOSSIBLE) /* 18: known, never a request */                                                           \
    X(DONE)       /* all axes rest */                                                                        \
    X(COLLISION)                                                                                             \
    X(BAD_TRAJECTORY)

typedef enum fl_input {
#define X(name) FL_IN_##name,
    FL_INPUTS(X)
#undef X
        FL_IN_COUNT
} fl_input_t;

/* X(name, bit): what may stand against an input. */
#define FL_CONDITIONS(X)                                                                                     \
    X(COLLIDED, 0)                                                                                           \
    X(HALL_UNCALIBRATED, 1)                                                                                  \
    X(DATUM_UNCALIBRATED, 2)                                                                                 \
    X(DATUM_UNKNOWN, 3)                                                                                      \
    X(BAD_PARAMETERS, 4)

enum {
#define X(name, bit) FL_IF_##name = 1 << (bit),
    FL_CONDITIONS(X)
#undef X
};

typedef struct fl_verdict {
    uint8_t next; /* the state if the command is carried out */
    uint8_t code; /* fl_code_t; the state does not change unless it is FL_ACCEPTED */
} fl_verdict_t;

/* The verdict of the table; conditions are FL_IF_... bits. Pure. */
fl_verdict_t fl_supervisor_match(fl_state_t state, fl_input_t input, uint32_t conditions);

#endif
