// The plant alone, for tests and identification studies.
#include <cmath>

#include "twin_rows.hpp"

namespace {

using namespace fl::twin;

using ParamInfo = std::tuple<std::string, std::string, double, double, double, std::string>;

std::vector<ParamInfo> plant_params() {
    std::vector<ParamInfo> out;
    for (const PlantParamInfo &p : plant_param_infos)
        out.emplace_back(p.name, p.unit, p.min, p.max, p.def, p.doc);
    return out;
}

std::vector<std::string> kernel_list() {
    std::vector<std::string> out;
    for (const Kernel *const *k = kernels(); *k != nullptr; ++k) out.emplace_back((*k)->name);
    return out;
}

struct TestPlant {
    Plant plant;
    uint32_t tick = 0;
};

TestPlant new_plant(Doubles plant, Doubles transmission, Input1<double> output_rad, uint64_t seed,
                    const std::string &kernel, const SubstepsArgument &substeps) {
    const std::vector<double> start(output_rad.data(), output_rad.data() + output_rad.size());
    return {Plant(units_of(plant, transmission), start, seed, kernel.c_str(), substeps_of(substeps))};
}

size_t known(const TestPlant &p, size_t axis) {
    if (axis >= p.plant.axis_count()) throw nb::index_error("no such axis");
    return axis;
}

void set_duty(Plant &plant, const double *duty) {
    for (size_t i = 0; i < plant.axis_count(); ++i)
        for (size_t k = 0; k < 3; ++k)
            plant.group(plant.place(i).group).duty[k][plant.place(i).lane] =
                static_cast<float>(duty[3 * i + k]);
}

void write_row(Plant &plant, double *row, int32_t *hall) {
    for (size_t i = 0; i < plant.axis_count(); ++i) {
        const AxisState s = plant.state(i);
        const double values[4] = {s.theta_rad, s.momentum_Nms, s.gear_rad, s.output_rad};
        std::copy(values, values + 4, row + 4 * i);
        for (size_t k = 0; k < 2; ++k)
            hall[2 * i + k] = plant.group(plant.place(i).group).hall_cnt[k][plant.place(i).lane];
    }
}

void plant_ticks(TestPlant &p, const double *duty, size_t ticks, double *log, int32_t *hall) {
    const size_t n = p.plant.axis_count();
    for (size_t t = 0; t < ticks; ++t, ++p.tick) {
        set_duty(p.plant, duty + t * n * 3);
        for (size_t g = 0; g < p.plant.group_count(); ++g) {
            p.plant.sense(g, p.tick);
            p.plant.step(g);
        }
        write_row(p.plant, log + t * n * 4, hall + t * n * 2);
    }
}

// Motor rad, momentum N m s, gear rad, output rad.
using History = Output<double, -1, -1, 4>;
using HallCounts = Output<int32_t, -1, -1, 2>;

std::pair<History, HallCounts> plant_run(TestPlant &p, const Input<double, -1, -1, -1> &duty) {
    const size_t n = p.plant.axis_count(), ticks = duty.shape(0);
    if (duty.shape(1) != n || duty.shape(2) != 3) throw nb::value_error("duty: (ticks, axes, 3)");
    auto log = new_array<double, -1, -1, 4>({ticks, n, 4});
    auto hall = new_array<int32_t, -1, -1, 2>({ticks, n, 2});
    {
        nb::gil_scoped_release free;
        plant_ticks(p, duty.data(), ticks, log.data(), hall.data());
    }
    return {log, hall};
}

// Field-oriented drive for tests without firmware: Eq. 18 and 20 from the true angle, torque linear in time.
void drive_torque(Plant &plant, const double *torque_fraction) {
    constexpr double third = 2.0943951023931953;
    for (size_t i = 0; i < plant.axis_count(); ++i) {
        const double u = torque_fraction[i];
        const double field = plant.motor_rad(i) + (u < 0.0 ? -1.5707963267948966 : 1.5707963267948966);
        const double phase[3] = {field + third, field - third, field};
        for (size_t k = 0; k < 3; ++k)
            plant.group(plant.place(i).group).duty[k][plant.place(i).lane] =
                static_cast<float>(0.5 * std::abs(u) * (1.0 + std::cos(phase[k])));
    }
}

History plant_push(TestPlant &p, const Input2<double> &torque_fraction) {
    const size_t n = p.plant.axis_count(), ticks = torque_fraction.shape(0);
    if (torque_fraction.shape(1) != n) throw nb::value_error("torque_fraction: (ticks, axes)");
    auto log = new_array<double, -1, -1, 4>({ticks, n, 4});
    std::vector<int32_t> hall(2 * n);
    for (size_t t = 0; t < ticks; ++t, ++p.tick) {
        drive_torque(p.plant, torque_fraction.data() + t * n);
        for (size_t g = 0; g < p.plant.group_count(); ++g) p.plant.sense(g, p.tick), p.plant.step(g);
        write_row(p.plant, log.data() + t * n * 4, hall.data());
    }
    return log;
}

// Group by group, so that what is stepped stays in the cache: what the plant alone costs.
void plant_advance(TestPlant &p, uint32_t ticks) {
    nb::gil_scoped_release free;
    for (size_t g = 0; g < p.plant.group_count(); ++g)
        for (uint32_t t = 0; t < ticks; ++t) p.plant.sense(g, p.tick + t), p.plant.step(g);
    p.tick += ticks;
}

void bind_test_plant(nb::module_ &m) {
    nb::class_<TestPlant>(m, "Plant", "Motors, gears and hall sensors of n axes, without firmware.")
        .def(nb::new_(&new_plant), nb::arg("plant"), nb::arg("transmission"), nb::arg("output_rad"),
             nb::arg("seed") = 0, nb::arg("kernel") = "", nb::arg("substeps") = 10,
             "plant (n, len(PLANT_PARAMS)), transmission (n, TRANSMISSION_SIZE), output_rad (n,); substeps a "
             "tick, or a pair: of any axis, and of one that pushes its gear all the time. ValueError names "
             "what is "
             "wrong with which axis.")
        .def("run", &plant_run, nb::arg("duty"),
             "One tick for each row of duties (ticks, n, 3). Returns (ticks, n, 4): motor rad, momentum N m "
             "s, "
             "gear rad, output rad after each tick; and hall counts (ticks, n, 2) at its start.")
        .def("push", &plant_push, nb::arg("torque_fraction"),
             "Drives at 90 deg to the true rotor, Eq. 20, with a share [-1, 1] of the supply (ticks, n).")
        .def("advance", &plant_advance, nb::arg("ticks"), "Ticks with the duties as they are, without a log.")
        .def(
            "state",
            [](TestPlant &p, size_t axis) {
                const AxisState s = p.plant.state(known(p, axis));
                return std::make_tuple(s.theta_rad, s.momentum_Nms, s.gear_rad, s.output_rad);
            },
            nb::arg("axis"), "Motor rad, momentum N m s, gear rad, output rad.")
        .def(
            "set_state",
            [](TestPlant &p, size_t axis, double theta_rad, double momentum_Nms, double gear_rad) {
                p.plant.set_state(known(p, axis), theta_rad, momentum_Nms, gear_rad);
            },
            nb::arg("axis"), nb::arg("theta_rad"), nb::arg("momentum_Nms"), nb::arg("gear_rad"))
        .def(
            "set_external_torque",
            [](TestPlant &p, size_t axis, double torque_Nm) {
                p.plant.set_external_torque(known(p, axis), torque_Nm);
            },
            nb::arg("axis"), nb::arg("torque_Nm"), "At the output, positive towards positive angles.")
        .def(
            "set_open", [](TestPlant &p, size_t axis, bool open) { p.plant.set_open(known(p, axis), open); },
            nb::arg("axis"), nb::arg("open"), "Opens or closes the bridge; once a tick while it is open.")
        .def(
            "backlash_rad", [](TestPlant &p, size_t axis) { return p.plant.backlash_rad(known(p, axis)); },
            nb::arg("axis"), "Where the gear is, motor rad.")
        .def(
            "speed_bound",
            [](TestPlant &p, size_t axis) {
                const SpeedBound bound = speed_bound(p.plant.params(known(p, axis)));
                return std::pair(bound.limit_rad_s, bound.time_constant_s);
            },
            nb::arg("axis"),
            "Of the rotor: limit in rad/s that none exceeds, time constant of the way there in s.")
        .def_prop_ro("kernel", [](TestPlant &p) { return p.plant.kernel_name(); });
}

// Truth of the transmission at any output angles: gear angle T- and backlash, both motor rad.
std::pair<Output<double, -1>, Output<double, -1>>
evaluate_transmission(const Input1<double> &row, double gear_ratio, const Input1<double> &output_rad) {
    const Gear gear(transmission_of(row));
    auto gear_rad = new_array<double, -1>({output_rad.size()});
    auto backlash = new_array<double, -1>({output_rad.size()});
    for (size_t i = 0; i < output_rad.size(); ++i) {
        const Cell cell = cell_of_output(gear, gear_ratio, output_rad.data()[i]);
        gear_rad.data()[i] = gear_of_output(cell, output_rad.data()[i]);
        backlash.data()[i] = cell.backlash().at(gear_rad.data()[i]);
    }
    return {gear_rad, backlash};
}

} // namespace

void bind_plant(nb::module_ &m) {
    m.attr("PLANT_PARAMS") = plant_params();
    m.attr("KERNELS") = kernel_list();
    m.attr("HARMONIC_ORDERS") = nb::cast(std::vector<int>(harmonic_orders.begin(), harmonic_orders.end()));
    m.attr("WEAR_COUNT") = wear_count;
    m.attr("TRANSMISSION_SIZE") = transmission_doubles;
    m.attr("NODES_PER_TURN") = nodes_per_turn;
    m.def("transmission", &evaluate_transmission, nb::arg("transmission"), nb::arg("gear_ratio"),
          nb::arg("output_rad"), "Gear angle T- and backlash B, motor rad, at output angles.");
    m.def(
        "output_per_motor",
        [](const Input1<double> &row, double gear_ratio) {
            return output_per_motor(Gear(transmission_of(row)), gear_ratio);
        },
        nb::arg("transmission"), nb::arg("gear_ratio"),
        "The most that the output turns for a rad of the motor.");
    bind_test_plant(m);
}
