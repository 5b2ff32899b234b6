#include "search/cost_to_go.hpp"

#include <algorithm>
#include <array>

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
    pitch_ = alphas_ + 2;
    words_per_line_ = BlockedCells::words_per_line(*request.robot);
    for (Blocked &blocked : blocked_) blocked.cost = 0;
    // eight cells that begin in the last line may end beyond it
    costs_.assign((request.steps + 1) * (betas_ + 2) * pitch_ + static_cast<int>(at_once), none);
    across_.assign((betas_ + 2) * pitch_, none);
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
        if (step >= ask_.last_step)
            rest(step);
        else
            step_back(step);
        for (const Blocked &blocked : blocked_)
            if (blocked.cost > 0) add_encounters(step, blocked);
    }
}

// At the last cell, for good.
void CostToGo::rest(int step) { at_last(step) = step == ask_.steps ? Cost{0} : at_last(step + 1); }

// By one move from each cell to the next step. The compiler makes one instruction of several cells here.
void CostToGo::step_back(int step) {
    const Cost move = static_cast<Cost>(ask_.move), wait = static_cast<Cost>(ask_.wait);
    for (int beta = 0; beta < betas_; ++beta) {
        const Cost *next = line(beta, step + 1);
        Cost *across = across_.data() + place(beta, 0);
        for (int a = 0; a < alphas_; ++a) {
            const Cost beside = static_cast<Cost>(lower(next[a - 1], next[a + 1]) + move);
            across[a] = lower(next[a], beside);
        }
    }
    for (int beta = 0; beta < betas_; ++beta) {
        const Cost *next = line(beta, step + 1);
        const Cost *above = across_.data() + place(beta + 1, 0), *below = across_.data() + place(beta - 1, 0);
        Cost *out = line(beta, step);
        const Cost moved = static_cast<Cost>(move + dear(beta)),
                   waited = static_cast<Cost>(wait + dear(beta));
        for (int a = 0; a < alphas_; ++a) {
            const Cost other = lower(lower(next[a - 1], next[a + 1]), lower(below[a], above[a]));
            const Cost best = lower(static_cast<Cost>(other + moved), static_cast<Cost>(next[a] + waited));
            out[a] = lower(best, none);
        }
    }
    at_last(step) = lower(at_last(step), plus(at_last(step + 1), dear(ask_.last.beta)));
}

void CostToGo::add_encounters(int step, const Blocked &blocked) {
    const Cost encounter = static_cast<Cost>(std::min<int>(blocked.cost, most_encounter));
    const CellBits *bits = blocked.bits.data() + step * words();
    for (int beta = 0; beta < betas_; ++beta)
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
