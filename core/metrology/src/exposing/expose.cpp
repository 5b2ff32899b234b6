#include "fiberloom/expose.hpp"
#include "../machine.hpp"
#include "normals.hpp"
#include "painter.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <thread>
#include <vector>

namespace fl::metrology {
namespace {

constexpr float poisson_below_e = 40;
constexpr std::size_t stretch = stretch_px;

// By the sum of the probabilities: few steps where the mean is small.
double poisson(double mean, Random &random) {
    double left = random.uniform(), p = std::exp(-mean);
    int k = 0;
    for (; left > p && k < 1000; ++k) {
        left -= p;
        p *= mean / (k + 1);
    }
    return k;
}

// Of so many photons that their scatter is Gaussian, but for a little skewness. In single precision: 0.01 e
// of a full well, whose scatter is some hundred.
inline float bright(float mean, float read_variance, float z) {
    const float variance = mean + read_variance;
    return mean + std::sqrt(variance) * z + mean / (6 * variance) * (z * z - 1);
}

double faint(double mean, double read_variance, Random &random) {
    const double z = normal(random);
    return poisson(std::max(mean, 0.0), random) + std::sqrt(read_variance) * z;
}

// To the nearest whole number, halves to even ones: adding 1.5 * 2^23 shifts the fraction out.
inline float rounded(float x) {
    constexpr float magic = 12582912.0f;
    return (x + magic) - magic;
}

// The detector in single precision.
struct Converter {
    float full_well_e, per_e_adu, bias_adu;

    explicit Converter(const Detector &d)
        : full_well_e(static_cast<float>(d.full_well_e)), per_e_adu(static_cast<float>(1.0 / d.gain_e_adu)),
          bias_adu(static_cast<float>(d.bias_adu)) {}
    std::int32_t adu(float e) const {
        const float value = bias_adu + std::min(full_well_e, e) * per_e_adu;
        return static_cast<std::int32_t>(rounded(std::clamp(value, 0.0f, 65535.0f)));
    }
};

// Some pixels of a row that follow each other.
struct Stretch {
    std::size_t count;
    float mean_e[stretch];
    float normal[stretch]; // draws, for bright pixels
};

FL_CLONES void expose_bright(const Stretch &pixels, const Detector &detector, std::uint16_t *adu) {
    const Converter to(detector); // whole stretches: what nothing writes to meanwhile stays in registers
    const float read_variance = static_cast<float>(detector.read_noise_e * detector.read_noise_e);
    std::int32_t whole[stretch];
    for (std::size_t i = 0; i < stretch; ++i)
        whole[i] = to.adu(bright(pixels.mean_e[i], read_variance, pixels.normal[i]));
    for (std::size_t i = 0; i < pixels.count; ++i) adu[i] = static_cast<std::uint16_t>(whole[i]);
}

// Pixels of any brightness, one by one: a faint one draws numbers of its own.
void expose_any(const Stretch &pixels, const Detector &detector, Random &random, std::uint16_t *adu) {
    const Converter to(detector);
    const double read_variance = detector.read_noise_e * detector.read_noise_e;
    for (std::size_t i = 0; i < pixels.count; ++i) {
        const float mean = pixels.mean_e[i];
        const float e = mean < poisson_below_e
                            ? static_cast<float>(faint(static_cast<double>(mean), read_variance, random))
                            : bright(mean, static_cast<float>(read_variance), pixels.normal[i]);
        adu[i] = static_cast<std::uint16_t>(to.adu(e));
    }
}

// What falls on a row beside the light: at its first pixel, and more at each further one.
struct Ground {
    double level_e, slope_e;
};

enum class Brightness { bright, mixed, faint };

// Mean electrons of a stretch from pixel `first` of its row on; how bright its pixels are.
FL_CLONES Brightness mean_electrons(const float *light_e, Ground ground, std::int32_t first,
                                    Stretch &pixels) {
    const std::int32_t count = static_cast<std::int32_t>(pixels.count);
    const float level_e = static_cast<float>(ground.level_e), slope_e = static_cast<float>(ground.slope_e);
    std::int32_t faint = 0, bright = 0;
    for (std::int32_t k = 0; k < count; ++k) {
        const float mean_e = light_e[k] + level_e + slope_e * static_cast<float>(first + k);
        pixels.mean_e[k] = mean_e;
        faint |= !(mean_e >= poisson_below_e);
        bright |= mean_e >= poisson_below_e;
    }
    return faint == 0 ? Brightness::bright : bright == 0 ? Brightness::faint : Brightness::mixed;
}

FL_CLONES bool dark(const float *light_e, std::size_t count) {
    std::int32_t any = 0;
    for (std::size_t k = 0; k < count; ++k) any |= light_e[k] != 0.0f;
    return any == 0;
}

// What the sky alone makes of the pixels of a row: ADU = base + z (spread + z skew) for a normal number z.
struct SkyRow {
    std::vector<float> base, spread, skew; // padded to whole stretches
    std::vector<unsigned char> bright;     // by stretch: every pixel is
    float top_adu;

