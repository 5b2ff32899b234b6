// The firmware's C as a Python module: parameters, the identifier codec, one positioner on a bench.
#include "bind.hpp"

#include <algorithm>
#include <cstddef>

#include "bench_positioner.hpp"
#include "bind_laws.hpp"

extern "C" {
#include "fl_codes.h"
#include "fl_identifier.h"
#include "fl_status.h"
}

namespace {

struct ParamInfo {
    const char *name, *unit;
    double min, max, def;
    const char *doc;
};

constexpr ParamInfo param_infos[] = {
#define X(name, unit, min, max, def, doc) {#name, unit, min, max, def, doc},
    FL_AXIS_PARAMS(X)
#undef X
};
constexpr size_t param_count = sizeof param_infos / sizeof *param_infos;
static_assert(sizeof(fl_axis_params_t) == param_count * sizeof(float));

nb::list param_list() {
    nb::list out;
    for (const auto &p : param_infos) out.append(nb::make_tuple(p.name, p.unit, p.min, p.max, p.def, p.doc));
    return out;
}

// The protocol as the firmware has it: what the host's enumerations are compared with.

nb::list code_list() {
    nb::list out;
#define X(name, number) out.append(nb::make_tuple(number, #name));
    FL_CODES(X)
#undef X
    return out;
}

nb::list status_list() {
    nb::list out;
#define X(name, bit) out.append(nb::make_tuple(bit, #name));
    FL_STATUS_BITS(X)
#undef X
    return out;
}

uint32_t encode(int positioner, int command, int uid, int code) {
    const auto check = [](const char *name, int value, int max) {
        if (value >= 0 && value <= max) return;
        throw nb::value_error((std::string(name) + " must be 0.." + std::to_string(max)).c_str());
    };
    check("positioner", positioner, FL_ID_POSITIONER_MAX);
    check("command", command, FL_ID_COMMAND_MAX);
    check("uid", uid, FL_ID_UID_MAX);
    check("code", code, FL_ID_CODE_MAX);
    return fl_identifier_pack({static_cast<uint16_t>(positioner), static_cast<uint8_t>(command),
                               static_cast<uint8_t>(uid), static_cast<uint8_t>(code)});
}

std::tuple<int, int, int, int> decode(uint32_t id) {
    if (id >> 29) throw nb::value_error("identifier has more than 29 bits");
    const fl_identifier_t f = fl_identifier_unpack(id);
    return {int{f.positioner}, int{f.command}, int{f.uid}, int{f.code}};
}

using Bench = fl::BenchPositioner;
using ParamRow = Input<float, static_cast<nb::ssize_t>(param_count)>;
using ParamRows = Input<float, FL_AXES, static_cast<nb::ssize_t>(param_count)>;

fl_axis_params_t params_row(const ParamRows &rows, size_t axis) {
    fl_axis_params_t p;
    std::copy_n(rows.data() + axis * param_count, param_count, reinterpret_cast<float *>(&p));
    return p;
}

size_t axis_index(int axis) {
    if (axis < 0 || axis >= FL_AXES) throw nb::index_error("axis must be 0 (alpha) or 1 (beta)");
    return static_cast<size_t>(axis);
}

void bench_init(Bench *b, int id, ParamRows rows) {
    if (id < 1 || id > FL_ID_POSITIONER_MAX) throw nb::value_error("id must be 1..2047");
    const fl_axis_params_t params[FL_AXES] = {params_row(rows, 0), params_row(rows, 1)};
    new (b) Bench(static_cast<uint16_t>(id), params);
}

void bench_receive(Bench &b, uint32_t id, nb::bytes data) {
    if (data.size() > 8) throw nb::value_error("a frame holds at most 8 bytes");
    b.receive(id, reinterpret_cast<const uint8_t *>(data.c_str()), data.size());
}

using Frames = nb::typed<nb::list, std::tuple<uint32_t, nb::bytes>>;

Frames bench_take_frames(Bench &b) {
    Frames out;
    for (const auto &f : b.sent) out.append(nb::make_tuple(f.id, nb::bytes(f.data.data(), f.data.size())));
    b.sent.clear();
    return out;
}

// Ticks n times; rows of time-ordered telemetry of one axis.
constexpr size_t columns = 8;

Output<double, -1, columns> bench_run(Bench &b, int n, int axis) {
    const size_t a = axis_index(axis);
    auto log = new_array<double, -1, columns>({static_cast<size_t>(std::max(n, 0)), columns});
    for (int i = 0; i < n; ++i) {
        b.tick();
        const fl_axis_telemetry_t t = fl_positioner_telemetry(&b.firmware, axis);
        const auto &p = b.plant[a];
        const double row[columns] = {t.command_deg,    t.tracking_deg, t.speed_rad_s, t.feedback_Nm,
                                     t.feedforward_Nm, t.voltage,      p.theta_rad,   p.omega_rad_s};
        std::copy_n(row, columns, log.data() + i * columns);
    }
    return log;
}

double *plant_field(Bench &b, int axis, const std::string &name) {
    auto &p = b.plant[axis_index(axis)];
    const std::pair<const char *, double *> fields[] = {
        {"inertia", &p.inertia},
        {"drag", &p.drag},
        {"back_emf", &p.back_emf},
        {"coulomb", &p.coulomb},
        {"spring_torque", &p.spring_torque},
        {"spring_rate", &p.spring_rate},
        {"cogging_torque", &p.cogging_torque},
        {"cogging_phase", &p.cogging_phase},
        {"torque_per_volt", &p.torque_per_volt},
        {"u_dc", &p.u_dc},
        {"stop_rad", &p.stop_rad},
        {"blocked", &p.blocked},
        {"external_torque", &p.external_torque},
        {"theta_rad", &p.theta_rad},
        {"omega_rad_s", &p.omega_rad_s},
    };
    for (const auto &[key, value] : fields)
        if (name == key) return value;
    throw nb::key_error(("the bench plant has no " + name).c_str());
}

void bench_forget(Bench &b, int axis, bool hall, bool datum) {
    const auto mask = static_cast<uint8_t>(~(1u << axis_index(axis)));
    if (hall) b.firmware.hall_calibrated &= mask;
    if (datum) b.firmware.axis[axis].datum_calibrated = false;
}

Output<float, -1> bench_params(const Bench &b, int axis) {
    auto out = new_array<float, -1>({param_count});
    std::copy_n(reinterpret_cast<const float *>(&b.firmware.params[axis_index(axis)]), param_count,
                out.data());
    return out;
}

bool bench_set_params(Bench &b, int axis, ParamRow row) {
    fl_axis_params_t p;
    std::copy_n(row.data(), param_count, reinterpret_cast<float *>(&p));
    axis_index(axis);
    return fl_positioner_set_params(&b.firmware, axis, &p);
}

std::tuple<float, float, float> bench_duty(const Bench &b, int axis) {
    const auto &d = b.plant[axis_index(axis)].duty;
    return {d[0], d[1], d[2]};
}

void bind_bench_firmware(nb::class_<Bench> &bench) {
    bench
        .def("__init__", &bench_init, nb::arg("id"), nb::arg("params"),
             "params: (2, len(AXIS_PARAMS)) float32, alpha and beta.")
        .def("power_up", &Bench::power_up, "As after switching on: only the storage is kept.")
        .def("receive", &bench_receive, nb::arg("id"), nb::arg("data") = nb::bytes("", 0))
        .def("take_frames", &bench_take_frames, "Frames sent since the last call: (id, data).")
        .def(
            "tick",
            [](Bench &b, int n) {
                for (int i = 0; i < n; ++i) b.tick();
            },
            nb::arg("n") = 1)
        .def("run", &bench_run, nb::arg("n"), nb::arg("axis"),
             "n ticks; rows of command_deg, tracking_deg, speed_rad_s, feedback_Nm, feedforward_Nm, "
             "voltage, theta_rad, omega_rad_s (the last two are the plant's).")
        .def("declare_position", &Bench::declare_position, "Tells the firmware where the rotors are.")
        .def(
            "set_position",
            [](Bench &b, int32_t alpha, int32_t beta) {
                const int32_t p[FL_AXES] = {alpha, beta};
                fl_positioner_set_position(&b.firmware, p);
            },
            nb::arg("alpha"), nb::arg("beta"))
        .def("enter_bootloader", [](Bench &b) { fl_positioner_enter_bootloader(&b.firmware); })
        .def("forget_calibration", &bench_forget, nb::arg("axis"), nb::arg("hall") = false,
             nb::arg("datum") = false, "As on a unit that was never calibrated.")
        .def("params", &bench_params, nb::arg("axis"))
        .def("set_params", &bench_set_params, nb::arg("axis"), nb::arg("row"),
             "The firmware's parameters, not the bench's sensors.")
        .def("sync", [](Bench &b) { fl_positioner_sync(&b.firmware); })
        .def("at_rest", [](const Bench &b) { return fl_positioner_at_rest(&b.firmware); })
        .def("skip", [](Bench &b, uint32_t n) { fl_positioner_skip(&b.firmware, n); }, nb::arg("n"));
}

void bind_bench_hardware(nb::class_<Bench> &bench) {
    bench
        .def(
            "plant", [](Bench &b, int axis, const std::string &name) { return *plant_field(b, axis, name); },
            nb::arg("axis"), nb::arg("name"), "A number of the bench's plant; KeyError if it has no such.")
        .def(
            "set_plant",
            [](Bench &b, int axis, const std::string &name, double value) {
                *plant_field(b, axis, name) = value;
            },
            nb::arg("axis"), nb::arg("name"), nb::arg("value"))
        .def(
            "set_hall", [](Bench &b, int axis, uint16_t a, uint16_t c) { b.hall[axis_index(axis)] = {a, c}; },
            nb::arg("axis"), nb::arg("a_cnt"), nb::arg("b_cnt"))
        .def("duty", &bench_duty, nb::arg("axis"))
        .def_rw("driven", &Bench::driven)
        .def_rw("mailbox_open", &Bench::mailbox_open)
        .def_rw("opens", &Bench::opens)
        .def(
            "is_open", [](const Bench &b, int axis) { return b.plant[axis_index(axis)].open; },
            nb::arg("axis"), "Whether the bridge of the axis is open.")
        .def_rw("hall_noise_cnt", &Bench::hall_noise_cnt)
        .def_rw("write_budget", &Bench::write_budget)
        .def_prop_rw(
            "storage", [](const Bench &b) { return nb::bytes(b.storage.data(), b.storage.size()); },
            [](Bench &b, nb::bytes s) { b.storage.assign(s.c_str(), s.c_str() + s.size()); })
        .def_prop_ro("status", [](const Bench &b) { return b.firmware.status; })
        .def_prop_ro("state", [](const Bench &b) { return int{b.firmware.state}; })
        .def_prop_ro("position_cnt",
                     [](const Bench &b) {
                         return std::pair(fl_positioner_position(&b.firmware, 0),
                                          fl_positioner_position(&b.firmware, 1));
                     })
        .def_prop_ro("memory", [](const Bench &b) {
            return nb::bytes(reinterpret_cast<const char *>(&b.firmware), sizeof b.firmware);
        });
}

} // namespace

