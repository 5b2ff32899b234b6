"""LaTeX of the pages as MathML, which browsers draw themselves: no script, nothing from elsewhere."""

import html
import re
from xml.etree import ElementTree

from latex2mathml.converter import convert

PIECE = re.compile(
    r'<div class="arithmatex">\\\[(?P<block>.*?)\\\]</div>'
    r'|<span class="arithmatex">\\\((?P<inline>.*?)\\\)</span>',
    re.S,
)
"""An equation as Markdown's arithmatex (generic) leaves it."""

OTHER_WORDS = (
    (re.compile(r"\\arg\b"), r"\\operatorname{arg}"),
    (re.compile(r"\\operatorname\{(\w+)\}"), r"\\,\\text{\1}\\,"),
    (re.compile(r"\\((?:sin|cos)(?:\^2)?)(?= +[\w\\])"), r"\\\1\\,"),
    (re.compile(r"\\(begin|end)\{aligned\}"), r"\\\1{align*}"),
)
"""What LaTeX knows and the converter does not, in the converter's words."""

UNKNOWN = re.compile(r"<m[io]>(?:\\[a-zA-Z]+|&(?:amp;)?)</m[io]>")
"""What the converter leaves of a command that it does not know."""

PARTS = {"mfrac": 2, "mroot": 2, "msub": 2, "msup": 2, "msubsup": 3, "munder": 2, "mover": 2, "munderover": 3}
"""Parts of those elements that a browser does not draw with more or fewer."""


class EquationError(ValueError):
    """LaTeX that cannot be drawn."""


def mathml(latex: str, display: str = "inline") -> str:
    """One equation as a `<math>` element; `display`: block or inline.

    EquationError where it is not understood.
    """
    said = latex.strip()
    for pattern, other in OTHER_WORDS:
        said = pattern.sub(other, said)
    try:
        drawn = convert(said, display=display)
    except Exception as error:  # the converter has many
        raise EquationError(f"{latex.strip()}: {error or type(error).__name__}") from None
    if fault := _fault(drawn):
        raise EquationError(f"{latex.strip()}: not understood: {fault}")
    return str(drawn)


def _fault(drawn: str) -> str:
    if unknown := UNKNOWN.search(drawn):
        return unknown.group()
    elements = ElementTree.fromstring(drawn).iter()
    named = [(element.tag.rpartition("}")[2], len(element)) for element in elements]
    return ", ".join(f"{tag} of {n} parts" for tag, n in named if PARTS.get(tag, n) != n)


def with_equations(page: str) -> str:
    """HTML of a page with every equation drawn. EquationError for the first that cannot be."""
    return PIECE.sub(_drawn, page)


def _drawn(piece: re.Match[str]) -> str:
    if piece["inline"] is not None:
        return mathml(html.unescape(piece["inline"]))
    return f'<div class="equation">{mathml(html.unescape(piece["block"]), "block")}</div>'
