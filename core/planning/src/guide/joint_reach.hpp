// Whether two positioners can get from their starts to their goals past each other at all, however long it
// takes, if all others that move are absent: whether both lie in one connected part of their joint
// configuration space, which has four dimensions.
//
// A flood of both grids at once, from the starts and from the goals in turn: a bit for each two cells, 64 to
// a word. It is over as soon as they meet, or one of the two can grow no more. A cell stands for all angles
// that are nearer to it than to others: it is shut only if the arms overlap at all of them. So where no way
// is found there is none.
#pragma once

#include "guide/blocked_cells.hpp"

#include <cstdint>

namespace fl::planning {

class JointReach {
  public:
    using Word = std::uint64_t;

    // Words that two such grids take; of the first one those cells count that it can come to alone.
    static std::int64_t words(const Robot &first, const Robot &second);
    static constexpr std::int64_t most_words = 2'000'000; // 16 MB, three times

    // Whether it is proven that there is no way. need_mm: between both centre lines, beside extra radii.
    // @pre both keep nothing in hand; the words are not more than the most.
    bool none(const Robot &first, const Robot &second, double need_mm);

  private:
    // What can be come to from one end.
    struct Flood {
        List<Word> reached; // of each place of the first one, of each line of beta of the second
        List<int> queue;    // places of the first one around which it has grown
        int next = 0;
        List<std::uint8_t> queued;
        bool ended() const { return next == queue.size(); }
    };
    // Cells that one can come to alone from its start or its goal, in a fixed order.
    struct Places {
        List<Cell> cells;
        List<int> of; // of each cell, by its index; -1: it cannot be come to
    };
    static Places places_of(const Robot &robot);
    int place(Cell c) const { return first_->inside(c) ? places_.of[first_->index(c)] : -1; }
    int size() const { return betas_ * width_; }
    int word(Cell second) const;
    Word *reached(Flood &flood, int place) const { return flood.reached.data() + place * size(); }
    void begin(const Robot &first, const Robot &second, double need_mm);
    void begin(Flood &flood, Cell first, Cell second);
    const Word *open(int place);
    void grow(Flood &flood);
    void put_around(Flood &flood, Cell here);
    void meet(int place);
    bool add_line(const Word *from, const Word *within, Word *to) const;
    bool add_around(const Word *from, const Word *within, Word *to) const;
    void fill(const Word *within, Word *to) const;

    const Robot *first_ = nullptr, *second_ = nullptr;
    double need_mm_ = 0.0;      // less what a cell stands for
    Places places_;             // of the first one
    int betas_ = 0, width_ = 0; // lines of beta of the second one, words of each
    List<Word> alone_;          // of the second one, past the bodies at rest
    List<Word> open_;           // of each place of the first one, once it is known
    List<std::uint8_t> known_;
    BlockedCells blocked_;
    TouchTables tables_;
    Flood floods_[2];
    List<Word> around_;
    bool met_ = false;
};

} // namespace fl::planning
