// Paths of two or three positioners at once, for those that interlock: none can pass the others where they
// will rest, so one of them has to wait for another half-way, and no sequence of single searches finds
// where.
//
// Weighted A* in the product of the grids, one step of time per move. The search begins at the
// crowded end: from the goals back in time, or from the starts. Others cost, as in the single search.
#pragma once

#include "guide/key_table.hpp"
#include "guide/pair_flood.hpp"
#include "search/search.hpp"

#include <cstdint>

namespace fl::planning {

struct JointRequest {
    List<Robot *> robots; // two or three
    List<const MovingObstacles *> moving;
    List<int> deadlines;
    int steps = 0;
    double need_mm = 0.0;
    bool backward = true;
    int most_nodes = 0; // given up beyond this
    // From where two still get to their goals: no other cells are looked at, and what touches others is shut.
    // Only forward.
    const PairFlood *flood = nullptr;
};

class JointSearch {
  public:
    static constexpr int most = 3;

    // True if there are paths for all within the deadlines.
    bool run(const JointRequest &request);
    const List<Cell> &path(int which) const { return paths_[which]; }
    std::int64_t expansions() const { return expansions_; }
    // Of the last run.
    int nodes() const { return nodes_.size(); }

  private:
    using NodeId = Index<struct JointNodeKind>;
    struct Cells {
        Cell of[most];
        friend bool operator==(const Cells &, const Cells &) = default;
    };
    struct Moves {
        Move of[most];
    };
    struct Node {
        Cells cells;
        Moves moves; // by which it was reached
        NodeId parent;
        int step;
        int cost;
        bool closed;
    };
    // What one of them can do from its cell: its nine moves, what they sweep, their cost among the others.
    struct Options {
        bool possible[9];
        SweptArm swept[9];
        int cost[9];
        Cell next[9];
    };
    enum Pairing : std::uint8_t { not_looked_at, apart_from, touching };

    int count() const { return ask_.robots.size(); }
    Cells ends(bool first) const;
    int to_go(int which, Cell c) const;
    int to_go_past(int which, Cell c) const;
    int estimate(const Cells &cells) const;
    int encounters(int which, const SweptArm &step, int when) const;
    void list_options(const Node &from);
    void list_options(int which, const Node &from);
    bool apart(int p, int q, int move_p, int move_q);
    bool apart_from_before(int which, const Moves &moves);
    void expand(NodeId from);
    void combine(NodeId from, int which, Moves &moves, int cost);
    void reach(NodeId from, const Moves &moves, int cost);
    std::uint64_t key(const Cells &cells, int step) const;
    void push(NodeId node);
    NodeId pop();
    bool can_rest();
    void trace(NodeId node);

    JointRequest ask_;
    List<Node, NodeId> nodes_;
    KeyTable<NodeId> known_;
    std::vector<std::uint64_t> queue_;
    Options options_[most];
    // Of each: steps that it still needs from each of its cells, past the bodies at rest.
    const List<int> *past_bodies_[most] = {};
    // for each two and each of their moves
    Pairing apart_[most][most][9][9];
    List<Cell> paths_[most];
    std::int64_t expansions_ = 0;
};

} // namespace fl::planning
