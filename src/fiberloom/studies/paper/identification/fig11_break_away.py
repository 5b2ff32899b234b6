"""Fig. 11: break-away torque over one motor turn, in both directions."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.calibration import BreakAway, break_away
from fiberloom.studies.paper.identification.identified import UNITS, Identified, each_seed
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, ordering, quantity

ALPHA = 0
PLACE = 2
"""Of the five output angles: the middle of the range."""
ORDERS = range(1, 7)


def curves(found: Identified) -> list[BreakAway]:
    """Alpha's curves in the middle of the range, one per unit."""
    friction, data, scale = found.friction[ALPHA], found.friction_data[ALPHA], found.scale[ALPHA]
    return [break_away(data, friction, scale, row)[PLACE] for row in range(UNITS)]


def strongest_order(curve: BreakAway) -> int:
    """Cycles per motor turn that explain most of the curves about their means."""
    power = np.zeros(len(ORDERS))
    for rotor_deg, torque in zip(curve.rotor_deg, curve.torque_uNm, strict=True):
        for k, order in enumerate(ORDERS):
            turn = np.deg2rad(rotor_deg) * order
            design = np.stack([np.ones_like(turn), np.sin(turn), np.cos(turn)], axis=1)
            power[k] -= float(np.linalg.lstsq(design, torque, rcond=None)[1][0])
    return ORDERS[int(np.argmax(power))]


def asymmetry(curve: BreakAway) -> float:
    """Ratio of the mean torque needed in the negative direction to that in the positive one."""
    plus, minus = curve.spring_uNm + curve.coulomb_uNm, curve.spring_uNm - curve.coulomb_uNm
    return abs(minus / plus)


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's double sinusoid that asks for more in the negative direction."""
    found = each_seed(settings, 11)
    return FigureOutcome(
        quantities=_quantities(found),
        drawings=[_draw(curves(found[0])[0])],
        how=(
            f"{UNITS} units per seed. The motors creep over a turn in both directions at five output angles "
            "while the firmware records voltage and angle; torques are scaled by weights on the arms (half "
            "of Fig. 13's). The paper raises the torque until the rotor starts; creeping shows the same "
            "torque, drag taken off."
        ),
        beyond=["All of it over the bus, without opening the positioner: `fiberloom calibrate friction`."],
    )


def _quantities(found: list[Identified]) -> list[Quantity]:
    each = [curves(f) for f in found]
    coulomb = [
        f.friction[ALPHA].coulomb.value * 1e-6 / f.bench.units.plant["coulomb_gear"][:, ALPHA] for f in found
    ]
    return [
        quantity(
            "fig11.cycles_per_turn",
            "cycles of cogging in a motor turn",
            [float(np.mean([strongest_order(c) for c in some])) for some in each],
            "1",
            Kind.PUT_IN,
            paper=2.0,
            note="strongest of 1 to 6 cycles in the recorded curves",
        ),
        quantity(
            "fig11.asymmetry",
            "torque in the negative direction over that in the positive one, mid range",
            [float(np.mean([asymmetry(c) for c in some])) for some in each],
            "1",
            Kind.PUT_IN,
            note="the paper prints no number",
        ),
        ordering(
            "fig11.order.negative_needs_more",
            "more torque is needed in the negative direction, against the spring",
            [all(asymmetry(c) > 1.0 for c in some) for some in each],
            Kind.PUT_IN,
            note="of every unit; the spring is put in",
        ),
        quantity(
            "fig11.coulomb_uNm",
            "Coulomb friction by Eq. 11, alpha",
            [float(np.mean([c.coulomb_uNm for c in some])) for some in each],
            "uNm",
            Kind.PUT_IN,
            note="20 uNm derived from Fig. 12 and 14",
        ),
        quantity(
            "fig11.coulomb_over_gear",
            "identified Coulomb friction over the gear's true one",
            [float(np.mean(share)) for share in coulomb],
            "1",
            beyond=True,
            note="what Eq. 9 calls Coulomb friction is the gear's less what its load helps, and the rotor's "
            "own",
        ),
    ]


def _draw(curve: BreakAway) -> Drawing:
    canvas, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    labels = ("positive direction", "negative direction")
    for rotor_deg, torque, label in zip(curve.rotor_deg, curve.torque_uNm, labels, strict=True):
        order = np.argsort(rotor_deg)
        axes.plot(rotor_deg[order], np.abs(torque[order]), ".-", linewidth=0.8, markersize=3, label=label)
    axes.set(
        xlabel="motor angle [deg]",
        ylabel="|break-away torque| [µNm]",
        xlim=(0, 360),
        xticks=range(0, 361, 45),
    )
    axes.legend(fontsize=8)
    axes.grid(True, alpha=0.3)
    return drawing(
        "break_away", "Alpha motor of one unit, one motor turn in the middle of the range.", canvas
    )
