// The firmware's laws, each alone, over arrays: for tests, notebooks and replay of logs.
#include "bind_laws.hpp"

#include "open_loop/bind_rows.hpp"
#include "open_loop/bind_steps.hpp"

#include <algorithm>
#include <memory>
#include <optional>
#include <tuple>

#ifdef __SSE__
#include <xmmintrin.h>
#endif

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

extern "C" {
#include "fl_axis.h"
#include "fl_calibration.h"
#include "fl_commands.h"
#include "fl_crc.h"
#include "fl_supervisor.h"
}

namespace {

using Params = Input1<float>;

fl_axis_params_t params_of(const Params &row) {
    fl_axis_params_t p;
    if (row.shape(0) * sizeof(float) != sizeof p)
        throw nb::value_error("params: one float32 for every line of AXIS_PARAMS");
    std::copy_n(row.data(), row.shape(0), reinterpret_cast<float *>(&p));
    return p;
}

// An axis is mostly trajectory memory: too much for a stack.
std::unique_ptr<fl_axis_t> axis_of(const Params &row) {
    auto a = std::make_unique<fl_axis_t>();
    const fl_axis_params_t p = params_of(row);
    fl_axis_init(a.get(), &p);
    return a;
}

void same_length(size_t a, size_t b) {
    if (a != b) throw nb::value_error("arrays need the same length");
}

Output<float, -1, 2> sine_cosine(Input1<int32_t> angle_cnt) {
    const size_t n = angle_cnt.shape(0);
    auto out = new_array<float, -1, 2>({n, 2});
    for (size_t i = 0; i < n; ++i) {
        const fl_sincos_t v = fl_sincos_cnt(angle_cnt.data()[i]);
        out.data()[2 * i] = v.sin;
        out.data()[2 * i + 1] = v.cos;
    }
    return out;
}

Output<int32_t, -1> atan2_cnt(Input1<float> s, Input1<float> c) {
    same_length(s.shape(0), c.shape(0));
    auto out = new_array<int32_t, -1>({s.shape(0)});
    for (size_t i = 0; i < s.shape(0); ++i) out.data()[i] = fl_atan2_cnt(s.data()[i], c.data()[i]);
    return out;
}

Output<float, -1> square_root(Input1<float> x) {
    auto out = new_array<float, -1>({x.shape(0)});
    for (size_t i = 0; i < x.shape(0); ++i) out.data()[i] = fl_sqrt(x.data()[i]);
    return out;
}

// Unwrapped angles of a row of samples.
Output<int32_t, -1> hall_angle(Params params, Input2<uint16_t> adc_cnt) {
    if (adc_cnt.shape(1) != 2) throw nb::value_error("adc_cnt: (n, 2)");
    const auto axis = axis_of(params);
    auto out = new_array<int32_t, -1>({adc_cnt.shape(0)});
    for (size_t i = 0; i < adc_cnt.shape(0); ++i)
        out.data()[i] = fl_hall_step(&axis->law.hall, &axis->hall, adc_cnt.data() + 2 * i).angle_cnt;
    return out;
}

Output<float, -1, 3> commutate(Input1<float> voltage, Input2<float> rotor, float lead_rad) {
    same_length(voltage.shape(0), rotor.shape(0));
    if (rotor.shape(1) != 2) throw nb::value_error("rotor: (n, 2) of sine and cosine");
    auto out = new_array<float, -1, 3>({voltage.shape(0), 3});
    for (size_t i = 0; i < voltage.shape(0); ++i) {
        const fl_sincos_t r{rotor.data()[2 * i], rotor.data()[2 * i + 1]};
        const fl_duty_t d = fl_commutate(voltage.data()[i], r, lead_rad);
        std::copy_n(d.phase, 3, out.data() + 3 * i);
    }
    return out;
}

Output<float, -1, 3> rotating_field(float u, Input1<int32_t> field_cnt) {
    auto out = new_array<float, -1, 3>({field_cnt.shape(0), 3});
    for (size_t i = 0; i < field_cnt.shape(0); ++i) {
        const fl_duty_t d = fl_rotating_field(u, field_cnt.data()[i]);
        std::copy_n(d.phase, 3, out.data() + 3 * i);
    }
    return out;
}

// Rows in: command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2. Rows out: torque, feedforward,
// watched feedback, learnt drag scale, collision (0 or 1).
Output<double, -1, 5> servo(Params params, Input2<double> rows, bool settling) {
    if (rows.shape(1) != 4) throw nb::value_error("rows: (n, 4)");
    const auto axis = axis_of(params);
    auto out = new_array<double, -1, 5>({rows.shape(0), 5});
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *r = rows.data() + 4 * i;
        const auto command = static_cast<int32_t>(r[0]), measured = static_cast<int32_t>(r[1]);
        const fl_servo_in_t in = {fl_sub_i32(command, measured), command, command, static_cast<float>(r[2]),
                                  static_cast<float>(r[3]),      settling};
        const fl_servo_out_t o = fl_servo_step(&axis->law.drive.servo, &axis->drive.servo, &in, FL_TICK_S);
        const bool hit = fl_collision_closed(
            &axis->law.drive.collision,
            {o.watched_Nm, in.speed_rad_s, axis->drive.servo.direction, axis->drive.servo.drag_doubt});
        const double row[5] = {o.torque_Nm, o.feedforward_Nm, o.watched_Nm, axis->drive.servo.drag_scale,
                               double(hit)};
        std::copy_n(row, 5, out.data() + 5 * i);
    }
    return out;
}

