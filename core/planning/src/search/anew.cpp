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
// A knot that grows: how many it may be, how many join it at once, repairs and work for one beginning, for
// all others to come back, and for the knot to the end.
constexpr int most_of_a_knot = 12, join_at_once = 2, repairs_of_a_return = 40, repairs_alone = 12;
constexpr std::int64_t work_of_a_beginning = 300000, work_of_a_return = 40000, work_of_growing = 800000;

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

// Those that conflict and are not of a knot, those with most conflicts first.
List<PathIndex> Repair::in_conflict(const List<PathIndex> &knot) const {
    List<PathIndex> out;
    for (const PathIndex i : paths_.places())
        if (!paths_.at(i).conflicts.empty() && !knot.contains(i)) out.push_back(i);
    std::stable_sort(out.begin(), out.end(), [&](PathIndex i, PathIndex j) {
        return paths_.at(i).conflicts.size() > paths_.at(j).conflicts.size();
    });
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

// A knot, all others absent: by halves, until that was in vain a few times.
void Repair::hurry_knot(const List<PathIndex> &knot, int wanted_steps) {
    for (int low = wanted_steps, failed = 0; failed <= most_failures;) {
        const PathIndex last = last_of(knot);
        const int arrival = paths_.arrival(last);
        if (arrival <= low) return;
        const int deadline = (low + arrival) / 2;
        if (squeeze(last, deadline, repairs_alone)) continue;
        low = deadline + 1;
        ++failed;
    }
}

// A knot, all others absent: whether its paths do not conflict, and all end before a step. Those that have
// joined it last begin anew; where that fails all of it does.
bool Repair::part_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, int step,
                        int wanted_steps) {
    for (const List<PathIndex> *some : {&joined, &knot}) {
        paths_.note_changes();
        for (const PathIndex i : knot) paths_.at(i).deadline = wanted_steps;
        last_steps_ = most_steps_;
        const bool apart = begin_anew(*some, 0, work_of_a_beginning);
        last_steps_ = 0;
        if (apart) hurry_knot(knot, wanted_steps);
        const bool done = apart && paths_.arrival(last_of(knot)) < step;
        paths_.end_changes(done);
        if (done) return true;
        if (joined.size() == knot.size() || enough()) return false;
    }
    return false;
}

// All others come back, and go round the knot, or it round them: whether none conflict then. If some do all
// is as before; rivals: those that conflict and are not of the knot.
bool Repair::fit_in(const List<PathIndex> &knot, const List<PathIndex> &others, List<PathIndex> &rivals) {
    paths_.note_changes();
    come_back(others);
    rivals = in_conflict(knot);
    bool done = rivals.empty();
    if (!done && knot.size() > 1) { // one alone has been tried
        most_work_ = work() + work_of_a_return;
        done = rounds(repairs_of_a_return);
        most_work_ = unlimited;
        if (const List<PathIndex> left = in_conflict(knot); !left.empty()) rivals = left;
    }
    paths_.end_changes(done);
    if (!done) leave(others);
    return done;
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
        allow_before(best);
        List<PathIndex> rivals;
        done = fit_in(knot, others, rivals);
        joined.clear();
        for (int k = 0; k < std::min(rivals.size(), join_at_once); ++k) joined.push_back(rivals[k]);
    }
    return done;
}

// The last one and its neighbours from nothing, with plenty of time, as when all began; then they hurry.
bool Repair::begin_among_all(PathIndex last, int wanted_steps) {
    const int best = paths_.arrival(last);
    const List<PathIndex> knot = knot_of(last);
    for (const PathIndex i : knot) paths_.at(i).deadline = wanted_steps;
    last_steps_ = most_steps_;
    const bool apart = begin_anew(knot, 0, work_of_a_knot);
    last_steps_ = 0;
    return apart && squeeze_changed(best);
}

// The knot of the last one from nothing, alone at first, or among all. It is kept if all arrive earlier than
// the last one did, else all is as before.
bool Repair::untie(PathIndex last, int wanted_steps, bool alone) {
    if (paths_.heeds_lateness()) return false;
    const int best = paths_.arrival(last), steps = paths_.steps();
    List<int, PathIndex> deadlines;
    for (const PathIndex i : paths_.places()) deadlines.push_back(paths_.at(i).deadline);
    allow_before(best);
    paths_.note_changes();
    pairs_by_flood_ = true;
    alone_ = alone;
    const bool done = alone ? grow_knot(last, wanted_steps) : begin_among_all(last, wanted_steps);
    alone_ = false;
    pairs_by_flood_ = false;
    paths_.end_changes(done);
    if (!done)
        for (const PathIndex i : paths_.places()) paths_.at(i).deadline = deadlines[i];
    if (paths_.steps() > steps) paths_.shorten();
    return done;
}

} // namespace fl::planning
