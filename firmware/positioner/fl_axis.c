#include "fl_axis.h"

/* Seldom done inside a tick: kept apart, so that the compiler does not shape the rest around it. Loads
 * of both hall channels at once, which copies invite, would wait for the two stores of read_hall. */
#define FL_COLD __attribute__((noinline, cold))

/* Field speed of the hall calibration: 240 rpm */
enum { SPIN_STEP_CNT = 2097 };

static const float off[3] = {0.0f, 0.0f, 0.0f};

/* -- plans --------------------------------------------------------------------------------------- */

static void plan_clear(fl_axis_t *a) {
    a->leg = a->legs = 0;
    a->leg_ticks = a->calm_ticks = 0;
    a->fresh = true;
}

static void plan_add(fl_axis_t *a, fl_leg_kind_t kind, int32_t target_cnt) {
    a->plan[a->legs++] = (fl_leg_t){target_cnt, (uint8_t)kind};
}

/* The signed length of the landing at the end of a way. */
static int32_t landing(const fl_axis_t *a, int32_t way_cnt) {
    const int32_t most = a->law.landing_cnt;
    return way_cnt > most ? most : way_cnt < -most ? -most : way_cnt;
}

/* The end of every move: at the target from the direction of the way to it. */
static void plan_arrival(fl_axis_t *a, int32_t target_cnt) {
    plan_add(a, FL_LEG_LAND, target_cnt);
    plan_add(a, FL_LEG_SETTLE, target_cnt);
}

/* Overshoots in the positive direction, then ends against the spring. */
static void plan_precise(fl_axis_t *a, int32_t target_cnt) {
    plan_add(a, FL_LEG_GOTO, fl_add_i32(target_cnt, a->law.approach_cnt));
    plan_add(a, FL_LEG_GOTO, fl_sub_i32(target_cnt, landing(a, -a->law.approach_cnt)));
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
    plan_add(a, FL_LEG_GOTO, fl_sub_i32(target_cnt, landing(a, way)));
    plan_arrival(a, target_cnt);
}

void fl_axis_goto(fl_axis_t *a, int32_t target_cnt) {
    plan_clear(a);
    if (stays(a, fl_sub_i32(target_cnt, a->position_cnt)))
        plan_add(a, FL_LEG_REST, target_cnt);
    else
        plan_goto(a, a->position_cnt, target_cnt);
}

void fl_axis_follow(fl_axis_t *a, fl_path_t *path) {
    const bool flat = path->plateau_slot == 0;
    const int32_t before =
        flat ? a->position_cnt : (int32_t)fl_path_value(path, (uint16_t)(path->plateau_slot - 1));
    plan_clear(a);
    if (flat && stays(a, fl_sub_i32(path->last_cnt, a->position_cnt))) {
        plan_add(a, FL_LEG_REST, path->last_cnt);
        return;
    }
    plan_add(a, FL_LEG_FOLLOW, path->last_cnt);
    path->landing_cnt = 0;
    if (a->precise) {
        plan_precise(a, path->last_cnt);
    } else {
        path->landing_cnt = landing(a, fl_sub_i32(path->last_cnt, before));
        plan_arrival(a, path->last_cnt);
    }
}

static int32_t datum(const fl_axis_t *a) { return fl_add_i32(a->law.datum_cnt, a->offset_cnt); }

