// From paths that conflict to paths that do not: large-neighbourhood search over small groups of positioners.
#pragma once

#include "search/path_set.hpp"

#include <functional>

namespace fl::planning {

inline constexpr int any_cost = 1 << 25; // more than any path costs
// Nodes that all joint searches of a round look at, at most.
inline constexpr int most_joint_nodes = 500000;
inline constexpr int near_by = 8; // neighbours that may join a group, or get more time with it

class Repair {
  public:
    struct Manner {
        double share = 1.0;  // of the effort of the settings
        int begins_anew = 0; // so often in vain the knot of a pair that resists
        // Whether it is proven that two cannot both arrive.
        std::function<bool(PathIndex, PathIndex)> locked = [](PathIndex, PathIndex) { return false; };
    };
    Repair(PathSet &paths, const Settings &settings, Statistics &statistics, const Manner &manner)
        : paths_(paths), settings_(settings), statistics_(statistics),
          effort_(manner.share * settings.effort), begins_anew_(manner.begins_anew), lock_(manner.locked),
          random_(settings.seed), growing_(settings.seed + 1) {}

    // A path for every positioner, longest first, conflicts allowed where they cannot be avoided. Those that
    // have none, even alone: their grid at rest has a way that no motion with its turnings can follow.
    List<PathIndex> first_paths();
    // Replans groups until no two paths conflict (true), or until effort or deadline are used up.
    // first_steps: the first deadline; a pair that resists gets a part of it as more time, up to last_steps.
    bool run(int first_steps, int last_steps);
    // Two that cannot both arrive: repairs ended when they were found.
    struct Pair {
        PathIndex first, second;
    };
    const List<Pair> &locked() const { return locked_; }
    // Looks for paths that end earlier, down to this many steps.
    void hurry(int wanted_steps);
    // Replans each positioner alone for a shorter, straighter path without conflicts, where it is found soon.
    void tidy();
    std::int64_t expansions() const { return search_.expansions() + joint_.expansions(); }

  private:
    bool first_path(PathIndex i, int most);
    struct Group {
        List<PathIndex> members;
        List<SavedPath> before;
        int conflicts = 0;
    };

