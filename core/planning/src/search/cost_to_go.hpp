// What the rest of a path costs, nearly, from each cell at each step: encounters with neighbours, moves and
// waits. Found by dynamic programming back from the end, for all cells of a step at once.
//
// It sees the neighbours in mid-step alone, and no changes of speed; a search that is guided by it looks at
// little else than its path.
#pragma once

#include "search/blocked_cells.hpp"

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
    void block(int step, const CellBits *cells, int cost);
    void find();

    // Of a cell that can be come to by then, and from which the last cell can be come to in time.
    int from(Cell c, int step) const { return line(c.beta, step)[c.alpha]; }
    int total() const { return from(ask_.first, ask_.hold); }

  private:
    struct Blocked {
        int cost = 0;        // as it was asked for; 0: not in use
        List<CellBits> bits; // of each step
    };

    int words() const { return betas_ * words_per_line_; }
    // The costs of a line of cells, filled up to whole blocks; one beyond each of its ends, and the lines
    // beside the first and the last, can be read: none.
    int place(int beta, int step) const { return (step * (betas_ + 2) + beta + 1) * pitch_ + 1; }
    Cost *line(int beta, int step) { return costs_.data() + place(beta, step); }
    const Cost *line(int beta, int step) const { return costs_.data() + place(beta, step); }
    Cost &at_last(int step) { return line(ask_.last.beta, step)[ask_.last.alpha]; }
    int dear(int beta) const { return ask_.beta->empty() ? 0 : (*ask_.beta)[beta]; }

    // Lines of beta, and blocks of cells in them; the ends are not part of it.
    struct Box {
        int first_block, end_block, first_beta, end_beta;
    };
    Box box_at(int step) const;
    void forget(int step, const Box &box);
    void rest(int step);
    void step_back(int step, const Box &box);
    void add_encounters(int step, const Box &box, const Blocked &blocked);

    Request ask_;
    int alphas_ = 0, betas_ = 0, blocks_ = 0, pitch_ = 0, words_per_line_ = 0;
    Blocked blocked_[2];
    List<Cost> costs_;  // of each step
    List<Cost> across_; // of a step: the cheapest of three neighbours in alpha
};

} // namespace fl::planning
