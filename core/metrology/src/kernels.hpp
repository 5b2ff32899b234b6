// The two loops that cost: the scan of the image, and the normal equations of one spot. Compiled for several
// instruction sets, chosen at run time; without contraction all give the same bits.
#pragma once

#include "fiberloom/image.hpp"

#include <array>
#include <vector>

namespace fl::metrology {

constexpr int chunk_px = 64;

// A part of a row of an image.
struct RowPart {
    int x0, y, width;
};

// Columns of a part of a row, from its first, where a pixel is above its chunk's threshold, not below its
// four neighbours before it in reading order and above the four after it (so of equal neighbours exactly one
// is the top). The rows above and below are read; the first and last columns of the part are left to the
// caller. threshold: one for each chunk of the part.
void row_peaks(const ImageView &image, const RowPart &part, const float *threshold, std::vector<int> &peaks);

// A rectangle cut out around one spot: what it shows less background and neighbours, the variance of those,
// and 1 for a pixel that may be used. Rows are padded with unusable pixels to a multiple of `lanes`.
struct Stamp {
    static constexpr int lanes = 8;
    int x0 = 0;
    int y0 = 0;
    int width = 0; // padded
    int height = 0;
    std::vector<float> value;
    std::vector<float> variance;
    std::vector<float> usable;

    void resize(int x, int y, int w, int h);
};

// One spot's ellipse, q = xx dx^2 + xy dx dy + yy dy^2, and its profile in t = linear q + square q^2 with the
// norm multiplied in.
struct Shape {
    float xx, xy, yy;
    std::array<float, 6> amplitude;
    float linear = 1;
    float square = 0;
};

struct FitState {
    double flux, x, y, background; // x, y relative to the stamp's first pixel
};

// How a pixel is judged: it has half its weight at |residual| = cut * sqrt(variance + (tolerance * model)^2 +
// floor), all of it well below and none well above.
struct Judge {
    float cut;
    float tolerance;
    float floor_variance;
    float inverse_gain;
    float q_max; // pixels beyond this ellipse do not count, those near its edge less and less
};

// Upper triangle of the Fisher matrix, the score, and what was seen on the way; p = (flux, x, y, background).
struct Normal {
    enum {
        ff,
        fx,
        fy,
        fb,
        xx,
        xy,
        xb,
        yy,
        yb,
        bb, // Fisher matrix
        sf,
        sx,
        sy,
        sb, // score
        chi2,
        pixels,
        left_out, // used, and left out by the judge
        light,
        light_lost, // squared profile of all pixels, and of those without a say
        size
    };
    std::array<double, size> sum{};
};

Normal normal_equations(const Stamp &stamp, const Shape &shape, const FitState &state, const Judge &judge);

// stamp.value -= flux * profile, stamp.variance += the same / gain, for a neighbour at (x, y) of the stamp.
void subtract_profile(Stamp &stamp, const Shape &shape, double flux, double x, double y, float inverse_gain);

// Sums of w d (1, dx, dy, dx^2, dx dy, dy^2), w = exp(-q / 2): what the adaptive moments iterate on.
std::array<double, 6> weighted_moments(const Stamp &stamp, const Shape &shape, double x, double y);

// Adds one spot to the normal equations of the ladder's amplitudes: 21 of the upper triangle, 6 of the right
// side, then what the misfit needs: sum of (r^2 - variance) / variance^2, sum of model^2 / variance^2 for q
// < 8.
using LadderSums = std::array<double, 29>;
void add_ladder(const Stamp &stamp, const Shape &shape, float norm, const FitState &state, const Judge &judge,
                LadderSums &sums);

} // namespace fl::metrology
