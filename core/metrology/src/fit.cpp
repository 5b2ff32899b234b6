#include "fit.hpp"
#include "machine.hpp"
#include "pixels.hpp"

#include <algorithm>

namespace fl::metrology {

std::array<double, Profile::terms> polynomial_terms(double u, double v) {
    const double u2 = u * u, v2 = v * v;
    return {1,      u,      v,       u2,         u * v,   v2,         u2 * u, u2 * v,
            u * v2, v2 * v, u2 * u2, u2 * u * v, u2 * v2, u * v2 * v, v2 * v2};
}

namespace {

constexpr int most_iterations = 15;
constexpr double enough = 0.1;    // of the statistical error: the step after would be a tenth of it again
constexpr float cut_sigma = 5.0f; // a Poisson pixel beyond this is rarer than a cosmic ray
constexpr double kept_knowledge = 0.99;
constexpr double flat_square = 0.5;
constexpr double widest_px2 = 1e4; // FWHM 235 px
constexpr double pi = 3.14159265358979323846;
constexpr std::array<double, 6> lambda{0.5, 1, 2, 4, 8, 16};

double polynomial(const std::array<double, Profile::terms> &c, double u, double v) {
    const auto t = polynomial_terms(u, v);
    double sum = 0;
    for (std::size_t k = 0; k < t.size(); ++k) sum += c[k] * t[k];
    return sum;
}

// Cholesky of the 4 x 4 Fisher matrix in place of a library: fixed size, and singular is an answer.
struct Solver {
    std::array<std::array<double, 4>, 4> l{};
    int n;
    bool regular = true;

    Solver(const Normal &normal, int size) : n(size) {
        const auto &s = normal.sum;
        const double a[4][4] = {{s[0], s[1], s[2], s[3]},
                                {s[1], s[4], s[5], s[6]},
                                {s[2], s[5], s[7], s[8]},
                                {s[3], s[6], s[8], s[9]}};
        for (int i = 0; i < n; ++i)
            for (int j = 0; j <= i; ++j) {
                double v = a[i][j];
                for (int k = 0; k < j; ++k) v -= l[i][k] * l[j][k];
                if (i == j && !(v > 1e-10 * a[i][i])) regular = false;
                l[i][j] = i == j ? std::sqrt(std::max(v, 1e-300)) : v / l[j][j];
            }
    }

