// From which cells, at which steps, two positioners still get to their goals in time: both at once, past each
// other and past all others, whose motion is given.
//
// A flood of both grids at once, back in time from the goals: a bit for each two cells, 64 to a word, all
// moves of a step by shifts. It sees arms in mid-step alone, as the guide of a single search does, and no
// changes of speed. So where it finds nothing there is hardly a way, and a search that keeps to it seldom
// goes astray.
#pragma once

#include "guide/blocked_cells.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <memory>

namespace fl::planning {

// One of the two.
class FloodSide {
  public:
    static constexpr int most_alphas = 64; // lines, a bit each; of more, some are left out

    // Whether its ends are among the lines that are kept, and few others are left out: of a fine grid none
    // that it can come to, as in a pocket.
    static bool holds(Robot &robot);

    void begin(Robot &robot, int deadline, int steps);
    // Others are in the way of these cells at a step. at_end: they rest where they begin or end; starts and
    // goals keep clear of each other though they may be nearer than a flood takes for clear.
    void block(int step, const BlockedLines &cells, bool at_end);

    int betas() const { return betas_; }
    int deadline() const { return deadline_; }
    Cell start() const { return start_; }
    Cell goal() const { return goal_; }
    int first_alpha() const { return first_alpha_; }
    int end_alpha() const { return first_alpha_ + alphas_; }
    // A bit for each line of alpha.
    std::uint64_t free(int beta, int step) const { return still_free_[beta] & ~busy_[step * betas_ + beta]; }
    bool free(Cell c, int step) const { return (free(c.beta, step) >> (c.alpha - first_alpha_) & 1) != 0; }
    std::uint64_t word(const CellBlock *line) const;
    int blocks() const { return blocks_; }
    // Cells at the end, and around it, of a line of beta.
    static bool around(Cell c, Cell end) { return steps_between(c, end) <= 1; }
    std::uint64_t around(Cell end, int beta) const;

  private:
    static int steps_between(Cell p, Cell q) {
        return std::max(std::abs(p.alpha - q.alpha), std::abs(p.beta - q.beta));
    }
    Cell start_, goal_;
    int deadline_ = 0, betas_ = 0, first_alpha_ = 0, alphas_ = 0, blocks_ = 0;
    List<std::uint64_t> still_free_; // of each line of beta: past the bodies at rest
    List<std::uint64_t> busy_;       // of each step, of each line of beta
};

inline constexpr int words_at_once = 4; // that are stepped back

class PairFlood {
  public:
    FloodSide &side(int which) { return sides_[which]; }
    // touching: the cells of the second one that touch the first one at a cell.
    using Touching = std::function<BlockedLines(Cell)>;
    // Whether both can get from their starts to their goals in so many steps. Where that would take too much
    // room, they have less time than their deadlines.
    bool run(int steps, const Touching &touching);
    // Whether they can from these cells at this step.
    bool holds(int step, Cell first, Cell second) const;
    // From which step on the goal of one is free to the end.
    int rest_from(int which) const;

  private:
    static constexpr int rows_at_hand = 4;                 // that are spread
    static constexpr std::int64_t most_words = 16'000'000; // 128 MB

    // Lines of both axes, the ends not among them.
    struct Box {
        int alpha, end_alpha, beta, end_beta;
        int width() const { return end_alpha - alpha; }
        int lines() const { return end_beta - beta; }
        int place(Cell c) const { return (c.beta - beta) * width() + c.alpha - alpha; }
        bool holds(Cell c) const {
            return c.alpha >= alpha && c.alpha < end_alpha && c.beta >= beta && c.beta < end_beta;
        }
    };
    // Of a step: the cells at which each may be. A word for each cell of the first one and each line of beta
    // of the second, from begin on; so many more before and after these, which are 0, that lines beside the
    // first and the last can be read, and all words taken so many at once.
    static constexpr int beyond = 2; // words
    static int pitch_of(int lines) {
        return (lines + 2 * beyond + words_at_once - 1) / words_at_once * words_at_once;
    }
    struct Layer {
        Box first, second;
        std::int64_t begin = 0;
        std::int64_t cells() const { return static_cast<std::int64_t>(first.width()) * first.lines(); }
        std::int64_t words() const { return cells() * second.lines(); }
        int pitch() const { return pitch_of(second.lines()); }
        std::int64_t room() const { return cells() * pitch(); }
    };
    Box box(const FloodSide &side, int step) const;
    std::int64_t lay_out(int steps);
    bool lay_out_within(int steps);
    void keep_ends_apart(Cell first, int at);
    const std::uint64_t *apart_from(Cell first, const Touching &touching);
    void spread_row(const Layer &from, const Layer &to, int beta, std::uint64_t *out);
    void list_free(int step, const Box &box);
    bool step_back(int step, const Touching &touching);

    FloodSide sides_[2];
    int latest_ = 0;                         // neither has more time than this
    List<Layer> layers_;                     // of each step
    std::unique_ptr<std::uint64_t[]> words_; // of a layer once it is stepped back to
    std::int64_t room_ = 0;                  // for so many words
    // A step back, of lines of beta of the first one: by moves of the second one; and by alpha of the first.
    List<std::uint64_t> spread_, wide_;
    List<std::uint64_t> free_;  // lines of the second one at a step
    List<std::uint64_t> apart_; // lines of the second one for each cell of the first, once asked for
    List<int> apart_at_;        // where they begin; -1: not asked for
};

} // namespace fl::planning
