// Which goals can be had: alone, beside each other, and past the bodies at rest; which must be given up.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/motion.hpp"
#include "motion/robot.hpp"

#include <optional>

namespace fl::planning {

// Where the positioners of one plan go. One that cannot move is an obstacle where it is.
class GoalFeasibility {
  public:
    GoalFeasibility(const Bodies &bodies, const Task &task, const Settings &settings, const Clock &clock);

    // Replaces goals until all of them can be held together, and each can be reached if no other positioner
    // moved.
    void settle();
    Places<PositionerIndex> places() const { return goals_.places(); }
    bool moves(PositionerIndex i) const { return !goals_[i].stuck; }
    bool still(PositionerIndex i) const { return goals_[i].still; }
    double approach(PositionerIndex i) const { return row(task_.approach_rad, i); }
    int steps_alone(PositionerIndex i) const { return goals_[i].steps_alone; }
    double need_mm() const { return need_mm_; }
    const std::vector<Refused> &refused() const { return refused_; }

    // The positioner on its grid, with all bodies at rest around it.
    Robot make_robot(PositionerIndex i) const;
    // Sends a positioner to a place that blocks no other; false if there is none it can reach.
    bool send_to_safe_place(PositionerIndex i, Refusal why, std::optional<PositionerIndex> other);
    // One for which the search has found no way, though it seemed to have one; again: it stays where it is.
    void has_no_way(PositionerIndex i);

  private:
    struct Goal {
        Angles angles;
        bool stuck = false;   // stays where it is whatever happens
        bool still = false;   // is at its goal and need not move
        bool settled = false; // the goal can be held
        bool gone = false;    // given up, new place not chosen yet: blocks no other
        int finer = 1;        // its grid is finer by this factor
        int steps_alone = 0;
    };
    // What is at rest in the way of a leg; no positioner: a fiducial or guide camera.
    struct Blocked {
        bool any = false;
        std::optional<PositionerIndex> by;
    };

    const Arm &arm(PositionerIndex i) const { return row(bodies_.arms, i); }
    Angles start(PositionerIndex i) const { return row(task_.start, i); }
    const List<PositionerIndex> &near(PositionerIndex i) const { return near_[i]; }
    double reach_mm(PositionerIndex i) const { return arm_body(bodies_, arm(i)).reach_mm(); }

    void find_near();
    void freeze_tangled();
    void freeze(PositionerIndex i);
    bool inside_travel(PositionerIndex i, Angles goal) const;
    SweptArm leg(PositionerIndex i, Angles goal, bool rests) const;
    AxisGrid grid(PositionerIndex i, double Angles::*axis, double step_rad) const;
    Blocked blocked(PositionerIndex i, const SweptArm &leg) const;
    bool legs_touch(PositionerIndex i, PositionerIndex j) const;
    bool legs_touch(PositionerIndex i, bool i_rests, PositionerIndex j, bool j_rests) const;
    bool settle_alone(PositionerIndex i);
    bool settle_each();
    bool settle_pairs();
    void wake_still(PositionerIndex i, PositionerIndex j);
    bool find_path_alone(PositionerIndex i);
    bool safe(PositionerIndex i, Angles place, bool rests) const;
    bool try_place(PositionerIndex i, Angles place, bool rests);
    List<Angles> folded_places(PositionerIndex i) const;

    const Bodies &bodies_;
    const Task &task_;
    const Settings &settings_;
    const Clock &clock_;
    double need_mm_;
    List<Goal, PositionerIndex> goals_;
    List<List<PositionerIndex>, PositionerIndex> near_;
    std::vector<Refused> refused_;
};

} // namespace fl::planning
