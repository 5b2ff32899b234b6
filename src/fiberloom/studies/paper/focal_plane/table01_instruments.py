"""Table 1: the six instruments, each with its own motors, bus, camera and operation."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.instruments.model import Operation
from fiberloom.studies.paper.focal_plane.table01_field import FURTHER, InstrumentRun, observe, rms
from fiberloom.studies.paper.focal_plane.table01_kept import RowRuns
from fiberloom.studies.paper.focal_plane.table01_rows import TABLE_1, Row
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Bound, Kind, Quantity, ordering, quantity
from fiberloom.typing import Floats

UNITS = 57
"""A module of PFS, and as many of each other."""


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the requirement of each instrument."""
    n_units = None if settings.full else UNITS
    seeds = settings.seeds
    kept = None if settings.folder is None else RowRuns(settings.folder, settings.fresh)
    found: dict[str, list[InstrumentRun]] = {row.key: [] for row in TABLE_1}
    failed: dict[str, str] = {}
    for row in TABLE_1:
        for seed in seeds:
            settings.say(f"Table 1: {row.name}, seed {seed}")
            made = observe(row, seed, n_units) if kept is None else kept.made(row, seed, n_units)
            if isinstance(made, InstrumentRun):
                found[row.key].append(made)
            else:
                failed[row.key] = made
    size = "All units" if settings.full else f"{UNITS} units"
    return FigureOutcome(
        quantities=[
            _stringent(),
            *(q for row in TABLE_1 for q in _quantities(row, found[row.key], failed.get(row.key, ""))),
        ],
        drawings=[_draw_table(found, len(seeds)), _draw(found)],
        how=(
            f"{size} of each instrument by its preset: its own motors, frames, camera, planning and "
            "corrections on the twin. Units are drawn and calibrated, targets assigned, motions planned, "
            "verified and driven over the bus. DESI's maps are empty, as before its first night. Errors are "
            "true, of healthy fibres with a target. Times have each camera's exposures in them. Table 1 "
            f"prints maxima; where one is not kept, {FURTHER} corrections more tell what it would take."
        ),
        table=_markdown(found, failed, len(seeds)),
        smaller=""
        if settings.full
        else f"{UNITS} units of each instead of 92 to 5000; --full runs all of them.",
    )


def _stringent() -> Quantity:
    strictest = min(TABLE_1, key=lambda row: row.tolerance_mdeg)
    return ordering(
        "table1.order.strictest_is_sdssv",
        "SDSS-V asks for the most accurate alpha axis of the six",
        strictest.key == "sdssv",
        Kind.IDENTITY,
        note="requirement over reach: "
        + ", ".join(f"{row.name} {row.tolerance_mdeg:.1f}" for row in TABLE_1)
        + " mdeg",
    )


def _quantities(row: Row, runs: Sequence[InstrumentRun], failed: str) -> list[Quantity]:
    key, name = f"table1.{row.key}", row.name
    if failed or not runs:
        return [quantity(f"{key}.max_um", f"{name}: worst healthy fibre, true", float("nan"), "um",
                         Kind.REQUIREMENT, paper=row.requirement_um, bound=Bound.AT_MOST,
                         note=f"not made: {failed}")]  # fmt: skip
    asked: Operation = row.operation
    worst = [float(r.error_um[-1].max()) for r in runs]
    on_target = [r.on_target(row.requirement_um) for r in runs]
    contacts = [float(r.contacts) for r in runs]
    missed = row.why if max(worst) > row.requirement_um else ""
    why = "; ".join(filter(None, [_by_moves(row, runs), missed, _left_out(runs)]))
    return [
        quantity(f"{key}.max_um", f"{name}: worst healthy fibre, true", max(worst), "um", Kind.REQUIREMENT,
                 paper=row.requirement_um, bound=Bound.AT_MOST,
                 note="; ".join(filter(None, [_seeds_met(row, runs), _note(row, runs)]))),
        *_own(row, runs),
        quantity(f"{key}.on_target", f"{name}: share of all assigned within {row.requirement_um:g} um, as "
                 "the exit code of observe has it", on_target, "1", Kind.REQUIREMENT,
                 paper=asked.required_share, bound=Bound.AT_LEAST, beyond=True),
        quantity(f"{key}.within", f"{name}: share of the healthy within {row.requirement_um:g} um",
                 [_within(r.error_um[-1], row.requirement_um) for r in runs], "1", beyond=True, note=why),
        quantity(f"{key}.contacts", f"{name}: contacts of arms, in the twin's truth", contacts, "1",
                 Kind.REQUIREMENT, paper=0.0, bound=Bound.AT_MOST, beyond=True),
        *(quantity(f"{key}.{what}", f"{name}: {words}", values, unit, beyond=True)
          for what, words, values, unit in _told(row, runs)),
    ]  # fmt: skip


