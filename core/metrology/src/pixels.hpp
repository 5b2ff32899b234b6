// One reader per pixel type, the switch from the run-time type to it, and from any place to whole pixels.
#pragma once

#include "fiberloom/image.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

namespace fl::metrology {

// Cut to a range; `low` for NaN, which std::clamp would let through.
inline double within(double value, double low, double high) {
    return value > low ? (value < high ? value : high) : low;
}

// The whole part, towards 0, of what is within a range of integers.
inline int whole(double value, int low, int high) { return static_cast<int>(within(value, low, high)); }

// ADU. No detector gives more: 32 bits hold 4.3e9. A pixel of floats beyond it, or that is not finite, holds
// no light: its key is NaN, which no comparison finds.
constexpr double most_adu = 1e10;

template <class Float> Float sane(Float adu) {
    return std::fabs(adu) <= static_cast<Float>(most_adu) ? adu : std::numeric_limits<Float>::quiet_NaN();
}

// One of each: `stored` is what the image holds, `key` what counts.
struct PixelU16 {
    using Raw = std::uint16_t;
    using Key = std::uint16_t; // what the scan compares
    static Key stored(Raw raw) { return raw; }
    static Key key(Raw raw) { return raw; }
};

struct PixelU16Fits {
    using Raw = std::uint16_t;
    using Key = std::uint16_t;
    static Key stored(Raw raw) { return static_cast<Key>(((raw >> 8) | (raw << 8)) ^ 0x8000); }
    static Key key(Raw raw) { return stored(raw); }
};

struct PixelF32 {
    using Raw = float;
    using Key = float;
    static Key stored(Raw raw) { return raw; }
    static Key key(Raw raw) { return sane(raw); }
};

struct PixelF32Fits {
    using Raw = std::uint32_t;
    using Key = float;
    static Key stored(Raw raw) { return std::bit_cast<float>(__builtin_bswap32(raw)); }
    static Key key(Raw raw) { return sane(stored(raw)); }
};

struct PixelF64 {
    using Raw = double;
    using Key = double;
    static Key stored(Raw raw) { return raw; }
    static Key key(Raw raw) { return sane(raw); }
};

// The pixels of one type: what the templates work on.
template <class P> struct Pixels {
    ImageView image;

    const typename P::Raw *row(int y) const {
        return reinterpret_cast<const typename P::Raw *>(image.data + y * image.row_bytes);
    }
    float at(int x, int y) const { return static_cast<float>(P::key(row(y)[x])); }
    bool inside(int x, int y, int margin = 0) const {
        return x >= margin && y >= margin && x < image.width - margin && y < image.height - margin;
    }
};

// Calls `use` with the Pixels<...> of the image's type.
template <class Use> decltype(auto) with_pixels(const ImageView &image, Use &&use) {
    switch (image.type) {
    case PixelType::U16Fits:
        return use(Pixels<PixelU16Fits>{image});
    case PixelType::F32:
        return use(Pixels<PixelF32>{image});
    case PixelType::F32Fits:
        return use(Pixels<PixelF32Fits>{image});
    case PixelType::F64:
        return use(Pixels<PixelF64>{image});
    case PixelType::U16:
        break;
    }
    return use(Pixels<PixelU16>{image});
}

} // namespace fl::metrology
