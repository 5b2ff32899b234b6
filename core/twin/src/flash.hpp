// The storage of a board in the twin: erased but for what was written. Few blocks ever are, and most of those
// hold what lies elsewhere, too.
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
                std::copy_n(content(number) + at, n, bytes + done);
        });
    }
    void write(size_t offset, const uint8_t *bytes, size_t len) {
        each_block(offset, len, [&](size_t number, size_t at, size_t done, size_t n) {
            if (place_[number] == shared && std::equal(bytes + done, bytes + done + n, content(number) + at))
                return;
            std::copy_n(bytes + done, n, &block(number)[at]);
        });
    }
    // Blocks that lie within a copy of `image` need no memory of their own, until they are written anew.
    // @pre the image, of `len` bytes, stays where and as it is
    void share(const uint8_t *image, size_t len) {
        std::array<uint8_t, storage_bytes> all;
        read(0, all.data(), all.size());
        const auto found = std::search(all.begin(), all.end(), image, image + len);
        if (found == all.end()) return;
        image_ = image;
        image_at_ = static_cast<size_t>(found - all.begin());
        const size_t first = (image_at_ + block_bytes - 1) / block_bytes;
        const size_t end = (image_at_ + len) / block_bytes;
        blocks_ = {};
        std::array<uint8_t, storage_bytes / block_bytes> before = place_;
        place_.fill(erased);
        for (size_t number = 0; number < before.size(); ++number) {
            if (number >= first && number < end)
                place_[number] = shared;
            else if (before[number] != erased)
                std::copy_n(&all[number * block_bytes], block_bytes, block(number).begin());
        }
    }
    // Memory beside the object itself.
    size_t bytes() const { return blocks_.capacity() * block_bytes; }

  private:
    static constexpr size_t block_bytes = 64;
    static constexpr uint8_t erased = 0xff, shared = 0xfe;
    using Block = std::array<uint8_t, block_bytes>;

    // Number of a block, where it begins in it, what is done before, and how many bytes there.
    template <typename Do> static void each_block(size_t offset, size_t len, Do &&what) {
        for (size_t done = 0, n = 0; done < len; done += n) {
            const size_t at = (offset + done) % block_bytes;
            n = std::min(block_bytes - at, len - done);
            what((offset + done) / block_bytes, at, done, n);
        }
    }
    // What a block holds that is not erased.
    const uint8_t *content(size_t number) const {
        return place_[number] == shared ? image_ + (number * block_bytes - image_at_)
                                        : blocks_[place_[number]].data();
    }
    // A block of its own, to be written.
    Block &block(size_t number) {
        uint8_t &place = place_[number];
        if (place >= shared) {
            Block filled;
            if (place == shared)
                std::copy_n(content(number), block_bytes, filled.begin());
            else
                filled.fill(0xff);
            place = static_cast<uint8_t>(blocks_.size());
            blocks_.reserve(blocks_.size() + 1); // no more than that: written once in a life
            blocks_.push_back(filled);
        }
        return blocks_[place];
    }

    std::array<uint8_t, storage_bytes / block_bytes> place_; // of each block, or erased
    std::vector<Block> blocks_;
    const uint8_t *image_ = nullptr; // of what is shared, and where in the storage it begins
    size_t image_at_ = 0;
};

} // namespace fl::twin
