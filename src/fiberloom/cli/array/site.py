"""A site file: what an observatory would type with every command, written once.

    bus = "cannet://10.1.10.31,10.1.10.32"
    camera = "alpaca://10.1.10.40:11111/0?exposure=5"
    layout = "layout"                  # paths: from the folder of this file
    calibration = "transmission.npz"
    store = "arrays.sqlite"
    exclude = [12, 40]

    [limits]
    disk_mb = 2000

Its values take the place of defaults; what is typed comes first.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text
from fiberloom.instruments.load import first_problem

BENCH = ("friction", "inertia", "coast", "stiffness", "arms", "repeatability")
"""Measurements of single units: they refuse the bus of an array."""


class SiteTable(BaseModel):
    """A table of a site file: a key that is not known is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Limits(SiteTable):
    """What `doctor` finds wrong."""

    disk_mb: float = Field(default=500.0, ge=0.0)
    """Free space below which a disk counts as full, MB."""
    calibration_days: float = Field(default=180.0, gt=0.0)
    """Age from which a calibration counts as old, days."""
    clock_s: float = Field(default=2.0, gt=0.0)
    """By which the camera's clock may be off, s."""


class Site(SiteTable):
    """A site file; None: as without the file."""

    bus: str | None = None
    camera: str | None = None
    instrument: str | None = None
    layout: Path | None = None
    positioners: int | None = Field(default=None, ge=1, lt=2**31)
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    calibration: Path | None = None
    arms: Path | None = None
    store: str | None = None
    exclude: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] = ()
    limits: Limits = Limits()

    def defaults(self) -> dict[str, Any]:
        """Defaults of options, by command and by option, as click takes them."""
        array = {"bus": self.bus, "store": self.store}
        plane = {"instrument": self.instrument, "layout": self.layout, "positioners": self.positioners}
        plane |= {"seed": self.seed}
        moved = array | plane | {
            "camera": self.camera,
            "calibration": self.calibration,
            "arms": self.arms,
            "exclude": ",".join(map(str, self.exclude)) or None,
        }  # fmt: skip
        limits = dict(self.limits)
        by_command = {
            **dict.fromkeys(("observe", "park", "home", "recover"), moved),
            "night": {name: moved[name] for name in ("bus", "camera", "calibration", "store", "exclude")},
            "doctor": moved | limits,
            "serve": {name: v for name, v in moved.items() if name not in ("arms", "exclude")},
            "stop": array | {"instrument": self.instrument},
            "status": array,
            "exclude": dict.fromkeys(("add", "list", "clear"), array),
            "calibrate": dict.fromkeys(("transmission", "focal-plane"), moved)
            | {name: {"bus": self.bus} for name in BENCH},
            "acceptance": {"bus": self.bus},
            "commission": {"bus": self.bus},
            **dict.fromkeys(("assign", "plan", "verify"), plane),
        }
        return {name: _given(values) for name, values in by_command.items()}


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: _given(v) if isinstance(v, dict) else str(v) if isinstance(v, Path) else v
        for name, v in values.items()
        if v is not None
    }


def load_site(path: Path) -> Site:
    """Reads a site file; its paths are from its own folder. InputError names file, key and what is wrong."""
    try:
        data = parse_toml(read_text(path), str(path))
    except InputError as error:
        raise InputError(f"--site {error}") from None
    try:
        site = Site.model_validate(data)
    except ValidationError as error:
        raise InputError(f"--site {path}: {first_problem(error)}") from None
    folder = path.resolve().parent
    placed: dict[str, Any] = {
        name: folder / value
        for name in ("layout", "calibration", "arms")
        if (value := getattr(site, name)) is not None
    }
    if site.instrument is not None and site.instrument.endswith(".toml"):
        placed["instrument"] = str(folder / site.instrument)
    if site.store is not None and "://" not in site.store:
        placed["store"] = str(folder / site.store)
    return site.model_copy(update=placed)
