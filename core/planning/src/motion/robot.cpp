#include "motion/robot.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

// How far an axis turns, in steps at most, from mid-step (with the corner cut) to the end of the step towards
// one line, when it is on the other line at the other end.
double way_from_middle(int towards, int other) {
    return std::abs(3 * towards - other) / 16.0 + std::abs(towards) / 4.0;
}

double longest_way(VelocityChange change) {
    return std::max(way_from_middle(change.from, change.to), way_from_middle(change.to, change.from));
}

} // namespace

Robot::Robot(const ArmBody &body, AxisGrid alpha, AxisGrid beta, double step_rad)
    : body_(body), limbs_(body.resting({})), alpha_(std::move(alpha)), beta_(std::move(beta)) {
    bulge_mm_ = step_bulge_mm(body, step_rad);
    for (int code = 0; code < 81; ++code) {
        const VelocityChanges c{{code / 27 - 1, code / 9 % 3 - 1}, {code / 3 % 3 - 1, code % 3 - 1}};
        const double turn_alpha = longest_way(c.alpha), turn_beta = longest_way(c.beta);
        displacement_bounds_[c.code()] =
            c.rests() ? 0.0 : body.way_mm(turn_alpha, turn_alpha + turn_beta) * step_rad + bulge_mm_;
    }
    widest_displacement_mm_ = body.way_mm(1.0, 2.0) * 0.5 * step_rad + bulge_mm_;
}

SweptArm Robot::swept(Cell c, VelocityChanges changes) const {
    if (changes.rests()) return resting(c);
    SweptArm swept;
    for (int k = 0; k <= quarters; ++k)
        swept.at[k] = body_.line(alpha_.turn(c.alpha, changes.alpha, k), beta_.turn(c.beta, changes.beta, k));
    swept.bulge_mm = bulge_mm_ + in_hand_mm(c);
    swept.displacement_bound_mm = displacement_bound_mm(changes);
    swept.extra_mm = body_.extra_mm;
    swept.shape = body_.shape;
    return swept;
}

SweptArm Robot::swept(Cell near, const Angles (&at)[quarters + 1]) const {
    SweptArm swept;
    for (int k = 0; k <= quarters; ++k)
        swept.at[k] = body_.line(alpha_.turn_at(at[k].alpha_rad), beta_.turn_at(at[k].beta_rad));
    swept.bulge_mm = bulge_mm_ + in_hand_mm(near);
    swept.extra_mm = body_.extra_mm;
    swept.shape = body_.shape;
    measure_displacement_bound(swept);
    return swept;
}

// What is kept in hand counts as if the arm bulged so much more.
void Robot::keep_in_hand(double mm, double free_rad) {
    in_hand_mm_ = mm;
    free_rad_ = free_rad;
    widest_displacement_mm_ += mm;
    for (double &bound : displacement_bounds_)
        if (bound > 0.0) bound += mm;
}

bool Robot::within_free(Cell c, Cell end) const {
    return std::abs(alpha_.angle(c.alpha) - alpha_.angle(end.alpha)) <= free_rad_ &&
           std::abs(beta_.angle(c.beta) - beta_.angle(end.beta)) <= free_rad_;
}

double Robot::in_hand_mm(Cell c) const {
    return in_hand_mm_ == 0.0 || within_free(c, start()) || within_free(c, goal()) ? 0.0 : in_hand_mm_;
}

void Robot::set_legs(List<SweptArm> legs) {
    legs_ = std::move(legs);
    const Segment here = line(goal());
    for (const SweptArm &leg : legs_)
        widest_displacement_mm_ = std::max(widest_displacement_mm_,
                                           limbs_move_mm(leg, here, leg.at[2]) + leg.displacement_bound_mm);
}

void Robot::add_obstacle(const SweptArm &body, double need_mm) {
    const double extra = extra_mm() + body.extra_mm;
    if (distance({centre(), centre()}, body.at[0]) > reach_mm() + need_mm + in_hand_mm_ + extra) return;
    if (shape() == nullptr && body.shape == nullptr && (body.layers & first_layer) == 0) return;
    obstacles_.push_back({body, need_mm});
    clearances_.assign(cells(), unknown);
}

