// Which goals can be taken together: for the assignment, before anything moves.
#pragma once

#include "fiberloom/planning.hpp"

#include <array>
#include <vector>

namespace fl::planning {

// Pairs of positioners (rows, the lower first) that touch at their goals or anywhere on the approach, which
// all make together: from beside the goal by an approach, rad. Sorted. Obstacles are not looked at.
// @pre one goal for each arm.
std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          Angles approach);

// For positioners (rows of the bodies, which may repeat) at goals, one for each: whether goal and approach
// are clear of the obstacles, 1 or 0.
// @pre rows are in range.
std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<int> &rows,
                                    const std::vector<Angles> &goals, Angles approach);

// Positioners (rows of the bodies, which may repeat), and a goal for each.
struct PlacesOf {
    std::vector<int> rows;
    std::vector<Angles> goals;
};

// One by one: whether the first and the second stay apart, at the goal and on the approach: 1 or 0.
// @pre as many of both; rows are in range.
std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const PlacesOf &first, const PlacesOf &second,
                                      Angles approach);

} // namespace fl::planning
