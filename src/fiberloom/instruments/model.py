"""What an instrument is: the numbers that a designer chooses, checked against each other.

Nothing here knows a particular instrument. Lengths in mm, angles in deg, errors in um; the frames
are those of docs/conventions.md.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from fiberloom.instruments.array import MOST_POSITIONERS as MOST_POSITIONERS
from fiberloom.instruments.array import Dots as Dots
from fiberloom.instruments.array import Layout as Layout
from fiberloom.instruments.array import Modules as Modules
from fiberloom.instruments.array import Scatter as Scatter
from fiberloom.instruments.array import UnitScatter as UnitScatter
from fiberloom.instruments.axis import Axis as Axis
from fiberloom.instruments.axis import DriveTable as DriveTable
from fiberloom.instruments.axis import Range, protocol_of
from fiberloom.instruments.outlines import KeepOut, Outline
from fiberloom.instruments.table import Finite, NotNegative, Positive, Table
from fiberloom.instruments.telescope.tables import PolynomialOptics as PolynomialOptics
from fiberloom.instruments.telescope.tables import RadialOptics as RadialOptics
from fiberloom.instruments.telescope.tables import RaytraceOptics as RaytraceOptics
from fiberloom.instruments.telescope.tables import SkyTable as SkyTable
from fiberloom.instruments.telescope.tables import SphereOptics as SphereOptics
from fiberloom.instruments.telescope.tables import SubaruOptics as SubaruOptics
from fiberloom.instruments.telescope.tables import TelescopeSite as TelescopeSite
from fiberloom.instruments.telescope.tables import WeatherTable as WeatherTable
from fiberloom.units import AXES as AXES

MOST_SIDE_PX = 50_000
"""Of a camera's image."""

METROLOGY = "metrology"

BODY_SHARE = 0.75
"""Radius of the real beta arm over the collision buffer that planning keeps: 1.5 mm for 2.0 mm at
SDSS-V (assumed; the arm's tube)."""
"""Name of the point that the camera sees, in every plane that has one."""


class Point(Table):
    """A fibre tip on the beta arm: x along the arm from the beta axis, y to its left."""

    x_mm: Finite
    y_mm: Finite = 0.0
    role: Literal["metrology", "science"]
    fraction: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the positioners that carry this fibre."""


class Positioner(Table):
    """Geometry of the nominal positioner."""

    l_alpha_mm: Positive
    """Distance between the two axes."""
    park_deg: Range
    """Folded place (alpha, beta) of a positioner that has nothing to do."""
    points: dict[str, Point]
    """Fibre tips by name."""

    @model_validator(mode="after")
    def _points(self) -> Self:
        roles = [p.role for p in self.points.values()]
        if "science" not in roles:
            raise ValueError("points: at least one fibre needs role = 'science'")
        for name, point in self.points.items():
            if point.role == METROLOGY and (name != METROLOGY or point.fraction != 1.0):
                raise ValueError(
                    f"points.{name}: the one metrology fibre is named 'metrology' and "
                    "every positioner has it (fraction 1)"
                )
            if point.role == "science" and name == METROLOGY:
                raise ValueError("points.metrology: role must be 'metrology'")
        return self


class Bodies(Table):
    """What can collide, seen from above: capsules and discs in the focal plane."""

    beta_segment_mm: Range
    """Centre line of the beta arm's capsule, from and to, along the arm from the beta axis."""
    collision_buffer_mm: Positive
    """Radius of that capsule."""
    collision_shrink_mm: NotNegative = 0.0
    """By how much that radius may shrink for a configuration that was decided elsewhere."""
    fiducial_radius_mm: NotNegative
    """0: no arm can touch a fiducial."""
    guide_camera_radius_mm: Positive = 1.0
    parts: tuple[Outline, ...] = ()
    """What planner and verifier take for a positioner; none: that capsule. Another collision buffer makes
    them wider or narrower by the difference."""
    keep_outs: tuple[KeepOut, ...] = ()
    """Where no arm may be: edges of the field and of its parts."""

    @model_validator(mode="after")
    def _segment(self) -> Self:
        if not self.beta_segment_mm[0] < self.beta_segment_mm[1]:
            raise ValueError(f"beta_segment_mm {list(self.beta_segment_mm)}: from must be below to")
        if self.collision_shrink_mm >= self.collision_buffer_mm:
            raise ValueError(
                f"collision_shrink_mm {self.collision_shrink_mm} must be below "
                f"collision_buffer_mm {self.collision_buffer_mm}"
            )
        if self.parts and all(part.arm == "alpha" for part in self.parts):
            raise ValueError("parts: at least one on the beta arm")
        return self

    def reach_mm(self, arm: str) -> float:
        """The farthest point of a body from the axis of its arm, "alpha" or "beta"; 0 where there is none."""
        plain = max(map(abs, self.beta_segment_mm)) + self.collision_buffer_mm
        own = [part.reach_mm for part in self.parts if part.arm == arm]
        return max([plain, *own] if arm == "beta" else own, default=0.0)


