#include "fiberloom/expose.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <thread>
#include <vector>

namespace fl::metrology {
namespace {

constexpr double poisson_below_e = 40;

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

// The mean of four quantiles, scaled: Gaussian to far beyond six sigma, four looks into a small table.
float normal(Random &random) {
    static const std::array<float, 4096> table = quantiles();
    const std::uint64_t b = random.bits();
    return 0.5f *
           ((table[b >> 52] + table[(b >> 40) & 4095]) + (table[(b >> 28) & 4095] + table[(b >> 16) & 4095]));
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

double electrons(double mean, double read_variance, Random &random) {
    const double z = normal(random);
    if (mean < poisson_below_e) return poisson(std::max(mean, 0.0), random) + std::sqrt(read_variance) * z;
    const double variance = mean + read_variance;
    return mean + std::sqrt(variance) * z + mean / (6 * variance) * (z * z - 1);
}

// To the nearest whole number, halves to even ones: adding 1.5 * 2^52 shifts the fraction out.
double rounded(double x) {
    constexpr double magic = 6755399441055744.0;
    return (x + magic) - magic;
}

// One row: its own random numbers, so that rows may be made in any order.
void expose_row(std::span<const float> light_e, std::size_t j, const Exposure &exposure,
                std::span<std::uint16_t> adu) {
    const Sky &sky = exposure.sky;
    const Detector &detector = exposure.detector;
    const double read_variance = detector.read_noise_e * detector.read_noise_e;
    const double ground = sky.level_e + sky.slope_y_e * static_cast<double>(j);
    Random random(exposure.seed + 0x632BE59BD9B4E019u * (j + 1));
    for (std::size_t i = 0; i < light_e.size(); ++i) {
        const double mean = light_e[i] + ground + sky.slope_x_e * static_cast<double>(i);
        const double e = std::min(electrons(mean, read_variance, random), detector.full_well_e);
        const double value = rounded(detector.bias_adu + e / detector.gain_e_adu);
        adu[i] = static_cast<std::uint16_t>(std::clamp(value, 0.0, 65535.0));
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
