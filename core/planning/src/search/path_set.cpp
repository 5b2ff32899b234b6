#include "search/path_set.hpp"

#include "motion/near_pairs.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

// For so many steps a positioner without a path is taken to rest at its start, and at its goal. Longer makes
// the others wait for nothing, shorter lets them plan through one that cannot leave in time.
constexpr int waiting_steps = 8;

// The guide sees arms in mid-step alone, where they may be farther apart than at its ends: it keeps so much
// more between them. So it may find dear what is not; no path is given up for it unless so many times too
// dear.
constexpr double guide_margin_mm = 0.3;
constexpr int much_too_dear = 3;
// The same of a flood, for those for which a guide is too careful: they need what room there is.
constexpr double flood_margin_mm = 0.1;

VelocityChange change(int before, int here, int after) { return {before - here, after - here}; }

// The last step in which something moves on a path.
int last_move(const List<Cell> &path) {
    int step = path.size() - 1;
    while (step > 0 && path[step - 1] == path.back()) --step;
    return step;
}

VelocityChanges changes_at(const List<Cell> &path, int step) {
    const Cell here = path[step], before = path[std::max(step - 1, 0)],
               after = path[std::min(step + 1, path.size() - 1)];
    return {change(before.alpha, here.alpha, after.alpha), change(before.beta, here.beta, after.beta)};
}

} // namespace

void PathSet::add(Robot robot) {
    Member m(std::move(robot));
    m.at_start = m.robot.resting(m.robot.start());
    m.at_goal = m.robot.resting(m.robot.goal());
    m.deadline = steps_;
    members_.push_back(std::move(m));
}

void PathSet::find_neighbours() {
    List<Reach> reaches;
    for (const Member &m : members_)
        reaches.push_back({m.robot.centre(), m.robot.reach_mm() + m.robot.extra_mm()});
    List<List<std::pair<double, PathIndex>>, PathIndex> near(size());
    for (const NearPair &pair : near_pairs(reaches, need_mm_)) {
        near[PathIndex(pair.first)].emplace_back(pair.gap_mm, PathIndex(pair.second));
        near[PathIndex(pair.second)].emplace_back(pair.gap_mm, PathIndex(pair.first));
    }
    for (const PathIndex i : places()) {
        std::sort(near[i].begin(), near[i].end());
        at(i).neighbours.clear();
        for (const auto &[gap, j] : near[i]) at(i).neighbours.push_back(j);
    }
}

void PathSet::allow(PathIndex i, int deadline) {
    at(i).deadline = deadline;
    if (deadline > steps_) extend(deadline - steps_);
}

void PathSet::extend(int steps) { set_steps(steps_ + steps); }

void PathSet::shorten() {
    if (!noted_.empty()) return;
    int last = 0;
    for (const Member &m : members_) last = std::max({last, m.deadline, m.arrival});
    if (last < steps_) set_steps(last);
}

void PathSet::set_steps(int steps) {
    steps_ = steps;
    for (Member &m : members_)
        if (!m.path.empty()) fit(m);
}

// The path to all steps: the last one becomes one of many at rest, its second half was at rest already.
void PathSet::fit(Member &m) const {
    m.path.resize(steps_ + 1, m.path.back());
    if (m.swept.size() > steps_ + 1) {
        m.swept.resize(steps_ + 1);
        m.circles.resize(steps_ + 1);
    }
    rest_after(m, m.arrival);
}

// So that the step, and the first one after it, if there is one, have motions of their own.
void PathSet::rest_after(Member &m, int step) const {
    const int count = std::min(step + 2, steps_ + 1);
    if (m.swept.size() >= count) return;
    m.swept.resize(count, m.robot.resting(m.path.back()));
    m.circles.resize(count, circle_of(m.swept.back()));
}

void PathSet::set_path(PathIndex i, const List<Cell> &path) {
    note(i);
    Member &m = at(i);
    m.path = path;
    m.arrival = last_move(path);
    const int count = std::min(m.arrival + 2, path.size());
    m.swept.resize(count);
    m.circles.resize(count);
    for (int k = 0; k < count; ++k) {
        m.swept[k] = m.robot.swept(path[k], changes_at(path, k));
        measure_displacement_bound(m.swept[k]);
        m.circles[k] = circle_of(m.swept[k]);
    }
    m.presence = Presence::path;
}

