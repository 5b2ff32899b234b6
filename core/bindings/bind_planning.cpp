// Plans and their verification on plain arrays; the Python side has the names and units people use.
#include "bind.hpp"
#include "fiberloom/conflicts.hpp"
#include "fiberloom/lateness.hpp"
#include "fiberloom/planning.hpp"
#include "fiberloom/verify.hpp"

#include <nanobind/stl/array.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/variant.h>

#include <algorithm>

namespace {

using namespace fl::planning;
using Arms = Input<double, -1, 5>;
using Pairs = Input<double, -1, 2>;
using Capsules = Input<double, -1, 7>;
using PartRows = Input<double, -1, 8>;
using Travel = Input<double, 2, 2>;
using Travels = Input<double, -1, 2, 2>;
using SidePair = std::array<double, 2>;
using FromGoal = std::variant<double, SidePair>; // above on both axes, or of each with its sign
using Flags = Input1<bool>;
using Points = Input<double, -1, 3>;
using Dict = nb::typed<nb::dict, nb::str, nb::any>;

std::vector<fl::Arm> arms_of(const Arms &rows) {
    std::vector<fl::Arm> out;
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *a = rows.data() + 5 * i;
        out.push_back({{a[0], a[1]}, a[2], a[3], a[4]});
    }
    return out;
}

std::vector<fl::Angles> angles_of(const Pairs &rows) {
    std::vector<fl::Angles> out;
    for (size_t i = 0; i < rows.shape(0); ++i) out.push_back({rows.data()[2 * i], rows.data()[2 * i + 1]});
    return out;
}

fl::Limits limits_of(const Travel &travel) {
    const double *t = travel.data();
    return {t[0], t[1], t[2], t[3]};
}

std::vector<fl::Limits> limits_of(const Travels &travels) {
    std::vector<fl::Limits> out;
    for (size_t i = 0; i < travels.shape(0); ++i) {
        const double *t = travels.data() + 4 * i;
        out.push_back({t[0], t[1], t[2], t[3]});
    }
    return out;
}

Sides sides_of(SidePair sides) {
    if (std::abs(sides[0]) != 1.0 || std::abs(sides[1]) != 1.0) throw nb::value_error("sides: 1 or -1");
    return {sides[0], sides[1]};
}

fl::Angles approach_of(const FromGoal &from) {
    if (const double *above = std::get_if<double>(&from)) return {*above, *above};
    const SidePair &of_each = std::get<SidePair>(from);
    return {of_each[0], of_each[1]};
}

template <class T> std::vector<T> vector_of(const Input1<T> &row) {
    return {row.data(), row.data() + row.shape(0)};
}

std::vector<std::uint8_t> flags_of(const Flags &row) { return {row.data(), row.data() + row.shape(0)}; }

Output<bool, -1> array_of(const std::vector<std::uint8_t> &flags) {
    auto out = new_array<bool, -1>({flags.size()});
    for (size_t k = 0; k < flags.size(); ++k) out.data()[k] = flags[k] != 0;
    return out;
}

Output<double, -1, 3> points_of(const Motion &motion) {
    auto out = new_array<double, -1, 3>({motion.time_s.size(), 3});
    for (size_t k = 0; k < motion.time_s.size(); ++k) {
        out.data()[3 * k] = motion.time_s[k];
        out.data()[3 * k + 1] = motion.angles[k].alpha_rad;
        out.data()[3 * k + 2] = motion.angles[k].beta_rad;
    }
    return out;
}

Motion motion_from(const Points &rows) {
    Motion m;
    for (size_t k = 0; k < rows.shape(0); ++k) {
        const double *r = rows.data() + 3 * k;
        m.time_s.push_back(r[0]);
        m.angles.push_back({r[1], r[2]});
    }
    return m;
}

void need_rows(const char *name, size_t have, size_t want) {
    if (have != want)
        throw nb::value_error((std::string(name) + ": " + std::to_string(have) + " rows for " +
                               std::to_string(want) + " positioners")
                                  .c_str());
}

