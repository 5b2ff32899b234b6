// Kinematics over whole focal planes. A row of `arms` is one positioner:
// centre_x_mm, centre_y_mm, l_alpha_mm, alpha_off_rad, beta_off_rad.
#include "bind.hpp"
#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"

#include <algorithm>

namespace {

using Arms = Input<double, -1, 5>;
using Pairs = Input<double, -1, 2>;
using Segments = Input<double, -1, 4>;

fl::Arm arm_at(const Arms &arms, size_t i) {
    const double *a = arms.data() + 5 * i;
    return {{a[0], a[1]}, a[2], a[3], a[4]};
}

fl::Vec2 vec_at(const Pairs &pairs, size_t i) {
    const double *p = pairs.data() + 2 * i;
    return {p[0], p[1]};
}

fl::Angles angles_at(const Pairs &pairs, size_t i) {
    const double *p = pairs.data() + 2 * i;
    return {p[0], p[1]};
}

fl::Segment segment_at(const Segments &rows, size_t i) {
    const double *s = rows.data() + 4 * i;
    return {{s[0], s[1]}, {s[2], s[3]}};
}

void same_rows(size_t n, std::initializer_list<size_t> others) {
    for (size_t m : others)
        if (m != n) throw nb::value_error("arms, points, angles and targets need the same number of rows");
}

Output<double, -1, 2> forward(Arms arms, Pairs point, Pairs angles) {
    const size_t n = arms.shape(0);
    same_rows(n, {point.shape(0), angles.shape(0)});
    auto xy = new_array<double, -1, 2>({n, 2});
    for (size_t i = 0; i < n; ++i) {
        const fl::Vec2 p = fl::forward(arm_at(arms, i), vec_at(point, i), angles_at(angles, i));
        xy.data()[2 * i] = p.x;
        xy.data()[2 * i + 1] = p.y;
    }
    return xy;
}

constexpr nb::ssize_t max_solutions = fl::Solutions::max_count;
using Inverse = std::tuple<Output<double, -1, max_solutions, 2>, Output<int, -1>, Output<double, -1>>;

// limits: of the first arm; of_each: how many numbers on those of the next one are, 0 where all have the
// same.
Inverse inverse_within(Arms arms, Pairs point, Pairs target, const double *limits, size_t of_each) {
    const size_t n = arms.shape(0);
    same_rows(n, {point.shape(0), target.shape(0)});
    constexpr size_t k = fl::Solutions::max_count;
    auto angles = new_array<double, -1, max_solutions, 2>({n, k, 2});
    auto count = new_array<int, -1>({n});
    auto gap = new_array<double, -1>({n});
    for (size_t i = 0; i < n; ++i) {
        const double *l = limits + of_each * i;
        const fl::Limits lim{l[0], l[1], l[2], l[3]};
        const fl::Solutions s = fl::inverse(arm_at(arms, i), vec_at(point, i), vec_at(target, i), lim);
        for (size_t j = 0; j < k; ++j) {
            angles.data()[(i * k + j) * 2] = s.angles[j].alpha_rad;
            angles.data()[(i * k + j) * 2 + 1] = s.angles[j].beta_rad;
        }
        count.data()[i] = s.count;
        gap.data()[i] = s.gap_mm;
    }
    return {angles, count, gap};
}

Inverse inverse(Arms arms, Pairs point, Pairs target, Pairs limits) {
    if (limits.shape(0) != 2) throw nb::value_error("limits: [[alpha_min, alpha_max], [beta_min, beta_max]]");
    return inverse_within(arms, point, target, limits.data(), 0);
}

Inverse inverse_each(Arms arms, Pairs point, Pairs target, Input<double, -1, 2, 2> limits) {
    same_rows(arms.shape(0), {limits.shape(0)});
    return inverse_within(arms, point, target, limits.data(), 4);
}

Output<double, -1, 2, 2> jacobian(Arms arms, Pairs point, Pairs angles) {
    const size_t n = arms.shape(0);
    same_rows(n, {point.shape(0), angles.shape(0)});
    auto out = new_array<double, -1, 2, 2>({n, 2, 2});
    for (size_t i = 0; i < n; ++i) {
        const auto j = fl::jacobian(arm_at(arms, i), vec_at(point, i), angles_at(angles, i));
        std::copy(j.begin(), j.end(), out.data() + 4 * i);
    }
    return out;
}

Output<double, -1> segment_distance(Segments first, Segments second) {
    const size_t n = first.shape(0);
    same_rows(n, {second.shape(0)});
    auto out = new_array<double, -1>({n});
    for (size_t i = 0; i < n; ++i)
        out.data()[i] = fl::segment_distance(segment_at(first, i), segment_at(second, i));
    return out;
}

Output<double, -1, 7> closest_points(Segments first, Segments second) {
    const size_t n = first.shape(0);
    same_rows(n, {second.shape(0)});
    auto out = new_array<double, -1, 7>({n, 7});
    for (size_t i = 0; i < n; ++i) {
        const fl::Closest c = fl::closest_points(segment_at(first, i), segment_at(second, i));
        const double row[] = {c.on_first.x,  c.on_first.y,   c.on_second.x, c.on_second.y,
                              c.along_first, c.along_second, c.distance_mm};
        std::copy(std::begin(row), std::end(row), out.data() + 7 * i);
    }
    return out;
}

Output<double, -1, 4> beta_segment(Arms arms, double from_mm, double to_mm, Pairs angles) {
    const size_t n = arms.shape(0);
    same_rows(n, {angles.shape(0)});
    auto out = new_array<double, -1, 4>({n, 4});
    for (size_t i = 0; i < n; ++i) {
        const fl::Segment s = fl::beta_segment(arm_at(arms, i), from_mm, to_mm, angles_at(angles, i));
        const double row[] = {s.a.x, s.a.y, s.b.x, s.b.y};
        std::copy(std::begin(row), std::end(row), out.data() + 4 * i);
    }
    return out;
}

} // namespace

