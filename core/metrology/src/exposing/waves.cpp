#include "fiberloom/waves.hpp"

#include <algorithm>
#include <cstddef>

#include "../machine.hpp"

namespace fl::metrology {
namespace {

constexpr size_t together = 64; // places whose sums stay in the first-level cache over all waves

struct Places {
    double x[together], y[together], sum[together];
};

// Half turns in two parts, the first with 33 bits: multiples of it below 10^5 are exact. Then the series of
// the cosine out to x^22 on [-pi/2, pi/2]: what is left out is below 1e-18.
inline __attribute__((always_inline)) double cosine(double angle_rad) {
    constexpr double round_magic = 6755399441055744.0; // adding 1.5 * 2^52 shifts the fraction out
    constexpr double high = 3.14159265346825122834, low = 1.21542010130123844986e-10;
    const double count = (angle_rad * 0.31830988618379067154 + round_magic) - round_magic;
    const double rest = (angle_rad - count * high) - count * low;
    const double odd = count - 2.0 * ((count * 0.5 + round_magic) - round_magic);
    const double z = rest * rest;
    double c = 1.0;
    for (int n = 22; n >= 2; n -= 2) c = 1.0 - c * (z * (1.0 / (n * (n - 1))));
    return c * (1.0 - 2.0 * odd * odd);
}

// By place, wave after wave: how many a vector takes does not matter.
FL_CLONES void add_to(Places &p, const double *waves, size_t numbers) {
    for (size_t w = 0; w < numbers; w += wave_columns) {
        const double kx = waves[w], ky = waves[w + 1], phase = waves[w + 2];
        for (size_t i = 0; i < together; ++i) p.sum[i] += cosine(p.x[i] * kx + p.y[i] * ky + phase);
    }
}

} // namespace

void add_waves(std::span<const double> xy, std::span<const double> waves, std::span<double> sums) {
    for (size_t first = 0; first < sums.size(); first += together) {
        const size_t count = std::min(together, sums.size() - first);
        Places p{};
        for (size_t i = 0; i < count; ++i) {
            p.x[i] = xy[2 * (first + i)];
            p.y[i] = xy[2 * (first + i) + 1];
        }
        add_to(p, waves.data(), waves.size());
        for (size_t i = 0; i < count; ++i) sums[first + i] += p.sum[i];
    }
}

} // namespace fl::metrology
