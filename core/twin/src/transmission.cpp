#include "fiberloom/twin/transmission.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numbers>

// Sums may be computed by wider vectors where a machine has them, with the same bits.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(FL_ONE_COPY)
#define FL_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define FL_CLONES
#endif

namespace fl::twin {
namespace {

constexpr double two_pi = 2.0 * std::numbers::pi;

// cos and sin of the angle of a node, all turns alike.
Harmonic on_circle(int32_t node) {
    const double angle = node_step_rad * static_cast<double>(node & (nodes_per_turn - 1));
    return {std::cos(angle), std::sin(angle)};
}

// At the first nodes of blocks, times any order: no transcendental at run time, and 8 KB that stay in the
// cache.
struct Circle {
    static constexpr int32_t blocks = nodes_per_turn / block_nodes;
    Harmonic point[blocks];
    Circle() {
        for (int32_t i = 0; i < blocks; ++i) point[i] = on_circle(block_nodes * i);
    }
    const Harmonic &at(int32_t block) const { return point[block & (blocks - 1)]; }
};
const Circle circle;

// Four numbers at once; named, not in loops over memory, so that sums stay in registers.
typedef double Quad __attribute__((vector_size(32)));
typedef int64_t Places __attribute__((vector_size(32)));
static_assert(sizeof(Quad) == sizeof(Gear::Wave));
constexpr int32_t quad_nodes = sizeof(Quad) / sizeof(double), block_quads = block_nodes / quad_nodes;
static_assert(block_quads == 2);

// Sums of both series at the nodes of a block: delta in output rad, backlash in motor rad without its mean.
struct Sums {
    Quad delta_rad[block_quads], backlash_rad[block_quads];
    double delta_rad_at(int32_t k) const { return delta_rad[k / quad_nodes][k % quad_nodes]; }
    double backlash_rad_at(int32_t k) const { return backlash_rad[k / quad_nodes][k % quad_nodes]; }
};

// Every order at the nodes of a block, counted from its first.
struct Within {
    Quad cos[harmonic_count][block_quads], sin[harmonic_count][block_quads];
    Within() {
        for (size_t i = 0; i < harmonic_count; ++i)
            for (int32_t k = 0; k < block_nodes; ++k) {
                const Harmonic wave = on_circle(harmonic_orders[i] * k);
                cos[i][k / quad_nodes][k % quad_nodes] = wave.cos;
                sin[i][k / quad_nodes][k % quad_nodes] = wave.sin;
            }
    }
};
const Within within;

FL_CLONES void series(const Gear &gear, int32_t block, Sums &out) {
    Quad delta_0 = {}, delta_1 = {}, backlash_0 = {}, backlash_1 = {};
    const Gear::Wave *wave = gear.waves.get();
    for (uint32_t left = gear.orders; left != 0; left &= left - 1, ++wave) {
        const auto i = static_cast<size_t>(__builtin_ctz(left));
        // both amplitudes, cos and sin of each, as seen from where the wave is at the first node of the block
        const Harmonic &at = circle.at(harmonic_orders[i] * block);
        const Quad at_cos = {at.cos, at.cos, at.cos, at.cos}, at_sin = {at.sin, -at.sin, at.sin, -at.sin};
        Quad own;
        std::memcpy(&own, wave, sizeof own);
        const Quad seen = own * at_cos + __builtin_shuffle(own, Places{1, 0, 3, 2}) * at_sin;
        const Quad(&cos)[block_quads] = within.cos[i], (&sin)[block_quads] = within.sin[i];
        delta_0 += seen[0] * cos[0] + seen[1] * sin[0];
        delta_1 += seen[0] * cos[1] + seen[1] * sin[1];
        backlash_0 += seen[2] * cos[0] + seen[3] * sin[0];
        backlash_1 += seen[2] * cos[1] + seen[3] * sin[1];
    }
    out = {{delta_0, delta_1}, {backlash_0, backlash_1}};
}

double wear_at(const WearMarks &marks, double theta_rad) {
    double sum = 0.0;
    for (const Wear &w : marks) {
        const double off = std::abs(theta_rad - w.centre_rad);
        if (w.height_rad != 0.0 && off < 0.5 * w.width_rad)
            sum += w.height_rad * 0.5 * (1.0 + std::cos(two_pi * off / w.width_rad));
    }
    return sum;
}

bool is_worn(const Transmission &t) {
    return std::any_of(t.wear.begin(), t.wear.end(), [](const Wear &w) { return w.height_rad != 0.0; });
}

// Calls look(lo, hi) for the cells between neighbouring nodes, until it says no. The series repeat every
// turn, wear does not.
template <class Look> void each_cell(const Gear &gear, double gear_ratio, Look &&look) {
    const int32_t first = gear.wear ? -2 * nodes_per_turn : 0;
    const int32_t last = gear.wear ? 2 * nodes_per_turn : nodes_per_turn;
    NodeBlock block;
    Node lo = block.at(gear, gear_ratio, first);
    for (int32_t i = first + 1; i <= last; ++i) {
        const Node hi = block.at(gear, gear_ratio, i);
        if (!look(lo, hi)) return;
        lo = hi;
    }
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

Gear::Gear(const Transmission &t)
    : backlash_mean_rad(t.backlash_mean_rad),
      wear(is_worn(t) ? std::make_unique<const WearMarks>(t.wear) : nullptr) {
    const auto silent = [](const Harmonic &h) { return h.cos == 0.0 && h.sin == 0.0; };
    for (size_t i = 0; i < harmonic_count; ++i)
        if (!silent(t.delta_rad[i]) || !silent(t.backlash_rad[i])) orders |= 1U << i;
    wave_count = static_cast<uint32_t>(std::popcount(orders));
    waves = std::make_unique<Wave[]>(wave_count);
    Wave *wave = waves.get();
    for (uint32_t left = orders; left != 0; left &= left - 1) {
        const auto i = static_cast<size_t>(std::countr_zero(left));
        *wave++ = {t.delta_rad[i], t.backlash_rad[i]};
    }
}

void NodeBlock::load(const Gear &gear, double gear_ratio, int32_t block) {
    Sums sums;
    series(gear, block, sums);
    for (int32_t k = 0; k < block_nodes; ++k) {
        const double theta = node_step_rad * (block * block_nodes + k);
        const double delta = sums.delta_rad_at(k) + (gear.wear ? wear_at(*gear.wear, theta) : 0.0);
        nodes[static_cast<size_t>(k)] = {gear_ratio * (theta + delta),
                                         gear.backlash_mean_rad + sums.backlash_rad_at(k)};
    }
    number = block;
}

Node transmission_node(const Gear &gear, double gear_ratio, int32_t index) {
    NodeBlock block;
    return block.at(gear, gear_ratio, index);
}

Cell transmission_cell(const Gear &gear, double gear_ratio, int32_t index) {
    NodeBlock block;
    const Node lo = block.at(gear, gear_ratio, index);
    return {index, lo, block.at(gear, gear_ratio, index + 1)};
}

void seek_gear(const Gear &gear, double gear_ratio, double gear_rad, Cell &cell, NodeBlock &block) {
    while (gear_rad >= cell.hi.gear_rad) {
        cell.lo = cell.hi;
        cell.hi = block.at(gear, gear_ratio, ++cell.index + 1);
    }
    while (gear_rad < cell.lo.gear_rad) {
        cell.hi = cell.lo;
        cell.lo = block.at(gear, gear_ratio, --cell.index);
    }
}

Cell cell_of_output(const Gear &gear, double gear_ratio, double output_rad) {
    return transmission_cell(gear, gear_ratio, static_cast<int32_t>(std::floor(output_rad / node_step_rad)));
}

double gear_of_output(const Cell &cell, double output_rad) {
    return cell.lo.gear_rad + (output_rad - cell.output_lo_rad()) / cell.output_per_gear();
}

double output_of_gear(const Cell &cell, double gear_rad) {
    return cell.output_lo_rad() + (gear_rad - cell.lo.gear_rad) * cell.output_per_gear();
}

// By the sums of amplitudes where those tell little more than the nodes would.
double output_per_motor(const Gear &gear, double gear_ratio) {
    constexpr double shallow = 0.3;
    double slope = 0.0;
    const Gear::Wave *wave = gear.waves.get();
    for (uint32_t left = gear.orders; left != 0; left &= left - 1, ++wave)
        slope += harmonic_orders[static_cast<size_t>(std::countr_zero(left))] *
                 (std::hypot(wave->delta_rad.cos, wave->delta_rad.sin) +
                  std::hypot(wave->backlash_rad.cos, wave->backlash_rad.sin) / gear_ratio);
    if (!gear.wear && slope < shallow) return 1.0 / (gear_ratio * (1.0 - slope));
    double narrowest_rad = gear_ratio * node_step_rad;
    each_cell(gear, gear_ratio, [&](const Node &lo, const Node &hi) {
        const double gear_rad = hi.gear_rad - lo.gear_rad;
        narrowest_rad = std::min({narrowest_rad, gear_rad, gear_rad + hi.backlash_rad - lo.backlash_rad});
        return true;
    });
    return node_step_rad / narrowest_rad;
}

const char *transmission_fault(const Transmission &t, double gear_ratio) {
    if (plainly_sound(t, gear_ratio)) return nullptr;
    const char *fault = nullptr;
    each_cell(Gear(t), gear_ratio, [&](const Node &lo, const Node &hi) {
        if (hi.backlash_rad < 0.0)
            fault = "backlash is negative somewhere";
        else if (!(hi.gear_rad > lo.gear_rad))
            fault = "delta falls faster than the angle rises";
        else if (!(hi.gear_rad + hi.backlash_rad > lo.gear_rad + lo.backlash_rad))
            fault = "backlash falls faster than the angle rises";
        return fault == nullptr;
    });
    return fault;
}

} // namespace fl::twin
