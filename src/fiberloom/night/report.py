"""The report of a night: one HTML file with its pictures inside, and the figures beside it as JSON."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from fiberloom.night.figures import night_figures
from fiberloom.report.acceptance import html_page, pairs
from fiberloom.store.nights.book import NightBook
from fiberloom.wholefile import write_whole

PAGE, FIGURES = "night.html", "night.json"

LANES = ("exposure", "fibres", "other")
COLOURS = {
    "exposure": "#0072b2",
    "begin check": "#cc79a7",
    "blind": "#e69f00",
    "correction": "#f0e442",
    "planning": "#999999",
    "park": "#009e73",
    "wait": "#dddddd",
    "recover": "#d55e00",
}
"""For all kinds of colour vision (Okabe and Ito)."""
OTHER_COLOUR = "#bbbbbb"

WIDTH, LANE, LEFT, TOP = 1000, 26, 70, 26
LEAST_PX = 1.0
"""A bar that is shorter is drawn so wide."""


def write_report(book: NightBook, folder: Path) -> Path:
    """Writes page and figures of a night into a folder; the page."""
    figures = night_figures(book)
    write_whole(folder / FIGURES, json.dumps(figures, indent=1) + "\n")
    write_whole(folder / PAGE, night_html(figures))
    return folder / PAGE


def night_html(figures: Mapping[str, Any]) -> str:
    """The whole page, of the figures of `night_figures`."""
    night = figures["night"]
    title = f"Night {night['id']}: {night['name']}"
    body = [
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="verdict {_kind(night["status"])}">{html.escape(_verdict(night))}</p>',
        pairs(_head(figures)),
        "<h2>Timeline</h2>",
        timeline_svg(figures["timeline"], figures["night"]["utc_start"]),
        _legend(),
        "<h2>Fields</h2>",
        _fields_table(figures["fields"]),
        "<h2>Visits</h2>",
        _visits_table(figures["visits"], figures["convergence"]),
        "<h2>Where the time went</h2>",
        _steps_table(figures["steps"]),
        "<h2>Positioners with the largest errors</h2>",
        _worst_table(figures["worst_positioners"]),
        "<h2>Alarms</h2>",
        _alarms_table(figures["alarms"]),
        "<h2>Commands</h2>",
        _commands_table(figures["commands"]),
    ]
    return html_page(html.escape(title), body)


def _kind(status: str) -> str:
    return {"finished": "pass", "failed": "fail"}.get(status, "other")


def _verdict(night: Mapping[str, Any]) -> str:
    return f"{night['status']}: {night['note']}" if night["note"] else str(night["status"])


def _head(figures: Mapping[str, Any]) -> dict[str, str]:
    night, totals = figures["night"], figures["totals"]
    gap = totals["shutter_to_ready_s"]
    share = totals["share_open"]
    ready = "no exposure was followed by a field"
    if gap["n"]:
        ready = f"median {gap['median']:.1f} s, at most {gap['max']:.1f} s, {gap['n']} times"
    return {
        "Array": f"{night['instrument']}, {night['array']}",
        "Begin and end (UTC)": f"{_moment(night['utc_start'])} to {_moment(night['utc_end'])}",
        "Shutter open": f"{totals['shutter_open_s']:.0f} s of {totals['night_s']:.0f} s"
        + (f", {100 * share:.1f} %" if share is not None else ""),
        "Exposures": f"{totals['exposures']} in {totals['visits']} visits",
        "Shutter closed to fibres on target": ready,
        "Plans": f"{totals['planned_ahead']} made while the shutter was open, {totals['planned_now']} later; "
        f"assigning and planning with the shutter closed took {totals['computing_wall_s']:.1f} s",
        "Queue": night["queue"],
        "Command": night["command_line"],
        "Version, seed, layout": f"{night['version']}, {night['seed']}, {night['config_hash']}",
    }


def _moment(text: str | None) -> str:
    return "not yet" if text is None else datetime.fromisoformat(text).strftime("%Y-%m-%d %H:%M:%S")


# the timeline


def timeline_svg(bars: Sequence[Mapping[str, Any]], begin: str) -> str:
    """Bars of all steps in three lanes, over hours of UTC. `bars`: of the figures; `begin`: of the night."""
    if not bars:
        return "<p>Nothing was done.</p>"
    zero = datetime.fromisoformat(begin)
    ends_s = [_after_s(bar, zero) + bar["duration_s"] for bar in bars]
    span_s = max(max(ends_s), 60.0)
    scale = (WIDTH - LEFT - 10) / span_s
    height = TOP + LANE * len(LANES) + 24
    parts = [_rect(bar, zero, scale) for bar in bars]
    parts += [_label(name, TOP + LANE * k + 17) for k, name in enumerate(LANES)]
    parts += _ticks(zero, span_s, scale, height)
    parts += _field_names(bars, zero, scale)
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" width="100%" role="img" aria-label="timeline" '
        f'font-family="system-ui,sans-serif" font-size="12" fill="currentColor">{"".join(parts)}</svg>'
    )


def _after_s(bar: Mapping[str, Any], zero: datetime) -> float:
    return (datetime.fromisoformat(bar["begin"]) - zero).total_seconds()


def _what(bar: Mapping[str, Any]) -> str:
    """The kind of a bar, by which it is coloured."""
    name = str(bar["what"]).removeprefix("position: ")
    return next((kind for kind in COLOURS if name.startswith(kind)), "")


def _lane(bar: Mapping[str, Any]) -> int:
    if _what(bar) == "exposure":
        return 0
    return 1 if str(bar["what"]).startswith("position: ") else 2


def _rect(bar: Mapping[str, Any], zero: datetime, scale: float) -> str:
    x, width = LEFT + scale * _after_s(bar, zero), max(scale * bar["duration_s"], LEAST_PX)
    what = html.escape(f"{bar['field']} {bar['what']}: {bar['duration_s']:.1f} s, {bar['outcome']}".strip())
    edge = ' stroke="#d55e00" stroke-width="2"' if bar["outcome"] != "done" else ""
    return (
        f'<rect x="{x:.2f}" y="{TOP + LANE * _lane(bar) + 3}" width="{width:.2f}" height="{LANE - 6}" '
        f'fill="{COLOURS.get(_what(bar), OTHER_COLOUR)}"{edge}><title>{what}</title></rect>'
    )


def _label(text: str, y: float) -> str:
    return f'<text x="0" y="{y}">{text}</text>'


def _ticks(zero: datetime, span_s: float, scale: float, height: int) -> list[str]:
    step_s = next((s for s in (60, 300, 900, 1800, 3600, 7200) if span_s / s <= 12), 14400)
    first = (zero + timedelta(seconds=step_s)).timestamp() // step_s * step_s - zero.timestamp()
    ticks = []
    while first <= span_s:
        x, text = LEFT + scale * first, (zero + timedelta(seconds=first)).strftime("%H:%M")
        ticks.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{height - 18}" stroke="#8886"/>')
        ticks.append(f'<text x="{x:.1f}" y="{height - 4}" text-anchor="middle">{text}</text>')
        first += step_s
    return ticks


def _field_names(bars: Iterable[Mapping[str, Any]], zero: datetime, scale: float) -> list[str]:
    """Each field's name where its exposures begin, unless it would cover the one before."""
    names, free = [], 0.0
    last = None
    for bar in bars:
        x = LEFT + scale * _after_s(bar, zero)
        if _lane(bar) == 0 and bar["field"] != last and x >= free:
            text = str(bar["field"])[:16]
            names.append(f'<text x="{x:.1f}" y="{TOP - 8}">{html.escape(text)}</text>')
            free, last = x + 7.5 * len(text) + 8, bar["field"]
    return names


