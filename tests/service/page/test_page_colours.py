"""What is on the page can be read in each theme: contrasts as WCAG 2.1 defines and asks for them.

Success criteria 1.4.3 (words) and 1.4.11 (shapes).
"""

import re
from pathlib import Path

import pytest

import fiberloom

PAGE = Path(fiberloom.__file__).parent / "service" / "page"
CSS, LOOK = (PAGE / "style.css").read_text(), (PAGE / "look.js").read_text()
THEMES = ("dark", "light", "red")
TEXT, GRAPHIC = 4.5, 3.0
"""Least contrasts of words, and of shapes that tell something."""


def luminance(colour):
    """Of `#rgb` or `#rrggbb`, 0 to 1."""
    digits = colour.removeprefix("#")
    digits = digits if len(digits) == 6 else "".join(2 * d for d in digits)
    parts = [int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    """1 to 21."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def styles(theme):
    """Colours of the style sheet by their names."""
    head = ":root" if theme == "dark" else f'[data-theme="{theme}"]'
    block = CSS.split(head + " {", 1)[1].split("}", 1)[0]
    return dict(re.findall(r"--([\w-]+): (#\w+)", block))


def pairs(text):
    """`name: "#colour"` of a piece of look.js."""
    return dict(re.findall(r'(\w+): "(#\w+)"', text))


def states(theme):
    """Colour of each state."""
    names = re.findall(r"(\w+):", LOOK.split("const DARK = {", 1)[1].split("};", 1)[0])
    found = pairs(LOOK.split("const DARK = {", 1)[1].split("};", 1)[0])
    if theme == "light":
        found |= pairs(LOOK.split("const LIGHT = {", 1)[1].split("};", 1)[0])
    if theme == "red":
        plain = re.search(r'\[s, "(#\w+)"\]', LOOK).group(1)
        found = dict.fromkeys(names, plain) | pairs(LOOK.split("Object.assign(RED, {", 1)[1].split("}", 1)[0])
    assert len(found) == len(names) > 10
    return found


def paper(theme):
    """Colours of the picture, and those of the bars."""
    line = re.search(rf"^  {theme}: {{ back: .*$", LOOK, flags=re.M).group(0)
    return pairs(line), re.findall(r"#\w+", line.split("bar: [", 1)[1])


@pytest.mark.parametrize("theme", THEMES)
def test_words_can_be_read(theme):
    style, (picture, bars) = styles(theme), paper(theme)
    for name in ("text", "soft", "warn", "bad"):
        for ground in ("back", "panel"):
            assert contrast(style[name], style[ground]) >= TEXT, (name, ground)
    assert contrast(style.get("stop-text", "#fff"), style["stop"]) >= TEXT
    for bar in bars:
        assert contrast(picture["text"], bar) >= TEXT, bar


@pytest.mark.parametrize("theme", THEMES)
def test_shapes_can_be_seen(theme):
    picture = paper(theme)[0]
    drawn = states(theme) | {name: picture[name] for name in ("target", "error", "chosen")}
    for name, colour in drawn.items():
        assert contrast(colour, picture["back"]) >= GRAPHIC, name