// Law 1 along rows of command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2. Rows out: torque,
// feedforward, watched feedback, voltage, load_Nm, the gap below the rotor in counts.
Output<double, -1, 6> regulator(Params params, Input2<double> rows, int32_t zero_cnt) {
    if (rows.shape(1) != 4) throw nb::value_error("rows: (n, 4)");
    const auto axis = axis_of(params);
    const fl_drive_config_t *cfg = &axis->law.drive;
    fl_drive_state_t *st = &axis->drive;
    auto out = new_array<double, -1, 6>({rows.shape(0), 6});
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *r = rows.data() + 4 * i;
        const auto command = static_cast<int32_t>(r[0]), measured = static_cast<int32_t>(r[1]);
        const int32_t rotor = fl_sub_i32(measured, zero_cnt);
        const fl_servo_in_t in = {fl_sub_i32(command, measured), command,
                                  fl_sub_i32(command, zero_cnt), static_cast<float>(r[2]),
                                  static_cast<float>(r[3]),      false};
        const fl_drive_out_t o = fl_drive_contact(cfg, st, &in, fl_sincos_cnt(rotor));
        const double row[6] = {o.torque.torque_Nm,
                               o.torque.feedforward_Nm,
                               o.torque.watched_Nm,
                               o.voltage,
                               st->regulator.seen.load_rad_s2 * cfg->regulator.inertia,
                               double(fl_sub_i32(rotor, st->teeth.gear_cnt))};
        std::copy_n(row, 6, out.data() + 6 * i);
    }
    return out;
}

