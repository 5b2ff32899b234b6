// Spots painted into an image: the light that falls on each pixel, for the camera of the twin.
#pragma once

#include <span>

namespace fl::metrology {

// How the light of a spot falls off.
enum class PsfKind {
    Gaussian, // exp(-q / 2)
    Moffat,   // (1 + q)^-parameter
    Disc,     // a fibre tip: flat to q = 1, its edge blurred over `parameter` of the radius
};

// q = d^T S^-1 d; seven numbers a spot: x_px, y_px, flux, S_xx, S_xy, S_yy (px^2), parameter.
constexpr int spot_columns = 7;

// Adds flux * (profile integrated over the pixel) out to `radius_q`, the ellipse where a spot ends, by
// Gauss-Legendre quadrature: 4 x 4 points in the core (error below 1e-6 of the peak for FWHM >= 2 px), fewer
// in the wings. What lies outside the image is left out.
// @pre the image has width x height pixels, spots a multiple of spot_columns numbers; S is positive definite.
void render_spots(std::span<float> image, int width, int height, std::span<const double> spots, PsfKind kind,
                  double radius_q);

} // namespace fl::metrology
