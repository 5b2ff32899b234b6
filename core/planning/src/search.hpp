// The way of one positioner through (alpha, beta, time), with the others' motion given.
//
// A* with a fixed deadline: coming close to a moving neighbour costs much (so that a way is found even
// where none is free), moves and waits little, and bodies that stand still may not be touched at all.
#pragma once

#include "crowd.hpp"
#include "robot.hpp"

#include <array>
#include <cstdint>
#include <vector>

namespace fl::planning {

// What a way costs beside the encounters on it. Units are arbitrary; encounters cost about 1000 a step.
struct Costs {
    int move = 2;          // an axis moves by one line
    int bend = 1;          // an axis changes its speed
    int wait = 2;          // a step on a cell that is not the goal: without it, floods are twice as wide
    std::vector<int> beta; // per step on a line of the beta grid; empty: nothing
};

struct Request {
    Robot *robot = nullptr;
    const Crowd *crowd = nullptr;
    const Costs *costs = nullptr;
    int steps = 0;        // how long the crowd is known
    int deadline = 0;     // by this step it must stand at its goal, for good
    int give_up = 0;      // a way that costs so much or more is not wanted
    double need_mm = 0.0; // between centre lines
    // From the goal back in time: the same ways, but of equals it finds the one that moves last, not first.
    // Two positioners that interlock at their goals need one that comes early and waits, one that comes late.
    bool backward = false;
    int hold = 0; // for so many steps it stands at the end where the search begins
};

class Search {
  public:
    // The cells at steps 0 .. steps of the cheapest way; empty if there is none below `give_up`.
    const std::vector<Cell> &run(const Request &request);
    std::int64_t expansions() const { return expansions_; }

  private:
    struct Node {
        std::uint32_t round = 0; // of which search the rest is
        int cost = 0;
        std::uint8_t move = 0; // by which move it was reached, 0 .. 8; 4 is to stay
        bool closed = false;
    };
    struct Place {
        Cell cell;
        int step; // counted in the direction of the search
    };
    // What it means to arrive at a cell by one move and to leave it by another.
    struct Turning {
        Bends bends;
        bool possible = true;
        int cost = 0;
    };

    void begin();
    void list_turnings();
    void prepare_end();
    int hold_cost();
    Cell first_cell() const { return ask_.backward ? ask_.robot->goal() : ask_.robot->start(); }
    const Turning &turning(int move_in, int move_out) const {
        return turnings_[static_cast<size_t>(9 * move_in + move_out)];
    }
    int steps_to_go(Cell c) const;
    int heuristic(Cell c) const;
    int beta_cost(Cell c) const;
    void expand(std::uint32_t id);
    void finish(std::uint32_t id, Place at);
    void relax(std::uint32_t id, Place at, const Node &here, int move);
    void gather_near(Place at);
    int encounters(const Piece &step) const;
    int encounters(Place at, Bends turn);
    void push(std::uint32_t id, int total);
    bool pop(std::uint32_t &id);
    std::uint32_t id(Place at) const;
    Place place(std::uint32_t id) const;
    Node &node(std::uint32_t id);
    void trace();

    Request ask_;
    Cell last_cell_;
    int last_step_ = 0; // by which the way must be done, in the direction of the search
    std::array<Turning, 81> turnings_;
    std::vector<Node> nodes_;
    std::vector<std::vector<std::uint32_t>> buckets_; // open nodes by total cost; the last come first
    size_t lowest_ = 0, highest_ = 0;
    size_t open_ = 0;
    std::vector<const Crowd::Visit *> near_, doubtful_;
    std::vector<int> end_cost_; // of standing at the last cell from a step to the end
    std::vector<Cell> path_;
    std::uint32_t round_ = 0;
    std::uint32_t last_ = 0;
    int best_ = 0;
    std::int64_t expansions_ = 0;
};

} // namespace fl::planning
