// Ways of two or three positioners at once, for those that interlock: none can go past the others where they
// will stand, so one of them has to wait for another half-way, and no sequence of single searches finds
// where.
//
// Weighted A* in the product of the grids, one step of time per move. The search begins at the
// crowded end: from the goals back in time, or from the starts. Others cost, as in the single search.
#pragma once

#include "search.hpp"

#include <array>
#include <cstdint>
#include <vector>

namespace fl::planning {

struct JointRequest {
    std::vector<Robot *> robots; // two or three
    std::vector<const Crowd *> crowds;
    std::vector<int> deadlines;
    int steps = 0;
    double need_mm = 0.0;
    bool backward = true;
    int most_nodes = 0; // given up beyond this
};

class JointSearch {
  public:
    static constexpr size_t most = 3;

    // True if there is a way for all within the deadline.
    bool run(const JointRequest &request);
    const std::vector<Cell> &way(size_t which) const { return ways_[which]; }
    size_t size() const { return nodes_.size(); }
    std::int64_t expansions() const { return expansions_; }

  private:
    using Cells = std::array<Cell, most>;
    using Moves = std::array<std::uint8_t, most>;
    struct Node {
        Cells cells;
        Moves moves; // by which it was reached
        int parent;
        int step;
        int cost;
        bool closed;
    };
    // What one of them can do from its cell: its nine moves, their motion, their cost among the others.
    struct Options {
        std::array<bool, 9> possible;
        std::array<Piece, 9> pieces;
        std::array<int, 9> cost;
        std::array<Cell, 9> next;
    };

    size_t count() const { return ask_.robots.size(); }
    Cells ends(bool first) const;
    Bends bends(int move_in, int move_out) const;
    int to_go(size_t which, Cell c) const;
    int estimate(const Cells &cells) const;
    int encounters(size_t which, const Piece &step, int when) const;
    void list_options(const Node &from);
    void list_options(size_t which, const Node &from);
    bool apart(size_t p, size_t q, size_t move_p, size_t move_q);
    void expand(int from);
    void combine(int from, size_t which, Moves &moves, int cost);
    void reach(int from, const Moves &moves, int cost);
    std::uint64_t key(const Cells &cells) const;
    int &slot(const Cells &cells);
    void grow_table();
    void push(int node);
    bool can_rest();
    void trace(int node);

    JointRequest ask_;
    std::vector<Node> nodes_;
    std::vector<int> table_; // open addressing; node or -1
    std::vector<std::uint64_t> queue_;
    std::array<Options, most> options_;
    // for each two and each of their moves: not looked at (0), apart (1), not (2)
    std::array<std::array<std::uint8_t, 81>, most * most> apart_;
    std::array<std::vector<Cell>, most> ways_;
    std::int64_t expansions_ = 0;
};

} // namespace fl::planning