// Rows in: error_rad, beyond_Nm, excess_Nms, speed_rad_s, direction, acceleration_rad_s2, drag_doubt,
// touching (0 or 1), sine and cosine of the rotor. Rows out: rise_Nm, limit_Nm, touched (0 or 1), and what is
// learnt of the ripple, Nm: sine and cosine of orders 1 and 2.
Output<double, -1, 7> touch(Params params, Input2<double> rows) {
    if (rows.shape(1) != 10) throw nb::value_error("rows: (n, 10)");
    const auto axis = axis_of(params);
    fl_touch_state_t *st = &axis->drive.touch;
    auto out = new_array<double, -1, 7>({rows.shape(0), 7});
    for (size_t i = 0; i < rows.shape(0); ++i) {
        float r[10];
        std::transform(rows.data() + 10 * i, rows.data() + 10 * i + 10, r, [](double x) { return float(x); });
        const fl_touch_in_t in = {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9]};
        const bool touched = fl_touch_step(&axis->law.drive.touch, st, &in);
        const fl_ripple_state_t &w = st->ripple;
        const double row[7] = {st->rise_Nm,   st->limit_Nm,   double(touched), w.once_sin_Nm,
                               w.once_cos_Nm, w.twice_sin_Nm, w.twice_cos_Nm};
        std::copy_n(row, 7, out.data() + 7 * i);
    }
    return out;
}

// Rows out: position_cnt now, speed_rad_s and acceleration_rad_s2 over the coming tick.
Output<double, -1, 3> smooth(Input1<int32_t> raw_cnt, int32_t start_cnt) {
    fl_smooth_state_t st;
    fl_smooth_reset(&st, start_cnt);
    auto out = new_array<double, -1, 3>({raw_cnt.shape(0), 3});
    for (size_t i = 0; i < raw_cnt.shape(0); ++i) {
        const fl_command_t c = fl_smooth_step(&st, raw_cnt.data()[i]);
        const double row[3] = {double(c.position_cnt), c.speed_rad_s, c.acceleration_rad_s2};
        std::copy_n(row, 3, out.data() + 3 * i);
    }
    return out;
}

// Positions at the end of each tick, target last.
Output<int32_t, -1> profile(int32_t from_cnt, int32_t to_cnt, float speed_rpm, float acceleration_rad_s2) {
    if (!(speed_rpm > 0) || !(acceleration_rad_s2 > 0))
        throw nb::value_error("speed and acceleration must be positive");
    fl_profile_state_t st;
    const fl_profile_limits_t lim = {speed_rpm * FL_CNT_TICK_PER_RPM,
                                     acceleration_rad_s2 * FL_CNT_TICK2_PER_RAD_S2};
    fl_profile_start(&st, from_cnt, to_cnt, lim);
    auto out = new_array<int32_t, -1>({st.total_ticks});
    for (size_t i = 0; i < out.shape(0); ++i) out.data()[i] = fl_profile_step(&st);
    return out;
}

// Rows of points (position_cnt, tick); positions at the end of each of n ticks.
std::tuple<Output<int32_t, -1>, int, bool> path(Input2<int32_t> points, int32_t here_cnt, size_t ticks,
                                                int32_t landing_cnt) {
    if (points.shape(1) != 2) throw nb::value_error("points: (n, 2) of position_cnt and tick");
    auto p = std::make_unique<fl_path_t>();
    fl_path_clear(p.get());
    for (size_t i = 0; i < points.shape(0); ++i)
        if (!fl_path_append(p.get(), points.data()[2 * i], points.data()[2 * i + 1]))
            throw nb::value_error(("point " + std::to_string(i) + " was not taken").c_str());
    p->landing_cnt = landing_cnt;
    fl_path_cursor_t cursor;
    fl_path_start(&cursor, here_cnt);
    auto out = new_array<int32_t, -1>({ticks});
    for (size_t i = 0; i < ticks; ++i) out.data()[i] = fl_path_step(p.get(), &cursor);
    return {out, int{p->slots}, fl_path_done(p.get(), &cursor)};
}

std::pair<int, int> supervisor(int state, int input, uint32_t conditions) {
    if (state < 0 || state >= FL_STATE_COUNT || input < 0 || input >= FL_IN_COUNT)
        throw nb::value_error("no such state or input");
    const fl_verdict_t v =
        fl_supervisor_match(static_cast<fl_state_t>(state), static_cast<fl_input_t>(input), conditions);
    return {int{v.next}, int{v.code}};
}

using Rows = nb::typed<nb::list, nb::typed<nb::dict, nb::str, nb::any>>;