def _kept_by(row: Row, runs: Sequence[InstrumentRun]) -> int:
    """How many runs keep the maximum of Table 1."""
    return sum(float(r.error_um[-1].max()) <= row.requirement_um for r in runs)


def _seeds_met(row: Row, runs: Sequence[InstrumentRun]) -> str:
    """How many of several seeds keep it, in words; empty for one."""
    return f"met by {_kept_by(row, runs)} of {len(runs)} seeds" if len(runs) > 1 else ""


def _verdict(kept: int, seeds: int) -> str:
    """MET or MISSED; of several `seeds` with how many have kept what is asked for."""
    word = MET if kept == seeds else MISSED
    return word if seeds == 1 else f"{word}, {kept} of {seeds} seeds"


def _own(row: Row, runs: Sequence[InstrumentRun]) -> list[Quantity]:
    """What the makers publish, in their own terms; none where that is Table 1's."""
    operation: Operation = row.operation
    own = operation.own
    if own is None:
        return []
    share = own.statistic == "share"
    return [
        quantity(f"table1.{row.key}.own", f"{row.name}: the makers' {own.words}", [r.own(own) for r in runs],
                 "1" if share else "um", Kind.REQUIREMENT, paper=own.share if share else own.within_um,
                 bound=Bound.AT_LEAST if share else Bound.AT_MOST, beyond=True, note=own.source)
    ]  # fmt: skip


def _told(row: Row, runs: Sequence[InstrumentRun]) -> list[tuple[str, str, list[float], str]]:
    """Figures without a bound: name, words, values, unit."""
    moves = max(len(r.error_um) for r in runs)
    last = [r.error_um[-1] for r in runs]
    return [
        ("moves", "moves, the blind one with them", [float(len(r.error_um)) for r in runs], "1"),
        ("blind_rms_um", "blind move, true rms", [rms(r.error_um[0]) for r in runs], "um"),
        ("rms_um", f"after {moves} moves, true rms", [rms(e) for e in last], "um"),
        ("p95_um", f"after {moves} moves, 95 %", [float(np.percentile(e, 95)) for e in last], "um"),
        (
            "reconfiguration_s",
            "from the first motion to the last image",
            [r.reconfiguration_s for r in runs],
            "s",
        ),
        ("cpu_s", "processor time, calibration included", [r.cpu_s for r in runs], "s"),
        ("memory_gib", "most memory", [r.memory_gib for r in runs], "GiB"),
        *_further(row, runs),
    ]


def _further(row: Row, runs: Sequence[InstrumentRun]) -> list[tuple[str, str, list[float], str]]:
    """What more corrections than the instrument makes would bring, of the runs that made them."""
    further = [r.further_um for r in runs if r.further_um is not None]
    if not further:
        return []
    words = f"share within {row.requirement_um:g} um after {FURTHER} corrections more than it makes"
    return [("further_within", words, [_within(e, row.requirement_um) for e in further], "1")]


def _by_moves(row: Row, runs: Sequence[InstrumentRun]) -> str:
    """Shares within the requirement move by move, in words; empty where there is one move."""
    least = min(len(r.error_um) for r in runs)
    shares = [np.mean([_within(r.error_um[k], row.requirement_um) for r in runs]) for k in range(least)]
    return f"after each move {', '.join(f'{100.0 * s:.1f}' for s in shares)} %" if least > 1 else ""


def _left_out(runs: Sequence[InstrumentRun]) -> str:
    """Which units got no target, by their calibration before the field, and why; empty: none.

    Each run has drawn units of its own, which have the same numbers.
    """
    told = []
    for run in runs:
        named = (f"{name} ({run.left_out[name]})" for name in sorted(run.left_out, key=int))
        told += [f"{len(run.left_out)} units, {'; '.join(named)}"] if run.left_out else []
    how = "left out before the assignment, not counted on by their calibration"
    return f"{how}: {', and in another field '.join(told)}" if told else ""


def _within(error_um: Floats, requirement_um: float) -> float:
    return float(np.mean(error_um <= requirement_um))


def _note(row: Row, runs: Sequence[InstrumentRun]) -> str:
    healthy = sum(len(r.error_um[-1]) for r in runs)
    assigned, every = sum(r.assigned for r in runs), sum(r.positioners for r in runs)
    collisions, contacts = sum(r.collisions for r in runs), sum(r.contacts for r in runs)
    return (
        f"published: {row.published}. {assigned} of {every} positioners had a target, {healthy} of these "
        f"were healthy; {collisions} collisions in verified plans, {contacts} contacts in truth"
    )


