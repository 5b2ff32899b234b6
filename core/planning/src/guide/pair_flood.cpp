#include "guide/pair_flood.hpp"

#include "motion/clones.hpp"

#include <algorithm>
#include <cstdlib>

namespace fl::planning {
namespace {

constexpr int fewer_steps = 4; // by which there is less time, until there is room

// The words of a cell and of those beside it, of the same number each; at the border of a box one of them is
// there twice.
struct Beside {
    const std::uint64_t *below, *here, *above;

    // words: of the cell at `first`, of so many cells. at: a cell in them or next to them; pitch: from one to
    // the next, in words.
    Beside(const std::uint64_t *words, int first, int end, int at, int pitch)
        : below(words + (std::max(at - 1, first) - first) * pitch),
          here(words + (std::clamp(at, first, end - 1) - first) * pitch),
          above(words + (std::min(at + 1, end - 1) - first) * pitch) {}
};

// All of them in one.
FL_INLINE void join(const Beside &from, int count, std::uint64_t *__restrict out) {
    const std::uint64_t *__restrict below = from.below, *__restrict here = from.here,
                                    *__restrict above = from.above;
    for (int k = 0; k < count; ++k) out[k] = below[k] | here[k] | above[k];
}

// Of these those that are free; whether there are any.
FL_INLINE bool join_free(const Beside &from, const std::uint64_t *__restrict free, int count,
                         std::uint64_t *__restrict out) {
    const std::uint64_t *__restrict below = from.below, *__restrict here = from.here,
                                    *__restrict above = from.above;
    std::uint64_t any = 0;
    for (int k = 0; k < count; ++k) {
        out[k] = (below[k] | here[k] | above[k]) & free[k];
        any |= out[k];
    }
    return any != 0;
}

// Each bit, and those beside it.
FL_INLINE std::uint64_t with_beside(std::uint64_t word) { return word | word << 1 | word >> 1; }

// A line and those beside it, of those that there are.
FL_INLINE std::uint64_t around_line(const std::uint64_t *from, int first, int end, int beta) {
    std::uint64_t word = 0;
    for (int b = std::max(beta - 1, first); b <= std::min(beta + 1, end - 1); ++b) word |= from[b - first];
    return with_beside(word);
}

// Of all lines, those beside them included, to lines that may begin and end one earlier or later. Lines
// between two others, which are most, are taken several at once.
FL_INLINE void spread_lines(const std::uint64_t *__restrict from, int from_first, int from_end,
                            std::uint64_t *__restrict out, int first, int end) {
    const int low = std::clamp(from_first + 1, first, end), high = std::clamp(from_end - 1, low, end);
    for (int beta = first; beta < low; ++beta)
        out[beta - first] = around_line(from, from_first, from_end, beta);
    const std::uint64_t *__restrict here = from + (low - from_first);
    std::uint64_t *__restrict to = out + (low - first);
    for (int k = 0; k < high - low; ++k) to[k] = with_beside(here[k - 1] | here[k] | here[k + 1]);
    for (int beta = high; beta < end; ++beta)
        out[beta - first] = around_line(from, from_first, from_end, beta);
}

// Of some words what is apart; whether any is left.
FL_INLINE bool keep_apart(const std::uint64_t *__restrict apart, int count, std::uint64_t *__restrict out) {
    std::uint64_t any = 0;
    for (int k = 0; k < count; ++k) {
        out[k] &= apart[k];
        any |= out[k];
    }
    return any != 0;
}

// Of those of alpha that are kept: around its way.
int first_line(const Robot &robot) {
    const int all = robot.alpha().size(), middle = (robot.start().alpha + robot.goal().alpha) / 2;
    const int kept = std::min(all, FloodSide::most_alphas);
    return std::clamp(middle - FloodSide::most_alphas / 2, 0, all - kept);
}

} // namespace

bool FloodSide::holds(const Robot &robot) {
    const int first = first_line(robot);
    const auto kept = [&](Cell c) { return c.alpha >= first && c.alpha < first + most_alphas; };
    return robot.alpha().size() <= most_alphas + 1 && kept(robot.start()) && kept(robot.goal());
}

void FloodSide::begin(const Robot &robot, int deadline, int steps, const List<int> &from_goal) {
    start_ = robot.start(), goal_ = robot.goal();
    deadline_ = deadline;
    betas_ = robot.beta().size();
    blocks_ = BlockedCells::blocks_per_line(robot);
    alphas_ = std::min(robot.alpha().size(), most_alphas);
    first_alpha_ = first_line(robot);
    busy_.assign((steps + 1) * betas_, 0);
    still_free_.assign(betas_, 0);
    for (int beta = 0; beta < betas_; ++beta)
        for (int k = 0; k < alphas_; ++k)
            if (from_goal[robot.index({first_alpha_ + k, beta})] >= 0)
                still_free_[beta] |= std::uint64_t{1} << k;
}

// The bits of a line of blocks, from the first line of alpha on.
std::uint64_t FloodSide::word(const CellBlock *line) const {
    std::uint64_t out = 0;
    for (int k = 0; k < blocks_; ++k) {
        const int at = k * BlockedCells::block - first_alpha_;
        const std::uint64_t bits = line[k];
        if (at >= most_alphas || at <= -BlockedCells::block) continue;
        out |= at >= 0 ? bits << at : bits >> -at;
    }
    return out;
}

std::uint64_t FloodSide::around(Cell end, int beta) const {
    if (std::abs(beta - end.beta) > 1) return 0;
    return with_beside(std::uint64_t{1} << (end.alpha - first_alpha_));
}

void FloodSide::block(int step, const BlockedLines &cells, bool at_end) {
    for (int beta = cells.first; beta < cells.end; ++beta) {
        std::uint64_t bits = word(cells.bits + (beta - cells.first) * blocks_);
        if (at_end) bits &= ~(around(start_, beta) | around(goal_, beta));
        busy_[step * betas_ + beta] |= bits;
    }
}

// The cells that can be come to by a step, and from which the goal can be come to in time.
PairFlood::Box PairFlood::box(const FloodSide &side, int step) const {
    const int left = std::max(std::min(side.deadline(), latest_) - step, 0);
    const Cell p = side.start(), q = side.goal();
    const auto low = [&](int from, int to, int least) { return std::max({from - step, to - left, least}); };
    const auto end = [&](int from, int to, int most) {
        return std::min({from + step, to + left, most - 1}) + 1;
    };
    return {low(p.alpha, q.alpha, side.first_alpha()), end(p.alpha, q.alpha, side.end_alpha()),
            low(p.beta, q.beta, 0), end(p.beta, q.beta, side.betas())};
}

// The words of all layers; 0 if one cannot arrive in time even alone.
std::int64_t PairFlood::lay_out(int steps) {
    layers_.clear();
    std::int64_t begin = 0;
    for (int step = 0; step <= steps; ++step) {
        const Layer layer{box(sides_[0], step), box(sides_[1], step), begin};
        for (const Box &one : {layer.first, layer.second})
            if (one.width() <= 0 || one.lines() <= 0) return 0;
        begin += layer.words();
        layers_.push_back(layer);
    }
    return begin;
}

// False if one cannot arrive in time even alone.
bool PairFlood::lay_out_within(int steps) {
    latest_ = steps;
    std::int64_t words = lay_out(steps);
    while (words > most_words) {
        latest_ -= fewer_steps;
        words = lay_out(steps);
    }
    if (room_ < words) {
        words_ = std::make_unique_for_overwrite<std::uint64_t[]>(static_cast<std::size_t>(words));
        room_ = words;
    }
    return words > 0;
}

// Where both are at an end, or next to it.
void PairFlood::keep_ends_apart(Cell first, int at) {
    const FloodSide &one = sides_[0], &second = sides_[1];
    for (int beta = 0; beta < second.betas(); ++beta) {
        if (FloodSide::around(first, one.start())) apart_[at + beta] |= second.around(second.start(), beta);
        if (FloodSide::around(first, one.goal())) apart_[at + beta] |= second.around(second.goal(), beta);
    }
}

const std::uint64_t *PairFlood::apart_from(Cell first, const Touching &touching) {
    const FloodSide &second = sides_[1];
    int &at = apart_at_[first.beta * FloodSide::most_alphas + first.alpha - sides_[0].first_alpha()];
    if (at < 0) {
        at = apart_.size();
        apart_.resize(at + second.betas(), ~std::uint64_t{0});
        const BlockedLines cells = touching(first);
        for (int beta = cells.first; beta < cells.end; ++beta)
            apart_[at + beta] = ~second.word(cells.bits + (beta - cells.first) * second.blocks());
        keep_ends_apart(first, at);
    }
    return apart_.data() + at;
}

// From each cell of the first one by all moves of the second.
FL_CLONES void PairFlood::spread_second(const Layer &from, const Layer &to) {
    const int cells = from.first.width() * from.first.lines();
    const int lines = to.second.lines(), from_lines = from.second.lines();
    if (spread_.size() < cells * lines) spread_.resize(cells * lines);
    for (int cell = 0; cell < cells; ++cell)
        spread_lines(words_.get() + from.begin + cell * from_lines, from.second.beta, from.second.end_beta,
                     spread_.data() + cell * lines, to.second.beta, to.second.end_beta);
}

// Then by all moves of alpha of the first one, line by line of its beta.
FL_CLONES void PairFlood::spread_alpha(const Layer &from, const Layer &to) {
    const int lines = to.second.lines(), rows = from.first.lines();
    if (const int words = rows * to.first.width() * lines; wide_.size() < words) wide_.resize(words);
    std::uint64_t *out = wide_.data();
    for (int row = 0; row < rows; ++row) {
        const std::uint64_t *in_row = spread_.data() + row * from.first.width() * lines;
        for (int alpha = to.first.alpha; alpha < to.first.end_alpha; ++alpha, out += lines)
            join({in_row, from.first.alpha, from.first.end_alpha, alpha, lines}, lines, out);
    }
}

// Lines of the second one at a step: cells in its box in which nothing is in its way.
void PairFlood::list_free(int step, const Box &box) {
    const std::uint64_t inside =
        (box.width() >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << box.width()) - 1)
        << (box.alpha - sides_[1].first_alpha());
    free_.clear();
    for (int beta = box.beta; beta < box.end_beta; ++beta)
        free_.push_back(inside & sides_[1].free(beta, step));
}

