"""Section 2: the rules of the design, by the project's own design tools."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.design.coverage import best_pattern, coverage, covers
from fiberloom.design.gear import MOTOR_ERROR_DEG, least_ratio, output_deg
from fiberloom.design.lattice import Lattice
from fiberloom.design.spring import spring_window
from fiberloom.instruments import AXES
from fiberloom.instruments.model import METROLOGY
from fiberloom.studies.paper.bench import L_BETA_MM, paper_instrument
from fiberloom.studies.paper.focal_plane.table01_rows import TABLE_1, Row
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, ordering, quantity
from fiberloom.units import GEAR, UM_PER_MM

OUTPUT_DEG = 0.01
"""Output accuracy of the paper's example."""
CORE_UM = {"sdssv": 120.0, "desi": 107.0, "cobra": 127.0}
"""Diameters of light-transmissive cores; coordio, desimodel, the PFS web site."""
APOGEE = (3, 5)
"""SDSS-V: 300 of 500 positioners."""
FOLDED_MM = (("alpha", 7.6, 7.7), ("beta", 15.0, 3.9))
"""Axis, lever, and the motor angle that moves the fibre by 1 um, deg (Kronig 2020, Section 4)."""


def run(settings: Settings) -> FigureOutcome:
    """The paper's rules, each tried on the instruments of Table 1."""
    settings.say("Section 2: rules of the design")
    return FigureOutcome(
        quantities=[*_ratio(), *_accuracy(), *_coverage(settings.seed), *_spring(settings.seed)],
        drawings=[_draw()],
        how=(
            "Put in: arms, pitch and requirement of Table 1, the diameter of three fibres, springs and "
            "friction of the twin's units (Fig. 11 and 12). The rules are those of `fiberloom design`; holes "
            "are looked for exactly, in an endless lattice of equal units."
        ),
        beyond=["Holes of micrometres, the best pattern for a second kind of fibre, springs of 500 units."],
    )


def lattice_of(row: Row) -> Lattice:
    """Of a `row` of Table 1; both axes turn freely."""
    return Lattice(row.l_alpha_mm, row.l_beta_mm, row.pitch_mm)


def _ratio() -> list[Quantity]:
    lever_mm = TABLE_1[3].reach_mm
    asked_um = UM_PER_MM * lever_mm * float(np.deg2rad(OUTPUT_DEG))
    needed = ", ".join(f"{row.name} {least_ratio(row.requirement_um, row.reach_mm)}" for row in TABLE_1)
    found = [
        quantity(
            "section2.ratio",
            f"reduction ratio for a motor off by {MOTOR_ERROR_DEG:g} deg and an output of {OUTPUT_DEG:g} deg",
            float(least_ratio(asked_um, lever_mm)),
            "1",
            Kind.IDENTITY,
            paper=500.0,
            note=f"least for each requirement: {needed}",
        )
    ]
    for axis, lever, paper in FOLDED_MM:
        found.append(
            quantity(
                f"section2.motor_deg_{axis}",
                f"motor angle of {axis} that moves the fibre by 1 um at {lever:g} mm",
                GEAR * output_deg(1.0, lever),
                "deg",
                Kind.IDENTITY,
                paper=paper,
            )
        )
    return found


def _accuracy() -> list[Quantity]:
    rows = {row.key: row for row in TABLE_1}
    shares = {key: rows[key].requirement_um / core_um for key, core_um in CORE_UM.items()}
    told = ", ".join(f"{rows[key].name} {100.0 * share:.1f} %" for key, share in shares.items())
    return [
        quantity(
            "section2.requirement_of_core",
            "requirement over the diameter of the core",
            100.0 * float(np.mean(list(shares.values()))),
            "%",
            Kind.PUT_IN,
            paper=4.0,
            note=f"the paper: around 4 %; {told}",
        ),
        quantity(
            "section2.sensor_deg",
            "resolution that a sensor at the output of beta would need",
            output_deg(rows["sdssv"].requirement_um, L_BETA_MM),
            "deg",
            Kind.PUT_IN,
            paper=0.02,
            note="the paper: about 0.02 deg, in an actuator of 4 to 6 mm; ours is SDSS-V's requirement at "
            f"{L_BETA_MM:g} mm, alpha stretched needs {output_deg(5.0, rows['sdssv'].reach_mm):.4f} deg",
        ),
    ]