// A row of something, from a number.
int row_of(double number, size_t rows, const char *what) {
    if (!(number >= 0.0 && number < static_cast<double>(rows)))
        throw nb::value_error((std::string(what) + " of no positioner").c_str());
    return static_cast<int>(number);
}

Layers layers_of(double number) {
    if (!(number >= 1.0 && number <= static_cast<double>(all_layers)))
        throw nb::value_error("layers: 1 to 2^32 - 1, a bit each");
    return static_cast<Layers>(number);
}

Bodies bodies_of(const Arms &arms, const PartRows &parts, const Capsules &obstacles) {
    Bodies bodies{arms_of(arms), {}, {}};
    const size_t n = bodies.arms.size();
    bodies.parts.resize(n);
    for (size_t k = 0; k < parts.shape(0); ++k) {
        const double *p = parts.data() + 8 * k;
        bodies.parts[static_cast<size_t>(row_of(p[0], n, "a part"))].push_back(
            {{{p[2], p[3]}, {p[4], p[5]}}, p[6], p[1] == 0.0, layers_of(p[7])});
    }
    for (const auto &of_one : bodies.parts)
        if (of_one.empty()) throw nb::value_error("a positioner without parts");
    for (size_t k = 0; k < obstacles.shape(0); ++k) {
        const double *o = obstacles.data() + 7 * k;
        const int owner = o[6] < 0.0 ? -1 : row_of(o[6], n, "an obstacle");
        bodies.obstacles.push_back({{{o[0], o[1]}, {o[2], o[3]}}, o[4], layers_of(o[5]), owner});
    }
    return bodies;
}

Settings settings_of(double speed, double acceleration, double grid) {
    Settings settings;
    settings.speed_rad_s = speed;
    settings.acceleration_rad_s2 = acceleration;
    settings.grid_rad = grid;
    return settings;
}

std::tuple<double, std::vector<double>, int> clock_of(const Task &task, const Settings &settings) {
    const Clock clock(settings, task);
    std::vector<double> grids;
    for (size_t k = 0; k < task.start.size(); ++k)
        grids.push_back(clock.grid_rad(pace_of(settings, task, static_cast<int>(k))));
    return {clock.quarter_s, grids, clock.turn_quarters};
}

// --- a plan ------------------------------------------------------------------------------------

void bodies_init(Bodies *self, Arms arms, PartRows parts, Capsules obstacles) {
    new (self) Bodies(bodies_of(arms, parts, obstacles));
}

void task_init(Task *self, Pairs start, Pairs goal, Input1<double> approach, Flags fixed, Travel travel) {
    const size_t n = start.shape(0);
    need_rows("goal", goal.shape(0), n);
    need_rows("approach", approach.shape(0), n);
    need_rows("fixed", fixed.shape(0), n);
    new (self)
        Task{angles_of(start), angles_of(goal), vector_of(approach), flags_of(fixed), limits_of(travel)};
}

void task_may_shorten(Task &task, Input1<double> least) {
    need_rows("least", least.shape(0), task.approach_rad.size());
    task.least_approach_rad = vector_of(least);
    for (size_t i = 0; i < task.approach_rad.size(); ++i)
        task.least_approach_rad[i] = std::min(task.least_approach_rad[i], task.approach_rad[i]);
}

template <class Of> void set_travels(Of &of, Travels travels) { of.travels = limits_of(travels); }

template <class Of> void set_sides(Of &of, SidePair sides) { of.sides = sides_of(sides); }

void task_set_paces(Task &task, Input1<double> speed, Input1<double> acceleration) {
    need_rows("speed", speed.shape(0), task.start.size());
    need_rows("acceleration", acceleration.shape(0), task.start.size());
    task.speed_rad_s = vector_of(speed);
    task.acceleration_rad_s2 = vector_of(acceleration);
}

void settings_init(Settings *self, double speed, double acceleration, double grid) {
    new (self) Settings(settings_of(speed, acceleration, grid));
}

