// Light to digital units: what a detector makes of the electrons that it should have.
#pragma once

#include <cstdint>
#include <span>

namespace fl::metrology {

// What a pixel makes of its electrons. @pre gain_e_adu > 0.
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

// What turns light into an image, beside the light.
struct Exposure {
    Sky sky;
    Detector detector;
    std::uint64_t seed = 0; // of the noise
    int threads = 1;        // the image does not depend on it
};

// Poisson and read noise on `light` plus sky, then full well, gain, bias, rounding and the sixteen bits.
// The noise of a row depends on seed and row alone, not on the number of threads. From 40 electrons on, one
// Gaussian number with the skewness of the Poisson distribution (Cornish-Fisher) serves for both noises.
//
// light_e: electrons per pixel, row by row, `width` to a row. adu: gets the image.
// @pre width > 0; the size of light_e is a multiple of it; adu has the size of light_e; gain > 0.
void expose(std::span<const float> light_e, int width, const Exposure &exposure,
            std::span<std::uint16_t> adu);

} // namespace fl::metrology
