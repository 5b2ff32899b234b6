// One positioner of the twin: firmware on one side of the port, two axes of the plant on the other.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "fiberloom/twin/loads.hpp"
#include "fiberloom/twin/twin.hpp"
#include "flash.hpp"

namespace fl::twin {

inline constexpr uint8_t start_command = 14; // START_TRAJECTORY

struct Sent {
    Reply reply;
    size_t sender; // index of the positioner
};

struct LastTouch { // by another body, now or lately
    uint32_t other;
    uint64_t forget_tick; // never, while they touch
};

// What touches and pushes a positioner.
struct Touching {
    // torque of neighbours as last applied, and torque asked for from outside
    Push push, user_push;
    std::vector<Contact> contacts;
    std::vector<LastTouch> touched;

    bool over() const { return contacts.empty() && touched.empty() && push == Push{} && user_push == Push{}; }
    size_t bytes() const {
        return sizeof(Touching) + contacts.capacity() * sizeof(Contact) +
               touched.capacity() * sizeof(LastTouch);
    }
};

struct Outbox {
    std::vector<Sent> frames;
    std::vector<Touch> touches;
};

// What the positioners of a group have in common: written by the thread that runs the group.
struct alignas(64) PositionerGroup {
    Plant *plant = nullptr;
    AxisGroup *lanes = nullptr;
    uint32_t awake = 0;                  // a bit for each that is not asleep
    uint32_t posed = 0;                  // and for each that has been published since the last sync point
    uint32_t disturbed = 0;              // and that has just begun to be pushed
    bool moved = false;                  // it has run since then
    uint64_t now = 0;                    // tick at which a firmware of them was last called or woken
    uint64_t sensed = UINT64_MAX;        // of which the hall channels of those that run show the angle
    uint64_t ticks_run = 0, skipped = 0; // of all of them, summed up: done, and slept through
    uint64_t stepped = 0;                // ticks of the group
    Outbox outbox;
};

class Positioner {
  public:
    Positioner() = default;
    Positioner(const Positioner &) = delete; // the port points back here
    Positioner &operator=(const Positioner &) = delete;

    // index: number in the focal plane; its axes are 2 index and 2 index + 1 of the plant.
    // group: of its axes, with plant and lanes; lane: of alpha there. It is awake.
    void attach(PositionerGroup &group, size_t index, size_t lane);
    // Its axes are there from now on. Whether it is awake is for the caller to note.
    void move(PositionerGroup &group, size_t lane) {
        group_ = &group;
        lane_ = static_cast<uint16_t>(lane);
    }
    // params: flashed at the factory, and those of the first unit, which stay where they are; what the
    // storage holds goes before them.
    void boot(uint16_t id, const FactoryParams::Both &first, const fl_axis_params_t params[FL_AXES]);
    // Back to what is flashed or stored: what was only set is gone.
    void power_cycle();
    // As delivered: it knows where it is and where its stops are, and has that in its storage.
    void deliver(const int32_t position_cnt[FL_AXES], const int32_t stop_cnt[FL_AXES]);
    // Off and on again with a record that has lost these whole motor turns, and the datum of both axes: the
    // firmware restores the record, and the hall sensors say the angle within a turn.
    void power_up(const int turns[FL_AXES]);

    void receive(const fl_can_frame_t &frame, uint64_t tick);
    // False when the firmware has nothing to do for its axes in this tick.
    bool begin_tick(uint64_t tick) {
        group_->now = tick;
        ++group_->ticks_run;
        return fl_positioner_begin_tick(&firmware_);
    }
    // What the hall channels of an axis show in this tick.
    void hall(int axis, uint16_t adc_cnt[2]);
    // Whether a host may do the ticks of its axes without asking it.
    bool may_cruise() const {
        const bool (&stuck)[FL_AXES] = faults().stuck_hall;
        return !scoped() && !stuck[FL_ALPHA] && !stuck[FL_BETA];
    }
    // Such ticks have passed, the last one before or in `tick`; the hall channels of an axis showed this.
    void count_ticks(uint32_t ticks, uint64_t tick) {
        group_->now = tick;
        group_->ticks_run += ticks;
        fl_positioner_skip(&firmware_, ticks);
    }
    void looked(int axis, int32_t a_cnt, int32_t b_cnt, uint16_t adc_cnt[2]) {
        adc_cnt[0] = last_hall_[axis][0] = static_cast<uint16_t>(a_cnt);
        adc_cnt[1] = last_hall_[axis][1] = static_cast<uint16_t>(b_cnt);
    }
    // After the ticks before this one: falls asleep when nothing will change.
    void rest(const Plant &plant, uint64_t tick, bool may_sleep);
    void wake(uint64_t tick);
    bool asleep() const { return (group_->awake >> lane_ & 1U) == 0; }