Dict dict_of(const Statistics &s) {
    Dict d;
    d["searches"] = s.searches;
    d["expansions"] = s.expansions;
    d["repairs"] = s.repairs;
    d["first_conflicts"] = s.first_conflicts;
    d["bound_steps"] = s.bound_steps;
    d["steps"] = s.steps;
    d["quarters_earlier"] = s.quarters_earlier;
    d["step_s"] = s.step_s;
    d["cut_short"] = s.cut_short;
    if (s.late) d["not_late"] = s.not_late;
    return d;
}

using Motions = std::vector<Output<double, -1, 3>>;
using Refusals = std::vector<std::tuple<int, std::string, int, int>>;
using LastLegs = std::vector<std::tuple<int, std::array<double, 3>, std::array<double, 3>>>;

std::array<double, 3> array_of(const LastLeg &leg) { return {leg.height_rad, leg.begin_s, leg.end_s}; }

LastLeg last_leg_of(const std::array<double, 3> &leg) { return {leg[0], leg[1], leg[2]}; }

std::tuple<Motions, Refusals, Dict, LastLegs> plan_all(const Bodies &bodies, const Task &task,
                                                       const Settings &settings) {
    need_rows("start", task.start.size(), bodies.arms.size());
    if (!task.travels.empty()) need_rows("travels", task.travels.size(), bodies.arms.size());
    PlanResult result;
    {
        nb::gil_scoped_release release;
        result = plan(bodies, task, settings);
    }
    Motions motions;
    Refusals refused;
    for (const Motion &m : result.motions) motions.push_back(points_of(m));
    for (const Refused &r : result.refused)
        refused.emplace_back(r.robot, to_string(r.reason), r.other, r.obstacle);
    LastLegs legs;
    for (const Approach &a : result.approaches)
        legs.emplace_back(a.robot, array_of(a.alpha), array_of(a.beta));
    return {motions, refused, dict_of(result.statistics), legs};
}

