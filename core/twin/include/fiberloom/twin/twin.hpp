// A focal plane of positioners: the plant, the real firmware behind its port in each of them, the bus,
// and neighbours that touch. The clock is virtual and counts control ticks.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

// C gives structs and functions the same name; C++ finds that worth a warning
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
extern "C" {
#include "fl_positioner.h"
}
#pragma GCC diagnostic pop

#include "fiberloom/twin/loads.hpp"
#include "fiberloom/twin/neighbours.hpp"
#include "fiberloom/twin/plant.hpp"

namespace fl::twin {

inline constexpr int every_bus = -1;

struct TwinSetup {
    std::vector<uint16_t> ids;            // N, 1..2047, no two alike
    std::vector<Unit> units;              // 2 N: alpha, beta of each
    std::vector<fl_axis_params_t> params; // 2 N: what the firmware believes
    std::vector<Angles> start;            // N, output angles
    std::vector<Arm> arms;                // N, true
    std::vector<Obstacle> obstacles;
    Body body;
    bool neighbours = true;
    bool skip_resting = true;
    bool side_by_side = true; // the firmware's laws, as vector code where axes track
    bool sort_lanes = true; // at START those with paths of about the same length share lanes; the same bytes
    uint64_t seed = 0;
    int threads = 1;
    Substeps substeps;
    std::string kernel;       // "" for the best
    double bound_scale = 1.0; // of Neighbours: above 1 shorter slices, the same bytes
};

struct Reply {
    uint64_t tick;
    fl_can_frame_t frame;
};

// What one axis did in one tick, each column listed once; torque_out is from outside, at the output.
// clang-format off
#define FL_SCOPE_FIELDS(X) \
    X(time_s) X(motor_rad) X(gear_rad) X(output_rad) X(speed_rad_s) X(torque_out_Nm) \
    X(duty_a) X(duty_b) X(duty_c) X(hall_a_cnt) X(hall_b_cnt) \
    X(command_deg) X(tracking_deg) X(command_speed_rad_s) X(feedback_Nm) X(feedforward_Nm) X(voltage) \
    X(load_Nm) X(touch_Nm)
// clang-format on

struct ScopeSample {
#define X(name) double name = 0.0;
    FL_SCOPE_FIELDS(X)
#undef X
};

inline constexpr const char *scope_fields[] = {
#define X(name) #name,
    FL_SCOPE_FIELDS(X)
#undef X
};
inline constexpr size_t scope_field_count = sizeof scope_fields / sizeof *scope_fields;
static_assert(sizeof(ScopeSample) == scope_field_count * sizeof(double), "a sample is a row of columns");

// What a positioner does to the next START that it should obey, once.
enum class AtStart : uint8_t { obeys, misses, refuses, restarts };

struct PositionerFaults {
    AxisFaults axes[FL_AXES];
    bool stuck_hall[FL_AXES] = {false, false}; // the channels repeat what they showed
    bool deaf = false;                         // frames to it are lost
    bool mute = false;                         // frames from it are lost
    AtStart at_start = AtStart::obeys;
};

class Twin {
  public:
    explicit Twin(const TwinSetup &setup);
    ~Twin();
    Twin(const Twin &) = delete;
    Twin &operator=(const Twin &) = delete;

    size_t positioner_count() const;
    uint64_t tick() const;
    Plant &plant();
    const Neighbours &neighbours() const;
    const char *kernel_name() const;

    // A frame now, on one bus or on all: for one positioner, or for all there (identifier bits 28..18
    // zero).
    void send(const fl_can_frame_t &frame, int bus = every_bus);
    // Which bus a positioner hangs on; 0 unless told.
    void connect(size_t positioner, int bus);
    // Ticks of 0.5 ms; returns what the positioners sent since the last call, by time, then by positioner.
    std::vector<Reply> run(uint64_t ticks);
    // What the next run() would do before its first tick: after START lanes are sorted.
    void prepare();
    // So many calls of run(), but none after one that has brought a reply.
    std::vector<Reply> run_until_reply(uint64_t ticks, uint64_t slices);

    Angles output(size_t positioner) const;
    const fl_positioner_t &firmware(size_t positioner) const;
    bool asleep(size_t positioner) const;
    // Nothing moves and no firmware has anything to do: time alone goes on.
    bool resting() const;
    // Positioners whose own firmware did the last tick, because they did not cruise.
    size_t single_ticks() const;
    // Ticks left out of the firmware so far, and ticks run, over all positioners.
    uint64_t ticks_skipped() const;
    uint64_t ticks_run() const;
    // Ticks of groups of lanes in which one of theirs was awake, so far.
    uint64_t group_ticks() const;
    // Slices of time in which groups of positioners did not wait for each other, so far.
    uint64_t slices() const;
    // By positioner: the farthest that a point of its arms can come within so many ticks from now, whatever
    // it is told, unless another begins to push it: Neighbours::bound_mm.
    std::vector<double> bounds_mm(uint64_t ticks) const;
    // Memory of everything, shared among all, without the firmware's own state.
    size_t bytes_per_positioner() const;

    void set_external_torque(size_t positioner, int axis, double torque_Nm);
    // From now on these pull at its arms, as they are: bundles of fibres at ease. No gravity unless told.
    void set_loads(size_t positioner, const AxisLoad &alpha, const AxisLoad &beta);
    void point(Gravity gravity);
    // What its temperature sensor reads, in the sensor's counts.
    void set_temperature(size_t positioner, uint32_t counts);
    void set_faults(size_t positioner, const PositionerFaults &faults);
    const PositionerFaults &faults(size_t positioner) const;
    void set_transmission(size_t positioner, int axis, const Transmission &transmission);
    void set_params(size_t positioner, int axis, const PlantParams &params);
    // Power off and on: the firmware starts anew with what its storage holds, after the bootloader has waited
    // its ten seconds for an upgrade, or at once.
    void power_cycle(size_t positioner, bool bootloader = false);
    // The same at rest, without a datum on record, and with counters that are off by whole motor turns.
    void power_up(size_t positioner, int alpha_turns, int beta_turns);

    void scope(size_t positioner, int axis, bool on);
    std::vector<ScopeSample> take_scope(size_t positioner, int axis);
    // First moments of contact since the last call; what bounces for 40 ms is one contact.
    std::vector<Touch> take_touches();

  private:
    struct State;
    std::unique_ptr<State> s_;
};

} // namespace fl::twin
