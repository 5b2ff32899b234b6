// Where a spot may be: local maxima above the background, each led to the top of its own peak.
#pragma once

#include "scene.hpp"

#include <vector>

namespace fl::metrology {

struct Seed {
    double x = 0; // px
    double y = 0;
    float height = 0; // ADU above the background: mean of the 3 x 3 pixels, outliers clipped
    float lowest = 0; // ADU above the background: the third faintest of the 3 x 3 pixels
    bool saturated = false;
};

// `box` 1 or 2: peaks are climbed on sums of 3 x 3 or 5 x 5 pixels.
std::vector<Seed> detect(const Scene &scene, int box);

// The nearest seed in a circle; false if there is none.
bool detect_near(const Scene &scene, int box, const Circle &where, Seed &seed);

} // namespace fl::metrology
