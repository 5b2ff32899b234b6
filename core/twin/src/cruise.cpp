#include "cruise.hpp"

#include <algorithm>

#include "fl_profile.h"

namespace fl::twin {
namespace {

uint32_t before(uint32_t tick, uint32_t corner) { return corner - 1 - tick; }

// fl_profile_step changes its rule in the ticks that make these true.
uint32_t ticks_of(const fl_profile_state_t &p) {
    if (p.tick + 1 >= p.total_ticks) return 0;
    const uint32_t down = p.total_ticks - p.ramp_ticks;
    if (p.tick + 1 < p.ramp_ticks) return before(p.tick, p.ramp_ticks);
    if (p.tick + 1 == p.ramp_ticks || p.tick + 1 == down) return 0;
    return before(p.tick, p.tick + 1 < down ? down : p.total_ticks);
}

int64_t change_q30(const fl_profile_state_t &p) {
    const uint32_t next = p.tick + 1;
    if (next < p.ramp_ticks) return p.acceleration_q30;
    return next > p.total_ticks - p.ramp_ticks ? -p.acceleration_q30 : 0;
}

// Ticks of a landing that do not reach the target, not all of them: no step is longer than the one before.
uint32_t landing_ticks(const fl_axis_t &a, uint32_t most) {
    const int32_t left_cnt = fl_abs_i32(fl_sub_i32(a.plan[a.leg].target_cnt, a.raw_cnt));
    const int32_t step_cnt = fl_landing_step(left_cnt, a.law.landing_step_cnt);
    if (left_cnt <= step_cnt) return 0;
    return std::min(static_cast<uint32_t>((left_cnt - 1) / step_cnt), most);
}

// The lanes tell when the wait is over; not worth it where that may be soon.
uint32_t settling_ticks(const fl_axis_t &a) {
    const uint32_t calm = a.wait.calm_ticks;
    return calm + least_cruise_ticks > a.law.settle_ticks && a.wait.leg_ticks > FL_SMOOTH_TICKS ? 0
                                                                                                : UINT32_MAX;
}

const fl_leg_traits_t &leg_of(const fl_axis_t &a) { return fl_leg_traits[a.plan[a.leg].kind]; }

} // namespace

bool settles(const fl_axis_t &a) { return (leg_of(a).traits & FL_LEG_SETTLES) != 0; }

uint32_t cruise_ticks(const fl_axis_t &a, uint32_t most) {
    if (!fl_axis_tracks(&a) || a.slowing) return 0;
    switch (leg_of(a).step) {
    case FL_STEP_LAND:
        return landing_ticks(a, most);
    case FL_STEP_STAY:
        return settling_ticks(a);
    case FL_STEP_PATH:
        return a.cursor.ticks_left > 0 ? a.cursor.ticks_left - 1 : 0;
    case FL_STEP_PROFILE:
        return ticks_of(a.profile);
    default:
        return 0;
    }
}

void load_law(LawBatch &b, int i, const fl_axis_law_t &law) {
#define X(type, name) b.hall.name[i] = law.hall.name;
    FL_LAW_HALL(X)
#undef X
#define X(type, name) b.servo.name[i] = law.drive.servo.name;
    FL_LAW_SERVO(X)
#undef X
#define X(type, name) b.collision.name[i] = law.drive.collision.name;
    FL_LAW_COLLISION(X)
#undef X
#define X(type, name) b.touch.name[i] = law.drive.touch.name;
    FL_LAW_TOUCH(X)
#undef X
    b.law[i] = law.drive.law;
    b.voltage_per_Nm[i] = law.drive.voltage_per_Nm;
    b.full_Nm[i] = law.drive.full_Nm;
    if (b.law[i] != FL_LAW_CONTACT) return;
#define X(type, name) b.contact->teeth.name[i] = law.drive.teeth.name;
    FL_LAW_TEETH(X)
#undef X
#define X(type, name) b.contact->regulator.name[i] = law.drive.regulator.name;
    FL_LAW_REGULATOR(X)
#undef X
}

void load_state(LawBatch &b, int i, const fl_drive_state_t &state) {
#define X(type, name) b.state.name[i] = state.servo.name;
    FL_LAW_STATE(X)
#undef X
#define X(type, name) b.observer.name[i] = state.touch.name;
    FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) b.ripple.name[i] = state.touch.ripple.name;
    FL_LAW_RIPPLE(X)
#undef X
    if (b.law[i] != FL_LAW_CONTACT) return;
#define X(type, name) b.contact->gap.name[i] = state.teeth.name;
    FL_LAW_GAP(X)
#undef X
#define X(type, name) b.contact->seen.name[i] = state.regulator.seen.name;
    FL_LAW_SEEN(X)
#undef X
    b.contact->slack_Nm[i] = state.regulator.slack_Nm;
}

void store_state(const LawBatch &b, int i, fl_axis_t &a) {
#define X(type, name) a.drive.servo.name = b.state.name[i];
    FL_LAW_STATE(X)
#undef X
#define X(type, name) a.drive.touch.name = b.observer.name[i];
    FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) a.drive.touch.ripple.name = b.ripple.name[i];
    FL_LAW_RIPPLE(X)
