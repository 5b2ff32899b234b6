// An image in memory of the caller, read in place: rows of pixels with any distance between rows.
//
// The centre of the first pixel is (0, 0); x runs along a row. Pixels are digital units (ADU). A pixel of
// floats that is not finite or beyond 1e10 ADU, which no detector gives, counts as one that holds no light.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fl::metrology {

// U16Fits and F32Fits are what an uncompressed FITS file holds, byte for byte: big-endian, and for
// BITPIX = 16 with BZERO = 32768 the sign bit stands for the offset. A memory-mapped file is read as it is.
enum class PixelType { U16, U16Fits, F32, F32Fits, F64 };

// Pixels in memory of the caller, which must stay while the view is used.
// @pre data holds height rows of width pixels of the type, row_bytes from one to the next.
struct ImageView {
    const std::byte *data = nullptr;
    std::ptrdiff_t row_bytes = 0;
    int width = 0;
    int height = 0;
    PixelType type = PixelType::U16;
};

} // namespace fl::metrology
