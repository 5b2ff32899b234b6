#include "robot.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

// How far an axis turns, in steps at most, from mid-step (with the corner cut) to the end of the step towards
// one line, when it is on the other line at the other end.
double way_from_middle(int towards, int other) {
    return std::abs(3 * towards - other) / 16.0 + std::abs(towards) / 4.0;
}

} // namespace

Robot::Robot(const Arm &arm, double from_mm, double to_mm, AxisGrid alpha, AxisGrid beta, double step_rad)
    : arm_(arm), from_mm_(from_mm), to_mm_(to_mm), alpha_(std::move(alpha)), beta_(std::move(beta)) {
    const double far = std::max(std::abs(from_mm), std::abs(to_mm)), l_a = std::abs(arm.l_alpha_mm);
    const double quarter = step_rad / quarters;
    // second derivative of the end's position over a quarter, at most: both axes at full speed
    bulge_mm_ = (l_a * quarter * quarter + far * 4.0 * quarter * quarter) / 8.0;
    for (int code = 0; code < 81; ++code) {
        const Bends b{{code / 27 - 1, code / 9 % 3 - 1}, {code / 3 % 3 - 1, code % 3 - 1}};
        const double turn_alpha =
            std::max(way_from_middle(b.alpha.from, b.alpha.to), way_from_middle(b.alpha.to, b.alpha.from));
        const double turn_beta =
            std::max(way_from_middle(b.beta.from, b.beta.to), way_from_middle(b.beta.to, b.beta.from));
        sways_[b.code()] =
            b.rests() ? 0.0 : (l_a * turn_alpha + far * (turn_alpha + turn_beta)) * step_rad + bulge_mm_;
    }
    widest_sway_mm_ = (l_a + 2.0 * far) * 0.5 * step_rad + bulge_mm_;
    reach_mm_ = l_a + far;
}

Piece Robot::piece(Cell c, Bends bends) const {
    if (bends.rests()) return standing(line(c));
    Piece piece;
    for (int k = 0; k <= quarters; ++k)
        piece.at[static_cast<size_t>(k)] =
            line(alpha_.turn(c.alpha, bends.alpha, k), beta_.turn(c.beta, bends.beta, k));
    piece.bulge_mm = bulge_mm_;
    piece.sway_mm = sways_[bends.code()];
    return piece;
}

void Robot::add_obstacle(const Segment &body, double need_mm) {
    if (distance({centre(), centre()}, body) > reach_mm_ + need_mm) return;
    obstacles_.push_back({standing(body), need_mm});
    states_.assign(static_cast<size_t>(cells()), unknown);
}

Robot::State Robot::look(Cell c) const {
    const Segment here = line(c);
    State state = all_clear;
    for (const Obstacle &o : obstacles_) {
        const double d = distance(here, o.piece.at[0]);
        if (d < o.need_mm - widest_sway_mm_) return none_clear;
        if (d < o.need_mm + widest_sway_mm_) state = some_clear;
    }
    return state;
}

bool Robot::clear(const Piece &piece) const {
    return std::all_of(obstacles_.begin(), obstacles_.end(),
                       [&](const Obstacle &o) { return stay_apart(piece, o.piece, o.need_mm); });
}

bool Robot::clear(Cell c, Bends bends) {
    if (obstacles_.empty()) return true;
    State &state = states_[static_cast<size_t>(index(c))];
    if (state == unknown) state = look(c);
    return state == some_clear ? clear(piece(c, bends)) : state == all_clear;
}

int Robot::steps_alone() {
    if (obstacles_.empty()) return travel_steps();
    std::vector<int> steps(static_cast<size_t>(cells()), -1);
    std::vector<Cell> queue{start()};
    steps[static_cast<size_t>(index(start()))] = 0;
    if (!clear(start(), {}) || !clear(goal(), {})) return -1;
    for (size_t k = 0; k < queue.size(); ++k) {
        const Cell here = queue[k];
        const int now = steps[static_cast<size_t>(index(here))];
        if (here == goal()) return now;
        for (int move = 0; move < 9; ++move) {
            const int a = move % 3 - 1, b = move / 3 - 1;
            const Cell next{here.alpha + a, here.beta + b};
            if (!inside(next) || steps[static_cast<size_t>(index(next))] >= 0) continue;
            if (!clear(here, {{0, a}, {0, b}}) || !clear(next, {{-a, 0}, {-b, 0}})) continue;
            steps[static_cast<size_t>(index(next))] = now + 1;
            queue.push_back(next);
        }
    }
    return -1;
}

} // namespace fl::planning
