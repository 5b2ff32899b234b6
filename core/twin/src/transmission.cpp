#include "fiberloom/twin/transmission.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fl::twin {
namespace {

constexpr double two_pi = 2.0 * std::numbers::pi;
constexpr double node_step_rad = two_pi / nodes_per_turn;

// cos and sin of a node angle times an order are entries of one table: no transcendental at run time.
struct Circle {
    std::array<Harmonic, nodes_per_turn> point;
    Circle() {
        for (size_t i = 0; i < nodes_per_turn; ++i) {
            const double angle = node_step_rad * static_cast<double>(i);
            point[i] = {std::cos(angle), std::sin(angle)};
        }
    }
    const Harmonic &at(int32_t k) const { return point[static_cast<size_t>(k) & (nodes_per_turn - 1)]; }
};
const Circle circle;

// Sums of both series at a node: delta in output rad, backlash in motor rad without its mean.
struct Sums {
    double delta_rad = 0.0, backlash_rad = 0.0;
};

// Both sums at once, in one vector.
Sums series(const Transmission &t, int32_t index) {
    typedef double Both __attribute__((vector_size(16)));
    Both sums = {};
    for (size_t i = 0; i < harmonic_count; ++i) {
        const Harmonic &wave = circle.at(harmonic_orders[i] * index);
        const Both cosines = {t.delta_rad[i].cos, t.backlash_rad[i].cos};
        const Both sines = {t.delta_rad[i].sin, t.backlash_rad[i].sin};
        sums += cosines * wave.cos + sines * wave.sin;
    }
    return {sums[0], sums[1]};
}

double wear_at(const std::array<Wear, wear_count> &marks, double theta_rad) {
    double sum = 0.0;
    for (const Wear &w : marks) {
        const double off = std::abs(theta_rad - w.centre_rad);
        if (w.height_rad != 0.0 && off < 0.5 * w.width_rad)
            sum += w.height_rad * 0.5 * (1.0 + std::cos(two_pi * off / w.width_rad));
    }
    return sum;
}

Cell between(int32_t index, Node lo, Node hi) {
    const double width = hi.gear_rad - lo.gear_rad;
    const double slope = (hi.backlash_rad - lo.backlash_rad) / width;
    return {
        index, lo, hi, node_step_rad * index, node_step_rad / width, lo.backlash_rad - slope * lo.gear_rad,
        slope};
}

bool is_worn(const Transmission &t) {
    return std::any_of(t.wear.begin(), t.wear.end(), [](const Wear &w) { return w.height_rad != 0.0; });
}

// By the sums of amplitudes alone: a thousand gears are checked at once, and none is refused by it.
bool plainly_sound(const Transmission &t, double gear_ratio) {
    double slope = 0.0, depth = 0.0;
    for (size_t i = 0; i < harmonic_count; ++i) {
        const double delta = std::hypot(t.delta_rad[i].cos, t.delta_rad[i].sin);
        const double backlash = std::hypot(t.backlash_rad[i].cos, t.backlash_rad[i].sin);
        slope += harmonic_orders[i] * (delta + backlash / gear_ratio);
        depth += backlash;
    }
    return !is_worn(t) && slope < 1.0 && depth <= t.backlash_mean_rad;
}

} // namespace

Node transmission_node(const Transmission &t, double gear_ratio, int32_t index) {
    const double theta = node_step_rad * index;
    const Sums sums = series(t, index);
    const double delta = sums.delta_rad + wear_at(t.wear, theta);
    return {gear_ratio * (theta + delta), t.backlash_mean_rad + sums.backlash_rad};
}

Cell transmission_cell(const Transmission &t, double gear_ratio, int32_t index) {
    return between(index, transmission_node(t, gear_ratio, index),
                   transmission_node(t, gear_ratio, index + 1));
}

Cell cell_of_gear(const Transmission &t, double gear_ratio, double gear_rad, const Cell &near) {
    int32_t index = near.index;
    Node lo = near.lo, hi = near.hi;
    while (gear_rad >= hi.gear_rad) {
        lo = hi;
        hi = transmission_node(t, gear_ratio, ++index + 1);
    }
    while (gear_rad < lo.gear_rad) {
        hi = lo;
        lo = transmission_node(t, gear_ratio, --index);
    }
    return between(index, lo, hi);
}

Cell cell_of_output(const Transmission &t, double gear_ratio, double output_rad) {
    return transmission_cell(t, gear_ratio, static_cast<int32_t>(std::floor(output_rad / node_step_rad)));
}

double gear_of_output(const Cell &cell, double output_rad) {
    return cell.lo.gear_rad + (output_rad - cell.output_lo_rad) / cell.output_per_gear;
}

double output_of_gear(const Cell &cell, double gear_rad) {
    return cell.output_lo_rad + (gear_rad - cell.lo.gear_rad) * cell.output_per_gear;
}

const char *transmission_fault(const Transmission &t, double gear_ratio) {
    if (plainly_sound(t, gear_ratio)) return nullptr;
    // the series repeat every turn, wear does not
    const int32_t first = is_worn(t) ? -2 * nodes_per_turn : 0;
    const int32_t last = is_worn(t) ? 2 * nodes_per_turn : nodes_per_turn;
    Node lo = transmission_node(t, gear_ratio, first);
    for (int32_t i = first + 1; i <= last; ++i) {
        const Node hi = transmission_node(t, gear_ratio, i);
        if (hi.backlash_rad < 0.0) return "backlash is negative somewhere";
        if (!(hi.gear_rad > lo.gear_rad)) return "delta falls faster than the angle rises";
        if (!(hi.gear_rad + hi.backlash_rad > lo.gear_rad + lo.backlash_rad))
            return "backlash falls faster than the angle rises";
        lo = hi;
    }
    return nullptr;
}

} // namespace fl::twin
