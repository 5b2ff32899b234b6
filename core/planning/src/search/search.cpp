#include "search/search.hpp"

#include <algorithm>
#include <numeric>

namespace fl::planning {
namespace {

constexpr int beyond = 1 << 20; // steps; more than there are

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
    return NodeId((at.step * betas_ + at.cell.beta) * alphas_ + at.cell.alpha);
}

// At a line of one axis, with a speed.
Search::Line Search::line_at(int line, int last, int lines, int speed) {
    if (line < 0 || line >= lines) return {beyond, 0};
    return {std::abs(line - last), axis_changes(line, last, speed)};
}

// From a place that was reached by a move.
int Search::least_to_come(Place at, int move) const {
    const Line alpha = line_at(at.cell.alpha, last_cell_.alpha, alphas_, alpha_of(move));
    const Line beta = line_at(at.cell.beta, last_cell_.beta, betas_, beta_of(move));
    if (ask_.guide != nullptr) return changes_to_come(alpha, beta) + ask_.guide->from(at.cell, at.step);
    return changes_to_come(alpha, beta) + ask_.costs->move * (alpha.left + beta.left);
}

int Search::total(int cost, int to_come) const {
    return cost + (ask_.guide != nullptr ? ask_.costs->greed * to_come : to_come);
}

int Search::beta_cost(Cell c) const { return ask_.costs->beta.empty() ? 0 : ask_.costs->beta[c.beta]; }

// Whether the next one may lead to a path better than that found.
bool Search::may_help() { return !queue_.empty() && (best_ >= ask_.give_up || queue_.lowest() < best_); }

void Search::begin() {
    // backward, the time after the deadline comes first: it is spent at the goal
    if (ask_.backward) ask_.hold += ask_.steps - ask_.deadline;
    last_step_ = ask_.backward ? ask_.steps : ask_.deadline;
    last_cell_ = ask_.backward ? ask_.robot->start() : ask_.robot->goal();
    alphas_ = ask_.robot->alpha().size(), betas_ = ask_.robot->beta().size();
    const int size = ask_.robot->cells() * (ask_.steps + 1);
    if (nodes_.size() < size) nodes_.resize(size);
    const int turnings = ask_.moving->always().empty() ? 0 : 81 * ask_.robot->cells();
    if (always_.size() < turnings) always_.resize(turnings);
    if (++round_ > Node::most_rounds) { // the marks would repeat
        std::fill(nodes_.begin(), nodes_.end(), Node{});
        std::fill(always_.begin(), always_.end(), Always{});
        round_ = 1;
    }
    queue_.clear();
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

// What resting at a cell costs at each step from one to another; at the goal, on the legs to come as well.
void Search::list_rest(Cell cell, int from, int to) {
    const SweptArm here = ask_.robot->resting(cell);
    const bool at_goal = cell == ask_.robot->goal() && !ask_.robot->legs().empty();
    rest_cost_.assign(ask_.steps + 1, always_encounters(cell, {}));
    rest_met_.assign(ask_.steps + 1, -1);
    const Vec2 centre = middle(here.at[2].a, here.at[2].b);
    const double radius = 0.5 * length(here.at[2].b - here.at[2].a) + here.extra_mm + ask_.need_mm;
    const int first = ask_.backward ? ask_.steps - to : from, last = ask_.backward ? ask_.steps - from : to;
    for (const MovingObstacles::Visit &e : ask_.moving->visits()) {
        if (e.last < first || e.first > last || ask_.moving->is_always(e)) continue;
        if (!e.near(centre, radius) || !e.meets(here, ask_.need_mm)) continue;
        for (int k = e.first; k <= e.last; ++k) {
            const int step = ask_.backward ? ask_.steps - k : k;
            if (rest_met_[step] != e.slot) rest_cost_[step] += e.cost; // no one is met twice in a step
            rest_met_[step] = e.slot;
        }
    }
    for (int step = 0; at_goal && step <= ask_.steps; ++step) rest_cost_[step] += leg_encounters(step);
}

int Search::hold_cost() {
    if (ask_.hold == 0) return 0;
    list_rest(first_cell(), 0, ask_.hold - 1);
    return std::accumulate(rest_cost_.begin(), rest_cost_.begin() + ask_.hold, 0);
}

// What it costs to rest at the last cell to the end, from each step after it can be come to.
void Search::prepare_end() {
    list_rest(last_cell_, ask_.hold + steps_between(first_cell(), last_cell_) + 1, ask_.steps);
    end_cost_.assign(ask_.steps + 2, 0);
    if (!ask_.backward) end_cost_[ask_.steps + 1] = leg_encounters(ask_.steps);
    for (int step = ask_.steps; step >= 0; --step) end_cost_[step] = end_cost_[step + 1] + rest_cost_[step];
}

// Whether the centre lines alone do not tell that two touch.
bool Search::shaped(const MovingObstacles::Visit &e) const {
    return ask_.robot->shape() != nullptr || e.swept->shape != nullptr;
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
        if (e.slot == met || !e.near(centre, radius) || !e.meets(step, ask_.need_mm)) continue;
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
int Search::leg_encounters(int step) const {
    int cost = 0, met = -1;
    for (const SweptArm &leg : ask_.robot->legs()) {
        cost += look_always(leg);
        for (const int index : visits_at(step)) {
            const MovingObstacles::Visit &e = ask_.moving->visit(index);
            if (e.late && e.slot != met && e.meets(leg, ask_.need_mm)) {
                cost += e.cost;
                met = e.slot;
            }
        }
    }
    return cost;
}

int Search::encounters(Place at, VelocityChanges turn) {
    const int cost = always_encounters(at.cell, turn) + near_encounters(at, turn);
    return doubtful_.empty() ? cost : cost + doubtful_encounters(ask_.robot->swept(at.cell, turn));
}

// Most are seen to be clear, or not, from mid-step alone; the others are doubtful.
int Search::near_encounters(Place at, VelocityChanges turn) {
    const Robot &robot = *ask_.robot;
    const Segment here = robot.middle_line(at.cell, turn);
    const Vec2 centre = middle(here.a, here.b);
    const double way = robot.displacement_bound_mm(turn);
    const double room = ask_.need_mm + robot.bulge_mm() + way + robot.extra_mm();
    const double radius = 0.5 * length(here.b - here.a) + room;
    int cost = 0, met = -1; // no one is met twice in a step
    doubtful_.clear();
    for (const int index : visits_at(at.step)) {
        const MovingObstacles::Visit &e = ask_.moving->visit(index);
        if (!e.near(centre, radius) || e.slot == met) continue;
        const double d2 = squared_distance(here, e.swept->at[2]);
        const double clear = room + e.swept->bulge_mm + e.swept->displacement_bound_mm + e.swept->extra_mm;
        if (d2 >= clear * clear) continue;
        if (shaped(e) || d2 >= ask_.need_mm * ask_.need_mm) {
            doubtful_.push_back({&e, d2});
            continue;
        }
        cost += e.cost;
        met = e.slot;
        while (!doubtful_.empty() && doubtful_.back().visit->slot == met) doubtful_.pop_back();
    }
    return cost;
}

int Search::doubtful_encounters(const SweptArm &step) const {
    int cost = 0, met = -1;
    for (const auto &[e, squared_mm2] : doubtful_)
        if (e->slot != met && e->meets(step, std::sqrt(squared_mm2), ask_.need_mm)) {
            cost += e->cost;
            met = e->slot;
        }
    return cost;
}

// To rest at the last cell from here to the end.
void Search::finish(const Open &here) {
    const Place at = here.place();
    const Turning &turn = turnings_[here.move][stay];
    if (!ask_.robot->clear(at.cell, turn.changes)) return;
    const int cost = here.cost + turn.cost + encounters(at, turn.changes) + end_cost_[at.step + 1];
    if (cost >= best_) return;
    best_ = cost;
    last_ = at;
}

Search::Leaving Search::leaving(const Open &here) const {
    const Place at = here.place(), later{at.cell, at.step + 1};
    const Costs &costs = *ask_.costs;
    const bool guided = ask_.guide != nullptr;
    return {at,
            turnings_[here.move],
            here.cost + beta_cost(at.cell),
            id(later),
            guided,
            guided ? ask_.guide->around(at.cell, later.step) : CostToGo::Around(),
            costs.move,
            costs.velocity_change,
            at.cell == last_cell_ ? 0 : costs.wait,
            guided ? costs.greed : 1};
}

// To the cells on a line of beta, the next one or the same, as least_to_come tells what is still to come.
void Search::relax(const Leaving &from, int way, const Line (&alpha)[3]) {
    const Cell cell = from.at.cell;
    const int step = from.at.step + 1, left = last_step_ - step;
    const Line beta = line_at(cell.beta + way, last_cell_.beta, betas_, way);
    if (beta.left > left) return;
    for (int a = -1; a <= 1; ++a) {
        const int move = 3 * way + a + stay;
        const Line &line = alpha[a + 1];
        const Turning &turn = from.turnings[move];
        if (!turn.possible || line.left > left) continue;
        if (closed(NodeId(from.same.value() + way * alphas_ + a))) continue;
        int to_come = from.velocity_change * (line.changes + beta.changes);
        to_come += from.guided ? from.guide.from(a, way) : from.move * (line.left + beta.left);
        const int cost = from.cost + turn.cost + (move == stay ? from.wait : 0);
        if (cost + to_come < best_)
            queue_.push(Open({{cell.alpha + a, cell.beta + way}, step}, cost, move),
                        cost + from.greed * to_come);
    }
}

// Whether the last step of a way, to here, keeps it the best one. If it meets others the way goes back into
// the queue.
bool Search::look(Open open) {
    if (open.looked_at) return true;
    const Place at = open.place(), before{moved(at.cell, 8 - open.move), at.step - 1};
    const VelocityChanges turn = turnings_[nodes_[id(before)].move()][open.move].changes;
    if (!ask_.robot->clear(before.cell, turn)) return false;
    const int met = encounters(before, turn);
    if (met == 0) return true;
    open.cost += met;
    open.looked_at = true;
    const int to_come = least_to_come(at, open.move);
    if (open.cost + to_come < best_) queue_.push(open, total(open.cost, to_come));
    return false;
}

// The cells that a step leads to, on three lines of beta, are on their way from memory before they are asked
// for.
void Search::fetch_around(NodeId same) const {
    for (int way = -1; way <= 1; ++way) {
        const int at = same.value() + way * alphas_;
        if (at >= 0 && at < nodes_.size()) __builtin_prefetch(&nodes_[NodeId(at)]);
    }
}

void Search::expand(const Open &here) {
    const Place at = here.place();
    ++expansions_;
    if (at.step < last_step_) fetch_around(id({at.cell, at.step + 1}));
    nodes_[id(at)] = {round_, here.move};
    if (at.cell == last_cell_) finish(here);
    if (at.step == last_step_) return;
    Line alpha[3];
    for (int way = -1; way <= 1; ++way)
        alpha[way + 1] = line_at(at.cell.alpha + way, last_cell_.alpha, alphas_, way);
    // Of equals, the last is looked at first. So an arm unfolds as late as it can (beta stays or goes up),
    // and is out of the way of others until then.
    const Leaving from = leaving(here);
    for (int way = -1; way <= 1; ++way) relax(from, way, alpha);
}

void Search::trace() {
    path_.assign(ask_.steps + 1, last_cell_);
    Place at = last_;
    while (true) {
        path_[at.step] = at.cell;
        if (at.step == ask_.hold) break;
        const int back = 8 - nodes_[id(at)].move(); // the opposite move
        at = {moved(at.cell, back), at.step - 1};
    }
    std::fill(path_.begin(), path_.begin() + ask_.hold, first_cell());
    if (ask_.backward) std::reverse(path_.begin(), path_.end());
}

const List<Cell> &Search::run(const Request &request) {
    ask_ = request;
    begin();
    const Place first{first_cell(), ask_.hold};
    const int cost = hold_cost();
    queue_.push(Open(first, cost, stay, true), total(cost, least_to_come(first, stay)));
    const std::int64_t last = ask_.most_expansions > 0 ? expansions_ + ask_.most_expansions : -1;
    undecided_ = false;
    while (may_help()) {
        const Open open = queue_.pop();
        if (closed(id(open.place())) || !look(open)) continue;
        expand(open);
        if (expansions_ == last) {
            undecided_ = true;
            return path_;
        }
    }
    if (best_ < ask_.give_up) trace();
    return path_;
}

} // namespace fl::planning
