#include "points/fewer_points.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

// Of the points of an axis the approach takes so many at most, if it is not in several turns.
constexpr int for_approach = 3;
// So many at most are left out in a row: more would lead too far from the path.
constexpr int longest_run = 16;

// One axis along a path, by the lines on which it is at each step.
class AxisPath {
  public:
    AxisPath(const AxisGrid &grid, List<int> lines) : grid_(grid), lines_(std::move(lines)) {}

    Knots knots() const {
        Knots out{{0, grid_.angle(lines_[0])}};
        for (int step = 0; step < lines_.size(); ++step) {
            const VelocityChange change = change_at(step);
            if (grid_.straight(lines_[step], change)) continue;
            for (const int k : {1, 3})
                if (const int quarter = 4 * step + k - 1; quarter > 0)
                    out.push_back({quarter, grid_.angle(lines_[step], change, k)});
        }
        return out;
    }

  private:
    VelocityChange change_at(int step) const {
        const int here = lines_[step], before = lines_[std::max(step - 1, 0)],
                  after = lines_[std::min(step + 1, lines_.size() - 1)];
        return {before - here, after - here};
    }

    const AxisGrid &grid_;
    List<int> lines_;
};

Knots knots_of(const Member &member, const AxisGrid &grid, int Cell::*axis) {
    List<int> lines;
    for (const Cell c : member.path) lines.push_back(c.*axis);
    return AxisPath(grid, lines).knots();
}

// In rad per quarter, after the one before.
double slope(const Knots &knots, int k) {
    if (k == 0) return 0.0; // at rest
    const Knot &from = knots[k - 1], &to = knots[k];
    return (to.angle_rad - from.angle_rad) / (to.quarter - from.quarter);
}

// Of one positioner, both axes.
class Thinning {
  public:
    Thinning(PathSet &paths, PathIndex i, int most_knots, OwnKnots knots)
        : paths_(paths), i_(i), most_knots_(most_knots), member_(paths.at(i)), own_(std::move(knots)) {}

    // Whether any has been left out.
    bool run() {
        const bool alpha = thin(own_.alpha), beta = thin(own_.beta);
        return alpha || beta;
    }
    const OwnKnots &knots() const { return own_; }

  private:
    // Short runs first: they lead least far from the path. The last segment stays, as it leads to the
    // approach.
    bool thin(Knots &knots) {
        bool any = false;
        sharpest_ = 0.0;
        for (int k = 1; k < knots.size(); ++k)
            sharpest_ = std::max(sharpest_, std::abs(slope(knots, k) - slope(knots, k - 1)));
        for (int run = 1; run <= longest_run; ++run)
            for (int first = 1; knots.size() > most_knots_ && first + run < knots.size() - 1;)
                leave_out(knots, first, run) ? void(any = true) : void(++first);
        return any;
    }

    // Where the axis changes its speed nowhere by more than it did, and still keeps clear of all.
    bool leave_out(Knots &knots, int first, int run) {
        const Knots before = knots;
        knots.erase(knots.begin() + first, knots.begin() + first + run);
        const double here = slope(knots, first), most = sharpest_ * (1.0 + 1e-12);
        const bool soft = std::abs(here - slope(knots, first - 1)) <= most &&
                          std::abs(slope(knots, first + 1) - here) <= most;
        if (soft && clear(knots[first - 1].quarter / 4, knots[first].quarter / 4)) return true;
        knots = before;
        return false;
    }

    bool clear(int first_step, int last_step) {
        List<SweptArm> swept;
        for (int step = first_step; step <= last_step; ++step) swept.push_back(swept_at(step));
        return paths_.retrace(i_, first_step, swept);
    }

    SweptArm swept_at(int step) const {
        Angles at[quarters + 1];
        for (int k = 0; k <= quarters; ++k)
            at[k] = {angle_at(own_.alpha, 4 * step + k - 1), angle_at(own_.beta, 4 * step + k - 1)};
        return member_.robot.swept(member_.path[step], at);
    }

    PathSet &paths_;
    PathIndex i_;
    int most_knots_;
    const Member &member_;
    OwnKnots own_;
    double sharpest_ = 0.0; // change of speed of an axis on its path
};

OwnKnots knots_of(const Member &member) {
    return {knots_of(member, member.robot.alpha(), &Cell::alpha),
            knots_of(member, member.robot.beta(), &Cell::beta)};
}

} // namespace

void fewer_points(PathSet &paths, int most_points, const Enough &enough, List<OwnKnots, PathIndex> &own) {
    const int most = most_points - for_approach;
    for (const PathIndex i : paths.places()) {
        if (paths.at(i).still) continue;
        const OwnKnots knots = own[i].empty() ? knots_of(paths.at(i)) : own[i];
        if (std::max(knots.alpha.size(), knots.beta.size()) <= most || enough()) continue;
        if (Thinning thinning(paths, i, most, knots); thinning.run()) own[i] = thinning.knots();
    }
}

} // namespace fl::planning
