// The law of steppers (fl_steps.h) over arrays: for tests and replay.
#pragma once

#include "../bind.hpp"

#include <algorithm>
#include <cstdlib>
#include <tuple>

extern "C" {
#include "fl_steps.h"
}

namespace steps_law {

constexpr int32_t most_count = 1 << 30;

// segment_ticks, start, most, change, field_steps
inline fl_steps_config_t config_of(const Input<int32_t, 5> &c) {
    const int32_t *v = c.data();
    if (v[1] < 1 || v[2] < v[1] || v[2] >= 1 << 15)
        throw nb::value_error("config: 1 <= start <= most < 2^15");
    if (v[0] < v[2]) throw nb::value_error("config: a segment has at least as many ticks as microsteps");
    if (v[3] < 1 || v[3] >= 1 << 15 || v[4] < 4)
        throw nb::value_error("config: 1 <= change < 2^15, field >= 4");
    return {static_cast<uint32_t>(v[0]), v[1], v[2], v[3], v[4]};
}

inline void check_count(int32_t count) {
    if (std::abs(static_cast<int64_t>(count)) >= most_count) throw nb::value_error("counts: below 2^30");
}

// Position, segment, field and whether it is at rest, at the end of each tick of a way.
inline Output<int32_t, -1, 4> trace(Input<int32_t, 5> config, int32_t position, int32_t goal, int ticks,
                                    int stop_tick) {
    const fl_steps_config_t cfg = config_of(config);
    check_count(position), check_count(goal);
    auto out = new_array<int32_t, -1, 4>({static_cast<size_t>(std::max(ticks, 0)), 4});
    fl_steps_state_t st = {};
    st.position = position;
    fl_steps_go(&st, goal);
    for (int i = 0; i < ticks; ++i) {
        if (i == stop_tick) fl_steps_stop(&cfg, &st);
        const auto o = fl_steps_step(&cfg, &st, false);
        const int32_t line[4] = {st.position, st.segment, o.field, o.done};
        std::copy_n(line, 4, out.data() + 4 * i);
    }
    return out;
}

// A search by a rotor that is `lost` microsteps behind its count, with the edge of the switch at 0.
inline std::tuple<bool, int32_t, int32_t> seek(Input<int32_t, 5> config, int32_t position, int32_t lost,
                                               int32_t most) {
    const fl_steps_config_t cfg = config_of(config);
    check_count(position), check_count(most);
    fl_steps_state_t st = {};
    st.position = position;
    fl_steps_seek(&st, most);
    int32_t rotor = position - lost;
    for (bool done = false; !done;) {
        const auto o = fl_steps_step(&cfg, &st, most < 0 ? rotor <= 0 : rotor >= 0);
        rotor += o.step;
        done = o.done;
    }
    return {st.found, st.slip, st.position};
}

inline void bind(nb::module_ &m) {
    m.def(
        "steps_trace", &trace, nb::arg("config"), nb::arg("position"), nb::arg("goal"), nb::arg("ticks"),
        nb::arg("stop_tick") = -1,
        "(ticks, 4) position, segment, field in microsteps and whether it is at rest, at the end of each "
        "tick of a way; braked from stop_tick on. config: segment_ticks, start, most, change, field_steps.");
    m.def(
        "steps_seek", &seek, nb::arg("config"), nb::arg("position"), nb::arg("lost"), nb::arg("most"),
        "(found, slip, position) of a search of the datum by a rotor `lost` microsteps behind its count; the "
        "switch closes at 0 of the rotor.");
}

} // namespace steps_law