void fl_axis_home(fl_axis_t *a, bool calibrate) {
    plan_clear(a);
    plan_add(a, FL_LEG_SEARCH, 0);
    plan_add(a, FL_LEG_DATUM, 0);
    plan_goto(a, datum(a), 0);
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
 * rotor stands. */
void fl_axis_calibrate_hall(fl_axis_t *a) {
    plan_clear(a);
    plan_add(a, FL_LEG_SPIN_RANGE, inward(a, 2.0f));
    plan_add(a, FL_LEG_SPIN_FIT, inward(a, 4.0f));
    plan_add(a, FL_LEG_SPIN_FIT, inward(a, 2.0f));
    plan_add(a, FL_LEG_SPIN, a->position_cnt);
    plan_add(a, FL_LEG_BRAKE, a->position_cnt);
    fl_hall_fit_reset(&a->fit.hall);
}

/* A turn and a half closes any backlash; four turns are measured each way. */
void fl_axis_calibrate_cogging(fl_axis_t *a) {
    plan_clear(a);
    plan_add(a, FL_LEG_SWEEP_IN, inward(a, 1.5f));
    plan_add(a, FL_LEG_SWEEP, inward(a, 5.5f));
    plan_add(a, FL_LEG_SWEEP_IN, inward(a, 4.0f));
    plan_add(a, FL_LEG_SWEEP, a->position_cnt);
    plan_add(a, FL_LEG_SETTLE, a->position_cnt);
    fl_friction_fit_reset(&a->fit.friction);
}

void fl_axis_push(fl_axis_t *a, fl_torque_step_t step) {
    plan_clear(a);
    a->push = step;
    plan_add(a, FL_LEG_PUSH, 0);
    plan_add(a, FL_LEG_BRAKE, 0);
}

static void phases_off(fl_axis_t *a, const fl_port_t *port, int index) {
    a->voltage = 0.0f;
    a->command.speed_rad_s = 0.0f;
    port->set_phases(port->ctx, index, off);
}

void fl_axis_brake(fl_axis_t *a, const fl_port_t *port, int index) {
    if (fl_axis_rests(a) || a->plan[a->leg].kind == FL_LEG_BRAKE) return;
    plan_clear(a);
    plan_add(a, FL_LEG_BRAKE, 0);
    phases_off(a, port, index);
}

void fl_axis_off(fl_axis_t *a, const fl_port_t *port, int index) {
    plan_clear(a);
    phases_off(a, port, index);
}

/* -- positions ----------------------------------------------------------------------------------- */

static fl_hall_out_t look(fl_axis_t *a, const fl_port_t *port, int index) {
    port->read_hall(port->ctx, index, a->adc_cnt);
    return fl_hall_step(&a->law.hall, &a->hall, a->adc_cnt);
}

int32_t fl_axis_look(fl_axis_t *a, const fl_port_t *port, int index) {
    return look(a, port, index).angle_cnt;
}

static void declare(fl_axis_t *a, int32_t position_cnt) {
    a->zero_cnt = fl_sub_i32(position_cnt, a->hall.angle_cnt);
    a->position_cnt = a->command.position_cnt = position_cnt;
}

void fl_axis_set_position(fl_axis_t *a, const fl_port_t *port, int index, int32_t position_cnt) {
    look(a, port, index);
    declare(a, position_cnt);
    a->datum_ref_cnt = fl_sub_i32(datum(a), a->zero_cnt) & (FL_TURN_CNT - 1);
    a->datum_calibrated = true;
}

/* The datum is the calibrated rotor angle nearest to where the axis came to stand, so that it does
 * not depend on how hard the stop was pressed. */
static void declare_datum(fl_axis_t *a) {
    if (a->datum_calibrate) {
        a->datum_ref_cnt = a->hall.angle_cnt & (FL_TURN_CNT - 1);
        a->datum_calibrated = true;
    }
    a->datum_found = true;
    const int32_t past = fl_fold_cnt(fl_sub_i32(a->hall.angle_cnt, a->datum_ref_cnt));
    declare(a, fl_add_i32(datum(a), past));
}

bool fl_axis_in_range(const fl_axis_t *a, int32_t position_cnt) {
    /* the limits are rounded to float32: a thousandth of a degree of grace */
    const int32_t grace = 2983;
    return position_cnt >= fl_sub_i32(a->law.position_min_cnt, grace) &&
           position_cnt <= fl_add_i32(a->law.position_max_cnt, grace);
}

/* Go-to moves reach their speed within 0.25 s at the latest: jaeger's estimate of their duration. */
static fl_profile_limits_t goto_limits(const fl_axis_t *a) {
    const float speed = (float)a->speed_rpm * FL_CNT_TICK_PER_RPM;
    const fl_profile_limits_t lim = {
        speed, fl_max(a->law.acceleration_cnt_tick2, speed * (1.0f / (0.25f * FL_TICK_HZ)))};
    return lim;
}

static uint32_t way_ticks(const fl_axis_t *a, int32_t way_cnt) {
    const float speed = (float)a->speed_rpm * FL_CNT_TICK_PER_RPM;
    return (uint32_t)(fl_abs((float)way_cnt) / speed) + FL_TICK_HZ / 4;
}

uint32_t fl_axis_goto_ticks(const fl_axis_t *a, int32_t target_cnt) {
    const int32_t way = fl_sub_i32(target_cnt, a->position_cnt);
    if (!a->precise) return way_ticks(a, way);
    return way_ticks(a, fl_add_i32(way, a->law.approach_cnt)) + way_ticks(a, a->law.approach_cnt);
}

/* -- the tick ------------------------------------------------------------------------------------ */

static void leg_enter(fl_axis_t *a) {
    a->leg_ticks = a->calm_ticks = 0;
    a->lag_cnt = 0;
    a->calm_cnt = a->hall.angle_cnt;
    if (fl_axis_rests(a)) return;
    const fl_leg_t leg = a->plan[a->leg];
    if (leg.kind == FL_LEG_GOTO) fl_profile_start(&a->profile, a->raw_cnt, leg.target_cnt, goto_limits(a));
    /* what the integral made up for in motion is gone at standstill */
    if (leg.kind == FL_LEG_LAND) a->drive.servo.integral_Nm = 0.0f;
    if (leg.kind == FL_LEG_FOLLOW) fl_path_start(&a->cursor, a->raw_cnt);
}

static void leg_next(fl_axis_t *a) {
    ++a->leg;
    leg_enter(a);
}

/* From where the rotor is, without a jump. */
FL_COLD static void plan_begin(fl_axis_t *a) {
    a->raw_cnt = a->position_cnt;
    fl_smooth_reset(&a->smooth, a->raw_cnt);
    a->drive.servo.integral_Nm = a->drive.servo.direction = 0.0f;
    a->drive.touch = (fl_touch_state_t){.scatter_Nm = a->drive.touch.scatter_Nm};
    a->fresh = false;
    a->start_cnt = a->position_cnt;
    for (int i = 0; i < 2; ++i) a->start_adc_cnt[i] = a->adc_cnt[i];
    leg_enter(a);
}

/* Slower and slower: 64 ms times the remaining way, and the landing speed. */
static int32_t landing_step(const fl_axis_t *a, int32_t target_cnt) {
    const int32_t way = fl_abs_i32(fl_sub_i32(target_cnt, a->raw_cnt));
    return a->law.landing_step_cnt + (way >> 7);
}

/* One step of at most step_cnt towards the target; true when there. */
static bool creep(fl_axis_t *a, int32_t target_cnt, int32_t step_cnt) {
    const int32_t way = fl_sub_i32(target_cnt, a->raw_cnt);
    const bool there = way <= step_cnt && way >= -step_cnt;
    a->raw_cnt = there ? target_cnt : fl_add_i32(a->raw_cnt, way > 0 ? step_cnt : -step_cnt);
    return there;
}

/* Moves the raw command on by one tick; true when the leg's way has ended. */
static bool leg_step(fl_axis_t *a, const fl_path_t *path) {
    const fl_leg_t leg = a->plan[a->leg];
    switch (leg.kind) {
    case FL_LEG_FOLLOW:
        a->raw_cnt = fl_path_step(path, &a->cursor);
        return fl_path_done(path, &a->cursor);
    case FL_LEG_GOTO:
        a->raw_cnt = fl_profile_step(&a->profile);
        return fl_profile_done(&a->profile);
    case FL_LEG_LAND:
        return creep(a, leg.target_cnt, landing_step(a, leg.target_cnt));
    case FL_LEG_SEARCH:
        a->raw_cnt = fl_sub_i32(a->raw_cnt, a->law.datum_step_cnt);
        /* the stop is found by the same rule from near and far: the touch watch needs some way first, and
         * where it stops the gear is wound up less, by which the datum could be a motor turn off */
        a->drive.touch.way_rad = 0.0f;
        return false;
    case FL_LEG_SPIN:
    case FL_LEG_SPIN_RANGE:
    case FL_LEG_SPIN_FIT:
        return creep(a, leg.target_cnt, SPIN_STEP_CNT);
    case FL_LEG_SWEEP_IN:
    case FL_LEG_SWEEP:
        return creep(a, leg.target_cnt, 4 * a->law.landing_step_cnt);
    default:
        return false;
    }
}

/* Legs at creep speed. */
static bool creeping(uint8_t kind) {
    return kind == FL_LEG_LAND || kind == FL_LEG_SETTLE || kind == FL_LEG_SWEEP || kind == FL_LEG_SWEEP_IN;
}

static bool spinning(uint8_t kind) { return kind >= FL_LEG_SPIN && kind <= FL_LEG_SPIN_FIT; }

/* What the calibrating legs are there for. */
FL_COLD static void observe(fl_axis_t *a, uint8_t kind) {
    if (kind == FL_LEG_SPIN_RANGE) fl_hall_fit_range(&a->fit.hall, a->adc_cnt);
    if (kind == FL_LEG_SPIN_FIT) fl_hall_fit_add(&a->fit.hall, a->adc_cnt);
    if (kind == FL_LEG_SWEEP) {
        /* the measured speed: noisy, but it knows where cogging slows the rotor, and sums forgive noise */
        const float speed = (float)fl_sub_i32(a->hall.angle_cnt, a->calm_cnt) * FL_RAD_S_PER_CNT_TICK;
        const float driving = a->torque.torque_Nm - a->law.drive.servo.drag * speed;
        fl_friction_fit_add(&a->fit.friction, a->command.speed_rad_s < 0.0f, a->hall.angle_cnt, driving);
        a->calm_cnt = a->hall.angle_cnt;
    }
}

/* What the servo is asked at the command of this tick. */
static inline void ask_servo(const fl_axis_t *a, fl_servo_in_t *in) {
    in->error_cnt = fl_sub_i32(a->command.position_cnt, a->position_cnt);
    in->command_cnt = a->command.position_cnt;
    in->rotor_cnt = fl_sub_i32(a->command.position_cnt, a->zero_cnt);
    in->speed_rad_s = a->command.speed_rad_s;
    in->acceleration_rad_s2 = a->command.acceleration_rad_s2;
    in->settling = creeping(a->plan[a->leg].kind);
}

/* Eq. 20 to 22; true when something blocks. */
static bool drive_closed(fl_axis_t *a, fl_sincos_t rotor, const fl_servo_in_t *in, fl_duty_t *duty) {
    const fl_drive_out_t out = fl_drive_step(&a->law.drive, &a->drive, in, rotor);
    a->torque = out.torque;
    a->voltage = out.voltage;
    *duty = out.duty;
    return out.stuck;
}

/* The field where the command is in the middle of the coming tick; true when the magnet lost it. */
static bool drive_open(fl_axis_t *a, fl_duty_t *duty) {
    const int32_t half_step = fl_sub_i32(a->smooth.value_cnt, a->command.position_cnt) / 2;
    const int32_t field = fl_sub_i32(fl_add_i32(a->command.position_cnt, half_step), a->zero_cnt);
    a->torque = (fl_servo_out_t){0.0f, 0.0f, 0.0f};
    a->voltage = a->law.open_loop_voltage;
    *duty = fl_rotating_field(a->voltage, field);
    return fl_collision_open(&a->law.drive.collision, fl_sub_i32(a->command.position_cnt, a->position_cnt));
}

static fl_axis_event_t finish(fl_axis_t *a, const fl_port_t *port, int index) {
    a->leg = a->legs = 0;
    phases_off(a, port, index);
    if (a->law.holding_voltage > 0.0f) {
        a->voltage = a->law.holding_voltage;
        const fl_duty_t duty = fl_rotating_field(a->voltage, a->hall.angle_cnt);
        port->set_phases(port->ctx, index, duty.phase);
    }
    return FL_AXIS_DONE;
}

/* Standing: the rotor stays within a motor degree for the settle time. */
static bool stands(fl_axis_t *a) {
    const int32_t moved = fl_abs_i32(fl_sub_i32(a->hall.angle_cnt, a->calm_cnt));
    if (moved > (int32_t)FL_CNT_PER_MOTOR_DEG) {
        a->calm_ticks = 0;
        a->calm_cnt = a->hall.angle_cnt;
    }
    return ++a->calm_ticks > a->law.settle_ticks;
}

static fl_axis_event_t coast(fl_axis_t *a, const fl_port_t *port, int index) {
    a->command.position_cnt = a->position_cnt;
    if (!stands(a)) return FL_AXIS_NONE;
    if (a->plan[a->leg].kind == FL_LEG_BRAKE) return finish(a, port, index);
    declare_datum(a);
    ++a->leg;
    a->fresh = true;
    return FL_AXIS_NONE;
}

/* The command stands still and the rotor does not lag, for the settle time; or never mind. The error
 * is averaged over some 4 ms against the noise of the sensors. Beyond the target counts as arrived:
 * the backlash lies between the rotor and any way back. */
static bool settled(fl_axis_t *a) {
    if (++a->leg_ticks <= FL_SMOOTH_TICKS) return false;
    const int32_t error = fl_sub_i32(a->command.position_cnt, a->position_cnt);
    a->lag_cnt += ((a->drive.servo.direction < 0.0f ? -error : error) - a->lag_cnt) >> 3;
    const bool calm = a->lag_cnt <= a->law.tolerance_cnt || !a->closed_loop;
    a->calm_ticks = calm ? a->calm_ticks + 1 : 0;
    return a->calm_ticks > a->law.settle_ticks || a->leg_ticks > a->law.timeout_ticks + FL_SMOOTH_TICKS;
}

static fl_axis_event_t blocked(fl_axis_t *a, const fl_port_t *port, int index) {
    if (a->plan[a->leg].kind != FL_LEG_SEARCH) return a->detect ? FL_AXIS_BLOCKED : FL_AXIS_NONE;
    phases_off(a, port, index);
    leg_next(a);
    return FL_AXIS_NONE;
}

static inline void advance(fl_axis_t *a, const fl_path_t *path, fl_axis_demand_t *demand) {
    a->position_cnt = fl_add_i32(a->hall.angle_cnt, a->zero_cnt);
    demand->way_ended = leg_step(a, path);
    a->command = fl_smooth_step(&a->smooth, a->raw_cnt);
    ask_servo(a, &demand->servo);
}

static inline fl_axis_event_t conclude(fl_axis_t *a, const fl_port_t *port, int index, bool way_ended,
                                       bool stuck) {
    const uint8_t kind = a->plan[a->leg].kind;
    if (stuck && (a->detect || kind == FL_LEG_SEARCH)) return blocked(a, port, index);
    if (kind == FL_LEG_SETTLE && settled(a)) return finish(a, port, index);
    if (kind == FL_LEG_SEARCH && ++a->leg_ticks > a->law.search_ticks) return finish(a, port, index);
    if (way_ended) leg_next(a);
    return FL_AXIS_NONE;
}

void fl_axis_advance(fl_axis_t *a, const fl_path_t *path, fl_axis_demand_t *demand) {
    advance(a, path, demand);
}

fl_axis_event_t fl_axis_conclude(fl_axis_t *a, const fl_port_t *port, int index, bool way_ended, bool stuck) {
    return conclude(a, port, index, way_ended, stuck);
}

/* Eq. 20 without a loop. The field leads by what the rotor turned in the last tick, halved. */
FL_COLD static fl_axis_event_t push(fl_axis_t *a, const fl_port_t *port, int index, fl_sincos_t rotor) {
    const int second = a->leg_ticks >= a->push.ticks[0];
    const bool over = a->leg_ticks >= (uint32_t)a->push.ticks[0] + a->push.ticks[1];
    const float lead_rad = 0.5f * FL_RAD_PER_CNT * (float)fl_sub_i32(a->hall.angle_cnt, a->calm_cnt);
    a->calm_cnt = a->hall.angle_cnt;
    a->command.position_cnt = a->raw_cnt = a->position_cnt;
    ++a->leg_ticks;
    if (over || !fl_axis_in_range(a, a->position_cnt)) {
        phases_off(a, port, index);
        leg_next(a);
        return FL_AXIS_NONE;
    }
    a->voltage = (float)a->push.voltage[second] * (1.0f / 32767.0f);
    const fl_duty_t duty = fl_commutate(a->voltage, rotor, fl_clamp(lead_rad, -0.2f, 0.2f));
    port->set_phases(port->ctx, index, duty.phase);
    return FL_AXIS_NONE;
}

fl_axis_event_t fl_axis_tick(fl_axis_t *a, const fl_path_t *path, const fl_port_t *port, int index) {
    const uint8_t kind = a->plan[a->leg].kind;
    /* nothing to do: it stands where it settled, wherever inside the backlash the rotor fell */
    if (kind == FL_LEG_REST) return finish(a, port, index);
    const fl_hall_out_t hall = look(a, port, index);
    a->position_cnt = fl_add_i32(hall.angle_cnt, a->zero_cnt);
    if (kind == FL_LEG_BRAKE || kind == FL_LEG_DATUM) return coast(a, port, index);
    if (a->fresh) plan_begin(a);
    if (kind == FL_LEG_PUSH) return push(a, port, index, hall.rotor);

    fl_axis_demand_t demand;
    advance(a, path, &demand);
    fl_duty_t duty;
    const bool spin = spinning(kind);
    const bool closed = (a->closed_loop && !spin) || kind == FL_LEG_SWEEP || kind == FL_LEG_SWEEP_IN;
    const bool stuck = closed ? drive_closed(a, hall.rotor, &demand.servo, &duty) : drive_open(a, &duty);
    if (stuck && !spin && (a->detect || kind == FL_LEG_SEARCH)) return blocked(a, port, index);
    if (kind > FL_LEG_BRAKE) observe(a, kind);
    port->set_phases(port->ctx, index, duty.phase);
    return conclude(a, port, index, demand.way_ended, false);
}