bool PathSet::retrace(PathIndex i, int first, const List<SweptArm> &swept) {
    Member &m = at(i);
    if (!std::all_of(swept.begin(), swept.end(), [&](const SweptArm &s) { return clear(m, s); }))
        return false;
    SavedPath before = save(i);
    rest_after(m, first + swept.size() - 1);
    for (int k = 0; k < swept.size(); ++k) {
        m.swept[first + k] = swept[k];
        m.circles[first + k] = circle_of(swept[k]);
    }
    count_conflicts(i);
    if (m.conflicts.empty()) return true;
    restore(std::move(before));
    count_conflicts(i);
    return false;
}

void PathSet::sweep_otherwise(PathIndex i, int step, Cell near, const Angles (&at)[quarters + 1]) {
    Member &m = this->at(i);
    const bool rests = std::all_of(std::begin(at), std::end(at), [&](Angles a) {
        return a.alpha_rad == at[0].alpha_rad && a.beta_rad == at[0].beta_rad;
    });
    m.by_quarters = true;
    m.path[step] = near;
    rest_after(m, step);
    m.swept[step] = rests ? m.robot.resting(near) : m.robot.swept(near, at);
    m.circles[step] = circle_of(m.swept[step]);
}

bool PathSet::clear(const Member &m, const SweptArm &swept) const {
    if (m.robot.clear(swept)) return true;
    if (!m.by_quarters) return false;
    for (int k = 0; k < quarters; ++k)
        if (!m.robot.clear(quarter_of(swept, k))) return false;
    return true;
}

bool PathSet::meet_within_circles(const Member &p, const Member &q, int step) const {
    const SweptArm &one = p.swept[p.moving(step)], &other = q.swept[q.moving(step)];
    if (stay_apart(one, other, need_mm_)) return false;
    if (!p.by_quarters && !q.by_quarters) return true;
    for (int k = 0; k < quarters; ++k)
        if (!stay_apart(quarter_of(one, k), quarter_of(other, k), need_mm_)) return true;
    return false;
}

void PathSet::keep_still(PathIndex i) {
    set_path(i, List<Cell>(steps_ + 1, at(i).robot.start()));
    at(i).still = true;
}

void PathSet::forget(PathIndex i, Presence presence) {
    note(i);
    at(i).presence = presence;
}

void PathSet::take_over(PathIndex i, const Member &before) {
    Member &m = at(i);
    const bool has_one = before.presence == Presence::path && !before.path.empty();
    if (!has_one || before.still || m.still || !m.robot.same_grid(before.robot)) return;
    for (int k = 0; k < before.path.size(); ++k)
        if (!m.robot.clear(before.path[k], changes_at(before.path, k))) return;
    allow(i, std::max(m.deadline, before.deadline));
    if (before.path.size() > steps_ + 1) extend(before.path.size() - 1 - steps_);
    List<Cell> path = before.path;
    path.resize(steps_ + 1, path.back());
    set_path(i, path);
}

void PathSet::free_rooms() {
    flood_ = {};
    guide_ = {};
    tables_ = {};
    for (MovingObstacles &moving : joint_moving_) moving = {};
}

PathSet::Seen PathSet::seen_at(const Member &m, int step) const {
    if (m.presence == Presence::path) return {&m.swept[m.moving(step)], m.path[step]};
    if (m.presence == Presence::absent) return {};
    const int wait = std::clamp(m.deadline - m.robot.travel_steps(), 1, waiting_steps);
    if (step < wait) return {&m.at_start, m.robot.start()};
    if (step > m.deadline - wait) return {&m.at_goal, m.robot.goal()};
    return {};
}

// By the circles alone: if they are within reach of it, nothing else is said.
bool PathSet::beyond_reach(const Robot &robot, const Circle &them) const {
    const Vec2 to = them.centre - robot.centre();
    const double far = robot.reach_mm() + robot.extra_mm() + 0.5 * need_mm_ + them.radius_mm;
    return dot(to, to) > far * far;
}

bool PathSet::within_reach(const Robot &robot, const SweptArm &them) const {
    const double reach =
        robot.reach_mm() + robot.extra_mm() + need_mm_ + them.displacement_bound_mm + them.extra_mm;
    // the middle of the line tells most
    const Segment &line = them.at[2];
    const Vec2 to = middle(line.a, line.b) - robot.centre();
    const double squared = dot(to, to), far = reach + 0.5 * length(line.b - line.a);
    if (squared < reach * reach || squared >= far * far) return squared < reach * reach;
    return squared_distance(robot.centre(), line) < reach * reach;
}

