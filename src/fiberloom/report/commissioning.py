"""The commissioning record of a unit: one HTML file in the frame of the acceptance report."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from fiberloom.report.acceptance import html_page, pairs, signature


def commissioning_html(unit: Mapping[str, Any], head: Mapping[str, Any]) -> str:
    """The whole page. unit: a record of commissioning.json; head: what identifies the unit and the run."""
    word, kind = ("commissioned", "pass") if unit["commissioned"] else ("not commissioned", "fail")
    title = f"Commissioning of positioner {unit['positioner_id']}"
    body = [
        f"<h1>{title}</h1>",
        f'<p class="verdict {kind}">{word}</p>',
        pairs(head),
        *_reasons(unit["reasons"]),
        "<h2>Parameters</h2>",
        _table(p for p in unit["parameters"] if p["origin"] != "factory"),
        "<h2>Kept from the factory</h2>",
        _table(p for p in unit["parameters"] if p["origin"] == "factory"),
        "<h2>Cross-checks</h2>",
        _checks(unit["checks"]),
        "<h2>For the host</h2>",
        _host(unit["host"]),
        signature(),
    ]
    return html_page(f"{title}: {word}", body)


def _reasons(reasons: Iterable[str]) -> Iterator[str]:
    for reason in reasons:
        yield f'<p class="fail">{html.escape(reason)}</p>'


def number_text(record: Mapping[str, Any]) -> str:
    """Value and standard error to the first digit of the error, with the same decimals; a dash for None.

    Numbers below 0.001 or from 1e6 on have a common power of ten: (4.35 ± 0.01)e-05.
    """
    value, error = record["value"], record.get("standard_error")
    if value is None:
        return "–"
    if not error:
        return f"{value:.4g}"
    last = _power(error, digits=1)
    value, error = round(value, -last) + 0.0, round(error, -last)  # + 0.0: no "-0.00"
    power = _power(max(abs(value), error))
    power = 0 if -3 <= power < 6 else power
    decimals = max(power - last, 0)
    text = f"{value / 10.0**power:.{decimals}f} ± {error / 10.0**power:.{decimals}f}"
    return f"({text})e{power:+03d}" if power else text


def _power(number: float, digits: int = 12) -> int:
    """Power of ten of the first digit of a number that is rounded to so many digits."""
    return int(f"{number:.{digits - 1}e}".partition("e")[2])


def found_text(record: Mapping[str, Any]) -> str:
    """The same with the unit."""
    return f"{number_text(record)} {record['unit']}".removesuffix(" 1")


def limits_text(low: float | None, high: float | None) -> str:
    """A range, or the one limit there is, in the unit (SI) of what it limits."""
    if low is None or high is None:
        return f"≤ {high:g}" if high is not None else f"≥ {low:g}" if low is not None else ""
    return f"{low:g} … {high:g}"


def _table(records: Iterable[Mapping[str, Any]]) -> str:
    names = ("", "factory", "found", "limits", "")
    head = "".join(f'<th class="{"n" if k in (1, 2, 3) else ""}">{name}</th>' for k, name in enumerate(names))
    return f"<table><tr>{head}</tr>{''.join(map(_row, records))}</table>"


def _row(r: Mapping[str, Any]) -> str:
    kind = {"good": "pass", "refused": "fail"}.get(r["verdict"], "other")
    note = html.escape(r["reason"] or r["provenance"])
    return (
        f"<tr><td>{r['axis']} {html.escape(r['parameter'])}"
        f'<br><small class="note other">{note}</small></td>'
        f'<td class="n">{r["factory"]:.4g}</td><td class="n">{html.escape(found_text(r))}</td>'
        f'<td class="n">{limits_text(r["low"], r["high"])}</td><td class="{kind}">{r["verdict"]}</td></tr>'
    )


def _checks(records: Iterable[Mapping[str, Any]]) -> str:
    rows = (
        f'<tr><td>{html.escape(r["check"])}</td><td class="n">{html.escape(found_text(r))}</td>'
        f'<td class="n">{limits_text(r["low"], r["high"])}</td>'
        f'<td class="{r["verdict"] if r["verdict"] != "not measured" else "other"}">{r["verdict"]}</td></tr>'
        for r in records
    )
    return f"<table>{''.join(rows)}</table>"


def _host(records: Mapping[str, Mapping[str, Any]]) -> str:
    rows = (
        f'<tr><td>{html.escape(name)}<br><small class="note other">{html.escape(r["reason"] or r["source"])}'
        f'</small></td><td class="n">{html.escape(found_text(r))}</td></tr>'
        for name, r in records.items()
    )
    return f"<table>{''.join(rows)}</table>"
