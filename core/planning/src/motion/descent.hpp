// How a positioner comes to its goal: from above, each axis in one of the turns with which a plan ends.
//
// All turns last equally long. As a rule every positioner comes down in the first one, or earlier
// (points/early_descents.hpp), both axes at once.
// Where that would touch, an axis may begin less high, or come down in a later turn. Until then it waits
// above the goal, or at the goal: then it goes up in the turn before, when others are where they shall be.
#pragma once

#include "motion/robot.hpp"

namespace fl::planning {

inline Angles between(Angles p, Angles q, double part) {
    return {p.alpha_rad + part * (q.alpha_rad - p.alpha_rad), p.beta_rad + part * (q.beta_rad - p.beta_rad)};
}

struct AxisDescent {
    double height_rad = 0.0;
    int turn = 0;
    bool waits_at_goal = false; // only in a later turn than the first
    // How far above the goal the axis is when a turn begins.
    double above(int now) const {
        const bool high = now == turn || (now < turn && !waits_at_goal);
        return high ? height_rad : 0.0;
    }
    friend bool operator==(const AxisDescent &p, const AxisDescent &q) {
        return p.height_rad == q.height_rad && p.turn == q.turn && p.waits_at_goal == q.waits_at_goal;
    }
};

struct Descent {
    AxisDescent alpha, beta;
    int last_turn() const { return std::max(alpha.turn, beta.turn); }
    // How far above the goal the axes are when a turn begins.
    Angles above(int turn) const { return {alpha.above(turn), beta.above(turn)}; }
    bool moves(int turn) const {
        return alpha.above(turn) != alpha.above(turn + 1) || beta.above(turn) != beta.above(turn + 1);
    }
    friend bool operator==(const Descent &p, const Descent &q) {
        return p.alpha == q.alpha && p.beta == q.beta;
    }
};

// What there is to choose from. usual: as all others do; least: to this an approach may be shortened.
struct DescentRules {
    double usual_rad = 0.0;
    double least_rad = 0.0;
    int turns = 1;
    double highest_hook_rad = 0.0; // no axis goes up higher than this to come down at once
};

// A descent and what it costs: time of all above that of one positioner, and that above some of the height.
struct RatedDescent {
    Descent descent;
    int cost = 0;
};

// All descents that there are, the usual one first, then by their cost.
// @pre 0 <= least_rad <= usual_rad, turns >= 1.
List<RatedDescent> descents(const DescentRules &rules);

// A positioner's arm while the plan ends: one step for each turn until it rests at its goal.
class Legs {
  public:
    Legs() = default;
    // At rest all the time.
    Legs(const ArmBody &body, Angles rest);
    Legs(const ArmBody &body, Angles goal, const Descent &descent);

    int turns() const { return turns_.size(); }
    const SweptArm &at(int turn) const { return turn < turns_.size() ? turns_[turn] : rest_; }
    const SweptArm &rest() const { return rest_; }
    const List<SweptArm> &all() const { return turns_; } // none: it rests

  private:
    List<SweptArm> turns_; // none: it rests
    SweptArm rest_;
};

// Whether two positioners stay apart until both are at their goals.
bool stay_apart(const Legs &p, const Legs &q, double need_mm);

// A leg as a step: evenly from one height above the goal to another one.
SweptArm approach_leg(const ArmBody &body, Angles goal, Angles from, Angles to);

} // namespace fl::planning