void bind_plan(nb::module_ &m) {
    nb::class_<Bodies>(m, "Bodies", "Bodies of a focal plane: capsules fixed to arms, and what is fixed.")
        .def(
            "__init__", &bodies_init, nb::arg("arms"), nb::arg("parts"), nb::arg("obstacles"),
            "arms (N, 5): centre x, y in mm, l_alpha in mm, alpha_off, beta_off in rad. parts (P, 8), in any "
            "order, at least one for each positioner: its index, the arm (0 alpha, 1 beta), x0, y0, x1, y1 "
            "in "
            "its frame and radius in mm, with the collision buffer, and layers. obstacles (K, 7): x0, y0, "
            "x1, y1, radius in mm, layers, and the index of the positioner whose uncertain place it covers, "
            "or -1. Layers: an integer of which each bit is a height; what has none in common cannot touch. "
            "ValueError where one is not from 1 to 2^32 - 1, or an index is not of a positioner.");
    nb::class_<Task>(m, "Task", "What a plan must do.")
        .def(
            "__init__", &task_init, nb::arg("start"), nb::arg("goal"), nb::arg("approach"), nb::arg("fixed"),
            nb::arg("travel"),
            "start, goal (N, 2) in rad; approach (N,): rad above the goal, on both axes, from which the last "
            "leg starts; fixed (N,): cannot move; travel [[alpha_min, alpha_max], [beta_min, beta_max]] in "
            "rad. ValueError where the numbers of rows differ.")
        .def("may_shorten", &task_may_shorten, nb::arg("least"),
             "Approaches that would touch may be shortened to this, rad (N,). Without it none may.")
        .def("set_sides", &set_sides<Task>, nb::arg("sides"),
             "From which side of their goals alpha and beta come: 1 from above, -1 from below.")
        .def("set_travels", &set_travels<Task>, nb::arg("travels"),
             "The room of each positioner (N, 2, 2), instead of that of all, rad.")
        .def("set_paces", &task_set_paces, nb::arg("speed"), nb::arg("acceleration"),
             "Speed in rad/s and acceleration in rad/s2 of each positioner (N,), instead of the settings'. "
             "ValueError where the numbers of rows differ.");
    nb::class_<Settings>(m, "Settings", "Speeds, and how hard the planner tries.")
        .def("__init__", &settings_init, nb::kw_only(), nb::arg("speed"), nb::arg("acceleration"),
             nb::arg("grid"), "rad/s, rad/s2, and the widest step of the search grid in rad.")
        .def_rw("clearance_mm", &Settings::clearance_mm, "kept beyond touching")
        .def_rw("in_hand_mm", &Settings::in_hand_mm, "kept beyond that by an arm on its way")
        .def_rw("late_s", &Settings::late_s,
                "any one positioner may be late by so much, the others being on time; inf: it stops for good")
        .def_rw("first_deadline", &Settings::first_deadline, "over the time that the longest path needs")
        .def_rw("last_deadline", &Settings::last_deadline, "beyond this a positioner is given up")
        .def_rw("effort", &Settings::effort, "scales how long the repair goes on")
        .def_rw("most_points", &Settings::most_points, "of an axis over the bus, where that keeps all clear")
        .def_rw("approach_turns", &Settings::approach_turns,
                "positioners may come down to their goals in so many turns, if they must; 1: all together")
        .def_rw("seed", &Settings::seed)
        .def(
            "tell", [](Settings &self, Watch watch) { self.watch = std::move(watch); }, nb::arg("watch"),
            "While a plan is made, `watch` is called with the name of a stage, how many of its parts are "
            "done, and of how many. It must not raise.")
        .def(
            "end_when", [](Settings &self, Enough enough) { self.enough = std::move(enough); },
            nb::arg("enough"),
            "While a plan is made, `enough` is called often: whether it shall come to an end. It must not "
            "raise.");
    m.def("clock", &clock_of, nb::arg("task"), nb::arg("settings"),
          "The common clock of a plan: quarter of a step in s, widest move of each positioner in a step in "
          "rad, and how many quarters an approach lasts.");
    m.def(
        "plan", &plan_all, nb::arg("bodies"), nb::arg("task"), nb::arg("settings"),
        "Motions (list of (n, 3): time_s, alpha_rad, beta_rad); positioners that do not arrive (index, why, "
        "other or -1, obstacle or -1); statistics; positioners that do not come to their goals as all others "
        "do (index, last leg of alpha, of beta: height in rad, begin and end in s).");
}

// --- its verification --------------------------------------------------------------------------

void rules_init(Rules *self, double speed, double acceleration, double rounding, Travel travel) {
    new (self)
        Rules{speed, acceleration, {}, {}, limits_of(travel), rounding, false, {}, {}, {}, {}, {}, {}, {}};
}

void rules_set_paces(Rules &rules, Input1<double> speed, Input1<double> acceleration) {
    rules.own_speed_rad_s = vector_of(speed);
    rules.own_acceleration_rad_s2 = vector_of(acceleration);
}

void rules_expect(Rules &rules, Pairs start, Pairs goal, Flags arrives, Input1<double> approach) {
    if (goal.shape(0) != 0) need_rows("arrives", arrives.shape(0), goal.shape(0));
    rules.start = angles_of(start);
    rules.goal = angles_of(goal);
    rules.arrives = flags_of(arrives);
    rules.approach_rad = vector_of(approach);
}

void rules_say(Rules &rules, int robot, const std::array<double, 3> &alpha,
               const std::array<double, 3> &beta) {
    rules.approaches.push_back({robot, last_leg_of(alpha), last_leg_of(beta)});
}

Dict dict_of(const Gap &g) {
    Dict d;
    d["gap_mm"] = g.gap_mm;
    d["time_s"] = g.time_s;
    d["robot"] = g.robot;
    d["other"] = g.other;
    return d;
}

Dict dict_of(const Verification &v) {
    nb::list violations;
    for (const Violation &x : v.violations)
        violations.append(nb::make_tuple(to_string(x.fault), x.robot, x.other, x.time_s, x.depth));
    Dict d;
    d["violations"] = violations;
    d["robots"] = dict_of(v.robots);
    d["obstacles"] = dict_of(v.obstacles);
    d["top_speed_rad_s"] = v.top_speed_rad_s;
    d["top_acceleration_rad_s2"] = v.top_acceleration_rad_s2;
    d["top_jump_rad_s"] = v.top_jump_rad_s;
    return d;
}

