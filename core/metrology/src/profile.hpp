// The shape of the spots, measured in the image itself.
#pragma once

#include "detect.hpp"
#include "fit.hpp"

namespace fl::metrology {

// Median width at half maximum of the brightest, before anything is known of shapes. 0 without seeds.
double first_look_px(const Scene &scene, const std::vector<Seed> &seeds);

// Spots far wider than the 5 x 5 pixels that detection climbs on have many tops: one seed for each, at its
// middle.
std::vector<Seed> gather_wide(const Scene &scene, const std::vector<Seed> &seeds, double fwhm_px);

// Three steps: adaptive moments of bright, lonely spots give S of each; a polynomial through them gives S
// everywhere; a linear fit to all their pixels gives the amplitudes of the ladder. Needs no start but seeds.
Profile measure_profile(const Scene &scene, const std::vector<Seed> &seeds);

} // namespace fl::metrology
