// Those that were given more time than they need arrive earlier, one after the other.
#include "search/repair.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

constexpr int hurry_rounds = 25;        // repairs for one that hurries; in the end ...
constexpr int rounds_per_step = 10;     // ... so many more for each step that it is behind the wish, and ...
constexpr int most_rounds_of_one = 265; // ... no more than these
// One that arrives later than the bound and a fifth of it needs another order of the arms rather than the
// same one sooner: it and some around it start again, in so many repairs each time.
constexpr int far_behind = 5, rounds_of_a_start = 12, starts_at_once = 12;
constexpr int most_halvings = 4; // it tries to be earlier by all that it is behind, or a half, a quarter, ...
constexpr int least_around = 2, most_around = 6; // of the neighbours near by, that start again with it
// What this may take, as Repair::work counts it: so much for each step that one is too late, up to a most;
// nothing where the plan has taken much already. A step less is found soon, or not. Of 500; of more
// positioners as much more.
constexpr std::int64_t work_per_step_behind = 300000, most_work_in_the_end = 1000000,
                       most_work_of_a_plan = 8000000, work_of_a_step_less = 100000, work_when_near = 60000;
constexpr int usual_robots = 500;
// The knot of one that is behind by more than a share of `far` grows from the last one alone: before all that
// if it is far too late, each time that all that was in vain, and so often in the end: then of a share that
// is smaller where there are more positioners, as there is more work for one knot.
constexpr int share_before_all = 10, share_in_the_end = 14, grows_in_the_end = 2;
constexpr std::int64_t most_work_of_growing = 4500000;
// What these take, in states that a search looks at.
constexpr int work_of_a_joint_state = 20, work_of_a_guide = 300, work_of_a_flood = 20000;
constexpr int most_hurries = 64; // attempts of one to arrive earlier in which others have to give way

} // namespace

PathIndex Repair::last_to_arrive() const {
    PathIndex last(0);
    for (const PathIndex i : paths_.places())
        if (paths_.arrival(i) > paths_.arrival(last)) last = i;
    return last;
}

// Those that were given more time in need may do with less of it. One at a time, the last to arrive: halves
// what it is above the wish, and where that fails what is above the middle. What one knot cannot do without
// costs the others nothing.
void Repair::hurry(int wanted_steps) {
    last_steps_ = 0; // none gets more time now
    joint_left_ = most_joint_nodes;
    attempts_ = {most_hurries + 4 * paths_.size(), most_hurries, 0, 0};
    const int bound = statistics_.bound_steps;
    const int far = std::max(wanted_steps, bound + bound / far_behind);
    List<int, PathIndex> low(paths_.size(), wanted_steps); // what each of them may hope for
    while (may_hurry()) {
        const PathIndex last = last_to_arrive();
        const int arrival = paths_.arrival(last);
        if (arrival <= wanted_steps) return;
        if (arrival > low[last]) {
            const int deadline = (low[last] + arrival) / 2;
            if (!hurry_by_half(last, deadline, arrival <= far)) low[last] = deadline + 1;
        } else {
            if (!earlier_in_the_end(last, wanted_steps, far)) return;
            // near enough, single steps come sooner than all halves between
            low[last] = 4 * arrival > 5 * far ? far : arrival > far ? paths_.arrival(last) : wanted_steps;
        }
    }
}

// By an earlier deadline. One that is near enough gets little work for that, and no joint searches: what
// succeeds does so soon.
bool Repair::hurry_by_half(PathIndex last, int deadline, bool near) {
    if (!near) return squeeze(last, deadline, hurry_rounds);
    most_work_ = work() + work_when_near;
    const int joint_left = std::exchange(joint_left_, 0);
    const bool done = squeeze(last, deadline, hurry_rounds);
    joint_left_ = joint_left;
    most_work_ = unlimited;
    return done;
}

// A step less, with more repairs.
bool Repair::squeeze_in_the_end(PathIndex last, int wanted_steps) {
    const int arrival = paths_.arrival(last), behind = arrival - wanted_steps;
    most_work_ = work() + work_of_a_step_less;
    const bool done =
        squeeze(last, arrival - 1, std::min(hurry_rounds + rounds_per_step * behind, most_rounds_of_one));
    most_work_ = unlimited;
    return done;
}

// Whether there is work left for one that is so many steps too late.
bool Repair::may_start_again(int behind) const {
    const std::int64_t most = std::min(work_per_step_behind * behind, most_work_in_the_end);
    return of_usual(attempts_.work_in_the_end) < most &&
           of_usual(work() - attempts_.work_of_growing) < most_work_of_a_plan;
}

// A knot that grows, if there is work left for it. Where that fails all goes on as if it had not been tried;
// but once more it is tried otherwise.
bool Repair::grow(PathIndex last, int far) {
    if (of_usual(attempts_.work_of_growing) >= most_work_of_growing || enough()) return false;
    const std::int64_t before = work();
    const int with_repairs = attempts_.with_repairs;
    std::swap(random_, growing_);
    const bool done = grow_alone(last, far);
    std::swap(random_, growing_);
    attempts_.with_repairs = with_repairs;
    attempts_.work_of_growing += work() - before;
    return done;
}

