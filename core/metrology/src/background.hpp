// Level and noise of the background on a grid of tiles, from a thin sample of the pixels.
#pragma once

#include "fiberloom/image.hpp"

#include <vector>

namespace fl::metrology {

struct Background {
    static constexpr int tile_px = 128;
    int nx = 0;
    int ny = 0;
    std::vector<float> level; // ADU
    std::vector<float> noise; // ADU, 1 sigma of one pixel

    // bilinear between the centres of the tiles, constant beyond the outermost
    float level_at(double x_px, double y_px) const { return between(level, x_px, y_px); }
    float noise_at(double x_px, double y_px) const { return between(noise, x_px, y_px); }
    float median_level() const;
    float median_noise() const;

  private:
    float between(const std::vector<float> &grid, double x_px, double y_px) const;
};

Background measure_background(const ImageView &image);

} // namespace fl::metrology
