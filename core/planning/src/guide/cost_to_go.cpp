#include "guide/cost_to_go.hpp"

#include "motion/clones.hpp"

#include <algorithm>
#include <cstring>

namespace fl::planning {
namespace {

using Cost = CostToGo::Cost;

using Cost16 = Cost __attribute__((vector_size(32)));
constexpr int lanes = BlockedCells::block;

FL_INLINE Cost16 load(const Cost *p) {
    Cost16 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
FL_INLINE void store(Cost *p, Cost16 v) { std::memcpy(p, &v, sizeof v); }
FL_INLINE Cost16 lower(Cost16 a, Cost16 b) { return a < b ? a : b; }
FL_INLINE Cost16 higher(Cost16 a, Cost16 b) { return a < b ? b : a; }

Cost lower(Cost a, Cost b) { return a < b ? a : b; }
Cost plus(Cost a, int b) { return static_cast<Cost>(std::min<int>(a + b, CostToGo::none)); }

// The bits of sixteen cells as masks: all ones where the bit is set.
FL_INLINE Cost16 mask_of(CellBlock bits) {
    constexpr Cost last = static_cast<Cost>(1 << 15);
    constexpr Cost16 of_lane{1,      1 << 1, 1 << 2,  1 << 3,  1 << 4,  1 << 5,  1 << 6,  1 << 7,
                             1 << 8, 1 << 9, 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, last};
    return ((Cost16{} + static_cast<Cost>(bits)) & of_lane) != Cost16{};
}

// Of some lines: a cell, or a block and a cell.
FL_INLINE void forget_column(Cost *out, int pitch, int lines, bool block) {
    constexpr Cost none = CostToGo::none;
    for (int k = 0; k < lines; ++k) out[k * pitch] = none;
    for (int k = 0; block && k < lines; ++k) store(out + k * pitch + 1, Cost16{} + none);
}

// What a step from the cells of a line costs, without what it costs to leave them: to stay on the line and
// move, and from a line beside it.
struct Towards {
    Cost16 here, beside, across;
};
FL_INLINE Towards towards(const Cost *next, Cost move) {
    const Cost16 here = load(next), beside = lower(load(next - 1), load(next + 1));
    return {here, beside, lower(here, beside + move)};
}

// With an encounter where the bits are set; no more than none.
FL_INLINE Cost16 with_encounter(Cost16 cost, CellBlock bits, Cost encounter) {
    const Cost16 more = mask_of(bits) & (Cost16{} + encounter);
    return lower(cost, CostToGo::none - more) + more;
}

} // namespace

void CostToGo::begin(const Request &request) {
    for (Blocked &blocked : blocked_) forget(blocked);
    ask_ = request;
    alphas_ = request.robot->alpha().size();
    betas_ = request.robot->beta().size();
    blocks_ = BlockedCells::blocks_per_line(*request.robot);
    pitch_ = blocks_ * lanes + 2;
    boxes_.clear();
    for (int step = 0; step <= ask_.steps; ++step) boxes_.push_back(box_at(step));
    const int size = (request.steps + 1) * (betas_ + 2) * pitch_ + lanes;
    if (costs_.size() < size) costs_.resize(size);
    beyond_.assign(blocks_ * lanes, none);
    std::fill(beyond_.begin(), beyond_.begin() + alphas_, Cost{0});
}

// What was blocked of the grid asked for before.
void CostToGo::forget(Blocked &blocked) const {
    if (blocked.cost == 0) return;
    blocked.cost = 0;
    CellBlock *const bits = blocked.bits.data();
    for (int step = 0; step < blocked.used.size(); ++step)
        if (const Lines &used = blocked.used[step]; !used.none())
            std::fill(bits + word(used.first, 0, step), bits + word(used.end, 0, step), CellBlock{0});
}

// Those of the box alone are looked at.
FL_CLONES void CostToGo::block(int step, const BlockedLines &cells, int cost) {
    const int first = std::max(cells.first, boxes_[step].first_beta);
    const int end = std::min(cells.end, boxes_[step].end_beta);
    if (first >= end) return;
    Blocked &blocked = blocked_[blocked_[0].cost == 0 || blocked_[0].cost == cost ? 0 : 1];
    if (blocked.cost == 0) {
        const int size = (ask_.steps + 1) * betas_ * blocks_;
        if (blocked.bits.size() < size) blocked.bits.resize(size, 0);
        blocked.used.assign(ask_.steps + 1, {});
    }
    blocked.cost = cost;
    Lines &used = blocked.used[step];
    used = {std::min(used.first, first), std::max(used.end, end)};
    const CellBlock *from = cells.bits + (first - cells.first) * blocks_;
    CellBlock *out = blocked.bits.data() + word(first, 0, step);
    for (int k = 0; k < (end - first) * blocks_; ++k) out[k] |= from[k];
}

void CostToGo::find() {
    for (int step = ask_.steps; step >= ask_.hold; --step) {
        if (step >= ask_.last_step)
            rest(step);
        else
            step_back(step, boxes_[step]);
    }
}

// Cells that can be come to by a step, and from which the last cell can be come to in time.
CostToGo::Box CostToGo::box_at(int step) const {
    const int gone = step - ask_.hold, left = std::max(ask_.last_step - step, 0);
    const Cell p = ask_.first, q = ask_.last;
    const auto low = [&](int from, int to) { return std::max({from - gone, to - left, 0}); };
    const auto high = [&](int from, int to, int size) {
        return std::min({from + gone, to + left, size - 1}) + 1;
    };
    return {low(p.alpha, q.alpha) / lanes, (high(p.alpha, q.alpha, alphas_) + lanes - 1) / lanes,
            low(p.beta, q.beta), high(p.beta, q.beta, betas_)};
}

// Of a step before the last cell is come to for good: all cells from which it may be looked at.
void CostToGo::forget_lines(int step, int first, int end) {
    first = std::max(first, -1), end = std::min(end, betas_ + 1);
    if (first < end) std::fill(line(first, step) - 1, line(end - 1, step) - 1 + pitch_, none);
}

// Nothing is known of the cells around a box that are looked at from the step before: two lines beside it,
// and a block and a cell.
FL_CLONES void CostToGo::forget_around(int step, const Box &box) {
    forget_lines(step, box.first_beta - 2, box.first_beta);
    forget_lines(step, box.end_beta, box.end_beta + 2);
    const int betas = box.end_beta - box.first_beta;
    const bool below = box.first_block > 0, above = box.end_block < blocks_;
    Cost *const first = line(box.first_beta, step) + box.first_block * lanes;
    Cost *const end = line(box.first_beta, step) + box.end_block * lanes;
    forget_column(first - (below ? lanes : 0) - 1, pitch_, betas, below);
    forget_column(end, pitch_, betas, above);
}

// At the last cell, for good.
void CostToGo::rest(int step) {
    forget_lines(step, ask_.last.beta - 2, ask_.last.beta + 3);
    at_last(step) = with_encounters(step == ask_.steps ? Cost{0} : at_last(step + 1), step);
}

// By one move from each cell to the next step.
FL_CLONES void CostToGo::step_back(int step, const Box &box) {
    forget_around(step, box);
    for (int block = box.first_block; block < box.end_block; ++block) column_back(step, block, box);
    if (!box.holds(ask_.last.beta, ask_.last.alpha / lanes)) return;
    const Cost stays = plus(at_last(step + 1), dear(ask_.last.beta));
    at_last(step) = lower(at_last(step), with_encounters(stays, step));
}

// Of one block of each line, from line to line. All that is read is in local variables: what is stored could
// be part of any member.
FL_INLINE void CostToGo::column_back(int step, int block, const Box &box) {
    const Cost move = static_cast<Cost>(ask_.move), wait = static_cast<Cost>(ask_.wait);
    const int pitch = pitch_, blocks = blocks_, lines = box.end_beta - box.first_beta;
    const Cost *next = line(box.first_beta, step + 1) + block * lanes;
    Cost *out = line(box.first_beta, step) + block * lanes;
    const int *dear_line = ask_.beta->empty() ? nullptr : ask_.beta->data() + box.first_beta;
    const Encounters first = encounters(blocked_[0], box.first_beta, block, step);
    const Encounters second = encounters(blocked_[1], box.first_beta, block, step);
    const Cost16 no_cell = load(beyond_.data() + block * lanes), highest = Cost16{} + none;
    Towards below = towards(next - pitch, move), same = towards(next, move);
    for (int k = 0; k < lines; ++k, out += pitch) {
        next += pitch;
        const Towards above = towards(next, move);
        const Cost16 other = lower(same.beside, lower(below.across, above.across)) + move;
        Cost16 best = lower(other, same.here + wait);
        if (dear_line != nullptr) best += static_cast<Cost>(dear_line[k]);
        best = higher(lower(best, highest), no_cell);
        if (first.bits != nullptr) best = with_encounter(best, first.bits[k * blocks], first.cost);
        if (second.bits != nullptr) best = with_encounter(best, second.bits[k * blocks], second.cost);
        store(out, best);
        below = same;
        same = above;
    }
}

// Of the last cell.
Cost CostToGo::with_encounters(Cost cost, int step) const {
    const int block = ask_.last.alpha / lanes, lane = ask_.last.alpha % lanes;
    for (const Blocked &blocked : blocked_)
        if (blocked.cost > 0 && (blocked.bits[word(ask_.last.beta, block, step)] >> lane & 1) != 0)
            cost = plus(cost, blocked.encounter());
    return cost;
}

} // namespace fl::planning