    void fill(Ground ground, const Detector &d, std::size_t width) {
        const std::size_t stretches = (width + stretch - 1) / stretch, padded = stretches * stretch;
        base.resize(padded), spread.resize(padded), skew.resize(padded), bright.assign(stretches, 1);
        top_adu = static_cast<float>(Converter(d).adu(static_cast<float>(d.full_well_e)));
        for (std::size_t i = 0; i < padded; ++i) {
            const double mean_e = ground.level_e + ground.slope_e * static_cast<double>(i);
            const double variance = mean_e + d.read_noise_e * d.read_noise_e, third = mean_e / (6 * variance);
            base[i] = static_cast<float>(d.bias_adu + (mean_e - third) / d.gain_e_adu);
            spread[i] = static_cast<float>(std::sqrt(variance) / d.gain_e_adu);
            skew[i] = static_cast<float>(third / d.gain_e_adu);
            if (i < width && !(mean_e >= static_cast<double>(poisson_below_e))) bright[i / stretch] = 0;
        }
    }
};

// Pixels without light, in single precision: a value of 16 bits loses nothing that a count can show.
FL_CLONES void expose_sky(const SkyRow &sky, std::size_t at, const float *z, std::size_t count,
                          std::uint16_t *adu) {
    const float top = sky.top_adu;
    for (std::size_t k = 0; k < count; k += stretch) {
        const float *base = &sky.base[at + k], *spread = &sky.spread[at + k], *skew = &sky.skew[at + k];
        std::uint16_t whole[stretch];
        fetch_behind<1>(adu + k, sizeof whole);
        for (std::size_t i = 0; i < stretch; ++i) {
            const float n = z[k + i], value = base[i] + n * (spread[i] + n * skew[i]);
            const float below = value < top ? value : top; // a minimum and a maximum, each one instruction
            const float kept = below > 0.0f ? below : 0.0f;
            whole[i] = static_cast<std::uint16_t>(static_cast<std::int32_t>(rounded(kept)));
        }
        if (count - k >= stretch)
            std::memcpy(adu + k, whole, sizeof whole); // of a length that the compiler knows
        else
            std::memcpy(adu + k, whole, (count - k) * sizeof *adu);
    }
}

// One row after the other by one thread; each has its own random numbers, so that rows may be made in any
// order.
class RowExposer {
  public:
    RowExposer(const Exposure &exposure, std::size_t width) : exposure_(exposure), width_(width) {
        if (exposure.sky.slope_y_e == 0.0) sky_.fill(ground(0), exposure.detector, width);
    }

    // light_e: of the row; lit: a mark for each stretch, 0 where there is no light; nullptr: unknown.
    void expose_row(const float *light_e, const unsigned char *lit, std::size_t j, std::uint16_t *adu) {
        const std::uint64_t seed = exposure_.seed + 0x632BE59BD9B4E019u * (j + 1);
        const Ground here = ground(j);
        if (exposure_.sky.slope_y_e != 0.0) sky_.fill(here, exposure_.detector, width_);
        Random random(seed);
        Normals normals(~seed);
        Stretch pixels{}; // what a short one leaves is computed, too
        for (std::size_t at = 0; at < width_; at += pixels.count) {
            if (const std::size_t count = sky_from(light_e, lit, at); count > 0) {
                float z[Normals::most * stretch_px];
                normals.draw(static_cast<int>((count + stretch - 1) / stretch), z);
                expose_sky(sky_, at, z, count, adu + at);
                pixels.count = count;
                continue;
            }
            pixels.count = std::min(stretch, width_ - at);
            const Brightness how = mean_electrons(light_e + at, here, static_cast<std::int32_t>(at), pixels);
            if (how != Brightness::faint) normals.draw(1, pixels.normal);
            if (how == Brightness::bright)
                expose_bright(pixels, exposure_.detector, adu + at);
            else
                expose_any(pixels, exposure_.detector, random, adu + at);
        }
    }

