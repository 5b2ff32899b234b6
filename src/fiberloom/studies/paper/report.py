"""The report: one HTML file, pictures inside, readable on a phone, no script, no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from fiberloom.studies.paper import numbers
from fiberloom.studies.paper.parts import Part
from fiberloom.studies.paper.quantity import Kind, Quantity

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 60rem; padding: 0 1rem 4rem;
       color: #1c2430; background: #fff; }
h1 { font-size: 1.6rem; margin-top: 2rem; } h2 { font-size: 1.25rem; margin-top: 3rem;
       border-top: 1px solid #d5dae1; padding-top: 1rem; }
img { max-width: 100%; height: auto; } figure { margin: 1rem 0; }
figcaption, .small { font-size: .85rem; color: #56606e; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .85rem; width: 100%; }
th, td { text-align: left; padding: .3rem .5rem; border-bottom: 1px solid #e4e8ee; vertical-align: top; }
th { background: #f3f5f8; } td.n { text-align: right; white-space: nowrap; }
td.note { min-width: 14rem; }
tr.miss td { background: #fdeceb; } tr.beyond td { background: #eef6f1; }
.kind { white-space: nowrap; border-radius: .6rem; padding: 0 .45rem; background: #e4e8ee; }
.predicted { background: #dbe7fb; } .tuned { background: #fbeed3; } .missing { background: #f4b6b1; }
nav a { display: inline-block; margin-right: .8rem; }
"""


def report_html(parts: Sequence[Part], out: Path) -> str:
    """The whole page; pictures are read from below `out`."""
    body = [_opening(parts), *(_section(part, out) for part in parts), _closing()]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Kronig 2020, reproduced</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>"
    )


def _opening(parts: Sequence[Part]) -> str:
    quantities = [q for part in parts for q in part.quantities]
    links = "".join(f'<a href="#{p.name}">{escape(p.heading)}</a> ' for p in parts)
    return (
        "<h1>Kronig 2020, reproduced</h1>"
        "<p>The figures and numbers of <em>Precision control of miniature SCARA robots for multi-object "
        "spectrographs</em>, measured on fiberloom's twin through the firmware, bus, camera and "
        "calibration code that operators use.</p>"
        f"{_counts(quantities)}{_misses(parts)}{_kinds()}<nav>{links}</nav>"
    )


def _counts(quantities: Sequence[Quantity]) -> str:
    return (
        f"<p><strong>{numbers.headline(quantities)}.</strong> A number hits within 25 %, an ordering where "
        f"it holds for every seed. Beside them, no predictions: {numbers.others(quantities)}.</p>"
    )


def _misses(parts: Sequence[Part]) -> str:
    """Everything that is not as in the paper: the real predictions first."""
    wrong = [(p, q) for p in parts for q in p.quantities if q.misses]
    rows = [_miss(p, q) for p, q in sorted(wrong, key=lambda found: not found[1].real_prediction)]
    return f"<p>Not as in the paper:</p><ul>{''.join(rows)}</ul>" if rows else ""


def _miss(part: Part, q: Quantity) -> str:
    against = f" {escape(numbers.unit(q))} (ratio {numbers.ratio(q)})" if not q.is_ordering else ""
    return (
        f'<li><strong>{numbers.verdict(q)}</strong>: <a href="#{part.name}">{escape(part.heading)}</a>, '
        f"{escape(q.name)}: paper {numbers.paper(q)}, ours {numbers.ours(q)}{against}. {_why(q)}</li>"
    )


def _why(q: Quantity) -> str:
    return escape(q.note) if q.note else "No reason found yet."


_MEANING = {
    Kind.PUT_IN: "a parameter taken from the paper, so it tests only that the measurement gives it back",
    Kind.TUNED: "a parameter chosen or fitted so that this number agrees",
    Kind.IDENTITY: "arithmetic or geometry of what was put in",
    Kind.REQUIREMENT: "what an instrument asks for",
    Kind.BOUND: "the paper prints one side only",
    Kind.PREDICTED: "it came out; a real prediction where the paper prints a number or an ordering",
}


def _kinds() -> str:
    words = "; ".join(f"{_badge(kind, kind.value)} {text}" for kind, text in _MEANING.items())
    return (
        f'<p class="small">{words}. The spread is the standard deviation over seeds; every seed draws its '
        "own units. Where the paper prints no number, a dash stands beside ours. Green rows are not in the "
        "paper.</p>"
    )


def _badge(kind: Kind, text: str) -> str:
    return f'<span class="kind {kind.value.replace(" ", "-")}">{text}</span>'


def _section(part: Part, out: Path) -> str:
    pictures = "".join(_picture(out / file, caption) for file, caption in part.drawings)
    smaller = f"<p><strong>Smaller than the paper's:</strong> {escape(part.smaller)}</p>"
    beyond = "".join(f"<p><strong>Beyond the paper:</strong> {escape(text)}</p>" for text in part.beyond)
    return (
        f'<h2 id="{part.name}">{escape(part.heading)}: {escape(part.title)}</h2><p>{escape(part.how)}</p>'
        f"{smaller if part.smaller else ''}{_table(part.quantities)}{beyond}{pictures}"
        f'<p class="small">Took {part.seconds:.0f} s ({part.cpu_s:.0f} s of processor); '
        f"seeds {', '.join(map(str, part.seeds))}; "
        f"{'full' if part.full else 'default'} size; fiberloom {escape(part.version)}, {part.utc}. Again: "
        f"<code>fiberloom reproduce {part.key} --seed {part.seeds[0]} --seeds {len(part.seeds)}"
        f"{' --full' if part.full else ''}</code></p>"
    )


def _table(quantities: Sequence[Quantity]) -> str:
    head = "<th>quantity</th><th>paper</th><th>ours</th><th>unit</th><th>ratio</th><th>kind</th><th>note</th>"
    rows = "".join(_row(q) for q in quantities)
    return f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>'


def _row(q: Quantity) -> str:
    mark = "miss" if q.misses else "beyond" if q.beyond else ""
    badge = (
        f'<span class="kind missing">{numbers.verdict(q)}</span>'
        if q.misses
        else _badge(q.kind, q.kind.value)
    )
    note = _why(q) if q.misses else escape(q.note)
    return (
        f'<tr id="{q.id}" class="{mark}"><td>{escape(q.name)}</td><td class="n">{numbers.paper(q)}</td>'
        f'<td class="n">{numbers.ours(q)}</td><td>{escape(numbers.unit(q))}</td>'
        f'<td class="n">{numbers.ratio(q)}</td><td>{badge}</td><td class="note">{note}</td></tr>'
    )


def _picture(path: Path, caption: str) -> str:
    if not path.is_file():
        return f'<p class="small">{escape(path.name)} is not there any more.</p>'
    code = base64.b64encode(path.read_bytes()).decode("ascii")
    text = escape(caption)
    image = f'<img alt="{text}" src="data:image/png;base64,{code}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def _closing() -> str:
    return (
        '<p class="small">Made by <code>fiberloom reproduce</code>. The same numbers for machines: '
        "results.json; as a table: results.md.</p>"
    )