// Starts one after the other, by all that it is behind, or a half, a quarter, ...
bool Repair::start_some_again(PathIndex last, int behind, int far) {
    for (int k = 0; k < starts_at_once && may_start_again(behind) && !enough(); ++k) {
        const int less = std::max(1, behind >> random_.below(most_halvings));
        if (start_again(last, paths_.arrival(last) - less, far)) return true;
    }
    return false;
}

// The knot of one that is far too late grows. One that is far behind starts again in between, and its knot
// grows again, until it arrives earlier or too much has been done.
bool Repair::earlier_in_the_end(PathIndex last, int wanted_steps, int far) {
    const int behind = paths_.arrival(last) - far;
    if (share_before_all * behind > far && grow(last, far)) return true;
    do {
        const std::int64_t before = work();
        const bool done = start_some_again(last, behind, far) || squeeze_in_the_end(last, wanted_steps);
        attempts_.work_in_the_end += work() - before;
        if (done || (share_in_the_end * behind > far && grow(last, far))) return true;
    } while (may_start_again(behind) && !enough());
    for (int k = 0; k < grows_in_the_end && share_in_the_end * behind > of_usual(far); ++k)
        if (grow(last, far)) return true;
    return false;
}

// As much for as many as usual.
std::int64_t Repair::of_usual(std::int64_t of_all) const {
    return paths_.size() <= usual_robots ? of_all : of_all * usual_robots / paths_.size();
}

// What has been done, in states that are looked at: the same on each machine.
std::int64_t Repair::work() const {
    return search_.expansions() + work_of_a_joint_state * joint_.expansions() +
           work_of_a_guide * statistics_.searches + work_of_a_flood * floods_;
}

// One and some around it lose their paths and look for new ones, it by a deadline; all may come as late as
// `far`. All as before if that fails.
bool Repair::start_again(PathIndex last, int deadline, int far) {
    for (const PathIndex i : paths_.places()) {
        paths_.at(i).deadline = std::max(paths_.arrival(i), far);
        paths_.at(i).tries = paths_.at(i).joint_in_vain = 0;
    }
    paths_.shorten();
    const List<PathIndex> knot = some_around(last);
    paths_.at(last).deadline = deadline;
    paths_.note_changes();
    const Presence unplanned = random_.chance(50) ? Presence::absent : Presence::waiting;
    for (const PathIndex i : knot) paths_.forget(i, unplanned);
    const bool done = seek_anew(knot) && rounds(static_cast<int>(effort_ * rounds_of_a_start));
    paths_.end_changes(done);
    if (!done) paths_.at(last).deadline = paths_.arrival(last);
    return done;
}

// One and some of its neighbours near by, in an order of chance or the longest travel first.
List<PathIndex> Repair::some_around(PathIndex last) {
    List<PathIndex> knot{last};
    const auto &near = paths_.at(last).neighbours;
    if (near.empty()) return knot;
    for (int more = least_around + random_.below(most_around - least_around + 1); more > 0; --more) {
        const PathIndex pick = near[random_.below(std::min(near.size(), near_by))];
        if (!knot.contains(pick)) knot.push_back(pick);
    }
    order(knot);
    return knot;
}

// Paths one after the other, conflicts allowed. False if one of them has none in time.
bool Repair::seek_anew(const List<PathIndex> &knot) {
    for (const PathIndex i : knot) {
        Member &m = paths_.at(i);
        const Costs costs = random_.chance(50) ? random_costs(m.robot) : Costs{};
        Mode mode = random_mode(m.robot, m.deadline);
        mode.most_guided = 0;
        ++statistics_.searches;
        if (!paths_.seek(i, costs, any_cost, mode, search_)) return false;
        paths_.count_conflicts(i);
    }
    return true;
}

bool Repair::may_hurry() {
    return paths_.size() > 0 && attempts_.all-- > 0 && attempts_.with_repairs > 0 && !enough();
}

// One by an earlier deadline, and those in its way as late as they are, at most; all as before if that fails.
bool Repair::squeeze(PathIndex last, int deadline, int most_repairs) {
    const auto repairs = statistics_.repairs;
    for (const PathIndex i : paths_.places()) {
        paths_.at(i).deadline = std::min(paths_.at(i).deadline, std::max(paths_.arrival(i), deadline));
        paths_.at(i).tries = paths_.at(i).joint_in_vain = 0;
    }
    paths_.shorten();
    const int before = std::exchange(paths_.at(last).deadline, deadline);
    paths_.note_changes();
    ++statistics_.searches;
    bool done = paths_.seek(last, {}, any_cost, {}, search_);
    if (done) {
        paths_.count_conflicts(last);
        done = rounds(static_cast<int>(effort_ * most_repairs));
    }
    paths_.end_changes(done);
    if (!done) paths_.at(last).deadline = before;
    if (statistics_.repairs > repairs) --attempts_.with_repairs;
    return done;
}

} // namespace fl::planning