// The dispatcher's own rows; the names, which the firmware has no room for, are those of its list.
Rows command_table() {
    static const char *const names[] = {
#define X(name, number, least, most, flags, input, axes, arg, handler) #name,
        FL_COMMANDS(X)
#undef X
    };
    unsigned n;
    const fl_command_row_t *rows = fl_command_table(&n);
    Rows out;
    for (unsigned i = 0; i < n; ++i) {
        nb::dict d;
        d["number"] = int{rows[i].number};
        d["name"] = names[i];
        d["length"] = nb::make_tuple(int{rows[i].len_min}, int{rows[i].len_max});
        d["broadcast"] = bool(rows[i].flags & FL_CMD_BROADCAST);
        d["bootloader"] = bool(rows[i].flags & FL_CMD_BOOTLOADER);
        d["input"] = int{rows[i].input};
        d["axes"] = int{rows[i].axes};
        out.append(d);
    }
    return out;
}

std::optional<std::tuple<float, float, float, float, float, float>> hall_fit(Input2<uint16_t> adc_cnt) {
    if (adc_cnt.shape(1) != 2) throw nb::value_error("adc_cnt: (n, 2)");
    fl_hall_fit_t fit;
    fl_hall_fit_reset(&fit);
    for (size_t i = 0; i < adc_cnt.shape(0); ++i) fl_hall_fit_range(&fit, adc_cnt.data() + 2 * i);
    for (size_t i = 0; i < adc_cnt.shape(0); ++i) fl_hall_fit_add(&fit, adc_cnt.data() + 2 * i);
    fl_hall_shape_t s;
    if (!fl_hall_fit_solve(&fit, &s)) return std::nullopt;
    return std::tuple(s.offset_cnt[0], s.offset_cnt[1], s.amplitude_cnt[0], s.amplitude_cnt[1], s.phase_rad,
                      s.residual_rad);
}

// Rows of direction (negative or not), rotor_cnt, torque_Nm.
std::optional<std::tuple<float, float, float, float>> friction_fit(Input2<double> rows) {
    if (rows.shape(1) != 3) throw nb::value_error("rows: (n, 3)");
    fl_friction_fit_t fit;
    fl_friction_fit_reset(&fit);
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *r = rows.data() + 3 * i;
        fl_friction_fit_add(&fit, r[0] < 0.0, static_cast<int32_t>(r[1]), static_cast<float>(r[2]));
    }
    fl_friction_t f;
    if (!fl_friction_fit_solve(&fit, &f)) return std::nullopt;
    return std::make_tuple(f.coulomb_Nm, f.spring_Nm, f.cogging_Nm, f.cogging_phase_rad);
}

int params_fault(Params params) {
    const fl_axis_params_t p = params_of(params);
    return fl_params_fault(&p);
}

uint32_t crc32(nb::bytes data) {
    return fl_crc_end(fl_crc_add(FL_CRC_START, data.c_str(), static_cast<uint32_t>(data.size())));
}

nb::dict enumeration(std::initializer_list<std::pair<const char *, int>> items) {
    nb::dict d;
    for (const auto &[name, value] : items) d[name] = value;
    return d;
}

std::optional<bool> subnormals_met() {
#ifdef __SSE__
    constexpr unsigned int operand = 1U << 1, result = 1U << 4; // of MXCSR, kept until they are cleared
    const unsigned int told = _mm_getcsr();
    _mm_setcsr(told & ~(operand | result));
    return (told & (operand | result)) != 0;
#else
    return std::nullopt;
#endif
}

} // namespace

