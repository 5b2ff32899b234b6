// The hardware of many axes without firmware: motors, gears, springs, hall sensors. Duties in, hall
// counts and output angles out. docs/twin.md derives the model.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "fiberloom/twin/axis_group.hpp"
#include "fiberloom/twin/differing.hpp"
#include "fiberloom/twin/plant_params.hpp"
#include "fiberloom/twin/transmission.hpp"

namespace fl::twin {

// One true axis.
struct Unit {
    PlantParams params;
    Transmission transmission;
};

// What may be broken in the hardware of an axis.
struct AxisFaults {
    bool dead = false;    // the bridge gets no supply: the rotor is not driven
    bool blocked = false; // the rotor cannot turn
    bool lying = false;   // rotor and gear turn, the arm does not follow (an open coupling)
    // share of the gear's way that the arm makes, towards larger and smaller angles (a slipping coupling)
    double follows_up = 1.0, follows_down = 1.0;

    bool operator==(const AxisFaults &) const = default;
    // Whether the coupling slips in either direction.
    bool slips() const { return follows_up != 1.0 || follows_down != 1.0; }
};

// Motor angle, momentum of what moves with the rotor, gear angle, output angle.
struct AxisState {
    double theta_rad, momentum_Nms, gear_rad, output_rad;
};

// The hardware of many axes, in groups. An axis is a number below axis_count(); others are not checked for.
class Plant {
  public:
    // Axes rest at output_rad in negative contact. Throws std::invalid_argument that names the axis
    // and what is wrong with it. kernel: a name, or "" for the best of this machine.
    Plant(const std::vector<Unit> &units, const std::vector<double> &output_rad, uint64_t seed,
          const char *kernel = "", Substeps substeps = {});
    Plant(const Plant &) = delete;
    Plant &operator=(const Plant &) = delete;
    Plant(Plant &&) = default;

    // Number of axes.
    size_t axis_count() const { return axes_.size(); }
    // Number of groups.
    size_t group_count() const { return groups_.size(); }
    // Instruction set of the inner loops.
    const char *kernel_name() const { return kernel_->name; }

    // One tick of one group begins with the hall counts. Groups are independent: any thread may run any of
    // them. used: as of Kernel::sense.
    void sense(size_t group, uint32_t tick, uint64_t used = every_lane) {
        kernel_->sense(groups_[group], tick, used);
    }
    // Then, once the duties are set, 0.5 ms of physics.
    void step(size_t group, uint64_t used = every_lane);

    // Memory of all axes together.
    size_t bytes() const;

    // A lane of a group.
    struct Place {
        size_t group;
        int lane;
    };
    // Where an axis is kept: axis 2 i is alpha of positioner i, 2 i + 1 its beta.
    Place place(size_t axis) const {
        const size_t slot = slots_[axis / 2];
        return {slot / lane_group_size,
                static_cast<int>(axis % 2 * lane_group_size + slot % lane_group_size)};
    }
    // The positioners of all lanes, group by group. They stay at the same address.
    const std::vector<uint16_t> &members() const { return members_; }
    // Those of a group, lane by lane.
    std::span<const uint16_t> members(size_t group) const {
        const size_t begin = group * lane_group_size;
        return {members_.data() + begin, std::min<size_t>(lane_group_size, members_.size() - begin)};
    }
    // Others are stepped together from now on: no value of an axis changes by it. members: every positioner
    // once.
    void rearrange(const std::vector<uint16_t> &members);
    // The inner loops.
    const Kernel &kernel() const { return *kernel_; }
    // The lanes of a group.
    AxisGroup &group(size_t index) { return groups_[index]; }
    // The true parameters of an axis.
    PlantParams params(size_t axis) const {
        PlantParams p = axes_[axis].params.with(first_params_[axis % 2]);
        p.seat_rms = axes_[axis].seat.rms_rad;
        return p;
    }
    // One of them.
    double param(size_t axis, double PlantParams::*name) const {
        if (name == &PlantParams::seat_rms) return axes_[axis].seat.rms_rad;
        return axes_[axis].params.field(first_params_[axis % 2], name);
    }
    // Motor angle, rad.
    double motor_rad(size_t axis) const { return lane(axis, &AxisGroup::theta_rad); }
    // Where the gear closes negative contact, motor rad.
    double gear_rad(size_t axis) const { return lane(axis, &AxisGroup::gear_rad); }
    // Motor angle at which the arm touches its lower hard stop.
    double lower_stop_rad(size_t axis) const { return lane(axis, &AxisGroup::stop_lo_rad); }

    // All of it, now.
    AxisState state(size_t axis) const;
    // Puts rotor and gear somewhere: motor rad, N m s, gear rad.
    void set_state(size_t axis, double theta_rad, double momentum_Nms, double gear_rad);
    // Where the arm is, deflected by outside torque, Eq. 5a.
    double output_rad(size_t axis) const;
    // The same without the deflection.
    double output_at_rest_rad(size_t axis) const;
    // The deflection by outside torque and stops, at the output.
    double deflection_rad(size_t axis) const;
    // B where the gear is, motor rad.
    double backlash_rad(size_t axis) const;
    // The most that the output turns for a rad of the motor, anywhere.
    double output_per_motor(size_t axis) const;
    // By how much the teeth may seat off the middle, output rad.
    double seat_limit_rad(size_t axis) const;
    // By how much a rotor would turn in a tick if it went on, and if what moves with it were the rotor alone:
    // it is no faster. Rad.
    double motor_turn_rad(Place at) const {
        const AxisGroup &g = groups_[at.group];
        const float step_rad = g.p_Nms[at.lane] * g.step_per_p_free[at.lane];
        return static_cast<double>(step_rad < 0.0f ? -step_rad : step_rad) * substeps_.all;
    }
    // Deflection of the output for a torque there, Eq. 5a.
    double compliance_rad_per_Nm(size_t axis) const { return 1.0 / param(axis, &PlantParams::stiffness); }

