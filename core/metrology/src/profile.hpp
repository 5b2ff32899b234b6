// The shape of the spots, measured in the image itself.
#pragma once

#include "detect.hpp"
#include "fit.hpp"

namespace fl::metrology {

// Three steps: adaptive moments of bright, lonely spots give S of each; a polynomial through them gives S
// everywhere; a linear fit to all their pixels gives the amplitudes of the ladder. Needs no start but seeds.
Profile measure_profile(const ImageView &image, const Background &background, const Settings &settings,
                        const std::vector<Seed> &seeds);

} // namespace fl::metrology
