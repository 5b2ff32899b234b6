#include "detect.hpp"
#include "kernels.hpp"
#include "pixels.hpp"

#include <algorithm>
#include <set>
#include <type_traits>

namespace fl::metrology {
namespace {

// A spot of FWHM 2.5 px has its fifth brightest of 3 x 3 pixels at 0.41 of the peak or more; a hot pixel has
// not.
constexpr float peak_over_median = 2.7f;
constexpr float neighbour_share = 0.25f;
constexpr int neighbours_needed = 3;
constexpr int longest_climb_px = 40;
constexpr int largest_flat_top_px = 4000;

using Block = std::array<float, 9>;

// One bit per pixel: climbs that meet share their end.
class Visited {
  public:
    Visited(int width, int height)
        : width_(width), bits_((static_cast<std::size_t>(width) * height + 63) / 64) {}
    // true when the pixel was marked before
    bool mark(int x, int y) {
        const std::size_t i = static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + x;
        const std::uint64_t bit = std::uint64_t{1} << (i % 64);
        const bool before = (bits_[i / 64] & bit) != 0;
        bits_[i / 64] |= bit;
        return before;
    }

  private:
    int width_;
    std::vector<std::uint64_t> bits_;
};

// Level and noise of the background under a peak: looked up once for all its pixels.
struct Ground {
    float level;
    float noise;
};

template <class P> class PeakFinder {
  public:
    PeakFinder(const Pixels<P> &pixels, const Scene &scene, int box)
        : box_(box), pixels_(pixels), background_(scene.background),
          saturation_(static_cast<float>(scene.settings.saturation_adu)),
          threshold_(static_cast<float>(scene.settings.threshold)) {}

    Ground ground(int x, int y) const { return {background_.level_at(x, y), background_.noise_at(x, y)}; }

    // A hot pixel is lonely, a spot is not; on the flank of a spot it may hide the top and must not hide the
    // spot.
    bool lit(int x, int y) const {
        const Ground g = ground(x, y);
        const Block b = block(x, y, g);
        const auto above = [&](float bar) {
            return std::count_if(b.begin(), b.end(), [&](float v) { return v > g.level + bar; });
        };
        return above(std::max(neighbour_share * (b[4] - g.level), 1.5f * g.noise)) > neighbours_needed ||
               above(3.0f * g.noise) >= 5;
    }

    // Uphill on the sum of the clipped pixels of the box. False: this peak was climbed before.
    bool climb(int x, int y, Visited *visited, Seed &seed) const {
        const Ground g = ground(x, y);
        std::array<std::pair<int, int>, longest_climb_px> path;
        for (std::size_t n = 0; n < path.size(); ++n) {
            if (visited != nullptr && visited->mark(x, y)) {
                // the clip level moves along: a step back to where we come from is the top
                if (std::find(path.begin(), path.begin() + n, std::pair{x, y}) == path.begin() + n)
                    return false;
                break;
            }
            path[n] = {x, y};
            int dx = 0, dy = 0;
            uphill(x, y, g, dx, dy);
            if (dx == 0 && dy == 0) break;
            x += dx, y += dy;
        }
        seed = at_top(x, y);
        return true;
    }

    bool significant(const Seed &s) const {
        // nine pixels beat the noise of one by three; half of the peak is in the mean for FWHM 2.5 px
        return s.height > 0.5f * threshold_ * background_.noise_at(s.x, s.y);
    }

  private:
    // A square of pixels; outside the image the nearest inside, and no light where the image holds none.
    template <int radius> void square(int x, int y, const Ground &g, float *out) const {
        constexpr int n = 2 * radius + 1;
        if (pixels_.inside(x, y, radius)) {
            for (int j = 0; j < n; ++j) {
                const auto *row = pixels_.row(y + j - radius) + x - radius;
                for (int i = 0; i < n; ++i) out[n * j + i] = static_cast<float>(P::key(row[i]));
            }
        } else {
            for (int j = 0; j < n; ++j)
                for (int i = 0; i < n; ++i)
                    out[n * j + i] = pixels_.at(std::clamp(x + i - radius, 0, pixels_.image.width - 1),
                                                std::clamp(y + j - radius, 0, pixels_.image.height - 1));
        }
        if constexpr (std::is_floating_point_v<typename P::Key>)
            for (int k = 0; k < n * n; ++k)
                if (!std::isfinite(out[k])) out[k] = g.level;
    }

    Block block(int x, int y, const Ground &g) const {
        Block b;
        square<1>(x, y, g, b.data());
        return b;
    }

    // Pixels brighter than the neighbourhood can explain count as the brightest that it can.
    static float clip_level(Block b, const Ground &g) {
        std::nth_element(b.begin(), b.begin() + 4, b.end());
        return g.level + std::max(peak_over_median * (b[4] - g.level), 4.0f * g.noise);
    }

    void uphill(int x, int y, const Ground &g, int &dx, int &dy) const {
        std::array<float, 49> v;
        square<3>(x, y, g, v.data());
        const float clip = clip_level({v[16], v[17], v[18], v[23], v[24], v[25], v[30], v[31], v[32]}, g);
        for (float &value : v) value = std::min(value, clip);
        std::array<float, 7> column{}; // sums of the rows of the box, then moved up and down
        for (int i = 0; i < 7; ++i)
            for (int j = 3 - box_; j <= 3 + box_; ++j) column[i] += v[7 * j + i];
        float best = sum_of(column, 3);
        for (int move = -1; move <= 1; ++move) {
            std::array<float, 7> moved = column;
            const int gained = 7 * (3 + move * (box_ + 1)), lost = 7 * (3 - move * box_);
            for (int i = 0; i < 7 && move != 0; ++i) moved[i] += v[gained + i] - v[lost + i];
            for (int u = -1; u <= 1; ++u)
                if (const float s = sum_of(moved, 3 + u); s > best) best = s, dx = u, dy = move;
        }
        if (!pixels_.inside(x + dx, y + dy)) dx = dy = 0;
    }

    float sum_of(const std::array<float, 7> &c, int middle) const {
        const float three = c[middle - 1] + c[middle] + c[middle + 1];
        return box_ == 1 ? three : three + (c[middle - 2] + c[middle + 2]);
    }

    Seed at_top(int x, int y) const {
        if (pixels_.at(x, y) >= saturation_) return flat_top(x, y);
        const Ground g = ground(x, y);
        Block b = block(x, y, g);
        const float clip = clip_level(b, g);
        double sum = 0, sx = 0, sy = 0;
        for (int k = 0; k < 9; ++k) {
            const double v = std::max(std::min(b[k], clip) - g.level, 0.0f);
            sum += v, sx += v * (k % 3 - 1), sy += v * (k / 3 - 1);
        }
        std::nth_element(b.begin(), b.begin() + 2, b.end());
        const double scale = sum > 0 ? 1.0 / sum : 0.0;
        return {x + sx * scale, y + sy * scale, static_cast<float>(sum / 9), b[2] - g.level, false};
    }

    // The middle of the connected saturated pixels.
    Seed flat_top(int x, int y) const {
        std::vector<std::pair<int, int>> found{{x, y}};
        std::set<std::pair<int, int>> seen{{x, y}};
        double sx = 0, sy = 0;
        std::size_t k = 0;
        for (; k < found.size() && k < largest_flat_top_px; ++k) {
            const auto [u, v] = found[k];
            sx += u, sy += v;
            for (const auto &next : {std::pair{u + 1, v}, {u - 1, v}, {u, v + 1}, {u, v - 1}})
                if (pixels_.inside(next.first, next.second) &&
                    pixels_.at(next.first, next.second) >= saturation_ && seen.insert(next).second)
                    found.push_back(next);
        }
        const double n = static_cast<double>(k);
        const float above = pixels_.at(x, y) - background_.level_at(x, y);
        return {sx / n, sy / n, above, above, true};
    }

    int box_;
    const Pixels<P> &pixels_;
    const Background &background_;
    float saturation_;
    float threshold_;
};

// What a pixel must exceed, in ADU; sixteen bits cannot exceed more than they hold.
float threshold_at(const Scene &scene, double x, double y) {
    const Background &b = scene.background;
    const float bar = b.level_at(x, y) + static_cast<float>(scene.settings.threshold) * b.noise_at(x, y);
    const PixelType type = scene.image.type;
    const bool sixteen_bits = type == PixelType::U16 || type == PixelType::U16Fits;
    return sixteen_bits ? std::clamp(bar, 0.0f, 65535.0f) : bar;
}

std::vector<float> chunk_thresholds(const Scene &scene, int y) {
    std::vector<float> out;
    for (int x = chunk_px / 2; x < scene.image.width + chunk_px / 2; x += chunk_px)
        out.push_back(threshold_at(scene, x, y));
    return out;
}

template <class P> std::vector<Seed> detect_in(const Pixels<P> &pixels, const Scene &scene, int box) {
    const ImageView &image = pixels.image;
    const PeakFinder<P> finder(pixels, scene, box);
    Visited visited(image.width, image.height);
    std::vector<float> thresholds;
    std::vector<int> peaks;
    std::vector<Seed> seeds;
    // a spot on the outermost row or column is half a spot: its top is looked for from the next one inwards
    for (int y = 1; y + 1 < image.height; ++y) {
        if (y % 16 == 1) thresholds = chunk_thresholds(scene, y + 8);
        row_peaks(image, {0, y, image.width}, thresholds.data(), peaks);
        for (const int x : peaks)
            if (Seed seed; finder.lit(x, y) && finder.climb(x, y, &visited, seed) && finder.significant(seed))
                seeds.push_back(seed);
    }
    return seeds;
}

template <class P>
bool near_in(const Pixels<P> &pixels, const Scene &scene, int box, const Circle &where, Seed &best) {
    const ImageView &image = pixels.image;
    const PeakFinder<P> finder(pixels, scene, box);
    // one pixel more on the left and right, which the scan leaves alone
    const int x0 = whole(std::floor(where.x - where.radius) - 1, 0, image.width);
    const int x1 = whole(std::ceil(where.x + where.radius) + 1, -1, image.width - 1);
    const int y0 = whole(std::floor(where.y - where.radius), 1, image.height);
    const int y1 = whole(std::ceil(where.y + where.radius), -1, image.height - 2);
    if (x1 - x0 < 2) return false;
    const std::vector<float> thresholds(static_cast<std::size_t>((x1 - x0) / chunk_px + 1),
                                        threshold_at(scene, where.x, where.y));
    std::vector<int> peaks;
    double nearest = where.radius;
    bool found = false;
    for (int y = y0; y <= y1; ++y) {
        row_peaks(image, {x0, y, x1 - x0 + 1}, thresholds.data(), peaks);
        for (const int x : peaks) {
            Seed seed;
            if (!finder.lit(x0 + x, y) || !finder.climb(x0 + x, y, nullptr, seed)) continue;
            const double distance = std::hypot(seed.x - where.x, seed.y - where.y);
            if (distance <= nearest && finder.significant(seed))
                nearest = distance, best = seed, found = true;
        }
    }
    return found;
}

} // namespace

std::vector<Seed> detect(const Scene &scene, int box) {
    return with_pixels(scene.image, [&](const auto &p) { return detect_in(p, scene, box); });
}

bool detect_near(const Scene &scene, int box, const Circle &where, Seed &seed) {
    return with_pixels(scene.image, [&](const auto &p) { return near_in(p, scene, box, where, seed); });
}

} // namespace fl::metrology
