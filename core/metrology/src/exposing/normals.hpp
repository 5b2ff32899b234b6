// Normal numbers for the noise of an image: 64 at a time, side by side.
#pragma once

#include <array>
#include <cstdint>

namespace fl::metrology {

// Pixels that are made together.
constexpr int stretch_px = 64;

// xoshiro256+ (Blackman and Vigna 2018), seeded by splitmix64.
class Random {
  public:
    explicit Random(std::uint64_t seed);
    std::uint64_t bits() {
        const std::uint64_t out = state_[0] + state_[3], t = state_[1] << 17;
        state_[2] ^= state_[0], state_[3] ^= state_[1], state_[1] ^= state_[2], state_[0] ^= state_[3];
        state_[2] ^= t;
        state_[3] = state_[3] << 45 | state_[3] >> 19;
        return out;
    }
    // In [0, 1), in steps of 2^-53.
    double uniform() { return static_cast<double>(bits() >> 11) * 0x1p-53; }

  private:
    std::array<std::uint64_t, 4> state_{};
};

// One number: the mean of four quantiles, scaled; Gaussian to far beyond six sigma.
double normal(Random &random);

// Many. Eleven bits choose one of 2048 parts of the distribution of equal probability, five more a place in
// it, as if it were as dense all over; the outermost eight of either side, beyond 2.66 sigma, are drawn anew
// with 53 bits, so that the tails are those of the normal distribution.
class Normals {
  public:
    static constexpr int lanes = 8, most = 8;
    explicit Normals(std::uint64_t seed);
    // The next ones, of so many stretches, at most `most`.
    void draw(int stretches, float *z);

  private:
    alignas(64) std::uint64_t state_[4][lanes]; // of a generator in each lane, xoshiro256++
    Random tails_;
};

} // namespace fl::metrology
