/* One axis: hall sensor in, phase voltages out, and the plan of legs it works through.
 *
 * The axis works through a plan of legs (fl_leg.h). Three frames: the rotor angle (what the hall sensor sees,
 * unwrapped), the position (rotor angle + zero, 0 at output angle 0, 2^20 per motor turn = 2^30 per output
 * turn) and the raw command before smoothing, which is a position.
 */
#ifndef FL_AXIS_H
#define FL_AXIS_H

#include "fl_collision.h"
#include "fl_commutation.h"
#include "fl_drive.h"
#include "fl_friction_fit.h"
#include "fl_hall.h"
#include "fl_hall_fit.h"
#include "fl_landing.h"
#include "fl_leg.h"
#include "fl_params.h"
#include "fl_path.h"
#include "fl_port.h"
#include "fl_profile.h"
#include "fl_servo.h"
#include "fl_smooth.h"

/* What the laws need, computed once from the parameters. */
typedef struct fl_axis_law {
    fl_hall_config_t hall;
    fl_drive_config_t drive;
    float open_loop_voltage, holding_voltage;
    float acceleration_cnt_tick2;
    int32_t datum_step_cnt;
    uint32_t search_ticks;
    int32_t approach_cnt, landing_cnt, landing_step_cnt;
    int32_t tolerance_cnt;
    uint32_t settle_ticks, timeout_ticks;
    int32_t position_min_cnt, position_max_cnt, datum_cnt;
    uint32_t speed_max_cnt_tick;
} fl_axis_law_t;

typedef struct fl_leg {
    int32_t target_cnt;
    uint8_t kind; /* fl_leg_kind_t */
} fl_leg_t;

enum { FL_PLAN_LEGS = 6 };

typedef enum fl_axis_event {
    FL_AXIS_NONE,
    FL_AXIS_DONE,    /* the plan has ended: the axis rests */
    FL_AXIS_BLOCKED, /* collision */
} fl_axis_event_t;

/* For identification on a bench, Kronig 2020, Fig. 14: 32767 is u_dc, FL_TORQUE_OPEN the open bridge. */
typedef struct fl_torque_step {
    int16_t voltage[2];
    uint16_t ticks[2];
} fl_torque_step_t;

/* As a voltage: no switch of the bridge conducts, so that the rotor coasts without its back-EMF. */
enum { FL_TORQUE_OPEN = INT16_MIN };

/* A push ends after 0.2 s at the latest: at 6000 rpm 20 turns of the motor, 7 deg of the arm. */
enum { FL_TORQUE_TICKS = FL_TICK_HZ / 5 };

/* The trajectory's time on its way to a standstill: in 2^-16 of a tick. */
typedef struct fl_slow {
    int32_t from_cnt, to_cnt; /* the raw command at whole ticks of that time */
    uint32_t phase, rate;     /* between them; per tick */
} fl_slow_t;

/* So long it takes: 0.256 s, about the ramp of a go-to from 2000 rpm. */
enum { FL_SLOW_TICKS = 512, FL_SLOW_WHOLE = 1 << 16 };

/* What every tick touches comes first: it is what a simulator of many positioners waits for. */
typedef struct fl_axis {
    uint8_t leg, legs;
    bool fresh;   /* the next tick starts from where the rotor is */
    bool slowing; /* fl_axis_slow_down */
    bool closed_loop, detect, precise;
    bool datum_calibrated;
    bool datum_found;     /* by the search under way or the last one */
    bool datum_calibrate; /* that search defines the reference */
    uint16_t adc_cnt[2];  /* the hall channels, last */
    int32_t zero_cnt;     /* position - rotor angle */
    int32_t position_cnt; /* last measured; at rest where the move settled */
    int32_t raw_cnt;
    fl_hall_state_t hall;
    fl_drive_state_t drive;

    /* the last tick, for logs */
    fl_command_t command;
    fl_servo_out_t torque;
    float voltage;

    fl_path_cursor_t cursor;
    fl_axis_law_t law;
    fl_smooth_state_t smooth;
    fl_leg_t plan[FL_PLAN_LEGS];
    fl_profile_state_t profile;
    fl_slow_t slow;

    fl_settle_state_t wait;  /* in this leg: its ticks, those in which the rotor was calm, and its lag */
    int32_t calm_cnt;        /* rotor angle at which it was last calm; in a sweep or push a tick ago */
    int32_t datum_ref_cnt;   /* rotor angle of the datum within its turn */
    int32_t start_cnt;       /* where the plan began */
    float margin_rad;        /* SET_INCREASE_COLLISION_MARGIN */
    int32_t hall_error_mdeg; /* rms residual of the last hall calibration, motor millidegrees */
    int32_t offset_cnt;      /* SET_OFFSETS: added to the position of the datum */
    uint32_t speed_rpm;      /* of go-to moves */

    uint16_t start_adc_cnt[2]; /* where a hall calibration began */
    fl_torque_step_t push;
    union {
        fl_hall_fit_t hall;
        fl_friction_fit_t friction;
    } fit;
} fl_axis_t;

/* Constants from the parameters. Call again when a parameter has changed. Parameters outside their limits
 * (fl_params_fault) give constants with which no axis may move.
 * @pre the axis rests */
void fl_axis_configure(fl_axis_t *a, const fl_axis_params_t *params);
/* Forgets what the touch watch learnt: scatter and ripple of the load are those of hall shape and cogging.
 * @pre the axis rests */