Dict verify_all(const Bodies &bodies, const std::vector<Points> &motions, const Rules &rules) {
    const size_t n = bodies.arms.size();
    need_rows("motions", motions.size(), n);
    if (!rules.own_speed_rad_s.empty()) need_rows("speed", rules.own_speed_rad_s.size(), n);
    if (!rules.own_acceleration_rad_s2.empty())
        need_rows("acceleration", rules.own_acceleration_rad_s2.size(), n);
    if (!rules.travels.empty()) need_rows("travels", rules.travels.size(), n);
    if (!rules.start.empty()) need_rows("start", rules.start.size(), n);
    if (!rules.goal.empty()) need_rows("goal", rules.goal.size(), n);
    if (!rules.approach_rad.empty()) need_rows("approach", rules.approach_rad.size(), n);
    for (const Approach &said : rules.approaches)
        if (said.robot < 0 || static_cast<size_t>(said.robot) >= n)
            throw nb::index_error("an approach of no positioner");
    std::vector<Motion> all;
    for (const Points &rows : motions) all.push_back(motion_from(rows));
    Verification result;
    {
        nb::gil_scoped_release release;
        result = verify(bodies, all, rules);
    }
    return dict_of(result);
}

void bind_verify(nb::module_ &m) {
    nb::class_<Rules>(m, "Rules", "What a plan is held to.")
        .def("__init__", &rules_init, nb::kw_only(), nb::arg("speed"), nb::arg("acceleration"),
             nb::arg("rounding"), nb::arg("travel"),
             "rad/s, rad/s2, by how many rad angles may be off, and [[alpha_min, alpha_max], [beta_min, "
             "beta_max]] in rad.")
        .def("expect", &rules_expect, nb::arg("start"), nb::arg("goal"), nb::arg("arrives"),
             nb::arg("approach"),
             "Also check where motions start and end, rad (N, 2), the goal only where `arrives`, and the "
             "approach, rad (N,). Empty: not checked.")
        .def("say", &rules_say, nb::arg("robot"), nb::arg("alpha"), nb::arg("beta"),
             "Also check the last legs of one positioner (index): height above its end in rad, begin and end "
             "in "
             "s.")
        .def("set_sides", &set_sides<Rules>, nb::arg("sides"),
             "From which side of their goals alpha and beta come: 1 from above, -1 from below.")
        .def("set_travels", &set_travels<Rules>, nb::arg("travels"),
             "The room of each positioner (N, 2, 2), instead of that of all, rad.")
        .def("set_paces", &rules_set_paces, nb::arg("speed"), nb::arg("acceleration"),
             "Limits of each positioner instead of those of all: rad/s and rad/s2 (N,).")
        .def_rw("separating", &Rules::separating,
                "bodies that overlap at the start may move if they only move apart");
    m.def("verify", &verify_all, nb::arg("bodies"), nb::arg("motions"), nb::arg("rules"),
          "Proof in continuous time for motions (n, 3): time_s, alpha_rad, beta_rad. Violations are (fault, "
          "robot, other, time_s, depth in mm, rad, rad/s or rad/s2).");
}

// --- if one is late ---------------------------------------------------------------------------

using LatePairs = std::vector<std::tuple<int, int, double, double, double, double>>;

std::tuple<LatePairs, int> find_lateness(const Bodies &bodies, const std::vector<Points> &motions,
                                         double late) {
    need_rows("motions", motions.size(), bodies.arms.size());
    std::vector<Motion> all;
    for (const Points &rows : motions) all.push_back(motion_from(rows));
    if (!std::all_of(all.begin(), all.end(), sound))
        throw nb::value_error("motions: times must rise from 0, and all numbers be finite");
    if (!(late >= 0.0)) throw nb::value_error("late: must not be negative");
    Lateness found;
    {
        nb::gil_scoped_release release;
        found = lateness(bodies, all, late);
    }
    LatePairs pairs;
    for (const LatePair &p : found.pairs)
        pairs.emplace_back(p.late, p.other, p.bears_s, p.late_at_s, p.other_at_s, p.depth_mm);
    return {pairs, found.looked_at};
}