class Metrology(Table):
    """The camera that looks at the fibres."""

    present: bool
    noise_rms_um: NotNegative = 0.0
    """Repeatability on a static fibre, two-dimensional rms."""
    sees: str = METROLOGY
    """Name of the point it sees."""


class CameraTable(Table):
    """What the host knows of the camera before it has seen an image; the rest it finds in images."""

    width_px: Annotated[int, Field(ge=64, le=MOST_SIDE_PX)]
    height_px: Annotated[int, Field(ge=64, le=MOST_SIDE_PX)]
    scale_mm_px: Positive
    """Focal-plane millimetres on a pixel, in the middle of the field."""
    rotation_deg: Finite = 0.0
    """Direction in the focal plane of the pixel x axis."""
    flipped: bool = False
    """True: y in the image runs against y in the focal plane, at rotation 0."""
    field_radius_mm: Positive
    """Of the disc on which the terms of the distortion are orthonormal."""
    turn_tolerance_deg: Positive = 15.0
    """How far it may be turned from there, by a rotator or by how it hangs."""
    shift_tolerance_mm: Positive = 20.0
    """How far it may be shifted: below the pitch where fibres at home make a lattice like fiducials."""
    distortion_reach_mm: Positive = 3.0
    """How far distortion bends the image across a part of the field, at most."""
    fiducial_sigma_um: NotNegative = 0.0
    """How well the fiducials' places are known, per coordinate; 0: better than the camera."""
    terms: Literal["all", "found"] = "found"
    """Zhao-Burge terms of its distortion: all 34, or those that predict fiducials of the first image best."""
    turbulence: bool = False
    """Is there air to be taken off by a Gaussian process?"""
    exposure_s: Positive = 1.0


class OwnRequirement(Table):
    """What an instrument's makers publish of the accuracy of a field, in their own terms."""

    statistic: Literal["max", "rms", "share"]
    """What is bounded: the worst or the rms error of healthy fibres, or the share of all assigned fibres that
    are `within_um`."""
    within_um: Positive
    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """For the statistic of that name."""
    within_s: Positive | None = None
    """The time in which that must be reached, from the first motion to the last image; None: any."""
    source: str

    @property
    def words(self) -> str:
        """In words: `95 % within 10 um, in 120 s`."""
        what = (
            f"{100.0 * self.share:g} % within" if self.statistic == "share" else f"{self.statistic} at most"
        )
        return f"{what} {self.within_um:g} um" + (f", in {self.within_s:g} s" if self.within_s else "")