Robot::Clearance Robot::look(Cell c) const {
    const Segment here = line(c);
    Clearance clearance = all_clear;
    for (const Obstacle &o : obstacles_) {
        const double d = distance(here, o.swept.at[0]);
        const double need = o.need_mm + extra_mm() + o.swept.extra_mm;
        const bool shaped = shape() != nullptr || o.swept.shape != nullptr;
        if (!shaped && d < need - widest_displacement_mm_) return none_clear;
        if (d < need + widest_displacement_mm_) clearance = some_clear;
    }
    return clearance;
}

bool Robot::clear(const SweptArm &swept) const {
    return std::all_of(obstacles_.begin(), obstacles_.end(),
                       [&](const Obstacle &o) { return stay_apart(swept, o.swept, o.need_mm); });
}

bool Robot::may_be_at(Cell c) const {
    const SweptArm here = resting(c);
    return std::all_of(obstacles_.begin(), obstacles_.end(), [&](const Obstacle &o) {
        return stay_apart(here, o.swept, o.need_mm - widest_displacement_mm_);
    });
}

bool Robot::clear(Cell c, VelocityChanges changes) {
    if (obstacles_.empty()) return true;
    Clearance &clearance = clearances_[index(c)];
    if (clearance == unknown) clearance = look(c);
    return clearance == some_clear ? clear(swept(c, changes)) : clearance == all_clear;
}

// A step to a neighbouring cell, from rest to rest.
bool Robot::clear_move(Cell here, Cell next) {
    const int a = next.alpha - here.alpha, b = next.beta - here.beta;
    return clear(here, {{0, a}, {0, b}}) && clear(next, {{-a, 0}, {-b, 0}});
}

Robot::Flood Robot::flood(Cell from, std::optional<Cell> until) {
    Flood out{{from}, List<int>(cells(), -1)};
    out.steps[index(from)] = 0;
    for (int k = 0; k < out.cells.size(); ++k) {
        const Cell here = out.cells[k];
        if (here == until) break;
        for (int move = 0; move < 9; ++move) {
            const Cell next{here.alpha + move % 3 - 1, here.beta + move / 3 - 1};
            if (!inside(next) || out.steps[index(next)] >= 0 || !clear_move(here, next)) continue;
            out.steps[index(next)] = out.steps[index(here)] + 1;
            out.cells.push_back(next);
        }
    }
    return out;
}

// Whether nothing at rest is in the way if both axes go at once until the nearer one is at its goal.
bool Robot::straight_is_clear() {
    const auto towards = [](int from, int to) { return from + (to > from) - (to < from); };
    for (Cell here = start(), next; !(here == goal()); here = next) {
        next = {towards(here.alpha, goal().alpha), towards(here.beta, goal().beta)};
        if (!clear_move(here, next)) return false;
    }
    return true;
}

int Robot::steps_alone() {
    if (obstacles_.empty()) return travel_steps();
    if (!clear(start(), {}) || !clear(goal(), {})) return -1;
    return straight_is_clear() ? travel_steps() : flood(start(), goal()).steps[index(goal())];
}

List<Cell> Robot::way_alone() {
    if (!clear(start(), {}) || !clear(goal(), {})) return {};
    const List<int> steps = flood(start(), goal()).steps;
    if (steps[index(goal())] < 0) return {};
    List<Cell> way{goal()};
    while (!(way.back() == start())) {
        const Cell here = way.back();
        for (int move = 0; move < 9; ++move) {
            const Cell before{here.alpha + move % 3 - 1, here.beta + move / 3 - 1};
            if (!inside(before) || steps[index(before)] != steps[index(here)] - 1 ||
                !clear_move(before, here))
                continue;
            way.push_back(before);
            break;
        }
    }
    std::reverse(way.begin(), way.end());
    return way;
}

const List<int> &Robot::steps_from(Cell end, List<int> &known) {
    if (known.empty()) known = flood(end, {}).steps;
    return known;
}

const List<int> &Robot::steps_from_goal() { return steps_from(goal(), from_goal_); }

const List<int> &Robot::steps_from_start() { return steps_from(start(), from_start_); }

List<Cell> Robot::reachable() {
    if (!clear(start(), {})) return {};
    return flood(start(), {}).cells;
}

} // namespace fl::planning
