"""The motor of the twin against MuJoCo's DC motor actuator: other equations' form, other integrator.

A delta-wound motor commutated at 90 degrees is a DC motor (docs/theory/equations.md, Eq. 19): with lambda
and R of a coil its constant is K = 2 lambda/sqrt(3) and its resistance 8 R/9, for then K/R is the torque
per volt and K^2/R the drag of its back-EMF. The twin's field stands for a tick of 0.5 ms while the rotor
turns; MuJoCo's voltage is multiplied by the cosine of that angle. Torques in uNm and voltages in kV^-1
there, so that an inertia of 3.4e-9 kg m^2 is not lost in its floors; torque per volt is the same either
way.
"""

import numpy as np
import pytest
from mujoco_motor import MICRO, mujoco_with_dcmotor
from units_of import gear_of, nominal, plant

mujoco = mujoco_with_dcmotor()

TICK_S, SUBSTEPS = 5e-4, 20
MOTOR, MOMENTUM = 0, 1

XML = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody><body>
    <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/>
    <joint name="rotor" type="hinge" axis="0 0 1" armature="{armature}" damping="{damping}"
           frictionloss="{friction}" solreffriction="{solref}" solimpfriction="0.9999 0.9999 1e-3"/>
  </body></worldbody>
  <actuator><dcmotor joint="rotor" motorconst="{constant} {constant}" resistance="{resistance}"
                     cogging="{cogging} 2 {phase}"/></actuator>
</mujoco>
"""


def rotor(params, *, pushing):
    """MuJoCo's model of this axis: the rotor alone, or with the gear in contact."""
    p = {name: float(params[name]) for name in params.dtype.names}
    inertia = p["inertia_motor"] + (p["inertia_gear"] if pushing else 0.0)
    step = TICK_S / SUBSTEPS
    return mujoco.MjModel.from_xml_string(
        XML.format(
            step=step,
            armature=inertia * MICRO - 1e-9,
            damping=(p["viscous_motor"] + (p["viscous_gear"] if pushing else 0.0)) * MICRO,
            friction=(p["coulomb_motor"] + (p["coulomb_gear"] if pushing else 0.0)) * MICRO,
            # friction is a soft constraint there: as stiff as the step allows
            solref=f"{2 * step} 1",
            constant=2.0 / np.sqrt(3.0) * p["flux_linkage"] * np.sqrt(MICRO),
            resistance=8.0 / 9.0 * p["coil_resistance"],
            cogging=-p["cogging_2"] * MICRO,  # ours is met as a resistance
            phase=p["cogging_2_phase"],
        )
    )


def run(model, volts, theta, omega=0.0):
    """(ticks, 2) angle and speed at the ends of ticks with these voltages."""
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = theta, omega
    out = []
    for volt in volts:
        start = data.qpos[0]
        for _ in range(SUBSTEPS):
            turned = data.qpos[0] - start + 0.5 * model.opt.timestep * data.qvel[0]  # mid-step
            data.ctrl[0] = volt * np.sqrt(MICRO) * np.cos(turned)
            mujoco.mj_step(model, data)
        out.append((data.qpos[0], data.qvel[0]))
    return np.array(out)


def both(params, shares, *, pushing, theta=0.5):
    """Angle and speed of ours and of MuJoCo's rotor, (ticks, 2) each, for shares of the full voltage."""
    params["pwm_steps"] = 1e6
    ours = plant(params, gear_of(0.0 if pushing else 30000.0), 1.0 if pushing else 0.0)
    if not pushing:
        ours.set_state(0, theta, 0.0, 0.0)
    start = ours.state(0)[MOTOR]
    log = ours.push(np.asarray(shares, float)[:, None])[:, 0]
    inertia = params["inertia_motor"] + (params["inertia_gear"] if pushing else 0.0)
    mine = np.column_stack([log[:, MOTOR], log[:, MOMENTUM] / inertia])
    theirs = run(rotor(params, pushing=pushing), np.asarray(shares) * float(params["supply"]), start)
    return mine, theirs


