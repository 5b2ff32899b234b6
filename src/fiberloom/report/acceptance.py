"""The acceptance report of a unit: one HTML file with its pictures inside, to be read and signed."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.calibration.bench.acceptance import AcceptanceData, Check, UnitVerdict
from fiberloom.calibration.transmission.maps import NEGATIVE, POSITIVE
from fiberloom.instruments.model import AXES
from fiberloom.report.identification import turned_um

_STYLE = """
:root{color-scheme:light dark;--line:#8884;--good:#1a7f37;--bad:#cf222e;--grey:#777}
body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;padding:1rem;max-width:60rem}
h1{font-size:1.4rem;margin:.2rem 0}h2{font-size:1.1rem;margin:1.6rem 0 .4rem}
table{border-collapse:collapse;width:100%}td,th{padding:.35rem .4rem;border-bottom:1px solid var(--line);
text-align:left;vertical-align:top}td.n,th.n{text-align:right;white-space:nowrap}
.pass{color:var(--good);font-weight:600}.fail{color:var(--bad);font-weight:700}.other{color:var(--grey)}
.verdict{display:inline-block;padding:.2rem .8rem;border:2px solid;border-radius:.4rem;font-size:1.2rem}
img{max-width:100%;height:auto;background:#fff}
figure{margin:.6rem 0}figcaption{font-size:.9rem;color:var(--grey)}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem .8rem;margin:.6rem 0}dt{color:var(--grey)}
dd{margin:0;overflow-wrap:anywhere}
.sign{display:grid;grid-template-columns:1fr 1fr;gap:2.2rem 1.5rem;margin-top:2.5rem}
.sign div{border-top:1px solid;padding-top:.2rem;font-size:.9rem}
@media print{body{max-width:none}h2{break-after:avoid}figure{break-inside:avoid}}
@media(max-width:32rem){body{padding:.6rem;font-size:15px}.note{display:none}}
"""


def acceptance_html(verdict: UnitVerdict, data: AcceptanceData, head: Mapping[str, Any]) -> str:
    """The whole page. `head`: what identifies the unit and the run, in order."""
    number = verdict.positioner_id
    word = verdict.word
    if word == "not complete":
        word += f": {', '.join(verdict.missing)} not measured"
    kind = {"accepted": "pass", "not accepted": "fail"}.get(verdict.word, "other")
    title = f"Acceptance of positioner {number}"
    body = [
        f"<h1>{title}</h1>",
        f'<p class="verdict {kind}">{word}</p>',
        pairs(head),
        *_findings(verdict),
        "<h2>Figures</h2>" if not verdict.reason else "",
        *(_figures(verdict, data) if not verdict.reason else ()),
        signature(),
    ]
    return html_page(f"{title}: {word}", body)


def html_page(title: str, body: Iterable[str]) -> str:
    """A page in one file, to be read on a phone and printed; the parts of the body are HTML already."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def pairs(head: Mapping[str, Any]) -> str:
    """A list of what is called how."""
    rows = (f"<dt>{html.escape(k)}</dt><dd>{html.escape(str(v))}</dd>" for k, v in head.items())
    return f"<dl>{''.join(rows)}</dl>"


def _findings(verdict: UnitVerdict) -> Iterator[str]:
    if verdict.reason:
        yield f'<h2>Not measured</h2><p class="fail">{html.escape(verdict.reason)}</p>'
        return
    yield "<h2>Requirements</h2>" + _table(c for c in verdict.checks if c.limit is not None)
    yield "<h2>For information</h2>" + _table(c for c in verdict.checks if c.limit is None)


def _table(checks: Iterator[Check]) -> str:
    head = '<tr><th></th><th class="n">found</th><th class="n">at most</th><th></th></tr>'
    return f"<table>{head}{''.join(map(_row, checks))}</table>"


def _row(check: Check) -> str:
    note = f'<br><small class="note other">{html.escape(check.note)}</small>' if check.note else ""
    limit = "" if check.limit is None else f"{check.limit:g} {check.unit}"
    kind = check.verdict if check.verdict in ("pass", "fail") else "other"
    word = "" if check.verdict == "information" else check.verdict
    word += ", near its limit" if check.marginal else ""
    return (
        f'<tr><td>{html.escape(check.name)}{note}</td><td class="n">{found_text(check)}</td>'
        f'<td class="n">{limit}</td><td class="{kind}">{word}</td></tr>'
    )


