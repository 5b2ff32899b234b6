"""Closing tables for people at a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from fiberloom.instruments import Instrument

FILE_WIDTH = 120
"""Columns of a table that goes to a file or a pipe: no terminal says how wide it is."""


def table_console() -> Console:
    """As wide as the terminal; `FILE_WIDTH` at least where the output is a file or a pipe."""
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, FILE_WIDTH)
    return console


def print_report(report: Any) -> None:
    """Print a mapping as two columns, a list of mappings as a table."""
    console = table_console()
    if isinstance(report, Mapping):
        console.print(_pairs(report))
    elif report:
        console.print(_rows(report))
    else:
        console.print("nothing to show")


def _pairs(report: Mapping[str, Any]) -> Table:
    table = Table(box=box.SIMPLE, show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for key, value in report.items():
        table.add_row(key.replace("_", " "), _text(value))
    return table


def _rows(rows: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE)
    for key in rows[0]:
        table.add_column(key.replace("_", " "), overflow="fold")
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    return table


def print_estimates(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print identified quantities: value, standard error and, where known, how far from the truth."""
    console = Console()
    known = any("true" in row for row in rows)
    for number in dict.fromkeys(row["positioner_id"] for row in rows):
        table = Table(box=box.SIMPLE, title=f"positioner {number}", title_justify="left")
        for name in ("quantity", "value", "s.e.", "unit", *(("true", "off/s.e.") if known else ())):
            left = name in ("quantity", "unit")
            table.add_column(name, justify="left" if left else "right", no_wrap=name == "quantity")
        for row in rows:
            if row["positioner_id"] == number:
                table.add_row(*_estimate_cells(row, known))
        console.print(table)


