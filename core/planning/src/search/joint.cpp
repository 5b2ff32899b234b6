#include "search/joint.hpp"

#include <algorithm>
#include <functional>

namespace fl::planning {
namespace {

constexpr int step_cost = 4;                  // a step of time
constexpr int encounter_cost = 24;            // a step near another positioner: worth a detour of some steps
constexpr std::size_t first_places = 1 << 12; // of the nodes that are known

} // namespace

JointSearch::Cells JointSearch::ends(bool first) const {
    Cells cells{};
    for (int k = 0; k < count(); ++k)
        cells.of[k] = first == ask_.backward ? ask_.robots[k]->goal() : ask_.robots[k]->start();
    return cells;
}

int JointSearch::to_go(int which, Cell c) const {
    const Robot &robot = *ask_.robots[which];
    return steps_between(c, ask_.backward ? robot.start() : robot.goal());
}

// Past the bodies at rest; where that is not known, as if there were none.
int JointSearch::to_go_past(int which, Cell c) const {
    const int steps = (*past_bodies_[which])[ask_.robots[which]->index(c)];
    return steps < 0 ? to_go(which, c) : steps;
}

// Steps that all still need, and a little for those that are nearer: they shall come along.
int JointSearch::estimate(const Cells &cells) const {
    int longest = 0, sum = 0;
    for (int k = 0; k < count(); ++k) {
        const int go = to_go_past(k, cells.of[k]);
        longest = std::max(longest, go);
        sum += go;
    }
    return (step_cost - 1) * longest + sum;
}

int JointSearch::encounters(int which, const SweptArm &step, int when) const {
    int met = 0, last = -1; // no one is met twice in a step
    const Segment &mid = step.at[2];
    const Vec2 centre = middle(mid.a, mid.b);
    const double radius =
        0.5 * length(mid.b - mid.a) + step.displacement_bound_mm + ask_.need_mm + step.extra_mm;
    for (int index : ask_.moving[which]->at(ask_.backward ? ask_.steps - when : when)) {
        const MovingObstacles::Visit &e = ask_.moving[which]->visit(index);
        if (!e.near(centre, radius) || e.slot == last || !e.meets(step, ask_.need_mm)) continue;
        ++met;
        last = e.slot;
    }
    return met;
}

void JointSearch::list_options(int which, const Node &from) {
    Robot &robot = *ask_.robots[which];
    Options &out = options_[which];
    const Cell here = from.cells.of[which];
    // backward, the time after the deadline comes first and is spent at the goal
    const int late = ask_.steps - ask_.deadlines[which];
    const bool held = ask_.backward && from.step < late;
    const int left = (ask_.backward ? ask_.steps : ask_.deadlines[which]) - from.step;
    for (int move = 0; move < 9; ++move) {
        const VelocityChanges turn = changes_of(from.moves.of[which], move, ask_.backward);
        const Cell next = out.next[move] = moved(here, move);
        // to rest at the end needs no step
        const bool in_time = to_go(which, next) < left || to_go(which, here) + to_go(which, next) == 0;
        out.possible[move] = in_time && (!held || move == stay) && !turn.alpha.reverses() &&
                             !turn.beta.reverses() && robot.inside(next) && robot.clear(here, turn);
        if (!out.possible[move]) continue;
        out.swept[move] = robot.swept(here, turn);
        out.cost[move] = encounter_cost * encounters(which, out.swept[move], from.step);
        if (ask_.flood != nullptr) out.possible[move] = out.cost[move] == 0;
    }
}

void JointSearch::list_options(const Node &from) {
    for (int k = 0; k < count(); ++k) list_options(k, from);
    std::fill_n(&apart_[0][0][0][0], sizeof apart_ / sizeof(Pairing), not_looked_at);
}

bool JointSearch::apart(int p, int q, int move_p, int move_q) {
    Pairing &known = apart_[p][q][move_p][move_q];
    if (known == not_looked_at)
        known = stay_apart(options_[p].swept[move_p], options_[q].swept[move_q], ask_.need_mm) ? apart_from
                                                                                               : touching;
    return known == apart_from;
}

std::uint64_t JointSearch::key(const Cells &cells, int step) const {
    std::uint64_t k = ask_.flood != nullptr ? static_cast<std::uint64_t>(step) : 0;
    for (int i = 0; i < count(); ++i)
        k = k * static_cast<std::uint64_t>(ask_.robots[i]->cells()) +
            static_cast<std::uint64_t>(ask_.robots[i]->index(cells.of[i]));
    return k;
}

// The steps to go count as much again as the path so far: greedy, but a long detour does not pay.
void JointSearch::push(NodeId node) {
    const Node &n = nodes_[node];
    const int go = estimate(n.cells);
    const auto total =
        static_cast<std::uint64_t>(ask_.flood != nullptr ? ask_.steps - n.step : n.cost + 2 * go);
    queue_.push_back(total << 44 | static_cast<std::uint64_t>(std::min(go, 4095)) << 32 |
                     static_cast<std::uint64_t>(node.value()));
    std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
}

JointSearch::NodeId JointSearch::pop() {
    const NodeId node(static_cast<int>(queue_.front() & 0xffffffffu));
    std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
    queue_.pop_back();
    return node;
}

void JointSearch::reach(NodeId from, const Moves &moves, int cost) {
    Cells cells{};
    for (int k = 0; k < count(); ++k) cells.of[k] = options_[k].next[moves.of[k]];
    const int step = nodes_[from].step + 1;
    if (ask_.flood != nullptr && (step > ask_.steps || !ask_.flood->holds(step, cells.of[0], cells.of[1])))
        return;
    const std::uint64_t here = key(cells, step);
    const NodeId *known = known_.find(here);
    if (known != nullptr && (nodes_[*known].closed || nodes_[*known].cost <= cost)) return;
    // most places are known by now, and that is seen sooner than whether arms touch
    if (!apart_from_before(count() - 1, moves)) return;
    const Node reached{cells, moves, from, step, cost, false};
    const NodeId node = known != nullptr ? *known : NodeId(nodes_.size());
    if (known != nullptr) {
        nodes_[node] = reached;
    } else {
        known_.add(here, node);
        nodes_.push_back(reached);
    }
    push(node);
}

bool JointSearch::apart_from_before(int which, const Moves &moves) {
    for (int k = 0; k < which; ++k)
        if (!apart(k, which, moves.of[k], moves.of[which])) return false;
    return true;
}

// All combinations of moves. Whether the last one stays apart from the others is looked at where a place is
// reached.
void JointSearch::combine(NodeId from, int which, Moves &moves, int cost) {
    if (which >= std::min(count(), most)) return reach(from, moves, cost);
    const bool last = which == count() - 1;
    for (int move = 0; move < 9; ++move) {
        if (!options_[which].possible[move]) continue;
        moves.of[which] = static_cast<Move>(move);
        if (last || apart_from_before(which, moves))
            combine(from, which + 1, moves, cost + options_[which].cost[move]);
    }
}

void JointSearch::expand(NodeId from) {
    ++expansions_;
    Moves moves{};
    combine(from, 0, moves, nodes_[from].cost + step_cost);
}

// Whether all can come to rest where they are.
bool JointSearch::can_rest() {
    for (int k = 0; k < count(); ++k) {
        if (!options_[k].possible[stay]) return false;
        for (int j = 0; j < k; ++j)
            if (!apart(j, k, stay, stay)) return false;
    }
    return true;
}

void JointSearch::trace(NodeId node) {
    for (int k = 0; k < count(); ++k) {
        auto &path = paths_[k];
        path.assign(ask_.steps + 1, nodes_[node].cells.of[k]);
        int step = nodes_[node].step;
        for (NodeId n = node; n != NodeId(); n = nodes_[n].parent, --step) path[step] = nodes_[n].cells.of[k];
        std::fill(path.begin(), path.begin() + nodes_[NodeId(0)].step, nodes_[NodeId(0)].cells.of[k]);
        if (ask_.backward) std::reverse(path.begin(), path.end());
    }
}

bool JointSearch::run(const JointRequest &request) {
    ask_ = request;
    nodes_.clear();
    queue_.clear();
    for (int k = 0; k < count(); ++k)
        past_bodies_[k] =
            &(ask_.backward ? ask_.robots[k]->steps_from_start() : ask_.robots[k]->steps_from_goal());
    known_.clear(first_places);
    const Cells first = ends(true), last = ends(false);
    // backward, all rest at first until the latest deadline: nodes are of cells alone, and have no waits
    const int latest = *std::max_element(ask_.deadlines.begin(), ask_.deadlines.end());
    const int first_step = ask_.backward ? ask_.steps - latest : 0;
    nodes_.push_back({first, {{stay, stay, stay}}, NodeId(), first_step, 0, false});
    known_.add(key(first, first_step), NodeId(0));
    push(NodeId(0));
    const int rest_from =
        ask_.flood == nullptr ? 0 : std::max(ask_.flood->rest_from(0), ask_.flood->rest_from(1));
    while (!queue_.empty() && nodes_.size() < ask_.most_nodes) {
        const NodeId node = pop();
        Node &n = nodes_[node];
        if (n.closed) continue;
        n.closed = true;
        list_options(n);
        if (n.cells == last && n.step >= rest_from && can_rest()) {
            trace(node);
            return true;
        }
        expand(node);
    }
    return false;
}

} // namespace fl::planning
