// What spots are looked for in: an image, the background measured in it, and the caller's settings.
#pragma once

#include "background.hpp"
#include "fiberloom/spots.hpp"

namespace fl::metrology {

struct Scene {
    const ImageView &image;
    const Background &background;
    const Settings &settings;
};

// A rectangle around a place of the image, px.
struct Box {
    double x, y;
    double half_width, half_height;
};

// A place and how far from it, px.
struct Circle {
    double x, y;
    double radius;
};

} // namespace fl::metrology