class Operation(Table):
    """What counts as done, and how to get there."""

    requirement_um: Positive
    """Largest distance of a fibre from its target that the instrument accepts (Kronig 2020, Table 1)."""
    required_share: Annotated[float, Field(ge=0, le=1)] = 0.95
    """Of the assigned fibres, faulty ones included, that must keep it; else `observe` ends with 1."""
    own: OwnRequirement | None = None
    """What its makers publish, in their own terms; `reproduce table1` holds a field against both."""
    corrections_max: Annotated[int, Field(ge=0)]
    """Correction moves after the blind move, at most; 0 without a camera."""
    images_max: Annotated[int, Field(ge=1, le=100)] = 1
    """Images after each move, at most: as many as the noise of the camera asks for."""
    stop_rule: Literal["fixed", "percentile", "positioner"] = "fixed"
    """fixed: always corrections_max. percentile: end once the measured percentile is within the
    limit. positioner: one within the limit is not moved again; end when none is outside."""
    stop_percentile: Annotated[float, Field(gt=0, le=100)] = 100.0
    """Of the fibres with a target that are seen and healthy; for the rule of that name."""
    stop_below_um: Positive | None = None
    """The limit, as measured; the requirement when left out."""
    correction: Literal["plain", "filtered"] = "filtered"
    """plain: Kronig 2020 Eq. 25. filtered: measurements of all moves weighed by Eq. 31."""
    camera_retries: Annotated[int, Field(ge=0)] = 5
    """Further tries where no image comes after a move, before the command ends; the camera's own retries
    come before each."""
    camera_wait_s: Annotated[float, Field(ge=0)] = 10.0
    """Between them; nothing moves meanwhile."""


class Acceptance(Table):
    """What a unit must show on a bench before it goes into the focal plane; None: not asked for."""

    source: str = ""
    """Origin of the requirement."""
    repeatability_um: Positive | None = None
    """In x and y, rms, arm stretched."""
    hysteresis_deg: Positive | None = None
    """Between both contacts, largest: the backlash at the output."""
    non_linearity_deg: Positive | None = None
    """Largest deviation of an axis from its nominal ratio."""
    non_linearity_slope: Positive | None = None
    """Its largest change per angle, over steps of a turn / 183 (deg/deg)."""
    arm_deviation_mm: Positive | None = None
    """Of either arm from the nominal length."""
    blind_error_um: Positive | None = None
    """Largest distance from the target after a move without correction."""
    moves: Annotated[int, Field(ge=1)] | None = None
    """Until every target is within operation.requirement_um, the blind move counted."""
    tilt_deg: Positive | None = None
    """Of the fibre; a camera from above cannot see it."""


class ColdRule(Table):
    """What is asked of the motors below a temperature."""

    below_C: Finite
    speed_rpm: Positive
    """Largest motor speed of plans and of go-to moves."""
    holding_percent: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    """Holding current of alpha and beta, of the full field."""


class Care(Table):
    """What motors and supply may be asked for. The defaults ask for no care."""

    host_timeout_s: NotNegative = 0.0
    """A trajectory slows to a stop so long after the host's last frame; 0: it runs to its verified end."""
    moves_max: Annotated[int, Field(ge=1)] | None = None
    """Moves that a positioner may begin within `moves_window_s`."""
    moves_window_s: Positive = 600.0
    supply_A: Positive | None = None
    """Current for all motors together."""
    motor_friction_A: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    """Of an alpha and a beta motor that turns, however slowly."""
    motor_speed_A: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    """What the axis' `speed_deg_s` adds, in proportion to the speed."""
    temperature_zero_C: Finite = 0.0
    """Temperature at which command 132 answers 0."""
    temperature_C_per_count: Finite | None = None
    """None: what the bus reports has no known scale."""
    cold: tuple[ColdRule, ...] = ()
    """The lowest rule whose temperature is not reached counts."""

    @property
    def motor_most_A(self) -> tuple[float, float]:
        """Of an alpha and a beta motor at full speed."""
        alpha, beta = (f + s for f, s in zip(self.motor_friction_A, self.motor_speed_A, strict=True))
        return alpha, beta

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.supply_A is not None and not 0.0 < sum(self.motor_friction_A) <= self.supply_A:
            raise ValueError(
                f"supply_A {self.supply_A}: needs motor_friction_A, and must be enough for one positioner"
            )
        if self.cold and not self.temperature_C_per_count:
            raise ValueError("cold: needs temperature_C_per_count, the scale of command 132")
        return self


