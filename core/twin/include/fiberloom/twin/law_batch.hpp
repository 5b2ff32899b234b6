// The firmware's laws for the same axis of sixteen positioners side by side: the very functions of
// firmware/law, inlined into loops that the compiler turns into vector code. Same operations in the
// same order, so the same bits as the firmware's own tick (tests/twin/test_laws_side_by_side.py).
#pragma once

#include <cstdint>

#include "fiberloom/twin/axis_group.hpp"

namespace fl::twin {

struct alignas(64) LawBatch {
    using Floats = float[squad_size];
    using Ints = int32_t[squad_size];

    // configuration, loaded when an axis sets out
    Floats hall_offset_a, hall_offset_b, hall_gain_a, hall_gain_b, hall_sec_phase, hall_tan_phase;
    Floats k_p, k_i, integral_limit, drag, inertia, learning, coulomb, spring_torque, spring_rate;
    Floats cogging;
    Ints cogging_phase_cnt;
    Floats voltage_per_Nm, threshold_Nm, drag_doubt;

    // hall: counts and the last angle in; angle and rotor out
    Ints adc_a_cnt, adc_b_cnt, angle_cnt;
    Floats rotor_sin, rotor_cos;

    // servo: state in and out
    Floats integral_Nm, direction, drag_scale;
    // servo: in
    Ints error_cnt, command_cnt, rotor_cnt;
    Floats speed_rad_s, acceleration_rad_s2, stiffness;
    // servo and commutation: out
    Floats torque_Nm, feedforward_Nm, watched_Nm, voltage;
    Floats duty_a, duty_b, duty_c;
    Ints stuck;
};

} // namespace fl::twin
