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
    std::array<double, nodes_per_turn> sine;
    Circle() {
        for (int i = 0; i < nodes_per_turn; ++i) sine[static_cast<size_t>(i)] = std::sin(node_step_rad * i);
    }
    double sin_at(int32_t k) const { return sine[static_cast<size_t>(k) & (nodes_per_turn - 1)]; }
    double cos_at(int32_t k) const { return sin_at(k + nodes_per_turn / 4); }
};
const Circle circle;

double series(const std::array<Harmonic, harmonic_count> &terms, int32_t index) {
    double sum = 0.0;
    for (size_t i = 0; i < terms.size(); ++i) {
        const int32_t k = harmonic_orders[i] * index;
        sum += terms[i].cos * circle.cos_at(k) + terms[i].sin * circle.sin_at(k);
    }
    return sum;
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
    return {index, lo.gear_rad, hi.gear_rad, node_step_rad * index, node_step_rad / width,
            lo.backlash_rad - slope * lo.gear_rad, slope};
}

} // namespace

Node transmission_node(const Transmission &t, double gear_ratio, int32_t index) {
    const double theta = node_step_rad * index;
    const double delta = series(t.delta_rad, index) + wear_at(t.wear, theta);
    return {gear_ratio * (theta + delta), t.backlash_mean_rad + series(t.backlash_rad, index)};
}

Cell transmission_cell(const Transmission &t, double gear_ratio, int32_t index) {
    return between(index, transmission_node(t, gear_ratio, index),
                   transmission_node(t, gear_ratio, index + 1));
}

Cell cell_of_gear(const Transmission &t, double gear_ratio, double gear_rad, int32_t near_index) {
    Cell cell = transmission_cell(t, gear_ratio, near_index);
    while (gear_rad >= cell.gear_hi_rad) cell = transmission_cell(t, gear_ratio, cell.index + 1);
    while (gear_rad < cell.gear_lo_rad) cell = transmission_cell(t, gear_ratio, cell.index - 1);
    return cell;
}

Cell cell_of_output(const Transmission &t, double gear_ratio, double output_rad) {
    return transmission_cell(t, gear_ratio, static_cast<int32_t>(std::floor(output_rad / node_step_rad)));
}

double gear_of_output(const Cell &cell, double output_rad) {
    return cell.gear_lo_rad + (output_rad - cell.output_lo_rad) / cell.output_per_gear;
}

double output_of_gear(const Cell &cell, double gear_rad) {
    return cell.output_lo_rad + (gear_rad - cell.gear_lo_rad) * cell.output_per_gear;
}

const char *transmission_fault(const Transmission &t, double gear_ratio) {
    // the series repeat every turn, wear does not
    const bool worn = std::any_of(t.wear.begin(), t.wear.end(), [](const Wear &w) { return w.height_rad != 0.0; });
    const int32_t first = worn ? -2 * nodes_per_turn : 0, last = worn ? 2 * nodes_per_turn : nodes_per_turn;
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
