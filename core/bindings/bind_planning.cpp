// Plans and their verification on plain arrays; the Python side has the names and units people use.
#include "bind.hpp"
#include "fiberloom/conflicts.hpp"
#include "fiberloom/planning.hpp"
#include "fiberloom/verify.hpp"

#include <nanobind/stl/array.h>

#include <algorithm>

namespace {

using namespace fl::planning;
using Arms = nb::ndarray<const double, nb::shape<-1, 5>, nb::c_contig, nb::device::cpu>;
using Pairs = nb::ndarray<const double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Capsules = nb::ndarray<const double, nb::shape<-1, 5>, nb::c_contig, nb::device::cpu>;
using Four = nb::ndarray<const double, nb::shape<2, 2>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::vector<fl::Arm> arms_of(const Arms &rows) {
    std::vector<fl::Arm> out;
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *a = rows.data() + 5 * i;
        out.push_back({{a[0], a[1]}, a[2], a[3], a[4]});
    }
    return out;
}

Bodies bodies_of(const Arms &arms, std::array<double, 2> segment, double radius, const Capsules &obstacles) {
    Bodies bodies{arms_of(arms), segment[0], segment[1], radius, {}};
    for (size_t i = 0; i < obstacles.shape(0); ++i) {
        const double *o = obstacles.data() + 5 * i;
        bodies.obstacles.push_back({{{o[0], o[1]}, {o[2], o[3]}}, o[4]});
    }
    return bodies;
}

std::vector<fl::Angles> angles_of(const Pairs &rows) {
    std::vector<fl::Angles> out;
    for (size_t i = 0; i < rows.shape(0); ++i) out.push_back({rows.data()[2 * i], rows.data()[2 * i + 1]});
    return out;
}

nb::object rows_of(const std::vector<double> &time, const std::vector<fl::Angles> &angles) {
    auto out = new_array<double>({time.size(), 3});
    for (size_t k = 0; k < time.size(); ++k) {
        out.data()[3 * k] = time[k];
        out.data()[3 * k + 1] = angles[k].alpha_rad;
        out.data()[3 * k + 2] = angles[k].beta_rad;
    }
    return out.cast();
}

nb::dict dict_of(const Statistics &s) {
    nb::dict d;
    d["searches"] = s.searches;
    d["expansions"] = s.expansions;
    d["repairs"] = s.repairs;
    d["first_conflicts"] = s.first_conflicts;
    d["bound_steps"] = s.bound_steps;
    d["steps"] = s.steps;
    d["step_s"] = s.step_s;
    return d;
}

void need_rows(const char *name, size_t have, size_t want) {
    if (have != want)
        throw nb::value_error((std::string(name) + ": " + std::to_string(have) + " rows for " +
                               std::to_string(want) + " positioners")
                                  .c_str());
}

Settings settings_of(double speed, double acceleration, double grid) {
    Settings settings;
    settings.speed_rad_s = speed;
    settings.acceleration_rad_s2 = acceleration;
    settings.grid_rad = grid;
    return settings;
}

nb::tuple clock_of(double speed, double acceleration, double grid, double highest_approach) {
    const Clock clock(settings_of(speed, acceleration, grid), highest_approach);
    return nb::make_tuple(clock.quarter_s, clock.grid_rad, clock.leg_quarters);
}

