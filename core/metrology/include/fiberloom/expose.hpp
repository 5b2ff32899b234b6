// Light to digital units: what a detector makes of the electrons that it should have.
#pragma once

#include "fiberloom/render.hpp"

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

// Light that is painted while it is exposed: spots as of `render_spots`, and single pixels beside them.
struct Lights {
    std::span<const double> spots;
    PsfKind kind = PsfKind::Gaussian;
    double radius_q = 0;
    std::span<const std::int64_t> pixels; // row by row, in any order, also more than once
    std::span<const float> electrons;     // of those
};

// Poisson and read noise on `light` plus sky, then full well, gain, bias, rounding and the sixteen bits.
// The noise of a row depends on its light, the seed and the row alone, not on the number of threads. From 40
// electrons on, one Gaussian number with the skewness of the Poisson distribution (Cornish-Fisher) serves for
// both noises.
//
// light_e: electrons per pixel, row by row, `width` to a row. adu: gets the image.
// @pre width > 0; the size of light_e is a multiple of it; adu has the size of light_e; gain > 0.
void expose(std::span<const float> light_e, int width, const Exposure &exposure,
            std::span<std::uint16_t> adu);

// The same image as of all these lights rendered into one of zeros, but some rows at a time: none of the
// electrons ever fill a whole image. @pre as above; as `render_spots`; pixels lie in the image.
void expose_lights(const Lights &lights, int width, const Exposure &exposure, std::span<std::uint16_t> adu);

} // namespace fl::metrology