void PathSet::gather_one(const Member &me, int slot, MovingObstacles &moving) const {
    const Member &them = at(me.neighbours[slot]);
    if (them.presence == Presence::absent) return;
    if (late_steps(me, me.neighbours[slot]) > 0) return gather_late(me, slot, moving);
    const bool has_path = them.presence == Presence::path;
    const int rests_from = has_path ? them.arrival + 1 : steps_;
    for (int step = 0; step <= std::min(rests_from, steps_); ++step) {
        if (has_path && beyond_reach(me.robot, them.circles[them.moving(step)])) continue;
        const Seen seen = seen_at(them, step);
        if (seen.swept == nullptr) continue;
        const int last = step == rests_from ? steps_ : step;
        if (within_reach(me.robot, *seen.swept))
            moving.add(slot, step, last, {seen.swept, them.cost, seen.cell});
    }
}

List<PathSet::Stay> PathSet::stays(const Member &m) const {
    List<Stay> out;
    for (int step = 0; step <= steps_; ++step) {
        const Seen seen = seen_at(m, step);
        if (seen.swept == nullptr) continue;
        const bool rests = seen.swept->displacement_bound_mm == 0.0;
        if (rests && !out.empty() && out.back().last == step - 1 && out.back().cell == seen.cell &&
            out.back().swept->displacement_bound_mm == 0.0)
            out.back().last = step;
        else
            out.push_back({seen.swept, seen.cell, step, step});
    }
    add_legs(m, out);
    return out;
}

// They come after the last step of all, so that the step after its own last one is early enough.
void PathSet::add_legs(const Member &m, List<Stay> &out) const {
    if (m.still || m.presence == Presence::absent) return;
    const int last = m.presence == Presence::path ? m.arrival : m.deadline;
    const int first = std::min(last + 1, steps_);
    for (const SweptArm &leg : m.robot.legs()) out.push_back({&leg, m.robot.goal(), first, steps_});
}

void PathSet::gather_late(const Member &me, int slot, MovingObstacles &moving) const {
    const Member &them = at(me.neighbours[slot]);
    const int late = late_steps(me, me.neighbours[slot]);
    for (const Stay &there : stays(them)) {
        if (within_reach(me.robot, *there.swept))
            moving.add_late(slot, *there.swept, them.cost, there.cell, std::max(there.first - late, 0),
                            std::min(there.last + late, steps_));
    }
}

void PathSet::gather(PathIndex i, MovingObstacles &moving) const {
    moving.clear();
    for (int slot = 0; slot < at(i).neighbours.size(); ++slot) gather_one(at(i), slot, moving);
    moving.sort(steps_);
}

JointRequest PathSet::joint_request(const List<PathIndex> &group) {
    List<Presence> before; // they do not see each other but in the search
    for (const PathIndex i : group) before.push_back(std::exchange(at(i).presence, Presence::absent));
    JointRequest request;
    for (int k = 0; k < group.size(); ++k) {
        gather(group[k], joint_moving_[k]);
        request.robots.push_back(&at(group[k]).robot);
        request.moving.push_back(&joint_moving_[k]);
        request.deadlines.push_back(at(group[k]).deadline);
    }
    for (int k = 0; k < group.size(); ++k) at(group[k]).presence = before[k];
    request.steps = steps_;
    request.need_mm = need_mm_;
    return request;
}

bool PathSet::seek_joint(const List<PathIndex> &group, bool backward, int most_nodes, JointSearch &search) {
    JointRequest request = joint_request(group);
    request.backward = backward;
    request.most_nodes = most_nodes;
    return search.run(request);
}

// One of two, among those around it.
void PathSet::begin_flood(int which, Member &member) {
    FloodSide &side = flood_.side(which);
    side.begin(member.robot, member.deadline, steps_);
    for (const auto &visit : joint_moving_[which].visits()) {
        const Robot &them = at(member.neighbours[visit.slot]).robot;
        const bool at_end = visit.cell == them.start() || visit.cell == them.goal();
        const BlockedLines cells = member.blocked_to_floods.by(member.robot, visit.slot, them, visit.cell,
                                                               need_mm_ + flood_margin_mm, tables_);
        for (int step = visit.first; step <= visit.last; ++step) side.block(step, cells, at_end);
    }
}

bool PathSet::can_flood(const List<PathIndex> &pair) {
    return std::all_of(pair.begin(), pair.end(),
                       [this](PathIndex i) { return FloodSide::holds(at(i).robot); });
}

