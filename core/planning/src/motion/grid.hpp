// The search grid of one axis, and what the motion along it looks like in time.
//
// Lines are anchored at the start and at the place before the approach, and go on to the ends of the travel.
// In one step an axis stays on its line or goes to a neighbouring one. The plan's raw motion is straight
// between lines; what is sent (and tested) has its corners cut: straight from a quarter of a step before a
// line to a quarter of a step after it.
#pragma once

#include "motion/index.hpp"
#include "motion/trig.hpp"

#include <memory>

namespace fl::planning {

// Where the axis comes from and goes to around a line: the neighbouring lines below, this one, above.
struct VelocityChange {
    int from = 0; // -1, 0, 1: the line it was on a step before, seen from here
    int to = 0;   // -1, 0, 1: the line it will be on a step later
    bool reverses() const { return from != 0 && from == to; } // more than the acceleration allows
};

// What the lines of a grid are made from, rad.
struct GridSpan {
    double start_rad, goal_rad; // goal: the place before the approach
    double low_rad, high_rad;   // ends of the travel
    double zero_rad;            // added to the angles before their sine and cosine are taken
    int finer_at_ends = 1;      // so many times nearer to each other are lines that are ...
    double ends_rad = 0.0;      // ... so near to the start or the goal
    friend bool operator==(const GridSpan &, const GridSpan &) = default;
};

// Where lines are closer together than elsewhere: what is between two lines that reach into this range of
// angles is cut into so many parts. An end of the travel in the range gets a line however near the last one
// is (but for a remainder that a grid as fine as that everywhere would leave out).
struct FineLines {
    int parts = 1;
    double low_rad = 0.0, high_rad = 0.0;
    friend bool operator==(const FineLines &, const FineLines &) = default;
};

class AxisGrid {
  public:
    AxisGrid() = default;
    // Lines at most step_rad apart.
    AxisGrid(const GridSpan &span, double step_rad, const FineLines &fine = {});

    // How far the axis goes in a step at full speed.
    double step_rad() const { return step_rad_; }
    int size() const { return lines_->angles_rad.size(); }
    int start() const { return start_; }
    int goal() const { return goal_; }
    double angle(int line) const { return lines_->angles_rad[line]; }
    bool same_as(const AxisGrid &other) const;

    // The angle k quarters after mid-step minus two: at k = 2 the raw motion is on the line, and what is sent
    // is in the middle of the cut.
    double angle(int line, VelocityChange change, int k) const;
    const Turn &turn(int line, VelocityChange change, int k) const {
        return lines_->turns[line * slots + slot(change, k)];
    }
    const Turn &turn(int line) const { return lines_->turns[line * slots]; }
    Turn turn_at(double angle_rad) const { return fl::planning::turn(angle_rad + zero_rad_); }
    // Whether the axis keeps its speed at a line.
    bool straight(int line, VelocityChange change) const;

  private:
    // on the line; half and a quarter of the way to the line below, above; the three cut corners
    static constexpr int slots = 8;
    static int slot(VelocityChange change, int k) {
        constexpr int half[] = {1, 0, 2}, quarter[] = {3, 0, 4}, cut[] = {5, 5, 7, 5, 0, 6, 7, 6, 6};
        const int from = change.from + 1, to = change.to + 1;
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
    struct Lines {
        List<double> angles_rad;
        List<Turn> turns; // in each slot of each line
    };
    static double slot_angle(const List<double> &lines, int line, int slot);

    std::shared_ptr<const Lines> lines_ = std::make_shared<const Lines>(); // the same in all copies
    double zero_rad_ = 0.0, step_rad_ = 0.0;
    int start_ = 0;
    int goal_ = 0;
};

} // namespace fl::planning
