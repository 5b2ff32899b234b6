#include "fiberloom/twin/plant.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

namespace fl::twin {
namespace {

// A seat is forgotten over a motor turn of travel, four nodes (assumed: far below the 840 degrees of an
// approach, far above the microsteps of nothing at all).
constexpr double seat_memory = 0.7788; // exp(-1/4)
constexpr double seat_news = 0.6273;   // sqrt(1 - memory^2)

constexpr double blocked_Nm = 1.0; // a thousand times what these motors give

const Kernel *kernel_by_name(const std::string &name) {
    const Kernel *found = nullptr;
    std::string known;
    for (const Kernel *const *k = kernels(); *k != nullptr; ++k) {
        if (name.empty() || name == (*k)->name) found = *k;
        known += std::string(" ") + (*k)->name;
    }
    if (found == nullptr) throw std::invalid_argument("kernel '" + name + "': this machine has" + known);
    return found;
}

[[noreturn]] void refuse(size_t axis, const std::string &what) {
    throw std::invalid_argument("axis " + std::to_string(axis) + ": " + what);
}

void check_params(size_t axis, const PlantParams &params) {
    const double *value = &params.inertia_motor;
    for (const PlantParamInfo &info : plant_param_infos) {
        if (!(*value >= info.min && *value <= info.max))
            refuse(axis, std::string(info.name) + " = " + std::to_string(*value) + ", allowed " +
                             std::to_string(info.min) + " to " + std::to_string(info.max) + " " + info.unit);
        ++value;
    }
    if (params.stop_min >= params.stop_max) refuse(axis, "stop_min must be below stop_max");
}

void check(size_t axis, const Unit &unit) {
    check_params(axis, unit.params);
    if (const char *fault = transmission_fault(unit.transmission, unit.params.gear_ratio))
        refuse(axis, fault);
}

size_t positioners_of(size_t axes) {
    const size_t positioners = (axes + 1) / 2, most = size_t{UINT16_MAX} + 1;
    if (positioners > most) throw std::invalid_argument("a plant has 131072 axes at most");
    return positioners;
}

void check_substeps(Substeps substeps) {
    if (substeps.all < 1 || substeps.all > 100000)
        throw std::invalid_argument("substeps: 1 to 100000 a tick");
    if (substeps.pushing < 1 || substeps.pushing > substeps.all)
        throw std::invalid_argument("substeps of an axis that pushes its gear: 1 to those of any");
}

// splitmix64: keys of neighbouring axes have nothing in common.
uint32_t noise_key(uint64_t seed, uint64_t axis) {
    uint64_t z = seed + (axis + 1) * 0x9E3779B97F4A7C15ULL;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return static_cast<uint32_t>((z ^ (z >> 31)) >> 16);
}

// Lanes without an axis must be harmless to step: nothing moves them, no division by zero.
AxisGroup idle_group() {
    AxisGroup g{};
    for (size_t i = 0; i < lane_count; ++i) {
        g.pwm_steps[i] = g.cosine[i] = 1.0f;
        g.backlash_scale[i] = 1.0;
        g.coulomb_motor_Nms[i] = static_cast<float>(blocked_Nm);
        g.cell_lo_rad[i] = g.stop_lo_rad[i] = -1.0;
        g.cell_hi_rad[i] = g.stop_hi_rad[i] = 1.0;
    }
    return g;
}

} // namespace

Plant::Plant(const std::vector<Unit> &units, const std::vector<double> &output_rad, uint64_t seed,
             const char *kernel, Substeps substeps)
    : kernel_(kernel_by_name(kernel)), substeps_(substeps), h_s_(tick_s / substeps.all),
      members_(positioners_of(units.size())), slots_(members_.size()) {
    if (units.size() != output_rad.size()) throw std::invalid_argument("one output angle for every axis");
    check_substeps(substeps);
    axes_.resize(units.size());
    for (size_t axis = 0; axis < std::min<size_t>(units.size(), 2); ++axis)
        first_params_[axis] = units[axis].params;
    groups_.assign((units.size() + lane_count - 1) / lane_count, idle_group());
    slipping_.assign(groups_.size(), 0);
    std::iota(members_.begin(), members_.end(), uint16_t{0});
    slots_ = members_;
    for (size_t axis = 0; axis < units.size(); ++axis) {
        check(axis, units[axis]);
        keep_params(axis, units[axis].params);
        axes_[axis].gear = Gear(units[axis].transmission);
        group_of(axis).noise_key[place(axis).lane] = noise_key(seed, axis);
        axes_[axis].seat.key = noise_key(~seed, axis);
        configure(axis);
        put(axis, output_rad[axis]);
    }
}

const Plant::Broken Plant::whole;

size_t Plant::bytes() const {
    size_t bytes = axes_.capacity() * sizeof(Axis) + groups_.capacity() * sizeof(AxisGroup);
    bytes += (members_.capacity() + slots_.capacity()) * sizeof(uint16_t);
    for (const Axis &a : axes_)
        bytes += a.gear.bytes() + a.params.held_bytes() + (a.broken ? sizeof(Broken) : size_t{0});
    return bytes;
}

void Plant::rearrange(const std::vector<uint16_t> &members) {
    std::vector<AxisGroup> groups(groups_.size(), idle_group());
    std::vector<uint64_t> slipping(groups_.size(), 0);
    for (size_t slot = 0; slot < members.size(); ++slot) {
        for (size_t axis = 2 * size_t{members[slot]};
             axis < std::min(2 * size_t{members[slot]} + 2, axes_.size()); ++axis) {
            const Place from = place(axis);
            const size_t group = slot / lane_group_size;
            const size_t lane = axis % 2 * lane_group_size + slot % lane_group_size;
            copy_lane(groups_[from.group], static_cast<size_t>(from.lane), groups[group], lane);
            slipping[group] |= (slipping_[from.group] >> from.lane & 1) << lane;
        }
    }
    // where they are: others keep their addresses
    std::copy(groups.begin(), groups.end(), groups_.begin());
    std::copy(members.begin(), members.end(), members_.begin());
    slipping_ = std::move(slipping);
    for (size_t slot = 0; slot < members.size(); ++slot) slots_[members[slot]] = static_cast<uint16_t>(slot);
}

void Plant::step(size_t group, uint64_t used) {
    AxisGroup &g = groups_[group];
    kernel_->drive(g, used);
    const TickEvents events = kernel_->step(g, substeps_);
    foresee_cells(group, events.will_leave);
    if (events.left_cell != 0) follow_cells(group, events.left_cell);
    for (uint64_t left = slipping_[group]; left != 0; left &= left - 1)
        slip(axis_at(group, static_cast<size_t>(__builtin_ctzll(left))));
}

// What a new cell needs may lie far from the processor: it is asked for two ticks before, and the amplitudes
// of a gear of which the next node lies in another block a tick before.
void Plant::foresee_cells(size_t group, uint64_t lanes) {
    AxisGroup &g = groups_[group];
    for (uint64_t left = lanes & g.leaving & g.block_ends; left != 0; left &= left - 1)
        fetch_gear(axis_at(group, static_cast<size_t>(__builtin_ctzll(left))));
    for (uint64_t left = lanes & ~g.leaving; left != 0; left &= left - 1)
        fetch(axis_at(group, static_cast<size_t>(__builtin_ctzll(left))));
    g.leaving = lanes;
}

// Gears that left their cell inside a tick, as many at once as one call for numbers serves. One thing of all
// of them, then the next: what takes long of one does not wait for another's.
void Plant::follow_cells(size_t group, uint64_t lanes) {
    while (lanes != 0) {
        size_t axes[bell_vector];
        int32_t nodes[bell_vector];
        alignas(64) uint64_t counter[bell_vector] = {};
        alignas(64) double bell[bell_vector];
        size_t count = 0;
        for (; lanes != 0 && count < bell_vector; lanes &= lanes - 1)
            axes[count++] = axis_at(group, static_cast<size_t>(__builtin_ctzll(lanes)));
        for (size_t k = 0; k < count; ++k) nodes[k] = follow_cell(axes[k]);
        for (size_t k = 0; k < count; ++k) counter[k] = axes_[axes[k]].seat.counter();
        kernel_->bells(counter, bell, static_cast<int>(count));
        for (size_t k = 0; k < count; ++k) follow_seat(axes[k], nodes[k], bell[k]);
    }
}

// Asks for what a new cell changes.
void Plant::fetch(size_t axis) const {
    constexpr size_t line = 64;
    const auto *begin = reinterpret_cast<const char *>(&axes_[axis]);
    for (size_t at = 0; at < offsetof(Axis, broken); at += line) __builtin_prefetch(begin + at, 1);
    __builtin_prefetch(begin + offsetof(Axis, broken), 1);
}

void Plant::fetch_gear(size_t axis) const {
    constexpr size_t line = 64;
    const Gear &gear = axes_[axis].gear;
    const auto *begin = reinterpret_cast<const char *>(gear.waves.get());
    const size_t bytes = gear.wave_count * sizeof(Gear::Wave);
    for (size_t i = 0; i < bytes; i += line) __builtin_prefetch(begin + i);
    // to gcc a function that only asks for memory does nothing, and it leaves out the call
    asm volatile("");
}

double Plant::geared_rad(size_t axis) const {
    return output_of_gear(axes_[axis].cell, lane(axis, &AxisGroup::gear_rad));
}

// The arm makes a share of the gear's way since the last tick; the rest is lost, and the stops with it.
void Plant::slip(size_t axis) {
    Broken &a = *axes_[axis].broken;
    const double way_rad = geared_rad(axis) - a.geared_rad;
    if (way_rad == 0.0) return;
    a.geared_rad += way_rad;
    a.slip_rad += ((way_rad > 0.0 ? a.faults.follows_up : a.faults.follows_down) - 1.0) * way_rad;
    configure_stops(axis);
}

AxisState Plant::state(size_t axis) const {
    return {lane(axis, &AxisGroup::theta_rad), lane(axis, &AxisGroup::p_Nms),
            lane(axis, &AxisGroup::gear_rad), output_rad(axis)};
}

void Plant::set_state(size_t axis, double theta_rad, double momentum_Nms, double gear_rad) {
    set(axis, &AxisGroup::theta_rad, theta_rad);
    set(axis, &AxisGroup::p_Nms, momentum_Nms);
    set(axis, &AxisGroup::still, 0);
    set(axis, &AxisGroup::gear_rad, gear_rad);
    seek_cell(axis, gear_rad);
}

double Plant::output_at_rest_rad(size_t axis) const {
    const Axis &a = axes_[axis];
    if (broken(axis).faults.lying) return broken(axis).held_rad;
    const double gear_rad = lane(axis, &AxisGroup::gear_rad);
    const double share = (gear_rad - a.cell.lo.gear_rad) / (a.cell.hi.gear_rad - a.cell.lo.gear_rad);
    const double seat_rad = a.seat.lo_rad + share * (a.seat.hi_rad - a.seat.lo_rad);
    return output_of_gear(a.cell, gear_rad) + seat_rad + broken(axis).slip_rad;
}

double Plant::deflection_rad(size_t axis) const {
    const double torque_Nm = axes_[axis].torque_Nm + stop_torque_Nm(axis);
    return torque_Nm == 0.0 ? 0.0 : torque_Nm * compliance_rad_per_Nm(axis);
}

double Plant::output_rad(size_t axis) const { return output_at_rest_rad(axis) + deflection_rad(axis); }

double Plant::backlash_rad(size_t axis) const {
    return axes_[axis].cell.backlash().at(lane(axis, &AxisGroup::gear_rad));
}

// The corner of the field of three phases between 0 and the supply lies at sqrt(3) u_dc. The gear takes
// torque from the rotor and never gives: only drag, cogging and inertia are left. In an open bridge cogging
// acts without the drag of the EMF, so that it counts twice. Momentum is kept when contact opens, and a rotor
// that has lost the gear's inertia goes faster by their ratio.
SpeedBound speed_bound(const PlantParams &p) {
    const double constant = p.flux_linkage / p.coil_resistance;
    const double torque_Nm = std::sqrt(3.0) * constant * p.supply + 2.0 * (p.cogging_2 + p.cogging_4);
    const double drag_Nms = 1.5 * constant * p.flux_linkage + p.viscous_motor;
    const double time_constant_s = (p.inertia_motor + p.inertia_gear) / drag_Nms;
    return {torque_Nm / p.inertia_motor * time_constant_s, time_constant_s};
}

double Plant::output_per_motor(size_t axis) const {
    return fl::twin::output_per_motor(axes_[axis].gear, param(axis, &PlantParams::gear_ratio));
}

// Nodes are a chain of a memory and at most six standard deviations of news.
double Plant::seat_limit_rad(size_t axis) const {
    return 6.0 * seat_news / (1.0 - seat_memory) * axes_[axis].seat.rms_rad;
}

void Plant::set_external_torque(size_t axis, double torque_Nm) {
    axes_[axis].torque_Nm = torque_Nm;
    set(axis, &AxisGroup::still, 0);
    set(axis, &AxisGroup::load_0_Nms,
        h_s_ * (static_cast<double>(axes_[axis].spring_0_Nm) + torque_Nm) /
            param(axis, &PlantParams::gear_ratio));
}

void Plant::set_faults(size_t axis, AxisFaults faults) {
    std::unique_ptr<Broken> &broken = axes_[axis].broken;
    if (!broken && faults == AxisFaults{}) return;
    if (!broken) broken = std::make_unique<Broken>();
    Broken &a = *broken;
    if (faults.lying && !a.faults.lying) a.held_rad = output_at_rest_rad(axis);
    const bool caught = a.faults.lying && !faults.lying; // the coupling closes where the arm is
    a.faults = faults;
    if (caught) a.slip_rad += a.held_rad - output_at_rest_rad(axis);
    a.geared_rad = geared_rad(axis);
    const uint64_t bit = uint64_t{1} << place(axis).lane;
    uint64_t &slipping = slipping_[place(axis).group];
    slipping = faults.slips() ? slipping | bit : slipping & ~bit;
    configure(axis);
}

void Plant::set_params(size_t axis, const PlantParams &params) {
    check_params(axis, params);
    keep_params(axis, params);
    axes_[axis].block = {};
    set(axis, &AxisGroup::still, 0);
    configure(axis);
}

void Plant::set_transmission(size_t axis, const Transmission &transmission) {
    if (const char *fault = transmission_fault(transmission, param(axis, &PlantParams::gear_ratio)))
        refuse(axis, fault);
    const double gear_rad = lane(axis, &AxisGroup::gear_rad);
    const bool positive = lane(axis, &AxisGroup::theta_rad) > gear_rad + 0.5 * backlash_rad(axis);
    axes_[axis].gear = Gear(transmission);
    set(axis, &AxisGroup::still, 0);
    axes_[axis].block = {};
    axes_[axis].cell =
        transmission_cell(axes_[axis].gear, param(axis, &PlantParams::gear_ratio), axes_[axis].cell.index);
    seek_cell(axis, gear_rad);
    configure_stops(axis);
    if (positive) set(axis, &AxisGroup::theta_rad, gear_rad + backlash_rad(axis));
}

void Plant::put(size_t axis, double output_rad) {
    const PlantParams p = params(axis);
    if (!(output_rad >= p.stop_min && output_rad <= p.stop_max))
        refuse(axis, "output angle " + std::to_string(output_rad) + " rad lies beyond the hard stops");
    Axis &a = axes_[axis];
    a.cell = cell_of_output(a.gear, p.gear_ratio, output_rad);
    load_cell(axis);
    set(axis, &AxisGroup::gear_rad, gear_of_output(a.cell, output_rad));
    set(axis, &AxisGroup::theta_rad, lane(axis, &AxisGroup::gear_rad));
}

void Plant::keep_params(size_t axis, PlantParams params) {
    axes_[axis].seat.rms_rad = params.seat_rms;
    params.seat_rms = first_params_[axis % 2].seat_rms;
    axes_[axis].params = {first_params_[axis % 2], params};
}

void Plant::configure(size_t axis) {
    configure_drive(axis);
    configure_cogging(axis);
    configure_gear(axis);
    configure_stops(axis);
    configure_hall(axis);
    axes_[axis].spring_0_Nm =
        static_cast<float>(param(axis, &PlantParams::spring_rate) * param(axis, &PlantParams::spring_free));
    set_external_torque(axis, axes_[axis].torque_Nm);
}

// The EMF between two phases of the delta is that of the coil between them, lambda omega at its peak.
bool Plant::diodes_conduct(size_t axis) const {
    const PlantParams p = params(axis);
    const double speed_rad_s = std::abs(lane(axis, &AxisGroup::p_Nms)) / p.inertia_motor;
    return broken(axis).faults.dead || p.flux_linkage * speed_rad_s > p.supply;
}

void Plant::switch_bridge(size_t axis, Bridge bridge) {
    axes_[axis].bridge = bridge;
    set(axis, &AxisGroup::still, 0);
    configure_drive(axis);
    configure_gear(axis);
}

void Plant::configure_drive(size_t axis) {
    const PlantParams p = params(axis);
    const bool driven = !broken(axis).faults.dead && !axes_[axis].bridge.open;
    const double supply_V = driven ? p.supply : 0.0;
    set(axis, &AxisGroup::drive_scale_Nms,
        h_s_ * p.flux_linkage / p.coil_resistance * supply_V / p.pwm_steps);
    set(axis, &AxisGroup::pwm_steps, p.pwm_steps);
}

void Plant::configure_cogging(size_t axis) {
    const PlantParams p = params(axis);
    set(axis, &AxisGroup::cog_2s_Nms, h_s_ * p.cogging_2 * std::cos(p.cogging_2_phase));
    set(axis, &AxisGroup::cog_2c_Nms, h_s_ * p.cogging_2 * std::sin(p.cogging_2_phase));
    set(axis, &AxisGroup::cog_4s_Nms, 2.0 * h_s_ * p.cogging_4 * std::cos(p.cogging_4_phase));
    set(axis, &AxisGroup::cog_4c_Nms, h_s_ * p.cogging_4 * std::sin(p.cogging_4_phase));
}

void Plant::configure_gear(size_t axis) {
    const PlantParams p = params(axis);
    // in a closed bridge the coils are shorted at any duty; three sines around a delta add up to no current
    const double back_emf =
        axes_[axis].bridge.floats ? 0.0 : 1.5 * p.flux_linkage * p.flux_linkage / p.coil_resistance;
    const double inertia = p.inertia_motor + p.inertia_gear;
    const double free = 0.5 * h_s_ * (back_emf + p.viscous_motor) / p.inertia_motor;
    const double push = 0.5 * h_s_ * (back_emf + p.viscous_motor + p.viscous_gear) / inertia;
    set(axis, &AxisGroup::coulomb_motor_Nms,
        h_s_ * (broken(axis).faults.blocked ? blocked_Nm : p.coulomb_motor));
    set(axis, &AxisGroup::coulomb_gear_Nms, h_s_ * p.coulomb_gear);
    set(axis, &AxisGroup::load_1_Nms, -h_s_ * p.spring_rate / (p.gear_ratio * p.gear_ratio));
    set(axis, &AxisGroup::drag_free, free);
    set(axis, &AxisGroup::drag_free_inverse, 1.0 / (1.0 + free));
    set(axis, &AxisGroup::drag_push, push);
    set(axis, &AxisGroup::drag_push_inverse, 1.0 / (1.0 + push));
    set(axis, &AxisGroup::step_per_p_free, h_s_ / p.inertia_motor);
    set(axis, &AxisGroup::step_per_p_push, h_s_ / inertia);
    const double longer = static_cast<double>(substeps_.all) / substeps_.pushing;
    set(axis, &AxisGroup::drag_coarse, longer * push);
    set(axis, &AxisGroup::drag_coarse_inverse, 1.0 / (1.0 + longer * push));
    set(axis, &AxisGroup::step_per_p_coarse, longer * longer * h_s_ / inertia);
}

// A stop acts on the arm; seen from the gear it lies at T- of its angle, behind the gear's compliance.
void Plant::configure_stops(size_t axis) {
    const Axis &a = axes_[axis];
    const PlantParams p = params(axis);
    const double slip_rad = broken(axis).slip_rad;
    const auto gear_at = [&](double theta) {
        return gear_of_output(cell_of_output(a.gear, p.gear_ratio, theta), theta);
    };
    const double series = 1.0 / (1.0 / p.stiffness + 1.0 / p.stop_stiffness);
    set(axis, &AxisGroup::stop_lo_rad, gear_at(p.stop_min - slip_rad));
    set(axis, &AxisGroup::stop_hi_rad, gear_at(p.stop_max - slip_rad));
    set(axis, &AxisGroup::stop_Nms,
        broken(axis).faults.lying ? 0.0 : h_s_ * series / (p.gear_ratio * p.gear_ratio));
    look_for_stops(axis);
}

// Where no gear of a chunk may be at a stop, the plant does not ask. A gear that has left its cell is a
// little further on.
void Plant::look_for_stops(size_t axis) {
    constexpr double spare_rad = 1.0;
    AxisGroup &g = group_of(axis);
    const auto at = static_cast<size_t>(place(axis).lane);
    const bool near = g.cell_lo_rad[at] - spare_rad < g.stop_lo_rad[at] ||
                      g.cell_hi_rad[at] + spare_rad > g.stop_hi_rad[at];
    g.near_stop = (g.near_stop & ~(uint64_t{1} << at)) | uint64_t{near} << at;
}

void Plant::configure_hall(size_t axis) {
    const PlantParams p = params(axis);
    set(axis, &AxisGroup::hall_offset_a, p.hall_offset_a);
    set(axis, &AxisGroup::hall_sin_a, p.hall_amplitude_a);
    set(axis, &AxisGroup::hall_offset_b, p.hall_offset_b);
    set(axis, &AxisGroup::hall_cos_b, p.hall_amplitude_b * std::cos(p.hall_phase));
    set(axis, &AxisGroup::hall_sin_b, -p.hall_amplitude_b * std::sin(p.hall_phase));
    set(axis, &AxisGroup::hall_noise, p.hall_noise);
}

void Plant::load_cell(size_t axis) {
    AxisGroup &g = group_of(axis);
    const auto at = static_cast<size_t>(place(axis).lane);
    const Cell &cell = axes_[axis].cell;
    const Cell::Straight backlash = cell.backlash();
    g.backlash_0_rad[at] = backlash.at_0_rad;
    g.backlash_scale[at] = 1.0 / (1.0 + backlash.slope);
    g.cell_lo_rad[at] = cell.lo.gear_rad;
    g.cell_hi_rad[at] = cell.hi.gear_rad;
    look_for_stops(axis);
}

// From where it was.
void Plant::seek_cell(size_t axis, double gear_rad) {
    Axis &a = axes_[axis];
    seek_gear(a.gear, param(axis, &PlantParams::gear_ratio), gear_rad, a.cell, a.block);
    load_cell(axis);
}

// Returns by how many nodes. In positive contact the old cell's B placed the gear: the new one's does now, so
// that where the gear is never depends on how it came there.
int32_t Plant::follow_cell(size_t axis) {
    AxisGroup &g = group_of(axis);
    const auto at = static_cast<size_t>(place(axis).lane);
    const auto closed_rad = [&] { return (g.theta_rad[at] - g.backlash_0_rad[at]) * g.backlash_scale[at]; };
    const double gear_rad = g.gear_rad[at];
    const bool positive = gear_rad < g.theta_rad[at] && gear_rad - closed_rad() <= 1e-9;
    const int32_t before = axes_[axis].cell.index;
    seek_cell(axis, gear_rad);
    if (positive) g.gear_rad[at] = closed_rad();
    const int32_t index = axes_[axis].cell.index, last = index > before ? block_nodes - 2 : 0;
    const bool ends = (index & (block_nodes - 1)) == last;
    g.block_ends = (g.block_ends & ~(uint64_t{1} << at)) | uint64_t{ends} << at;
    return index - before;
}

// The cell moved on by so many nodes, up or down: what lies behind is forgotten. bell: of the seat's counter.
void Plant::follow_seat(size_t axis, int32_t nodes, double bell) {
    Seat &seat = axes_[axis].seat;
    const double rms_rad = seat.rms_rad;
    if (rms_rad == 0.0) return;
    double &ahead_rad = nodes > 0 ? seat.hi_rad : seat.lo_rad;
    double &behind_rad = nodes > 0 ? seat.lo_rad : seat.hi_rad;
    for (int32_t left = std::abs(nodes); left > 0; --left) {
        behind_rad = std::exchange(ahead_rad, seat_memory * ahead_rad + seat_news * rms_rad * bell);
        ++seat.passes;
        if (left > 1) bell = next_bell(seat);
    }
}

// Of one axis that has passed several nodes at once.
double Plant::next_bell(const Seat &seat) const {
    const uint64_t counter[bell_vector] = {seat.counter()};
    double bell[bell_vector];
    kernel_->bells(counter, bell, 1);
    return bell[0];
}

double Plant::stop_torque_Nm(size_t axis) const {
    if (broken(axis).faults.lying) return 0.0;
    const double gear_rad = lane(axis, &AxisGroup::gear_rad);
    const double over_rad = std::max(gear_rad - lane(axis, &AxisGroup::stop_hi_rad), 0.0) +
                            std::min(gear_rad - lane(axis, &AxisGroup::stop_lo_rad), 0.0);
    if (over_rad == 0.0) return 0.0;
    const PlantParams p = params(axis);
    return -over_rad / p.gear_ratio / (1.0 / p.stiffness + 1.0 / p.stop_stiffness);
}

} // namespace fl::twin