#undef X
#define X(type, name) a.torque.name = b.torque.name[i];
    FL_LAW_TORQUE(X)
#undef X
    a.voltage = b.voltage[i];
    if (b.law[i] != FL_LAW_CONTACT) return;
#define X(type, name) a.drive.teeth.name = b.contact->gap.name[i];
    FL_LAW_GAP(X)
#undef X
#define X(type, name) a.drive.regulator.seen.name = b.contact->seen.name[i];
    FL_LAW_SEEN(X)
#undef X
    a.drive.regulator.slack_Nm = b.contact->slack_Nm[i];
}

void stand(LawBatch &b, int i) {
    b.way.step_cnt[i] = b.way.rest[i] = b.way.rest_sum[i] = b.way.lands[i] = 0;
    b.way.ticks[i] = 1;
    b.way.speed_q30[i] = b.way.change_q30[i] = 0;
}

void load_way(LawBatch &b, int i, const fl_axis_t &a, uint64_t tick) {
    b.angle_cnt[i] = a.hall.angle_cnt;
    const fl_leg_traits_t leg = leg_of(a);
    b.way.follows[i] = leg.step == FL_STEP_PROFILE ? 0 : -1;
    b.way.creeps[i] = (leg.traits & FL_LEG_CREEPS) != 0;
    b.way.zero_cnt[i] = a.zero_cnt;
    stand(b, i);
    if (leg.step == FL_STEP_LAND || leg.step == FL_STEP_STAY) {
        b.way.path_cnt[i] = a.raw_cnt;
        b.way.lands[i] = leg.step == FL_STEP_LAND ? -1 : 0;
        b.way.target_cnt[i] = a.plan[a.leg].target_cnt;
        b.way.slowest_cnt[i] = a.law.landing_step_cnt;
#define X(type, name) b.settle.name[i] = a.law.name;
        FL_LAW_SETTLE(X)
#undef X
#define X(type, name) b.settle.name[i] = a.wait.name;
        FL_LAW_WAIT(X)
#undef X
    } else if (leg.step == FL_STEP_PATH) {
        b.way.path_cnt[i] = a.cursor.position_cnt;
        b.way.step_cnt[i] = a.cursor.step_cnt;
        b.way.rest[i] = a.cursor.rest;
        b.way.rest_sum[i] = a.cursor.rest_sum;
        b.way.ticks[i] = static_cast<int32_t>(a.cursor.ticks);
    } else {
        b.way.goto_q30[i] = a.profile.position_q30;
        b.way.speed_q30[i] = a.profile.speed_q30;
        b.way.change_q30[i] = change_q30(a.profile);
    }
    b.way.sum_cnt[i] = a.smooth.sum_cnt;
    b.way.value_cnt[i] = a.smooth.value_cnt;
    b.way.speed_rad_s[i] = a.smooth.speed_rad_s;
    for (uint32_t k = 0; k < FL_SMOOTH_TICKS; ++k)
        b.way.ring_cnt[(tick + k) % FL_SMOOTH_TICKS][i] =
            a.smooth.ring_cnt[(a.smooth.next + k) % FL_SMOOTH_TICKS];
}

void store_way(const LawBatch &b, int i, fl_axis_t &a, uint64_t tick, uint32_t ticks) {
    a.hall.angle_cnt = b.angle_cnt[i];
    if (ticks == 0) return;
    a.position_cnt = fl_add_i32(b.angle_cnt[i], b.way.zero_cnt[i]);
    const fl_leg_traits_t leg = leg_of(a);
    if (leg.step == FL_STEP_LAND || leg.step == FL_STEP_STAY) {
        a.raw_cnt = b.way.path_cnt[i];
        if (settles(a)) {
#define X(type, name) a.wait.name = b.settle.name[i];
            FL_LAW_WAIT(X)
#undef X
        }
    } else if (leg.step == FL_STEP_PATH) {
        a.cursor.position_cnt = a.raw_cnt = b.way.path_cnt[i];
        a.cursor.rest_sum = b.way.rest_sum[i];
        a.cursor.ticks_left -= ticks;
    } else {
        a.profile.position_q30 = b.way.goto_q30[i];
        a.profile.speed_q30 = b.way.speed_q30[i];
        a.profile.tick += ticks;
        a.raw_cnt = fl_profile_cnt(a.profile.position_q30);
    }
    a.command = {b.way.command_cnt[i], b.way.speed_rad_s[i], b.way.acceleration_rad_s2[i]};
    a.smooth.sum_cnt = b.way.sum_cnt[i];
    a.smooth.value_cnt = b.way.value_cnt[i];
    a.smooth.speed_rad_s = b.way.speed_rad_s[i];
    a.smooth.next = (a.smooth.next + ticks) % FL_SMOOTH_TICKS;
    for (uint32_t k = 0; k < FL_SMOOTH_TICKS; ++k)
        a.smooth.ring_cnt[(a.smooth.next + k) % FL_SMOOTH_TICKS] =
            b.way.ring_cnt[(tick + k) % FL_SMOOTH_TICKS][i];
}

} // namespace fl::twin
