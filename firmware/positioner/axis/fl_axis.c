#include "fl_axis_parts.h"

/* Field speed of the hall calibration: 240 rpm */
enum { SPIN_STEP_CNT = 2097 };

static int32_t landing_step(const fl_axis_t *a, int32_t target_cnt) {
    return fl_landing_step(fl_sub_i32(target_cnt, a->raw_cnt), a->law.landing_step_cnt);
}

/* One step of at most step_cnt towards the target; true when there. */
static bool creep(fl_axis_t *a, int32_t target_cnt, int32_t step_cnt) {
    const int32_t way = fl_sub_i32(target_cnt, a->raw_cnt);
    const bool there = way <= step_cnt && way >= -step_cnt;
    a->raw_cnt = there ? target_cnt : fl_add_i32(a->raw_cnt, way > 0 ? step_cnt : -step_cnt);
    return there;
}

/* Moves the raw command on by one tick of the leg's own time; true when the leg's way has ended. */
static bool whole_step(fl_axis_t *a, const fl_path_t *path, fl_leg_traits_t leg) {
    const int32_t target_cnt = a->plan[a->leg].target_cnt;
    switch (leg.step) {
    case FL_STEP_PATH:
        a->raw_cnt = fl_path_step(path, &a->cursor);
        return fl_path_done(path, &a->cursor);
    case FL_STEP_PROFILE:
        a->raw_cnt = fl_profile_step(&a->profile);
        return fl_profile_done(&a->profile);
    case FL_STEP_LAND:
        return creep(a, target_cnt, landing_step(a, target_cnt));
    case FL_STEP_SEARCH:
        a->raw_cnt = fl_sub_i32(a->raw_cnt, a->law.datum_step_cnt);
        /* the stop is found by the same rule from near and far: the touch watch needs some way first, and
         * where it stops the gear is wound up less, by which the datum could be a motor turn off */
        a->drive.touch.way_rad = a->drive.touch.closed_s = 0.0f;
        return false;
    case FL_STEP_SPIN:
        return creep(a, target_cnt, SPIN_STEP_CNT);
    case FL_STEP_SWEEP:
        return creep(a, target_cnt, 4 * a->law.landing_step_cnt);
    default:
        return false;
    }
}

/* The same while time slows down. */
FL_COLD static bool slow_step(fl_axis_t *a, const fl_path_t *path, fl_leg_traits_t leg) {
    fl_slow_t *s = &a->slow;
    if (leg.step != FL_STEP_PATH && leg.step != FL_STEP_PROFILE) return whole_step(a, path, leg);
    bool ended = false;
    s->rate -= FL_SLOW_WHOLE / FL_SLOW_TICKS;
    s->phase += s->rate;
    if (s->phase >= FL_SLOW_WHOLE) {
        s->phase -= FL_SLOW_WHOLE;
        s->from_cnt = s->to_cnt;
        ended = whole_step(a, path, leg);
        s->to_cnt = a->raw_cnt;
    }
    const int64_t step_cnt = fl_sub_i32(s->to_cnt, s->from_cnt);
    a->raw_cnt = fl_add_i32(s->from_cnt, (int32_t)(step_cnt * (int64_t)s->phase / FL_SLOW_WHOLE));
    if (ended) { /* the next leg begins here */
        s->from_cnt = s->to_cnt = a->raw_cnt;
        s->phase = FL_SLOW_WHOLE;
    }
    if (s->rate != 0) return ended;
    fl_axis_stop_here(a);
    return true;
}

static inline bool leg_step(fl_axis_t *a, const fl_path_t *path, fl_leg_traits_t leg) {
    return a->slowing ? slow_step(a, path, leg) : whole_step(a, path, leg);
}

/* What the servo is asked at the command of this tick. */
static inline void ask_servo(const fl_axis_t *a, fl_leg_traits_t leg, fl_servo_in_t *in) {
    in->error_cnt = fl_sub_i32(a->command.position_cnt, a->position_cnt);
    in->command_cnt = a->command.position_cnt;
    in->rotor_cnt = fl_sub_i32(a->command.position_cnt, a->zero_cnt);
    in->speed_rad_s = a->command.speed_rad_s;
    in->acceleration_rad_s2 = a->command.acceleration_rad_s2;
    in->settling = (leg.traits & FL_LEG_CREEPS) != 0;
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
    a->drive.touch.sure = 0.0f; /* what the gear does now is not followed */
    a->voltage = a->law.open_loop_voltage;
    *duty = fl_rotating_field(a->voltage, field);
    return fl_collision_open(&a->law.drive.collision, fl_sub_i32(a->command.position_cnt, a->position_cnt));
}

static fl_axis_event_t finish(fl_axis_t *a, const fl_port_t *port, int index) {
    a->leg = a->legs = 0;
    fl_axis_phases_off(a, port, index);
    if (a->law.holding_voltage > 0.0f) {
        a->voltage = a->law.holding_voltage;
        const fl_duty_t duty = fl_rotating_field(a->voltage, a->hall.angle_cnt);
        port->set_phases(port->ctx, index, duty.phase);
    }
    return FL_AXIS_DONE;
}

/* At a standstill: the rotor stays within a motor degree for the settle time. */
static bool is_still(fl_axis_t *a) {
    const int32_t moved = fl_abs_i32(fl_sub_i32(a->hall.angle_cnt, a->calm_cnt));
    if (moved > (int32_t)FL_CNT_PER_MOTOR_DEG) {
        a->wait.calm_ticks = 0;
        a->calm_cnt = a->hall.angle_cnt;
    }
    return ++a->wait.calm_ticks > a->law.settle_ticks;
}

