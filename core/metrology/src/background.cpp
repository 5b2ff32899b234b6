#include "background.hpp"
#include "pixels.hpp"

#include <algorithm>

namespace fl::metrology {
namespace {

constexpr int rows_per_tile = 8;
constexpr int columns_per_tile = 8;
// what a Gaussian loses of its standard deviation when cut at 3 sigma: 1 / 0.98657
constexpr float cut_correction = 1.01361f;

float median_of(std::vector<float> &values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

struct LevelNoise {
    float level;
    float noise;
};

// Median and median deviation find the cut; mean and deviation inside it do not know the step of the converter.
LevelNoise clipped(std::vector<float> &values, std::vector<float> &scratch) {
    const float median = median_of(values);
    scratch.clear();
    for (float v : values) scratch.push_back(std::fabs(v - median));
    const float cut = std::max(3.0f * 1.4826f * median_of(scratch), 1.0f);
    double sum = 0, squares = 0, n = 0;
    for (float v : values) {
        const double d = v - median;
        if (std::fabs(d) > cut) continue;
        sum += d, squares += d * d, n += 1;
    }
    const double mean = sum / n;
    // never below the step of the converter, so that a flat synthetic image is no special case
    const double variance = std::max(squares / n - mean * mean, 1.0 / 12.0);
    return {static_cast<float>(median + mean), static_cast<float>(std::sqrt(variance)) * cut_correction};
}

template <class P> void sample(const Pixels<P> &pixels, int x0, int y0, std::vector<float> &values) {
    const int x1 = std::min(x0 + Background::tile_px, pixels.image.width);
    const int y1 = std::min(y0 + Background::tile_px, pixels.image.height);
    const int dy = std::max(1, (y1 - y0) / rows_per_tile);
    const int dx = std::max(1, (x1 - x0) / columns_per_tile);
    values.clear();
    for (int y = y0 + dy / 2, k = 0; y < y1; y += dy, ++k)
        // another phase in every row: no column of the detector weighs more than others
        for (int x = x0 + (3 * k) % dx; x < x1; x += dx)
            if (const float v = pixels.at(x, y); std::isfinite(v)) values.push_back(v);
}

// Replaces every tile by the median of its neighbourhood: a tile full of light must not hide its own spots.
std::vector<float> smoothed(const std::vector<float> &grid, int nx, int ny) {
    std::vector<float> out(grid.size());
    std::vector<float> near;
    for (int j = 0; j < ny; ++j)
        for (int i = 0; i < nx; ++i) {
            near.clear();
            for (int v = std::max(j - 1, 0); v <= std::min(j + 1, ny - 1); ++v)
                for (int u = std::max(i - 1, 0); u <= std::min(i + 1, nx - 1); ++u)
                    if (std::isfinite(grid[v * nx + u])) near.push_back(grid[v * nx + u]);
            out[j * nx + i] = near.empty() ? 0.0f : median_of(near);
        }
    return out;
}

template <class P> Background measure(const Pixels<P> &pixels) {
    constexpr int t = Background::tile_px;
    Background b;
    b.nx = (pixels.image.width + t - 1) / t;
    b.ny = (pixels.image.height + t - 1) / t;
    std::vector<float> values, scratch;
    for (int j = 0; j < b.ny; ++j)
        for (int i = 0; i < b.nx; ++i) {
            sample(pixels, i * t, j * t, values);
            const LevelNoise s = values.empty() ? LevelNoise{NAN, NAN} : clipped(values, scratch);
            b.level.push_back(s.level);
            b.noise.push_back(s.noise);
        }
    b.level = smoothed(b.level, b.nx, b.ny);
    b.noise = smoothed(b.noise, b.nx, b.ny);
    return b;
}

} // namespace

float Background::between(const std::vector<float> &grid, double x_px, double y_px) const {
    const double u = std::clamp(x_px / tile_px - 0.5, 0.0, nx - 1.0);
    const double v = std::clamp(y_px / tile_px - 0.5, 0.0, ny - 1.0);
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