void bind_firmware(nb::module_ &parent) {
    nb::module_ m = parent.def_submodule("firmware", "The positioner's firmware, compiled for the host.");
    m.attr("AXIS_PARAMS") = param_list();
    m.attr("SIZEOF_POSITIONER") = sizeof(fl_positioner_t);
    m.attr("TX_QUEUE") = nb::make_tuple(offsetof(fl_positioner_t, tx), sizeof(fl_outbox_t));
    m.attr("HEARD_TICK") =
        nb::make_tuple(offsetof(fl_positioner_t, heard_tick), sizeof(fl_positioner_t::heard_tick));
    m.attr("CODES") = code_list();         // (number, name)
    m.attr("STATUS_BITS") = status_list(); // (bit, name)
    m.attr("TICK_HZ") = FL_TICK_HZ;
    m.attr("PATH_POINTS") = FL_PATH_POINTS;
    m.def("encode_identifier", &encode, nb::arg("positioner"), nb::arg("command"), nb::arg("uid") = 0,
          nb::arg("code") = 0);
    m.def("decode_identifier", &decode, nb::arg("id"), "(positioner, command, uid, code)");
    bind_laws(m);
    nb::class_<Bench> bench(m, "Positioner",
                            "One positioner on a bench, for tests: firmware, port, small plants.");
    bind_bench_firmware(bench);
    bind_bench_hardware(bench);
}
