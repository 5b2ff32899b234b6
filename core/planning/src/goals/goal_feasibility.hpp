// Which goals can be had: alone, beside each other, and past the bodies at rest; which must be given up.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/descent.hpp"
#include "motion/robot.hpp"

#include <optional>

namespace fl::planning {

// Where the positioners of one plan go. One that cannot move is an obstacle where it is.
class GoalFeasibility {
    struct FineAxes {
        FineLines alpha, beta;
    };
    struct Goal {
        Angles angles;
        Descent descent;       // to the angles
        Legs legs;             // of the descent; of one that stays where it is: at rest
        bool stuck = false;    // stays where it is whatever happens
        bool still = false;    // is at its goal and need not move
        bool settled = false;  // the goal can be held
        bool gone = false;     // given up, new place not chosen yet: blocks no other
        int finer = 1;         // its grid is finer by this factor ...
        FineAxes fine;         // ... or only where it is narrow
        bool hastened = false; // whether that has been looked for
        int finer_at_ends = 1; // and by this one more around its start and its goal
        bool in_hand = true;   // on its way it keeps more than it needs
        bool tight = false;    // it may not: it would find no path past the others
        int steps_alone = 0;
    };

  public:
    // All that may change.
    struct State {
        List<Goal, PositionerIndex> goals;
        std::vector<Refused> refused;
    };
    State state() const { return {goals_, refused_}; }
    void go_back_to(const State &state) { goals_ = state.goals, refused_ = state.refused; }

    GoalFeasibility(const Bodies &bodies, const Task &task, const Settings &settings, const Clock &clock);

    // Replaces goals until all of them can be held together, and each can be reached if no other positioner
    // moved.
    void settle();
    Places<PositionerIndex> places() const { return goals_.places(); }
    bool moves(PositionerIndex i) const { return !goals_[i].stuck; }
    bool still(PositionerIndex i) const { return goals_[i].still; }
    // How a positioner comes to its goal, and whether not as all others do.
    const Descent &descent(PositionerIndex i) const { return goals_[i].descent; }
    const Legs &legs(PositionerIndex i) const { return goals_[i].legs; }
    bool descends_otherwise(PositionerIndex i) const { return !(descent(i) == usual(i)); }
    int steps_alone(PositionerIndex i) const { return goals_[i].steps_alone; }
    double need_mm() const { return need_mm_; }
    const std::vector<Refused> &refused() const { return refused_; }

    // The positioner on its grid, with all bodies at rest around it.
    Robot make_robot(PositionerIndex i);
    // Whether it is proven that two cannot both come to their goals, even if all others that move are absent.
    // Where neither is in a pocket of its own that would take too long, and is not looked at.
    bool lock_each_other(PositionerIndex i, PositionerIndex j);
    // Sends a positioner to a place that blocks no other; false if there is none it can reach. One that has
    // been refused before stays where it is.
    bool send_to_safe_place(PositionerIndex i, Refusal why, std::optional<PositionerIndex> other);
    // Gives up one of two that do not both arrive: the first, or the second if the first can go nowhere where
    // it blocks no other. If both cannot, the first.
    void give_up_one(PositionerIndex first, PositionerIndex second, Refusal why);
    // Sends one that does not arrive, and rests at its start or comes back to it, to another place in
    // which it is in the way of no more others; false, and as before, if it is not such a one or there is
    // none.
    bool go_elsewhere(PositionerIndex i);
    // Makes the grid of a positioner finer around its start and its goal; asked again, twice as fine
    // everywhere instead, and again. False, and as before, if no finer one has a way past what does not move.
    bool refine(PositionerIndex i);
    // One whose grid is finer everywhere moves at a part of its speed: gives it one that is finer only where
    // its way is narrow, if the way past what does not move then takes fewer steps.
    void hasten(PositionerIndex i);
    bool finer_at_ends(PositionerIndex i) const { return goals_[i].finer_at_ends > 1; }
    // From now on these and those around them keep nothing in hand; false: they have kept nothing.
    bool spend(const List<PositionerIndex> &tangled);
    // One for which the search has found no way, though it seemed to have one: it keeps nothing in hand;
    // again: it goes to a safe place; again: it stays where it is.
    void has_no_way(PositionerIndex i);

  private:
    // A grid as it was made last.
    struct KnownGrid {
        GridSpan span{};
        double step_rad = 0.0;
        FineLines fine;
        AxisGrid grid;
    };
    struct KnownGrids {
        KnownGrid alpha, beta;
    };
    // What is at rest in the way: a positioner that does not move, or an obstacle.
    struct Blocked {
        bool any = false;
        std::optional<PositionerIndex> by;
        int obstacle = -1;
    };
    // Descents that positioners may make while all others keep theirs.
    struct Open;

