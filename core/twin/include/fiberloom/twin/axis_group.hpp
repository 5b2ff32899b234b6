// Sixty-four axes (32 positioners, first all alpha, then all beta) side by side: what one tick of the plant
// touches, about 13 KB, so a group stays in the first-level cache while it is stepped. Four vectors of a
// substep are under way at once; with two the processor waits for results half of the time.
//
// Angles are kept in double: 1024 turns of the motor leave single precision a hundredth of a degree. What
// happens inside a tick is told in single precision, as way since its start, which loses nothing
// (docs/twin.md) and puts twice as many axes into a vector.
//
// Everything that is a torque in the model is an impulse here: torque times the step h, in Nm s.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fl::twin {

#ifndef FL_LANE_GROUP_SIZE
#define FL_LANE_GROUP_SIZE 32
#endif
inline constexpr int lane_group_size =
    FL_LANE_GROUP_SIZE; // positioners of a group, at most 32: bits of masks
inline constexpr int lane_count = 2 * lane_group_size;
// lanes that are left out together when nothing moves in them
inline constexpr int chunk_size = lane_count < 16 ? lane_count : 16;
inline constexpr uint64_t every_lane = UINT64_MAX >> (64 - lane_count);
inline constexpr double tick_s = 0.0005; // 2 kHz control

// State, coefficients and signals of the axes of a group, one array of lanes each.
struct alignas(64) AxisGroup {
    using Exact = double[lane_count];
    using Lanes = float[lane_count];

    // state
    Exact theta_rad; // motor
    Exact gear_rad;  // motor angle at which negative contact is closed

    // transmission, linear inside the cell: positive contact at gear = (theta - backlash_0) backlash_scale
    Exact backlash_0_rad, backlash_scale;
    Exact cell_lo_rad, cell_hi_rad;
    // load of the gear, positive to positive angles: load_0 + load_1 gear, and stops beyond gear angles
    Exact load_0_Nms, load_1_Nms;
    Exact stop_lo_rad, stop_hi_rad, stop_Nms;

    // state: momentum of what moves with the rotor. All before is in double, from here on arrays of 4 bytes a
    // lane follow: copy_lane().
    Lanes p_Nms;

    Lanes sine, cosine; // of theta, at the start of a tick

    // drive: impulse = drive_sin sin(theta) + drive_cos cos(theta)
    Lanes drive_sin_Nms, drive_cos_Nms;
    Lanes drive_scale_Nms; // h lambda u_dc / (R pwm_steps), zero without supply
    Lanes pwm_steps;

    // cogging as resistance: c2s sin 2t + c2c cos 2t + (c4s/2) sin 4t + c4c cos 4t
    Lanes cog_2s_Nms, cog_2c_Nms, cog_4s_Nms, cog_4c_Nms;

    // friction, drag and inertia
    Lanes coulomb_motor_Nms, coulomb_gear_Nms;
    Lanes drag_free, drag_free_inverse;     // h d / 2J and 1/(1 + that), rotor alone
    Lanes drag_push, drag_push_inverse;     // rotor with gear
    Lanes step_per_p_free, step_per_p_push; // h / J
    // rotor with gear in the longer steps of Substeps, where p is told in units of h / step
    Lanes drag_coarse, drag_coarse_inverse, step_per_p_coarse;

    // hall channels: offset + sin_a sine ; offset + cos_b cosine + sin_b sine ; noise
    Lanes hall_offset_a, hall_sin_a, hall_offset_b, hall_cos_b, hall_sin_b, hall_noise;

    float duty[3][lane_count]; // phases A, B, C as the firmware last set them
    uint32_t noise_key[lane_count];
    int32_t still[lane_count]; // all bits: the last tick changed nothing, and nothing has been changed since
    int32_t hall_cnt[2][lane_count];

    // A bit for each lane: whose gear may come to a stop in its cell, with a motor radian to spare; that was
    // about to leave its cell a tick ago; of which the next node on its way lies in another NodeBlock.
    uint64_t near_stop, leaving, block_ends;
};

// Lane `from_lane` of a group becomes lane `to_lane` of another, with all that is told of it.
void copy_lane(const AxisGroup &from, size_t from_lane, AxisGroup &to, size_t to_lane);

// What happened in a tick, one bit per lane.
struct TickEvents {
    uint64_t left_cell = 0;
    uint64_t will_leave = 0; // its cell within two more such ticks, or has done so
};

// Steps of a tick: of any axis, and of one that pushes its gear all the time.
struct Substeps {
    int all = 10, pushing = 10;
};

struct LawBatch;
struct LawScratch;

inline constexpr int bell_vector = 8;

// One build of the inner loops for one instruction set. All builds do the same operations in the same
// order without contraction, so they agree to the bit.
struct Kernel {
    const char *name;
    // Sine, cosine and hall counts of the present angle; duties to drive impulses. used: a bit for each lane
    // whose firmware may look at its angle or set its duties in this tick. Chunks that are still, and none of
    // whose lanes are used, stay as they are.
    void (*sense)(AxisGroup &group, uint32_t tick, uint64_t used);
    void (*drive)(AxisGroup &group, uint64_t used);
    TickEvents (*step)(AxisGroup &group, Substeps substeps);
    // Standard normal numbers, nearly, out of counters: Irwin-Hall of twelve, ends at six. Whole vectors of
    // bell_vector are read and written.
    void (*bells)(const uint64_t *counter, double *bell, int count);
    // the firmware's laws for one axis of a lane group, law_batch.hpp
    void (*hall_law)(LawBatch &batch, LawScratch &scratch);
    // the commands of those that cruise
    void (*advance_law)(LawBatch &batch, LawScratch &scratch, uint64_t tick);
    // laws: a bit of 1 << law for each that a lane wants
    void (*drive_law)(LawBatch &batch, LawScratch &scratch, unsigned laws);
    // whether those that settle have done so
    void (*settle_law)(LawBatch &batch, LawScratch &scratch);
};

// The kernels this machine runs, slowest first; ends with a nullptr.
const Kernel *const *kernels();

} // namespace fl::twin
