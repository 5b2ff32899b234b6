// The storage of a board in the twin: erased but for what was written. Few blocks ever are.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace fl::twin {

inline constexpr size_t storage_bytes = 4096;

class Flash {
  public:
    Flash() { place_.fill(erased); }
    // @pre offset + len <= storage_bytes, for both
    void read(size_t offset, uint8_t *bytes, size_t len) const {
        each_block(offset, len, [&](size_t number, size_t at, size_t done, size_t n) {
            if (place_[number] == erased)
                std::fill_n(bytes + done, n, uint8_t{0xff});
            else
                std::copy_n(&blocks_[place_[number]][at], n, bytes + done);
        });
    }
    void write(size_t offset, const uint8_t *bytes, size_t len) {
        each_block(offset, len, [&](size_t number, size_t at, size_t done, size_t n) {
            std::copy_n(bytes + done, n, &block(number)[at]);
        });
    }
    // Memory beside the object itself.
    size_t bytes() const { return blocks_.capacity() * block_bytes; }

  private:
    static constexpr size_t block_bytes = 64;
    static constexpr uint8_t erased = 0xff;
    using Block = std::array<uint8_t, block_bytes>;

    // Number of a block, where it begins in it, what is done before, and how many bytes there.
    template <typename Do> static void each_block(size_t offset, size_t len, Do &&what) {
        for (size_t done = 0, n = 0; done < len; done += n) {
            const size_t at = (offset + done) % block_bytes;
            n = std::min(block_bytes - at, len - done);
            what((offset + done) / block_bytes, at, done, n);
        }
    }
    Block &block(size_t number) {
        uint8_t &place = place_[number];
        if (place == erased) {
            place = static_cast<uint8_t>(blocks_.size());
            blocks_.reserve(blocks_.size() + 1); // no more than that: written once in a life
            blocks_.emplace_back().fill(0xff);
        }
        return blocks_[place];
    }

    std::array<uint8_t, storage_bytes / block_bytes> place_; // of each block, or erased
    std::vector<Block> blocks_;
};

} // namespace fl::twin