// False if there are no cells left.
FL_CLONES bool PairFlood::step_back(int step, const Touching &touching) {
    const Layer &from = layers_[step + 1], &to = layers_[step];
    spread_second(from, to);
    spread_alpha(from, to);
    list_free(step, to.second);
    const int lines = to.second.lines(), width = to.first.width() * lines;
    bool any = false;
    for (int beta = to.first.beta; beta < to.first.end_beta; ++beta)
        for (int alpha = to.first.alpha; alpha < to.first.end_alpha; ++alpha) {
            const Cell c{alpha, beta};
            std::uint64_t *out = words_.get() + to.begin + to.first.place(c) * lines;
            if (!sides_[0].free(c, step)) {
                std::fill(out, out + lines, 0);
                continue;
            }
            const Beside beside(wide_.data() + (alpha - to.first.alpha) * lines, from.first.beta,
                                from.first.end_beta, beta, width);
            if (join_free(beside, free_.data(), lines, out))
                any |= keep_apart(apart_from(c, touching) + to.second.beta, lines, out);
        }
    return any;
}

bool PairFlood::run(int steps, const Touching &touching) {
    if (!lay_out_within(steps)) return false;
    apart_.clear();
    apart_at_.assign(FloodSide::most_alphas * sides_[0].betas(), -1);
    const Layer &last = layers_[steps];
    const Cell p = sides_[0].goal(), q = sides_[1].goal();
    if (!sides_[0].free(p, steps) || !sides_[1].free(q, steps)) return false;
    words_[last.begin] = std::uint64_t{1} << (q.alpha - sides_[1].first_alpha());
    for (int step = steps - 1; step >= 0; --step)
        if (!step_back(step, touching)) return false;
    return holds(0, sides_[0].start(), sides_[1].start());
}

bool PairFlood::holds(int step, Cell first, Cell second) const {
    const Layer &layer = layers_[step];
    if (!layer.first.holds(first) || !layer.second.holds(second)) return false;
    const std::int64_t at =
        layer.begin + layer.first.place(first) * layer.second.lines() + second.beta - layer.second.beta;
    return (words_[at] >> (second.alpha - sides_[1].first_alpha()) & 1) != 0;
}

int PairFlood::rest_from(int which) const {
    const FloodSide &side = sides_[which];
    int step = layers_.size() - 1;
    while (step > 0 && side.free(side.goal(), step - 1)) --step;
    return step;
}

} // namespace fl::planning
