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
// The knot of a pair that resists grows, or begins anew, each time after a part of the repairs that are
// otherwise made in vain. It grows where no more pairs resist, so often in vain before it begins anew.
constexpr int share_before_anew = 8, few_pairs = 3, grows_in_vain = 2;
// A knot that grows: how many it may be, how many join it at once, and work for it to the end.
constexpr int most_of_a_knot = 12, join_at_once = 2;
constexpr std::int64_t work_of_growing = 800000;
// Of it alone: how often it tries from the paths that they have, repairs and work for that, work where it
// begins anew, and to the end of its hurry; repairs of each attempt to be earlier, and how many of these may
// be in vain.
constexpr int times_from_here = 3, repairs_in_time = 60, repairs_in_the_end = 40, repairs_alone = 12,
              most_failures = 2;
constexpr std::int64_t work_in_time = 200000, work_of_a_beginning = 300000, work_alone = 400000;
constexpr int nodes_of_two = 32000; // of a search of two alone that keeps to a flood
// For all others to come back: how often those go round that are in the way, beyond how many pairs more are
// of no use, repairs and work.
constexpr int times_round = 2, most_pairs_of_a_return = 3, repairs_of_a_return = 40;
constexpr std::int64_t work_of_a_return = 80000;
// The same where it shall part two: then the others have time to go round it.
constexpr int repairs_of_a_part = 100;
constexpr std::int64_t work_of_a_return_in_time = 150000, work_of_parting = 1000000;

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

