// Plans that end earlier by quarters of a step than their paths do: moves after waits begin earlier.
#pragma once

#include "points/own_knots.hpp"
#include "search/path_set.hpp"

namespace fl::planning {

struct EarlierByQuarters {
    int quarters = 0;                // by so many all arrive earlier than the last one did
    List<OwnKnots, PathIndex> knots; // of those that do not go as their paths do
};

// Takes quarters of a step from the waits of those that arrive last, and of those in their way, as far as all
// stay apart. What a path sweeps is then what is sent, its cells are those that are nearest at each step; no
// other path may be sought afterwards. Nothing where any may be late.
// @pre no two paths conflict.
EarlierByQuarters earlier_by_quarters(PathSet &paths, const Enough &enough);

} // namespace fl::planning
