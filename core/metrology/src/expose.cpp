#include "fiberloom/expose.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <thread>
#include <vector>

// Pixels may be computed by wider vectors where a machine has them, with the same bits.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(FL_ONE_COPY)
#define FL_CLONES __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#else
#define FL_CLONES
#endif

namespace fl::metrology {
namespace {

constexpr double poisson_below_e = 40;
// pixels that are made together
constexpr std::size_t stretch = 64;

// xoshiro256+ (Blackman and Vigna 2018), seeded by splitmix64.
class Random {
  public:
    explicit Random(std::uint64_t seed) {
        for (std::uint64_t &word : state_) {
            seed += 0x9E3779B97F4A7C15u;
            std::uint64_t z = seed;
            z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
            z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
            word = z ^ (z >> 31);
        }
    }
    std::uint64_t bits() {
        const std::uint64_t out = state_[0] + state_[3], t = state_[1] << 17;
        state_[2] ^= state_[0], state_[3] ^= state_[1], state_[1] ^= state_[2], state_[0] ^= state_[3];
        state_[2] ^= t;
        state_[3] = std::rotl(state_[3], 45);
        return out;
    }
    double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53; }

  private:
    std::array<std::uint64_t, 4> state_{};
};

// Quantiles of the normal distribution at the middles of 4096 equal parts, by Newton from one to the next.
std::array<float, 4096> quantiles() {
    constexpr int n = 4096;
    std::array<float, n> out{};
    double x = -4, squares = 0;
    for (int k = 0; k < n; ++k) {
        const double p = (k + 0.5) / n;
        for (int i = 0; i < 20; ++i)
            x -= (0.5 * std::erfc(-x / std::sqrt(2.0)) - p) /
                 (std::exp(-0.5 * x * x) / std::sqrt(2 * std::acos(-1.0)));
        out[static_cast<std::size_t>(k)] = static_cast<float>(x);
        squares += x * x;
    }
    for (float &v : out) v *= static_cast<float>(std::sqrt(n / squares));
    return out;
}

const std::array<float, 4096> table = quantiles();

// The mean of four quantiles, scaled: Gaussian to far beyond six sigma, four looks into a small table.
inline double normal(Random &random) {
    const std::uint64_t b = random.bits();
    const float upper = table[b >> 52] + table[(b >> 40) & 4095];
    const float lower = table[(b >> 28) & 4095] + table[(b >> 16) & 4095];
    return static_cast<double>(0.5f * (upper + lower));
}

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

// Of so many photons that their scatter is Gaussian, but for a little skewness.
inline double bright(double mean, double read_variance, double z) {
    const double variance = mean + read_variance;
    return mean + std::sqrt(variance) * z + mean / (6 * variance) * (z * z - 1);
}

double faint(double mean, double read_variance, Random &random) {
    const double z = normal(random);
    return poisson(std::max(mean, 0.0), random) + std::sqrt(read_variance) * z;
}

// To the nearest whole number, halves to even ones: adding 1.5 * 2^52 shifts the fraction out.
inline double rounded(double x) {
    constexpr double magic = 6755399441055744.0;
    return (x + magic) - magic;
}

inline std::int32_t converted(double e, const Detector &detector) {
    const double value = rounded(detector.bias_adu + std::min(e, detector.full_well_e) / detector.gain_e_adu);
    return static_cast<std::int32_t>(std::clamp(value, 0.0, 65535.0));
}

// Some pixels of a row that follow each other.
struct Stretch {
    std::size_t count;
    double mean_e[stretch];
    double normal[stretch]; // draws, for bright pixels
};

FL_CLONES void expose_bright(const Stretch &pixels, const Detector &detector, std::uint16_t *adu) {
    const Detector d = detector; // whole stretches: what nothing writes to meanwhile stays in registers
    const double read_variance = d.read_noise_e * d.read_noise_e;
    std::int32_t whole[stretch];
    for (std::size_t i = 0; i < stretch; ++i)
        whole[i] = converted(bright(pixels.mean_e[i], read_variance, pixels.normal[i]), d);
    for (std::size_t i = 0; i < pixels.count; ++i) adu[i] = static_cast<std::uint16_t>(whole[i]);
}

// Pixels of any brightness, one by one: a faint one draws more than one random number.
void expose_any(const Stretch &pixels, const Detector &detector, Random &random, std::uint16_t *adu) {
    const double read_variance = detector.read_noise_e * detector.read_noise_e;
    for (std::size_t i = 0; i < pixels.count; ++i) {
        const double mean = pixels.mean_e[i];
        const double e = mean < poisson_below_e ? faint(mean, read_variance, random)
                                                : bright(mean, read_variance, normal(random));
        adu[i] = static_cast<std::uint16_t>(converted(e, detector));
    }
}

// What falls on a row beside the light: at its first pixel, and more at each further one.
struct Ground {
    double level_e, slope_e;
};

// Mean electrons of a stretch from pixel `first` of its row on; whether all are bright.
FL_CLONES bool mean_electrons(const float *light_e, Ground ground, std::int32_t first, Stretch &pixels) {
    const std::int32_t count = static_cast<std::int32_t>(pixels.count);
    std::int64_t faint = 0;
    for (std::int32_t k = 0; k < count; ++k) {
        const double mean_e = static_cast<double>(light_e[k]) + ground.level_e +
                              ground.slope_e * static_cast<double>(first + k);
        pixels.mean_e[k] = mean_e;
        faint |= !(mean_e >= poisson_below_e);
    }
    return faint == 0;
}

// One row: its own random numbers, so that rows may be made in any order.
void expose_row(std::span<const float> light_e, std::size_t j, const Exposure &exposure,
                std::span<std::uint16_t> adu) {
    const Sky &sky = exposure.sky;
    const Ground ground{sky.level_e + sky.slope_y_e * static_cast<double>(j), sky.slope_x_e};
    Random random(exposure.seed + 0x632BE59BD9B4E019u * (j + 1));
    Stretch pixels{}; // what a short one leaves is computed, too
    for (std::size_t at = 0; at < light_e.size(); at += pixels.count) {
        pixels.count = std::min(stretch, light_e.size() - at);
        if (!mean_electrons(&light_e[at], ground, static_cast<std::int32_t>(at), pixels)) {
            expose_any(pixels, exposure.detector, random, &adu[at]);
            continue;
        }
        for (std::size_t k = 0; k < pixels.count; ++k) pixels.normal[k] = normal(random);
        expose_bright(pixels, exposure.detector, &adu[at]);
    }
}

} // namespace

void expose(std::span<const float> light_e, int width, const Exposure &exposure,
            std::span<std::uint16_t> adu) {
    const std::size_t w = static_cast<std::size_t>(width), rows = light_e.size() / w;
    const std::size_t bands = static_cast<std::size_t>(std::max(exposure.threads, 1));
    const auto band = [&](std::size_t b) {
        for (std::size_t j = b * rows / bands; j < (b + 1) * rows / bands; ++j)
            expose_row(light_e.subspan(j * w, w), j, exposure, adu.subspan(j * w, w));
    };
    std::vector<std::thread> others;
    for (std::size_t b = 1; b < bands; ++b) others.emplace_back(band, b);
    band(0);
    for (std::thread &t : others) t.join();
}

} // namespace fl::metrology
