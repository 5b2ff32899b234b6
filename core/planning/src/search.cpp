#include "search.hpp"

#include <algorithm>
#include <functional>

namespace fl::planning {
namespace {

constexpr int stay = 4;

Cell moved(Cell c, int move) { return {c.alpha + move % 3 - 1, c.beta + move / 3 - 1}; }

// How an axis bends around a line it reached by one move and leaves by another (-1, 0, 1 each).
Bend bend(int in, int out) { return {-in, out}; }

Bend reversed(Bend b) { return {b.to, b.from}; }

} // namespace

// The bends of the true motion, whatever the direction of the search.
Bends Search::bends(int move_in, int move_out) const {
    const Bends b{bend(move_in % 3 - 1, move_out % 3 - 1), bend(move_in / 3 - 1, move_out / 3 - 1)};
    return ask_.backward ? Bends{reversed(b.alpha), reversed(b.beta)} : b;
}

int Search::steps_to_go(Cell c) const {
    const Cell end = last_cell();
    return std::max(std::abs(c.alpha - end.alpha), std::abs(c.beta - end.beta));
}

std::uint32_t Search::id(Place at) const {
    return static_cast<std::uint32_t>(at.step * ask_.robot->cells() + ask_.robot->index(at.cell));
}

Search::Place Search::place(std::uint32_t id) const {
    const int cells = ask_.robot->cells(), width = ask_.robot->alpha().size();
    const int step = static_cast<int>(id) / cells, cell = static_cast<int>(id) % cells;
    return {{cell % width, cell / width}, step};
}

Search::Node &Search::node(std::uint32_t id) {
    Node &n = nodes_[id];
    if (n.round != round_) n = {round_, ask_.give_up, stay, false};
    return n;
}

int Search::heuristic(Cell c) const {
    const Cell end = last_cell();
    return ask_.costs->move * (std::abs(c.alpha - end.alpha) + std::abs(c.beta - end.beta));
}

void Search::push(std::uint32_t id, int cost, int to_go) {
    const auto total = static_cast<std::uint64_t>(cost + to_go);
    queue_.push_back(total << 38 | static_cast<std::uint64_t>(std::min(to_go, 1023)) << 28 | id);
    std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
}

void Search::begin() {
    // backward, the time after the deadline comes first: it is spent at the goal
    if (ask_.backward) ask_.hold += ask_.steps - ask_.deadline;
    last_step_ = ask_.backward ? ask_.steps : ask_.deadline;
    const size_t size = static_cast<size_t>(ask_.robot->cells()) * static_cast<size_t>(ask_.steps + 1);
    if (nodes_.size() < size) nodes_.resize(size);
    if (++round_ == 0) { // after 2^32 searches the marks would repeat
        std::fill(nodes_.begin(), nodes_.end(), Node{});
        round_ = 1;
    }
    queue_.clear();
    path_.clear();
    best_ = ask_.give_up;
    prepare_end();
}

int Search::hold_cost() {
    const Piece rest = ask_.robot->piece(first_cell(), {});
    int cost = 0;
    for (int step = 0; step < ask_.hold; ++step) {
        gather_near({first_cell(), step});
        cost += encounters(rest);
    }
    return cost;
}

// What it costs to stand at the last cell from each step to the end.
void Search::prepare_end() {
    const Piece rest = ask_.robot->piece(last_cell(), {});
    end_cost_.assign(static_cast<size_t>(ask_.steps + 2), 0);
    for (int step = ask_.steps; step >= 0; --step) {
        gather_near({last_cell(), step});
        end_cost_[static_cast<size_t>(step)] = end_cost_[static_cast<size_t>(step + 1)] + encounters(rest);
    }
}

// The neighbours that some step around this cell could meet.
void Search::gather_near(Place at) {
    near_.clear();
    const Segment here = ask_.robot->line(at.cell);
    const Vec2 centre = middle(here.a, here.b);
    const double room = ask_.need_mm + ask_.robot->widest_sway_mm();
    const double radius = 0.5 * length(here.b - here.a) + room;
    for (int index : ask_.crowd->at(ask_.backward ? ask_.steps - at.step : at.step)) {
        const Crowd::Visit &e = ask_.crowd->visit(index);
        const Vec2 gap = e.centre - centre;
        const double touch = radius + e.radius_mm;
        if (dot(gap, gap) >= touch * touch) continue;
        const double close = room + e.piece->sway_mm;
        if (squared_distance(here, e.piece->at[2]) < close * close) near_.push_back(&e);
    }
}

int Search::encounters(const Piece &step) const {
    int cost = 0;
    for (const Crowd::Visit *e : near_)
        if (!stay_apart(step, *e->piece, ask_.need_mm)) cost += e->cost;
    return cost;
}

int Search::encounters(Place at, Bends turn) {
    if (near_.empty()) return 0;
    // most are seen to be clear, or not, from mid-step alone
    const Segment here = ask_.robot->middle_line(at.cell, turn);
    const double sway = ask_.robot->sway_mm(turn);
    int cost = 0;
    doubtful_.clear();
    for (const Crowd::Visit *e : near_) {
        const double d2 = squared_distance(here, e->piece->at[2]);
        const double clear =
            ask_.need_mm + ask_.robot->bulge_mm() + e->piece->bulge_mm + sway + e->piece->sway_mm;
        if (d2 >= clear * clear) continue;
        if (d2 < ask_.need_mm * ask_.need_mm)
            cost += e->cost;
        else
            doubtful_.push_back(e);
    }
    if (doubtful_.empty()) return cost;
    const Piece piece = ask_.robot->piece(at.cell, turn);
    for (const Crowd::Visit *e : doubtful_)
        if (!stay_apart(piece, *e->piece, ask_.need_mm)) cost += e->cost;
    return cost;
}

int Search::base_cost(Place at, Bends turn, int move) const {
    const Costs &c = *ask_.costs;
    const int moves = std::abs(move % 3 - 1) + std::abs(move / 3 - 1);
    const int changes = (turn.alpha.from != -turn.alpha.to) + (turn.beta.from != -turn.beta.to);
    const int here = c.beta.empty() ? 0 : c.beta[static_cast<size_t>(at.cell.beta)];
    return c.move * moves + c.bend * changes + here;
}

// To stand at the last cell from here to the end.
void Search::finish(std::uint32_t from, Place at) {
    const Node n = node(from);
    const Bends turn = bends(n.move, stay);
    if (!ask_.robot->clear(at.cell, turn)) return;
    const int cost = n.cost + base_cost(at, turn, stay) + encounters(at, turn) +
                     end_cost_[static_cast<size_t>(at.step + 1)];
    if (cost >= best_) return;
    best_ = cost;
    last_ = from;
}

void Search::relax(std::uint32_t from, Place at, int move) {
    const Node n = node(from);
    const Bends turn = bends(n.move, move);
    if (turn.alpha.reverses() || turn.beta.reverses()) return;
    const Place next{moved(at.cell, move), at.step + 1};
    if (!ask_.robot->inside(next.cell) || next.step + steps_to_go(next.cell) > last_step_) return;
    const std::uint32_t to = id(next);
    const int to_go = heuristic(next.cell);
    Node &m = node(to);
    int cost = n.cost + base_cost(at, turn, move);
    if (m.closed || cost >= m.cost || cost + to_go >= best_) return;
    if (!ask_.robot->clear(at.cell, turn)) return;
    cost += encounters(at, turn);
    if (cost >= m.cost || cost + to_go >= best_) return;
    m.cost = cost;
    m.move = static_cast<std::uint8_t>(move);
    push(to, cost, to_go);
}

void Search::expand(std::uint32_t from) {
    ++expansions_;
    const Place at = place(from);
    gather_near(at);
    if (at.cell == last_cell()) finish(from, at);
    if (at.step == last_step_) return;
    for (int move = 0; move < 9; ++move) relax(from, at, move);
}

void Search::trace() {
    path_.assign(static_cast<size_t>(ask_.steps + 1), last_cell());
    Place at = place(last_);
    while (true) {
        path_[static_cast<size_t>(at.step)] = at.cell;
        if (at.step == ask_.hold) break;
        const int back = 8 - node(id(at)).move; // the opposite move
        at = {moved(at.cell, back), at.step - 1};
    }
    std::fill(path_.begin(), path_.begin() + ask_.hold, first_cell());
    if (ask_.backward) std::reverse(path_.begin(), path_.end());
}

const std::vector<Cell> &Search::run(const Request &request) {
    ask_ = request;
    begin();
    const std::uint32_t first = id({first_cell(), ask_.hold});
    node(first).cost = hold_cost();
    push(first, node(first).cost, heuristic(first_cell()));
    while (!queue_.empty()) {
        const std::uint64_t top = queue_.front();
        if (static_cast<int>(top >> 38) >= best_) break;
        std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
        queue_.pop_back();
        const auto from = static_cast<std::uint32_t>(top & 0xfffffffu);
        if (node(from).closed) continue;
        node(from).closed = true;
        expand(from);
    }
    if (best_ < ask_.give_up) trace();
    return path_;
}

} // namespace fl::planning
