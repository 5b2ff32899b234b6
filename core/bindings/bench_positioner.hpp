// One positioner on a bench: the firmware behind a port whose sensors are either set by the caller or
// driven by a small plant. For tests of the firmware; the twin proper is core/twin.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

extern "C" {
#include "fl_dispatch.h"
#include "fl_positioner.h"
}

namespace fl {

// Rigid rotor with drag, Coulomb friction, spring and cogging; no backlash, no compliance.
struct BenchPlant {
    double inertia = 3.5e-9, drag = 8e-7, coulomb = 2e-5;
    double back_emf = 5e-7; // of the drag: none while the bridge is open
    double spring_torque = 8e-6, spring_rate = -9e-10;
    double cogging_torque = 1e-5, cogging_phase = 0;
    double torque_per_volt = 4.2e-5, u_dc = 12;
    double stop_rad = -1e9; // nothing passes below
    double blocked = 0;     // 1: the rotor is held
    double external_torque = 0;
    double theta_rad = 0, omega_rad_s = 0;
    std::array<float, 3> duty{};
    bool open = false; // the bridge: no phase is connected

    // Eq. 19 without its back-EMF, which `drag` holds.
    double motor_torque(double theta) const {
        if (open) return 0.0;
        const double half_sqrt3 = std::sqrt(3.0) / 2;
        const double u_cos = 4.0 / 3 * (duty[2] - (duty[0] + duty[1]) / 2);
        const double u_sin = (duty[1] - duty[0]) / half_sqrt3;
        return torque_per_volt * u_dc * (u_sin * std::cos(theta) - u_cos * std::sin(theta));
    }

    // Half drift, kick with implicit drag and soft-threshold friction, half drift.
    void step(double dt) {
        theta_rad += omega_rad_s * dt / 2;
        const double slows = open ? drag - back_emf : drag;
        const double load = motor_torque(theta_rad) + spring_torque + spring_rate * theta_rad -
                            cogging_torque * std::sin(2 * theta_rad + cogging_phase) + external_torque;
        const double free = (omega_rad_s * inertia + dt * (load - slows * omega_rad_s / 2)) /
                            (1 + dt * slows / (2 * inertia));
        const double stuck = dt * coulomb / (1 + dt * slows / (2 * inertia));
        const double p = std::max(free - stuck, 0.0) + std::min(free + stuck, 0.0);
        omega_rad_s = blocked != 0 ? 0 : p / inertia;
        theta_rad += omega_rad_s * dt / 2;
        if (theta_rad < stop_rad) {
            theta_rad = stop_rad;
            omega_rad_s = std::max(omega_rad_s, 0.0);
        }
    }
};

struct BenchFrame {
    uint32_t id;
    std::vector<uint8_t> data;
};

class BenchPositioner {
  public:
    std::array<BenchPlant, FL_AXES> plant;
    std::array<std::array<uint16_t, 2>, FL_AXES> hall{}; // what the sensors say when `driven` is off
    std::vector<BenchFrame> sent;
    std::vector<uint8_t> storage = std::vector<uint8_t>(4096, 0xff);
    long write_budget = -1; // bytes until the power fails; -1 never
    bool driven = true;     // hall counts from the plants
    bool mailbox_open = true;
    bool opens = true; // the board can open its bridges; read at power-up
    double hall_noise_cnt = 0;
    int substeps = 10;

    BenchPositioner(uint16_t id, const fl_axis_params_t params[FL_AXES]) : id_(id) {
        params_ = {params[0], params[1]};
        power_up();
    }

    // The firmware is the C struct alone: power-up forgets everything but the storage.
    void power_up() {
        for (auto &p : plant) p.open = false;
        const fl_port_t port{this,         read_hall,     set_phases, send_frame,
                             storage_read, storage_write, nullptr,    opens ? open_phases : nullptr};
        fl_positioner_init(&firmware, &port, id_, params_.data());
    }