def test_the_equivalent_dc_motor_has_the_twins_torque_per_volt():
    model = rotor(nominal(cogging_2=0.0), pushing=True)
    data = mujoco.MjData(model)
    data.ctrl[0] = 12.0 * np.sqrt(MICRO)
    mujoco.mj_forward(model, data)
    p = nominal()
    full_uNm = 1.5 * p["flux_linkage"] / p["coil_resistance"] * np.sqrt(0.75) * 12.0 * MICRO
    assert data.actuator_force[0] == pytest.approx(full_uNm, rel=1e-9)
    data.ctrl[0], data.qvel[0] = 0.0, 100.0
    mujoco.mj_forward(model, data)
    drag_uNm = -1.5 * p["flux_linkage"] ** 2 / p["coil_resistance"] * 100.0 * MICRO
    assert data.actuator_force[0] == pytest.approx(drag_uNm, rel=1e-9)


@pytest.mark.parametrize("pushing", [False, True])
def test_step_of_voltage(pushing):
    """Fig. 14: 70, then 490 uNm: inertia, friction, drag and back-EMF in one curve."""
    params = nominal(cogging_2=0.0, cogging_4=0.0, spring_rate=0.0)
    mine, theirs = both(params, [0.14] * 120 + [0.97] * 60, pushing=pushing)
    # MuJoCo is of first order: half its step of 25 us in time, 0.6 % of the time constant
    np.testing.assert_allclose(mine[:, 1], theirs[:, 1], rtol=5e-3, atol=0.5)
    assert mine[-1, 1] > 500.0
    np.testing.assert_allclose(mine[:, 0], theirs[:, 0], rtol=5e-3, atol=0.02)


def test_speeds_in_the_end_agree_to_a_ten_thousandth():
    """Where nothing changes any more the integrators do not matter: torque against drag."""
    params = nominal(cogging_2=0.0, cogging_4=0.0, spring_rate=0.0)
    for share in (0.2, -0.5, 0.9):
        mine, theirs = both(params, [share] * 300, pushing=True)
        # what is left is how MuJoCo's soft friction falls short: 1e-4 of 20 uNm, and its step
        assert mine[-1, 1] == pytest.approx(theirs[-1, 1], rel=3e-4)


def test_coasting_through_cogging():
    """No voltage: shorted coils, bearings and two cogs a turn; the ripple of the speed is the cogging's."""
    params = nominal(cogging_4=0.0, cogging_2_phase=0.7)
    shares = [0.3] * 60 + [0.0] * 60
    mine, theirs = both(params, shares, pushing=False)
    np.testing.assert_allclose(mine[:, 1], theirs[:, 1], rtol=0.02, atol=0.8)
    smooth, _ = both(nominal(cogging_2=0.0, cogging_4=0.0), shares, pushing=False)
    ripple = mine[60:90, 1] - smooth[60:90, 1]
    assert np.abs(ripple).max() > 3.0  # the cogging is there to be seen
    assert np.corrcoef(ripple, theirs[60:90, 1] - smooth[60:90, 1])[0, 1] > 0.98


def test_coasting_without_current():
    """The bridge open: MuJoCo's rotor without its motor, ours with the coils open."""
    params = nominal(cogging_2=0.0, cogging_4=0.0)
    ours = plant(params, gear_of(60000.0), 1.0)
    ours.set_state(0, 500.0, 450.0 * float(params["inertia_motor"]), 0.0)
    mine = []
    for _ in range(60):
        ours.set_open(0, True)
        mine.append(ours.run(np.zeros((1, 1, 3)))[0][0, 0, MOMENTUM] / params["inertia_motor"])
    params["flux_linkage"] *= 1e-6  # no coil
    theirs = run(rotor(params, pushing=False), [0.0] * 60, 500.0, 450.0)
    np.testing.assert_allclose(mine, theirs[:, 1], rtol=1e-3)


def test_friction_holds_a_rotor_in_both():
    """Below break-away nothing turns: ours to the bit, MuJoCo's soft friction creeps a little."""
    params = nominal(cogging_2=0.0, cogging_4=0.0, spring_rate=0.0)
    full = 1.5 * params["flux_linkage"] / params["coil_resistance"] * np.sqrt(0.75) * params["supply"]
    hold = 0.9 * (params["coulomb_motor"] + params["coulomb_gear"]) / full
    mine, theirs = both(params, [hold] * 100, pushing=True)
    assert (mine[:, 0] == mine[0, 0]).all()
    assert np.abs(theirs[-1, 0] - theirs[0, 0]) < np.deg2rad(0.5)
