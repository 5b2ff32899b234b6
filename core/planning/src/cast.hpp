// Who goes where: which goals can be had at all, who must give way, who stands.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion.hpp"
#include "robot.hpp"

#include <optional>
#include <vector>

namespace fl::planning {

// The parts of all positioners in one plan. A positioner is an actor if it can move; the others are
// obstacles where they are.
class Cast {
  public:
    Cast(const Bodies &bodies, const Task &task, const Settings &settings, const Clock &clock);

    // Settles goals until all of them can stand together, and each can be reached if nobody else were there.
    void settle();
    int size() const { return static_cast<int>(parts_.size()); }
    bool acts(int i) const { return !part(i).stuck; }
    bool still(int i) const { return part(i).still; }
    double approach(int i) const { return task_.approach_rad[static_cast<size_t>(i)]; }
    int steps_alone(int i) const { return part(i).steps_alone; }
    double need_mm() const { return need_mm_; }
    const std::vector<Refused> &refused() const { return refused_; }

    // The positioner on its grid, with all that stands still around it.
    Robot make_robot(int i) const;
    // Sends a positioner to a place where it is in nobody's way; false if there is none it can reach.
    bool send_to_safe_place(int i, Refusal why, int other);

  private:
    struct Part {
        Angles goal;
        bool stuck = false;   // stands where it is whatever happens
        bool still = false;   // is at its goal and need not move
        bool settled = false; // the goal stands
        bool gone = false;    // given up, new place not chosen yet: in nobody's way
        int finer = 1;        // its grid is finer by this factor
        int steps_alone = 0;
    };

    Part &part(int i) { return parts_[static_cast<size_t>(i)]; }
    const Part &part(int i) const { return parts_[static_cast<size_t>(i)]; }
    const Arm &arm(int i) const { return bodies_.arms[static_cast<size_t>(i)]; }
    Angles start(int i) const { return task_.start[static_cast<size_t>(i)]; }
    const std::vector<int> &near(int i) const { return near_[static_cast<size_t>(i)]; }

    void find_near();
    void freeze_tangled();
    void freeze(int i);
    bool inside_travel(int i, Angles goal) const;
    Piece leg(int i, Angles goal, bool stands) const;
    std::optional<int> blocked_by(int i, const Piece &leg) const;
    bool legs_meet(int i, int j) const;
    bool legs_meet(int i, int j, bool i_stands, bool j_stands) const;
    bool settle_alone(int i);
    bool settle_pairs();
    void wake_still(int i, int j);
    bool find_way_alone(int i);
    bool safe(int i, Angles place, bool stands) const;
    bool try_place(int i, Angles place, bool stands);
    std::vector<Angles> places(int i) const;

    const Bodies &bodies_;
    const Task &task_;
    const Settings &settings_;
    const Clock &clock_;
    double need_mm_;
    std::vector<Part> parts_;
    std::vector<std::vector<int>> near_;
    std::vector<Refused> refused_;
};

} // namespace fl::planning
