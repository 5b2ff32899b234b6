#include "fl_supervisor.h"

#define S(name) (1u << FL_STATE_##name)
#define I(name) (1u << FL_IN_##name)

enum { SAME = 0xff };

#define ANY 0xffffffffu
#define RESTING (S(IDLE) | S(LOADING) | S(LOADED) | S(REFUSED))
#define TRAVELLING (S(MOVING) | S(STOPPING))
#define CALIBRATING (S(HOMING) | S(HALL_CALIBRATION) | S(DATUM_CALIBRATION) | S(COGGING_CALIBRATION))
#define ACTIVE (TRAVELLING | CALIBRATING)

#define CALIBRATE (I(CALIBRATE_HALL) | I(CALIBRATE_DATUM) | I(CALIBRATE_COGGING))
#define LOAD (I(NEW) | I(POINT) | I(END))
#define MOVE (I(GOTO) | I(HOME) | CALIBRATE)
#define AT_REST_ONLY (LOAD | I(START) | MOVE | I(SETTING))

typedef struct rule {
    uint32_t states, inputs;
    uint8_t if_any; /* 0: whatever the conditions */
    uint8_t next;
    uint8_t code;
} rule_t;

static const rule_t rules[] = {
    /* the bootloader knows its own commands and the queries marked for it (checked at dispatch) */
    {S(BOOTLOADER), I(BOOT) | I(QUERY), 0, SAME, FL_ACCEPTED},
    {S(BOOTLOADER), ANY, 0, SAME, FL_INVALID_BOOTLOADER_COMMAND},
    {ANY, I(BOOT) | I(IMPOSSIBLE), 0, SAME, FL_INVALID_COMMAND},
    {ANY, I(QUERY), 0, SAME, FL_ACCEPTED},

    /* stopping is always possible; what is loaded is dropped */
    {ACTIVE, I(STOP), 0, FL_STATE_STOPPING, FL_ACCEPTED},
    {ANY, I(STOP), 0, FL_STATE_IDLE, FL_ACCEPTED},

    /* from inside */
    {ACTIVE, I(COLLISION), 0, FL_STATE_STOPPING, FL_ACCEPTED},
    {ACTIVE, I(DONE), 0, FL_STATE_IDLE, FL_ACCEPTED},
    {S(LOADING), I(BAD_TRAJECTORY), 0, FL_STATE_REFUSED, FL_ACCEPTED},
    {ANY, I(COLLISION) | I(DONE) | I(BAD_TRAJECTORY), 0, SAME, FL_ACCEPTED},

    /* one thing at a time */
    {CALIBRATING, AT_REST_ONLY, 0, SAME, FL_CALIBRATION_MODE_ACTIVE},
    {TRAVELLING, AT_REST_ONLY, 0, SAME, FL_ALREADY_IN_MOTION},
    {RESTING, I(SETTING), 0, SAME, FL_ACCEPTED},

    /* nothing moves on parameters that cannot be */
    {RESTING, I(NEW) | I(START) | MOVE, FL_IF_BAD_PARAMETERS, SAME, FL_INVALID_COMMAND},

    /* a collision is cleared first, by STOP_TRAJECTORY */
    {RESTING, I(NEW) | I(START) | MOVE, FL_IF_COLLIDED, SAME, FL_COLLISION_DETECTED},

    /* what must have been calibrated before */
    {RESTING, I(CALIBRATE_HALL), 0, FL_STATE_HALL_CALIBRATION, FL_ACCEPTED},
    {RESTING, I(NEW) | MOVE, FL_IF_HALL_UNCALIBRATED, SAME, FL_MOTOR_NOT_CALIBRATED},
    {RESTING, I(CALIBRATE_DATUM), 0, FL_STATE_DATUM_CALIBRATION, FL_ACCEPTED},
    {RESTING, I(HOME), FL_IF_DATUM_UNCALIBRATED, SAME, FL_DATUM_NOT_CALIBRATED},
    {RESTING, I(HOME), 0, FL_STATE_HOMING, FL_ACCEPTED},
    {RESTING, I(NEW) | I(GOTO) | I(CALIBRATE_COGGING), FL_IF_DATUM_UNKNOWN, SAME, FL_DATUM_NOT_INITIALIZED},
    {RESTING, I(CALIBRATE_COGGING), 0, FL_STATE_COGGING_CALIBRATION, FL_ACCEPTED},
    {RESTING, I(GOTO), 0, FL_STATE_MOVING, FL_ACCEPTED},

    /* trajectories; a new one replaces the old one */
    {RESTING, I(NEW), 0, FL_STATE_LOADING, FL_ACCEPTED},
    {S(LOADING), I(POINT), 0, SAME, FL_ACCEPTED},
    {S(LOADING), I(END), 0, FL_STATE_LOADED, FL_ACCEPTED},
    {RESTING, I(POINT) | I(END), 0, SAME, FL_INVALID_TRAJECTORY},
    {S(LOADED), I(START), FL_IF_DATUM_UNKNOWN, SAME, FL_DATUM_NOT_INITIALIZED},
    {S(LOADED), I(START), 0, FL_STATE_MOVING, FL_ACCEPTED},
    {S(LOADING) | S(REFUSED), I(START), 0, SAME, FL_INVALID_TRAJECTORY},
    /* a START for the others: accepted, no motion */
    {S(IDLE), I(START), 0, SAME, FL_ACCEPTED},
};

fl_verdict_t fl_supervisor_match(fl_state_t state, fl_input_t input, uint32_t conditions) {
    for (unsigned i = 0; i < sizeof rules / sizeof *rules; ++i) {
        const rule_t *r = &rules[i];
        if (!(r->states >> state & 1u) || !(r->inputs >> input & 1u)) continue;
        if (r->if_any != 0 && !(r->if_any & conditions)) continue;
        const fl_verdict_t verdict = {r->next == SAME ? (uint8_t)state : r->next, r->code};
        return verdict;
    }
    const fl_verdict_t verdict = {(uint8_t)state, FL_INVALID_COMMAND};
    return verdict;
}