nb::tuple plan_all(Arms arms, std::array<double, 2> segment, double radius, Capsules obstacles, Pairs start,
                   Pairs goal, Input1<double> approach, Flags fixed, Four travel, double speed,
                   double acceleration, double grid, double clearance, double first_deadline,
                   double last_deadline, double effort, std::uint64_t seed) {
    const size_t n = arms.shape(0);
    need_rows("start", start.shape(0), n);
    need_rows("goal", goal.shape(0), n);
    need_rows("approach", approach.shape(0), n);
    need_rows("fixed", fixed.shape(0), n);
    const Bodies bodies = bodies_of(arms, segment, radius, obstacles);
    const double *t = travel.data();
    const Task task{angles_of(start),
                    angles_of(goal),
                    {approach.data(), approach.data() + n},
                    {fixed.data(), fixed.data() + n},
                    {t[0], t[1], t[2], t[3]}};
    Settings settings = settings_of(speed, acceleration, grid);
    settings.clearance_mm = clearance;
    settings.first_deadline = first_deadline;
    settings.last_deadline = last_deadline;
    settings.effort = effort;
    settings.seed = seed;
    PlanResult outcome;
    {
        nb::gil_scoped_release release;
        outcome = plan(bodies, task, settings);
    }
    nb::list motions, refused;
    for (const Motion &m : outcome.motions) motions.append(rows_of(m.time_s, m.angles));
    for (const Refused &r : outcome.refused)
        refused.append(nb::make_tuple(r.robot, to_string(r.reason), r.other));
    return nb::make_tuple(motions, refused, dict_of(outcome.statistics));
}

using Points = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

Motion motion_from(const Points &rows) {
    Motion m;
    for (size_t k = 0; k < rows.shape(0); ++k) {
        const double *r = rows.data() + 3 * k;
        m.time_s.push_back(r[0]);
        m.angles.push_back({r[1], r[2]});
    }
    return m;
}

nb::dict dict_of(const Gap &g) {
    nb::dict d;
    d["gap_mm"] = g.gap_mm;
    d["time_s"] = g.time_s;
    d["robot"] = g.robot;
    d["other"] = g.other;
    return d;
}

nb::dict dict_of(const Verification &v) {
    nb::list violations;
    for (const Violation &x : v.violations)
        violations.append(nb::make_tuple(to_string(x.fault), x.robot, x.other, x.time_s, x.depth));
    nb::dict d;
    d["violations"] = violations;
    d["robots"] = dict_of(v.robots);
    d["obstacles"] = dict_of(v.obstacles);
    d["top_speed_rad_s"] = v.top_speed_rad_s;
    d["top_acceleration_rad_s2"] = v.top_acceleration_rad_s2;
    d["top_jump_rad_s"] = v.top_jump_rad_s;
    return d;
}

nb::dict verify_all(Arms arms, std::array<double, 2> segment, double radius, Capsules obstacles,
                    const std::vector<Points> &motions, Four travel, Pairs start, Pairs goal, Flags arrives,
                    Input1<double> approach, double speed, double acceleration, double rounding) {
    const size_t n = arms.shape(0);
    need_rows("motions", motions.size(), n);
    if (start.shape(0) != 0) need_rows("start", start.shape(0), n);
    if (goal.shape(0) != 0) need_rows("goal", goal.shape(0), n);
    if (goal.shape(0) != 0) need_rows("arrives", arrives.shape(0), n);
    if (approach.shape(0) != 0) need_rows("approach", approach.shape(0), n);
    const Bodies bodies = bodies_of(arms, segment, radius, obstacles);
    std::vector<Motion> all;
    for (const Points &rows : motions) all.push_back(motion_from(rows));
    const double *t = travel.data();
    const Rules rules{speed,
                      acceleration,
                      {t[0], t[1], t[2], t[3]},
                      rounding,
                      angles_of(start),
                      angles_of(goal),
                      {arrives.data(), arrives.data() + arrives.shape(0)},
                      {approach.data(), approach.data() + approach.shape(0)}};
    Verification result;
    {
        nb::gil_scoped_release release;
        result = verify(bodies, all, rules);
    }
    return dict_of(result);
}

nb::object find_conflicts(Arms arms, std::array<double, 2> segment, double radius, Pairs goals,
                          double approach) {
    need_rows("goals", goals.shape(0), arms.shape(0));
    const Bodies bodies{arms_of(arms), segment[0], segment[1], radius, {}};
    const auto found = conflicts(bodies, angles_of(goals), approach);
    auto out = new_array<int>({found.size(), 2});
    for (size_t k = 0; k < found.size(); ++k) std::copy(found[k].begin(), found[k].end(), out.data() + 2 * k);
    return out.cast();
}

