// All positioners that may move, their ways so far, and who meets whom.
#pragma once

#include "joint.hpp"
#include "random.hpp"
#include "robot.hpp"
#include "search.hpp"

#include <utility>
#include <vector>

namespace fl::planning {

// How others see a positioner whose way is being sought anew.
enum class Presence {
    way,      // as its present way says
    absent,   // not at all
    standing, // at its start for a while, absent, at its goal for a while: so that nobody plans through one
              // that cannot get out of the way in time
};

// Two positioners that meet, and in how many steps.
struct Meeting {
    int other = -1;
    int steps = 0;
};

struct Member {
    explicit Member(Robot r) : robot(std::move(r)) {}

    Robot robot;
    std::vector<int> neighbours; // nearest first
    std::vector<Cell> way;       // the cell at each step
    std::vector<Piece> pieces;   // the motion of each step
    std::vector<Meeting> meetings;
    Piece at_start, at_goal;
    Presence presence = Presence::standing;
    int cost = 1000;    // of meeting it, per step
    bool still = false; // stands at its goal from the beginning to the end, without an approach
    int deadline = 0;   // the step by which it must have arrived
    int tries = 0;      // repairs around it since the last one that helped
};

// In which direction of time a way is sought, and for how many steps it stands first.
struct Mode {
    bool backward = false;
    int hold = 0;
};

// What a repair may have to take back.
struct Memory {
    int robot;
    std::vector<Cell> way;
    std::vector<Piece> pieces;
    bool still;
};

class Team {
  public:
    Team(double need_mm, int steps) : need_mm_(need_mm), steps_(steps) {}
    // The last step in which a positioner moves.
    int arrival(int robot) const;

    const std::vector<Member> &members() const { return members_; }
    Member &at(int robot) { return members_[static_cast<size_t>(robot)]; }
    const Member &at(int robot) const { return members_[static_cast<size_t>(robot)]; }
    int size() const { return static_cast<int>(members_.size()); }
    int steps() const { return steps_; }
    double need_mm() const { return need_mm_; }

    void add(Robot robot);
    void find_neighbours();
    // Gives a positioner more time; everybody who has arrived stands at the goal during steps added.
    void allow(int robot, int deadline);

    // Seeks a way of one positioner among the others as they are now; false if there is none below give_up.
    bool seek(int robot, const Costs &costs, int give_up, Mode mode, Search &search);
    // Seeks ways of two or three at once; sets none of them.
    bool seek_joint(const std::vector<int> &robots, bool backward, int most_nodes, JointSearch &search);
    void set_way(int robot, const std::vector<Cell> &way);
    void stand_still(int robot);
    // Counts anew whom a positioner meets.
    void count_meetings(int robot);
    int meetings() const; // pairs

    Memory remember(int robot) const;
    void restore(Memory memory);

  private:
    void gather(int robot, Crowd &crowd) const;
    void gather_one(const Member &me, int other, Crowd &crowd) const;
    void extend(int steps);
    const Piece *piece_of(const Member &member, int step) const;
    void forget_meetings(int robot);
    int steps_met(const Member &p, const Member &q) const;

    double need_mm_;
    int steps_;
    std::vector<Member> members_;
    Crowd crowd_;
    std::array<Crowd, JointSearch::most> joint_crowds_;
};

} // namespace fl::planning
