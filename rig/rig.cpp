#include "rig.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "io.h"

namespace fl::rig {
namespace {

twin::Plant plant_of(const Setup &s) {
    return twin::Plant({s.unit[FL_ALPHA], s.unit[FL_BETA]}, {s.start_rad[FL_ALPHA], s.start_rad[FL_BETA]},
                       s.seed);
}

} // namespace

template <class F> void Rig::timed(Cost &cost, F &&call) {
    if (look_deep) io_stack_mark();
    const uint32_t before = io_clock();
    call();
    cost.add((io_clock() - before) & IO_CLOCK_MASK);
    if (look_deep) cost.deepest = std::max(cost.deepest, io_stack_used());
}

void Cost::add(uint32_t counts) {
    ++calls;
    sum += counts;
    most = std::max(most, counts);
}

Rig::Rig(const Setup &setup) : setup_(setup), plant_(plant_of(setup)) {
    std::memset(storage_, 0xff, sizeof storage_);
    plant_.sense(0, 0); // the first hall reading is real
    power_up();
}

void Rig::power_up() {
    const fl_port_t port = {this,         read_hall,     set_phases, send_frame,
                            storage_read, storage_write, nullptr,    open_phases};
    const float off[3] = {0.0f, 0.0f, 0.0f};
    for (int axis = 0; axis < FL_AXES; ++axis) set_phases(this, axis, off);
    timed(boot_cost, [&] { fl_positioner_init(&firmware_, &port, positioner_id, setup_.params); });
}

void Rig::place() {
    int32_t position_cnt[FL_AXES];
    for (size_t axis = 0; axis < FL_AXES; ++axis)
        position_cnt[axis] = static_cast<int32_t>(
            std::lround(plant_.motor_rad(axis) / (2.0 * std::numbers::pi) * FL_TURN_CNT));
    fl_positioner_set_position(&firmware_, position_cnt);
}

void Rig::receive(const fl_can_frame_t &frame) {
    timed(frame_cost, [&] { fl_positioner_receive(&firmware_, &frame); });
}

void Rig::tick() {
    plant_.sense(0, ticks_);
    timed(tick_cost, [&] { fl_positioner_tick(&firmware_); });
    plant_.step(0);
    digest_tick();
    ++ticks_;
}

// FNV-1a over words.
void Rig::mix(const void *word) {
    uint32_t bits;
    std::memcpy(&bits, word, sizeof bits);
    digest_ = (digest_ ^ bits) * 16777619u;
}

void Rig::digest_tick() {
    const twin::AxisGroup &g = plant_.group(0);
    for (size_t axis = 0; axis < FL_AXES; ++axis) {
        const int lane = plant_.place(axis).lane;
        for (const auto &hall_cnt : g.hall_cnt) mix(&hall_cnt[lane]);
        for (const auto &duty : g.duty) mix(&duty[lane]);
    }
}

// -- the port -----------------------------------------------------------------------------------------

void Rig::read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    twin::Plant &plant = static_cast<Rig *>(ctx)->plant_;
    const twin::AxisGroup &g = plant.group(0);
    const int lane = plant.place(static_cast<size_t>(axis)).lane;
    for (int k = 0; k < 2; ++k) adc_cnt[k] = static_cast<uint16_t>(g.hall_cnt[k][lane]);
}

void Rig::set_phases(void *ctx, int axis, const float duty[3]) {
    twin::Plant &plant = static_cast<Rig *>(ctx)->plant_;
    const int lane = plant.place(static_cast<size_t>(axis)).lane;
    for (int k = 0; k < 3; ++k) plant.group(0).duty[k][lane] = duty[k];
    plant.set_open(static_cast<size_t>(axis), false);
}

void Rig::open_phases(void *ctx, int axis) {
    static_cast<Rig *>(ctx)->plant_.set_open(static_cast<size_t>(axis), true);
}

bool Rig::send_frame(void *ctx, const fl_can_frame_t *frame) {
    Rig &r = *static_cast<Rig *>(ctx);
    if (r.sent_count == mailbox_frames) return false;
    r.sent[r.sent_count++] = *frame;
    return true;
}

uint32_t Rig::storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    if (offset >= storage_bytes) return 0;
    const uint32_t held = std::min(len, storage_bytes - offset);
    std::memcpy(bytes, static_cast<Rig *>(ctx)->storage_ + offset, held);
    return held;
}

uint32_t Rig::storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    Rig &r = *static_cast<Rig *>(ctx);
    if (offset >= storage_bytes) return 0;
    uint32_t held = std::min(len, storage_bytes - offset);
    if (r.write_budget >= 0) {
        held = static_cast<uint32_t>(std::min<int64_t>(held, r.write_budget));
        r.write_budget -= held;
    }
    std::memcpy(r.storage_ + offset, bytes, held);
    return held;
}

} // namespace fl::rig