void bind_geometry(nb::module_ &m) {
    nb::module_ g = m.def_submodule("geometry", "Kronig 2020, Eq. 1 and 2, row by row.");
    g.attr("MAX_SOLUTIONS") = fl::Solutions::max_count;
    g.def("forward", &forward, nb::arg("arms"), nb::arg("point_mm"), nb::arg("angles_rad"),
          "Focal-plane position (N, 2) in mm of a point on each beta arm. Eq. 1.");
    g.def("inverse", &inverse, nb::arg("arms"), nb::arg("point_mm"), nb::arg("target_mm"),
          nb::arg("limits_rad"),
          "Angles (N, 4, 2) in rad inside the limits, how many of the four hold, and how far in mm "
          "each target lies outside the annulus of its arms. Eq. 2, both elbows.");
    g.def("inverse_each", &inverse_each, nb::arg("arms"), nb::arg("point_mm"), nb::arg("target_mm"),
          nb::arg("limits_rad"), "As `inverse`, with limits of each arm, (N, 2, 2).");
    g.def("jacobian", &jacobian, nb::arg("arms"), nb::arg("point_mm"), nb::arg("angles_rad"),
          "d(x, y)/d(alpha, beta), (N, 2, 2) in mm/rad.");
    g.def("segment_distance", &segment_distance, nb::arg("first_mm"), nb::arg("second_mm"),
          "Distance (N,) in mm of pairs of segments, each x0, y0, x1, y1.");
    g.def("closest_points", &closest_points, nb::arg("first_mm"), nb::arg("second_mm"),
          "Per pair of segments: the nearest points x, y on each, how far along each (0..1), distance.");
    g.def("beta_segment", &beta_segment, nb::arg("arms"), nb::arg("from_mm"), nb::arg("to_mm"),
          nb::arg("angles_rad"), "Centre lines (N, 4) of the beta arms' capsules: x0, y0, x1, y1.");
}
