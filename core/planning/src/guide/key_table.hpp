// What is known of many keys: a table with open addressing, which doubles as soon as half of it is taken.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace fl::planning {

template <class Value> class KeyTable {
  public:
    using Key = std::uint64_t;

    // Forgets all, and has so many places at first. @pre a power of two
    void clear(std::size_t places) {
        table_.assign(places, Entry());
        taken_ = 0;
    }
    // None if nothing is known of it. Valid until something is added.
    const Value *find(Key key) const {
        if (table_.empty()) return nullptr;
        const Entry &entry = table_[place_of(key)];
        return entry.key == key ? &entry.value : nullptr;
    }
    // @pre nothing is known of it yet
    void add(Key key, const Value &value) {
        if (2 * (taken_ + 1) > table_.size()) grow();
        put({key, value});
    }

  private:
    static constexpr Key no_key = ~Key{0};
    static constexpr std::size_t first_places = 64; // where `clear` has not said how many
    struct Entry {
        Key key = no_key;
        Value value{};
    };
    // Of the key, or the free one where it belongs.
    std::size_t place_of(Key key) const {
        const std::size_t mask = table_.size() - 1;
        std::size_t at = (key * 0x9e3779b97f4a7c15u >> 32) & mask;
        while (table_[at].key != no_key && table_[at].key != key) at = (at + 1) & mask;
        return at;
    }
    void put(const Entry &entry) {
        table_[place_of(entry.key)] = entry;
        ++taken_;
    }
    void grow() {
        const std::vector<Entry> before = std::move(table_);
        clear(before.empty() ? first_places : 2 * before.size());
        for (const Entry &entry : before)
            if (entry.key != no_key) put(entry);
    }

    std::vector<Entry> table_;
    std::size_t taken_ = 0;
};

} // namespace fl::planning
