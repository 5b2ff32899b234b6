"""The text of `--errors`: which errors a twin has, and how large. Nothing heavy is loaded to read it."""

from __future__ import annotations

from fiberloom.errors import InputError

TERMS = ("arm", "fibre", "fiducial", "air")
"""What can be switched."""

GEARS = ("stages", "teeth", "family")
"""Spectra of the gears' deviations: as tuned, of the teeth alone, each gear its own."""


def factors_of(switches: str) -> dict[str, float]:
    """By term of `switches` the factor on its size (a ratio); 0 where the text does not name it."""
    factors = dict.fromkeys(TERMS, 0.0)
    for part in _parts(switches):
        name, given, text = part.partition("=")
        if part in ("all", "none"):
            factors = dict.fromkeys(TERMS, 1.0 if part == "all" else 0.0)
        elif name in TERMS:
            factors[name] = _factor(part, text if given else "1")
        elif name != "gears":
            known = f"all, none, {', '.join(TERMS)}, each with =FACTOR, and gears=SPECTRUM"
            raise InputError(f"--errors {part}: known are {known}")
    return factors


def gears_of(switches: str) -> str:
    """The spectrum of the gears that `switches` names last, of `GEARS`; stages where it names none."""
    spectrum = GEARS[0]
    for part in _parts(switches):
        name, _, text = part.partition("=")
        if name == "gears":
            if text not in GEARS:
                raise InputError(f"--errors {part}: gears={', gears='.join(GEARS)}")
            spectrum = text
    return spectrum


def _parts(switches: str) -> list[str]:
    return [word.strip() for word in switches.split(",") if word.strip()]


def _factor(part: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 <= value <= 100.0:
        raise InputError(f"--errors {part}: a factor on the size, 0 to 100")
    return value