    const Arm &arm(PositionerIndex i) const { return row(bodies_.arms, i); }
    const ArmBody &body(PositionerIndex i) const { return arms_[i]; }
    Pace pace(PositionerIndex i) const { return pace_of(settings_, task_, i.value()); }
    double obstacle_need_mm(const Capsule &o) const {
        return arms_.radius_mm() + o.radius_mm + settings_.clearance_mm;
    }
    double step_rad(PositionerIndex i) const { return clock_.grid_rad(pace(i)) / goals_[i].finer; }
    Angles start(PositionerIndex i) const { return row(task_.start, i); }
    const List<PositionerIndex> &near(PositionerIndex i) const { return near_[i]; }
    bool away(PositionerIndex i) const { return goals_[i].stuck || goals_[i].gone; }
    const Limits &travel(PositionerIndex i) const { return travel_of(task_, i.value()); }
    Descent coming_from(const std::vector<double> &heights_rad, PositionerIndex i) const;
    Descent usual(PositionerIndex i) const;
    Descent lowest(PositionerIndex i) const;
    List<RatedDescent> descents_of(PositionerIndex i) const;

    void find_near();
    void freeze_tangled();
    void freeze(PositionerIndex i);
    bool is_refused(PositionerIndex i) const;
    void refuse(PositionerIndex i, Refusal why, const Blocked &by);
    bool move_away(PositionerIndex i, Refusal why, const Blocked &by);
    void set_goal(PositionerIndex i, Angles angles, const Descent &descent);
    bool inside_travel(PositionerIndex i, Angles place) const;
    bool inside_travel(PositionerIndex i, Angles place, const Descent &descent) const;
    const AxisGrid &grid(PositionerIndex i, double Angles::*axis, double step_rad);
    Blocked blocked(PositionerIndex i, const Legs &legs) const;
    Blocked blocked(PositionerIndex i, const SweptArm &leg) const;
    double bulge_mm(PositionerIndex i) const;
    bool apart(PositionerIndex i, const Legs &mine, PositionerIndex j, const Legs &theirs) const;
    bool legs_touch(PositionerIndex i, PositionerIndex j) const;
    bool settle_alone(PositionerIndex i);
    bool settle_each();
    bool settle_pairs();
    void wake_still(PositionerIndex i, PositionerIndex j);
    bool find_path_alone(PositionerIndex i);
    Robot without_hand(PositionerIndex i, int finer);
    static void make_finer(Goal &goal);
    bool spend_one(PositionerIndex i);
    bool safe(PositionerIndex i, const Legs &legs) const;
    bool try_place(PositionerIndex i, Angles place, bool rests);
    List<Angles> folded_places(PositionerIndex i) const;
    List<Angles> reachable_places(PositionerIndex i);
    void go_finely_in_a_pocket(PositionerIndex i);
    List<SweptArm> straight_way(PositionerIndex i) const;
    List<Angles> elsewhere(PositionerIndex i, const List<Angles> &places) const;
    bool make_way(PositionerIndex i);
    bool make_room(PositionerIndex i);

    // narrow_places.cpp
    static FineAxes narrow_part(const List<Cell> &way, const Robot &fine, Robot &wide, int parts);
    void try_fine(PositionerIndex i, const FineAxes &fine);

    // approaches.cpp
    bool find_descent(PositionerIndex i);
    bool give_up(PositionerIndex i);
    Refusal meeting(PositionerIndex i, PositionerIndex j) const;
    bool rearrange_some(const List<List<PositionerIndex>, PositionerIndex> &rivals);
    bool rearrange_with_blockers(const List<PositionerIndex> &group);
    bool rearrange(const List<PositionerIndex> &group);
    List<int> cheapest(const List<Open> &all) const;
    List<Open> open_all(const List<PositionerIndex> &group, bool alone);
    Open open(PositionerIndex i, const List<PositionerIndex> &group, bool alone);
    List<PositionerIndex> blockers(PositionerIndex i, const Legs &legs,
                                   const List<PositionerIndex> &group) const;
    void take(PositionerIndex i, const Descent &descent);
    void relax();

    const Bodies &bodies_;
    ArmBodies arms_;
    const Task &task_;
    const Settings &settings_;
    const Clock &clock_;
    double need_mm_;
    List<Goal, PositionerIndex> goals_;
    List<KnownGrids, PositionerIndex> grids_;
    List<List<PositionerIndex>, PositionerIndex> near_;
    std::vector<Refused> refused_;
    int rearranged_ = 0; // groups that have got new descents
};

} // namespace fl::planning