def _estimate_cells(row: Mapping[str, Any], known: bool) -> list[str]:
    if row["reason"]:
        return [row["quantity"], "-", "-", f"refused: {row['reason']}"]
    cells = [row["quantity"], f"{row['value']:.6g}", f"{row['standard_error']:.2g}", row["unit"]]
    if known and "true" in row:
        cells += [f"{row['true']:.6g}", f"{row['off_by_se']:+.2f}"]
    return cells


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return "\n".join(f"{k}: {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return "\n".join(_text(v) for v in value)
    return str(value)


def observation_table(summary: Mapping[str, Any]) -> Table:
    """Return the table that closes an observation: one row per move."""
    table = Table(box=box.SIMPLE, title=_headline(summary), title_justify="left",
                  caption=_caption(summary), caption_justify="left", collapse_padding=True)  # fmt: skip
    of_fibres = [f"{name}\n[µm]" for name in ("measured", "metrology", "science", "guided", "95 %", "worst")]
    for name in ("move", *of_fibres, f"within\n{summary['requirement_um']:g} µm"):
        first = name == "move"
        # where 80 columns are too few the label of a move takes two lines; no figure is cut
        table.add_column(name, justify="left" if first else "right", no_wrap=not first)
    for move in summary["moves"]:
        if move["interrupted"]:
            table.add_row(f"{move['label']}: stopped", *7 * ["-"])
            continue
        table.add_row(
            move["label"],
            _um(move["measured_rms_um"]),
            _um(move["true_metrology_rms_um"]),
            _um(move["true_rms_um"]),
            _um(move["guided_rms_um"]),
            _um(move["p95_um"]),
            _um(move["max_um"]),
            f"{move['n_within_requirement']}/{summary['n_assigned']}",
        )
    return table


def spread_table(summary: Mapping[str, Any]) -> Table:
    """Return how the errors of each move are spread, of healthy units and of the others with a target."""
    title = f"Errors of the science fibre, {_by_truth(summary)}"
    table = Table(box=box.SIMPLE, title=title, title_justify="left", collapse_padding=True)
    table.add_column("move")
    for name in (
        "units",
        "n",
        "rms\n[µm]",
        "95 %\n[µm]",
        "99 %\n[µm]",
        f"within\n{summary['requirement_um']:g} µm",
    ):
        table.add_column(name, justify="left" if name == "units" else "right", no_wrap=True)
    for move in summary["moves"]:
        for key, units in (("healthy", "healthy"), ("not_healthy", "others")):
            if move[key]["n"] and not move["interrupted"]:
                table.add_row(move["label"], units, *_spread_cells(move[key]))
    return table


def _spread_cells(spread: Mapping[str, Any]) -> list[str]:
    errors = [_um(spread[key]) for key in ("rms_um", "p95_um", "p99_um")]
    # rounded down: what is below a share that is required does not read as that share
    return [str(spread["n"]), *errors, f"{int(1000.0 * spread['share_within_requirement']) / 10:.1f} %"]


def _by_truth(summary: Mapping[str, Any]) -> str:
    return "true" if any(move["true_rms_um"] is not None for move in summary["moves"]) else "as measured"


_SOMETIMES = {"guiding_um": "guiding", "gravity_um": "gravity"}
"""Parts that not every observation has."""


def budget_line(budget: Mapping[str, Any]) -> str:
    """Of what the errors of the last move are made, in words; um rms."""
    names = {"loop_um": "loop", "camera_um": "camera", "fibre_um": "fibre on its arm"}
    names |= {key: name for key, name in _SOMETIMES.items() if budget.get(key) is not None}
    parts = [
        f"{name} {'not known' if budget[key] is None else _um(budget[key])}" for key, name in names.items()
    ]
    takes = budget["guider_takes_um"]
    guider = "" if takes is None else f"; a guider takes {_um(takes)}"
    return f"parts, {budget['known']} [µm rms]: {', '.join(parts)}{guider}"


def drift_line(sky: Mapping[str, Any]) -> str:
    """What the exposure does to the targets, and when to re-position."""
    every = f"re-position every {sky['reposition_every_s'] / 60.0:.0f} min to stay within"
    told = f"sky: airmass {sky['airmass']:.2f}, placed for {sky['placed_for_utc']} UTC; "
    if sky["exposure_s"]:
        told += (
            f"an exposure of {sky['exposure_s'] / 60.0:.0f} min moves targets by up to "
            f"{sky['drift_um']:.1f} um, {sky['drift_guided_um']:.1f} um with guiding; "
        )
    return f"{told}{every} {sky['drift_limit_um']:g} um"


def series_lines(series: Sequence[Mapping[str, Any]]) -> list[str]:
    """How near the fibres were to guided targets in each exposure of a series."""
    return [
        f"exposure {one['exposure']}, {one['begin_s'] / 60.0:.0f} to {one['end_s'] / 60.0:.0f} min: "
        f"worst fibre {one['worst_um']:.1f} um{_in_reach(one)} (drift {one['drift_um']:.1f}); "
        f"not re-positioned {one['worst_unless_moved_um']:.1f} um (drift {one['drift_unless_moved_um']:.1f})"
        for one in series
    ]


def _in_reach(one: Mapping[str, Any]) -> str:
    """Where targets have gone out of reach, in words."""
    if "out_of_reach" not in one:
        return ""
    return f", {one['worst_in_reach_um']:.1f} without {one['out_of_reach']} out of reach"


def guiding_lines(summary: Mapping[str, Any]) -> list[str]:
    """Of what guide stars have told before each exposure, and the truth of a twin; of summary.json."""
    if "guiding" not in summary:
        return []
    if not summary["guiding"]:
        return ["guiding: nothing here looks at the guide stars of the list; see `fiberloom sky guide`"]
    lines = [guide_line(one) for one in summary["guiding"]]
    last = summary["guiding"][-1]
    return [*lines, guide_truth_line(last)] if "truth" in last else lines


def guide_line(guided: Mapping[str, Any]) -> str:
    """What guide stars have told before an exposure; `guided`: of summary.json."""
    lost = guided["not_seen"]
    named = f" (not seen: {_names(lost)})" if lost else ""
    seen = f"guiding, exposure {guided['exposure']}: {guided['seen']} of {guided['stars']} stars seen{named}"
    found = "" if "chi2" not in guided else f"; {_fit_line(guided)}"
    short = guided.get("out_of_reach", [])
    left = f"; out of reach now: the targets of {_names([str(k) for k in short])}" if short else ""
    how = f"not applied: {guided['why_not']}" if guided["why_not"] else "applied"
    return f"{seen}{found}; {how}{left}"


def _fit_line(guided: Mapping[str, Any]) -> str:
    left_out = guided["left_out"]
    named = f" (left out: {_names(left_out)})" if left_out else ""
    return (
        f"{guided['used']} used{named}, chi2 {guided['chi2']:.0f} of {guided['freedom']}; points off by "
        f"{guided['points_off_ra_arcsec']:+.2f} arcsec in RA, {guided['points_off_dec_arcsec']:+.2f} in Dec "
        f"({guided['offset_x_um']:+.1f}, {guided['offset_y_um']:+.1f} um +- {guided['offset_error_um']:.1f})"
        f", turned by {guided['rotation_arcsec']:+.1f} +- {guided['rotation_error_arcsec']:.1f} arcsec, "
        f"scale {guided['scale_ppm']:+.1f} +- {guided['scale_error_ppm']:.1f} ppm"
    )


def guide_truth_line(guided: Mapping[str, Any]) -> str:
    """How the telescope truly points off, as only a twin knows; `guided`: of summary.json."""
    true = guided["truth"]
    return (
        f"in truth {true['points_off_ra_arcsec']:+.2f} arcsec in RA, {true['points_off_dec_arcsec']:+.2f} in "
        f"Dec ({true['offset_x_um']:+.1f}, {true['offset_y_um']:+.1f} um), {true['rotation_arcsec']:+.1f} "
        f"arcsec, {true['scale_ppm']:+.1f} ppm"
    )


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


_NAMED = 5
"""Stars named in a line."""


def temperature_line(temperature: Mapping[str, Any]) -> str:
    """How long arms were taken to be; empty: as measured. `temperature`: of summary.json, deg C and ppm."""
    if temperature["why_not"]:
        return f"arms taken as they were measured: {temperature['why_not']}"
    if not temperature["arms_grown_ppm"]:
        return ""
    nights = temperature["nights"]
    known = f"by {nights} observations" if nights else "says the instrument"
    line = (
        f"{temperature['at_C']:.1f} deg C: arms taken {temperature['arms_grown_ppm']:+.0f} ppm longer than "
        f"at {temperature['arms_measured_C']:.1f}; {temperature['expansion_ppm_K']:.1f} +- "
        f"{temperature['expansion_sd_ppm_K']:.1f} ppm a kelvin, {known}"
    )
    return "; but ".join(filter(None, [line, temperature["contradiction"]]))


def left_out_line(left_out: Mapping[str, str]) -> str:
    """Positioners that got no target, by number, as their calibration does not count on them; empty: none."""
    if not left_out:
        return ""
    return (
        f"left out before the assignment, not counted on by their calibration: {len(left_out)} positioners, "
        f"{', '.join(left_out)} (why: left_out in summary.json)"
    )


def shortfall(summary: Mapping[str, Any], required: float) -> list[str]:
    """What keeps an observation below the `required` share (0 to 1), in lines; none where it is not.

    What was not assigned is told where fewer targets than that have a positioner of those that could.
    """
    assigned, within = summary["n_assigned"], summary["n_within_requirement"]
    lines = []
    if assigned < required * min(summary["n_positioners"], summary["n_targets"]) or not assigned:
        lines.append(f"not assigned: {counted(summary['not_assigned'])}")
    if assigned and (not within or within < required * assigned):
        lines.append(f"not on target: {counted(summary['not_on_target'])}")
        share = f"{within} of {assigned} ({1000 * within // assigned / 10:g} %)"
        lines.append(f"below what is required: {share} on target, at least {100.0 * required:g} % must be")
    elif not assigned:
        lines.append("below what is required: no target was assigned, so none was observed")
    return lines


def counted(reasons: Mapping[str, int]) -> str:
    """Reasons by count, in one line."""
    return ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in reasons.items()) or "none"


def _headline(summary: Mapping[str, Any]) -> str:
    return (
        f"{summary['n_within_requirement']} of {summary['n_assigned']} assigned fibres within "
        f"{summary['requirement_um']:g} µm of their targets"
    )


def _caption(summary: Mapping[str, Any]) -> str:
    if _by_truth(summary) != "true":
        return "Errors: rms; 95 %, worst and within as measured."
    return (
        "Errors: rms; measured, then true: of the metrology fibre, of the science fibre, and guided: less "
        "shift, rotation and scale of the field. 95 %, worst and within: of the science fibre, true."
    )


def _um(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def overview(i: Instrument) -> dict[str, Any]:
    """What tells instruments apart: numbers, arms and pitch in mm, motor, requirement in um."""
    return {
        "name": i.name,
        "positioners": i.layout.n_positioners,
        "arms_mm": f"{i.positioner.l_alpha_mm:g} / {i.positioner.points[i.seen_point].x_mm:g}",
        "pitch_mm": i.layout.pitch_mm,
        "motor": i.alpha.kind,
        "requirement_um": i.operation.requirement_um,
        "images": "yes" if i.camera else "no",
    }
