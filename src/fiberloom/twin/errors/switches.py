"""The text of `--errors`: which errors a twin has, and how large. Nothing heavy is loaded to read it."""

from __future__ import annotations

from fiberloom.errors import InputError

TERMS = ("arm", "fibre", "fiducial", "air")
"""What can be switched."""


def factors_of(switches: str) -> dict[str, float]:
    """By term of `switches` the factor on its size (a ratio); 0 where the text does not name it."""
    factors = dict.fromkeys(TERMS, 0.0)
    for part in filter(None, (word.strip() for word in switches.split(","))):
        name, given, text = part.partition("=")
        if part in ("all", "none"):
            factors = dict.fromkeys(TERMS, 1.0 if part == "all" else 0.0)
        elif name in TERMS:
            factors[name] = _factor(part, text if given else "1")
        else:
            raise InputError(f"--errors {part}: known are all, none, {', '.join(TERMS)}, each with =FACTOR")
    return factors


def _factor(part: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 <= value <= 100.0:
        raise InputError(f"--errors {part}: a factor on the size, 0 to 100")
    return value
