// The parameters that a positioner was flashed with at the factory. Half of them are those of every unit:
// kept is what differs from the first one.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>

#include "fiberloom/twin/twin.hpp"

namespace fl::twin {

class FactoryParams {
  public:
    using Both = std::array<fl_axis_params_t, FL_AXES>;
    static constexpr size_t byte_count = sizeof(Both);
    using Bytes = std::array<uint8_t, byte_count>;

    // As these, told by what differs from those of the first unit.
    // @pre first stays where and as it is
    void set(const Both &first, const fl_axis_params_t params[FL_AXES]) {
        first_ = &first;
        const Words base = words(first.data()), own = words(params);
        for (size_t k = 0; k < word_count; ++k)
            if (own[k] != base[k]) differs_[k / 64] |= uint64_t{1} << k % 64;
        values_ = std::make_unique<uint32_t[]>(count());
        std::copy_if(own.begin(), own.end(), values_.get(),
                     [&, k = size_t{0}](uint32_t) mutable { return is_own(k++); });
    }
    Both both() const { return std::bit_cast<Both>(all()); }
    Bytes bytes() const { return std::bit_cast<Bytes>(all()); }
    // Memory beside the object itself.
    size_t held_bytes() const { return count() * sizeof(uint32_t); }

  private:
    static constexpr size_t word_count = byte_count / sizeof(uint32_t);
    using Words = std::array<uint32_t, word_count>; // as bits: a parameter may be NaN, or -0

    static Words words(const fl_axis_params_t params[FL_AXES]) {
        Words out;
        std::memcpy(out.data(), params, byte_count);
        return out;
    }
    bool is_own(size_t k) const { return (differs_[k / 64] >> k % 64 & 1U) != 0; }
    size_t count() const {
        size_t sum = 0;
        for (const uint64_t bits : differs_) sum += static_cast<size_t>(std::popcount(bits));
        return sum;
    }
    Words all() const {
        if (first_ == nullptr) return {};
        Words out = words(first_->data());
        const uint32_t *value = values_.get();
        for (size_t k = 0; k < word_count; ++k)
            if (is_own(k)) out[k] = *value++;
        return out;
    }

    const Both *first_ = nullptr;
    std::array<uint64_t, (word_count + 63) / 64> differs_{}; // a bit for each word
    std::unique_ptr<uint32_t[]> values_;                     // of those
};

} // namespace fl::twin
