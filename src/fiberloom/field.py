"""The facade: a focal plane that is calibrated and observed, on hardware or on the twin."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from fiberloom.blocking import finish
from fiberloom.bus.transport import Transport
from fiberloom.calibration.focal_plane.survey_data import SurveyData
from fiberloom.calibration.transmission.cache import load_for
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.calibration.transmission.sweep import Calibration, SweepSettings, calibration_of
from fiberloom.connect import open_hardware, twin_source
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.operation.known import known_so_far
from fiberloom.operation.motion import FieldMotion, MotionMaker
from fiberloom.operation.observe import STORE, ObserveOptions, Observer, Silent, Watcher, asked
from fiberloom.operation.recording import SurveyRecorder
from fiberloom.operation.reference.referencing import reference
from fiberloom.operation.results import Observation
from fiberloom.operation.safety.writing import beside, entered
from fiberloom.operation.session.session import KnownArray, Session
from fiberloom.operation.session.states import Deed
from fiberloom.operation.session.witness import Witness
from fiberloom.operation.source import OutsideArray, Source
from fiberloom.operation.survey import FocalPlaneCalibration, SurveySettings, survey, survey_of_store
from fiberloom.operation.sweep.array_sweep import THICKER_MM, ArraySweep
from fiberloom.operation.sweep.kept import KeptSweep
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.place import RUNS, Place
from fiberloom.targets import TargetList

POINTS = 200
"""Of a transmission sweep, per axis and direction, as the paper's Fig. 10."""


