// The way of one positioner through (alpha, beta, time), with the others' motion given.
//
// A* with a fixed deadline: time before the deadline costs nothing, coming close to a moving neighbour costs
// (so that a way is found even where none is free), bodies that stand still may not be touched at all.
#pragma once

#include "crowd.hpp"
#include "robot.hpp"

#include <cstdint>
#include <vector>

namespace fl::planning {

// What a way costs beside the encounters on it. Units are arbitrary; encounters cost about 1000 a step.
struct Costs {
    int move = 2;          // an axis moves by one line
    int bend = 1;          // an axis changes its speed
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
    int cost() const { return best_; }
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

    void begin();
    void prepare_end();
    int hold_cost();
    Cell first_cell() const { return ask_.backward ? ask_.robot->goal() : ask_.robot->start(); }
    Cell last_cell() const { return ask_.backward ? ask_.robot->start() : ask_.robot->goal(); }
    Bends bends(int move_in, int move_out) const;
    int steps_to_go(Cell c) const;
    void expand(std::uint32_t id);
    void finish(std::uint32_t id, Place at);
    void relax(std::uint32_t id, Place at, int move);
    void gather_near(Place at);
    int encounters(const Piece &step) const;
    int encounters(Place at, Bends bends);
    int base_cost(Place at, Bends turn, int move) const;
    int heuristic(Cell c) const;
    void push(std::uint32_t id, int cost, int to_go);
    std::uint32_t id(Place at) const;
    Place place(std::uint32_t id) const;
    Node &node(std::uint32_t id);
    void trace();

    Request ask_;
    std::vector<Node> nodes_;
    std::vector<std::uint64_t> queue_; // a heap of cost, way to go, node
    std::vector<const Crowd::Visit *> near_, doubtful_;
    std::vector<int> end_cost_; // of standing at the last cell from a step to the end
    std::vector<Cell> path_;
    std::uint32_t round_ = 0;
    std::uint32_t last_ = 0;
    int last_step_ = 0; // by which the way must be done, in the direction of the search
    int best_ = 0;
    std::int64_t expansions_ = 0;
};

} // namespace fl::planning