// Of two: the request's moving obstacles are gathered.
bool PathSet::flood(const List<PathIndex> &pair) {
    Member &first = at(pair[0]), &second = at(pair[1]);
    begin_flood(0, first);
    begin_flood(1, second);
    const auto &near = second.neighbours;
    const int slot = static_cast<int>(std::find(near.begin(), near.end(), pair[0]) - near.begin());
    return flood_.run(steps_, [&](Cell c) {
        return second.blocked_to_floods.by(second.robot, slot, first.robot, c, need_mm_ + flood_margin_mm,
                                           tables_);
    });
}

bool PathSet::seek_pair(const List<PathIndex> &pair, int most_nodes, JointSearch &search) {
    JointRequest request = joint_request(pair);
    if (!flood(pair)) return false;
    request.backward = false;
    request.most_nodes = most_nodes;
    request.flood = &flood_;
    return search.run(request);
}

// What is likely to come, once a search without a guide has found nothing soon.
void PathSet::guide(Request &request, Member &member) {
    const Robot &robot = *request.robot;
    const bool back = request.backward;
    CostToGo::Request ask;
    ask.robot = &robot;
    ask.first = back ? robot.goal() : robot.start();
    ask.last = back ? robot.start() : robot.goal();
    ask.steps = steps_;
    ask.hold = request.hold + (back ? steps_ - request.deadline : 0);
    ask.last_step = back ? steps_ : request.deadline;
    ask.move = request.costs->move;
    ask.wait = request.costs->wait;
    ask.beta = &request.costs->beta;
    guide_.begin(ask);
    for (const auto &visit : moving_.visits()) {
        const Robot &them = at(member.neighbours[visit.slot]).robot;
        const BlockedLines cells =
            member.blocked.by(robot, visit.slot, them, visit.cell, need_mm_ + guide_margin_mm, tables_);
        for (int step = visit.first; step <= visit.last; ++step)
            guide_.block(back ? steps_ - step : step, cells, visit.cost);
    }
    guide_.find();
    request.guide = &guide_;
}

bool PathSet::seek(PathIndex i, const Costs &costs, int give_up, Mode mode, Search &search) {
    gather(i, moving_);
    Member &m = at(i);
    Request request{&m.robot, &moving_, &costs,        steps_,   m.deadline,
                    give_up,  need_mm_, mode.backward, mode.hold};
    request.most_expansions = mode.unguided;
    const List<Cell> *path = mode.unguided > 0 ? &search.run(request) : nullptr;
    if (path == nullptr || search.undecided()) {
        guide(request, m);
        if (guide_.total() / much_too_dear >= give_up) return false;
        request.most_expansions = mode.most_guided;
        path = &search.run(request);
    }
    if (path->empty()) return false;
    set_path(i, *path);
    m.still = false;
    return true;
}

Circle PathSet::circle_of(const SweptArm &swept) const {
    const Segment &mid = swept.at[2];
    const double half = 0.5 * length(mid.b - mid.a);
    return {middle(mid.a, mid.b), half + swept.displacement_bound_mm + swept.extra_mm + 0.5 * need_mm_};
}

int PathSet::steps_in_conflict(const Member &p, const Member &q) const {
    const int last = std::max(p.swept.size(), q.swept.size()) - 1; // from here on both rest
    int count = meet(p, q, last) ? steps_ + 1 - last : 0;
    for (int k = 0; k < last; ++k)
        if (meet(p, q, k)) ++count;
    return count;
}

// Stays of the one that meet some of the other, if one of them is late.
int PathSet::late_in_conflict(const Member &p, const Member &q) const {
    const int late = std::min(late_steps_, steps_);
    const List<Stay> theirs = stays(q);
    int count = 0;
    for (const Stay &a : stays(p)) {
        count += std::any_of(theirs.begin(), theirs.end(), [&](const Stay &b) {
            if (b.first - late > a.last || a.first - late > b.last) return false;
            return circles_touch(circle_of(*a.swept), circle_of(*b.swept)) &&
                   !ever_apart(*a.swept, *b.swept, need_mm_);
        });
    }
    return count;
}

bool PathSet::only_late(PathIndex i, PathIndex j) const {
    const auto &conflicts = at(i).conflicts;
    return std::any_of(conflicts.begin(), conflicts.end(),
                       [j](const PathConflict &c) { return c.other == j && c.late; });
}