    // Others have had their turn meanwhile: what its firmware touches is asked for at once, not piece by
    // piece.
    void fetch() const;

    const fl_positioner_t &firmware() const { return firmware_; }
    fl_positioner_t &firmware() { return firmware_; }
    size_t index() const { return index_; }
    uint16_t id() const { return firmware_.id; }
    const PositionerFaults &faults() const { return faults_ ? *faults_ : sound; }
    void set_faults(const PositionerFaults &faults) { faults_ = std::make_unique<PositionerFaults>(faults); }
    int bus = 0;
    uint32_t temperature_cnt = 1900; // of its sensor

    void start_scope(int axis, bool on);
    std::vector<ScopeSample> take_scope(int axis);
    // Memory of its own, without the firmware's state and what scopes have recorded.
    size_t bytes() const {
        return sizeof(Positioner) - sizeof(fl_positioner_t) + storage_.held_bytes() + factory_.held_bytes() +
               (touching ? touching->bytes() : size_t{0}) + (loads ? sizeof(ArmLoads) : size_t{0}) +
               (faults_ ? sizeof(PositionerFaults) : size_t{0});
    }
    bool scoped() const { return scope_on_[FL_ALPHA] || scope_on_[FL_BETA]; }
    // A sample of each axis that a scope is on.
    void record(const Plant &plant, uint64_t tick);

    std::unique_ptr<ArmLoads> loads;    // none: nothing pulls at its arms
    std::unique_ptr<Touching> touching; // none: nothing touches it or pushes it
    // What there is of that; nothing where nothing is.
    const Touching &touch() const { return touching ? *touching : untouched; }
    Touching &touch_now() {
        if (!touching) touching = std::make_unique<Touching>();
        return *touching;
    }

  private:
    // True when the fault of this frame's START has taken the firmware's place.
    bool spoils_start(const fl_can_frame_t &frame);
    void look();
    static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]);
    static void set_phases(void *ctx, int axis, const float duty[3]);
    static void open_phases(void *ctx, int axis);
    static bool send_frame(void *ctx, const fl_can_frame_t *frame);
    static uint32_t read_temperature(void *ctx);
    static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len);
    static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len);
    size_t lane(int axis) const { return lane_ + static_cast<size_t>(axis) * lane_group_size; }
    size_t number(int axis) const { return 2 * size_t{index_} + static_cast<size_t>(axis); } // in the plant
    fl_port_t port();
    void start(uint16_t id);
    bool still() const;
    bool loads_follow(const Plant &plant) const;
    ScopeSample sample(const Plant &plant, int axis, uint64_t tick) const;

    fl_positioner_t firmware_{};
    static const PositionerFaults sound;
    static const Touching untouched;
    FactoryParams factory_;
    std::unique_ptr<PositionerFaults> faults_; // none: sound
    PositionerGroup *group_ = nullptr;
    Flash storage_;
    uint64_t asleep_since_ = 0;
    uint16_t index_ = 0, lane_ = 0; // lane: of alpha; beta's is lane_group_size further
    uint16_t last_hall_[FL_AXES][2] = {};
    std::unique_ptr<std::array<std::vector<ScopeSample>, FL_AXES>> scope_;
    bool scope_on_[FL_AXES] = {false, false};
};

} // namespace fl::twin
