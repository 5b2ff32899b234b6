// What the rest of a path costs, nearly, from each cell at each step: encounters with neighbours, moves and
// waits. Found by dynamic programming back from the end, for all cells of a step at once.
//
// It sees the neighbours in mid-step alone, and no changes of speed; a search that is guided by it looks at
// little else than its path.
#pragma once

#include "guide/blocked_cells.hpp"

#include <algorithm>

namespace fl::planning {

class CostToGo {
  public:
    using Cost = std::int16_t;
    static constexpr Cost none = 30000;          // this much or more: as good as no path
    static constexpr Cost most_encounter = 4000; // an encounter costs no more here

    // Steps are counted in the direction of the search.
    struct Request {
        const Robot *robot = nullptr;
        Cell first, last;
        int hold = 0;      // the search begins after so many steps
        int last_step = 0; // by then it must rest at the last cell ...
        int steps = 0;     // ... to the end
        int move = 0, wait = 0;
        const List<int> *beta = nullptr; // of a step, per line of the beta grid; empty: nothing
    };

    // Forgets all; then encounters are added, then `find` is called.
    void begin(const Request &request);
    // Adds cells in which there is an encounter at a step. Of all calls since `begin`, `cost` has two values
    // at most; a cell that is added for both costs their sum.
    void block(int step, const BlockedLines &cells, int cost);
    void find();

    // Of a cell that can be come to by then, and from which the last cell can be come to in time.
    int from(Cell c, int step) const { return line(c.beta, step)[c.alpha]; }
    // The same of the cells around one: of that which is so many lines away.
    class Around {
      public:
        Around() = default;
        Around(const Cost *here, int pitch) : here_(here), pitch_(pitch) {}
        int from(int alphas, int betas) const { return here_[betas * pitch_ + alphas]; }

      private:
        const Cost *here_ = nullptr;
        int pitch_ = 0;
    };
    Around around(Cell c, int step) const { return {line(c.beta, step) + c.alpha, pitch_}; }
    int total() const { return from(ask_.first, ask_.hold); }

  private:
    // Lines of beta; the end is not part of them.
    struct Lines {
        int first = 1 << 20, end = 0;
        bool none() const { return first >= end; }
    };
    struct Blocked {
        int cost = 0;         // as it was asked for; 0: not in use
        List<CellBlock> bits; // of each step
        List<Lines> used;     // of each step: all bits of others are 0
        Cost encounter() const { return static_cast<Cost>(std::min<int>(cost, most_encounter)); }
    };
    // From a block of a line on, at a step; no bits: none.
    struct Encounters {
        const CellBlock *bits = nullptr;
        Cost cost = 0;
    };
    Encounters encounters(const Blocked &blocked, int beta, int block, int step) const {
        if (blocked.cost <= 0 || blocked.used[step].none()) return {};
        return {blocked.bits.data() + word(beta, block, step), blocked.encounter()};
    }
    // Lines of beta, and blocks of cells in them; the ends are not part of it.
    struct Box {
        int first_block, end_block, first_beta, end_beta;
        bool holds(int beta, int block) const {
            return beta >= first_beta && beta < end_beta && block >= first_block && block < end_block;
        }
    };

    // The costs of a line of cells, filled up to whole blocks; one beyond each of its ends, and the lines
    // beside the first and the last, can be read: none.
    int place(int beta, int step) const { return (step * (betas_ + 2) + beta + 1) * pitch_ + 1; }
    Cost *line(int beta, int step) { return costs_.data() + place(beta, step); }
    const Cost *line(int beta, int step) const { return costs_.data() + place(beta, step); }
    Cost &at_last(int step) { return line(ask_.last.beta, step)[ask_.last.alpha]; }
    int word(int beta, int block, int step) const { return (step * betas_ + beta) * blocks_ + block; }
    int dear(int beta) const { return ask_.beta->empty() ? 0 : (*ask_.beta)[beta]; }

    Box box_at(int step) const;
    void forget(Blocked &blocked) const;
    void forget_lines(int step, int first, int end);
    void forget_around(int step, const Box &box);
    void rest(int step);
    void step_back(int step, const Box &box);
    void column_back(int step, int block, const Box &box);
    Cost with_encounters(Cost cost, int step) const;

    Request ask_;
    int alphas_ = 0, betas_ = 0, blocks_ = 0, pitch_ = 0;
    Blocked blocked_[2];
    List<Box> boxes_;   // of each step
    List<Cost> costs_;  // of each step
    List<Cost> beyond_; // none where a line has no cell, 0 where it has
};

} // namespace fl::planning
