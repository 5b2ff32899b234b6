#include "fiberloom/render.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace fl::metrology {
namespace {

constexpr double pi = 3.14159265358979323846;
constexpr std::array<double, 4> node{-0.43056815579702629, -0.16999052179242813, 0.16999052179242813,
                                     0.43056815579702629};
constexpr std::array<double, 4> weight{0.17392742256872693, 0.32607257743127307, 0.32607257743127307,
                                       0.17392742256872693};

struct Source {
    double x, y, xx, xy, yy, norm, parameter; // inverse of S, and the norm that makes the flux
    double half_width, half_height;
};

double density(PsfKind kind, double q, double parameter) {
    switch (kind) {
    case PsfKind::Gaussian: return std::exp(-0.5 * q);
    case PsfKind::Moffat: return std::pow(1 + q, -parameter);
    case PsfKind::Disc: break;
    }
    return 0.5 * std::erfc((std::sqrt(q) - 1) / (std::sqrt(2.0) * parameter));
}

// Integral of density over the plane for S = 1.
double volume(PsfKind kind, double parameter) {
    switch (kind) {
    case PsfKind::Gaussian: return 2 * pi;
    case PsfKind::Moffat: return pi / (parameter - 1);
    case PsfKind::Disc: break;
    }
    return pi * (1 + parameter * parameter);
}

Source source(const double *s, PsfKind kind, double radius_q) {
    const double det = s[3] * s[5] - s[4] * s[4];
    return {s[0], s[1], s[5] / det, -2 * s[4] / det, s[3] / det,
            s[2] / (volume(kind, s[6]) * std::sqrt(det)), s[6],
            std::sqrt(radius_q * s[3]) + 0.5, std::sqrt(radius_q * s[5]) + 0.5};
}

double pixel(const Source &s, PsfKind kind, int i, int j) {
    double sum = 0;
    for (std::size_t b = 0; b < 4; ++b) {
        const double dy = j + node[b] - s.y;
        for (std::size_t a = 0; a < 4; ++a) {
            const double dx = i + node[a] - s.x;
            const double q = s.xx * dx * dx + s.xy * dx * dy + s.yy * dy * dy;
            sum += weight[a] * weight[b] * density(kind, q, s.parameter);
        }
    }
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
