// Plans and their verification on plain arrays; the Python side has the names and units people use.
#include "bind.hpp"
#include "fiberloom/planning.hpp"

#include <nanobind/stl/tuple.h>

namespace {

using namespace fl::planning;
using Arms = nb::ndarray<const double, nb::shape<-1, 5>, nb::c_contig, nb::device::cpu>;
using Pairs = nb::ndarray<const double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Capsules = nb::ndarray<const double, nb::shape<-1, 5>, nb::c_contig, nb::device::cpu>;
using Four = nb::ndarray<const double, nb::shape<2, 2>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

Bodies bodies_of(const Arms &arms, const Four &segment_radius, const Capsules &obstacles) {
    const double *s = segment_radius.data(); // [[from, to], [radius, 0]]
    Bodies bodies{{}, s[0], s[1], s[2], {}};
    for (size_t i = 0; i < arms.shape(0); ++i) {
        const double *a = arms.data() + 5 * i;
        bodies.arms.push_back({{a[0], a[1]}, a[2], a[3], a[4]});
    }
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

nb::tuple plan_all(Arms arms, Four segment_radius, Capsules obstacles, Pairs start, Pairs goal, Flags fixed,
                   Four travel, double speed, double acceleration, double approach, double grid,
                   double clearance, double first_deadline, double last_deadline, double effort,
                   std::uint64_t seed) {
    const size_t n = arms.shape(0);
    need_rows("start", start.shape(0), n);
    need_rows("goal", goal.shape(0), n);
    need_rows("fixed", fixed.shape(0), n);
    const Bodies bodies = bodies_of(arms, segment_radius, obstacles);
    const double *t = travel.data();
    const Task task{
        angles_of(start), angles_of(goal), {fixed.data(), fixed.data() + n}, {t[0], t[1], t[2], t[3]}};
    Settings settings;
    settings.speed_rad_s = speed;
    settings.acceleration_rad_s2 = acceleration;
    settings.approach_rad = approach;
    settings.grid_rad = grid;
    settings.clearance_mm = clearance;
    settings.first_deadline = first_deadline;
    settings.last_deadline = last_deadline;
    settings.effort = effort;
    settings.seed = seed;
    Outcome outcome;
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

} // namespace

void bind_planning(nb::module_ &m) {
    nb::module_ p =
        m.def_submodule("planning", "Collision-free motion of all positioners, and its verification.");
    p.def("plan", &plan_all, nb::arg("arms"), nb::arg("segment_radius"), nb::arg("obstacles"),
          nb::arg("start"), nb::arg("goal"), nb::arg("fixed"), nb::arg("travel"), nb::kw_only(),
          nb::arg("speed"), nb::arg("acceleration"), nb::arg("approach"), nb::arg("grid"),
          nb::arg("clearance_mm"), nb::arg("first_deadline"), nb::arg("last_deadline"), nb::arg("effort"),
          nb::arg("seed"),
          "Motions (list of (n, 3): time_s, alpha_rad, beta_rad), who does not arrive (index, why, other), "
          "statistics.");
}