def _legend() -> str:
    marks = (
        f'<span style="white-space:nowrap;margin-right:1em"><span style="display:inline-block;width:.9em;'
        f'height:.9em;background:{colour};border:1px solid #8888"></span> {name}</span>'
        for name, colour in COLOURS.items()
    )
    return f"<p>{''.join(marks)}</p>"


# tables


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]], none: str = "None.") -> str:
    """Numbers to the right; what is not known is a dash."""
    made = [list(row) for row in rows]
    if not made:
        return f"<p>{none}</p>"
    head = "".join(f"<th{_right(k, made)}>{html.escape(name)}</th>" for k, name in enumerate(heads))
    lines = (
        "".join(f"<td{_right(k, made)}>{_cell(value)}</td>" for k, value in enumerate(row)) for row in made
    )
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f'<div style="overflow-x:auto"><table><tr>{head}</tr>{body}</table></div>'


def _right(column: int, rows: Sequence[Sequence[Any]]) -> str:
    numbers = any(isinstance(row[column], int | float) for row in rows)
    return ' class="n"' if numbers else ""


def _cell(value: Any) -> str:
    if value is None or value == "":
        return "–"
    if isinstance(value, float):
        return f"{value:.2f}"
    return html.escape(str(value)).replace(" → ", "\u00a0→ ").replace(" of ", "\u00a0of\u00a0")


