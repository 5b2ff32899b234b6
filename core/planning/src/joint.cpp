#include "joint.hpp"

#include <algorithm>
#include <functional>

namespace fl::planning {
namespace {

constexpr std::uint8_t stay = 4;
constexpr int step_cost = 4;       // a step of time
constexpr int encounter_cost = 24; // a step near another positioner: worth a detour of some steps
constexpr size_t first_table = 1 << 12;

int alpha_of(int move) { return move % 3 - 1; }
int beta_of(int move) { return move / 3 - 1; }
Bend reversed(Bend b) { return {b.to, b.from}; }

} // namespace

JointSearch::Cells JointSearch::ends(bool first) const {
    Cells cells{};
    for (size_t k = 0; k < count(); ++k)
        cells[k] = first == ask_.backward ? ask_.robots[k]->goal() : ask_.robots[k]->start();
    return cells;
}

Bends JointSearch::bends(int move_in, int move_out) const {
    const Bends b{{-alpha_of(move_in), alpha_of(move_out)}, {-beta_of(move_in), beta_of(move_out)}};
    return ask_.backward ? Bends{reversed(b.alpha), reversed(b.beta)} : b;
}

int JointSearch::to_go(size_t which, Cell c) const {
    const Robot &robot = *ask_.robots[which];
    const Cell last = ask_.backward ? robot.start() : robot.goal();
    return std::max(std::abs(c.alpha - last.alpha), std::abs(c.beta - last.beta));
}

// Steps that all still need, and a little for those that are nearer: they shall come along.
int JointSearch::estimate(const Cells &cells) const {
    int longest = 0, sum = 0;
    for (size_t k = 0; k < count(); ++k) {
        const int go = to_go(k, cells[k]);
        longest = std::max(longest, go);
        sum += go;
    }
    return (step_cost - 1) * longest + sum;
}

int JointSearch::encounters(size_t which, const Piece &step, int when) const {
    int met = 0;
    const Segment &mid = step.at[2];
    const Vec2 centre = middle(mid.a, mid.b);
    const double radius = 0.5 * length(mid.b - mid.a) + step.sway_mm + ask_.need_mm;
    for (int index : ask_.crowds[which]->at(ask_.backward ? ask_.steps - when : when)) {
        const Crowd::Visit &e = ask_.crowds[which]->visit(index);
        const Vec2 gap = e.centre - centre;
        const double touch = radius + e.radius_mm;
        if (dot(gap, gap) < touch * touch && !stay_apart(step, *e.piece, ask_.need_mm)) ++met;
    }
    return met;
}

void JointSearch::list_options(size_t which, const Node &from) {
    Robot &robot = *ask_.robots[which];
    Options &out = options_[which];
    const Cell here = from.cells[which];
    // backward, the time after the deadline comes first and is spent at the goal
    const int late = ask_.steps - ask_.deadlines[which];
    const bool held = ask_.backward && from.step < late;
    const int left = (ask_.backward ? ask_.steps : ask_.deadlines[which]) - from.step;
    for (int move = 0; move < 9; ++move) {
        const auto m = static_cast<size_t>(move);
        const Bends turn = bends(from.moves[which], move);
        const Cell next = out.next[m] = {here.alpha + alpha_of(move), here.beta + beta_of(move)};
        // to stand at the end needs no step
        const bool in_time = to_go(which, next) < left || to_go(which, here) + to_go(which, next) == 0;
        out.possible[m] = in_time && (!held || move == stay) && !turn.alpha.reverses() &&
                          !turn.beta.reverses() && robot.inside(next) && robot.clear(here, turn);
        if (!out.possible[m]) continue;
        out.pieces[m] = robot.piece(here, turn);
        out.cost[m] = encounter_cost * encounters(which, out.pieces[m], from.step);
    }
}

void JointSearch::list_options(const Node &from) {
    for (size_t k = 0; k < count(); ++k) list_options(k, from);
    for (auto &pair : apart_) pair.fill(0);
}

bool JointSearch::apart(size_t p, size_t q, size_t move_p, size_t move_q) {
    std::uint8_t &known = apart_[p * most + q][move_p * 9 + move_q];
    if (known == 0)
        known = stay_apart(options_[p].pieces[move_p], options_[q].pieces[move_q], ask_.need_mm) ? 1 : 2;
    return known == 1;
}

std::uint64_t JointSearch::key(const Cells &cells) const {
    std::uint64_t k = 0;
    for (size_t i = 0; i < count(); ++i)
        k = k * static_cast<std::uint64_t>(ask_.robots[i]->cells()) +
            static_cast<std::uint64_t>(ask_.robots[i]->index(cells[i]));
    return k;
}

// The place of these cells in the table: its node, or the free place where it belongs (-1).
int &JointSearch::slot(const Cells &cells) {
    const std::uint64_t k = key(cells);
    size_t at = (k * 0x9e3779b97f4a7c15u >> 20) & (table_.size() - 1);
    while (table_[at] >= 0 && key(nodes_[static_cast<size_t>(table_[at])].cells) != k)
        at = (at + 1) & (table_.size() - 1);
    return table_[at];
}

void JointSearch::grow_table() {
    table_.assign(2 * table_.size(), -1);
    for (size_t n = 0; n < nodes_.size(); ++n) slot(nodes_[n].cells) = static_cast<int>(n);
}

// The way to go counts as much again as the way come: greedy, but a long detour does not pay.
void JointSearch::push(int node) {
    const Node &n = nodes_[static_cast<size_t>(node)];
    const int go = estimate(n.cells);
    const auto total = static_cast<std::uint64_t>(n.cost + 2 * go);
    queue_.push_back(total << 44 | static_cast<std::uint64_t>(std::min(go, 4095)) << 32 |
                     static_cast<std::uint64_t>(node));
    std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
}

void JointSearch::reach(int from, const Moves &moves, int cost) {
    Cells cells{};
    for (size_t k = 0; k < count(); ++k) cells[k] = options_[k].next[moves[k]];
    int &place = slot(cells);
    if (place >= 0) {
        const Node &known = nodes_[static_cast<size_t>(place)];
        if (known.closed || known.cost <= cost) return;
    }
    const Node reached{cells, moves, from, nodes_[static_cast<size_t>(from)].step + 1, cost, false};
    int node = place;
    if (node < 0) {
        node = place = static_cast<int>(nodes_.size());
        nodes_.push_back(reached);
        if (2 * nodes_.size() > table_.size()) grow_table();
    } else {
        nodes_[static_cast<size_t>(node)] = reached;
    }
    push(node);
}

// All combinations of moves in which those chosen so far stay apart.
void JointSearch::combine(int from, size_t which, Moves &moves, int cost) {
    if (which == count()) return reach(from, moves, cost);
    for (size_t move = 0; move < 9; ++move) {
        if (!options_[which].possible[move]) continue;
        bool free = true;
        for (size_t k = 0; free && k < which; ++k) free = apart(k, which, moves[k], move);
        if (!free) continue;
        moves[which] = static_cast<std::uint8_t>(move);
        combine(from, which + 1, moves, cost + options_[which].cost[move]);
    }
}

void JointSearch::expand(int from) {
    ++expansions_;
    Moves moves{};
    combine(from, 0, moves, nodes_[static_cast<size_t>(from)].cost + step_cost);
}

// Whether all can come to rest where they are.
bool JointSearch::can_rest() {
    for (size_t k = 0; k < count(); ++k) {
        if (!options_[k].possible[stay]) return false;
        for (size_t j = 0; j < k; ++j)
            if (!apart(j, k, stay, stay)) return false;
    }
    return true;
}

void JointSearch::trace(int node) {
    const int last = nodes_[static_cast<size_t>(node)].step;
    for (size_t k = 0; k < count(); ++k) {
        auto &way = ways_[k];
        way.assign(static_cast<size_t>(ask_.steps + 1), nodes_[static_cast<size_t>(node)].cells[k]);
        for (int n = node, step = last; n >= 0; n = nodes_[static_cast<size_t>(n)].parent, --step)
            way[static_cast<size_t>(step)] = nodes_[static_cast<size_t>(n)].cells[k];
        if (ask_.backward) std::reverse(way.begin(), way.end());
    }
}

bool JointSearch::run(const JointRequest &request) {
    ask_ = request;
    nodes_.clear();
    queue_.clear();
    table_.assign(first_table, -1);
    const Cells first = ends(true), last = ends(false);
    nodes_.push_back({first, {stay, stay, stay}, -1, 0, 0, false});
    slot(first) = 0;
    push(0);
    while (!queue_.empty() && static_cast<int>(nodes_.size()) < ask_.most_nodes) {
        const int node = static_cast<int>(queue_.front() & 0xffffffffu);
        std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
        queue_.pop_back();
        Node &n = nodes_[static_cast<size_t>(node)];
        if (n.closed) continue;
        n.closed = true;
        list_options(n);
        if (n.cells == last && can_rest()) {
            trace(node);
            return true;
        }
        expand(node);
    }
    return false;
}

} // namespace fl::planning
