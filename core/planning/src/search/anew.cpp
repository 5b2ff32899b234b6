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
// The knot of a pair that resists grows, or begins anew, each time after a part of the repairs that are
// otherwise made in vain. It grows where no more pairs resist, so often in vain before it begins anew.
constexpr int share_before_anew = 6, few_pairs = 3, grows_in_vain = 2;
// A knot that grows: how many it may be, how many join it at once, repairs and work for one beginning, for
// all others to come back, and for the knot to the end.
constexpr int most_of_a_knot = 12, join_at_once = 2, repairs_of_a_return = 40, repairs_alone = 12;
constexpr std::int64_t work_of_a_beginning = 300000, work_of_a_return = 40000, work_of_growing = 800000;
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
    pairs_by_flood_ = alone_ = true;
    const bool done = grow_knot(wish);
    pairs_by_flood_ = alone_ = false;
    paths_.end_changes(done);
    set_deadlines(before);
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

// Those that conflict and are not of a knot, those with most conflicts first. But for some that conflict with
// none of it.
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

// A knot, all others absent: by halves, until that was in vain a few times, or has taken enough.
void Repair::hurry_knot(const List<PathIndex> &knot, int wanted_steps, std::int64_t most_work) {
    const std::int64_t before = work();
    for (int low = wanted_steps, failed = 0; failed <= most_failures && work() - before < most_work;) {
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
bool Repair::part_alone(const List<PathIndex> &knot, const List<PathIndex> &joined, const Growth &wish) {
    for (const List<PathIndex> *some : {&joined, &knot}) {
        paths_.note_changes();
        for (const PathIndex i : knot) paths_.at(i).deadline = wish.wanted_steps;
        const int last_steps = std::exchange(last_steps_, most_steps_);
        const bool apart = begin_anew(*some, 0, work_of_a_beginning);
        last_steps_ = 0;
        const auto before = deadlines();
        if (apart) hurry_knot(knot, wish.wanted_steps, last_steps > 0 ? work_of_a_beginning : unlimited);
        last_steps_ = last_steps;
        if (last_steps_ > 0) set_deadlines(before);
        const bool done = apart && paths_.arrival(last_of(knot)) < wish.step;
        paths_.end_changes(done);
        if (done) return true;
        if (joined.size() == knot.size() || enough()) return false;
    }
    return false;
}

// All others come back, and go round the knot, or it round them: whether few enough conflict then. If not all
// is as before; rivals: those that conflict and are not of the knot.
bool Repair::fit_in(const List<PathIndex> &knot, const List<PathIndex> &others, const Growth &wish,
                    List<PathIndex> &rivals) {
    const bool in_time = last_steps_ > 0;
    paths_.note_changes();
    come_back(others);
    rivals = in_conflict(knot, wish.before);
    bool done = paths_.conflicts() < wish.most_pairs;
    if (!done && knot.size() > 1) { // one alone has been tried
        most_work_ = work() + (in_time ? work_of_a_return_in_time : work_of_a_return);
        done =
            rounds(in_time ? repairs_of_a_part : repairs_of_a_return) || paths_.conflicts() < wish.most_pairs;
        most_work_ = unlimited;
        if (const auto left = in_conflict(knot, wish.before); !left.empty()) rivals = left;
    }
    paths_.end_changes(done);
    if (!done) leave(others);
    return done;
}

// One or two alone, then with those that they meet and past which they find no way, and so on, until all
// others fit in. Few are soon parted; among all their neighbours at once they seldom are.
bool Repair::grow_knot(const Growth &wish) {
    const bool in_time = last_steps_ > 0;
    const std::int64_t most_work = work() + (in_time ? work_of_parting : work_of_growing);
    List<PathIndex> knot, joined = wish.first;
    bool done = false;
    while (!joined.empty() && !done && work() < most_work && !enough()) {
        come_back(joined);
        knot.insert(knot.end(), joined.begin(), joined.end());
        const List<PathIndex> others = others_around(knot);
        leave(others);
        if (knot.size() > most_of_a_knot || !part_alone(knot, joined, wish)) break;
        if (!in_time) allow_before(wish.step);
        List<PathIndex> rivals;
        done = fit_in(knot, others, wish, rivals);
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
    const auto before = deadlines();
    allow_before(best);
    paths_.note_changes();
    pairs_by_flood_ = true;
    alone_ = alone;
    const bool done =
        alone ? grow_knot({{last}, best, wanted_steps, 1, {}}) : begin_among_all(last, wanted_steps);
    alone_ = false;
    pairs_by_flood_ = false;
    paths_.end_changes(done);
    if (!done) set_deadlines(before);
    if (paths_.steps() > steps) paths_.shorten();
    return done;
}

} // namespace fl::planning
