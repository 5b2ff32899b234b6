"""The page of a design: tables and pictures in one file, to be read without the network."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from fiberloom.report.acceptance import html_page, pairs


@dataclass(frozen=True)
class DesignSection:
    """A heading, what is said below it, tables and a picture."""

    title: str
    """With the result: `Gear: both ratios are in their windows`."""
    says: Sequence[str] = ()
    """Paragraphs."""
    tables: Sequence[Sequence[Mapping[str, Any]]] = ()
    """Rows with the same keys."""
    picture: Path | None = None
    """PNG; read when the page is made."""
    captions: Sequence[str] = ()
    """Of the tables, in their order."""


def design_html(name: str, head: Mapping[str, Any], sections: Sequence[DesignSection]) -> str:
    """The whole page of the design `name`; `head`: what identifies it."""
    body = [f"<h1>Design of {html.escape(name)}</h1>", pairs(head)]
    for section in sections:
        body += _section(section)
    return html_page(f"Design of {html.escape(name)}", body)


def _section(section: DesignSection) -> Iterator[str]:
    yield f"<h2>{html.escape(section.title)}</h2>"
    for line in section.says:
        kind = ' class="fail"' if line.startswith("wrong") else ""
        yield f"<p{kind}>{html.escape(line)}</p>"
    for rows, caption in zip_longest(section.tables, section.captions, fillvalue=""):
        if rows and not isinstance(rows, str):
            yield _table(rows, str(caption))
    if section.picture is not None:
        code = base64.b64encode(section.picture.read_bytes()).decode()
        yield f'<figure><img alt="{html.escape(section.title)}" src="data:image/png;base64,{code}"></figure>'


def _table(rows: Sequence[Mapping[str, Any]], caption: str) -> str:
    head = "".join(f"<th>{html.escape(key.replace('_', ' '))}</th>" for key in rows[0])
    lines = ("".join(_cell(value) for value in row.values()) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    told = f'<caption style="text-align:left">{html.escape(caption)}</caption>' if caption else ""
    return f'<div style="overflow-x:auto;margin-top:1em"><table>{told}<tr>{head}</tr>{body}</table></div>'


def _cell(value: Any) -> str:
    if isinstance(value, list):
        value = "; ".join(map(str, value))
    value = "" if value is None else value
    kind = ' class="n"' if isinstance(value, int | float) else ""
    return f"<td{kind}>{html.escape(str(value))}</td>"
