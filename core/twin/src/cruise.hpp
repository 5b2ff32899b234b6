// An axis cruises while its command moves by one rule: within a segment of its path, on one ramp or the
// straight part of a go-to, in the landing at its end, or while it settles there. Then everything of it lies
// in the lanes of a LawBatch, and the firmware's own structure is out of date until the axis leaves them. The
// bits are those of the firmware's own ticks.
#pragma once

#include "fiberloom/twin/law_batch.hpp"
#include "positioner.hpp"

namespace fl::twin {

inline constexpr uint32_t least_cruise_ticks = 16; // fewer are not worth the copy

// Whether the axis is in a leg that ends when the rotor has come along.
bool settles(const fl_axis_t &a);

// Ticks from now on in which the command moves by one rule: 0 where the axis does not track. `most`: of a
// landing.
uint32_t cruise_ticks(const fl_axis_t &a, uint32_t most);

// Configuration, state and command of an axis into a lane, for ticks from `tick` on; and back before `tick`,
// after `ticks` of them.
void load_law(LawBatch &b, int lane, const fl_axis_law_t &law);
void load_state(LawBatch &b, int lane, const fl_drive_state_t &state);
void load_way(LawBatch &b, int lane, const fl_axis_t &a, uint64_t tick);
// A lane that nobody uses: its command stays where it is.
void stand(LawBatch &b, int lane);
void store_state(const LawBatch &b, int lane, fl_axis_t &a);
void store_way(const LawBatch &b, int lane, fl_axis_t &a, uint64_t tick, uint32_t ticks);

} // namespace fl::twin
