// One positioner on the twin's plant: the firmware behind a port whose other side are two simulated axes.
// Compiled for the host and for the target from the same sources.
#pragma once

#include <cstdint>
#include <memory>

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
extern "C" {
#include "fl_dispatch.h"
#include "fl_positioner.h"
}
#pragma GCC diagnostic pop

#include "fiberloom/twin/plant.hpp"

namespace fl::rig {

inline constexpr uint32_t storage_bytes = 2048; // as few as a board may have
inline constexpr uint16_t positioner_id = 5;
inline constexpr uint32_t mailbox_frames = 8;

// What a unit is: true axes, where they stand, what the firmware was told of them.
struct Setup {
    twin::Unit unit[FL_AXES];
    double start_rad[FL_AXES] = {0.0, 0.0}; // output angles
    fl_axis_params_t params[FL_AXES];
    uint64_t seed = 0;
};

// Counts of io_clock spent in the firmware, and how deep it went, since they were last taken.
struct Cost {
    uint32_t calls = 0, most = 0, deepest = 0;
    uint64_t sum = 0;
    void add(uint32_t counts);
};

class Rig {
  public:
    explicit Rig(const Setup &setup);
    Rig(const Rig &) = delete;
    Rig &operator=(const Rig &) = delete;

    void power_up(); // the firmware forgets all but its storage; the axes stay as they are
    void place();    // tells the firmware where the motors truly are, as the factory does
    void receive(const fl_can_frame_t &frame);
    void tick();
    bool at_rest() const { return fl_positioner_at_rest(&firmware_); }

    const fl_positioner_t &firmware() const { return firmware_; }
    fl_positioner_t &firmware() { return firmware_; }
    twin::Plant &plant() { return plant_; }
    uint32_t ticks() const { return ticks_; }
    uint32_t digest() const { return digest_; } // of every hall count and duty of every tick so far
    int64_t write_budget = -1;                  // bytes until the power fails inside a write; -1: never
    Cost tick_cost, frame_cost, boot_cost;
    bool look_deep = false; // also how much stack the firmware takes: slow

    // what the firmware has sent and has not been taken yet
    fl_can_frame_t sent[mailbox_frames];
    uint32_t sent_count = 0;

  private:
    template <class F> void timed(Cost &cost, F &&call);
    static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]);
    static void set_phases(void *ctx, int axis, const float duty[3]);
    static void open_phases(void *ctx, int axis);
    static bool send_frame(void *ctx, const fl_can_frame_t *frame);
    static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len);
    static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len);
    void mix(const void *word);
    void digest_tick();

    Setup setup_;
    twin::Plant plant_;
    fl_positioner_t firmware_{};
    uint8_t storage_[storage_bytes];
    uint32_t ticks_ = 0, digest_ = 2166136261u;
};

} // namespace fl::rig