void fl_axis_unlearn_touch(fl_axis_t *a, const fl_axis_params_t *params);
/* Forgets what the laws learnt on the way: integral, drag, scatter and ripple of the load.
 * @pre the axis rests */
void fl_axis_unlearn(fl_axis_t *a, const fl_axis_params_t *params);
/* Power-up state, fl_axis_configure included.
 * @pre none: also on memory that was never used */
void fl_axis_init(fl_axis_t *a, const fl_axis_params_t *params);

/* Whether the axis has no plan: then it is not ticked. */
static inline bool fl_axis_rests(const fl_axis_t *a) { return a->leg >= a->legs; }

/* Plans: what the axis was doing is forgotten, and the first tick starts from the measured position.
 * fl_axis_goto: to a position, 2^30 per output turn.
 * @pre the target is in range; fl_positioner gives a plan to an axis at rest only */
void fl_axis_goto(fl_axis_t *a, int32_t target_cnt);
/* Along the stored trajectory, then to rest at its last point.
 * @pre at least one point; the path is not changed while it is followed */
void fl_axis_follow(fl_axis_t *a, fl_path_t *path);
/* To the hard stop, which is the datum, then to position 0. `calibrate`: the stop defines the datum anew. */
void fl_axis_home(fl_axis_t *a, bool calibrate);
/* Turns the field and fits the shape of the hall channels; the result is in fit.hall at the end of the plan.
 */
void fl_axis_calibrate_hall(fl_axis_t *a);
/* Sweeps four motor turns each way and fits friction, spring and cogging; the result is in fit.friction. */
void fl_axis_calibrate_cogging(fl_axis_t *a);
/* Drives with these torques, then brakes. It ends early at the limits of the range.
 * @pre step.ticks add up to FL_TORQUE_TICKS at most; a voltage is FL_TORQUE_OPEN only on a board that opens
 *      its bridges */
void fl_axis_push(fl_axis_t *a, fl_torque_step_t step);
/* Stops on the way of a trajectory: its time runs slower and slower, so that axes which begin in the same
 * tick stay together on it. What has come to its landing ends as it would. Ends with the axis at rest, like
 * any plan.
 * @pre not in the first tick of the plan */
void fl_axis_slow_down(fl_axis_t *a);
/* Phases off at once (the coils brake), the rest of the plan forgotten. */
void fl_axis_brake(fl_axis_t *a, const fl_port_t *port, int index);

/* Phases off and no plan, whatever it was doing. */
void fl_axis_off(fl_axis_t *a, const fl_port_t *port, int index);

/* One control period.
 * @pre !fl_axis_rests; the path is the one given to fl_axis_follow */
fl_axis_event_t fl_axis_tick(fl_axis_t *a, const fl_path_t *path, const fl_port_t *port, int index);

/* The same in parts, for hosts that do the laws of many axes at once. While fl_axis_tracks:
 *   fl_hall_step and fl_drive_step, side by side, between them fl_axis_advance, after them fl_axis_conclude
 * is fl_axis_tick to the bit. */
typedef struct fl_axis_demand {
    fl_servo_in_t servo;
    bool way_ended; /* the leg's way; it may still have to settle */
} fl_axis_demand_t;

/* In closed loop along an ordinary way (FL_LEG_TRACKS), not in its first tick. */
static inline bool fl_axis_tracks(const fl_axis_t *a) {
    if (fl_axis_rests(a) || a->fresh || !a->closed_loop) return false;
    return (fl_leg_traits[a->plan[a->leg].kind].traits & FL_LEG_TRACKS) != 0;
}
/* Moves the command on by one tick.
 * @pre fl_axis_tracks; a->hall is that of this tick */
void fl_axis_advance(fl_axis_t *a, const fl_path_t *path, fl_axis_demand_t *demand);
/* Ends the tick: to the next leg, to rest, or blocked.
 * @pre fl_axis_tracks; a->drive, torque and voltage are those of this tick, the phases are set; but where it
 * is stuck, they are as in the tick before */
fl_axis_event_t fl_axis_conclude(fl_axis_t *a, const fl_port_t *port, int index, bool way_ended, bool stuck);

/* Reads the sensors outside the tick; the unwrapped rotor angle. */
int32_t fl_axis_look(fl_axis_t *a, const fl_port_t *port, int index);

/* How far the rotor is now from the position, which stays what it was when the axis came to rest: without
 * current the cogging turns it inside the backlash. Counts. */
int32_t fl_axis_fallen(fl_axis_t *a, const fl_port_t *port, int index);

/* Declares the position, 2^30 per output turn, and with it the datum: that of the rotor as it is now, or, if
 * the axis has `settled`, that in place of the one it has come to rest at. */
void fl_axis_set_position(fl_axis_t *a, const fl_port_t *port, int index, int32_t position_cnt, bool settled);

/* Ticks that a go-to from the present position takes at most, settling not counted:
 * |way|/speed + 0.25 s, and the approach if the axis is precise. */
uint32_t fl_axis_goto_ticks(const fl_axis_t *a, int32_t target_cnt);

/* Whether a position (2^30 per output turn) lies within position_min..position_max. */
bool fl_axis_in_range(const fl_axis_t *a, int32_t position_cnt);

#endif