void bind_laws(nb::module_ &m) {
    m.def("sincos", &sine_cosine, nb::arg("angle_cnt"),
          "(n, 2) sine and cosine of motor angles, 2**20 a turn.");
    m.def("atan2_cnt", &atan2_cnt, nb::arg("sin"), nb::arg("cos"));
    m.def("sqrt", &square_root, nb::arg("x"));
    m.def("hall_angle", &hall_angle, nb::arg("params"), nb::arg("adc_cnt"),
          "Unwrapped rotor angle in counts.");
    m.def("commutate", &commutate, nb::arg("voltage"), nb::arg("rotor"), nb::arg("lead_rad") = 0.0f,
          "Duties (n, 3). Eq. 18 and 20.");
    m.def("rotating_field", &rotating_field, nb::arg("u"), nb::arg("field_cnt"), "Duties (n, 3). Eq. 18.");
    m.def("servo", &servo, nb::arg("params"), nb::arg("rows"), nb::arg("settling") = false,
          "Eq. 21 and 22 along rows of command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2.");
    m.def("regulator", &regulator, nb::arg("params"), nb::arg("rows"), nb::arg("zero_cnt") = 0,
          "Law 1 along rows of command_cnt, measured_cnt, speed_rad_s, acceleration_rad_s2: (torque_Nm, "
          "feedforward_Nm, watched_Nm, voltage, load_Nm, gap below the rotor in counts).");
    m.def(
        "touch", &touch, nb::arg("params"), nb::arg("rows"),
        "(rise_Nm, limit_Nm, touched, four coefficients of fl_ripple.h in Nm) along rows of error_rad, "
        "beyond_Nm, excess_Nms, speed_rad_s, direction, acceleration_rad_s2, drag_doubt, touching, sine and "
        "cosine of the rotor, from power-up.");
    m.def("smooth", &smooth, nb::arg("raw_cnt"), nb::arg("start_cnt"));
    m.def("profile", &profile, nb::arg("from_cnt"), nb::arg("to_cnt"), nb::arg("speed_rpm"),
          nb::arg("acceleration_rad_s2"));
    rows_law::bind(m);
    steps_law::bind(m);
    m.def("path", &path, nb::arg("points"), nb::arg("here_cnt"), nb::arg("ticks"),
          nb::arg("landing_cnt") = 0);
    m.def("supervisor", &supervisor, nb::arg("state"), nb::arg("input"), nb::arg("conditions"),
          "(next state, response code)");
    m.def("command_table", &command_table,
          "Rows of number, name, length (least, most), broadcast, bootloader, input, axes.");
    m.def("hall_fit", &hall_fit, nb::arg("adc_cnt"),
          "(offset a, b, amplitude a, b, phase_rad, residual_rad) or None.");
    m.def("friction_fit", &friction_fit, nb::arg("rows"),
          "(coulomb_Nm, spring_Nm, cogging_Nm, cogging_phase_rad) or None, of rows (n, 3) of direction, "
          "rotor_cnt, torque_Nm.");
    m.def("fade", &fl_fade, nb::arg("x"), nb::arg("share"), nb::arg("least"),
          "What is left of x after a tick: never below `least`.");
    m.def("follow", &fl_follow, nb::arg("x"), nb::arg("target"), nb::arg("share"),
          "x a tick on, where it follows the target.");
    m.def("subnormals_met", &subnormals_met,
          "Whether a result or an operand was subnormal on this thread since the last call; None where the "
          "processor does not tell.");
    m.def("round_i32", &fl_round_i32, nb::arg("x"), "Nearest integer, halves away from zero.");
    m.def("params_fault", &params_fault, nb::arg("params"), "Index of the first bad parameter, -1 if none.");
    m.def("crc32", &crc32, nb::arg("data"));
#define X(name) {#name, FL_STATE_##name},
    m.attr("STATES") = enumeration({FL_STATES(X)});
#undef X
#define X(name) {#name, FL_IN_##name},
    m.attr("INPUTS") = enumeration({FL_INPUTS(X)});
#undef X
#define X(name, bit) {#name, FL_IF_##name},
    m.attr("CONDITIONS") = enumeration({FL_CONDITIONS(X)});
#undef X
}
