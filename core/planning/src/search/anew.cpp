// Knots that begin anew. Which arm passes which is decided early, and repairs seldom change it: where that
// leads nowhere, all of a knot lose their paths and find others, as if nothing had been done.
#include "search/repair.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

// What one beginning takes at most: repairs, work as Repair::work counts it, nodes of joint searches.
constexpr int repairs_of_a_knot = 300, joint_nodes_of_a_knot = 20000;
constexpr std::int64_t work_of_a_knot = 700000;
constexpr int repairs_of_a_squeeze = 25;
constexpr int most_failures = 2; // of squeezes one after the other, before this order of the arms is given up
// A pair that resists begins anew after a part of the repairs that are otherwise made in vain.
constexpr int share_before_anew = 3;

} // namespace

// One and its nearest neighbours; now and then those of the neighbour that arrives last, too.
List<PathIndex> Repair::knot_of(PathIndex i) {
    List<PathIndex> knot{i};
    const auto add_around = [&](PathIndex middle) {
        const auto &near = paths_.at(middle).neighbours;
        for (int k = 0; k < std::min(near.size(), near_by); ++k)
            if (!knot.contains(near[k])) knot.push_back(near[k]);
    };
    add_around(i);
    if (knot.size() > 1 && random_.chance(50))
        add_around(*std::max_element(knot.begin() + 1, knot.end(), [&](PathIndex p, PathIndex q) {
            return paths_.arrival(p) < paths_.arrival(q);
        }));
    knot.erase_if([&](PathIndex member) { return paths_.at(member).still; });
    return knot;
}

// All of a knot from nothing, by the first deadline that allows each a path; then repairs. Whether none of
// all conflict then, or fewer pairs than `most_pairs`.
bool Repair::begin_anew(List<PathIndex> knot, int most_pairs) {
    order(knot);
    for (const PathIndex i : knot) paths_.forget(i, Presence::waiting);
    const int others = std::max(0, joint_left_ - joint_nodes_of_a_knot);
    joint_left_ -= others;
    most_work_ = work() + work_of_a_knot;
    const bool all = std::all_of(knot.begin(), knot.end(), [&](PathIndex i) {
        if (!first_path(i, most_steps_)) return false;
        paths_.count_conflicts(i);
        return true;
    });
    const bool done = all && (rounds(repairs_of_a_knot) || paths_.conflicts() < most_pairs);
    most_work_ = unlimited;
    joint_left_ += others;
    return done;
}

// Repairs until no two conflict; where they come to a standstill, a knot in which two do begins anew.
bool Repair::part(int most) {
    if (begins_anew_ == 0 || paths_.heeds_lateness()) return rounds(most);
    for (int failed = 0;;) {
        vain_share_ = share_before_anew;
        const bool done = rounds(most);
        vain_share_ = 1;
        if (done || !locked_.empty() || failed == begins_anew_ || enough()) return done;
        failed = part_anew() ? 0 : failed + 1;
    }
}

// Whether fewer pairs conflict then; all as before if not.
bool Repair::part_anew() {
    const auto all = pairs();
    const Pair pair = all[random_.below(all.size())];
    List<PathIndex> knot = knot_of(pair.first);
    if (!knot.contains(pair.second) && !paths_.at(pair.second).still) knot.push_back(pair.second);
    paths_.note_changes();
    const bool done = begin_anew(knot, all.size());
    paths_.end_changes(done);
    return done;
}

// The last of those that have changed, if it arrives at a step or later.
PathIndex Repair::last_changed(int step) const {
    PathIndex last;
    for (const PathIndex i : paths_.changed())
        if (paths_.arrival(i) >= (last == PathIndex() ? step : paths_.arrival(last) + 1)) last = i;
    return last;
}

// Whether those that have changed come to arrive before a step, one after the other.
bool Repair::squeeze_changed(int step) {
    for (int failed = 0; failed <= most_failures;) {
        const PathIndex last = last_changed(step);
        if (last == PathIndex()) return true;
        const int deadline = failed == 0 ? step - 1 : (step - 1 + paths_.arrival(last)) / 2;
        failed = squeeze(last, deadline, repairs_of_a_squeeze) ? 0 : failed + 1;
    }
    return false;
}

// The knot of the last one from nothing, with plenty of time, as when all began; then they hurry. It is kept
// if they arrive earlier than the last one did, else all is as before.
bool Repair::untie(PathIndex last, int wanted_steps) {
    if (paths_.heeds_lateness()) return false;
    const int best = paths_.arrival(last), steps = paths_.steps();
    List<int, PathIndex> deadlines;
    for (const PathIndex i : paths_.places()) {
        Member &m = paths_.at(i);
        deadlines.push_back(m.deadline);
        m.deadline = std::max(m.arrival, best - 1);
        m.tries = m.joint_in_vain = 0;
    }
    const List<PathIndex> knot = knot_of(last);
    for (const PathIndex i : knot) paths_.at(i).deadline = wanted_steps;
    paths_.note_changes();
    last_steps_ = most_steps_;
    pairs_by_flood_ = true;
    const bool apart = begin_anew(knot, 0);
    last_steps_ = 0;
    const bool done = apart && squeeze_changed(best);
    pairs_by_flood_ = false;
    paths_.end_changes(done);
    if (!done)
        for (const PathIndex i : paths_.places()) paths_.at(i).deadline = deadlines[i];
    if (paths_.steps() > steps) paths_.shorten();
    return done;
}

} // namespace fl::planning
