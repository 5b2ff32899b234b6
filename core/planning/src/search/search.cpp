#include "search/search.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

constexpr int most_buckets = 1 << 17; // costs above this are all the same: a hundred encounters

VelocityChange reversed(VelocityChange c) { return {c.to, c.from}; }

// Of the speed of one axis: it must start towards its last line, if it does not run there, and stop.
int axis_changes(int line, int last, int speed) {
    const int way = (last > line) - (last < line);
    if (way == 0) return speed == 0 ? 0 : 1;
    return speed == way ? 1 : (speed == 0 ? 2 : 3);
}

} // namespace

VelocityChanges changes_of(int move_in, int move_out, bool backward) {
    const VelocityChanges c{{-alpha_of(move_in), alpha_of(move_out)}, {-beta_of(move_in), beta_of(move_out)}};
    return backward ? VelocityChanges{reversed(c.alpha), reversed(c.beta)} : c;
}

Search::NodeId Search::id(Place at) const {
    return NodeId(at.step * ask_.robot->cells() + ask_.robot->index(at.cell));
}

Search::Place Search::place(NodeId id) const {
    const int cells = ask_.robot->cells(), width = ask_.robot->alpha().size();
    const int step = id.value() / cells, cell = id.value() % cells;
    return {{cell % width, cell / width}, step};
}

Search::Node &Search::node(NodeId id) {
    Node &n = nodes_[id];
    if (n.round != round_) n = {round_, ask_.give_up, stay, false};
    return n;
}

int Search::changes_to_go(Cell c, int move) const {
    return axis_changes(c.alpha, last_cell_.alpha, alpha_of(move)) +
           axis_changes(c.beta, last_cell_.beta, beta_of(move));
}

// From a place that was reached by a move.
int Search::least_to_come(Place at, int move) const {
    const Cell c = at.cell;
    const int changes = ask_.costs->velocity_change * changes_to_go(c, move);
    if (ask_.guide != nullptr) return changes + ask_.guide->from(c, at.step);
    const int lines = std::abs(c.alpha - last_cell_.alpha) + std::abs(c.beta - last_cell_.beta);
    return changes + ask_.costs->move * lines;
}

int Search::total(int cost, int to_come) const {
    return cost + (ask_.guide != nullptr ? ask_.costs->greed * to_come : to_come);
}

int Search::beta_cost(Cell c) const { return ask_.costs->beta.empty() ? 0 : ask_.costs->beta[c.beta]; }

void Search::push(NodeId id, int total) {
    const int bucket = std::min(total, most_buckets - 1);
    if (bucket >= buckets_.size()) buckets_.resize(bucket + 1);
    buckets_[bucket].push_back(id);
    lowest_ = std::min(lowest_, bucket);
    highest_ = std::max(highest_, bucket);
    ++open_;
}

// The open node of lowest total cost; false if there is none below that of the path found.
bool Search::pop(NodeId &id) {
    if (open_ == 0) return false;
    while (buckets_[lowest_].empty()) ++lowest_;
    if (best_ < ask_.give_up && lowest_ >= best_) return false;
    id = buckets_[lowest_].back();
    buckets_[lowest_].pop_back();
    --open_;
    return true;
}

void Search::begin() {
    // backward, the time after the deadline comes first: it is spent at the goal
    if (ask_.backward) ask_.hold += ask_.steps - ask_.deadline;
    last_step_ = ask_.backward ? ask_.steps : ask_.deadline;
    last_cell_ = ask_.backward ? ask_.robot->start() : ask_.robot->goal();
    const int size = ask_.robot->cells() * (ask_.steps + 1);
    if (nodes_.size() < size) nodes_.resize(size);
    const int turnings = ask_.moving->always().empty() ? 0 : 81 * ask_.robot->cells();
    if (always_.size() < turnings) always_.resize(turnings);
    if (++round_ == 0) { // after 2^32 searches the marks would repeat
        std::fill(nodes_.begin(), nodes_.end(), Node{});
        std::fill(always_.begin(), always_.end(), Always{});
        round_ = 1;
    }
    for (int k = 0; k < std::min(highest_ + 1, buckets_.size()); ++k) buckets_[k].clear();
    lowest_ = most_buckets;
    highest_ = 0;
    open_ = 0;
    path_.clear();
    best_ = ask_.give_up;
    list_turnings();
    prepare_end();
}