def _coverage(seed: int) -> list[Quantity]:
    equal = [row for row in TABLE_1 if row.l_alpha_mm == row.l_beta_mm]
    reaching = [row for row in TABLE_1 if abs(row.pitch_mm - row.reach_mm) < 1e-9]
    holes = {row.name: coverage(lattice_of(row), n=1000).hole_um for row in equal}
    whole = {row.name: covers(lattice_of(row)) for row in equal}
    lattice = Lattice.of(paper_instrument(), METROLOGY)
    second = coverage(lattice, best_pattern(lattice, *APOGEE, seed), seed=seed)
    return [
        ordering(
            "section2.order.equal_arms_cover",
            "equal arms cover the whole plane",
            list(whole.values()),
            Kind.IDENTITY,
            note="a condition is missing: a reach of p/sqrt(3), the point amid three units; holes: "
            + ", ".join(f"{name} {um:.1f} um" for name, um in holes.items()),
        ),
        ordering(
            "section2.order.pitch_of_both_arms_covers",
            "p = l_a + l_b covers the whole plane",
            [covers(lattice_of(row)) for row in reaching],
            Kind.IDENTITY,
            note=f"{', '.join(row.name for row in reaching)}, with the lengths of Table 1",
        ),
        quantity(
            "section2.apogee.covered",
            "share of the plane reached by fibres of 300 of 500 positioners, best pattern of 3 in 5",
            float(second.at_least[1]),
            "1",
            Kind.IDENTITY,
            note="the paper: almost full coverage for either kind of fibre, no number",
        ),
    ]


def _spring(seed: int) -> list[Quantity]:
    found = []
    for axis, name in enumerate(AXES):
        window = spring_window(paper_instrument(), axis, factor=1.0, seed=seed)
        found.append(
            ordering(
                f"section2.order.spring_{name}",
                f"spring of {name}: above outside torques and, with them, below the friction of the gear",
                ((window.closes > 1.0) & (window.holds > 1.0)).tolist(),
                note=f"500 units of the twin, {window.load_mNm:g} mNm of gravity assumed; medians: closes by "
                f"{float(np.median(window.closes)):.2f}, holds by {float(np.median(window.holds)):.2f}",
                beyond=True,
            )
        )
    return found


def _draw() -> Drawing:
    """By how much the six reach farther than they need to cover the plane."""
    canvas, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    for k, row in enumerate(TABLE_1):
        beyond_um = UM_PER_MM * (row.reach_mm - _needed_mm(row))
        colour = "tab:blue" if covers(lattice_of(row)) else "crimson"
        axes.barh(k, beyond_um, color=colour)
        axes.plot(beyond_um, k, "o", color=colour)
        axes.annotate(f"{beyond_um:.1f}", (beyond_um, k), (6, 6), textcoords="offset points", fontsize=8)
    axes.set_yticks(range(len(TABLE_1)), [row.name for row in TABLE_1])
    axes.set_xscale("symlog", linthresh=1.0)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set(
        xlabel="reach beyond what covers the plane [um]", xlim=(-20.0, 1e4), ylim=(-0.6, len(TABLE_1) - 0.2)
    )
    caption = (
        "Equal arms need a reach of p/sqrt(3), unequal ones p, to the centre of a neighbour; red: holes."
    )
    return drawing("coverage_rules", caption, canvas)


def _needed_mm(row: Row) -> float:
    return row.pitch_mm / (np.sqrt(3.0) if row.l_alpha_mm == row.l_beta_mm else 1.0)