def _share(row: Mapping[str, Any]) -> str | None:
    return None if row["assigned"] is None else f"{row['on_target']} of {row['assigned']}"


def _place(visit: Mapping[str, Any]) -> str:
    return f"{visit['repeat'] + 1}, {visit['dither'] + 1}, {visit['attempt']}"


def _fields_table(fields: Iterable[Mapping[str, Any]]) -> str:
    heads = ("field", "state", "visits", "failed", "exposures", "on target", "rms [um]", "reason", "notes")
    return _table(
        heads,
        (
            (
                *(f["field"], f["state"], f["visits"], f["failed"], f["exposures"]),
                *(_share(f), f["rms_um"], f["reason"], f["notes"]),
            )
            for f in fields
        ),
    )


def _visits_table(visits: Iterable[Mapping[str, Any]], convergence: Iterable[Mapping[str, Any]]) -> str:
    rms = {c["visit"]: " → ".join(_cell(v) for v in c["rms_um"]) for c in convergence}
    heads = (
        *("visit", "field", "repeat, dither, try", "state", "begun (UTC)", "position [s]", "exposures"),
        *("on target", "rms after each move [um]", "plan", "run", "note"),
    )
    return _table(
        heads,
        (
            (
                *(v["id"], v["field"], _place(v), v["state"]),
                *(_moment(v["utc_start"])[11:], v["seconds"].get("position"), v["exposures"]),
                *(_share(v), rms.get(v["id"]), v["plan_from"], v["run_id"], v["note"]),
            )
            for v in visits
        ),
    )


def _steps_table(steps: Iterable[Mapping[str, Any]]) -> str:
    heads = ("step", "n", "median [s]", "longest [s]", "together [s]", "of this machine [s]", "not done")
    keys = ("step", "n", "median_s", "max_s", "total_s", "wall_s", "not_done")
    return _table(heads, ([step[key] for key in keys] for step in steps))


def _worst_table(rows: Iterable[Mapping[str, Any]]) -> str:
    heads = ("positioner", "median [um]", "before this night [um]", "after each visit [um]", "flags")
    return _table(
        heads,
        (
            (
                *(r["positioner_id"], r["median_um"], r["before_um"]),
                *(" ".join(_cell(e) for e in r["error_um"]), ", ".join(r["flags"])),
            )
            for r in rows
        ),
    )


def _alarms_table(alarms: Iterable[Mapping[str, Any]]) -> str:
    heads = ("severity", "of", "text", "since (UTC)", "times", "acknowledged by")
    return _table(
        heads,
        (
            (
                a["severity"],
                a["subject"],
                a["text"],
                _moment(a["since"])[11:],
                a["count"],
                a["acknowledged_by"],
            )
            for a in alarms
        ),
    )


def _commands_table(commands: Iterable[Mapping[str, Any]]) -> str:
    heads = ("time (UTC)", "by", "command", "result")
    return _table(heads, ((_moment(c["utc"])[11:], c["author"], c["command"], c["result"]) for c in commands))
