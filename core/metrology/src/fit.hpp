// One spot: cut out of the image, and fitted with the frame's profile.
#pragma once

#include "kernels.hpp"
#include "scene.hpp"

namespace fl::metrology {

struct Ellipse {
    double xx, xy, yy;   // S in px^2
    double area() const; // sqrt|S|
    // Of a spot: not a point, not a line, not wider than any spot; false where a number is none.
    bool sound() const;
    // half the size of the box that holds q <= q_max
    double half_width(double q_max) const;
    double half_height(double q_max) const;
};

std::array<double, Profile::terms> polynomial_terms(double u, double v);
Ellipse ellipse_at(const Profile &profile, double x_px, double y_px);
Shape shape_of(const Profile &profile, const Ellipse &ellipse);

// What each rung of the ladder weighs in the flux: its integral over the plane over 2 pi sqrt|S|.
std::array<double, Profile::components> rung_weights(const Profile &profile);

// The profile for q = 0 .. as flux 1 on an ellipse of area 1, and its derivative.
double profile_value(const Profile &profile, double q);
double profile_slope(const Profile &profile, double q);

// The ellipse that holds all but half a percent of what is known about the position of a spot whose peak has
// `contrast` times the variance of the background.
double reach(const Profile &profile, double contrast);

// A table of `reach` over brightness, made once per frame.
class Reach {
  public:
    explicit Reach(const Profile &profile);
    double operator()(double contrast) const;

  private:
    std::array<double, 24> q_max_{};
};

struct Fit {
    std::size_t seed = 0;          // which of the frame's seeds
    double flux = 0, x = 0, y = 0; // ADU, px of the image
    double background = 0;         // ADU above the background map
    double var_x = 0, cov_xy = 0, var_y = 0, var_flux = 0;
    double explained = 0; // of chi2, by the light of the spot
    double chi2 = 0;      // per degree of freedom
    double freedom = 1;
    double lost = 0;     // share of the profile's squared light without a say
    double left_out = 0; // pixels
    double q_max = 0;
    double moved = 0; // px from where the fit began
    bool saturated = false;
    bool truncated = false;
    bool converged = false;
    bool orphaned = false; // a neighbour that was taken off turned out to be none
    float height = 0;      // ADU, of the seed
};

// What was found on cutting a box out: whether it leaves the image, whether a pixel is saturated.
struct Cut {
    bool truncated = false;
    bool saturated = false;
};
// Fills the stamp with the pixels of the box that lie in the image.
Cut cut_out(const Scene &scene, const Box &box, Stamp &stamp);

// Asks the memory for the pixels of the next spot while this one is fitted: spots lie far apart.
void fetch_ahead(const ImageView &image, const Box &box);

// Solves for flux, x, y and background; the stamp's neighbours are taken off already.
void solve(const Stamp &stamp, const Profile &profile, const Settings &settings, bool free_background,
           Fit &fit);

// Two spots that share their light: flux, x, y of both and one background. All others are taken off the stamp
// already. False, and both as they were, where that does not end: they are one spot, or none.
bool solve_pair(const Stamp &stamp, const Profile &profile, const Settings &settings, Fit &first,
                Fit &second);

} // namespace fl::metrology
