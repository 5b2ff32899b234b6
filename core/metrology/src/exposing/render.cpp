#include "../machine.hpp"
#include "painter.hpp"

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

// Powers that are products; of 1 the light has no end.
constexpr int least_power = 2, most_power = 8;

bool is_small_whole(double n) { return n >= least_power && n <= most_power && n == std::floor(n); }

// x^-n, by multiplication where n is a small whole number.
double inverse_power(double x, double n) {
    if (!is_small_whole(n)) return std::pow(x, -n);
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

Source source(const double *s, PsfKind kind, double radius_q, int width, int height) {
    const double det = s[3] * s[5] - s[4] * s[4];
    const double half_width = std::sqrt(radius_q * s[3]) + 0.5,
                 half_height = std::sqrt(radius_q * s[5]) + 0.5;
    return {s[0],
            s[1],
            s[5] / det,
            -2 * s[4] / det,
            s[3] / det,
            s[2] / (volume(kind, s[6]) * std::sqrt(det)),
            s[6],
            std::max(0, static_cast<int>(std::floor(s[0] - half_width))),
            std::min(width - 1, static_cast<int>(std::ceil(s[0] + half_width))),
            std::max(0, static_cast<int>(std::floor(s[1] - half_height))),
            std::min(height - 1, static_cast<int>(std::ceil(s[1] + half_height)))};
}

double q_at(const Source &s, double dx, double dy) {
    return s.xx * dx * dx + s.xy * dx * dy + s.yy * dy * dy;
}

// the rim of a disc is sharp wherever it is
const Rule &rule_at(const Source &s, PsfKind kind, int i, int j) {
    const double q = q_at(s, i - s.x, j - s.y);
    return q < core_q || kind == PsfKind::Disc ? four : q < flank_q ? two : one;
}

// Pixels of a row that follow each other and have one rule; at most so many at once.
constexpr int run_pixels = 64;
struct Run {
    int first, count, row;
    const Rule &rule;
};

// Sums over the points of the rule, in the order of the points for each pixel.
void sum_any(const Source &s, PsfKind kind, const Run &run, float *sum) {
    for (int k = 0; k < run.count; ++k) {
        double whole = 0;
        for (int b = 0; b < run.rule.n; ++b)
            for (int a = 0; a < run.rule.n; ++a)
                whole +=
                    run.rule.weight[a] * run.rule.weight[b] *
                    density(kind,
                            q_at(s, run.first + k + run.rule.node[a] - s.x, run.row + run.rule.node[b] - s.y),
                            s.parameter);
        sum[k] = static_cast<float>(whole);
    }
}

// The same of a Moffat function whose power is a small whole number: products and one quotient, whole vectors
// side by side. What lies beyond the end of the run is summed, too, and not used. In single precision,
// counted from the spot's own place: good to some 1e-6 of what falls on a pixel.
constexpr int together = 16;
static_assert(run_pixels % together == 0);

template <int power>
[[gnu::always_inline]] inline void sum_power(const Source &s, const Run &run, float *__restrict sum) {
    const Rule rule = run.rule; // what nothing writes to meanwhile stays in registers
    const float xx = static_cast<float>(s.xx), xy = static_cast<float>(s.xy), yy = static_cast<float>(s.yy);
    const int end = (run.count + together - 1) / together * together;
    for (int b = 0; b < rule.n; ++b)
        for (int a = 0; a < rule.n; ++a) {
            const float weight = static_cast<float>(rule.weight[a] * rule.weight[b]);
            const float from = static_cast<float>(run.first + rule.node[a] - s.x);
            const float dy = static_cast<float>(run.row + rule.node[b] - s.y);
            for (int k = 0; k < end; ++k) {
                const float dx = from + static_cast<float>(k);
                const float one_and_q = 1 + (xx * dx * dx + xy * dx * dy + yy * dy * dy);
                float product = one_and_q;
                for (int n = 1; n < power; ++n) product *= one_and_q;
                sum[k] += weight * (1 / product);
            }
        }
}

// By the source's own power: the loop over it has no end that a compiler knows.
template <int power = least_power>
[[gnu::always_inline]] inline void sum_whole(const Source &s, const Run &run, float *sum) {
    if (s.parameter == power)
        sum_power<power>(s, run, sum);
    else if constexpr (power < most_power)
        sum_whole<power + 1>(s, run, sum);
}

FL_CLONES void sum_moffat(const Source &s, const Run &run, float *sum) { sum_whole(s, run, sum); }

void add_run(const Source &s, PsfKind kind, const Run &run, float *row) {
    float sum[run_pixels] = {};
    if (kind == PsfKind::Moffat && is_small_whole(s.parameter))
        sum_moffat(s, run, sum);
    else
        sum_any(s, kind, run, sum);
    const float norm = static_cast<float>(s.norm);
    for (int k = 0; k < run.count; ++k) row[run.first + k] += norm * sum[k];
}

// The pixels of row j.
void add_row(const Source &s, PsfKind kind, int j, float *row) {
    for (int i = s.x0; i <= s.x1;) {
        const Rule &rule = rule_at(s, kind, i, j);
        int end = i + 1;
        while (end <= s.x1 && end - i < run_pixels && &rule_at(s, kind, end, j) == &rule) ++end;
        add_run(s, kind, {i, end - i, j, rule}, row);
        i = end;
    }
}

} // namespace

Painter::Painter(int width, int height, std::span<const double> spots, PsfKind kind, double radius_q)
    : width_(width), kind_(kind) {
    for (std::size_t k = 0; k + spot_columns <= spots.size(); k += spot_columns)
        sources_.push_back(source(&spots[k], kind, radius_q, width, height));
}

void Painter::paint(int begin, int end, float *rows, unsigned char *lit, int mark_px) const {
    const int marks = (width_ + mark_px - 1) / mark_px;
    for (const Source &s : sources_) {
        if (s.x0 > s.x1) continue;
        for (int j = std::max(s.y0, begin); j <= std::min(s.y1, end - 1); ++j) {
            add_row(s, kind_, j, rows + static_cast<std::ptrdiff_t>(j - begin) * width_);
            if (lit != nullptr)
                std::fill(lit + (j - begin) * marks + s.x0 / mark_px,
                          lit + (j - begin) * marks + s.x1 / mark_px + 1, static_cast<unsigned char>(1));
        }
    }
}

void render_spots(std::span<float> image, int width, int height, std::span<const double> spots, PsfKind kind,
                  double radius_q) {
    Painter(width, height, spots, kind, radius_q).paint(0, height, image.data(), nullptr, 1);
}

} // namespace fl::metrology
