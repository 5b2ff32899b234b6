// The law of move tables (fl_rows.h) over arrays: for tests and replay.
#pragma once

#include "../bind.hpp"

#include <algorithm>
#include <cstdlib>
#include <vector>

extern "C" {
#include "fl_rows.h"
}

namespace rows_law {

using Table = Input<int32_t, -1, 5>;
using Tables = Input<int32_t, -1, -1, 5>;

// One row: signed steps of both motors, which of them cruise, pause.
inline fl_row_t row_of(const int32_t *r) {
    if (std::abs(r[0]) >= 1 << 20 || std::abs(r[1]) >= 1 << 20) throw nb::value_error("steps: below 2^20");
    if (r[4] < 0 || r[4] > UINT16_MAX) throw nb::value_error("pause: 0..65535");
    return {{r[0], r[1]}, {r[2] != 0, r[3] != 0}, static_cast<uint16_t>(r[4])};
}

inline std::vector<fl_row_t> table_of(const int32_t *data, size_t count) {
    std::vector<fl_row_t> rows;
    for (size_t k = 0; k < count; ++k) rows.push_back(row_of(data + 5 * k));
    return rows;
}

inline fl_rows_config_t config_of(const Input<uint32_t, 4> &c) {
    if (!c.data()[0] || !c.data()[1] || !c.data()[2]) throw nb::value_error("config: three numbers above 0");
    return {c.data()[0], c.data()[1], c.data()[2], c.data()[3]};
}

// Fields and phases of both motors at the end of each tick.
inline Output<int32_t, -1, 4> trace(Input<uint32_t, 4> config, Table table, int ticks) {
    const fl_rows_config_t cfg = config_of(config);
    const auto rows = table_of(table.data(), table.shape(0));
    auto out = new_array<int32_t, -1, 4>({static_cast<size_t>(std::max(ticks, 0)), 4});
    fl_rows_state_t st = {};
    for (int i = 0; i < ticks; ++i) {
        const auto o = fl_rows_step(&cfg, &st, rows.data(), static_cast<uint32_t>(rows.size()));
        const int32_t line[4] = {o.field_tenths[0], o.field_tenths[1], o.phase[0], o.phase[1]};
        std::copy_n(line, 4, out.data() + 4 * i);
    }
    return out;
}

// One table to its end: fields of both motors and the tick at the end of each row.
inline void run_table(const fl_rows_config_t &cfg, const std::vector<fl_row_t> &rows, int32_t *out) {
    const auto count = static_cast<uint32_t>(rows.size());
    fl_rows_state_t st = {};
    int32_t tick = 0;
    for (uint32_t row = 0; row < count; ++row) {
        while (fl_rows_next(&cfg, rows.data(), count, st.row) <= row) {
            fl_rows_step(&cfg, &st, rows.data(), count);
            ++tick;
        }
        const int32_t line[3] = {st.field_tenths[0], st.field_tenths[1], tick};
        std::copy_n(line, 3, out + 3 * row);
    }
}

inline Output<int32_t, -1, -1, 3> ends(Input<uint32_t, 4> config, Tables tables) {
    const fl_rows_config_t cfg = config_of(config);
    const size_t n = tables.shape(0), r = tables.shape(1);
    auto out = new_array<int32_t, -1, -1, 3>({n, r, 3});
    for (size_t i = 0; i < n; ++i)
        run_table(cfg, table_of(tables.data() + i * r * 5, r), out.data() + i * r * 3);
    return out;
}

inline void bind(nb::module_ &m) {
    m.def(
        "rows_trace", &trace, nb::arg("config"), nb::arg("table"), nb::arg("ticks"),
        "(ticks, 4) fields of both motors in tenths of a motor deg and their phases, at the end of each tick "
        "of a table: rows of steps (2), cruise (2), pause. config: creep_ticks, cruise_tenths, ramp_ticks, "
        "pause_ticks.");
    m.def("rows_ends", &ends, nb::arg("config"), nb::arg("tables"),
          "(n, R, 3) fields of both motors in tenths of a motor deg, and the tick, at the end of each row.");
}

} // namespace rows_law
