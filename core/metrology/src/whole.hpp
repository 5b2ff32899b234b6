// From places of any kind, also those that are no number, to whole pixels.
#pragma once

namespace fl::metrology {

// Cut to a range; `low` for NaN, which std::clamp would let through.
inline double within(double value, double low, double high) {
    return value > low ? (value < high ? value : high) : low;
}

// The whole part, towards 0, of what is within a range of integers.
inline int whole(double value, int low, int high) { return static_cast<int>(within(value, low, high)); }

} // namespace fl::metrology