void Search::list_turnings() {
    const Costs &c = *ask_.costs;
    for (int in = 0; in < 9; ++in)
        for (int out = 0; out < 9; ++out) {
            Turning &t = turnings_[in][out];
            // of the true motion, whatever the direction of the search
            t.changes = changes_of(in, out, ask_.backward);
            t.possible = !t.changes.alpha.reverses() && !t.changes.beta.reverses();
            const int changes = (alpha_of(in) != alpha_of(out)) + (beta_of(in) != beta_of(out));
            t.cost =
                c.velocity_change * changes + c.move * (std::abs(alpha_of(out)) + std::abs(beta_of(out)));
        }
}

int Search::hold_cost() {
    int cost = 0;
    for (int step = 0; step < ask_.hold; ++step) {
        gather_near({first_cell(), step});
        cost += rest_encounters(first_cell());
    }
    return cost;
}

// What it costs to rest at the last cell from each step to the end.
void Search::prepare_end() {
    end_cost_.assign(ask_.steps + 2, 0);
    for (int step = ask_.steps; step >= 0; --step) {
        gather_near({last_cell_, step});
        if (step == ask_.steps && !ask_.backward) end_cost_[step + 1] = leg_encounters();
        end_cost_[step] = end_cost_[step + 1] + rest_encounters(last_cell_);
    }
}

// The neighbours that some step around this cell could meet.
void Search::gather_near(Place at) {
    near_.clear();
    const Segment here = ask_.robot->line(at.cell);
    const Vec2 centre = middle(here.a, here.b);
    const Robot &robot = *ask_.robot;
    const double widest = ask_.need_mm + robot.widest_displacement_mm(), room = widest + robot.extra_mm();
    const double radius = 0.5 * length(here.b - here.a) + room;
    for (int index : ask_.moving->at(ask_.backward ? ask_.steps - at.step : at.step)) {
        const MovingObstacles::Visit &e = ask_.moving->visit(index);
        const Vec2 gap = e.centre - centre;
        const double touch = radius + e.radius_mm;
        if (dot(gap, gap) >= touch * touch) continue;
        const double close = room + e.swept->displacement_bound_mm + e.swept->extra_mm;
        if (squared_distance(here, e.swept->at[2]) >= close * close) continue;
        if (!shaped(e) || limbs_within(robot.limbs(), here, *e.swept, e.swept->at[2],
                                       widest + e.swept->displacement_bound_mm))
            near_.push_back(&e);
    }
}

// Whether the centre lines alone do not tell that two touch.
bool Search::shaped(const MovingObstacles::Visit &e) const {
    return ask_.robot->shape() != nullptr || e.swept->shape != nullptr;
}

int Search::encounters(const SweptArm &step) const {
    int cost = 0, met = -1; // no one is met twice in a step
    for (const MovingObstacles::Visit *e : near_)
        if (e->slot != met && e->meets(step, ask_.need_mm)) {
            cost += e->cost;
            met = e->slot;
        }
    return cost;
}

// With those that may be there at any step.
int Search::look_always(const SweptArm &step) const {
    const Segment &mid = step.at[2];
    const Vec2 centre = middle(mid.a, mid.b);
    const double radius =
        0.5 * length(mid.b - mid.a) + step.displacement_bound_mm + step.extra_mm + ask_.need_mm;
    int cost = 0, met = -1;
    for (const int index : ask_.moving->always()) {
        const MovingObstacles::Visit &e = ask_.moving->visit(index);
        const Vec2 gap = e.centre - centre;
        const double touch = radius + e.radius_mm;
        if (e.slot == met || dot(gap, gap) >= touch * touch || !e.meets(step, ask_.need_mm)) continue;
        cost += e.cost;
        met = e.slot;
    }
    return cost;
}

int Search::always_encounters(Cell cell, VelocityChanges turn) {
    if (ask_.moving->always().empty()) return 0;
    Always &known = always_[81 * ask_.robot->index(cell) + turn.code()];
    if (known.round != round_) known = {round_, look_always(ask_.robot->swept(cell, turn))};
    return known.cost;
}

// Of one that comes down to its goal: with those that may be late then.
int Search::leg_encounters() const {
    int cost = 0, met = -1;
    for (const SweptArm &leg : ask_.robot->legs()) {
        cost += look_always(leg);
        for (const MovingObstacles::Visit *e : near_)
            if (e->late && e->slot != met && e->meets(leg, ask_.need_mm)) {
                cost += e->cost;
                met = e->slot;
            }
    }
    return cost;
}

// At rest at a cell; at the goal, on the legs to come as well.
int Search::rest_encounters(Cell cell) {
    const int rest = encounters(ask_.robot->swept(cell, {})) + always_encounters(cell, {});
    return cell == ask_.robot->goal() ? rest + leg_encounters() : rest;
}

