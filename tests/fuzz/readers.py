"""Every reader against files that were damaged: read, or refused in one line. Never anything else.

    python tests/fuzz/readers.py [--files 100000] [--seed 0] [--only maps,store] [--keep build/fuzz]

Each reader is named with a valid file that the project writes (valid_files.py); a mutated file is
named by reader and number, and what goes wrong with one is kept in --keep and printed.
"""

import argparse
import faulthandler
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mutations import mutated, page_mutated, seed_of
from valid_files import PLANE, SMALL_PFS, WRITERS

import fiberloom as fl
from fiberloom.calibration.fibres.exposures_file import read_exposures
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.focal_plane.arms_file import ArmsFile
from fiberloom.cli.array.site import load_site
from fiberloom.drive.piezo import read_module_maps
from fiberloom.drive.steppers.kept import read_units
from fiberloom.errors import InputError
from fiberloom.instruments import read_layout
from fiberloom.metrology import read_spots
from fiberloom.planning import read_configuration, read_plans, verify
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.learnt import LearntHistory, generations
from fiberloom.store.listing import runs_below
from fiberloom.tables import read_table
from fiberloom.targets import read_targets

THREE_MEGARA = fl.FocalPlane.of("megara", seed=0, n=3)
DESI, MEGARA = fl.Instrument.of("desi"), fl.Instrument.of("megara")

CPU_S = 20.0
"""A file that takes longer is an endless one."""


class Endless(BaseException):
    """The reader did not come back."""


def read_trajectories(path: Path) -> None:
    for plan in read_plans(path, PLANE):
        verify(PLANE, plan)


def read_arms(path: Path) -> None:
    arms = ArmsFile.read(path, PLANE)
    arms.calibrated()
    arms.covariance_mm2()


def read_maps(path: Path) -> None:
    maps = fl.TransmissionMaps.read(path)
    assert np.isfinite(maps.to_wire(90.0)).all()
    assert np.isfinite(maps.backlash_motor_deg(90.0)).all()


def read_store(path: Path) -> None:
    runs_below(str(path))
    with Store.open(path, create=False) as store:
        for run in store.runs():
            for ask in (store.measurements, store.moves, store.events, store.calibrations):
                ask(run.id)
        for generation in generations(store):
            LearntHistory(store, generation.origin).latest()
        book = ArrayBook(store, "bus")
        book.state()
        book.exclusions(past=True)
        book.places(book.known_positioners())


def read_centroids(path: Path) -> None:
    spots = fl.centroid(path)
    assert np.isfinite(spots.xy_px).all()
    assert np.isfinite(spots.flux_e).all()


READERS: dict[str, Callable[[Path], object]] = {
    "targets.csv": read_targets,
    "targets.ecsv": read_targets,
    "targets.fits": read_targets,
    "targets.par": read_targets,
    "targets.par.gz": read_targets,
    "configuration.csv": lambda path: read_configuration(path, PLANE),
    "layout/layout.toml": lambda path: read_layout(path.parent, PLANE.instrument),
    "layout/positioners.ecsv": lambda path: read_layout(path.parent, PLANE.instrument),
    "layout/fiducials.ecsv": lambda path: read_layout(path.parent, PLANE.instrument),
    "sdssv/positionerTable.csv": lambda path: read_layout(path.parent, PLANE.instrument),
    "sdssv/wokCoords.csv": lambda path: read_layout(path.parent, PLANE.instrument),
    **dict.fromkeys(
        (
            "desi/calib-20260101.csv",
            "desi/petal-alignments.yaml",
            "desi/focal_surface_lookup.csv",
            "desi/fp-metrology.csv",
        ),
        lambda path: read_layout(path.parent, DESI),
    ),
    **dict.fromkeys(
        (
            "pfs/pfs_6_cobras_scalars.csv",
            "pfs/black_dots_mm-2024-01-01.csv",
            "pfs/fiducial_positions_20240101.csv",
        ),
        lambda path: read_layout(path.parent, SMALL_PFS),
    ),
    "megara/derived_megara_3_rps.csv": lambda path: read_layout(path.parent, MEGARA),
    "module.xml": read_module_maps,
    "instrument.toml": lambda path: fl.FocalPlane.of(path, n=7),
    "site.toml": lambda path: load_site(path).defaults(),
    "maps.npz": read_maps,
    "units.npz": lambda path: read_units(path, THREE_MEGARA),
    "trajectories.json": read_trajectories,
    "arms.ecsv": read_arms,
    "fibres.ecsv": read_table,
    "offsets.ecsv": lambda path: FibreOffsets.load(path).applied(PLANE),
    "exposures.ecsv": read_exposures,
    "spots.csv": read_spots,
    "image.fits": read_centroids,
    "float.fits": read_centroids,
    "tiles.fits": read_centroids,
    "image.fits.gz": read_centroids,
    "store.sqlite": read_store,
}


