// The search grid of one axis, and what the motion along it looks like in time.
//
// Lines are anchored at the start and at the place before the approach, and go on to the ends of the travel.
// In one step an axis stays on its line or goes to a neighbouring one. The plan's raw motion is straight
// between lines; what is sent (and tested) has its corners cut over half a step:
// a moving average over a window of half a step, kept at quarter steps.
#pragma once

#include "trig.hpp"

#include <array>
#include <vector>

namespace fl::planning {

// Where the axis comes from and goes to around a line: the neighbouring lines below, this one, above.
struct Bend {
    int from = 0; // -1, 0, 1: the line it was on a step before, seen from here
    int to = 0;   // -1, 0, 1: the line it will be on a step later
    bool reverses() const { return from != 0 && from == to; } // more than the acceleration allows
};

class AxisGrid {
  public:
    AxisGrid() = default;
    // zero_rad is added to the angles before their sine and cosine are taken.
    AxisGrid(double start_rad, double goal_rad, double step_rad, double low_rad, double high_rad,
             double zero_rad);

    int size() const { return static_cast<int>(lines_.size()); }
    int start() const { return start_; }
    int goal() const { return goal_; }
    double angle(int line) const { return lines_[static_cast<size_t>(line)]; }

    // The angle k quarters after mid-step minus two: k = 2 is the moment the raw motion is on the line.
    double angle(int line, Bend bend, int k) const;
    const Turn &turn(int line, Bend bend, int k) const {
        return turns_[static_cast<size_t>(line) * slots + slot(bend, k)];
    }
    const Turn &turn(int line) const { return turns_[static_cast<size_t>(line) * slots]; }

  private:
    // on the line; half and a quarter of the way to the line below, above; the three cut corners
    static constexpr size_t slots = 8;
    static size_t slot(Bend bend, int k) {
        constexpr size_t half[] = {1, 0, 2}, quarter[] = {3, 0, 4}, cut[] = {5, 5, 7, 5, 0, 6, 7, 6, 6};
        const auto from = static_cast<size_t>(bend.from + 1), to = static_cast<size_t>(bend.to + 1);
        switch (k) {
        case 0:
            return half[from];
        case 1:
            return quarter[from];
        case 2:
            return cut[3 * from + to];
        case 3:
            return quarter[to];
        default:
            return half[to];
        }
    }
    double slot_angle(int line, size_t slot) const;

    std::vector<double> lines_;
    std::vector<Turn> turns_;
    int start_ = 0;
    int goal_ = 0;
};

} // namespace fl::planning
