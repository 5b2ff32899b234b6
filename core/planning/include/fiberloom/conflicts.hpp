// Which goals can be taken together: for the assignment, before anything moves.
#pragma once

#include "fiberloom/planning.hpp"

#include <array>
#include <vector>

namespace fl::planning {

// Pairs of positioners (rows, the lower first) that touch at their goals or anywhere on the approach, which
// all make together: from approach_rad above the goal on both axes. Sorted. Obstacles are not looked at.
// @pre one goal for each arm.
std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          double approach_rad);

// For each positioner whether goal and approach are clear of the obstacles: 1 or 0.
// @pre one goal for each arm.
std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<Angles> &goals,
                                    double approach_rad);

// Row by row: whether arms[k] at p[k] and others[k] at q[k] stay apart, at the goal and on the approach: 1 or
// 0.
// @pre bodies.arms, others, p and q have the same number of rows.
std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const std::vector<Arm> &others,
                                      const std::vector<Angles> &p, const std::vector<Angles> &q,
                                      double approach_rad);

} // namespace fl::planning
