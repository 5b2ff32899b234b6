#include "background.hpp"
#include "pixels.hpp"

#include <algorithm>

namespace fl::metrology {
namespace {

constexpr int rows_per_tile = 8;
constexpr int columns_per_tile = 8;
// what a Gaussian loses of its standard deviation when cut at 3 sigma: 1 / 0.98657
constexpr float cut_correction = 1.01361f;
constexpr float inverse_root_two = 0.70710678f;
constexpr float least_noise = 0.28867513f; // 1 / sqrt(12)

float median_of(std::vector<float> &values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

// Standard deviation about zero of what lies within 3 robust deviations: it does not know the step of the
// converter, as a median would.
float deviation(const std::vector<float> &values, std::vector<float> &scratch) {
    scratch.clear();
    for (float v : values) scratch.push_back(std::fabs(v));
    const float cut = std::max(3.0f * 1.4826f * median_of(scratch), 1.0f);
    float squares = 0, n = 0;
    for (float v : values) {
        const float inside = std::fabs(v) <= cut ? 1.0f : 0.0f;
        squares += inside * v * v, n += inside;
    }
    return std::sqrt(squares / n) * cut_correction;
}

struct LevelNoise {
    float level;
    float noise;
};

// Pixels here and there in a tile, and each one's difference from the next: its noise does not know of
// gradients.
struct Sample {
    std::vector<float> values, steps, scratch;

    template <class P> void take(const Pixels<P> &pixels, int x0, int y0) {
        const int x1 = std::min(x0 + Background::tile_px, pixels.image.width);
        const int y1 = std::min(y0 + Background::tile_px, pixels.image.height);
        const int dy = std::max(1, (y1 - y0) / rows_per_tile), dx = std::max(2, (x1 - x0) / columns_per_tile);
        values.clear(), steps.clear();
        for (int y = y0 + dy / 2, k = 0; y < y1; y += dy, ++k)
            // another phase in every row: no column of the detector weighs more than others
            for (int x = x0 + (3 * k) % dx; x + 1 < x1; x += dx) add(pixels.at(x, y), pixels.at(x + 1, y));
    }

    void add(float here, float next) {
        if (!std::isfinite(here) || !std::isfinite(next)) return;
        values.push_back(here), steps.push_back(next - here);
    }

    LevelNoise measure() {
        if (values.empty()) return {NAN, NAN};
        // never below the step of the converter, so that a flat synthetic image is no special case
        const float noise = std::max(deviation(steps, scratch) * inverse_root_two, least_noise);
        return {median_of(values), noise};
    }
};

// Replaces every tile by the median of its neighbourhood: a tile full of light must not hide its own spots.
// `without`: where the neighbourhood shows nothing.
std::vector<float> smoothed(const std::vector<float> &grid, int nx, int ny, float without) {
    std::vector<float> out(grid.size());
    std::vector<float> near;
    for (int j = 0; j < ny; ++j)
        for (int i = 0; i < nx; ++i) {
            near.clear();
            for (int v = std::max(j - 1, 0); v <= std::min(j + 1, ny - 1); ++v)
                for (int u = std::max(i - 1, 0); u <= std::min(i + 1, nx - 1); ++u)
                    if (std::isfinite(grid[v * nx + u])) near.push_back(grid[v * nx + u]);
            out[j * nx + i] = near.empty() ? without : median_of(near);
        }
    return out;
}

template <class P> Background measure(const Pixels<P> &pixels) {
    constexpr int t = Background::tile_px;
    Background b;
    b.nx = (pixels.image.width + t - 1) / t;
    b.ny = (pixels.image.height + t - 1) / t;
    Sample sample;
    for (int j = 0; j < b.ny; ++j)
        for (int i = 0; i < b.nx; ++i) {
            sample.take(pixels, i * t, j * t);
            const LevelNoise s = sample.measure();
            b.level.push_back(s.level);
            b.noise.push_back(s.noise);
        }
    b.level = smoothed(b.level, b.nx, b.ny, 0.0f);
    b.noise = smoothed(b.noise, b.nx, b.ny, least_noise);
    return b;
}

} // namespace

float Background::between(const std::vector<float> &grid, double x_px, double y_px) const {
    const double u = within(x_px / tile_px - 0.5, 0.0, nx - 1.0);
    const double v = within(y_px / tile_px - 0.5, 0.0, ny - 1.0);
    const int i = std::min(static_cast<int>(u), std::max(nx - 2, 0));
    const int j = std::min(static_cast<int>(v), std::max(ny - 2, 0));
    const int right = nx > 1 ? 1 : 0;
    const int down = ny > 1 ? nx : 0;
    const float *g = grid.data() + j * nx + i;
    const double fu = u - i, fv = v - j;
    return static_cast<float>((1 - fv) * ((1 - fu) * g[0] + fu * g[right]) +
                              fv * ((1 - fu) * g[down] + fu * g[down + right]));
}

float Background::median_level() const {
    std::vector<float> copy = level;
    return median_of(copy);
}

float Background::median_noise() const {
    std::vector<float> copy = noise;
    return median_of(copy);
}

Background measure_background(const ImageView &image) {
    return with_pixels(image, [](const auto &pixels) { return measure(pixels); });
}

} // namespace fl::metrology
