// Sums of plane waves at many places: smooth random fields, as air and optics make them.
#pragma once

#include <span>

namespace fl::metrology {

// Three numbers a wave: k_x, k_y (rad per unit of length), phase (rad).
constexpr int wave_columns = 3;

// Adds sum over waves of cos(k_x x + k_y y + phase) to each place's sum; NaN where a place is NaN. The same
// bits on every machine; a cosine errs by less than 4e-16 and 2e-16 of its angle.
// @pre xy holds two numbers for each of `sums`, waves a multiple of wave_columns; angles below 10^5 rad.
void add_waves(std::span<const double> xy, std::span<const double> waves, std::span<double> sums);

} // namespace fl::metrology
