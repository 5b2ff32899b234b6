// One reader per pixel type, and the switch from the run-time type to it.
#pragma once

#include "fiberloom/image.hpp"

#include <bit>
#include <cmath>
#include <cstring>

namespace fl::metrology {

struct PixelU16 {
    using Raw = std::uint16_t;
    using Key = std::uint16_t; // what the scan compares
    static Key key(Raw raw) { return raw; }
};

struct PixelU16Fits {
    using Raw = std::uint16_t;
    using Key = std::uint16_t;
    static Key key(Raw raw) { return static_cast<Key>(((raw >> 8) | (raw << 8)) ^ 0x8000); }
};

struct PixelF32 {
    using Raw = float;
    using Key = float;
    static Key key(Raw raw) { return raw; }
};

struct PixelF32Fits {
    using Raw = std::uint32_t;
    using Key = float;
    static Key key(Raw raw) { return std::bit_cast<float>(__builtin_bswap32(raw)); }
};

struct PixelF64 {
    using Raw = double;
    using Key = double;
    static Key key(Raw raw) { return raw; }
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