@dataclass
class Outcome:
    """Of one mutated file."""

    kind: str
    """read, refused, or what went wrong."""
    what: str = ""

    @property
    def good(self) -> bool:
        return self.kind in ("read", "refused")


def attempt(read: Callable[[Path], object], path: Path) -> Outcome:
    """Reads one file; a refusal must be one line that names the file."""
    signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            read(path)
    except InputError as error:
        words = str(error)
        sound = "\n" not in words and len(words) < 2000
        return Outcome("refused") if sound else Outcome("not one line", words[:3000])
    except Exception as error:
        return Outcome(type(error).__name__, traceback.format_exc(limit=-6))
    except Endless:
        return Outcome("endless", traceback.format_exc(limit=-6))
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return Outcome("read")


class Fuzzer:
    """One reader, its valid file, and a folder for the mutated ones."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.read = name, READERS[name]
        self.path = folder / name
        self.path.parent.mkdir(parents=True, exist_ok=True)
        WRITERS[name](self.path)
        self.valid = self.path.read_bytes()

    def content(self, number: int) -> bytes:
        """The mutated file of this number."""
        rng = np.random.default_rng(seed_of(self.name, number))
        return (page_mutated if self.name.endswith(".sqlite") else mutated)(self.valid, rng)

    def attempt(self, number: int) -> Outcome:
        """Writes and reads it."""
        for beside in ("-wal", "-shm"):
            self.path.with_name(self.path.name + beside).unlink(missing_ok=True)
        self.path.write_bytes(self.content(number))
        return attempt(self.read, self.path)

    def restore(self) -> None:
        """The valid file again, beside which others are read."""
        self.path.write_bytes(self.valid)


def on_time(signum: int, frame: object) -> None:
    raise Endless


def fuzz(name: str, numbers: range, keep: Path | None = None) -> Counter[str]:
    """Counts by kind of outcome; what is wrong is printed, and kept in the folder `keep`."""
    signal.signal(signal.SIGVTALRM, on_time)
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(name, Path(folder))
        first = attempt(fuzzer.read, fuzzer.path)
        assert first.kind == "read", f"{name}: the valid file is not read: {first.what}"
        for number in numbers:
            outcome = fuzzer.attempt(number)
            count[outcome.kind] += 1
            if outcome.good:
                continue
            if count[outcome.kind] <= 3:
                print(f"{name} {number}: {outcome.kind}\n{outcome.what}", flush=True)
            if keep is not None:
                kept = keep / f"{number}-{name.replace('/', '-')}"
                keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(fuzzer.path, kept)
    return count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=100_000, help="in all, the same for each reader")
    parser.add_argument("--seed", type=int, default=0, help="number of the first file of each reader")
    parser.add_argument(
        "--only", default="", help="readers, separated by commas; part of their names will do"
    )
    parser.add_argument("--keep", type=Path, default=Path("build/fuzz"))
    asked = parser.parse_args()
    faulthandler.enable()  # a crash tells where
    names = [n for n in READERS if any(part in n for part in asked.only.split(","))]
    each, wrong, total = -(-asked.files // len(names)), 0, 0
    for name in names:
        count = fuzz(name, range(asked.seed, asked.seed + each), asked.keep)
        bad = {kind: n for kind, n in count.items() if kind not in ("read", "refused")}
        wrong, total = wrong + sum(bad.values()), total + each
        print(
            f"{name:28} {each:7} files: {count['read']:6} read, {count['refused']:6} refused, {bad or 0}",
            flush=True,
        )
    print(f"{total} mutated files of {len(names)} kinds: {wrong} neither read nor refused in one line")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
