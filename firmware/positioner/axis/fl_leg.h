/* The legs that a plan is made of. How each behaves is one row of FL_LEGS; the rest of the axis asks for
 * traits, never for the kind. */
#ifndef FL_LEG_H
#define FL_LEG_H

#include <stdint.h>

/* X(kind, what its ticks do, how the raw command moves, what is measured, traits)
 *
 * REST is a move to where the axis is; FOLLOW the stored trajectory, GOTO a trapezoid, LAND the creep to the
 * target and SETTLE the wait there; SEARCH turns until the hard stop and DATUM waits for standstill there;
 * BRAKE coasts to the plan's end; SPIN turns the field of a hall calibration; SWEEP_IN closes the backlash
 * before the SWEEP that measures friction; PUSH is the bench's torque step. */
/* clang-format off */
#define FL_LEGS(X)                                                                                           \
    X(REST,       REST,  STAY,    NOTHING, 0)                                                                \
    X(FOLLOW,     DRIVE, PATH,    NOTHING, FL_LEG_TRACKS)                                                    \
    X(GOTO,       DRIVE, PROFILE, NOTHING, FL_LEG_TRACKS)                                                    \
    X(LAND,       DRIVE, LAND,    NOTHING, FL_LEG_TRACKS | FL_LEG_CREEPS)                                    \
    X(SETTLE,     DRIVE, STAY,    NOTHING, FL_LEG_TRACKS | FL_LEG_CREEPS | FL_LEG_SETTLES)                   \
    X(SEARCH,     DRIVE, SEARCH,  NOTHING, FL_LEG_SEEKS)                                                     \
    X(DATUM,      COAST, STAY,    NOTHING, FL_LEG_DATUM_HERE)                                                \
    X(BRAKE,      COAST, STAY,    NOTHING, 0)                                                                \
    X(SPIN,       DRIVE, SPIN,    NOTHING, FL_LEG_BLIND)                                                     \
    X(SPIN_RANGE, DRIVE, SPIN,    RANGE,   FL_LEG_BLIND)                                                     \
    X(SPIN_FIT,   DRIVE, SPIN,    SHAPE,   FL_LEG_BLIND)                                                     \
    X(SWEEP_IN,   DRIVE, SWEEP,   NOTHING, FL_LEG_CREEPS | FL_LEG_CLOSED)                                    \
    X(SWEEP,      DRIVE, SWEEP,   TORQUE,  FL_LEG_CREEPS | FL_LEG_CLOSED)                                    \
    X(PUSH,       PUSH,  STAY,    NOTHING, 0)
/* clang-format on */

typedef enum fl_leg_kind {
#define X(kind, does, step, measures, traits) FL_LEG_##kind,
    FL_LEGS(X)
#undef X
        FL_LEG_KINDS
} fl_leg_kind_t;

/* What a tick does. */
typedef enum fl_leg_does {
    FL_DOES_DRIVE, /* moves the command on and lets the rotor follow */
    FL_DOES_COAST, /* phases off, until the rotor stands */
    FL_DOES_PUSH,  /* a torque without a loop */
    FL_DOES_REST,  /* ends the plan */
} fl_leg_does_t;

/* How the raw command moves on. */
typedef enum fl_leg_step {
    FL_STEP_STAY,
    FL_STEP_PATH,
    FL_STEP_PROFILE,
    FL_STEP_LAND,   /* towards the target, slower and slower */
    FL_STEP_SEARCH, /* in the negative direction, without an end */
    FL_STEP_SPIN,   /* towards the target at the speed of the hall calibration */
    FL_STEP_SWEEP,  /* the same at four times the landing speed */
} fl_leg_step_t;

/* What a calibration takes from each tick. */
typedef enum fl_leg_measures {
    FL_MEASURES_NOTHING,
    FL_MEASURES_RANGE,  /* of the hall channels */
    FL_MEASURES_SHAPE,  /* their ellipse */
    FL_MEASURES_TORQUE, /* that keeps the rotor moving */
} fl_leg_measures_t;

/* Traits, as bits. */
enum {
    FL_LEG_TRACKS = 1 << 0,  /* an ordinary way: a host may do its laws side by side with those of others */
    FL_LEG_CREEPS = 1 << 1,  /* the servo has its gains of creep speed */
    FL_LEG_CLOSED = 1 << 2,  /* in closed loop even if the axis is set to open loop */
    FL_LEG_BLIND = 1 << 3,   /* in open loop whatever the axis is set to; nothing blocks it */
    FL_LEG_SEEKS = 1 << 4,   /* what blocks ends the leg, even with detection off; it gives up in the end */
    FL_LEG_SETTLES = 1 << 5, /* the plan ends when the rotor does not lag */
    FL_LEG_DATUM_HERE = 1 << 6, /* where it comes to stand is the datum */
};

typedef struct fl_leg_traits {
    uint8_t does, step, measures, traits;
} fl_leg_traits_t;

/* By kind. */
extern const fl_leg_traits_t fl_leg_traits[FL_LEG_KINDS];

#endif