class Field:
    """A focal plane with its bus and its camera: calibrate it, then observe target lists.

    Made by `Field.twin`, where no hardware is needed, or by `Field.open`. Both give this class, and all
    that follows is the same: frames on the bus, positions from the camera.

    Parameters
    ----------
    plane : FocalPlane
        The layout.
    source : Source
        Where bus and camera come from.
    seed : int
        Decides whatever is drawn: between equal assignments and plans, and a twin's units and noise.
    calibration : str or Path, optional
        File of transmission maps.

    Attributes
    ----------
    run : FieldRun
        The same methods without `await`, where no event loop runs.
    watcher : Watcher
        Is told what is being done; silent unless you set one.
    command_line : str
        How the record names its runs.
    keep : callable
        Called with every observation that has ended well, before its run counts as finished, e.g. to save it.
    maps : TransmissionMaps or None
        The maps in use, once there are some.
    maps_file : Path or None
        Their file.
    book : ArrayBook or None
        What a store keeps of the array: with it an observation owns the array while it lasts, leaves
        excluded positioners where they are, and keeps where each was left.
    exclude : tuple of int
        Positioners that are left out now; with a `book`.
    witness : Witness or None
        Told of moves while they are made; with a `book`.
    begun_s : float or None
        Since when an observation takes its time, of ``time.monotonic()``; None: since its call.

    Examples
    --------
    >>> import fiberloom as fl
    >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
    >>> field
    Field('sdssv', 7 positioners, on the twin, not calibrated)
    >>> seen = field.run.observe(fl.read_targets("targets.csv"), corrections=1)
    >>> field.last is seen
    True
    """

    def __init__(
        self, plane: FocalPlane, source: Source, seed: int = 0, calibration: str | Path | None = None
    ) -> None:
        self.plane, self.source, self.seed = plane, source, seed
        self.calibration_file = None if calibration is None else Path(calibration)
        self.maps: TransmissionMaps | None = None
        self.maps_file: Path | None = None
        self.run = FieldRun(self)
        self.watcher: Watcher = Silent()
        self.command_line = "fiberloom.Field"
        self.keep: Callable[[Observation], None] = lambda _: None
        self.book: ArrayBook | None = None
        self.exclude: tuple[int, ...] = ()
        self.begun_s: float | None = None
        self.witness: Witness | None = None
        self._points = 0
        self._observer: Observer | None = None

    @classmethod
    def twin(
        cls,
        plane: FocalPlane,
        seed: int = 0,
        camera: str = "image",
        faults: str = "",
        calibration: str | Path | None = None,
        errors: str = "none",
    ) -> Field:
        """A field on the twin: true units drawn from the seed, with the real firmware in them.

        Parameters
        ----------
        plane : FocalPlane
            The layout as the host knows it.
        seed : int
            The one seed of everything random; the same seed gives the same numbers.
        camera : str
            ``"image"``: images are rendered, searched and matched. ``"noise"``: true positions with the
            camera's noise; quicker.
        faults : str
            What goes wrong, e.g. ``"dark=3,dead=1,lying=1"``.
        calibration : str or Path, optional
            File of transmission maps; when left out, the twin is swept once and its maps are cached.
        errors : str
            What is off its tables, as in a real array: ``"none"``, ``"all"``, or some with factors on
            their sizes, e.g. ``"fibre=2,fiducial"``; docs/twin/errors.md lists them.

        Returns
        -------
        Field
            Folded and at rest.

        Raises
        ------
        InputError
            The twin does not drive this instrument, or does not know the camera or a fault.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), faults="dark=1")
        Field('sdssv', 7 positioners, on the twin, not calibrated)
        >>> fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="film")
        Traceback (most recent call last):
        fiberloom.errors.InputError: --camera film: known are noise, image
        """
        return cls(plane, twin_source(plane, seed, camera, faults, errors), seed, calibration)

    @classmethod
    def open(
        cls,
        plane: FocalPlane,
        bus: str | Transport,
        camera: Any,
        calibration: str | Path | None = None,
        seed: int = 0,
    ) -> Field:
        """A field of real positioners. The bus is connected when something moves, not before.

        Parameters
        ----------
        plane : FocalPlane
            The layout as built, e.g. of `FocalPlane.read`.
        bus : str or Transport
            ``"cannet://HOST:PORT[,HOST:PORT...]"`` for CAN@net gateways, ``"socketcan:can0,can1"`` or any
            ``"INTERFACE:CHANNEL"`` of python-can, or an open transport, which stays open. ``"twin:"`` is
            the twin inside of this process.
        camera : str or Camera
            ``"alpaca://HOST:PORT/0"``, ``"folder:PATH?trigger=COMMAND"``, ``"indi://HOST:PORT/NAME"``,
            ``"aravis:NAME"``, or an object with ``measure(expected_mm) -> Measurement``: positions (N, 2)
            in mm.
        calibration : str or Path, optional
            File of transmission maps, e.g. of `TransmissionMaps.save`; when left out, the nominal ratio of
            the gears is used, with which blind moves miss by some 0.1 mm.
        seed : int
            Decides between equally good assignments and plans.

        Returns
        -------
        Field
            Not connected yet.

        Raises
        ------
        InputError
            The address cannot be read, or the camera is not one.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> fl.Field.open(plane, bus="cannet://10.1.10.31,10.1.10.32:19229", camera="alpaca://sky:11111/0")
        Field('sdssv', 7 positioners, on hardware, not calibrated)
        """
        return cls(plane, open_hardware(plane, bus, camera, seed=seed), seed, calibration)

    @property
    def folder(self) -> Path | None:
        """Where the files of the last `observe` are, or belong; None before the first.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).folder is None
        True
        """
        return None if self._observer is None else self._observer.folder

    def __repr__(self) -> str:
        where = "on hardware" if isinstance(self.source, OutsideArray) else "on the twin"
        known = "not calibrated" if self.maps is None else "calibrated"
        return f"Field({self.plane.instrument.name!r}, {len(self.plane)} positioners, {where}, {known})"

    @property
    def last(self) -> Observation | None:
        """What the last `observe` has measured, also where it was interrupted; None before the first.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).last is None
        True
        """
        return None if self._observer is None else self._observer.last

    async def calibrate(self, points: int = POINTS) -> TransmissionMaps:
        """The transmission maps of this field: from its file, from the cache, or swept now.

        Parameters
        ----------
        points : int
            Of a sweep, per axis and direction. 200 points of 500 units take some minutes, once.

        Returns
        -------
        TransmissionMaps
            Rows in the order of the plane; also `maps` from now on.

        Raises
        ------
        InputError
            A file of maps that is broken or lacks a positioner.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7))
        >>> field.run.calibrate()
        TransmissionMaps(7 positioners, 200 knots, gear 1024)
        """
        if self.maps is None or points != self._points:
            self.maps, self.maps_file = await self._find_maps(points)
            self._points = points
        return self.maps

    async def _find_maps(self, points: int) -> tuple[TransmissionMaps, Path | None]:
        if not self.plane.instrument.drive.by_maps:
            if self.calibration_file is not None:
                self.source.know(self.calibration_file)
            return nominal_maps(self.plane), None
        if self.calibration_file is not None:
            return load_for(self.plane, self.calibration_file), self.calibration_file
        if isinstance(self.source, OutsideArray):
            self.watcher.say("no calibration given: the nominal ratio of the gears is used")
            return nominal_maps(self.plane), None
        cached = self.source.maps_file(points)
        if cached is not None and cached.exists():
            return load_for(self.plane, cached), cached
        found = await self.sweep(points)
        if cached is not None:
            with contextlib.suppress(InputError):  # where nothing can be kept, sweep again next time
                found.maps.save(cached)
        return found.maps, cached

    async def sweep(
        self,
        points: int = POINTS,
        *,
        out: str | Path = RUNS / "transmission",
        keep: Callable[[Calibration], None] = lambda _: None,
    ) -> Calibration:
        """Sweeps every positioner, whatever is cached, and reports how good its map is.

        A twin is swept on a bench. An array is swept where it is: all turn together, after the begin check,
        by verified steps; who does not move is gone round. One that was stopped goes on with the next call:
        every point is kept in `out` until the sweep has ended.

        Parameters
        ----------
        points : int
            Per axis and direction, at least 8.
        out : str or Path
            Folder of the record of an array.
        keep : callable
            Called with the calibration before what was kept of the points goes, e.g. to save it.

        Returns
        -------
        Calibration
            Maps, report (a reason where a positioner has no map) and what was measured.

        Raises
        ------
        InputError
            Too few points; no positioner answers; none can be swept, or the sweep is stopped again and
            again; the folder holds a part of the sweep of another array, or by another camera.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=1))
        >>> found = field.run.sweep(points=16)
        >>> bool(found.report.ok.all())
        True
        """
        if not self.plane.instrument.drive.by_maps:
            kind = self.plane.instrument.drive.protocol
            raise InputError(
                f"{self.plane.instrument.name}: no transmission maps with drive.protocol = '{kind}'"
            )
        self.watcher.say("calibrating transmissions")
        if (on_bench := await self.source.sweep(points, self.watcher.count)) is not None:
            keep(on_bench)
            return on_bench
        folder, settings = prepare_folder(Path(out)), SweepSettings(points)
        kept = await beside(KeptSweep.open, folder, self._about_sweep(settings))
        if kept.done:
            self.watcher.say(f"{kept.done} points were measured before: the sweep goes on")
        found = await self._swept_in_place(settings, folder, kept)
        await beside(keep, found)
        await beside(kept.forget)
        return found

    def _about_sweep(self, settings: SweepSettings) -> dict[str, str]:
        """What a sweep that goes on must have in common with its begin."""
        named = self.source.named() if isinstance(self.source, OutsideArray) else {}
        return {**named, "layout": self.plane.config_hash(), "number of points": str(settings.n_points)}

    async def _swept_in_place(self, settings: SweepSettings, folder: Path, kept: KeptSweep) -> Calibration:
        maps = nominal_maps(self.plane)
        async with contextlib.AsyncExitStack() as stack:
            plane, make = await self._held(stack, self.plane, maps)
            recorder = await self._recorder(stack, folder)
            hardware = await self.source.open()
            wide = plane.with_collision_buffer(plane.collision_buffer_mm + THICKER_MM)
            motion = make(wide, maps, hardware, recorder, self.watcher.say)
            motion.state.looser_mm = THICKER_MM
            try:
                await motion.connect()
                await reference(motion)
                data = await ArraySweep(motion, settings, self.watcher.count, kept).run()
            finally:
                await motion.close()
        return calibration_of(self.plane, data, settings)

    async def _held(
        self, stack: contextlib.AsyncExitStack, plane: FocalPlane, maps: TransmissionMaps
    ) -> tuple[FocalPlane, MotionMaker]:
        """Layout without what is excluded, and motion; an array with a book is owned until the stack ends."""
        if self.book is None:
            return plane, FieldMotion
        session = await beside(self._session, plane, maps, self.book)
        held = await stack.enter_async_context(session.owning(Deed.CALIBRATE))
        return session.plane, held.motion

    def _session(self, plane: FocalPlane, maps: TransmissionMaps, book: ArrayBook) -> Session:
        array = KnownArray(plane, maps, self.source, book)
        return Session(array, self.command_line, self.watcher.say, self.exclude, self.witness)

    async def _recorder(self, stack: contextlib.AsyncExitStack, folder: Path) -> SurveyRecorder:
        store = await stack.enter_async_context(entered(Store.open, folder / STORE))
        run = await stack.enter_async_context(entered(self._survey_run, store))
        return SurveyRecorder(run, self.plane)

    async def observe(
        self,
        targets: TargetList,
        corrections: int | None = None,
        *,
        out: str | Path | Place | None = None,
        **options: Unpack[ObserveOptions],
    ) -> Observation:
        """Puts fibres on targets: assign, plan, verify, blind move, image, corrections.

        Every move is in the record (``store.sqlite``) before the next one begins, and in `last`
        if this is interrupted: nothing that was measured is lost.

        Parameters
        ----------
        targets : TargetList
            What to look at; mm in the focal plane.
        corrections : int, optional
            Moves after the blind one, exactly so many; when left out, the instrument's stop rule says when
            it is enough.
        out : str, Path or Place, optional
            Folder of the record, and of pages where they are asked for. When left out the record is
            ``runs/store.sqlite``, and the folder is named after the run's number in it: ``runs/0001``.
        **options
            By name; see below.

        Returns
        -------
        Observation
            How near every fibre came.

        Other Parameters
        ----------------
        correction : str, optional
            ``"filtered"`` (Kalman) or ``"plain"`` (Kronig 2020, Eq. 25); default: the instrument's.
        images : int, optional
            After each move, at most; default: the instrument's.
        compare_linear : bool
            Measure a blind move by a linear gear ratio too, at the end.
        strict : bool
            No number of targets outweighs one of a higher priority.
        exposures : int
            Of a series on the sky; between them fibres follow their targets.
        swap : bool
            Choose, of equally good assignments, that of the shortest ways from where the positioners say they
            are, and swap targets where the motion is held up.
        arms : str or Path, optional
            File of `survey`: arms in place of the layout's.
        fibres : str, optional
            File of `fiberloom calibrate fibres`: where the science fibres are on their arms.
        gravity : str, optional
            File of `fiberloom calibrate gravity`: by how much the arms sag; with `pointing`.
        pointing : ExposurePointing, optional
            Of the telescope, at the image and while light is collected; a twin's in the zenith when left out.
        adapt : bool
            Learn the maps from every measured move.
        learnt : str, optional
            Store with what was learnt; with `adapt` a file beside the maps when left out.
        pages : str
            Exposures that get pages to look at: ``"none"``, ``"last"`` or ``"all"``.
        save_images : bool
            Keep every exposure as FITS.

        Raises
        ------
        InputError
            The folder cannot be written, a file cannot be read, no positioner answers, the camera is dark.

        Examples
        --------
        >>> import fiberloom as fl
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> field.run.observe(fl.read_targets("targets.csv"), corrections=2)
        Observation('sdssv', 7 positioners, 7 with a target, 3 moves, 7 within 5 um)
        """
        place = Place.of(out)
        folder = prepare_folder(place.base)
        settings, learning = asked(corrections, options, self.seed, place.store)
        moves = None if corrections is None else 1 + corrections
        if learning.adapt and not self.plane.instrument.drive.by_maps:
            learning = learning.kept_by(self.source, self.calibration_file)
        maps = await self.calibrate(self._points or POINTS)
        maps_file = self.maps_file or folder / "maps.npz"
        known = await beside(known_so_far, self.plane, maps, maps_file, learning)
        self._observer = Observer(
            self.plane, known, place, self.command_line, self.source.about(), self.watcher, self.keep
        )
        self._observer.begun_s = self.begun_s
        if self.book is None:
            await known.ask(self.source, self.watcher.say, moves)
            return await self._observer.observe(targets, settings, self.source.open)
        session = await beside(self._session, known.plane, known.maps, self.book)
        known.plane = session.plane
        async with session.owning(Deed.OBSERVE) as held:
            self._observer.motion = held.motion
            await known.ask(self.source, self.watcher.say, moves)
            return await self._observer.observe(targets, settings, self.source.open)

    async def survey(
        self,
        settings: SurveySettings | None = None,
        *,
        guess: FocalPlane | None = None,
        measured: str | Path | None = None,
        out: str | Path = RUNS / "focal-plane",
    ) -> FocalPlaneCalibration:
        """Finds centre, arms and zeros of all positioners where they are mounted (Kronig 2020, Eq. 26).

        Parameters
        ----------
        settings : SurveySettings, optional
            How many configurations, and how wide the berth.
        guess : FocalPlane, optional
            The layout to begin with; `plane` when left out.
        measured : str or Path, optional
            Store of an earlier survey, also an interrupted one: nothing moves, its images are fitted.
        out : str or Path
            Folder of the record.

        Returns
        -------
        FocalPlaneCalibration
            Arms with their errors; its ``plane`` is the calibrated layout.

        Raises
        ------
        InputError
            As `observe`; the store holds nothing that was measured.

        Examples
        --------
        >>> import fiberloom as fl
        >>> from fiberloom.operation.survey import SurveySettings
        >>> field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
        >>> found = field.run.survey(SurveySettings(configurations=8))
        >>> found.summary()["calibrated"]
        7
        """
        folder, settings = prepare_folder(Path(out)), settings or SurveySettings(seed=self.seed)
        maps, begun = await self.calibrate(self._points or POINTS), guess or self.plane
        if measured is None:
            data = await self._surveyed(begun, maps, settings, folder)
        else:
            with Store.read(measured) as store:
                data = survey_of_store(store, self.plane, maps)
        self.watcher.say("fitting")
        stamp = marks(self.plane, self.seed)
        return FocalPlaneCalibration.of(begun, data, settings, stamp, self.source.true_plane)

    async def _surveyed(
        self, begun: FocalPlane, maps: TransmissionMaps, settings: SurveySettings, folder: Path
    ) -> SurveyData:
        self.watcher.say("moving and looking")
        async with contextlib.AsyncExitStack() as stack:
            begun, make = await self._held(stack, begun, maps)
            recorder = await self._recorder(stack, folder)
            hardware = await self.source.open()
            chosen = replace(settings, motion=make) if self.book is not None else settings
            return await survey(begun, maps, hardware, chosen, recorder, self.watcher.count)

    def _survey_run(self, store: Store) -> Any:
        return store.start_run(
            command_line=self.command_line,
            instrument=self.plane.instrument.name,
            config_hash=self.plane.config_hash(),
            seed=self.seed,
        )


