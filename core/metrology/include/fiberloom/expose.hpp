// Light to digital units: what a detector makes of the electrons that it should have.
#pragma once

#include <cstdint>
#include <span>

namespace fl::metrology {

struct Detector {
    double gain_e_adu = 1;
    double read_noise_e = 0;
    double bias_adu = 0;
    double full_well_e = 1e9;
};

// background = level + slope_x * x + slope_y * y, electrons per pixel
struct Sky {
    double level_e = 0;
    double slope_x_e = 0;
    double slope_y_e = 0;
};

// Poisson and read noise on `light` plus sky, then full well, gain, bias, rounding and the sixteen bits.
// The noise of a row depends on seed and row alone, not on the number of threads. From 40 electrons on, one
// Gaussian number with the skewness of the Poisson distribution (Cornish-Fisher) serves for both noises.
void expose(std::span<const float> light_e, int width, const Sky &sky, const Detector &detector,
            std::uint64_t seed, std::span<std::uint16_t> adu, int threads = 1);

} // namespace fl::metrology
