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
// A pair that resists begins anew after a part of the repairs that are otherwise made in vain.
constexpr int share_before_anew = 3;
// A knot that grows: how many it may be, how many join it at once, and work for it to the end.
constexpr int most_of_a_knot = 12, join_at_once = 2;
constexpr std::int64_t work_of_growing = 800000;
// Of it alone: how often it tries from the paths that they have, repairs and work for that, work where it
// begins anew, and to the end of its hurry; repairs of each attempt to be earlier, and how many of these may
// be in vain.
constexpr int times_from_here = 3, repairs_in_time = 60, repairs_in_the_end = 40, repairs_alone = 12,
              most_failures = 2;
constexpr std::int64_t work_in_time = 200000, work_of_a_beginning = 300000, work_alone = 400000;
// For all others to come back: how often those go round that are in the way, beyond how many pairs more are
// of no use, repairs and work.
constexpr int times_round = 2, most_pairs_of_a_return = 3, repairs_of_a_return = 40;
constexpr std::int64_t work_of_a_return = 80000;

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
bool Repair::begin_anew(List<PathIndex> knot, int most_pairs, std::int64_t most_work) {
    order(knot);
    for (const PathIndex i : knot) paths_.forget(i, Presence::waiting);
    const int others = std::max(0, joint_left_ - joint_nodes_of_a_knot);
    joint_left_ -= others;
    most_work_ = work() + most_work;
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
    const bool done = begin_anew(knot, all.size(), work_of_a_knot);
    paths_.end_changes(done);
    return done;
}

// All others that move and that the knot can meet.
List<PathIndex> Repair::others_around(const List<PathIndex> &knot) const {
    List<PathIndex> others;
    for (const PathIndex i : knot)
        for (const PathIndex j : paths_.at(i).neighbours)
            if (!knot.contains(j) && !others.contains(j) && !paths_.at(j).still) others.push_back(j);
    return others;
}

// From now on these are as if they were not there, until they come back.
void Repair::leave(const List<PathIndex> &others) {
    for (const PathIndex i : others) {
        paths_.forget(i, Presence::absent);
        paths_.count_conflicts(i);
    }
}

void Repair::come_back(const List<PathIndex> &others) {
    for (const PathIndex i : others) paths_.at(i).presence = Presence::path;
    for (const PathIndex i : others) paths_.count_conflicts(i);
}

int Repair::steps_in_conflict(PathIndex i) const {
    int sum = 0;
    for (const PathConflict &c : paths_.at(i).conflicts) sum += c.steps;
    return sum;
}

// Those that conflict and are not of a knot, those that do for most steps first.
List<PathIndex> Repair::in_conflict(const List<PathIndex> &knot) const {
    List<PathIndex> out;
    for (const PathIndex i : paths_.places())
        if (!paths_.at(i).conflicts.empty() && !knot.contains(i)) out.push_back(i);
    std::stable_sort(out.begin(), out.end(),
                     [&](PathIndex i, PathIndex j) { return steps_in_conflict(i) > steps_in_conflict(j); });
    return out;
}

PathIndex Repair::last_of(const List<PathIndex> &some) const {
    return *std::max_element(some.begin(), some.end(),
                             [&](PathIndex p, PathIndex q) { return paths_.arrival(p) < paths_.arrival(q); });
}

// All may arrive as late as before a step, those that are later as late as they are.
void Repair::allow_before(int step) {
    for (const PathIndex i : paths_.places()) {
        Member &m = paths_.at(i);
        m.deadline = std::max(m.arrival, step - 1);
        m.tries = m.joint_in_vain = 0;
    }
}

// A knot, all others absent: those that are late look for paths before a step, then repairs. Whether none
// conflict.
bool Repair::part_in_time(const List<PathIndex> &knot, int step, int repairs) {
    for (const PathIndex i : knot) {
        paths_.at(i).deadline = step - 1;
        paths_.at(i).tries = paths_.at(i).joint_in_vain = 0;
    }
    for (const PathIndex i : knot) {
        if (paths_.arrival(i) < step) continue;
        ++statistics_.searches;
        if (!paths_.seek(i, {}, any_cost, {}, search_)) return false;
        paths_.count_conflicts(i);
    }
    most_work_ = work() + work_in_time;
    const bool done = rounds(repairs);
    most_work_ = unlimited;
    return done;
}

// A knot, all others absent: some of it begin anew, with plenty of time. Whether none conflict.
bool Repair::begin_alone(const List<PathIndex> &knot, const List<PathIndex> &some, int wanted_steps) {
    for (const PathIndex i : knot) paths_.at(i).deadline = wanted_steps;
    last_steps_ = most_steps_;
    const bool apart = begin_anew(some, 0, work_of_a_beginning);
    last_steps_ = 0;
    return apart;
}

