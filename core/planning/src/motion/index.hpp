// Lists whose places are counted by signed numbers of one kind each: the row of a positioner in the task
// cannot be taken for its place in the path set, and no cast between signed and unsigned is needed.
#pragma once

#include <algorithm>
#include <compare>
#include <cstddef>
#include <vector>

namespace fl::planning {

// A place in the lists of one kind; without a number: no place.
template <class Kind> class Index {
  public:
    constexpr Index() = default;
    constexpr explicit Index(int place) : place_(place) {}
    constexpr int value() const { return place_; }
    friend constexpr auto operator<=>(Index, Index) = default;

  private:
    int place_ = -1;
};

using PositionerIndex = Index<struct PositionerKind>; // a row of Bodies and Task
using PathIndex = Index<struct PathKind>;             // a place in a PathSet

constexpr int number_of(int place) { return place; }
template <class Kind> constexpr int number_of(Index<Kind> place) { return place.value(); }

// 0 .. count - 1 as places of one kind, for range-based loops.
template <class I> class Places {
  public:
    struct Iterator {
        int place;
        I operator*() const { return I(place); }
        Iterator &operator++() {
            ++place;
            return *this;
        }
        bool operator!=(const Iterator &other) const { return place != other.place; }
    };
    explicit Places(int count) : count_(count) {}
    Iterator begin() const { return {0}; }
    Iterator end() const { return {count_}; }

  private:
    int count_;
};

// A std::vector with signed sizes, indexed by I alone.
template <class T, class I = int> class List : private std::vector<T> {
    using Base = std::vector<T>;

  public:
    using Base::Base;
    using Base::begin, Base::end, Base::data, Base::empty, Base::clear, Base::front, Base::back;
    using Base::push_back, Base::emplace_back, Base::pop_back, Base::insert, Base::erase;
    using typename Base::value_type, typename Base::iterator, typename Base::const_iterator;

    List() = default;
    explicit List(int count) : Base(static_cast<size_t>(count)) {}
    List(int count, const T &value) : Base(static_cast<size_t>(count), value) {}

    int size() const { return static_cast<int>(Base::size()); }
    Places<I> places() const { return Places<I>(size()); }
    T &operator[](I i) { return Base::operator[](static_cast<size_t>(number_of(i))); }
    const T &operator[](I i) const { return Base::operator[](static_cast<size_t>(number_of(i))); }
    void resize(int count) { Base::resize(static_cast<size_t>(count)); }
    void resize(int count, const T &value) { Base::resize(static_cast<size_t>(count), value); }
    void assign(int count, const T &value) { Base::assign(static_cast<size_t>(count), value); }

    bool contains(const T &value) const { return std::find(begin(), end(), value) != end(); }
    template <class Test> void erase_if(Test test) { std::erase_if(static_cast<Base &>(*this), test); }
};

// A row of the public structures, which hold a std::vector each.
template <class T> const T &row(const std::vector<T> &rows, PositionerIndex i) {
    return rows[static_cast<size_t>(i.value())];
}

} // namespace fl::planning
