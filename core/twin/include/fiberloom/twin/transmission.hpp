// The true non-linear transmission of one axis, Kronig 2020 Eq. 6 and 7.
//
//   negative contact: theta_motor = T-(theta) = n (theta + delta(theta)) = gear angle
//   positive contact: theta_motor = gear angle + B(theta)      (Eq. 3b, sign corrected)
//
// delta and B are harmonic series over the output turn plus a few local marks of wear. The truth is
// what lies between `nodes_per_turn` nodes by straight lines: a node's value depends on its number
// alone, so the truth does not depend on the way the axis took, and inverting it is exact.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <numbers>

#include "fiberloom/twin/plant_params.hpp"

namespace fl::twin {

inline constexpr int nodes_per_turn = 4096;
inline constexpr double node_step_rad = 2.0 * std::numbers::pi / nodes_per_turn; // output angle

// Cycles per output turn: eccentricities (1 to 3), the 36 tooth pairings of the last stage with
// sidebands (teeth differ) and overtones (peaks are sharp), and an earlier stage, 36 x 5.66, with its own.
// A gear need not have them all (src/fiberloom/twin/gears.py).
inline constexpr std::array<int, 13> harmonic_orders = {1, 2, 3, 35, 36, 37, 71, 72, 73, 108, 203, 204, 205};
inline constexpr int harmonic_count = static_cast<int>(harmonic_orders.size());
inline constexpr int wear_count = 8;

// Amplitudes of one harmonic.
struct Harmonic {
    double cos = 0.0, sin = 0.0;
};

// A raised cosine on delta, full width at its foot: what a worn tooth leaves.
struct Wear {
    double centre_rad = 0.0, width_rad = 0.0, height_rad = 0.0;
};

// Series of the deviations of one gear, Eq. 6 and 7; orders in harmonic_orders.
struct Waves {
    std::array<Harmonic, harmonic_count> delta_rad{};    // output angle
    std::array<Harmonic, harmonic_count> backlash_rad{}; // motor angle
    double backlash_mean_rad = 0.0;
};

using WearMarks = std::array<Wear, wear_count>;

// All deviations of one gear.
struct Transmission : Waves {
    WearMarks wear{};
};
static_assert(sizeof(Transmission) == (4 * harmonic_count + 1 + 3 * wear_count) * sizeof(double));

// The same as it is kept: without orders that the gear does not have, and most gears have no mark.
struct Gear {
    // One order of both series.
    struct Wave {
        Harmonic delta_rad, backlash_rad;
    };
    Gear() = default;
    explicit Gear(const Transmission &t);
    // Memory beside the object itself.
    size_t bytes() const {
        return wave_count * sizeof(Wave) + (wear != nullptr ? sizeof(WearMarks) : size_t{0});
    }

    uint32_t orders = 0;                   // a bit for each of harmonic_orders that it has
    uint32_t wave_count = 0;               // how many they are
    std::unique_ptr<Wave[]> waves;         // of each of them
    double backlash_mean_rad = 0.0;        // motor angle
    std::unique_ptr<const WearMarks> wear; // none: not worn
};

// Gear angle T- and backlash B at a node, motor rad.
struct Node {
    double gear_rad = 0.0, backlash_rad = 0.0;
};

// Between two nodes everything is linear in the gear angle.
struct Cell {
    int32_t index = 0; // node at its lower end, any turn
    Node lo, hi;

    double output_lo_rad() const { return node_step_rad * index; }
    double width_rad() const { return hi.gear_rad - lo.gear_rad; }
    double output_per_gear() const { return node_step_rad / width_rad(); } // d theta / d gear
    // B at any gear angle within.
    struct Straight {
        double at_0_rad, slope;
        double at(double gear_rad) const { return at_0_rad + slope * gear_rad; }
    };
    Straight backlash() const {
        const double slope = (hi.backlash_rad - lo.backlash_rad) / width_rad();
        return {lo.backlash_rad - slope * lo.gear_rad, slope};
    }
};

inline constexpr int32_t block_nodes = 8; // a turn has a whole number of blocks

// Nodes that follow each other, found together: an axis that goes along needs them in turn. The block in
// which they lie decides how their sums are rounded, so that a node is the same whatever was asked for
// before.
struct NodeBlock {
    int32_t number = INT32_MIN; // its first node is number * block_nodes
    std::array<Node, block_nodes> nodes;

    // Node `index`, which lies at the output angle index 2 pi / nodes_per_turn. One block is for one gear.
    const Node &at(const Gear &gear, double gear_ratio, int32_t index) {
        if (index >> block_shift != number) load(gear, gear_ratio, index >> block_shift);
        return nodes[static_cast<size_t>(index & (block_nodes - 1))];
    }

  private:
    static constexpr int block_shift = 3;
    static_assert(1 << block_shift == block_nodes);
    void load(const Gear &gear, double gear_ratio, int32_t block);
};

// One node, and the cell from it to the next.
Node transmission_node(const Gear &gear, double gear_ratio, int32_t index);
Cell transmission_cell(const Gear &gear, double gear_ratio, int32_t index);

// Moves a cell of a gear to where it holds a gear angle. `block` is of the same gear.
void seek_gear(const Gear &gear, double gear_ratio, double gear_rad, Cell &cell, NodeBlock &block);
// The cell that holds an output angle.
Cell cell_of_output(const Gear &gear, double gear_ratio, double output_rad);

// T-: gear angle of an output angle, without outside torque.
double gear_of_output(const Cell &cell, double output_rad);
// The output angle of a gear angle, the inverse.
double output_of_gear(const Cell &cell, double gear_rad);

// The most that the output turns for a rad of the motor, in either contact, anywhere.
double output_per_motor(const Gear &gear, double gear_ratio);

// Everywhere rising in both contacts, and B never negative: nullptr, or what is wrong.
const char *transmission_fault(const Transmission &t, double gear_ratio);

} // namespace fl::twin
