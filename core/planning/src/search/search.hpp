// The path of one positioner through (alpha, beta, time), with the others' motion given.
//
// A* with a fixed deadline: coming close to a moving neighbour costs much (so that a path is found even
// where none is free), moves and waits little, and bodies at rest may not be touched at all.
#pragma once

#include "guide/cost_to_go.hpp"
#include "motion/robot.hpp"
#include "search/moving_obstacles.hpp"

#include <algorithm>
#include <bit>
#include <cstdint>

namespace fl::planning {

// A move of one step is a number 0 .. 8: alpha and beta by one line down, none, or up.
using Move = std::uint8_t;
inline constexpr Move stay = 4;
inline int alpha_of(int move) { return move % 3 - 1; }
inline int beta_of(int move) { return move / 3 - 1; }
inline Cell moved(Cell c, int move) { return {c.alpha + alpha_of(move), c.beta + beta_of(move)}; }
// Steps between two cells if nothing is between.
inline int steps_between(Cell p, Cell q) {
    return std::max(std::abs(p.alpha - q.alpha), std::abs(p.beta - q.beta));
}
// To arrive at a cell by one move and to leave it by another; backward: in reversed time.
VelocityChanges changes_of(int move_in, int move_out, bool backward);

// What a path costs beside the encounters on it. Units are arbitrary; encounters cost about 1000 a step.
struct Costs {
    int move = 2;            // an axis moves by one line
    int velocity_change = 1; // of an axis
    int wait = 2;            // a step on a cell that is not the goal: without it, floods are twice as wide
    List<int> beta;          // per step on a line of the beta grid; empty: nothing
    // What is still to come counts so many times where a guide knows it: above 1 a path is found sooner, and
    // may cost so many times the cheapest.
    int greed = 2;
};

struct Request {
    Robot *robot = nullptr;
    const MovingObstacles *moving = nullptr;
    const Costs *costs = nullptr;
    int steps = 0;        // how long the moving obstacles are known
    int deadline = 0;     // by this step it must rest at its goal, for good
    int give_up = 0;      // a path that costs so much or more is not wanted
    double need_mm = 0.0; // between centre lines
    // From the goal back in time: the same paths, but of equals it finds the one that moves last, not first.
    // Two positioners that interlock at their goals need one that comes early and waits, one that comes late.
    bool backward = false;
    int hold = 0;            // for so many steps it rests at the end where the search begins
    int most_expansions = 0; // undecided beyond this; 0: no limit
    // What is still to come, where it is known; without it, moves alone.
    const CostToGo *guide = nullptr;
};

// What a search has still to look at, by total cost: the lowest first, and of equals the one added last.
template <class Item> class OpenQueue {
  public:
    static constexpr int most = 1 << 17; // costs from here on are all the same

    OpenQueue() : first_(most, none), used_(most / bits, 0) {}

    bool empty() const { return size_ == 0; }
    void clear() {
        for (int word = lowest_; word <= highest_; ++word)
            for (; used_[word] != 0; used_[word] &= used_[word] - 1) first_[first_used(word)] = none;
        entries_.clear();
        lowest_ = most / bits;
        highest_ = -1;
        size_ = 0;
    }
    void push(const Item &item, int cost) {
        const int bucket = std::min(cost, most - 1), word = bucket / bits;
        entries_.push_back({item, first_[bucket]});
        first_[bucket] = entries_.size() - 1;
        used_[word] |= std::uint64_t{1} << bucket % bits;
        lowest_ = std::min(lowest_, word);
        highest_ = std::max(highest_, word);
        ++size_;
    }
    // @pre not empty
    int lowest() {
        while (used_[lowest_] == 0) ++lowest_;
        return first_used(lowest_);
    }
    // One of the lowest cost. @pre not empty
    Item pop() {
        const int bucket = lowest();
        const Entry &entry = entries_[first_[bucket]];
        first_[bucket] = entry.next;
        if (entry.next == none) used_[lowest_] &= used_[lowest_] - 1;
        --size_;
        return entry.item;
    }

  private:
    static constexpr int none = -1, bits = 64;
    struct Entry {
        Item item;
        int next; // the one added to the same bucket before
    };
    int first_used(int word) const { return word * bits + std::countr_zero(used_[word]); }

    List<int> first_;          // of each bucket, its last entry
    List<std::uint64_t> used_; // a bit for each bucket that has any
    List<Entry> entries_;
    int lowest_ = most / bits, highest_ = -1, size_ = 0; // words
};

class Search {
  public:
    // The cells at steps 0 .. steps of a path below `give_up`; empty if there is none. The cheapest; with a
    // guide it may cost `greed` times as much. Valid until the next run.
    const List<Cell> &run(const Request &request);
    std::int64_t expansions() const { return expansions_; }
    // Whether the last run was ended by most_expansions.
    bool undecided() const { return undecided_; }