    List<PathIndex> longest_first() const;
    List<Pair> pairs() const;
    int tries(Pair pair) const;
    bool has_time(Pair pair) const;
    void round(Pair pair);
    void joint_round(Pair pair);
    int joint_in_vain(Pair pair) const;
    int joint_nodes(const List<PathIndex> &joint) const;
    List<PathIndex> choose_joint(Pair pair);
    bool shall_flood(const List<PathIndex> &joint);
    List<PathIndex> drawn_in(const List<PathIndex> &joint, Group &group);
    void set_joint(const List<PathIndex> &joint);
    void set_joint(const List<PathIndex> &joint, Group &group);
    PathIndex near_one_of(Pair pair, int among);
    int most_others(Pair pair) const;
    Group choose(Pair pair);
    void save(Group &group) const;
    int affordable(const Group &group) const;
    int touching(const Group &group) const;
    void forget_paths(const List<PathIndex> &members);
    Costs random_costs(const Robot &robot);
    Mode random_mode(const Robot &robot, int deadline);
    bool replan(const List<PathIndex> &members, int most_cost, int most_pairs);
    void take_back(Group &group);
    void judge_late(Pair pair);
    bool spare_around(PathIndex i);
    bool be_on_time(PathIndex i);
    void judge(Pair pair, const Group &group, int conflicts_now);
    bool may_hurry();
    bool squeeze(PathIndex last, int deadline, int most_repairs);
    bool hurry_by_half(PathIndex last, int deadline, bool near);
    bool squeeze_in_the_end(PathIndex last, int wanted_steps);
    bool start_some_again(PathIndex last, int behind, int far);
    bool may_start_again(int behind) const;
    bool earlier_in_the_end(PathIndex last, int wanted_steps, int far);
    bool start_again(PathIndex last, int deadline, int far);
    List<PathIndex> some_around(PathIndex last);
    bool seek_anew(const List<PathIndex> &knot);
    void order(List<PathIndex> &members);
    List<PathIndex> knot_of(PathIndex i);
    bool begin_anew(List<PathIndex> knot, int most_pairs, std::int64_t most_work);
    bool part(int most);
    bool part_anew();
    bool part_by_growing();
    bool grow(PathIndex last, int far);
    bool grow_alone(PathIndex last, int wanted_steps);
    // What a knot that grows shall come to.
    struct Growth {
        List<PathIndex> first;
        int step = 0;           // before which it shall end
        int wanted_steps = 0;   // its deadline at first
        int most_pairs = 0;     // fewer shall conflict in the end
        List<PathIndex> before; // conflicted before it grew, and are no matter of it
    };
    bool grow_knot(const Growth &wish);
    List<PathIndex> others_around(const List<PathIndex> &knot) const;
    void leave(const List<PathIndex> &others);
    void come_back(const List<PathIndex> &others);
    bool is_there(PathIndex i) const { return paths_.at(i).presence == Presence::path; }
    List<PathIndex> in_conflict(const List<PathIndex> &knot, const List<PathIndex> &but = {}) const;
    PathIndex last_of(const List<PathIndex> &some) const;
    void allow_before(int step);
    List<int, PathIndex> deadlines() const;
    void set_deadlines(const List<int, PathIndex> &deadlines);
    int steps_in_conflict(PathIndex i) const;
    bool part_in_time(const List<PathIndex> &knot, int step, int repairs);
    bool begin_alone(const List<PathIndex> &knot, const List<PathIndex> &some, int wanted_steps);
    void hurry_by_halves(const List<PathIndex> &knot, int wanted_steps, std::int64_t most_work);
    bool hurry_knot(const List<PathIndex> &knot, const Growth &wish, std::int64_t most_work);
    bool seek_two(const List<PathIndex> &two, int deadline);
    bool part_two_in_time(const List<PathIndex> &two, const Growth &wish);
    bool part_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, const Growth &wish);
    bool part_two_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, const Growth &wish);
    void go_round(const List<PathIndex> &knot);
    bool repair_return(const List<PathIndex> &knot, const Growth &wish);
    bool fit_in(const List<PathIndex> &knot, const List<PathIndex> &others, const Growth &wish,
                List<PathIndex> &rivals);
    bool fit_in_soon(const List<PathIndex> &knot, const List<PathIndex> &others, const Growth &wish,
                     List<PathIndex> &rivals);
    std::int64_t of_usual(std::int64_t of_all) const;
    std::int64_t work() const;
    PathIndex last_to_arrive() const;
    bool rounds(int most);
    void find_locked();
    bool enough();
    std::int64_t most_in_vain() const;
    int most_repairs_in_vain() const;
    void give_time(Pair pair);
    static int least_cost(const Robot &robot, const Costs &costs);
    void tidy_one(PathIndex i, const Costs &costs);
    void spare_corners();
    int path_cost(const Member &member, const Costs &costs) const;

    PathSet &paths_;
    const Settings &settings_;
    Statistics &statistics_;
    double effort_;
    int begins_anew_;
    std::function<bool(PathIndex, PathIndex)> lock_;
    List<Pair> locked_;
    Random random_, growing_; // of all; of knots that grow, so that what they tried in vain changes no more
    Search search_;
    JointSearch joint_;
    // Attempts of one to arrive earlier that are left: of all, and of those in which others have to give way;
    // and what has been done for those that are far behind.
    struct Attempts {
        int all = 0, with_repairs = 0;
        std::int64_t work_in_the_end = 0, work_of_growing = 0;
    } attempts_;
    int joint_left_ = 0; // nodes that joint searches may still look at
    std::int64_t floods_ = 0;
    int in_vain_ = 0; // repairs since fewer paths met
    static constexpr std::int64_t unlimited = std::int64_t{1} << 62;
    std::int64_t most_work_ = unlimited; // beyond which repairs end
    int vain_share_ = 1;                 // over this, repairs are made in vain
    // A knot grows: few are there, and joint searches are of two alone and keep to a flood where they can.
    bool alone_ = false;
    bool parts_two_ = false; // such a knot is one of two that resist, and not of the last to arrive
    int first_steps_ = 0;
    int last_steps_ = 0; // beyond which no deadline is set
    int most_steps_ = 0; // the same before any hurries
};

} // namespace fl::planning