// Repairs until no two conflict; where they come to a standstill, a knot in which two do grows, or begins
// anew.
bool Repair::part(int most) {
    if (begins_anew_ == 0 || paths_.heeds_lateness()) return rounds(most);
    for (int grown = 0, anew = 0;;) {
        vain_share_ = share_before_anew;
        const bool done = rounds(most);
        vain_share_ = 1;
        if (done || !locked_.empty() || anew == begins_anew_ || enough()) return done;
        const bool grows = grown < grows_in_vain && paths_.conflicts() <= few_pairs;
        if (grows ? part_by_growing() : part_anew())
            grown = anew = 0;
        else
            ++(grows ? grown : anew);
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

// The same with a knot that grows from the two. Those that do not arrive earlier for it lose no time.
bool Repair::part_by_growing() {
    const auto all = pairs();
    const Pair pair = all[random_.below(all.size())];
    Growth wish{{}, most_steps_ + 1, first_steps_, all.size(), in_conflict({pair.first, pair.second})};
    for (const PathIndex i : {pair.first, pair.second})
        if (!paths_.at(i).still) wish.first.push_back(i);
    const auto before = deadlines();
    paths_.note_changes();
    alone_ = parts_two_ = true;
    const bool done = grow_knot(wish);
    alone_ = parts_two_ = false;
    paths_.end_changes(done);
    set_deadlines(before);
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

// Those that conflict and are not of a knot, those that do for most steps first, or with most others where it
// parts two; but not those of some that conflict with none of it.
List<PathIndex> Repair::in_conflict(const List<PathIndex> &knot, const List<PathIndex> &but) const {
    const auto met = [&](PathIndex i) {
        const auto &theirs = paths_.at(i).conflicts;
        return !theirs.empty() &&
               (!but.contains(i) || std::any_of(theirs.begin(), theirs.end(), [&](const PathConflict &c) {
                   return knot.contains(c.other);
               }));
    };
    List<PathIndex> out;
    for (const PathIndex i : paths_.places())
        if (!knot.contains(i) && met(i)) out.push_back(i);
    std::stable_sort(out.begin(), out.end(), [&](PathIndex i, PathIndex j) {
        if (parts_two_) return paths_.at(i).conflicts.size() > paths_.at(j).conflicts.size();
        return steps_in_conflict(i) > steps_in_conflict(j);
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

List<int, PathIndex> Repair::deadlines() const {
    List<int, PathIndex> out;
    for (const PathIndex i : paths_.places()) out.push_back(paths_.at(i).deadline);
    return out;
}

// As they were; those that arrive later may be as late as they are.
void Repair::set_deadlines(const List<int, PathIndex> &deadlines) {
    for (const PathIndex i : paths_.places())
        paths_.at(i).deadline = std::max(deadlines[i], paths_.arrival(i));
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

// A knot, all others absent: by halves, until that was in vain a few times, or has taken enough.
void Repair::hurry_by_halves(const List<PathIndex> &knot, int wanted_steps, std::int64_t most_work) {
    for (int low = wanted_steps, failed = 0; failed <= most_failures && work() < most_work;) {
        const PathIndex last = last_of(knot);
        const int arrival = paths_.arrival(last);
        if (arrival <= low) return;
        const int deadline = (low + arrival) / 2;
        if (squeeze(last, deadline, repairs_alone)) continue;
        low = deadline + 1;
        ++failed;
    }
}

// The same, and where that is too late by what is left to a step. Whether all end before it.
bool Repair::hurry_knot(const List<PathIndex> &knot, const Growth &wish, std::int64_t most_work) {
    hurry_by_halves(knot, wish.wanted_steps, most_work);
    if (paths_.arrival(last_of(knot)) < wish.step) return true;
    paths_.note_changes();
    const bool done = part_in_time(knot, wish.step, repairs_in_the_end);
    paths_.end_changes(done);
    return done;
}

// Two of which a flood shows the ways, all others absent: whether they have paths by a deadline.
bool Repair::seek_two(const List<PathIndex> &two, int deadline) {
    for (const PathIndex i : two) paths_.at(i).deadline = deadline;
    ++floods_;
    if (!paths_.seek_pair(two, nodes_of_two, joint_)) return false;
    set_joint(two);
    return true;
}

// The same before a step: as early as is wished for, or as repairs then come to. To part them repairs would
// only ask for the same ways again.
bool Repair::part_two_in_time(const List<PathIndex> &two, const Growth &wish) {
    if (wish.wanted_steps < wish.step - 1 && seek_two(two, wish.wanted_steps)) return true;
    if (!seek_two(two, wish.step - 1)) return false;
    hurry_by_halves(two, wish.wanted_steps, work() + work_alone);
    return true;
}

// A knot, all others absent: whether its paths do not conflict, and all end before a step. It tries that a
// few times from the paths that they have, which is soon seen; then those that have joined it last, or all,
// begin anew.
bool Repair::part_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, const Growth &wish) {
    if (knot.size() == 2 && paths_.can_flood(knot)) return part_two_in_time(knot, wish);
    const int from_here = knot.size() == 1 ? 0 : times_from_here;
    for (int k = 0; k <= from_here && (k == 0 || !enough()); ++k) {
        const std::int64_t most_work = work() + work_alone;
        paths_.note_changes();
        const bool apart = k < from_here
                               ? part_in_time(knot, wish.step, repairs_in_time)
                               : begin_alone(knot, random_.chance(50) ? joined : knot, wish.wanted_steps);
        const bool done = apart && hurry_knot(knot, wish, most_work);
        paths_.end_changes(done);
        if (done) return true;
    }
    return false;
}

// The same where it parts two. Those that have joined it last begin anew; where that fails all of it does.
bool Repair::part_two_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, const Growth &wish) {
    for (const List<PathIndex> *some : {&joined, &knot}) {
        paths_.note_changes();
        const int last_steps = last_steps_;
        const bool apart = begin_alone(knot, *some, wish.wanted_steps);
        const auto before = deadlines();
        if (apart) hurry_by_halves(knot, wish.wanted_steps, work() + work_of_a_beginning);
        last_steps_ = last_steps;
        set_deadlines(before);
        const bool done = apart && paths_.arrival(last_of(knot)) < wish.step;
        paths_.end_changes(done);
        if (done) return true;
        if (joined.size() == knot.size() || enough()) return false;
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

// Whether few enough conflict once those in the way have gone round, and what still meets is repaired; where
// it parts two, by repairs alone.
bool Repair::repair_return(const List<PathIndex> &knot, const Growth &wish) {
    if (!parts_two_) {
        go_round(knot);
        if (paths_.conflicts() > most_pairs_of_a_return) return false;
    }
    most_work_ = work() + (parts_two_ ? work_of_a_return_in_time : work_of_a_return);
    const bool none = rounds(parts_two_ ? repairs_of_a_part : repairs_of_a_return);
    most_work_ = unlimited;
    return none || paths_.conflicts() < wish.most_pairs;
}

// All others come back, and go round the knot, or it round them: whether few enough conflict then. If not all
// is as before; rivals: those that conflict and are not of the knot.
bool Repair::fit_in(const List<PathIndex> &knot, const List<PathIndex> &others, const Growth &wish,
                    List<PathIndex> &rivals) {
    paths_.note_changes();
    come_back(others);
    rivals = in_conflict(knot, wish.before);
    bool done = paths_.conflicts() < wish.most_pairs;
    if (!done && knot.size() > 1) { // one alone has been tried
        done = repair_return(knot, wish);
        if (const auto left = in_conflict(knot, wish.before); !left.empty()) rivals = left;
    }
    paths_.end_changes(done);
    if (!done) leave(others);
    return done;
}

// The same before the middle between what the knot takes alone and the step; else before the step.
bool Repair::fit_in_soon(const List<PathIndex> &knot, const List<PathIndex> &others, const Growth &wish,
                         List<PathIndex> &rivals) {
    const int soon = (std::max(paths_.arrival(last_of(knot)), wish.wanted_steps) + wish.step) / 2 + 1;
    if (knot.size() > 1 && soon < wish.step) {
        allow_before(soon);
        if (fit_in(knot, others, wish, rivals)) return true;
    }
    allow_before(wish.step);
    return fit_in(knot, others, wish, rivals);
}

// One or two alone, then with those that they meet and past which they find no way, and so on, until all
// others fit in. Few are soon parted; among all their neighbours at once they seldom are.
bool Repair::grow_knot(const Growth &wish) {
    const std::int64_t most_work = work() + (parts_two_ ? work_of_parting : work_of_growing);
    List<PathIndex> knot, joined = wish.first;
    bool done = false;
    while (!joined.empty() && !done && work() < most_work && !enough()) {
        come_back(joined);
        knot.insert(knot.end(), joined.begin(), joined.end());
        const List<PathIndex> others = others_around(knot);
        leave(others);
        if (knot.size() > most_of_a_knot) break;
        if (!(parts_two_ ? part_two_alone(knot, joined, wish) : part_alone(knot, joined, wish))) break;
        List<PathIndex> rivals;
        done = parts_two_ ? fit_in(knot, others, wish, rivals) : fit_in_soon(knot, others, wish, rivals);
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
    const auto before = deadlines();
    allow_before(best);
    paths_.note_changes();
    alone_ = true;
    const bool done = grow_knot({{last}, best, wanted_steps, 1, {}});
    alone_ = false;
    paths_.end_changes(done);
    if (!done) set_deadlines(before);
    if (paths_.steps() > steps) paths_.shorten();
    return done;
}

} // namespace fl::planning