int Search::encounters(Place at, VelocityChanges turn) {
    int cost = always_encounters(at.cell, turn);
    if (near_.empty()) return cost;
    // most are seen to be clear, or not, from mid-step alone
    const Segment here = ask_.robot->middle_line(at.cell, turn);
    const double room = ask_.need_mm + ask_.robot->bulge_mm() + ask_.robot->displacement_bound_mm(turn) +
                        ask_.robot->extra_mm();
    int met = -1;
    doubtful_.clear();
    for (const MovingObstacles::Visit *e : near_) {
        if (e->slot == met) continue;
        const double d2 = squared_distance(here, e->swept->at[2]);
        const double clear = room + e->swept->bulge_mm + e->swept->displacement_bound_mm + e->swept->extra_mm;
        if (d2 >= clear * clear) continue;
        if (shaped(*e) || d2 >= ask_.need_mm * ask_.need_mm) {
            doubtful_.push_back(e);
            continue;
        }
        cost += e->cost;
        met = e->slot;
        while (!doubtful_.empty() && doubtful_.back()->slot == met) doubtful_.pop_back();
    }
    if (doubtful_.empty()) return cost;
    const SweptArm swept = ask_.robot->swept(at.cell, turn);
    met = -1;
    for (const MovingObstacles::Visit *e : doubtful_)
        if (e->slot != met && e->meets(swept, ask_.need_mm)) {
            cost += e->cost;
            met = e->slot;
        }
    return cost;
}

// To rest at the last cell from here to the end.
void Search::finish(NodeId from, Place at) {
    const Node n = node(from);
    const Turning &turn = turnings_[n.move][stay];
    if (!ask_.robot->clear(at.cell, turn.changes)) return;
    const int cost = n.cost + turn.cost + encounters(at, turn.changes) + end_cost_[at.step + 1];
    if (cost >= best_) return;
    best_ = cost;
    last_ = from;
}

void Search::relax(Place at, const Node &here, int move) {
    const Turning &turn = turnings_[here.move][move];
    if (!turn.possible) return;
    const Place next{moved(at.cell, move), at.step + 1};
    if (!ask_.robot->inside(next.cell) || next.step + steps_to_go(next.cell) > last_step_) return;
    const int to_come = least_to_come(next, move);
    int cost = here.cost + turn.cost + beta_cost(at.cell);
    if (move == stay && !(at.cell == last_cell_)) cost += ask_.costs->wait;
    if (cost + to_come >= best_) return;
    const NodeId to = id(next);
    Node &m = node(to);
    if (m.closed || cost >= m.cost) return;
    if (!ask_.robot->clear(at.cell, turn.changes)) return;
    cost += encounters(at, turn.changes);
    if (cost >= m.cost || cost + to_come >= best_) return;
    m.cost = cost;
    m.move = static_cast<Move>(move);
    push(to, total(cost, to_come));
}

void Search::expand(NodeId from) {
    ++expansions_;
    const Place at = place(from);
    gather_near(at);
    if (at.cell == last_cell_) finish(from, at);
    if (at.step == last_step_) return;
    const Node here = node(from);
    // Of equals, the last is looked at first. So an arm unfolds as late as it can (beta stays or goes up),
    // and is out of the way of others until then.
    for (int move = 0; move < 9; ++move) relax(at, here, move);
}

void Search::trace() {
    path_.assign(ask_.steps + 1, last_cell_);
    Place at = place(last_);
    while (true) {
        path_[at.step] = at.cell;
        if (at.step == ask_.hold) break;
        const int back = 8 - node(id(at)).move; // the opposite move
        at = {moved(at.cell, back), at.step - 1};
    }
    std::fill(path_.begin(), path_.begin() + ask_.hold, first_cell());
    if (ask_.backward) std::reverse(path_.begin(), path_.end());
}

const List<Cell> &Search::run(const Request &request) {
    ask_ = request;
    begin();
    const NodeId first = id({first_cell(), ask_.hold});
    node(first).cost = hold_cost();
    push(first, total(node(first).cost, least_to_come({first_cell(), ask_.hold}, stay)));
    const std::int64_t last = ask_.most_expansions > 0 ? expansions_ + ask_.most_expansions : -1;
    undecided_ = false;
    for (NodeId from; pop(from);) {
        Node &n = node(from);
        if (n.closed) continue;
        n.closed = true;
        expand(from);
        if (expansions_ == last) {
            undecided_ = true;
            return path_;
        }
    }
    if (best_ < ask_.give_up) trace();
    return path_;
}

} // namespace fl::planning
