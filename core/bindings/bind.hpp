// What the files of the Python module share: one binder per room, and the array types.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

namespace nb = nanobind;

void bind_firmware(nb::module_ &m);
void bind_geometry(nb::module_ &m);
void bind_metrology(nb::module_ &m);
void bind_planning(nb::module_ &m);
void bind_twin(nb::module_ &m);

// Read-only, C-contiguous, on the CPU: nanobind converts or copies where the caller's is not.
template <class T, size_t... Shape>
using Input =
    nb::ndarray<const T, nb::shape<static_cast<nb::ssize_t>(Shape)...>, nb::c_contig, nb::device::cpu>;
template <class T> using Input1 = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T> using Input2 = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// A new numpy array that owns its memory.
template <class T> nb::ndarray<nb::numpy, T> new_array(std::initializer_list<size_t> shape) {
    size_t size = 1;
    for (size_t n : shape) size *= n;
    T *data = new T[size]();
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return nb::ndarray<nb::numpy, T>(data, shape, owner);
}
