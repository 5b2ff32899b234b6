// Spots of light in a camera image: found, and measured at the photon limit.
//
// Detection reads the image once, against a background of tiles. The centroid is the solution of the
// maximum-likelihood equations sum (d - m)/var(m) dm/dp = 0 for p = (flux, x, y, background), with
// var(m) = var(background) + m/gain, which for Poisson counts is the exact score. Its covariance is the
// inverse Fisher matrix at the solution, so with the right profile it is the Cramer-Rao bound. The profile is
// measured in the image (profile.cpp); it already contains the integration over the pixel.
#pragma once

#include "fiberloom/image.hpp"

#include <array>
#include <limits>
#include <span>
#include <vector>

namespace fl::metrology {

// What is the matter with a spot; flags add up.
enum SpotFlag : std::uint32_t {
    saturated = 1,   // pixels at the saturation level, left out of the fit
    blended = 2,     // another spot within two FWHM
    truncated = 4,   // the edge of the image cuts the fitted region
    cosmic = 8,      // pixels that do not belong to the spot (cosmic ray, hot, dead), left out
    poor_shape = 16, // the residuals are larger than noise and profile explain
    not_found = 32,  // guided mode: nothing at the expected position; every number is NaN
    shared = 64,     // guided mode: two expected positions found the same spot
};

// One spot: its centre and flux with their variances, the background under it (ADU), and its flags. Every
// number is NaN where nothing was found.
struct Spot {
    double x_px = std::numeric_limits<double>::quiet_NaN();
    double y_px = std::numeric_limits<double>::quiet_NaN();
    double var_x_px2 = std::numeric_limits<double>::quiet_NaN();
    double cov_xy_px2 = std::numeric_limits<double>::quiet_NaN();
    double var_y_px2 = std::numeric_limits<double>::quiet_NaN();
    double flux_adu = std::numeric_limits<double>::quiet_NaN();
    double flux_err_adu = std::numeric_limits<double>::quiet_NaN();
    double background_adu = std::numeric_limits<double>::quiet_NaN();
    double chi2 = std::numeric_limits<double>::quiet_NaN(); // per degree of freedom
    std::uint32_t flags = not_found;
};

// Flux 1: m(q) = sum_k a_k exp(-t / (2 lambda_k)) / (2 pi sqrt|S|), where q = d^T S^-1 d is the elliptical
// radius squared, lambda_k = 1/2, 1, 2, 4, 8, 16, and t = q: one ladder holds Gaussians and Moffat wings. For
// flat tops, fibre tips large against the pixel, t = q^2 / 2. S varies with the position in the image as a
// polynomial of fourth degree.
struct Profile {
    static constexpr int components = 6;
    static constexpr int terms = 15; // u^i v^j, i + j <= 4, by rising degree; u, v in [-1, 1] over the image
    std::array<double, components> amplitude{0, 1, 0, 0, 0, 0};
    std::array<std::array<double, terms>, 3> shape{}; // S_xx, S_xy, S_yy in px^2
    bool flat_top = false;
    double half_width_px = 1; // u = x / half_width - 1
    double half_height_px = 1;
    double misfit = 0; // rms of the residuals beyond noise over the brightness of the pixel
    int n_spots = 0;   // spots that it was measured on; 0 means not measured

    // Whether it was measured in an image.
    bool measured() const { return n_spots > 0; }
    // Full width at half maximum at a place of the image, px: the geometric mean of the two axes.
    double fwhm_px(double x_px, double y_px) const;
};

// What is known of the camera, and what counts as a spot. @pre gain_e_adu > 0, threshold > 0.
struct Settings {
    double gain_e_adu = 1; // electrons per digital unit
    double saturation_adu = std::numeric_limits<double>::infinity();
    double threshold = 6; // brightest pixel over the noise of the background
    double fwhm_px = 0;   // a hint for the first look; 0 means that the image tells
    int max_profile_spots = 150;
};

// What an image showed.
struct Result {
    std::vector<Spot> spots;
    Profile profile;
    double background_adu = 0; // median over the tiles
    double noise_adu = 0;
};

// Every spot in the image, in rows from the top. A measured profile is used as it is; otherwise it is
// measured. @pre the image has at least 8 x 8 pixels.
Result find_spots(const ImageView &image, const Settings &settings, const Profile &known = {});

// One spot per expected position, pairs of x and y in px: the nearest within `radius_px`; not_found where
// there is none. @pre as find_spots; positions are finite.
Result find_expected(const ImageView &image, const Settings &settings, std::span<const double> expected_xy_px,
                     double radius_px, const Profile &known = {});

} // namespace fl::metrology