    std::array<double, 4> solve(std::array<double, 4> b) const {
        for (int i = 0; i < n; ++i) {
            for (int k = 0; k < i; ++k) b[i] -= l[i][k] * b[k];
            b[i] /= l[i][i];
        }
        for (int i = n; i-- > 0;) {
            for (int k = i + 1; k < n; ++k) b[i] -= l[k][i] * b[k];
            b[i] /= l[i][i];
        }
        return b;
    }
};

// Wide open and on the core alone while the position is rough, then as strict as the profile is good.
constexpr int rough_iterations = 2;
constexpr double core_q = 5.0;

Judge judge_at(int iteration, const Profile &profile, const Settings &settings, double peak, double q_max) {
    constexpr std::array<double, rough_iterations> slack{0.20, 0.03}; // of the peak, for a wrong position
    constexpr std::array<double, rough_iterations> trust{0.50, 0.15}; // of the pixel, for a wrong flux
    const double fine = std::max(0.003, 3 * profile.misfit);
    const bool rough = iteration < rough_iterations;
    const double floor = rough ? slack[iteration] * peak : 0.0;
    const double tolerance = rough ? std::max(trust[iteration], fine) : fine;
    return {cut_sigma, static_cast<float>(tolerance), static_cast<float>(floor * floor),
            static_cast<float>(1 / settings.gain_e_adu), static_cast<float>(rough ? core_q : q_max)};
}

void take_covariance(const Normal &normal, const Solver &solver, Fit &fit) {
    const auto cx = solver.solve({0, 1, 0, 0}), cy = solver.solve({0, 0, 1, 0}),
               cf = solver.solve({1, 0, 0, 0});
    fit.var_x = cx[1], fit.cov_xy = cx[2], fit.var_y = cy[2], fit.var_flux = cf[0];
    fit.freedom = std::max(normal.sum[Normal::pixels] - solver.n, 1.0);
    fit.chi2 = normal.sum[Normal::chi2] / fit.freedom;
    fit.left_out = normal.sum[Normal::left_out];
    fit.lost = normal.sum[Normal::light_lost] / std::max(normal.sum[Normal::light], 1e-300);
}

} // namespace

bool Ellipse::sound() const {
    return xx > 0.1 && yy > 0.1 && xx < widest_px2 && yy < widest_px2 && xx * yy - xy * xy > 0.01;
}
double Ellipse::area() const { return std::sqrt(xx * yy - xy * xy); }
double Ellipse::half_width(double q_max) const { return std::sqrt(q_max * xx); }
double Ellipse::half_height(double q_max) const { return std::sqrt(q_max * yy); }

Ellipse ellipse_at(const Profile &profile, double x_px, double y_px) {
    const double u = x_px / profile.half_width_px - 1, v = y_px / profile.half_height_px - 1;
    const Ellipse e{polynomial(profile.shape[0], u, v), polynomial(profile.shape[1], u, v),
                    polynomial(profile.shape[2], u, v)};
    // outside the spots it was fitted on the polynomial may leave sense: fall back to the middle of the frame
    return e.sound() ? e : Ellipse{profile.shape[0][0], profile.shape[1][0], profile.shape[2][0]};
}

Shape shape_of(const Profile &profile, const Ellipse &e) {
    const double det = e.xx * e.yy - e.xy * e.xy, norm = 1 / (2 * pi * std::sqrt(det));
    Shape s{static_cast<float>(e.yy / det),
            static_cast<float>(-2 * e.xy / det),
            static_cast<float>(e.xx / det),
            {}};
    for (std::size_t k = 0; k < lambda.size(); ++k)
        s.amplitude[k] = static_cast<float>(profile.amplitude[k] * norm);
    if (profile.flat_top) s.linear = 0, s.square = static_cast<float>(flat_square);
    return s;
}

std::array<double, Profile::components> rung_weights(const Profile &profile) {
    if (!profile.flat_top) return lambda;
    std::array<double, Profile::components> out{};
    // pi int exp(-q^2 / (4 lambda)) dq over 2 pi
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = 0.5 * std::sqrt(pi * lambda[k]);
    return out;
}

double profile_value(const Profile &profile, double q) {
    const double t = profile.flat_top ? flat_square * q * q : q;
    double sum = 0;
    for (std::size_t k = 0; k < lambda.size(); ++k)
        sum += profile.amplitude[k] * std::exp(-t / (2 * lambda[k]));
    return sum / (2 * pi);
}

double profile_slope(const Profile &profile, double q) {
    const double t = profile.flat_top ? flat_square * q * q : q,
                 rate = profile.flat_top ? 2 * flat_square * q : 1.0;
    double sum = 0;
    for (std::size_t k = 0; k < lambda.size(); ++k)
        sum -= profile.amplitude[k] / (2 * lambda[k]) * std::exp(-t / (2 * lambda[k]));
    return rate * sum / (2 * pi);
}

// The information on x inside q is proportional to int q' slope^2 / (1 + contrast * value / peak) dq'.
double reach(const Profile &profile, double contrast) {
    constexpr double step = 0.25;
    constexpr int n = 240;
    std::array<double, n> inside{};
    const double peak = profile_value(profile, 0);
    double sum = 0;
    for (int k = 0; k < n; ++k) {
        const double q = (k + 0.5) * step, slope = profile_slope(profile, q);
        sum += q * slope * slope / (1 + contrast * std::max(profile_value(profile, q), 0.0) / peak);
        inside[static_cast<std::size_t>(k)] = sum;
    }
    const auto at = std::lower_bound(inside.begin(), inside.end(), kept_knowledge * sum);
    return std::clamp(static_cast<double>(at - inside.begin() + 1) * step, 7.0, 30.0);
}

Reach::Reach(const Profile &profile) {
    for (std::size_t k = 0; k < q_max_.size(); ++k)
        q_max_[k] = reach(profile, std::ldexp(1.0, static_cast<int>(k)));
}

double Reach::operator()(double contrast) const {
    const double last = std::ldexp(1.0, static_cast<int>(q_max_.size()) - 2);
    const int k = contrast > 1 ? std::ilogb(std::min(contrast, last)) + 1 : 0;
    return q_max_[static_cast<std::size_t>(k)];
}

namespace {

// A level that rises along a row.
struct Slope {
    float left, rise;
};

// One row: pixels less a sloping background, 1 where they may be used; returns whether one is saturated.
template <class P>
bool copy_row(const typename P::Raw *row, int width, Slope background, float saturation, float *value,
              float *usable) {
    unsigned any = 0;
    for (int i = 0; i < width; ++i) {
        const float v = static_cast<float>(P::key(row[i]));
        const bool good = v < saturation; // false for NaN: no light
        any |= static_cast<unsigned>(v >= saturation);
        usable[i] = good ? 1.0f : 0.0f;
        value[i] = good ? v - background.left - background.rise * static_cast<float>(i) : 0.0f;
    }
    return any != 0;
}

// The background of the stamp is a plane: its tiles are far wider.
template <class P> Cut copy_pixels(const Pixels<P> &pixels, const Scene &scene, Stamp &stamp, int width) {
    const Background &background = scene.background;
    Cut cut;
    const double x1 = stamp.x0 + width - 1, y1 = stamp.y0 + stamp.height - 1;
    const float corner = background.level_at(stamp.x0, stamp.y0);
    const float across =
        (background.level_at(x1, stamp.y0) - corner) / static_cast<float>(std::max(width - 1, 1));
    const float down =
        (background.level_at(stamp.x0, y1) - corner) / static_cast<float>(std::max(stamp.height - 1, 1));
    const auto saturation = static_cast<float>(scene.settings.saturation_adu);
    for (int j = 0; j < stamp.height; ++j) {
        const std::size_t at = static_cast<std::size_t>(j * stamp.width);
        const Slope slope{corner + down * static_cast<float>(j), across};
        cut.saturated |= copy_row<P>(pixels.row(stamp.y0 + j) + stamp.x0, width, slope, saturation,
                                     &stamp.value[at], &stamp.usable[at]);
    }
    return cut;
}

} // namespace

Cut cut_out(const Scene &scene, const Box &box, Stamp &stamp) {
    const ImageView &image = scene.image;
    // a pixel farther out is as good as any farther
    const int x0 = whole(std::floor(box.x - box.half_width), -1, image.width),
              x1 = whole(std::ceil(box.x + box.half_width), -1, image.width);
    const int y0 = whole(std::floor(box.y - box.half_height), -1, image.height),
              y1 = whole(std::ceil(box.y + box.half_height), -1, image.height);
    const int left = std::clamp(x0, 0, image.width - 1), right = std::clamp(x1, left, image.width - 1);
    const int top = std::clamp(y0, 0, image.height - 1), bottom = std::clamp(y1, top, image.height - 1);
    stamp.resize(left, top, right - left + 1, bottom - top + 1);
    const float noise = scene.background.noise_at(box.x, box.y);
    std::fill(stamp.variance.begin(), stamp.variance.end(), noise * noise);
    Cut cut = with_pixels(
        image, [&](const auto &pixels) { return copy_pixels(pixels, scene, stamp, right - left + 1); });
    cut.truncated = left != x0 || right != x1 || top != y0 || bottom != y1;
    return cut;
}

void fetch_ahead(const ImageView &image, const Box &box) {
    const auto pixel_bytes = [&] {
        if (image.type == PixelType::F64) return 8;
        return image.type == PixelType::U16 || image.type == PixelType::U16Fits ? 2 : 4;
    }();
    const int x0 = whole(box.x - box.half_width, 0, image.width - 1);
    const int x1 = whole(box.x + box.half_width + 1, 0, image.width - 1);
    const int y0 = whole(box.y - box.half_height, 0, image.height - 1);
    const int y1 = whole(box.y + box.half_height + 1, 0, image.height - 1);
    for (int j = y0; j <= y1; ++j) {
        const std::byte *row = image.data + j * image.row_bytes;
        for (int b = x0 * pixel_bytes; b <= x1 * pixel_bytes; b += static_cast<int>(line_bytes))
            __builtin_prefetch(row + b);
        __builtin_prefetch(row + x1 * pixel_bytes);
    }
}

void solve(const Stamp &stamp, const Profile &profile, const Settings &settings, bool free_background,
           Fit &fit) {
    const Ellipse ellipse = ellipse_at(profile, fit.x, fit.y);
    const Shape shape = shape_of(profile, ellipse);
    const double peak_share = profile_value(profile, 0) / ellipse.area();
    const double longest = 0.7 * std::sqrt(ellipse.area()), x0 = fit.x, y0 = fit.y;
    FitState state{fit.flux, fit.x - stamp.x0, fit.y - stamp.y0, free_background ? fit.background : 0.0};
    fit.converged = false;
    for (int k = 0; k < most_iterations && !fit.converged; ++k) {
        const Judge judge = judge_at(k, profile, settings, std::max(state.flux, 0.0) * peak_share, fit.q_max);
        const Normal n = normal_equations(stamp, shape, state, judge);
        const Solver solver(n, free_background && k >= rough_iterations ? 4 : 3);
        if (!solver.regular) break;
        const auto step =
            solver.solve({n.sum[Normal::sf], n.sum[Normal::sx], n.sum[Normal::sy], n.sum[Normal::sb]});
        const double size = std::hypot(step[1], step[2]), brake = size > longest ? longest / size : 1.0;
        if (!std::isfinite(size + step[0] + step[3])) break;
        state.flux = std::max(state.flux + step[0], 0.3 * state.flux); // a flux below zero has no gradient
        state.x += brake * step[1], state.y += brake * step[2];
        if (solver.n == 4) state.background += step[3];
        take_covariance(n, solver, fit);
        fit.converged = k >= rough_iterations && size * size < enough * enough * (fit.var_x + fit.var_y);
    }
    fit.flux = state.flux, fit.background = state.background;
    fit.explained = fit.flux * fit.flux / fit.var_flux;
    fit.x = stamp.x0 + state.x, fit.y = stamp.y0 + state.y;
    fit.moved = std::hypot(fit.x - x0, fit.y - y0);
}

} // namespace fl::metrology
