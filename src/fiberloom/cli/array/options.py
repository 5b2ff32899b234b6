"""Options of commands to an array: how to reach it, what is known of it, where it is on record."""

from __future__ import annotations

import getpass
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.options import PlaneOptions, require_file
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.operation.session.session import KnownArray, Session
    from fiberloom.store.arrays import ArrayBook

STORE_VARIABLE = "FIBERLOOM_STORE"
"""Names the store of arrays, in place of the user's."""

CameraOption = Annotated[
    str | None,
    typer.Option(help="Camera: alpaca://HOST:PORT/N, folder:PATH, indi://HOST:PORT/NAME, aravis:NAME."),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(help="Transmission maps of `calibrate transmission`; default: the nominal ratio."),
]

CALIBRATION_HINT = "make one with 'fiberloom calibrate transmission'"


@dataclass(frozen=True, kw_only=True)
class BusOptions:
    """Of a command that needs to know which array."""

    bus: Annotated[
        str | None,
        typer.Option(help="Bus: cannet://HOST[:PORT][,HOST...], socketcan:can0, slcan:/dev/..., twin:"),
    ] = None
    store: Annotated[
        str | None,
        typer.Option(help="Store of arrays, file or URL; default: FIBERLOOM_STORE, else in the user's data."),
    ] = None

    @property
    def address(self) -> str:
        """Of the bus. InputError where none is named."""
        if not self.bus:
            raise InputError("--bus: which array? e.g. --bus cannet://10.1.10.31, or a --site file that says")
        return self.bus

    def book(self) -> ArrayBook:
        """What the store keeps of the array."""
        return array_book(self.address, self.store)


@dataclass(frozen=True, kw_only=True)
class ExcludeOptions(BusOptions):
    """Of a command that can leave positioners where they are."""

    exclude: Annotated[
        str, typer.Option(help="Positioners left where they are, for this command: numbers with commas.")
    ] = ""


@dataclass(frozen=True, kw_only=True)
class ArmsFileOptions:
    """Of a command that moves arms by what is known of them."""

    arms: Annotated[
        Path | None, typer.Option(help="Arms of `calibrate focal-plane`, in place of the layout's.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class ArrayOptions(ExcludeOptions, ArmsFileOptions, PlaneOptions):
    """Of a command that moves an array."""

    camera: CameraOption = None
    calibration: CalibrationOption = None

    def check(self) -> None:
        """Raises InputError for bad options that can be found without a slow import."""
        self.check_plane()
        _ = self.address, excluded(self.exclude)
        if self.camera is None:
            raise InputError("--camera: which camera? e.g. --camera alpaca://10.1.10.40:11111/0")
        require_file(self.calibration, CALIBRATION_HINT)
        require_file(self.arms, "make one with 'fiberloom calibrate focal-plane'")

    def known(self) -> KnownArray:
        """What is known of the array: layout and arms, maps, where it is, what is on record."""
        from fiberloom.calibration.focal_plane.arms_file import load_arms
        from fiberloom.calibration.transmission.cache import load_for
        from fiberloom.calibration.transmission.nominal import nominal_maps
        from fiberloom.connect import open_hardware
        from fiberloom.operation.session.session import KnownArray

        plane = self.plane()
        source = open_hardware(plane, self.address, self.camera or "", seed=self.seed)
        host = plane if self.arms is None else load_arms(self.arms, plane)
        maps = nominal_maps(plane)
        if self.calibration is not None and plane.instrument.drive.by_maps:
            maps = load_for(plane, self.calibration)
        elif self.calibration is not None:
            source.know(self.calibration)
        return KnownArray(host, maps, source, self.book())

    def session(self, progress: Callable[[str], None]) -> Session:
        """A session with the array; `progress` is called with the name of each step."""
        from fiberloom.operation.session.session import Session

        if self.calibration is None:
            progress("no --calibration: the nominal ratio of the gears is used")
        return Session(self.known(), command_line(), progress, excluded(self.exclude))


def array_book(bus: str, store: str | None) -> ArrayBook:
    """What a store keeps of the array on a `bus`; the usual `store` where none is named."""
    from fiberloom.connect import array_address
    from fiberloom.store import Store
    from fiberloom.store.arrays import ArrayBook

    return ArrayBook(Store.open(store_place(store)), array_address(bus))


def command_line() -> str:
    """What the operator typed."""
    return " ".join(["fiberloom", *sys.argv[1:]])


def operator() -> str:
    """Who types, for the record."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no such user here
        return str(os.getuid())


def store_place(named: str | None) -> str:
    """The store of arrays: as named, else by FIBERLOOM_STORE, else in the user's data folder."""
    if place := named or os.environ.get(STORE_VARIABLE):
        return place
    import platformdirs

    return str(Path(platformdirs.user_data_dir("fiberloom")) / "arrays.sqlite")


def excluded(text: str) -> tuple[int, ...]:
    """Numbers of positioners from "12,40". InputError where one is no number."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    for part in parts:
        if not (part.isascii() and part.isdigit() and len(part) < 10):
            raise InputError(f"--exclude {text}: '{part}' is not the number of a positioner; e.g. 12,40")
    return tuple(int(part) for part in parts)