    void tick() {
        fl_positioner_tick(&firmware);
        if (!driven) return;
        for (auto &p : plant)
            for (int i = 0; i < substeps; ++i) p.step(1.0 / FL_TICK_HZ / substeps);
    }

    // Where the rotors truly are, in counts of the position.
    void declare_position() {
        const int32_t position[FL_AXES] = {counts(plant[0]), counts(plant[1])};
        fl_positioner_set_position(&firmware, position);
    }

    void receive(uint32_t id, const uint8_t *data, size_t len) {
        fl_can_frame_t f{id, static_cast<uint8_t>(len), {}};
        for (size_t i = 0; i < len && i < 8; ++i) f.data[i] = data[i];
        fl_positioner_receive(&firmware, &f);
    }

    fl_positioner_t firmware{};

  private:
    uint16_t id_;
    std::array<fl_axis_params_t, FL_AXES> params_;
    uint64_t random_ = 0x9e3779b97f4a7c15;

    static int32_t counts(const BenchPlant &p) {
        return static_cast<int32_t>(std::llround(p.theta_rad / (2 * M_PI) * FL_TURN_CNT));
    }
    static BenchPositioner &self(void *ctx) { return *static_cast<BenchPositioner *>(ctx); }

    // Sum of four uniforms: normal enough for sensor noise, the same on every machine.
    double noise() {
        double sum = 0;
        for (int i = 0; i < 4; ++i) {
            random_ = random_ * 6364136223846793005ull + 1442695040888963407ull;
            sum += static_cast<double>(random_ >> 40) / 16777216.0 - 0.5;
        }
        return sum * std::sqrt(3.0) * hall_noise_cnt;
    }

    uint16_t adc(double value) {
        return static_cast<uint16_t>(std::clamp(std::lround(value + noise()), 0l, long{FL_HALL_ADC_MAX}));
    }

    static void read_hall(void *ctx, int axis, uint16_t out[2]) {
        BenchPositioner &b = self(ctx);
        if (b.driven) {
            const fl_axis_params_t &p = b.params_[axis];
            const double theta = b.plant[axis].theta_rad;
            b.hall[axis][0] = b.adc(p.hall_offset_a + p.hall_amplitude_a * std::sin(theta));
            b.hall[axis][1] = b.adc(p.hall_offset_b + p.hall_amplitude_b * std::cos(theta + p.hall_phase));
        }
        out[0] = b.hall[axis][0];
        out[1] = b.hall[axis][1];
    }
    static void set_phases(void *ctx, int axis, const float duty[3]) {
        for (int i = 0; i < 3; ++i) self(ctx).plant[axis].duty[i] = duty[i];
        self(ctx).plant[axis].open = false;
    }
    static void open_phases(void *ctx, int axis) { self(ctx).plant[axis].open = true; }
    static bool send_frame(void *ctx, const fl_can_frame_t *f) {
        BenchPositioner &b = self(ctx);
        if (b.mailbox_open) b.sent.push_back({f->id, std::vector<uint8_t>(f->data, f->data + f->len)});
        return b.mailbox_open;
    }
    static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
        const auto &s = self(ctx).storage;
        if (offset > s.size()) return 0;
        const auto n = std::min<size_t>(len, s.size() - offset);
        std::copy_n(s.begin() + offset, n, static_cast<uint8_t *>(bytes));
        return static_cast<uint32_t>(n);
    }
    static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
        BenchPositioner &b = self(ctx);
        if (offset > b.storage.size()) return 0;
        size_t n = std::min<size_t>(len, b.storage.size() - offset);
        if (b.write_budget >= 0) {
            n = std::min<size_t>(n, static_cast<size_t>(b.write_budget));
            b.write_budget -= static_cast<long>(n);
        }
        std::copy_n(static_cast<const uint8_t *>(bytes), n, b.storage.begin() + offset);
        return static_cast<uint32_t>(n);
    }
};

} // namespace fl
