// The firmware's laws for the same axis of 32 positioners side by side: the very functions of
// firmware/law, inlined into loops that the compiler turns into vector code. Same operations in the
// same order, so the same bits as the firmware's own tick (tests/twin/test_laws_side_by_side.py).
//
// Structures of the firmware lie here field by field, an array each; the lists name the fields in the
// order of the structure, and law_body.hpp does not compile when one is missing.
#pragma once

#include <cstdint>

#include "fiberloom/twin/axis_group.hpp"

// clang-format off
#define FL_LAW_HALL(X) \
    X(float, offset_a_cnt) X(float, offset_b_cnt) X(float, gain_a) X(float, gain_b) X(float, sec_phase) \
    X(float, tan_phase)
#define FL_LAW_SERVO(X) \
    X(float, k_p) X(float, k_i) X(float, settle_gain) X(float, integral_limit) X(float, drag) \
    X(float, inertia) X(float, doubting) X(float, learning) X(float, coulomb) X(float, spring_torque) \
    X(float, spring_rate) X(float, cogging) X(int32_t, cogging_phase_cnt)
#define FL_LAW_COLLISION(X) \
    X(float, threshold_Nm) X(float, contact_Nm) X(float, drag) X(float, drag_share) X(int32_t, error_min_cnt)
#define FL_LAW_TOUCH(X) \
    X(float, inertia) X(float, inertia_inverse) X(float, drag) X(float, gain_e) X(float, gain_v) \
    X(float, gain_a) X(float, doubt_Nms) X(float, surge_kg_m2) X(float, threshold_Nm)
#define FL_LAW_TEETH(X) \
    X(float, mean_cnt) X(float, once_cnt) X(float, twice_cnt) X(float, thrice_cnt) X(float, pairing_cnt) \
    X(int32_t, once_phase_cnt) X(int32_t, twice_phase_cnt) X(int32_t, thrice_phase_cnt) \
    X(int32_t, pairing_phase_cnt) X(int32_t, pairings)
#define FL_LAW_REGULATOR(X) \
    X(float, k_e) X(float, k_v) X(float, gain_e) X(float, gain_v) X(float, gain_a) X(float, inertia) \
    X(float, inertia_inverse) X(float, drag) X(float, gap_coulomb) X(float, gap_drag)
#define FL_LAW_GAP(X) X(int32_t, gear_cnt) X(int32_t, known) X(int32_t, touching)
#define FL_LAW_SEEN(X) X(float, error_rad) X(float, rate_rad_s) X(float, load_rad_s2)
#define FL_LAW_STATE(X) \
    X(float, integral_Nm) X(float, direction) X(float, drag_doubt) X(float, drag_scale)
#define FL_LAW_OBSERVER(X) \
    X(float, error_rad) X(float, rate_rad_s) X(float, load_rad_s2) X(float, mean_Nm) X(float, mean_speed_rad_s) X(float, follow) \
    X(float, late_1_rad_s) X(float, late_2_rad_s) X(float, late_3_rad_s) X(float, surge_rad_s2) X(float, scatter_Nm) X(float, dip_Nm) X(float, calm) X(float, share) X(float, unrest_Nm) X(float, way_rad) X(float, closed_s) X(float, sure) X(float, rise_Nm) X(float, limit_Nm)
#define FL_LAW_RIPPLE(X) \
    X(float, once_sin_Nm) X(float, once_cos_Nm) X(float, twice_sin_Nm) X(float, twice_cos_Nm) \
    X(float, error_rad) X(float, step_rad) X(float, beyond_Nm) X(float, sum_Nm) X(float, sin) X(float, cos) \
    X(float, twice_sin) X(float, twice_cos)
#define FL_LAW_INPUT(X) \
    X(int32_t, error_cnt) X(int32_t, command_cnt) X(int32_t, rotor_cnt) X(float, speed_rad_s) \
    X(float, acceleration_rad_s2) X(int32_t, settling)
