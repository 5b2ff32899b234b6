"""The text of `--errors`: which errors a twin has, and how large. Nothing heavy is loaded to read it."""

from __future__ import annotations

from typing import Literal, get_args

from fiberloom.errors import InputError

TERMS = ("arm", "fibre", "fiducial", "air", "power", "temperature", "gravity", "torque", "pointing")
"""What can be switched."""

NIGHT = "at_C"
"""Names the temperature of a night."""
COLDEST_C, WARMEST_C = -40.0, 60.0
"""Nights that a twin can have."""

GearSpectrum = Literal["stages", "teeth", "family"]
"""Which orders the gears have: two stages (36 tooth pairings, and 204 a turn of an earlier stage), the
teeth of the last stage alone with their overtones and sidebands, or each gear its own of all that."""


def check_switches(switches: str) -> None:
    """Raises InputError for a text that names what there is not."""
    factors_of(switches)
    gears_of(switches)
    night_C_of(switches)


def factors_of(switches: str) -> dict[str, float]:
    """By term of `switches` the factor on its size (a ratio); 0 where the text does not name it."""
    factors = dict.fromkeys(TERMS, 0.0)
    for part in _parts(switches):
        name, given, text = part.partition("=")
        if part in ("all", "none"):
            factors = dict.fromkeys(TERMS, 1.0 if part == "all" else 0.0)
        elif name in TERMS:
            factors[name] = _factor(part, text if given else "1")
        elif name not in ("gears", NIGHT):
            known = f"all, none, {', '.join(TERMS)}, each with =FACTOR, gears=SPECTRUM and {NIGHT}=DEG_C"
            raise InputError(f"--errors {part}: known are {known}")
    return factors


def night_C_of(switches: str) -> float | None:
    """The temperature of the night that `switches` names last, deg C; None where the seed draws it."""
    named = [part for part in _parts(switches) if part.partition("=")[0] == NIGHT]
    if not named:
        return None
    if factors_of(switches)["temperature"] == 0.0:
        raise InputError(f"--errors {named[-1]}: goes with the term temperature")
    try:
        at_C = float(named[-1].partition("=")[2])
    except ValueError:
        at_C = float("nan")
    if not COLDEST_C <= at_C <= WARMEST_C:
        raise InputError(f"--errors {named[-1]}: a temperature, {COLDEST_C:g} to {WARMEST_C:g} deg C")
    return at_C


def gears_of(switches: str) -> GearSpectrum:
    """The spectrum of the gears that `switches` names last; stages where it names none."""
    named = [text for name, _, text in (part.partition("=") for part in _parts(switches)) if name == "gears"]
    try:
        return [gear_spectrum(text) for text in ["stages", *named]][-1]
    except InputError as error:
        raise InputError(f"--errors: {error}") from None


def gear_spectrum(name: str) -> GearSpectrum:
    """The spectrum of this name; InputError where there is none."""
    known: tuple[GearSpectrum, ...] = get_args(GearSpectrum)
    for spectrum in known:
        if spectrum == name:
            return spectrum
    raise InputError(f"gears '{name}': must be one of {', '.join(known)}")


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
