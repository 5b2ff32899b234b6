// Spots painted into some rows of an image at a time.
#pragma once

#include "fiberloom/render.hpp"

#include <span>
#include <vector>

namespace fl::metrology {

// A spot as it is painted: its inverse ellipse, the norm that makes the flux, and the pixels that it lights.
struct Source {
    double x, y, xx, xy, yy, norm, parameter;
    int x0, x1, y0, y1; // first and last column and row
};

class Painter {
  public:
    // As `render_spots`, for an image of that size.
    Painter(int width, int height, std::span<const double> spots, PsfKind kind, double radius_q);
    // Adds all spots to the rows [begin, end), the first of which is at `rows`, in the order of the spots:
    // what a pixel gets does not depend on which rows are painted together. lit: one mark for each `mark_px`
    // pixels of a row, set where a spot falls; nullptr where nobody asks.
    void paint(int begin, int end, float *rows, unsigned char *lit, int mark_px) const;

  private:
    int width_;
    PsfKind kind_;
    std::vector<Source> sources_;
};

} // namespace fl::metrology
