#include "search/cost_to_go.hpp"

#include "motion/clones.hpp"

#include <algorithm>
#include <array>
#include <cstring>

namespace fl::planning {
namespace {

using Cost = CostToGo::Cost;

// The bits of eight cells as masks: all ones where the bit is set.
constexpr std::size_t at_once = 8;
using Eight = std::array<Cost, at_once>;
constexpr auto masks = [] {
    std::array<Eight, 1 << at_once> out{};
    for (std::size_t bits = 0; bits < out.size(); ++bits)
        for (std::size_t k = 0; k < at_once; ++k) out[bits][k] = static_cast<Cost>(bits >> k & 1 ? -1 : 0);
    return out;
}();

using Cost16 = Cost __attribute__((vector_size(32)));
constexpr int lanes = 16;

FL_INLINE Cost16 load(const Cost *p) {
    Cost16 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
FL_INLINE void store(Cost *p, Cost16 v) { std::memcpy(p, &v, sizeof v); }
FL_INLINE Cost16 lower(Cost16 a, Cost16 b) { return a < b ? a : b; }
FL_INLINE Cost16 cheapest_beside(const Cost *next) { return lower(load(next - 1), load(next + 1)); }

Cost lower(Cost a, Cost b) { return a < b ? a : b; }
Cost plus(Cost a, int b) { return static_cast<Cost>(std::min<int>(a + b, CostToGo::none)); }

// What an encounter costs, where the mask is set; no more than none. The compiler makes one instruction of
// it.
void add(Eight &cells, const Eight &mask, Cost encounter) {
    const Cost highest = static_cast<Cost>(CostToGo::none - encounter);
    for (std::size_t k = 0; k < at_once; ++k) {
        const Cost with = static_cast<Cost>(lower(cells[k], highest) + encounter);
        cells[k] = static_cast<Cost>((with & mask[k]) | (cells[k] & ~mask[k]));
    }
}

} // namespace

void CostToGo::begin(const Request &request) {
    ask_ = request;
    alphas_ = request.robot->alpha().size();
    betas_ = request.robot->beta().size();
    blocks_ = (alphas_ + lanes - 1) / lanes;
    pitch_ = blocks_ * lanes + 2;
    words_per_line_ = BlockedCells::words_per_line(*request.robot);
    for (Blocked &blocked : blocked_) blocked.cost = 0;
    costs_.resize((request.steps + 1) * (betas_ + 2) * pitch_ + lanes);
    across_.assign((betas_ + 2) * pitch_ + lanes, none);
}

void CostToGo::block(int step, const CellBits *cells, int cost) {
    Blocked &blocked = blocked_[blocked_[0].cost == 0 || blocked_[0].cost == cost ? 0 : 1];
    if (blocked.cost == 0) blocked.bits.assign((ask_.steps + 1) * words(), 0);
    blocked.cost = cost;
    CellBits *out = blocked.bits.data() + step * words();
    for (int k = 0; k < words(); ++k) out[k] |= cells[k];
}

void CostToGo::find() {
    for (int step = ask_.steps; step >= ask_.hold; --step) {
        const Box box = box_at(step);
        forget(step, box);
        if (step >= ask_.last_step)
            rest(step);
        else
            step_back(step, box);
        for (const Blocked &blocked : blocked_)
            if (blocked.cost > 0) add_encounters(step, box, blocked);
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

// Nothing is known of the cells of a step, and of those around them that are looked at from the step before.
void CostToGo::forget(int step, const Box &box) {
    const int first = std::max(box.first_beta - 2, -1), last = std::min(box.end_beta + 1, betas_);
    std::fill(line(first, step) - 1, line(last, step) - 1 + pitch_, none);
}

// At the last cell, for good.
void CostToGo::rest(int step) { at_last(step) = step == ask_.steps ? Cost{0} : at_last(step + 1); }

// By one move from each cell to the next step.
FL_CLONES void CostToGo::step_back(int step, const Box &box) {
    const Cost move = static_cast<Cost>(ask_.move), wait = static_cast<Cost>(ask_.wait);
    for (int beta = box.first_beta - 1; beta <= box.end_beta; ++beta) {
        if (beta < 0 || beta >= betas_) continue;
        const Cost *next = line(beta, step + 1);
        Cost *across = across_.data() + place(beta, 0);
        for (int a = box.first_block * lanes; a < box.end_block * lanes; a += lanes)
            store(across + a, lower(load(next + a), cheapest_beside(next + a) + move));
    }
    for (int beta = box.first_beta; beta < box.end_beta; ++beta) {
        const Cost *next = line(beta, step + 1);
        const Cost *above = across_.data() + place(beta + 1, 0), *below = across_.data() + place(beta - 1, 0);
        Cost *out = line(beta, step);
        const Cost moved = static_cast<Cost>(move + dear(beta)),
                   waited = static_cast<Cost>(wait + dear(beta));
        for (int a = box.first_block * lanes; a < box.end_block * lanes; a += lanes) {
            const Cost16 other = lower(cheapest_beside(next + a), lower(load(below + a), load(above + a)));
            const Cost16 best = lower(other + moved, load(next + a) + waited);
            store(out + a, lower(best, Cost16{} + none));
        }
        std::fill(out + alphas_, out + blocks_ * lanes, none);
    }
    at_last(step) = lower(at_last(step), plus(at_last(step + 1), dear(ask_.last.beta)));
}

void CostToGo::add_encounters(int step, const Box &box, const Blocked &blocked) {
    const Cost encounter = static_cast<Cost>(std::min<int>(blocked.cost, most_encounter));
    const CellBits *bits = blocked.bits.data() + step * words() + box.first_beta * words_per_line_;
    for (int beta = box.first_beta; beta < box.end_beta; ++beta)
        for (int w = 0; w < words_per_line_; ++w) {
            Cost *costs = line(beta, step) + w * BlockedCells::bits;
            for (CellBits hit = *bits++; hit != 0; hit >>= at_once, costs += at_once) {
                Eight cells;
                std::copy_n(costs, at_once, cells.begin());
                add(cells, masks[hit % masks.size()], encounter);
                std::copy_n(cells.begin(), at_once, costs);
            }
        }
}

} // namespace fl::planning