  private:
    using NodeId = Index<struct NodeKind>; // of a cell at a step

    // A cell at a step: the move of the best way to it, and in which search this was found. Two bytes: most
    // of what a search waits for is these, and as they are few more of them are at hand.
    class Node {
      public:
        static constexpr std::uint32_t most_rounds = (1u << 12) - 1;
        Node() = default;
        Node(std::uint32_t round, Move move) : code_(static_cast<std::uint16_t>(round << 4 | move)) {}
        Move move() const { return code_ & 15; }
        std::uint32_t round() const { return code_ >> 4; }

      private:
        std::uint16_t code_ = 0;
    };
    struct Place {
        Cell cell;
        int step; // counted in the direction of the search
    };
    // A way to a cell at a step that may be the best one. What the last step meets is looked at only when
    // its turn comes: of most it never does.
    struct Open {
        Open(Place at, int c, int m, bool looked = false)
            : step(at.step), cost(c), alpha(static_cast<std::int16_t>(at.cell.alpha)),
              beta(static_cast<std::int16_t>(at.cell.beta)), move(static_cast<Move>(m)), looked_at(looked) {}
        Place place() const { return {{alpha, beta}, step}; }

        int step, cost;
        std::int16_t alpha, beta;
        Move move; // the last one
        bool looked_at;
    };
    // A line of an axis to which a step may lead.
    struct Line {
        int left = 0;    // lines from there to the last one; beyond the grid more than any step allows
        int changes = 0; // of speed that are still needed, at least
    };
    // What it means to arrive at a cell by one move and to leave it by another.
    struct Turning {
        VelocityChanges changes;
        bool possible = true;
        int cost = 0;
    };

    void begin();
    void list_turnings();
    void prepare_end();
    int hold_cost();
    Cell first_cell() const { return ask_.backward ? ask_.robot->goal() : ask_.robot->start(); }
    int least_to_come(Place at, int move) const;
    int changes_to_come(const Line &alpha, const Line &beta) const {
        return ask_.costs->velocity_change * (alpha.changes + beta.changes);
    }
    int total(int cost, int to_come) const;
    static Line line_at(int line, int last, int lines, int speed);
    int beta_cost(Cell c) const;
    bool look(Open open);
    void expand(const Open &here);
    void finish(const Open &here);
    // What all steps from a cell have in common.
    struct Leaving {
        Place at;
        const Turning *turnings; // from the move by which it was reached
        int cost;                // of a step, without its move
        NodeId same;             // the cell, a step later
        bool guided;
        CostToGo::Around guide;                 // of a step later, where there is one
        int move, velocity_change, wait, greed; // as Costs has them, here
    };
    void fetch_around(NodeId same) const;
    Leaving leaving(const Open &here) const;
    void relax(const Leaving &from, int way, const Line (&alpha)[3]);
    bool shaped(const MovingObstacles::Visit &e) const;
    MovingObstacles::View visits_at(int step) const {
        return ask_.moving->at(ask_.backward ? ask_.steps - step : step);
    }
    void list_rest(Cell cell, int from, int to);
    int leg_encounters(int step) const;
    int always_encounters(Cell cell, VelocityChanges turn);
    int look_always(const SweptArm &step) const;
    int encounters(Place at, VelocityChanges turn);
    int near_encounters(Place at, VelocityChanges turn);
    int doubtful_encounters(const SweptArm &step) const;
    bool may_help();
    NodeId id(Place at) const;
    bool closed(NodeId id) const { return nodes_[id].round() == round_; }
    void trace();

    Request ask_;
    Cell last_cell_;
    int alphas_ = 0, betas_ = 0; // lines of its grid
    int last_step_ = 0;          // by which the path must be done, in the direction of the search
    Turning turnings_[9][9];
    List<Node, NodeId> nodes_;
    OpenQueue<Open> queue_;
    // Its distance in mid-step does not tell whether it is met.
    struct Doubtful {
        const MovingObstacles::Visit *visit;
        double squared_mm2;
    };
    List<Doubtful> doubtful_;
    // Encounters at any step, for each cell and turning: of which search they are, and what they cost.
    struct Always {
        std::uint32_t round = 0;
        int cost = 0;
    };
    List<Always> always_;
    List<int> rest_cost_, rest_met_; // of resting at a cell at each step, and with whom it was counted last
    List<int> end_cost_;             // of resting at the last cell from a step to the end
    List<Cell> path_;
    std::uint32_t round_ = 0;
    Place last_{}; // of the best path: where it comes to rest
    int best_ = 0;
    std::int64_t expansions_ = 0;
    bool undecided_ = false;
};

} // namespace fl::planning