// A knot, all others absent: by halves, until that was in vain a few times; then by what is left to a step.
// Whether all end before it.
bool Repair::hurry_knot(const List<PathIndex> &knot, int step, int wanted_steps, std::int64_t most_work) {
    for (int low = wanted_steps, failed = 0; failed <= most_failures && work() < most_work;) {
        const PathIndex last = last_of(knot);
        const int arrival = paths_.arrival(last);
        if (arrival <= low) break;
        const int deadline = (low + arrival) / 2;
        if (squeeze(last, deadline, repairs_alone)) continue;
        low = deadline + 1;
        ++failed;
    }
    if (paths_.arrival(last_of(knot)) < step) return true;
    paths_.note_changes();
    const bool done = part_in_time(knot, step, repairs_in_the_end);
    paths_.end_changes(done);
    return done;
}

// A knot, all others absent: whether its paths do not conflict, and all end before a step. It tries that a
// few times from the paths that they have, which is soon seen; then those that have joined it last, or all,
// begin anew.
bool Repair::part_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, int step,
                        int wanted_steps) {
    const int from_here = knot.size() == 1 ? 0 : times_from_here;
    for (int k = 0; k <= from_here && (k == 0 || !enough()); ++k) {
        const std::int64_t most_work = work() + work_alone;
        paths_.note_changes();
        const bool apart = k < from_here
                               ? part_in_time(knot, step, repairs_in_time)
                               : begin_alone(knot, random_.chance(50) ? joined : knot, wanted_steps);
        const bool done = apart && hurry_knot(knot, step, wanted_steps, most_work);
        paths_.end_changes(done);
        if (done) return true;
    }
    return false;
}

// Those that conflict and are not of a knot look for other paths, one after the other.
void Repair::go_round(const List<PathIndex> &knot) {
    for (int k = 0; k < times_round; ++k)
        for (const PathIndex i : in_conflict(knot)) {
            if (paths_.at(i).still) continue;
            ++statistics_.searches;
            if (paths_.seek(i, {}, any_cost, {}, search_)) paths_.count_conflicts(i);
        }
}

// Whether none conflict once those in the way have gone round, and what still meets is repaired.
bool Repair::repair_return(const List<PathIndex> &knot) {
    go_round(knot);
    if (paths_.conflicts() > most_pairs_of_a_return) return false;
    most_work_ = work() + work_of_a_return;
    const bool done = rounds(repairs_of_a_return);
    most_work_ = unlimited;
    return done;
}

// All others come back, and go round the knot, or it round them, all before a step: whether none conflict
// then. If some do all is as before; rivals: those that conflict and are not of the knot.
bool Repair::fit_in(int step, const List<PathIndex> &knot, const List<PathIndex> &others,
                    List<PathIndex> &rivals) {
    allow_before(step);
    paths_.note_changes();
    come_back(others);
    rivals = in_conflict(knot);
    bool done = rivals.empty();
    if (!done && knot.size() > 1) { // one alone has been tried
        done = repair_return(knot);
        if (const List<PathIndex> left = in_conflict(knot); !left.empty()) rivals = left;
    }
    paths_.end_changes(done);
    if (!done) leave(others);
    return done;
}

// The same half-way to what the knot takes alone, else before the last one arrives now.
bool Repair::fit_in_soon(int best, int wanted_steps, const List<PathIndex> &knot,
                         const List<PathIndex> &others, List<PathIndex> &rivals) {
    const int soon = (std::max(paths_.arrival(last_of(knot)), wanted_steps) + best) / 2 + 1;
    if (knot.size() > 1 && soon < best && fit_in(soon, knot, others, rivals)) return true;
    return fit_in(best, knot, others, rivals);
}

// The last one alone, then with those that it meets and past which it finds no way, and so on, until all
// others fit in. Few are soon parted; among all their neighbours at once they seldom are.
bool Repair::grow_knot(PathIndex last, int wanted_steps) {
    const int best = paths_.arrival(last);
    const std::int64_t most_work = work() + work_of_growing;
    List<PathIndex> knot, joined{last};
    bool done = false;
    while (!joined.empty() && !done && work() < most_work && !enough()) {
        come_back(joined);
        knot.insert(knot.end(), joined.begin(), joined.end());
        const List<PathIndex> others = others_around(knot);
        leave(others);
        if (knot.size() > most_of_a_knot || !part_alone(knot, joined, best, wanted_steps)) break;
        List<PathIndex> rivals;
        done = fit_in_soon(best, wanted_steps, knot, others, rivals);
        joined.clear();
        for (int k = 0; k < std::min(rivals.size(), join_at_once); ++k) joined.push_back(rivals[k]);
    }
    return done;
}

// The knot of the last one from nothing, alone at first. It is kept if all arrive earlier than the last one
// did, else all is as before.
bool Repair::grow_alone(PathIndex last, int wanted_steps) {
    if (paths_.heeds_lateness()) return false;
    const int best = paths_.arrival(last), steps = paths_.steps();
    List<int, PathIndex> deadlines;
    for (const PathIndex i : paths_.places()) deadlines.push_back(paths_.at(i).deadline);
    allow_before(best);
    paths_.note_changes();
    alone_ = true;
    const bool done = grow_knot(last, wanted_steps);
    alone_ = false;
    paths_.end_changes(done);
    if (!done)
        for (const PathIndex i : paths_.places()) paths_.at(i).deadline = deadlines[i];
    if (paths_.steps() > steps) paths_.shorten();
    return done;
}

} // namespace fl::planning
