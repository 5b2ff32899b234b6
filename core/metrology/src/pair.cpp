#include "fit.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace fl::metrology {
namespace {

constexpr int n = 7; // flux, x, y of the first, of the second; background
constexpr int most_iterations = 40;
constexpr double enough = 0.05;                                     // of the statistical error
constexpr double cut_sigma = 5;                                     // as of single spots
constexpr std::array<double, 5> slack{0.3, 0.15, 0.07, 0.03, 0.01}; // of the peak, while places are rough

using Vector = std::array<double, n>;
using Matrix = std::array<Vector, n>;

// What one pixel sees of a spot.
struct Seen {
    double q, value; // of flux 1
    double by_x, by_y;
};

// One of the two: its profile, and how far it is read.
class Lobe {
  public:
    Lobe(const Profile &profile, const Fit &fit)
        : shape_(shape_of(profile, ellipse_at(profile, fit.x, fit.y))), q_max_(fit.q_max) {}

    Seen at(double dx, double dy) const {
        const double qx = 2 * shape_.xx * dx + shape_.xy * dy, qy = 2 * shape_.yy * dy + shape_.xy * dx;
        const double q = 0.5 * (qx * dx + qy * dy), bend = shape_.square * q;
        double e = std::exp(-q * (shape_.linear + bend) / 32), rate = -1.0 / 32; // lambda = 16
        double value = e * shape_.amplitude[5], slope = rate * value;
        for (std::size_t k = 5; k-- > 0;) {
            e *= e, rate *= 2;
            value += e * shape_.amplitude[k], slope += rate * e * shape_.amplitude[k];
        }
        slope *= shape_.linear + 2 * bend;
        return {q, value, -slope * qx, -slope * qy};
    }
    // 1 within the ellipse, 0 beyond
    double window(double q) const { return std::clamp(5 * (q_max_ - q) / q_max_, 0.0, 1.0); }

  private:
    Shape shape_;
    double q_max_;
};

// Fisher matrix, score, and what was seen on the way.
struct Sums {
    Matrix fisher{};
    Vector score{};
    double chi2 = 0, pixels = 0, left_out = 0;
    std::array<double, 2> light{}, light_lost{};
};

struct Pair {
    const Stamp &stamp;
    std::array<Lobe, 2> lobes;
    double inverse_gain, tolerance;

    void add_pixel(int x, int y, const Vector &p, double floor_variance, Sums &sums) const {
        const auto at = static_cast<std::size_t>(y * stamp.width + x);
        const std::array<Seen, 2> seen{lobes[0].at(x - p[1], y - p[2]), lobes[1].at(x - p[4], y - p[5])};
        const double inside = std::max(lobes[0].window(seen[0].q), lobes[1].window(seen[1].q));
        if (!(inside > 0)) return;
        const double light = std::max(p[0] * seen[0].value + p[3] * seen[1].value, 0.0);
        const double variance = stamp.variance[at] + light * inverse_gain, misfit = tolerance * light;
        const double residual = stamp.value[at] - light - p[6];
        const double t =
            residual * residual / (cut_sigma * cut_sigma * (variance + misfit * misfit + floor_variance));
        const double say = inside * stamp.usable[at], good = say / (1 + t * t * t * t);
        const double weight = good / variance;
        const Vector gradient{seen[0].value,
                              p[0] * seen[0].by_x,
                              p[0] * seen[0].by_y,
                              seen[1].value,
                              p[3] * seen[1].by_x,
                              p[3] * seen[1].by_y,
                              1};
        for (std::size_t a = 0; a < n; ++a) {
            sums.score[a] += weight * residual * gradient[a];
            for (std::size_t b = 0; b <= a; ++b) sums.fisher[a][b] += weight * gradient[a] * gradient[b];
        }
        sums.chi2 += weight * residual * residual, sums.pixels += good, sums.left_out += say - good;
        for (std::size_t k = 0; k < 2; ++k) {
            const double square = lobes[k].window(seen[k].q) * seen[k].value * seen[k].value;
            sums.light[k] += square, sums.light_lost[k] += (1 - good / inside) * square;
        }
    }