COLUMNS = (
    "",
    "units",
    "Table 1",
    "moves",
    "rms",
    "95 %",
    "worst",
    "",
    "within",
    "the makers' own",
    "",
    "time",
    "CPU",
    "memory",
    "contacts",
    "published",
)
VERDICTS = (7, 10)
"""Columns: by the maximum of Table 1, and by the makers' own terms."""
MET, MISSED, NOT_MADE = "met", "MISSED", "not made"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _per_cent(share: float) -> str:
    """Rounded down, so that 100 % are all."""
    return f"{np.floor(1e4 * share + 1e-9) / 100.0:g} %"


def _cells(row: Row, runs: Sequence[InstrumentRun], seeds: int) -> list[str]:
    """A line of the table: means over the runs, the worst of all; one that failed has not met, of `seeds`."""
    if not runs:
        return [row.name, *(NOT_MADE if k in VERDICTS else "" for k in range(1, len(COLUMNS)))]
    last, own = [r.error_um[-1] for r in runs], row.operation.own
    worst_um = max(float(e.max()) for e in last)

    def mean(values: list[float], unit: str) -> str:
        return f"{_three_digits(float(np.mean(values)))} {unit}"

    return [
        row.name,
        f"{runs[0].positioners}",
        f"{row.requirement_um:g} µm max",
        f"{max(len(r.error_um) for r in runs)}",
        mean([rms(e) for e in last], "µm"),
        mean([float(np.percentile(e, 95)) for e in last], "µm"),
        f"{_three_digits(worst_um)} µm",
        _verdict(_kept_by(row, runs), seeds),
        _per_cent(min(_within(e, row.requirement_um) for e in last)),
        own.words.replace(" um", " µm") if own else "",
        _verdict(sum(not any(q.misses for q in _own(row, [r])) for r in runs), seeds) if own else "",
        mean([r.reconfiguration_s for r in runs], "s"),
        mean([r.cpu_s for r in runs], "s"),
        mean([r.memory_gib for r in runs], "GiB"),
        f"{sum(r.contacts for r in runs)}",
        row.published,
    ]


def _markdown(found: dict[str, list[InstrumentRun]], failed: dict[str, str], seeds: int) -> str:
    """The table as text; below it why rows are not there."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *(_cells(row, found[row.key], seeds) for row in TABLE_1)]
    words = [f"{row.name} was not made: {failed[row.key]}" for row in TABLE_1 if row.key in failed]
    return "\n".join([*("| " + " | ".join(cells) + " |" for cells in lines), *words])


def _draw_table(found: dict[str, list[InstrumentRun]], seeds: int) -> Drawing:
    canvas, axes = plt.subplots(figsize=(16, 3.6), layout="constrained")
    axes.set_axis_off()
    cells = [_cells(row, found[row.key], seeds) for row in TABLE_1]
    broken = [[text.replace("; ", "\n").replace(", in", "\nin") for text in line] for line in cells]
    table = axes.table(broken, colLabels=COLUMNS, loc="center", cellLoc="center")
    table.auto_set_font_size(False)
    table.set_fontsize(8.5)
    table.auto_set_column_width(list(range(len(COLUMNS))))
    table.scale(1.0, 2.2)
    for k, line in enumerate(cells):
        for column in VERDICTS:
            if line[column]:
                met = line[column].startswith(MET)
                table[k + 1, column].set_facecolor("#cfe8cf" if met else "#f5c6c6")
    return drawing(
        "table",
        "All six: true errors of healthy fibres after the last move, against the maximum of Table 1 and "
        "against what the makers publish in their own terms.",
        canvas,
    )


def _draw(found: dict[str, list[InstrumentRun]]) -> Drawing:
    canvas, axes = plt.subplots(figsize=(8, 4.6), layout="constrained")
    for k, row in enumerate(TABLE_1):
        if not found[row.key]:
            continue
        moves = max(len(r.error_um) for r in found[row.key])
        for shift, which, colour in ((-0.18, 0, "tab:blue"), (0.18, -1, "tab:green")):
            if which == -1 and moves == 1:
                continue
            error = np.concatenate([r.error_um[which] for r in found[row.key]])
            jitter = np.linspace(-0.13, 0.13, len(error))
            axes.plot(k + shift + jitter, error, ".", color=colour, markersize=3)
        axes.plot([k - 0.4, k + 0.4], 2 * [row.requirement_um], color="crimson")
    names = [row.name for row in TABLE_1]
    axes.set(yscale="log", ylabel="true error of a fibre [µm]", xticks=range(len(names)))
    axes.set_xticklabels(names)
    axes.grid(True, axis="y", alpha=0.3)
    return drawing(
        "errors",
        "Every dot is a healthy fibre: blue after the blind move, green after the last; red: requirement.",
        canvas,
    )