  private:
    // Pixels from `at` on that nothing but the sky lights, of as many whole stretches as are drawn at once.
    std::size_t sky_from(const float *light_e, const unsigned char *lit, std::size_t at) const {
        std::size_t count = 0;
        for (int k = 0; k < Normals::most && at + count < width_; ++k) {
            const std::size_t here = at + count, next = std::min(stretch, width_ - here);
            const bool no_light = (lit != nullptr && lit[here / stretch] == 0) || dark(light_e + here, next);
            if (!no_light || sky_.bright[here / stretch] == 0) break;
            count += next;
        }
        return count;
    }

    Ground ground(std::size_t j) const {
        const Sky &sky = exposure_.sky;
        return {sky.level_e + sky.slope_y_e * static_cast<double>(j), sky.slope_x_e};
    }

    const Exposure &exposure_;
    std::size_t width_;
    SkyRow sky_;
};

// Calls band(first row, row after the last) for a share of the rows in each thread.
template <class Band> void in_bands(std::size_t rows, int threads, Band &&band) {
    const std::size_t bands = static_cast<std::size_t>(std::max(threads, 1));
    std::vector<std::thread> others;
    for (std::size_t b = 1; b < bands; ++b)
        others.emplace_back([&, b] { band(b * rows / bands, (b + 1) * rows / bands); });
    band(std::size_t{0}, rows / bands);
    for (std::thread &t : others) t.join();
}

// Single pixels by rows, those of one pixel in the order in which they are told.
class Singles {
  public:
    Singles(const Lights &lights, std::size_t width) : lights_(lights), width_(width) {
        order_.resize(lights.pixels.size());
        std::iota(order_.begin(), order_.end(), std::size_t{0});
        std::stable_sort(order_.begin(), order_.end(),
                         [this](std::size_t a, std::size_t b) { return row(a) < row(b); });
    }

    void add(std::size_t begin, std::size_t end, float *rows, unsigned char *lit) const {
        const std::size_t marks = (width_ + stretch - 1) / stretch;
        const auto first = std::lower_bound(order_.begin(), order_.end(), begin,
                                            [this](std::size_t k, std::size_t j) { return row(k) < j; });
        for (auto k = first; k != order_.end() && row(*k) < end; ++k) {
            const std::size_t j = row(*k) - begin;
            const std::size_t i = static_cast<std::size_t>(lights_.pixels[*k]) % width_;
            rows[j * width_ + i] += lights_.electrons[*k];
            lit[j * marks + i / stretch] = 1;
        }
    }

  private:
    std::size_t row(std::size_t k) const { return static_cast<std::size_t>(lights_.pixels[k]) / width_; }

    const Lights &lights_;
    std::size_t width_;
    std::vector<std::size_t> order_;
};

// Rows that are painted before they are exposed: what they hold stays in the second-level cache.
constexpr std::size_t rows_at_once = 16;

} // namespace

void expose(std::span<const float> light_e, int width, const Exposure &exposure,
            std::span<std::uint16_t> adu) {
    const std::size_t w = static_cast<std::size_t>(width);
    in_bands(light_e.size() / w, exposure.threads, [&](std::size_t begin, std::size_t end) {
        RowExposer rows(exposure, w);
        for (std::size_t j = begin; j < end; ++j) rows.expose_row(&light_e[j * w], nullptr, j, &adu[j * w]);
    });
}

void expose_lights(const Lights &lights, int width, const Exposure &exposure, std::span<std::uint16_t> adu) {
    const std::size_t w = static_cast<std::size_t>(width), height = adu.size() / w;
    const std::size_t marks = (w + stretch - 1) / stretch;
    const Painter painter(width, static_cast<int>(height), lights.spots, lights.kind, lights.radius_q);
    const Singles singles(lights, w);
    in_bands(height, exposure.threads, [&](std::size_t begin, std::size_t end) {
        RowExposer exposer(exposure, w);
        std::vector<float> light_e(rows_at_once * w);
        std::vector<unsigned char> lit(rows_at_once * marks);
        for (std::size_t first = begin; first < end; first += rows_at_once) {
            const std::size_t last = std::min(first + rows_at_once, end);
            painter.paint(static_cast<int>(first), static_cast<int>(last), light_e.data(), lit.data(),
                          stretch_px);
            singles.add(first, last, light_e.data(), lit.data());
            for (std::size_t j = first; j < last; ++j)
                exposer.expose_row(&light_e[(j - first) * w], &lit[(j - first) * marks], j, &adu[j * w]);
            for (std::size_t k = 0; k < lit.size(); ++k) { // dark again for the next ones
                if (lit[k] == 0) continue;
                const std::size_t at = k / marks * w + k % marks * stretch;
                std::fill_n(&light_e[at], std::min(stretch, w - k % marks * stretch), 0.0f);
                lit[k] = 0;
            }
        }
    });
}

} // namespace fl::metrology
