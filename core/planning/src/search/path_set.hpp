// All positioners that may move, their paths so far, and which of the paths conflict.
#pragma once

#include "search/joint.hpp"
#include "search/random.hpp"
#include "search/search.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {

// A lateness of so many steps: one stops for good.
inline constexpr int most_late_steps = 1 << 20;

// How others see a positioner whose path is being sought anew.
enum class Presence {
    path,    // as its present path says
    absent,  // not at all
    waiting, // at its start for a while, absent, at its goal for a while: so that none plans through one
             // that cannot leave in time
};

// Two paths on which positioners touch, and in how many steps.
struct PathConflict {
    PathIndex other;
    int steps = 0;
    bool late = false; // only if one of the two is late
};

// Around all that an arm sweeps in a step.
struct Circle {
    Vec2 centre;
    double radius_mm = 0.0;
};

// One positioner of a path set.
struct Member {
    explicit Member(Robot r) : robot(std::move(r)) {}

    Robot robot;
    List<PathIndex> neighbours; // nearest first
    List<Cell> path;            // the cell at each step
    List<SweptArm> swept;       // the motion of each step, down to the first one of rest: see moving
    List<Circle> circles;       // around each of them
    int arrival = 0;            // the last step in which it moves
    List<PathConflict> conflicts;
    SweptArm at_start, at_goal;
    Presence presence = Presence::waiting;
    int cost = 1000;          // of touching it, per step
    bool by_quarters = false; // its steps are not those of the path: see sweep_otherwise
    bool still = false;       // rests at its goal from the beginning to the end, without an approach
    int deadline = 0;         // the step by which it must have arrived
    BlockedCells blocked, blocked_to_floods; // as a guide, and as a flood, sees them
    List<PathIndex> spared;                  // neighbours with which it is never late
    List<PathIndex> in_vain;                 // for each repair around a conflict of lateness alone: with whom
    int tries = 0;         // repairs around it since the last one that helped, or since it got more time
    int joint_in_vain = 0; // joint searches around it since the last repair that helped

    // Of a step, its place in `swept` and `circles`: after the last one it rests as in that.
    int moving(int step) const { return std::min(step, swept.size() - 1); }
};

// How a path is sought.
struct Mode {
    bool backward = false; // in time
    int hold = 0;          // steps for which it rests first
    int most_guided = 0;   // states that are looked at with a guide before it is given up; 0: no limit
    int unguided =
        100; // states that are looked at before a guide is made, which takes as long as some hundred
};

// What a repair may have to take back.
struct SavedPath {
    PathIndex index;
    List<Cell> path;
    List<SweptArm> swept;
    List<Circle> circles;
    List<PathConflict> conflicts;
    int arrival;
    bool still;
};

class PathSet {
  public:
    // late_steps: one may be late by so many steps, more than there are for any lateness.
    PathSet(double need_mm, int steps, int late_steps)
        : need_mm_(need_mm), steps_(steps), late_steps_(late_steps) {}
    // The last step in which a positioner moves.
    int arrival(PathIndex i) const { return at(i).arrival; }

    Member &at(PathIndex i) { return members_[i]; }
    const Member &at(PathIndex i) const { return members_[i]; }
    int size() const { return members_.size(); }
    Places<PathIndex> places() const { return members_.places(); }
    int steps() const { return steps_; }

    void add(Robot robot);
    void find_neighbours();
    // Gives a positioner more time; those that have arrived rest at the goal during steps added.
    void allow(PathIndex i, int deadline);
    // Ends with the last step that any of them may use; not while changes are noted.
    void shorten();

