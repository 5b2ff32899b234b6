#include "guide/pair_flood.hpp"

#include "motion/clones.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>

namespace fl::planning {
namespace {

constexpr int fewer_steps = 4; // by which there is less time, until there is room

// The words of a cell and of those beside it, of the same number each; at the border of a box one of them is
// there twice.
struct Beside {
    const std::uint64_t *below, *here, *above;
};

// words: of the cell at `first`, of so many cells. at: a cell in them or next to them; pitch: from one to the
// next, in words.
FL_INLINE Beside beside(const std::uint64_t *words, int first, int end, int at, int pitch) {
    return {words + (std::max(at - 1, first) - first) * pitch,
            words + (std::clamp(at, first, end - 1) - first) * pitch,
            words + (std::min(at + 1, end - 1) - first) * pitch};
}

using Words = std::uint64_t __attribute__((vector_size(8 * words_at_once)));
FL_INLINE Words load(const std::uint64_t *p) {
    Words v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
FL_INLINE void store(std::uint64_t *p, Words v) { std::memcpy(p, &v, sizeof v); }
FL_INLINE Words joined(const Beside &from, int k) {
    return load(from.below + k) | load(from.here + k) | load(from.above + k);
}
FL_INLINE bool any_of(Words v) { return (v[0] | v[1] | v[2] | v[3]) != 0; }

// All of them in one.
FL_INLINE void join(const Beside &from, int count, std::uint64_t *out) {
    for (int k = 0; k < count; k += words_at_once) store(out + k, joined(from, k));
}

// Of these those that are free; whether there are any.
FL_INLINE bool join_free(const Beside &from, const std::uint64_t *free, int count, std::uint64_t *out) {
    Words any{};
    for (int k = 0; k < count; k += words_at_once) {
        const Words left = joined(from, k) & load(free + k);
        store(out + k, left);
        any |= left;
    }
    return any_of(any);
}

// Of some words what is apart; whether any is left.
FL_INLINE bool keep_apart(const std::uint64_t *apart, int count, std::uint64_t *out) {
    Words any{};
    for (int k = 0; k < count; k += words_at_once) {
        const Words left = load(out + k) & load(apart + k);
        store(out + k, left);
        any |= left;
    }
    return any_of(any);
}

// Each bit, those beside it, and those on the lines beside it.
FL_INLINE void spread_lines(const std::uint64_t *from, int count, std::uint64_t *out) {
    for (int k = 0; k < count; k += words_at_once) {
        const Words lines = joined({from + k - 1, from + k, from + k + 1}, 0);
        store(out + k, lines | lines << 1 | lines >> 1);
    }
}

// Whether a grid has so many lines of alpha that those that are kept are chosen by where it can come to.
bool is_fine(const Robot &robot) { return robot.alpha().size() > FloodSide::most_alphas + 1; }

// Whether it can come to its goal from a line of alpha, past the bodies at rest.
bool comes_from(Robot &robot, int alpha) {
    const List<int> &from_goal = robot.steps_from_goal();
    for (int beta = 0; beta < robot.beta().size(); ++beta)
        if (from_goal[robot.index({alpha, beta})] >= 0) return true;
    return false;
}

// Of those of alpha that are kept: around its way, or, of a fine grid, from the first one that it can come
// to.
int first_line(Robot &robot) {
    const int all = robot.alpha().size(), last = all - std::min(all, FloodSide::most_alphas);
    if (!is_fine(robot))
        return std::clamp((robot.start().alpha + robot.goal().alpha - FloodSide::most_alphas) / 2, 0, last);
    int first = 0;
    while (first < last && !comes_from(robot, first)) ++first;
    return first;
}

} // namespace

bool FloodSide::holds(Robot &robot) {
    const int first = first_line(robot), end = first + most_alphas;
    const auto kept = [&](Cell c) { return c.alpha >= first && c.alpha < end; };
    if (!kept(robot.start()) || !kept(robot.goal())) return false;
    for (int alpha = end; is_fine(robot) && alpha < robot.alpha().size(); ++alpha)
        if (comes_from(robot, alpha)) return false;
    return true;
}

void FloodSide::begin(Robot &robot, int deadline, int steps) {
    start_ = robot.start(), goal_ = robot.goal();
    deadline_ = deadline;
    betas_ = robot.beta().size();
    blocks_ = BlockedCells::blocks_per_line(robot);
    alphas_ = std::min(robot.alpha().size(), most_alphas);
    first_alpha_ = first_line(robot);
    busy_.assign((steps + 1) * betas_, 0);
    still_free_.assign(betas_, 0);
    const List<int> &from_goal = robot.steps_from_goal();
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
    const std::uint64_t here = std::uint64_t{1} << (end.alpha - first_alpha_);
    return here | here << 1 | here >> 1;
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
    std::int64_t begin = beyond, words = 0; // words before the first cell are read
    for (int step = 0; step <= steps; ++step) {
        const Layer layer{box(sides_[0], step), box(sides_[1], step), begin};
        for (const Box &one : {layer.first, layer.second})
            if (one.width() <= 0 || one.lines() <= 0) return 0;
        begin += layer.room();
        words += layer.words();
        layers_.push_back(layer);
    }
    return words;
}

// False if one cannot arrive in time even alone.
bool PairFlood::lay_out_within(int steps) {
    latest_ = steps;
    std::int64_t words = lay_out(steps);
    while (words > most_words) {
        latest_ -= fewer_steps;
        words = lay_out(steps);
    }
    if (words == 0) return false;
    if (const std::int64_t room = layers_.back().begin + layers_.back().room() + beyond; room_ < room) {
        words_ = std::make_unique_for_overwrite<std::uint64_t[]>(static_cast<std::size_t>(room));
        room_ = room;
    }
    return true;
}

// Where both are at an end, or next to it.
void PairFlood::keep_ends_apart(Cell first, int at) {
    const FloodSide &one = sides_[0], &second = sides_[1];
    for (int beta = 0; beta < second.betas(); ++beta) {
        if (FloodSide::around(first, one.start()))
            apart_[at + beyond + beta] |= second.around(second.start(), beta);
        if (FloodSide::around(first, one.goal()))
            apart_[at + beyond + beta] |= second.around(second.goal(), beta);
    }
}

const std::uint64_t *PairFlood::apart_from(Cell first, const Touching &touching) {
    const FloodSide &second = sides_[1];
    int &at = apart_at_[first.beta * FloodSide::most_alphas + first.alpha - sides_[0].first_alpha()];
    if (at < 0) {
        at = apart_.size();
        apart_.resize(at + pitch_of(second.betas()) + words_at_once, ~std::uint64_t{0});
        const BlockedLines cells = touching(first);
        for (int beta = cells.first; beta < cells.end; ++beta)
            apart_[at + beyond + beta] = ~second.word(cells.bits + (beta - cells.first) * second.blocks());
        keep_ends_apart(first, at);
    }
    return apart_.data() + at;
}

// From a line of beta of the first one by all moves of the second, then by all moves of alpha of the first.
FL_INLINE void PairFlood::spread_row(const Layer &from, const Layer &to, int beta, std::uint64_t *out) {
    const int pitch = to.pitch(), from_pitch = from.pitch(), cells = from.first.width();
    const std::uint64_t *here = words_.get() + from.begin + (beta - from.first.beta) * cells * from_pitch +
                                to.second.beta - from.second.beta;
    for (int cell = 0; cell < cells; ++cell)
        spread_lines(here + cell * from_pitch, pitch, spread_.data() + cell * pitch);
    for (int alpha = to.first.alpha; alpha < to.first.end_alpha; ++alpha, out += pitch)
        join(beside(spread_.data(), from.first.alpha, from.first.end_alpha, alpha, pitch), pitch, out);
}

// Lines of the second one at a step: cells in its box in which nothing is in its way.
void PairFlood::list_free(int step, const Box &box) {
    const std::uint64_t inside =
        (box.width() >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << box.width()) - 1)
        << (box.alpha - sides_[1].first_alpha());
    free_.assign(pitch_of(box.lines()), 0);
    for (int beta = box.beta; beta < box.end_beta; ++beta)
        free_[beyond + beta - box.beta] = inside & sides_[1].free(beta, step);
}

// Line by line of beta of the first one: no more than three that are spread are needed at once, which stay
// near at hand. False if there are no cells left.
FL_CLONES bool PairFlood::step_back(int step, const Touching &touching) {
    const Layer &from = layers_[step + 1], &to = layers_[step];
    list_free(step, to.second);
    const int pitch = to.pitch(), row = to.first.width() * pitch;
    if (const int words = from.first.width() * pitch; spread_.size() < words) spread_.resize(words);
    if (wide_.size() < rows_at_hand * row) wide_.resize(rows_at_hand * row);
    const auto wide = [&](int beta) {
        const int there = std::clamp(beta, from.first.beta, from.first.end_beta - 1);
        return wide_.data() + there % rows_at_hand * row;
    };
    std::uint64_t *out = words_.get() + to.begin;
    bool any = false;
    int spread = std::max(to.first.beta - 1, from.first.beta); // the next line
    for (int beta = to.first.beta; beta < to.first.end_beta; ++beta) {
        for (; spread < std::min(beta + 2, from.first.end_beta); ++spread)
            spread_row(from, to, spread, wide(spread));
        Beside rows{wide(beta - 1), wide(beta), wide(beta + 1)};
        for (int alpha = to.first.alpha; alpha < to.first.end_alpha; ++alpha, out += pitch) {
            const Cell c{alpha, beta};
            if (!sides_[0].free(c, step))
                std::fill(out, out + pitch, 0);
            else if (join_free(rows, free_.data(), pitch, out))
                any |= keep_apart(apart_from(c, touching) + to.second.beta, pitch, out);
            rows = {rows.below + pitch, rows.here + pitch, rows.above + pitch};
        }
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
    std::fill_n(words_.get() + last.begin, last.room(), 0);
    words_[last.begin + beyond] = std::uint64_t{1} << (q.alpha - sides_[1].first_alpha());
    for (int step = steps - 1; step >= 0; --step)
        if (!step_back(step, touching)) return false;
    return holds(0, sides_[0].start(), sides_[1].start());
}

bool PairFlood::holds(int step, Cell first, Cell second) const {
    const Layer &layer = layers_[step];
    if (!layer.first.holds(first) || !layer.second.holds(second)) return false;
    const std::int64_t at =
        layer.begin + layer.first.place(first) * layer.pitch() + beyond + second.beta - layer.second.beta;
    return (words_[at] >> (second.alpha - sides_[1].first_alpha()) & 1) != 0;
}

int PairFlood::rest_from(int which) const {
    const FloodSide &side = sides_[which];
    int step = layers_.size() - 1;
    while (step > 0 && side.free(side.goal(), step - 1)) --step;
    return step;
}

} // namespace fl::planning
