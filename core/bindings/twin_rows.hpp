// Rows of numbers to the structures of the twin.
#pragma once

#include <nanobind/stl/variant.h>

#include <cstring>
#include <variant>

#include "bind.hpp"
#include "fiberloom/twin/plant.hpp"

namespace fl::twin {

using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

inline constexpr size_t param_doubles = sizeof(PlantParams) / sizeof(double);
inline constexpr size_t transmission_doubles = sizeof(Transmission) / sizeof(double);

// A number for all axes, or that and another for those that push their gears.
using SubstepsArgument = std::variant<int, std::pair<int, int>>;

inline Substeps substeps_of(const SubstepsArgument &argument) {
    if (const int *all = std::get_if<int>(&argument)) return {*all, *all};
    const auto [all, pushing] = std::get<std::pair<int, int>>(argument);
    return {all, pushing};
}

inline size_t rows_of(size_t size, size_t width, const char *what) {
    if (size % width != 0)
        throw nb::value_error(
            (std::string(what) + ": rows of " + std::to_string(width) + " numbers").c_str());
    return size / width;
}

inline std::vector<Unit> units_of(const Doubles &params, const Doubles &transmission) {
    const size_t n = rows_of(params.size(), param_doubles, "plant");
    if (rows_of(transmission.size(), transmission_doubles, "transmission") != n)
        throw nb::value_error("plant and transmission need the same number of axes");
    std::vector<Unit> units(n);
    for (size_t i = 0; i < n; ++i) {
        std::memcpy(static_cast<void *>(&units[i].params), params.data() + i * param_doubles,
                    sizeof(PlantParams));
        std::memcpy(static_cast<void *>(&units[i].transmission),
                    transmission.data() + i * transmission_doubles, sizeof(Transmission));
    }
    return units;
}

inline Transmission transmission_of(const Input1<double> &row) {
    if (row.size() != transmission_doubles)
        throw nb::value_error("transmission: one row of TRANSMISSION_SIZE");
    Transmission t;
    std::memcpy(static_cast<void *>(&t), row.data(), sizeof t);
    return t;
}

inline PlantParams params_of(const Input1<double> &row) {
    if (row.size() != param_doubles) throw nb::value_error("plant: one row of PLANT_PARAMS");
    PlantParams p;
    std::memcpy(static_cast<void *>(&p), row.data(), sizeof p);
    return p;
}

} // namespace fl::twin