nb::object flags_of(const std::vector<std::uint8_t> &flags) {
    auto out = new_array<bool>({flags.size()});
    for (size_t k = 0; k < flags.size(); ++k) out.data()[k] = flags[k] != 0;
    return out.cast();
}

nb::object clear_of_obstacles(Arms arms, std::array<double, 2> segment, double radius, Capsules obstacles,
                              Pairs goals, double approach) {
    need_rows("goals", goals.shape(0), arms.shape(0));
    return flags_of(static_ok(bodies_of(arms, segment, radius, obstacles), angles_of(goals), approach));
}

nb::object clear_pairs(Arms arms, Pairs goals, Arms others, Pairs other_goals, std::array<double, 2> segment,
                       double radius, double approach) {
    for (size_t n : {goals.shape(0), others.shape(0), other_goals.shape(0)})
        need_rows("pairs_clear", n, arms.shape(0));
    const Bodies bodies{arms_of(arms), segment[0], segment[1], radius, {}};
    return flags_of(pairs_clear(bodies, arms_of(others), angles_of(goals), angles_of(other_goals), approach));
}

} // namespace

void bind_planning(nb::module_ &m) {
    nb::module_ p =
        m.def_submodule("planning", "Collision-free motion of all positioners, and its verification.");
    p.def("clock", &clock_of, nb::arg("speed"), nb::arg("acceleration"), nb::arg("grid"),
          nb::arg("highest_approach"),
          "The common clock of plans: quarter of a step in s, widest move in a step in rad, and how many "
          "quarters "
          "each third of the approach lasts.");
    p.def("plan", &plan_all, nb::arg("arms"), nb::arg("segment_mm"), nb::arg("radius_mm"),
          nb::arg("obstacles"), nb::arg("start"), nb::arg("goal"), nb::arg("approach"), nb::arg("fixed"),
          nb::arg("travel"), nb::kw_only(), nb::arg("speed"), nb::arg("acceleration"), nb::arg("grid"),
          nb::arg("clearance_mm"), nb::arg("first_deadline"), nb::arg("last_deadline"), nb::arg("effort"),
          nb::arg("seed"),
          "Motions (list of (n, 3): time_s, alpha_rad, beta_rad), who does not arrive (index, why, other), "
          "statistics.");
    p.def("verify", &verify_all, nb::arg("arms"), nb::arg("segment_mm"), nb::arg("radius_mm"),
          nb::arg("obstacles"), nb::arg("motions"), nb::arg("travel"), nb::arg("start"), nb::arg("goal"),
          nb::arg("arrives"), nb::arg("approach"), nb::kw_only(), nb::arg("speed"), nb::arg("acceleration"),
          nb::arg("rounding"),
          "Proof in continuous time; start, goal and approach may be empty (not checked). Violations are "
          "(fault, "
          "robot, other, time_s, depth in mm, rad, rad/s or rad/s2).");
    p.def("conflicts", &find_conflicts, nb::arg("arms"), nb::arg("segment_mm"), nb::arg("radius_mm"),
          nb::arg("goals_rad"), nb::arg("approach_rad"),
          "Pairs (P, 2) of positioners that touch at their goals or on the approach that all make together.");
    p.def("static_ok", &clear_of_obstacles, nb::arg("arms"), nb::arg("segment_mm"), nb::arg("radius_mm"),
          nb::arg("obstacles"), nb::arg("goals_rad"), nb::arg("approach_rad"),
          "Whether goal and approach of each positioner are clear of obstacles (K, 5): x0, y0, x1, y1, "
          "radius in mm.");
    p.def("pairs_clear", &clear_pairs, nb::arg("arms"), nb::arg("goals_rad"), nb::arg("others"),
          nb::arg("other_goals_rad"), nb::arg("segment_mm"), nb::arg("radius_mm"), nb::arg("approach_rad"),
          "Row by row: whether two positioners stay apart at their goals and on the approach.");
}