    // Seeks a path of one positioner among the others as they are now; false if there is none below give_up.
    bool seek(PathIndex i, const Costs &costs, int give_up, Mode mode, Search &search);
    // Seeks paths of two or three at once; sets none of them.
    bool seek_joint(const List<PathIndex> &group, bool backward, int most_nodes, JointSearch &search);
    // Whether a flood holds the lines that both can come to.
    bool can_flood(const List<PathIndex> &pair);
    // Two at once, by such a flood; no others are met. False if there is no way.
    bool seek_pair(const List<PathIndex> &pair, int most_nodes, JointSearch &search);
    void set_path(PathIndex i, const List<Cell> &path);
    // What it sweeps from a step on, if that keeps it clear of all; false, and as before, if not.
    bool retrace(PathIndex i, int first, const List<SweptArm> &swept);
    // In a step it sweeps what it sweeps at these angles at the borders of the quarters, near a cell,
    // whatever it meets then; its path goes through that cell. It may begin to move within a step: what is
    // kept in hand and what bulges then counts in those quarters alone in which it moves.
    void sweep_otherwise(PathIndex i, int step, Cell near, const Angles (&at)[quarters + 1]);
    // Whether it stays clear of all bodies at rest in a step.
    bool clear(PathIndex i, int step) const { return clear(at(i), at(i).swept[at(i).moving(step)]); }
    // Whether two come too near in a step.
    bool meet(PathIndex i, PathIndex j, int step) const { return meet(at(i), at(j), step); }
    void keep_still(PathIndex i);
    // From now on it has no path, and is seen so by others: absent or waiting.
    void forget(PathIndex i, Presence presence);
    // Gives it the path that it had in another set, if it has the same places and no body at rest in its way.
    void take_over(PathIndex i, const Member &before);
    // Gives back what floods and guides have used: as much as 128 MB, for a set of which the paths are kept
    // alone.
    void free_rooms();
    // Counts anew with which paths this one conflicts.
    void count_conflicts(PathIndex i);
    int conflicts() const; // pairs
    // Whether two conflict, but not if both are on time.
    bool only_late(PathIndex i, PathIndex j) const;
    // Whether any may be late.
    bool heeds_lateness() const { return late_steps_ > 0; }
    bool spared(PathIndex i, PathIndex j) const { return at(i).spared.contains(j); }
    // From now on both are taken to be on time where they meet. False if they are already.
    bool spare(PathIndex i, PathIndex j);
    // Spares the pairs for which no paths can be found because of their ends.
    void spare_hopeless();

    // From now on what changes is noted ...
    void note_changes();
    // ... until here; unless they are kept, all paths are as they were, with their conflicts. Between the two
    // changes may be noted once more.
    void end_changes(bool keep);
    // Those that have changed since changes are noted. @pre they are.
    List<PathIndex> changed() const;

    SavedPath save(PathIndex i) const;
    void restore(SavedPath saved);
    // Of a list that was saved at once, if nothing else has changed since: with their conflicts.
    void restore_all(List<SavedPath> &saved);

  private:
    void gather(PathIndex i, MovingObstacles &moving) const;
    // Whether it could not, or could, come near to what another one sweeps.
    bool beyond_reach(const Robot &robot, const Circle &them) const;
    bool within_reach(const Robot &robot, const SweptArm &them) const;
    void gather_one(const Member &me, int slot, MovingObstacles &moving) const;
    void gather_late(const Member &me, int slot, MovingObstacles &moving) const;
    void guide(Request &request, Member &member);
    JointRequest joint_request(const List<PathIndex> &group);
    bool flood(const List<PathIndex> &pair);
    void begin_flood(int which, Member &member);
    void extend(int steps);
    void set_steps(int steps);
    // Where others see it in a step.
    struct Seen {
        const SweptArm *swept = nullptr; // none: not at all
        Cell cell;
    };
    Seen seen_at(const Member &member, int step) const;
    // What it does at some steps, the legs at its goal included.
    struct Stay {
        const SweptArm *swept = nullptr;
        Cell cell;
        int first = 0, last = 0;
    };
    List<Stay> stays(const Member &member) const;
    void add_legs(const Member &member, List<Stay> &out) const;
    int late_steps(const Member &member, PathIndex other) const {
        return member.spared.contains(other) ? 0 : std::min(late_steps_, steps_);
    }
    bool hopeless(const Member &p, const Member &q) const;
    int late_in_conflict(const Member &p, const Member &q) const;
    void forget_conflicts(PathIndex i);
    void note(PathIndex i);
    void note_before(List<SavedPath> &last);
    void fit(Member &m) const;
    void rest_after(Member &m, int step) const;
    Circle circle_of(const SweptArm &swept) const;
    // Whether they come too near.
    static bool circles_touch(const Circle &p, const Circle &q) {
        const Vec2 gap = p.centre - q.centre;
        const double touch = p.radius_mm + q.radius_mm;
        return dot(gap, gap) < touch * touch;
    }
    bool clear(const Member &m, const SweptArm &swept) const;
    bool meet(const Member &p, const Member &q, int step) const {
        return circles_touch(p.circles[p.moving(step)], q.circles[q.moving(step)]) &&
               meet_within_circles(p, q, step);
    }
    bool meet_within_circles(const Member &p, const Member &q, int step) const;
    int steps_in_conflict(const Member &p, const Member &q) const;

    double need_mm_;
    int steps_;
    int late_steps_;
    List<Member, PathIndex> members_;
    List<List<SavedPath>> noted_; // those that have changed, as they were; the last one since the last call
    MovingObstacles moving_;
    CostToGo guide_;
    TouchTables tables_;
    PairFlood flood_;
    MovingObstacles joint_moving_[JointSearch::most];
};

} // namespace fl::planning
