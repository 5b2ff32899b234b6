// The storage of a board in the twin: erased, but for what was flashed at the factory and what was written.
// Only what differs from these two takes memory.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "fiberloom/twin/differing.hpp"
#include "fiberloom/twin/twin.hpp"

namespace fl::twin {

inline constexpr size_t storage_bytes = 4096;

// The parameters that a positioner was flashed with at the factory.
class FactoryParams {
  public:
    using Both = std::array<fl_axis_params_t, FL_AXES>;
    static constexpr size_t byte_count = sizeof(Both);
    using Bytes = std::array<uint8_t, byte_count>;

    // `own`, told by what differs from those of the first unit.
    // @pre first stays where and as it is
    void set(const Both &first, const Both &own) {
        first_ = &first;
        differing_ = Differing<Both>(first, own);
    }
    // @pre they have been set
    Both both() const { return differing_.with(*first_); }
    Bytes bytes() const { return std::bit_cast<Bytes>(both()); }
    // Memory beside the object itself.
    size_t held_bytes() const { return differing_.held_bytes(); }

  private:
    const Both *first_ = nullptr;
    Differing<Both> differing_;
};

class Flash {
  public:
    // @pre offset + len <= storage_bytes, for both
    void read(size_t offset, uint8_t *bytes, size_t len) const {
        std::fill_n(bytes, len, uint8_t{0xff});
        read_factory(offset, bytes, len);
        for (const Cell &cell : cells_)
            overlay(cell.number * cell_bytes, cell.bytes.data(), cell_bytes, offset, bytes, len);
    }
    void write(size_t offset, const uint8_t *bytes, size_t len) {
        for (size_t done = 0, n = 0; done < len; done += n) {
            const size_t at = (offset + done) % cell_bytes;
            n = std::min(cell_bytes - at, len - done);
            write_within((offset + done) / cell_bytes, at, bytes + done, n);
        }
    }
    // What lies within a copy of `params` needs no memory of its own, until it is written anew.
    // @pre they stay where and as they are
    void share(const FactoryParams &params) {
        std::array<uint8_t, storage_bytes> all;
        read(0, all.data(), all.size());
        const FactoryParams::Bytes image = params.bytes();
        const auto found = std::search(all.begin(), all.end(), image.begin(), image.end());
        if (found == all.end()) return;
        factory_ = &params;
        factory_at_ = static_cast<size_t>(found - all.begin());
        cells_ = std::vector<Cell>(); // with its memory
        write(0, all.data(), all.size());
    }
    // Memory beside the object itself.
    size_t held_bytes() const { return cells_.capacity() * sizeof(Cell); }

  private:
    static constexpr size_t cell_bytes = 16;
    static_assert(storage_bytes / cell_bytes - 1 <= UINT8_MAX);
    using Content = std::array<uint8_t, cell_bytes>;
    // Of its own; others are as at the factory, or erased.
    struct Cell {
        uint8_t number;
        Content bytes;
    };

    // What both have of the storage, from the first, which begins at `from`, into the other.
    static void overlay(size_t from, const uint8_t *source, size_t source_len, size_t offset, uint8_t *bytes,
                        size_t len) {
        const size_t begin = std::max(from, offset), end = std::min(from + source_len, offset + len);
        if (begin < end) std::copy_n(source + (begin - from), end - begin, bytes + (begin - offset));
    }
    void read_factory(size_t offset, uint8_t *bytes, size_t len) const {
        if (factory_ == nullptr || offset >= factory_at_ + FactoryParams::byte_count ||
            offset + len <= factory_at_)
            return;
        const FactoryParams::Bytes image = factory_->bytes();
        overlay(factory_at_, image.data(), image.size(), offset, bytes, len);
    }
    // What would change nothing takes no memory.
    void write_within(size_t number, size_t at, const uint8_t *bytes, size_t len) {
        const auto same = [&](const Cell &cell) { return cell.number == number; };
        auto found = std::find_if(cells_.begin(), cells_.end(), same);
        if (found == cells_.end()) {
            Cell now{static_cast<uint8_t>(number), {}};
            read(number * cell_bytes, now.bytes.data(), cell_bytes);
            if (std::equal(bytes, bytes + len, &now.bytes[at])) return;
            cells_.reserve(cells_.size() + 1); // no more than that: written once in a life
            found = cells_.insert(cells_.end(), now);
        }
        std::copy_n(bytes, len, &found->bytes[at]);
    }

    std::vector<Cell> cells_;
    const FactoryParams *factory_ = nullptr; // of what is shared, and where in the storage it begins
    size_t factory_at_ = 0;
};

} // namespace fl::twin
