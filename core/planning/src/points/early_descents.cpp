#include "points/early_descents.hpp"

#include "motion/motion.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

class EarlyDescents {
  public:
    EarlyDescents(PathSet &paths, const List<WayDown, PathIndex> &ways, EndOfPlan end, double need_mm)
        : paths_(paths), ways_(ways), end_(end), need_mm_(need_mm) {}

    // Whether the descent of a positioner may begin in a quarter, from these angles: if so, it sweeps that.
    bool take(PathIndex i, int begin, Angles above) {
        const Descent &descent = ways_[i].descent;
        if (descent.last_turn() > 0 || begin + end_.turn > end_.begin || !clear_of_ways_down(i)) return false;
        const Angles high = descent.above(0);
        const Knots alpha = leg(begin, above.alpha_rad, high.alpha_rad);
        const Knots beta = leg(begin, above.beta_rad, high.beta_rad);
        List<SweptArm> swept;
        const int first = (begin + 1) / quarters;
        for (int step = first; step <= paths_.steps(); ++step)
            swept.push_back(swept_at(i, alpha, beta, step));
        return paths_.retrace(i, first, swept);
    }

  private:
    Knots leg(int begin, double above_rad, double height_rad) const {
        return {{begin, above_rad}, {begin + end_.turn, above_rad - height_rad}};
    }

    // Others come down later, or earlier, past its goal.
    bool clear_of_ways_down(PathIndex i) const {
        const SweptArm &rest = ways_[i].legs.rest();
        const auto &near = paths_.at(i).neighbours;
        return std::all_of(near.begin(), near.end(), [&](PathIndex j) {
            const List<SweptArm> &legs = ways_[j].legs.all();
            return std::all_of(legs.begin(), legs.end(),
                               [&](const SweptArm &leg) { return stay_apart(rest, leg, need_mm_); });
        });
    }

    // Of the arm in a quarter of a step: a turn may be quicker than the moves of a path. A leg tells that of
    // a quarter of itself, and it grows with the square of the angle.
    double bulge_mm(PathIndex i) const {
        const double part = static_cast<double>(quarters) / end_.turn;
        return ways_[i].legs.at(0).bulge_mm * part * part;
    }

    SweptArm swept_at(PathIndex i, const Knots &alpha, const Knots &beta, int step) const {
        const Member &member = paths_.at(i);
        const int begin = quarters * step - 1; // what is sent in a step
        if (begin >= alpha.back().quarter) return ways_[i].legs.rest();
        Angles at[quarters + 1];
        for (int k = 0; k <= quarters; ++k) at[k] = {angle_at(alpha, begin + k), angle_at(beta, begin + k)};
        SweptArm swept = member.robot.swept(member.path.back(), at);
        swept.bulge_mm = std::max(swept.bulge_mm, bulge_mm(i));
        measure_displacement_bound(swept);
        return swept;
    }

    PathSet &paths_;
    const List<WayDown, PathIndex> &ways_;
    EndOfPlan end_;
    double need_mm_;
};

} // namespace

List<int, PathIndex> early_descents(PathSet &paths, const List<OwnKnots, PathIndex> &own,
                                    const List<WayDown, PathIndex> &ways, EndOfPlan end, double need_mm) {
    EarlyDescents early(paths, ways, end, need_mm);
    List<int, PathIndex> begins;
    for (const PathIndex i : paths.places()) {
        const Member &member = paths.at(i);
        const Cell last = member.path.back();
        Angles above{member.robot.alpha().angle(last.alpha), member.robot.beta().angle(last.beta)};
        int above_from = end_of_path(paths.arrival(i));
        if (!own[i].empty()) {
            above = {own[i].alpha.back().angle_rad, own[i].beta.back().angle_rad};
            above_from = std::max(own[i].alpha.back().quarter, own[i].beta.back().quarter);
        }
        const int begin = above_from + quarters;
        begins.push_back(!member.still && early.take(i, begin, above) ? begin : end.begin);
    }
    return begins;
}

} // namespace fl::planning