bool PathSet::spare(PathIndex i, PathIndex j) {
    if (late_steps_ == 0 || spared(i, j)) return false;
    at(i).spared.push_back(j);
    at(j).spared.push_back(i);
    return true;
}

// Whether the way down of the one meets that of the other; or, if one may stop for good, its start.
bool PathSet::hopeless(const Member &p, const Member &q) const {
    if (p.still || q.still) return false;
    const auto meets = [&](const SweptArm &mine) {
        const auto apart = [&](const SweptArm &leg) { return ever_apart(mine, leg, need_mm_); };
        return !std::all_of(q.robot.legs().begin(), q.robot.legs().end(), apart);
    };
    const bool for_good = late_steps_ >= most_late_steps;
    return (for_good && (meets(p.at_start) || !ever_apart(p.at_start, q.at_goal, need_mm_))) ||
           std::any_of(p.robot.legs().begin(), p.robot.legs().end(), meets);
}

void PathSet::spare_hopeless() {
    if (late_steps_ == 0) return;
    for (const PathIndex i : places())
        for (const PathIndex j : at(i).neighbours)
            if (hopeless(at(i), at(j))) spare(i, j);
}

void PathSet::forget_conflicts(PathIndex i) {
    for (const PathConflict &conflict : at(i).conflicts)
        at(conflict.other).conflicts.erase_if([i](const PathConflict &c) { return c.other == i; });
    at(i).conflicts.clear();
}

void PathSet::count_conflicts(PathIndex i) {
    forget_conflicts(i);
    if (at(i).presence != Presence::path) return;
    for (const PathIndex j : at(i).neighbours) {
        if (at(j).presence != Presence::path) continue;
        int steps = steps_in_conflict(at(i), at(j));
        const bool late = steps == 0 && late_steps(at(i), j) > 0;
        if (late) steps = late_in_conflict(at(i), at(j));
        if (steps == 0) continue;
        at(i).conflicts.push_back({j, steps, late});
        at(j).conflicts.push_back({i, steps, late});
    }
}

int PathSet::conflicts() const {
    int sum = 0;
    for (const Member &m : members_) sum += m.conflicts.size();
    return sum / 2;
}

void PathSet::note_changes() { noted_.emplace_back(); }

void PathSet::note(PathIndex i) {
    const auto same = [i](const SavedPath &saved) { return saved.index == i; };
    if (!noted_.empty() && std::none_of(noted_.back().begin(), noted_.back().end(), same))
        noted_.back().push_back(save(i));
}

List<PathIndex> PathSet::changed() const {
    List<PathIndex> out;
    for (const SavedPath &saved : noted_.back()) out.push_back(saved.index);
    return out;
}

void PathSet::end_changes(bool keep) {
    List<SavedPath> last = std::move(noted_.back());
    noted_.pop_back();
    if (keep) return note_before(last);
    List<PathIndex> back;
    for (SavedPath &saved : last) {
        back.push_back(saved.index);
        restore(std::move(saved));
    }
    for (const PathIndex i : back) count_conflicts(i);
}

// What has been kept has changed since changes were noted before, too, if they were.
void PathSet::note_before(List<SavedPath> &last) {
    if (noted_.empty()) return;
    const List<PathIndex> known = changed();
    for (SavedPath &saved : last)
        if (!known.contains(saved.index)) noted_.back().push_back(std::move(saved));
}

SavedPath PathSet::save(PathIndex i) const {
    const Member &m = at(i);
    return {i, m.path, m.swept, m.circles, m.conflicts, m.arrival, m.still};
}

void PathSet::restore_all(List<SavedPath> &saved) {
    List<PathIndex> all;
    for (const SavedPath &one : saved) all.push_back(one.index);
    for (const PathIndex i : all) forget_conflicts(i);
    for (SavedPath &one : saved) {
        for (const PathConflict &c : one.conflicts)
            if (!all.contains(c.other)) at(c.other).conflicts.push_back({one.index, c.steps, c.late});
        at(one.index).conflicts = std::move(one.conflicts);
        restore(std::move(one));
    }
}

void PathSet::restore(SavedPath saved) {
    Member &m = at(saved.index);
    m.path = std::move(saved.path);
    m.swept = std::move(saved.swept);
    m.circles = std::move(saved.circles);
    m.arrival = saved.arrival;
    m.still = saved.still;
    m.presence = Presence::path;
    fit(m);
}

} // namespace fl::planning
