// From ways that meet to ways that do not: large-neighbourhood search over small groups of positioners.
#pragma once

#include "team.hpp"

namespace fl::planning {

class Repair {
  public:
    Repair(Team &team, const Settings &settings, Statistics &statistics)
        : team_(team), settings_(settings), statistics_(statistics), random_(settings.seed) {}

    // A way for everybody, longest first, encounters allowed where they cannot be avoided.
    void first_ways();
    // Replans groups until nobody meets anybody (true), or until effort or deadline are used up.
    bool run(int last_steps);
    // Looks for ways that end earlier, down to this many steps.
    void hurry(int wanted_steps);
    // Replans each positioner alone for a shorter, straighter way that meets nobody.
    void tidy();
    std::int64_t expansions() const { return search_.expansions() + joint_.expansions(); }

  private:
    struct Group {
        std::vector<int> robots;
        std::vector<Memory> before;
        int meetings = 0;
    };

    std::vector<std::pair<int, int>> pairs() const;
    void round(std::pair<int, int> pair);
    void joint_round(std::pair<int, int> pair);
    std::vector<int> choose_joint(std::pair<int, int> pair);
    void set_joint(const std::vector<int> &knot, Group &group);
    Group choose(std::pair<int, int> pair);
    void remember(Group &group) const;
    int affordable(const Group &group) const;
    int touching(const Group &group) const;
    void forget_ways(const Group &group);
    Costs random_costs(const Robot &robot);
    Mode random_mode(const Robot &robot, int deadline);
    bool replan(const std::vector<int> &robots, int most);
    void take_back(Group &group);
    void judge(std::pair<int, int> pair, const Group &group, int meetings_now);
    bool squeeze(int deadline);
    int arrival() const;
    bool rounds(int most);
    void give_time(std::pair<int, int> pair);
    static int least_cost(const Robot &robot, const Costs &costs);
    void tidy_one(int robot, const Costs &costs);
    int way_cost(const Member &member, const Costs &costs) const;

    Team &team_;
    const Settings &settings_;
    Statistics &statistics_;
    Random random_;
    Search search_;
    JointSearch joint_;
    int first_steps_ = 0;
    int last_steps_ = 0; // beyond which no deadline is set
};

} // namespace fl::planning