    Sums sums(const Vector &p, double floor_variance) const {
        Sums out;
        for (int y = 0; y < stamp.height; ++y)
            for (int x = 0; x < stamp.width; ++x) add_pixel(x, y, p, floor_variance, out);
        return out;
    }
};

// Inverse of a symmetric matrix given by its lower triangle; false where it is singular.
bool inverse_of(Matrix m, Matrix &out) {
    Matrix l{};
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double v = m[i][j];
            for (std::size_t k = 0; k < j; ++k) v -= l[i][k] * l[j][k];
            if (i == j && !(v > 1e-10 * m[i][i])) return false;
            l[i][j] = i == j ? std::sqrt(v) : v / l[j][j];
        }
    for (std::size_t c = 0; c < n; ++c) {
        Vector b{};
        b[c] = 1;
        for (std::size_t i = 0; i < n; ++i) {
            for (std::size_t k = 0; k < i; ++k) b[i] -= l[i][k] * b[k];
            b[i] /= l[i][i];
        }
        for (std::size_t i = n; i-- > 0;) {
            for (std::size_t k = i + 1; k < n; ++k) b[i] -= l[k][i] * b[k];
            b[i] /= l[i][i];
        }
        for (std::size_t i = 0; i < n; ++i) out[i][c] = b[i];
    }
    return true;
}

Vector step_of(const Matrix &inverse, const Vector &score) {
    Vector out{};
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t k = 0; k < n; ++k) out[i] += inverse[i][k] * score[k];
    return out;
}

void take(const Pair &pair, const Vector &p, const Sums &sums, const Matrix &cov, std::size_t k, Fit &fit) {
    const std::size_t f = 3 * k;
    const double x = pair.stamp.x0 + p[f + 1], y = pair.stamp.y0 + p[f + 2];
    fit.moved = std::hypot(x - fit.x, y - fit.y);
    fit.flux = p[f], fit.x = x, fit.y = y, fit.background = p[6];
    fit.var_flux = cov[f][f], fit.var_x = cov[f + 1][f + 1], fit.var_y = cov[f + 2][f + 2];
    fit.cov_xy = cov[f + 1][f + 2];
    fit.explained = p[f] * p[f] * sums.fisher[f][f];
    fit.freedom = std::max(sums.pixels - n, 1.0), fit.chi2 = sums.chi2 / fit.freedom;
    fit.left_out = sums.left_out, fit.lost = sums.light_lost[k] / std::max(sums.light[k], 1e-300);
    fit.converged = true;
}

} // namespace

bool solve_pair(const Stamp &stamp, const Profile &profile, const Settings &settings, Fit &first,
                Fit &second) {
    const Ellipse ellipse = ellipse_at(profile, first.x, first.y);
    const double longest = 0.4 * std::sqrt(ellipse.area());
    const double peak = std::max(first.flux, second.flux) * profile_value(profile, 0) / ellipse.area();
    const Pair pair{stamp,
                    {Lobe(profile, first), Lobe(profile, second)},
                    1 / settings.gain_e_adu,
                    std::max(0.003, 3 * profile.misfit)};
    Vector p{first.flux,
             first.x - stamp.x0,
             first.y - stamp.y0,
             second.flux,
             second.x - stamp.x0,
             second.y - stamp.y0,
             0};
    for (std::size_t k = 0; k < most_iterations; ++k) {
        const double floor = k < slack.size() ? slack[k] * peak : 0;
        const Sums sums = pair.sums(p, floor * floor);
        Matrix cov;
        if (!inverse_of(sums.fisher, cov)) return false;
        const Vector step = step_of(cov, sums.score);
        const double size = std::max(std::hypot(step[1], step[2]), std::hypot(step[4], step[5]));
        if (!std::isfinite(size + step[0] + step[3] + step[6])) return false;
        const double brake = size > longest ? longest / size : 1;
        for (std::size_t i = 0; i < n; ++i) {
            const double next = p[i] + (i % 3 == 0 && i < 6 ? step[i] : brake * step[i]);
            p[i] = i % 3 == 0 && i < 6 ? std::max(next, 0.3 * p[i]) : next;
        }
        const double error = cov[1][1] + cov[2][2] + cov[4][4] + cov[5][5];
        if (k < slack.size() || size * size > enough * enough * error) continue;
        take(pair, p, sums, cov, 0, first), take(pair, p, sums, cov, 1, second);
        return true;
    }
    return false;
}

} // namespace fl::metrology