class Expansion(Table):
    """How arms grow with the temperature, in the frame of the fiducials' table: against the plate."""

    arms_per_K: Finite
    """Expansion of the arms less that of the plate, a ratio for each kelvin."""
    arms_per_K_sd: Positive
    """Standard deviation of that: how well it is known."""
    measured_C: Finite = 20.0
    """Temperature at which the arms of the layout were measured."""
    range_C: Range = (-30.0, 45.0)
    """What a thermometer can say; beyond, it is wrong."""


def _filled_scatter(data: dict[str, Any]) -> dict[str, Any]:
    """The table of the scatter of these tables, with the nominal alpha arm where it has no other mean."""
    scatter, positioner = data.get("scatter", {}), data.get("positioner")
    arm = scatter.get("l_alpha_mm", {}) if isinstance(scatter, dict) else None
    nominal = positioner.get("l_alpha_mm") if isinstance(positioner, dict) else None
    if not isinstance(arm, dict) or not isinstance(nominal, int | float):
        return {}
    return {"scatter": scatter | {"l_alpha_mm": {"mean": nominal} | arm}}


class Instrument(Table):
    """A whole instrument: arms, axes, bodies, metrology, layout, scatter of its units. Read-only.

    Made by `Instrument.of`. `docs/instruments.md` describes each table of the TOML file. `twin` belongs
    to the twin, which checks it when it draws units.

    Raises
    ------
    pydantic.ValidationError
        A number out of its range, or two that contradict each other; `Instrument.of` makes an InputError
        of it.

    Examples
    --------
    >>> import fiberloom as fl
    >>> instrument = fl.Instrument.of("sdssv")
    >>> instrument
    Instrument('sdssv', 500 positioners, requirement 5 um)
    >>> instrument.layout.pitch_mm, instrument.alpha.gear
    (22.4, 1024.0)
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")]
    description: str
    reference: str
    """Where the numbers come from."""
    positioner: Positioner
    alpha: Axis
    beta: Axis
    drive: DriveTable = DriveTable()
    """Left out: by the motors, `protocol_of`."""
    bodies: Bodies
    metrology: Metrology
    camera: CameraTable | None = None
    """Of the images; an instrument without this table is measured by a noise model alone."""
    operation: Operation
    acceptance: Acceptance | None = None
    care: Care = Care()
    expansion: Expansion | None = None
    """None: arms are taken as they were measured, whatever the temperature."""
    layout: Layout
    sky: SkyTable | None = None
    """None: targets are given in the focal plane alone."""
    scatter: UnitScatter = UnitScatter()
    twin: dict[str, Any] = Field(default_factory=dict)

    @classmethod
    def of(cls, name_or_toml: str | Path) -> "Instrument":
        """An instrument by name, or from a file of your own.

        Parameters
        ----------
        name_or_toml : str or Path
            A preset (`fiberloom instruments` lists them) or a TOML file.

        Returns
        -------
        Instrument

        Raises
        ------
        InputError
            Neither a preset nor a file, or the rules that the file breaks: key, value, rule of each.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Instrument.of("pfs").science_fibres
        ('fibre',)
        """
        from fiberloom import instruments  # built on this class

        return instruments.load_instrument(name_or_toml)

    def __repr__(self) -> str:
        return (
            f"Instrument({self.name!r}, {self.layout.n_positioners} positioners, "
            f"requirement {self.operation.requirement_um:g} um)"
        )

    __str__ = __repr__

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, data: Any) -> Any:
        """What is left out and follows from the rest."""
        if not isinstance(data, dict):
            return data
        protocol = protocol_of([data.get(axis) for axis in AXES])
        return {"drive": {"protocol": protocol}} | data | _filled_scatter(data)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Tables that contradict each other, all of them."""
        found = [*self._seen(), *self._alpha_parts(), *self._park()]
        if found:
            raise ValueError("; ".join(found))
        return self

    def _seen(self) -> Iterator[str]:
        sees, points = self.metrology.sees, self.positioner.points
        if self.metrology.present and sees not in points:
            yield f"metrology.sees = '{sees}': no such point in positioner.points {sorted(points)}"
        elif self.metrology.present and points[sees].fraction < 1:
            yield (
                f"metrology.sees = '{sees}': only a part of the positioners carries that fibre "
                "(fraction below 1)"
            )
        if not self.metrology.present and self.operation.corrections_max > 0:
            yield (
                f"operation.corrections_max = {self.operation.corrections_max}: "
                "corrections need a camera (metrology.present = true)"
            )
        if self.camera is not None and not self.metrology.present:
            yield "camera: there is none where metrology.present = false"

    def _alpha_parts(self) -> Iterator[str]:
        far = max([part.far_mm for part in self.bodies.parts if part.arm == "alpha"], default=0.0)
        if far > 0.5 * self.layout.pitch_mm:
            yield (
                f"bodies.parts: one on the alpha arm reaches {far:g} mm from its axis; at most half of "
                f"layout.pitch_mm = {self.layout.pitch_mm:g}: alpha arms of neighbours are not tested"
            )

    def _park(self) -> Iterator[str]:
        for axis, angle in zip(AXES, self.positioner.park_deg, strict=True):
            low, high = getattr(self, axis).target_range_deg
            if not low <= angle <= high:
                yield (
                    f"positioner.park_deg: {axis} {angle} is outside {axis}.target_range_deg {[low, high]}"
                )

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """Alpha and beta, in the order of AXES."""
        return self.alpha, self.beta

    @property
    def approach_deg(self) -> float:
        """From how far both axes come to their goals: the larger approach of the two, without its sign."""
        return max(abs(axis.approach_deg) for axis in self.axes)

    @property
    def approach_sides(self) -> tuple[float, float]:
        """From which side of their goals alpha and beta come: 1 from above, -1 from below."""
        return self.alpha.side, self.beta.side

    @property
    def least_approach_deg(self) -> float:
        """To which height an approach may be shortened: on both axes it still closes the backlash."""
        return max(axis.least_approach_deg for axis in self.axes)

    @property
    def science_fibres(self) -> tuple[str, ...]:
        """Names of the fibres that targets can ask for, in the order of the file."""
        return tuple(k for k, p in self.positioner.points.items() if p.role == "science")

    @property
    def seen_point(self) -> str:
        """Name of the point that represents the positioner in measurements."""
        points = self.positioner.points
        return self.metrology.sees if self.metrology.sees in points else self.science_fibres[0]

    @property
    def reach_mm(self) -> tuple[float, float]:
        """Inner and outer radius that the nominal science fibres reach over all beta in range."""
        radii = [
            self._radius_mm(p, b)
            for p in self.positioner.points.values()
            for b in self._extreme_beta_deg()
            if p.role == "science"
        ]
        return min(radii), max(radii)

    def _extreme_beta_deg(self) -> list[float]:
        low, high = self.beta.target_range_deg
        return [low, high, *(b for b in (-180.0, 0.0, 180.0) if low < b < high)]

    def _radius_mm(self, point: Point, beta_deg: float) -> float:
        direction = math.radians(beta_deg) + math.atan2(point.y_mm, point.x_mm)
        length = math.hypot(point.x_mm, point.y_mm)
        x = self.positioner.l_alpha_mm + length * math.cos(direction)
        return math.hypot(x, length * math.sin(direction))