#define FL_LAW_SETTLE(X) X(int32_t, tolerance_cnt) X(uint32_t, settle_ticks) X(uint32_t, timeout_ticks)
#define FL_LAW_WAIT(X) X(uint32_t, leg_ticks) X(uint32_t, calm_ticks) X(int32_t, lag_cnt)
#define FL_LAW_TORQUE(X) \
    X(float, torque_Nm) X(float, feedforward_Nm) X(float, watched_Nm)
// clang-format on

namespace fl::twin {

inline constexpr int smooth_ticks = 32; // FL_SMOOTH_TICKS

// What the law that knows the contact needs beside that: configuration and states. Few arrays run it.
struct alignas(64) ContactLanes {
#define X(type, name) type name[lane_group_size];
    struct {
        FL_LAW_TEETH(X)
    } teeth;
    struct {
        FL_LAW_REGULATOR(X)
    } regulator;
    struct {
        FL_LAW_GAP(X)
    } gap;
    struct {
        FL_LAW_SEEN(X)
    } seen;
#undef X
    float slack_Nm[lane_group_size]; // of the regulator's state
};

// What the laws of a tick hand on to each other and to the plant: nothing of it is asked for in the next one,
// so that a thread needs one for all of its groups. Lanes that nobody uses hold anything.
struct alignas(64) LawScratch {
    using Floats = float[lane_group_size];
    using Ints = int32_t[lane_group_size];

    Floats rotor_sin, rotor_cos;
    Ints goto_cnt, change_cnt; // the command of a go-to, and what the command is beyond that of 32 ticks ago
#define X(type, name) type name[lane_group_size];
    struct {
        FL_LAW_INPUT(X)
    } input; // of the drive's law; then what it gives
#undef X
    Floats duty_a, duty_b, duty_c;
    Ints stuck;
    Ints settled; // the wait is over with this tick
};

// Configuration and state of the laws of one axis of a lane group, field by field.
struct alignas(64) LawBatch {
    using Floats = float[lane_group_size];
    using Ints = int32_t[lane_group_size];
    using Longs = int64_t[lane_group_size];

#define X(type, name) type name[lane_group_size];
    // configuration, loaded when an axis sets out
    struct {
        FL_LAW_HALL(X)
    } hall;
    struct {
        FL_LAW_SERVO(X)
    } servo;
    struct {
        FL_LAW_COLLISION(X)
    } collision;
    struct {
        FL_LAW_TOUCH(X)
    } touch;
    // states of servo and touch, in and out; the torques of the last tick
    struct {
        FL_LAW_STATE(X)
    } state;
    struct {
        FL_LAW_OBSERVER(X)
    } observer;
    struct {
        FL_LAW_RIPPLE(X)
    } ripple;
    struct {
        FL_LAW_TORQUE(X)
    } torque;
#undef X
    Floats voltage_per_Nm, full_Nm;
    Ints law;
    Ints adc_a_cnt, adc_b_cnt, angle_cnt; // angle: the last one in, this one out
    Floats voltage;

    // Where the command of an axis that cruises is (cruise.hpp): along a path or a go-to, and its smoothing.
    struct {
        Ints follows; // all bits: a path, none: a go-to
        Ints zero_cnt;
        Ints path_cnt, step_cnt, rest, rest_sum, ticks; // of its segment
        Ints lands, target_cnt, slowest_cnt;   // all bits: it creeps to the target; none: it does not
        Ints creeps;                           // what the servo is told
        Longs goto_q30, speed_q30, change_q30; // change: of the speed, per tick
        Longs sum_cnt;
        Ints value_cnt;
        Ints command_cnt; // as the servo was told last
        Floats speed_rad_s, acceleration_rad_s2;
        int32_t ring_cnt[smooth_ticks][lane_group_size]; // all lanes in the row of the tick
    } way;

#define X(type, name) type name[lane_group_size];
    // An axis that settles: what it waits for, and how far it is; where the wait is over, as it was before.
    struct {
        FL_LAW_SETTLE(X)
        FL_LAW_WAIT(X)
    } settle;
#undef X

    // Of lanes that want that law: somebody has to put them there. Last, so that arrays stay aligned.
    ContactLanes *contact = nullptr;
};

} // namespace fl::twin
