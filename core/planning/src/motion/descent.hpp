// How a positioner comes to its goal: from above, each axis in one of the turns with which a plan ends.
//
// All turns last equally long. As a rule every positioner comes down in the first one, both axes at once.
// Where that would touch, an axis may begin less high, or come down in a later turn.
#pragma once

#include "motion/robot.hpp"

namespace fl::planning {

inline Angles between(Angles p, Angles q, double part) {
    return {p.alpha_rad + part * (q.alpha_rad - p.alpha_rad), p.beta_rad + part * (q.beta_rad - p.beta_rad)};
}

struct Descent {
    Angles above; // the goal, by so much
    int alpha_turn = 0;
    int beta_turn = 0;
    int last_turn() const { return std::max(alpha_turn, beta_turn); }
    // How much of it is left when a turn begins.
    Angles left(int turn) const {
        return {alpha_turn < turn ? 0.0 : above.alpha_rad, beta_turn < turn ? 0.0 : above.beta_rad};
    }
    bool comes_down(int turn) const {
        return (alpha_turn == turn && above.alpha_rad > 0.0) || (beta_turn == turn && above.beta_rad > 0.0);
    }
    friend bool operator==(const Descent &p, const Descent &q) {
        return p.above.alpha_rad == q.above.alpha_rad && p.above.beta_rad == q.above.beta_rad &&
               p.alpha_turn == q.alpha_turn && p.beta_turn == q.beta_turn;
    }
};

// A descent that is not as usual, and what it costs: time of all above that of one positioner, and that above
// some of the height.
struct RatedDescent {
    Descent descent;
    int cost = 0;
};

// All descents that there are, the usual one first, then by their cost.
// @pre 0 <= least_rad <= usual_rad, turns >= 1.
List<RatedDescent> descents(double usual_rad, double least_rad, int turns);

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

  private:
    List<SweptArm> turns_; // none: it rests
    SweptArm rest_;
};

// Whether two positioners stay apart until both are at their goals.
bool stay_apart(const Legs &p, const Legs &q, double need_mm);

// A leg as a step: evenly from one height above the goal to another.
SweptArm approach_leg(const ArmBody &body, Angles goal, Angles from, Angles to);

} // namespace fl::planning