static fl_axis_event_t coast(fl_axis_t *a, const fl_port_t *port, int index, fl_leg_traits_t leg) {
    a->command.position_cnt = a->position_cnt;
    a->drive.touch.sure = 0.0f; /* it takes the gear along, and may fall back */
    if (!is_still(a)) return FL_AXIS_NONE;
    if (!(leg.traits & FL_LEG_DATUM_HERE)) return finish(a, port, index);
    fl_axis_declare_datum(a);
    ++a->leg;
    a->fresh = true;
    return FL_AXIS_NONE;
}

/* In open loop the rotor is where the field is, or lost. */
static bool settled(fl_axis_t *a) {
    const fl_settle_config_t cfg = {a->closed_loop ? a->law.tolerance_cnt : INT32_MAX, a->law.settle_ticks,
                                    a->law.timeout_ticks};
    const int32_t error = fl_sub_i32(a->command.position_cnt, a->position_cnt);
    return fl_settle_step(&cfg, &a->wait, a->drive.servo.direction < 0.0f ? -error : error);
}

/* Something blocks: the end of a search, a collision else. */
static fl_axis_event_t blocked(fl_axis_t *a, const fl_port_t *port, int index, fl_leg_traits_t leg) {
    if (!(leg.traits & FL_LEG_SEEKS)) return FL_AXIS_BLOCKED;
    fl_axis_phases_off(a, port, index);
    fl_axis_next_leg(a);
    return FL_AXIS_NONE;
}

/* Whether it matters in this leg that something blocks. */
static inline bool heeds(const fl_axis_t *a, fl_leg_traits_t leg) {
    if (leg.traits & FL_LEG_BLIND) return false;
    return a->detect || (leg.traits & FL_LEG_SEEKS);
}

static inline bool in_closed_loop(const fl_axis_t *a, fl_leg_traits_t leg) {
    if (leg.traits & FL_LEG_BLIND) return false;
    return a->closed_loop || (leg.traits & FL_LEG_CLOSED);
}

static inline void advance(fl_axis_t *a, const fl_path_t *path, fl_leg_traits_t leg,
                           fl_axis_demand_t *demand) {
    a->position_cnt = fl_add_i32(a->hall.angle_cnt, a->zero_cnt);
    demand->way_ended = leg_step(a, path, leg);
    a->command = fl_smooth_step(&a->smooth, a->raw_cnt);
    ask_servo(a, leg, &demand->servo);
}

/* The end of a tick in which nothing blocked: the plan's end, the next leg, or neither. */
static inline fl_axis_event_t end_tick(fl_axis_t *a, const fl_port_t *port, int index, fl_leg_traits_t leg,
                                       bool way_ended) {
    if ((leg.traits & FL_LEG_SETTLES) && settled(a)) return finish(a, port, index);
    if ((leg.traits & FL_LEG_SEEKS) && ++a->wait.leg_ticks > a->law.search_ticks)
        return finish(a, port, index);
    if (way_ended) fl_axis_next_leg(a);
    return FL_AXIS_NONE;
}

void fl_axis_advance(fl_axis_t *a, const fl_path_t *path, fl_axis_demand_t *demand) {
    advance(a, path, fl_axis_leg(a), demand);
}

fl_axis_event_t fl_axis_conclude(fl_axis_t *a, const fl_port_t *port, int index, bool way_ended, bool stuck) {
    const fl_leg_traits_t leg = fl_axis_leg(a);
    if (stuck && heeds(a, leg)) return blocked(a, port, index, leg);
    return end_tick(a, port, index, leg, way_ended);
}

/* A tick of a leg that does not drive. */
static fl_axis_event_t tick_undriven(fl_axis_t *a, const fl_port_t *port, int index, fl_leg_traits_t leg) {
    /* it stays where it settled, wherever inside the backlash the rotor fell */
    if (leg.does == FL_DOES_REST) return finish(a, port, index);
    a->position_cnt = fl_add_i32(fl_axis_look(a, port, index), a->zero_cnt);
    if (leg.does == FL_DOES_COAST) return coast(a, port, index, leg);
    if (a->fresh) fl_axis_begin(a);
    fl_axis_push_tick(a, port, index);
    return FL_AXIS_NONE;
}

fl_axis_event_t fl_axis_tick(fl_axis_t *a, const fl_path_t *path, const fl_port_t *port, int index) {
    const fl_leg_traits_t leg = fl_axis_leg(a);
    if (leg.does != FL_DOES_DRIVE) return tick_undriven(a, port, index, leg);
    const fl_hall_out_t hall = fl_axis_sense(a, port, index);
    a->position_cnt = fl_add_i32(hall.angle_cnt, a->zero_cnt);
    if (a->fresh) fl_axis_begin(a);

    fl_axis_demand_t demand;
    advance(a, path, leg, &demand);
    fl_duty_t duty;
    const bool stuck =
        in_closed_loop(a, leg) ? drive_closed(a, hall.rotor, &demand.servo, &duty) : drive_open(a, &duty);
    if (stuck && heeds(a, leg)) return blocked(a, port, index, leg);
    if (leg.measures != FL_MEASURES_NOTHING) fl_axis_measure(a, leg.measures);
    port->set_phases(port->ctx, index, duty.phase);
    return end_tick(a, port, index, leg, demand.way_ended);
}