    // From outside, at the output, positive towards positive angles.
    void set_external_torque(size_t axis, double torque_Nm);
    // As last set.
    double external_torque_Nm(size_t axis) const { return axes_[axis].torque_Nm; }
    // As last set.
    const AxisFaults &faults(size_t axis) const { return broken(axis).faults; }
    // Breaks or repairs an axis. An arm whose coupling closes again stays where it is.
    void set_faults(size_t axis, AxisFaults faults);
    // The gear wears: only at rest.
    void set_transmission(size_t axis, const Transmission &transmission);
    // Opens or closes the bridge of an axis. Open, no current flows: the duties do not matter, and there is
    // no drag by the back-EMF. The body diodes of the switches conduct only from an EMF of the supply on, and
    // a rotor that its own bridge has driven by sines stays below it: lambda omega < (sqrt(3)/2) u_dc. Called
    // once a tick while open: beyond that speed, or without supply, an open bridge brakes like a closed one.
    void set_open(size_t axis, bool open) {
        const Bridge bridge = {open, open && !diodes_conduct(axis)};
        if (axes_[axis].bridge != bridge) switch_bridge(axis, bridge);
    }
    // What wears beside the gear: friction, sensors. Only at rest; throws as the constructor does.
    void set_params(size_t axis, const PlantParams &params);

  private:
    // Teeth and grease do not come to lie twice in the same way: a small random walk of the output over
    // the travel of the gear, drawn anew at every node that is passed, straight in between.
    struct Seat {
        double lo_rad = 0.0, hi_rad = 0.0; // at the nodes of the cell
        double rms_rad = 0.0;              // PlantParams::seat_rms: every node asks for it
        uint32_t key = 0, passes = 0;
        uint64_t counter() const { return uint64_t{key} << 32 | passes; } // of the next number
    };
    // Open: no switch conducts, the duties do not count. Floating: no diode does either.
    struct Bridge {
        bool open = false, floats = false;
        bool operator==(const Bridge &) const = default;
    };
    struct Broken {
        AxisFaults faults;
        double slip_rad = 0.0;   // arm against gear, left by an open coupling
        double held_rad = 0.0;   // where the arm is while the coupling is open
        double geared_rad = 0.0; // where the gear had the arm of a slipping coupling
    };
    struct Axis {
        // what a new cell asks for comes first, and most of the rest only with new nodes
        Cell cell;
        NodeBlock block;
        Seat seat;
        Gear gear;
        Differing<PlantParams> params;  // from those of the first axis of its kind, but for the seat's
        std::unique_ptr<Broken> broken; // none: nothing is or was
        Bridge bridge;
        float spring_0_Nm = 0.0f; // of the torsion spring at 0: its parameters lie far from here
        double torque_Nm = 0.0;
    };
    static const Broken whole;
    const Broken &broken(size_t axis) const { return axes_[axis].broken ? *axes_[axis].broken : whole; }
    template <class T> using Field = T (AxisGroup::*)[lane_count];
    AxisGroup &group_of(size_t axis) { return groups_[place(axis).group]; }
    template <class T> double lane(size_t axis, Field<T> f) const {
        return static_cast<double>((groups_[place(axis).group].*f)[place(axis).lane]);
    }
    template <class T> void set(size_t axis, Field<T> f, double value) {
        (group_of(axis).*f)[place(axis).lane] = static_cast<T>(value);
    }

    size_t axis_at(size_t group, size_t lane) const {
        return 2 * size_t{members_[group * lane_group_size + lane % lane_group_size]} +
               lane / lane_group_size;
    }
    void put(size_t axis, double output_rad);
    void keep_params(size_t axis, PlantParams params);
    void configure(size_t axis);
    void configure_drive(size_t axis);
    void switch_bridge(size_t axis, Bridge bridge);
    bool diodes_conduct(size_t axis) const;
    void configure_cogging(size_t axis);
    void configure_gear(size_t axis);
    void configure_stops(size_t axis);
    void configure_hall(size_t axis);
    void load_cell(size_t axis);
    void look_for_stops(size_t axis);
    void fetch(size_t axis) const;
    void fetch_gear(size_t axis) const;
    void seek_cell(size_t axis, double gear_rad);
    void foresee_cells(size_t group, uint64_t lanes);
    void follow_cells(size_t group, uint64_t lanes);
    int32_t follow_cell(size_t axis);
    void follow_seat(size_t axis, int32_t nodes, double bell);
    double next_bell(const Seat &seat) const;
    double stop_torque_Nm(size_t axis) const;
    double geared_rad(size_t axis) const;
    void slip(size_t axis);

    const Kernel *kernel_;
    Substeps substeps_;
    double h_s_;
    std::array<PlantParams, 2> first_params_; // of the first alpha and beta
    std::vector<Axis> axes_;
    std::vector<AxisGroup> groups_;
    std::vector<uint16_t> members_, slots_; // positioners, lane by lane; and where each of them is there
    std::vector<uint64_t> slipping_;        // lanes of each group whose couplings slip
};

} // namespace fl::twin