class FieldRun:
    """The methods of a field without `await`, for scripts: `field.run.observe(...)`."""

    def __init__(self, field: Field) -> None:
        self._field = field

    def calibrate(self, points: int = POINTS) -> TransmissionMaps:
        """As `Field.calibrate`."""
        return finish(self._field.calibrate(points))

    def sweep(
        self,
        points: int = POINTS,
        *,
        out: str | Path = RUNS / "transmission",
        keep: Callable[[Calibration], None] = lambda _: None,
    ) -> Calibration:
        """As `Field.sweep`: `points`, `out`, `keep`."""
        return finish(self._field.sweep(points, out=out, keep=keep))

    def observe(
        self,
        targets: TargetList,
        corrections: int | None = None,
        *,
        out: str | Path | None = None,
        **options: Unpack[ObserveOptions],
    ) -> Observation:
        """As `Field.observe`: `targets`, `corrections`, `out` and its `options`."""
        return finish(self._field.observe(targets, corrections, out=out, **options))

    def survey(
        self,
        settings: SurveySettings | None = None,
        *,
        guess: FocalPlane | None = None,
        measured: str | Path | None = None,
        out: str | Path = RUNS / "focal-plane",
    ) -> FocalPlaneCalibration:
        """As `Field.survey`: `settings`, `guess`, `measured`, `out`."""
        return finish(self._field.survey(settings, guess=guess, measured=measured, out=out))
