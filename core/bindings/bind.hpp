// What the files of the Python module share: one binder per room, and the array types.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

namespace nb = nanobind;

void bind_firmware(nb::module_ &m);
void bind_geometry(nb::module_ &m);
void bind_metrology(nb::module_ &m);
void bind_planning(nb::module_ &m);
void bind_plant(nb::module_ &m);
void bind_twin(nb::module_ &m);

// Read-only, C-contiguous, on the CPU: nanobind converts or copies where the caller's is not.
template <class T, nb::ssize_t... Shape>
using Input = nb::ndarray<const T, nb::shape<Shape...>, nb::c_contig, nb::device::cpu>;
template <class T> using Input1 = Input<T, -1>;
template <class T> using Input2 = Input<T, -1, -1>;

// A numpy array that owns its memory; -1 for sizes that are known only when the program runs.
template <class T, nb::ssize_t... Shape> using Output = nb::ndarray<nb::numpy, T, nb::shape<Shape...>>;
template <class T, nb::ssize_t... Shape> Output<T, Shape...> new_array(std::initializer_list<size_t> shape) {
    size_t size = 1;
    for (size_t n : shape) size *= n;
    T *data = new T[size]();
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return Output<T, Shape...>(data, shape, owner);
}
