#include "fiberloom/render.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace fl::metrology {
namespace {

constexpr double pi = 3.14159265358979323846;

// Gauss-Legendre on [-1/2, 1/2]: four points in the core, two on the flank, one in the wings.
struct Rule {
    int n;
    std::array<double, 4> node, weight;
};
constexpr Rule four{4,
                    {-0.43056815579702629, -0.16999052179242813, 0.16999052179242813, 0.43056815579702629},
                    {0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693}};
constexpr Rule two{2, {-0.28867513459481288, 0.28867513459481288}, {0.5, 0.5}};
constexpr Rule one{1, {0.0}, {1.0}};
constexpr double core_q = 12, flank_q = 60;

struct Source {
    double x, y, xx, xy, yy, norm, parameter; // inverse of S, and the norm that makes the flux
    double half_width, half_height;
};

// x^-n, by multiplication where n is a small whole number.
double inverse_power(double x, double n) {
    constexpr double most = 8;
    if (n > most || n != std::floor(n)) return std::pow(x, -n);
    double power = x;
    for (int k = 1; k < static_cast<int>(n); ++k) power *= x;
    return 1 / power;
}

double density(PsfKind kind, double q, double parameter) {
    switch (kind) {
    case PsfKind::Gaussian:
        return std::exp(-0.5 * q);
    case PsfKind::Moffat:
        return inverse_power(1 + q, parameter);
    case PsfKind::Disc:
        break;
    }
    return 0.5 * std::erfc((std::sqrt(q) - 1) / (std::sqrt(2.0) * parameter));
}

// Integral of density over the plane for S = 1.
double volume(PsfKind kind, double parameter) {
    switch (kind) {
    case PsfKind::Gaussian:
        return 2 * pi;
    case PsfKind::Moffat:
        return pi / (parameter - 1);
    case PsfKind::Disc:
        break;
    }
    return pi * (1 + parameter * parameter);
}

Source source(const double *s, PsfKind kind, double radius_q) {
    const double det = s[3] * s[5] - s[4] * s[4];
    return {s[0],
            s[1],
            s[5] / det,
            -2 * s[4] / det,
            s[3] / det,
            s[2] / (volume(kind, s[6]) * std::sqrt(det)),
            s[6],
            std::sqrt(radius_q * s[3]) + 0.5,
            std::sqrt(radius_q * s[5]) + 0.5};
}

double q_at(const Source &s, double dx, double dy) {
    return s.xx * dx * dx + s.xy * dx * dy + s.yy * dy * dy;
}

double pixel(const Source &s, PsfKind kind, int i, int j) {
    const double q = q_at(s, i - s.x, j - s.y);
    // the rim of a disc is sharp wherever it is
    const Rule &rule = q < core_q || kind == PsfKind::Disc ? four : q < flank_q ? two : one;
    double sum = 0;
    for (int b = 0; b < rule.n; ++b)
        for (int a = 0; a < rule.n; ++a)
            sum += rule.weight[a] * rule.weight[b] *
                   density(kind, q_at(s, i + rule.node[a] - s.x, j + rule.node[b] - s.y), s.parameter);
    return s.norm * sum;
}

} // namespace

void render_spots(std::span<float> image, int width, int height, std::span<const double> spots, PsfKind kind,
                  double radius_q) {
    for (std::size_t k = 0; k + spot_columns <= spots.size(); k += spot_columns) {
        const Source s = source(&spots[k], kind, radius_q);
        const int x0 = std::max(0, static_cast<int>(std::floor(s.x - s.half_width)));
        const int x1 = std::min(width - 1, static_cast<int>(std::ceil(s.x + s.half_width)));
        const int y0 = std::max(0, static_cast<int>(std::floor(s.y - s.half_height)));
        const int y1 = std::min(height - 1, static_cast<int>(std::ceil(s.y + s.half_height)));
        for (int j = y0; j <= y1; ++j) {
            float *row = image.data() + static_cast<std::size_t>(j) * static_cast<std::size_t>(width);
            for (int i = x0; i <= x1; ++i) row[i] += static_cast<float>(pixel(s, kind, i, j));
        }
    }
}

} // namespace fl::metrology