void bind_lateness(nb::module_ &m) {
    m.def(
        "lateness", &find_lateness, nb::arg("bodies"), nb::arg("motions"), nb::arg("late"),
        "Proof in continuous time for motions (n, 3): time_s, alpha_rad, beta_rad, of which one is late. "
        "Pairs that touch at some lateness: (which is late, other, the lateness that they bear in s, moment "
        "of the plan at which the late one is, and the other, in s, depth in mm; both of no more than `late` "
        "s where they touch then); and how many pairs both move and can meet, each order for itself. "
        "ValueError for motions that are not sound.");
}

// --- goals alone -------------------------------------------------------------------------------

Output<int, -1, 2> find_conflicts(const Bodies &bodies, Pairs goals, const FromGoal &approach) {
    need_rows("goals", goals.shape(0), bodies.arms.size());
    const auto found = conflicts(bodies, angles_of(goals), approach_of(approach));
    auto out = new_array<int, -1, 2>({found.size(), 2});
    for (size_t k = 0; k < found.size(); ++k) std::copy(found[k].begin(), found[k].end(), out.data() + 2 * k);
    return out;
}

std::vector<int> rows_of(const Bodies &bodies, const Input1<std::int64_t> &rows) {
    std::vector<int> out;
    for (size_t k = 0; k < rows.shape(0); ++k)
        out.push_back(row_of(static_cast<double>(rows.data()[k]), bodies.arms.size(), "a goal"));
    return out;
}

Output<bool, -1> clear_of_obstacles(const Bodies &bodies, Input1<std::int64_t> rows, Pairs goals,
                                    const FromGoal &approach) {
    need_rows("goals", goals.shape(0), rows.shape(0));
    return array_of(static_ok(bodies, rows_of(bodies, rows), angles_of(goals), approach_of(approach)));
}

Output<bool, -1> clear_pairs(const Bodies &bodies, Input1<std::int64_t> rows, Pairs goals,
                             Input1<std::int64_t> others, Pairs other_goals, const FromGoal &approach) {
    for (size_t n : {goals.shape(0), others.shape(0), other_goals.shape(0)})
        need_rows("pairs_clear", n, rows.shape(0));
    const PlacesOf first{rows_of(bodies, rows), angles_of(goals)};
    const PlacesOf second{rows_of(bodies, others), angles_of(other_goals)};
    return array_of(pairs_clear(bodies, first, second, approach_of(approach)));
}

void bind_goals(nb::module_ &m) {
    m.def("conflicts", &find_conflicts, nb::arg("bodies"), nb::arg("goals_rad"), nb::arg("approach_rad"),
          "Pairs (P, 2) of positioners that touch at their goals (N, 2) or on the approach that all make "
          "together: rad above both axes, or of alpha and beta with the sign of each.");
    m.def("static_ok", &clear_of_obstacles, nb::arg("bodies"), nb::arg("rows"), nb::arg("goals_rad"),
          nb::arg("approach_rad"),
          "For positioners (n,) by index, which may repeat: whether goal (n, 2) and approach are clear of "
          "obstacles.");
    m.def("pairs_clear", &clear_pairs, nb::arg("bodies"), nb::arg("rows"), nb::arg("goals_rad"),
          nb::arg("other_rows"), nb::arg("other_goals_rad"), nb::arg("approach_rad"),
          "One by one: whether two positioners (n,) by index, which may repeat, stay apart at their goals "
          "(n, 2) and on the approach.");
}

} // namespace

void bind_planning(nb::module_ &m) {
    nb::module_ p =
        m.def_submodule("planning", "Collision-free motion of all positioners, and its verification.");
    bind_plan(p);
    bind_verify(p);
    bind_lateness(p);
    bind_goals(p);
}
