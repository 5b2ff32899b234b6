// A small generator of our own: the same numbers from the same seed on every platform.
#pragma once

#include "motion/index.hpp"
#include <cstdint>
#include <utility>

namespace fl::planning {

// SplitMix64 (Steele, Lea, Flood 2014).
class Random {
  public:
    explicit Random(std::uint64_t seed) : state_(seed) {}

    std::uint64_t next() {
        std::uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return z ^ (z >> 31);
    }

    // 0 .. n-1; n is small, so the bias of the remainder is of no concern.
    int below(int n) { return static_cast<int>(next() % static_cast<std::uint64_t>(n)); }

    bool chance(int percent) { return below(100) < percent; }

    template <class T, class I> void shuffle(List<T, I> &items) {
        for (int i = items.size(); i > 1; --i) std::swap(items[i - 1], items[below(i)]);
    }

  private:
    std::uint64_t state_;
};

} // namespace fl::planning