def found_text(check: Check) -> str:
    """Value with its standard error to two digits, and the unit."""
    if check.value is None:
        return "–"
    if check.error is None or not check.error > 0.0:
        number = f"{check.value:.0f}" if check.unit == "" else f"{check.value:.3g}"
        return f"{number} {check.unit}".strip()
    digits = max(1 - int(np.floor(np.log10(check.error))), 0)
    return f"{check.value:.{digits}f} ± {check.error:.{digits}f} {check.unit}"


def signature() -> str:
    """Lines to sign on."""
    lines = ("Name", "Date", "Signature", "Remarks")
    return '<div class="sign">' + "".join(f"<div>{line}</div>" for line in lines) + "</div>"


def _figures(verdict: UnitVerdict, data: AcceptanceData) -> Iterator[str]:
    row = verdict.row
    yield _picture(_transmission(data, row), "Deviation from the nominal ratio, and hysteresis (Fig. 10)")
    yield _picture(_blind(data, row), "Distance from the target, move by move, and where the targets were")
    yield _picture(_repeat(data, row), "Three targets 1 µm apart, visited again and again (Fig. 17)")


def _picture(figure: Any, caption: str) -> str:
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=100)
    plt.close(figure)
    code = base64.b64encode(memory.getvalue()).decode()
    words = html.escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{code}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def _transmission(data: AcceptanceData, row: int) -> Any:
    figure, panels = plt.subplots(2, 2, figsize=(10, 5.5), layout="constrained", sharex="col")
    one = data.maps.select([row])
    for axis, name in enumerate(AXES):
        low, high = one.output_deg[0, axis, :, [0, -1]].T
        theta = np.linspace(low.max(), high.min(), 1000)
        for direction, label in ((NEGATIVE, "negative contact"), (POSITIVE, "positive contact")):
            panels[0, axis].plot(theta, one.delta_deg(theta, direction)[0, axis], lw=0.9, label=label)
        gap = one.delta_deg(theta, POSITIVE)[0, axis] - one.delta_deg(theta, NEGATIVE)[0, axis]
        panels[1, axis].plot(theta, gap, lw=0.9, color="0.3")
        panels[0, axis].set(title=name, ylabel="δ [deg]")
        panels[0, axis].legend(fontsize=8)
        panels[1, axis].set(xlabel="θ [deg]", ylabel="hysteresis [deg]", ylim=(0, None))
    return figure


def _blind(data: AcceptanceData, row: int) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    errors = data.error_um[row]
    moves = np.arange(1, errors.shape[1] + 1)
    left.semilogy(moves, errors.T, color="C0", lw=0.6, alpha=0.6)
    left.semilogy(moves, np.sqrt(np.nanmean(errors**2, axis=0)), "k-o", lw=1.5, label="rms")
    requirement = data.plane.instrument.operation.requirement_um
    left.axhline(requirement, color="C3", ls="--", label=f"requirement {requirement:g} µm")
    left.set(xlabel="move", ylabel="distance [µm]", xticks=moves)
    left.legend(fontsize=8)
    rows = np.full(len(data.target_deg), row)
    alpha, beta = data.target_deg.T
    xy = data.plane.forward(alpha, beta, index=rows) - data.plane.centres_mm[row]
    spots = right.scatter(*xy.T, c=errors[:, 0], s=40, cmap="viridis")
    figure.colorbar(spots, ax=right, label="blind error [µm]")
    right.set(aspect="equal", xlabel="x from the centre [mm]", ylabel="y [mm]")
    return figure


def _repeat(data: AcceptanceData, row: int) -> Any:
    figure, panels = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
    for axis, name in enumerate(AXES):
        off_um = turned_um(data.visits[axis], row)
        for target in off_um:
            panels[axis].plot(*target.T, ".", ms=4)
        half = 1.1 * np.nanmax(np.abs(off_um))
        rms, error = data.repeatability[axis].own.of(row)
        panels[axis].set(
            title=f"{name}, lever {data.visits[axis].lever_mm[row]:.1f} mm: {rms:.3f} ± {error:.3f} µm",
            xlabel="along the way [µm]", ylabel="across [µm]", aspect="equal",
            xlim=(-half, half), ylim=(-0.5 * half, 0.5 * half),
        )  # fmt: skip
        panels[axis].title.set_fontsize(9)
    return figure
