/* The plans: which legs a move, a calibration or a stop is made of. */
#include "fl_axis_parts.h"

/* The signed length of the landing at the end of a way. */
static int32_t landing(const fl_axis_t *a, int32_t way_cnt) {
    const int32_t most = a->law.landing_cnt;
    return way_cnt > most ? most : way_cnt < -most ? -most : way_cnt;
}

/* The end of every move: at the target from the direction of the way to it. */
static void plan_arrival(fl_axis_t *a, int32_t target_cnt) {
    fl_axis_add_leg(a, FL_LEG_LAND, target_cnt);
    fl_axis_add_leg(a, FL_LEG_SETTLE, target_cnt);
}

/* Overshoots in the positive direction, then ends against the spring. */
static void plan_precise(fl_axis_t *a, int32_t target_cnt) {
    fl_axis_add_leg(a, FL_LEG_GOTO, fl_add_i32(target_cnt, a->law.approach_cnt));
    fl_axis_add_leg(a, FL_LEG_GOTO, fl_sub_i32(target_cnt, landing(a, -a->law.approach_cnt)));
    plan_arrival(a, target_cnt);
}

/* An axis that is to stay where it is does not start its motor: landing and settling on the spot again and
 * again would let it creep. */
static bool stays(const fl_axis_t *a, int32_t way_cnt) {
    return !a->precise && fl_abs_i32(way_cnt) <= a->law.tolerance_cnt;
}

static void plan_goto(fl_axis_t *a, int32_t from_cnt, int32_t target_cnt) {
    if (a->precise) {
        plan_precise(a, target_cnt);
        return;
    }
    const int32_t way = fl_sub_i32(target_cnt, from_cnt);
    fl_axis_add_leg(a, FL_LEG_GOTO, fl_sub_i32(target_cnt, landing(a, way)));
    plan_arrival(a, target_cnt);
}

void fl_axis_goto(fl_axis_t *a, int32_t target_cnt) {
    fl_axis_clear_plan(a);
    if (stays(a, fl_sub_i32(target_cnt, a->position_cnt)))
        fl_axis_add_leg(a, FL_LEG_REST, target_cnt);
    else
        plan_goto(a, a->position_cnt, target_cnt);
}

void fl_axis_follow(fl_axis_t *a, fl_path_t *path) {
    const bool flat = path->plateau_slot == 0;
    const int32_t before =
        flat ? a->position_cnt : (int32_t)fl_path_value(path, (uint16_t)(path->plateau_slot - 1));
    fl_axis_clear_plan(a);
    if (flat && stays(a, fl_sub_i32(path->last_cnt, a->position_cnt))) {
        fl_axis_add_leg(a, FL_LEG_REST, path->last_cnt);
        return;
    }
    fl_axis_add_leg(a, FL_LEG_FOLLOW, path->last_cnt);
    path->landing_cnt = 0;
    if (a->precise) {
        plan_precise(a, path->last_cnt);
    } else {
        path->landing_cnt = landing(a, fl_sub_i32(path->last_cnt, before));
        plan_arrival(a, path->last_cnt);
    }
}

void fl_axis_home(fl_axis_t *a, bool calibrate) {
    fl_axis_clear_plan(a);
    fl_axis_add_leg(a, FL_LEG_SEARCH, 0);
    fl_axis_add_leg(a, FL_LEG_DATUM, 0);
    plan_goto(a, fl_axis_datum_cnt(a), 0);
    a->datum_found = false;
    a->datum_calibrate = calibrate;
}

/* Towards the middle of the range, where calibrations find room. */
static int32_t inward(const fl_axis_t *a, float turns) {
    const int64_t middle = ((int64_t)a->law.position_min_cnt + a->law.position_max_cnt) / 2;
    const int32_t way = fl_round_i32(turns * (float)FL_TURN_CNT);
    return fl_add_i32(a->position_cnt, a->position_cnt < middle ? way : -way);
}

/* Two turns for the range, four for the shape, back to the start; then the field holds until the
 * rotor is at a standstill. */
void fl_axis_calibrate_hall(fl_axis_t *a) {
    fl_axis_clear_plan(a);
    fl_axis_add_leg(a, FL_LEG_SPIN_RANGE, inward(a, 2.0f));
    fl_axis_add_leg(a, FL_LEG_SPIN_FIT, inward(a, 4.0f));
    fl_axis_add_leg(a, FL_LEG_SPIN_FIT, inward(a, 2.0f));
    fl_axis_add_leg(a, FL_LEG_SPIN, a->position_cnt);
    fl_axis_add_leg(a, FL_LEG_BRAKE, a->position_cnt);
    fl_hall_fit_reset(&a->fit.hall);
}

/* A turn and a half closes any backlash; four turns are measured each way. */
void fl_axis_calibrate_cogging(fl_axis_t *a) {
    fl_axis_clear_plan(a);
    fl_axis_add_leg(a, FL_LEG_SWEEP_IN, inward(a, 1.5f));
    fl_axis_add_leg(a, FL_LEG_SWEEP, inward(a, 5.5f));
    fl_axis_add_leg(a, FL_LEG_SWEEP_IN, inward(a, 4.0f));
    fl_axis_add_leg(a, FL_LEG_SWEEP, a->position_cnt);
    fl_axis_add_leg(a, FL_LEG_SETTLE, a->position_cnt);
    fl_friction_fit_reset(&a->fit.friction);
}

void fl_axis_push(fl_axis_t *a, fl_torque_step_t step) {
    fl_axis_clear_plan(a);
    a->push = step;
    fl_axis_add_leg(a, FL_LEG_PUSH, 0);
    fl_axis_add_leg(a, FL_LEG_BRAKE, 0);
}

void fl_axis_slow_down(fl_axis_t *a) {
    if (fl_axis_rests(a)) return;
    a->slowing = true;
    a->slow = (fl_slow_t){a->raw_cnt, a->raw_cnt, FL_SLOW_WHOLE, FL_SLOW_WHOLE};
}

void fl_axis_stop_here(fl_axis_t *a) {
    a->slowing = false;
    a->legs = (uint8_t)(a->leg + 1);
    plan_arrival(a, a->raw_cnt);
}

static const float off[3] = {0.0f, 0.0f, 0.0f};

void fl_axis_phases_off(fl_axis_t *a, const fl_port_t *port, int index) {
    a->voltage = 0.0f;
    a->command.speed_rad_s = 0.0f;
    port->set_phases(port->ctx, index, off);
}

void fl_axis_brake(fl_axis_t *a, const fl_port_t *port, int index) {
    if (fl_axis_rests(a) || a->plan[a->leg].kind == FL_LEG_BRAKE) return;
    fl_axis_clear_plan(a);
    fl_axis_add_leg(a, FL_LEG_BRAKE, 0);
    fl_axis_phases_off(a, port, index);
}

void fl_axis_off(fl_axis_t *a, const fl_port_t *port, int index) {
    fl_axis_clear_plan(a);
    fl_axis_phases_off(a, port, index);
}
