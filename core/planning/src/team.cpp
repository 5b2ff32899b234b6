#include "team.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

// For so many steps a positioner without a way is taken to stand at its start, and at its goal. Longer makes
// the others wait for nothing, shorter lets them plan through one that cannot leave in time.
constexpr int standing_steps = 8;

Bend bend(int before, int here, int after) { return {before - here, after - here}; }

} // namespace

void Team::add(Robot robot) {
    Member m(std::move(robot));
    m.at_start = standing(m.robot.line(m.robot.start()));
    m.at_goal = standing(m.robot.line(m.robot.goal()));
    m.deadline = steps_;
    members_.push_back(std::move(m));
}

void Team::find_neighbours() {
    for (int i = 0; i < size(); ++i) {
        std::vector<std::pair<double, int>> near;
        for (int j = 0; j < size(); ++j) {
            const double gap = length(at(i).robot.centre() - at(j).robot.centre());
            if (j != i && gap < at(i).robot.reach_mm() + at(j).robot.reach_mm() + need_mm_)
                near.emplace_back(gap, j);
        }
        std::sort(near.begin(), near.end());
        at(i).neighbours.clear();
        for (const auto &[gap, j] : near) at(i).neighbours.push_back(j);
    }
}

void Team::allow(int robot, int deadline) {
    at(robot).deadline = deadline;
    if (deadline > steps_) extend(deadline - steps_);
}

int Team::arrival(int robot) const {
    const auto &way = at(robot).way;
    size_t step = way.size() - 1;
    while (step > 0 && way[step - 1] == way.back()) --step;
    return static_cast<int>(step);
}

void Team::extend(int steps) {
    steps_ += steps;
    for (Member &m : members_) {
        if (m.way.empty()) continue;
        // the last step becomes one of many at rest: its second half was at rest already
        m.way.resize(static_cast<size_t>(steps_ + 1), m.way.back());
        m.pieces.resize(static_cast<size_t>(steps_ + 1), standing(m.robot.line(m.way.back())));
    }
}

void Team::set_way(int robot, const std::vector<Cell> &way) {
    Member &m = at(robot);
    m.way = way;
    m.pieces.resize(way.size());
    for (size_t k = 0; k < way.size(); ++k) {
        const Cell here = way[k], before = way[k == 0 ? 0 : k - 1],
                   after = way[k + 1 == way.size() ? k : k + 1];
        m.pieces[k] = m.robot.piece(
            here, {bend(before.alpha, here.alpha, after.alpha), bend(before.beta, here.beta, after.beta)});
        measure_sway(m.pieces[k]);
    }
    m.presence = Presence::way;
}

void Team::stand_still(int robot) {
    set_way(robot, std::vector<Cell>(static_cast<size_t>(steps_ + 1), at(robot).robot.start()));
    at(robot).still = true;
}

const Piece *Team::piece_of(const Member &m, int step) const {
    if (m.presence == Presence::way) return &m.pieces[static_cast<size_t>(step)];
    if (m.presence == Presence::absent) return nullptr;
    const int stand = std::clamp(m.deadline - m.robot.travel_steps(), 1, standing_steps);
    if (step < stand) return &m.at_start;
    return step > m.deadline - stand ? &m.at_goal : nullptr;
}

void Team::gather_one(const Member &me, int other, Crowd &crowd) const {
    const Segment centre{me.robot.centre(), me.robot.centre()};
    const Member &them = at(other);
    if (them.presence == Presence::absent) return;
    for (int step = 0; step <= steps_; ++step) {
        const Piece *piece = piece_of(them, step);
        if (piece == nullptr) continue;
        const double reach = me.robot.reach_mm() + need_mm_ + piece->sway_mm;
        if (squared_distance(centre, piece->at[2]) < reach * reach) crowd.add(other, step, *piece, them.cost);
    }
}

void Team::gather(int robot, Crowd &crowd) const {
    crowd.clear();
    for (int j : at(robot).neighbours) gather_one(at(robot), j, crowd);
    crowd.sort(steps_);
}

bool Team::seek_joint(const std::vector<int> &robots, bool backward, int most_nodes, JointSearch &search) {
    std::vector<Presence> before; // they do not see each other but in the search
    for (int i : robots) before.push_back(std::exchange(at(i).presence, Presence::absent));
    JointRequest request;
    for (size_t k = 0; k < robots.size(); ++k) {
        gather(robots[k], joint_crowds_[k]);
        request.robots.push_back(&at(robots[k]).robot);
        request.crowds.push_back(&joint_crowds_[k]);
        request.deadlines.push_back(at(robots[k]).deadline);
    }
    for (size_t k = 0; k < robots.size(); ++k) at(robots[k]).presence = before[k];
    request.steps = steps_;
    request.need_mm = need_mm_;
    request.backward = backward;
    request.most_nodes = most_nodes;
    return search.run(request);
}

bool Team::seek(int robot, const Costs &costs, int give_up, Mode mode, Search &search) {
    gather(robot, crowd_);
    Member &m = at(robot);
    const auto &way = search.run(
        {&m.robot, &crowd_, &costs, steps_, m.deadline, give_up, need_mm_, mode.backward, mode.hold});
    if (way.empty()) return false;
    m.still = false;
    set_way(robot, way);
    return true;
}

int Team::steps_met(const Member &p, const Member &q) const {
    int met = 0;
    for (size_t k = 0; k < p.pieces.size(); ++k) {
        const Piece &a = p.pieces[k], &b = q.pieces[k];
        const Vec2 gap = middle(a.at[2].a, a.at[2].b) - middle(b.at[2].a, b.at[2].b);
        const double touch = 0.5 * (length(a.at[2].b - a.at[2].a) + length(b.at[2].b - b.at[2].a)) +
                             a.sway_mm + b.sway_mm + need_mm_;
        if (dot(gap, gap) < touch * touch && !stay_apart(a, b, need_mm_)) ++met;
    }
    return met;
}

void Team::forget_meetings(int robot) {
    for (const Meeting &meeting : at(robot).meetings) {
        auto &theirs = at(meeting.other).meetings;
        theirs.erase(
            std::find_if(theirs.begin(), theirs.end(), [&](const Meeting &m) { return m.other == robot; }));
    }
    at(robot).meetings.clear();
}

void Team::count_meetings(int robot) {
    forget_meetings(robot);
    if (at(robot).presence != Presence::way) return;
    for (int j : at(robot).neighbours) {
        if (at(j).presence != Presence::way) continue;
        const int met = steps_met(at(robot), at(j));
        if (met == 0) continue;
        at(robot).meetings.push_back({j, met});
        at(j).meetings.push_back({robot, met});
    }
}

int Team::meetings() const {
    size_t sum = 0;
    for (const Member &m : members_) sum += m.meetings.size();
    return static_cast<int>(sum / 2);
}

Memory Team::remember(int robot) const { return {robot, at(robot).way, at(robot).pieces, at(robot).still}; }

void Team::restore(Memory memory) {
    Member &m = at(memory.robot);
    m.way = std::move(memory.way);
    m.pieces = std::move(memory.pieces);
    m.still = memory.still;
    m.presence = Presence::way;
}

} // namespace fl::planning
