// A structure of which many exist that have most fields in common: kept is what differs from the first one.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <type_traits>

namespace fl::twin {

template <class T> class Differing {
    static_assert(std::is_trivially_copyable_v<T> && sizeof(T) % sizeof(uint32_t) == 0);

  public:
    Differing() = default;
    // As `own`, told by what differs from the first.
    Differing(const T &first, const T &own) {
        const Words base = words(first), mine = words(own);
        size_t count = 0;
        for (size_t k = 0; k < word_count; ++k) {
            if (mine[k] == base[k]) continue;
            differs_[k / mask_bits] |= uint64_t{1} << k % mask_bits;
            ++count;
        }
        values_ = std::make_unique<uint32_t[]>(count);
        uint32_t *value = values_.get();
        for (size_t k = 0; k < word_count; ++k)
            if (is_own(k)) *value++ = mine[k];
    }
    // All of it. @pre first is the one that it was made with
    T with(const T &first) const {
        Words out = words(first);
        const uint32_t *value = values_.get();
        for (size_t m = 0; m < masks; ++m)
            for (uint64_t left = differs_[m]; left != 0; left &= left - 1)
                out[m * mask_bits + static_cast<size_t>(std::countr_zero(left))] = *value++;
        return std::bit_cast<T>(out);
    }
    // One field of it. @pre the same
    template <class Field> Field field(const T &first, Field T::*name) const {
        const auto *begin = reinterpret_cast<const char *>(&first);
        const auto at = static_cast<size_t>(reinterpret_cast<const char *>(&(first.*name)) - begin);
        auto out = std::bit_cast<std::array<uint32_t, sizeof(Field) / sizeof(uint32_t)>>(first.*name);
        const size_t begins = at / sizeof(uint32_t);
        bool own = false;
        for (size_t k = 0; k < out.size(); ++k) own |= is_own(begins + k);
        if (!own) return first.*name;
        const uint32_t *value = values_.get() + place(begins);
        for (size_t k = 0; k < out.size(); ++k)
            if (is_own(begins + k)) out[k] = *value++;
        return std::bit_cast<Field>(out);
    }
    // Memory beside the object itself.
    size_t held_bytes() const { return place(word_count) * sizeof(uint32_t); }

  private:
    static constexpr size_t word_count = sizeof(T) / sizeof(uint32_t), mask_bits = 64;
    static constexpr size_t masks = (word_count + mask_bits - 1) / mask_bits;
    using Words = std::array<uint32_t, word_count>; // as bits: a number may be NaN, or -0

    static Words words(const T &of) { return std::bit_cast<Words>(of); }
    bool is_own(size_t k) const { return (differs_[k / mask_bits] >> k % mask_bits & 1U) != 0; }

    // Of a word among those kept: how many come before it.
    size_t place(size_t k) const {
        size_t before = 0;
        for (size_t m = 0; m < k / mask_bits; ++m) before += ones(differs_[m]);
        const size_t within = k % mask_bits;
        if (within == 0) return before;
        const uint64_t below = (uint64_t{1} << within) - 1;
        return before + ones(differs_[k / mask_bits] & below);
    }

    // std::popcount; the baseline has no instruction for it, and the library's function takes longer than the
    // rest of a field.
    static size_t ones(uint64_t x) {
        x -= x >> 1 & 0x5555555555555555U;
        x = (x & 0x3333333333333333U) + (x >> 2 & 0x3333333333333333U);
        x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fU;
        return static_cast<size_t>(x * 0x0101010101010101U >> 56);
    }

    std::array<uint64_t, masks> differs_{}; // a bit for each word
    std::unique_ptr<uint32_t[]> values_;    // of those
};

} // namespace fl::twin
