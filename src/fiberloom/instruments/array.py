"""The array: where positioners, fiducials and guide cameras are, and how units differ."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from fiberloom.instruments.axis import Range
from fiberloom.instruments.table import Finite, NotNegative, Positive, Table


class Scatter(Table):
    """A normal distribution, cut off at [min, max]; by default at 4 standard deviations."""

    mean: Finite = 0.0
    sd: NotNegative = 0.0
    min: Finite | None = None
    max: Finite | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Where the distribution is cut."""
        low = self.mean - 4 * self.sd if self.min is None else self.min
        high = self.mean + 4 * self.sd if self.max is None else self.max
        return low, high

    @model_validator(mode="after")
    def _mean_inside(self) -> Self:
        low, high = self.bounds
        if not low <= self.mean <= high:
            raise ValueError(f"mean {self.mean} must lie between min {low} and max {high}")
        return self


class GuideCameras(Table):
    """Cameras in a ring around the field; only the edge that faces the field can be touched."""

    number: Annotated[int, Field(ge=0, le=1000)]
    first_direction_deg: Finite
    """Direction of the first one from the centre of the field."""
    face_distance_mm: Positive
    """From the centre of the field to the edge."""
    half_width_mm: Positive
    centre_distance_mm: Positive
    """From the centre of the field to the centre of the chip (calibration files give that)."""


MOST_POSITIONERS = 20_000
"""Of one focal plane: four times as many as any that is built. Memory grows with them."""
FARTHEST_STEP = 1000
"""Holes from one fiducial to the next: farther than any field is wide."""
MOST_RINGS = 120
"""Enough holes for them, and for as many fiducials."""


class Modules(Table):
    """Positioners in modules of two rows. Fields have the same modules, each field turned clockwise against
    the one before by an equal part of a turn. In the first one modules run along -x, rows of a module along
    -y."""

    fields: Annotated[int, Field(ge=1, le=100)]
    per_field: Annotated[int, Field(ge=1, le=1000)]
    """Modules of a field."""
    positioners: Annotated[int, Field(ge=1, le=1000)]
    """Of a module, alternately in its two rows."""
    fiducials_mm: tuple[Range, ...] = ()
    """x and y of the fiducials of the first field."""

    @property
    def n_positioners(self) -> int:
        """Of all fields."""
        return self.fields * self.per_field * self.positioners


class Dots(Table):
    """An opaque spot beside each positioner: a fibre behind it is dark."""

    x_mm: Finite
    y_mm: Finite
    """Place against the centre of the positioner, in the focal plane."""
    sd_mm: NotNegative = 0.0
    """Standard deviation of single ones about it, per coordinate."""
    radius_mm: Positive


class Layout(Table):
    """A hexagonal array of holes with positioners and fiducials in it, or modules of positioners."""

    pitch_mm: Positive
    rings: Annotated[int, Field(ge=0, le=MOST_RINGS)] = 0
    """Rings of holes around the central one; of no meaning where there are modules."""
    modules: Modules | None = None
    """None: a hexagon of holes."""
    dots: Dots | None = None
    n_positioners: Annotated[int, Field(ge=1, le=MOST_POSITIONERS)]
    orientation_deg: Finite
    """Direction of alpha = 0 in the focal plane."""
    fiducial_lattice: tuple[int, int] | None = None
    """Fiducials sit in the holes that are whole combinations of this step and the one 60 deg from
    it, counted from the centre in steps along the two lattice directions."""
    outer_fiducial_radius_mm: Positive | None = None
    outer_fiducial_directions_deg: tuple[Finite, ...] = ()
    guide_cameras: GuideCameras | None = None
    field_radius_mm: Positive | None = None
    """There are no holes farther out; the whole hexagon when left out."""
    petals: Annotated[int, Field(ge=1, le=100)] = 1
    """Wedges of the field, each with the same holes, turned."""
    petal_gap_mm: NotNegative = 0.0
    """No hole is nearer to the edge of its petal than half of this."""
    keep_out_gap_mm: NotNegative = 0.0
    """No hole is nearer to a polygon among the keep-outs of the bodies; 0: holes do not heed them."""
    fiducial_pinholes_mm: tuple[Range, ...] = ((0.0, 0.0),)
    """Lights of one fiducial about its place, in the frame of its petal."""

    @property
    def n_holes(self) -> int:
        """Holes of the full hexagon."""
        return 3 * self.rings * (self.rings + 1) + 1

    @model_validator(mode="after")
    def _enough_holes(self) -> Self:
        if self.modules is not None and self.n_positioners != self.modules.n_positioners:
            raise ValueError(
                f"n_positioners {self.n_positioners}: modules have {self.modules.n_positioners} positioners"
            )
        if self.modules is None and self.n_positioners > self.n_holes:
            raise ValueError(
                f"n_positioners {self.n_positioners}: {self.rings} rings have only {self.n_holes} holes"
            )
        if not self.fiducial_pinholes_mm:
            raise ValueError("fiducial_pinholes_mm: a fiducial needs at least one light")
        if self.fiducial_lattice == (0, 0):
            raise ValueError("fiducial_lattice [0, 0] is no step")
        if self.fiducial_lattice is not None and max(map(abs, self.fiducial_lattice)) > FARTHEST_STEP:
            raise ValueError(f"fiducial_lattice: a step of more than {FARTHEST_STEP} holes")
        if bool(self.outer_fiducial_directions_deg) != (self.outer_fiducial_radius_mm is not None):
            raise ValueError("give outer_fiducial_radius_mm and outer_fiducial_directions_deg, or neither")
        return self


class UnitScatter(Table):
    """How units differ from the nominal one. Points: x of all fibres shifts by the spread of the
    metrology fibre (one arm, one length); the others have a scatter of their own beside it. What is left out
    does not differ."""

    l_alpha_mm: Scatter = Scatter()
    """Left out, or without a mean: about the nominal length."""
    alpha_offset_deg: Scatter = Scatter()
    """Zero of the alpha axis."""
    beta_offset_deg: Scatter = Scatter()
    base_x_mm: Scatter = Scatter()
    """Shift of the centre, in the positioner's own frame."""
    base_y_mm: Scatter = Scatter()
    beta_length_mm: Scatter = Scatter()
    """Shift in x of every point of the arm."""
    point_x_mm: Scatter = Scatter()
    """Own shift in x of each science fibre."""
    point_y_mm: Scatter = Scatter()
    """Own shift in y of each science fibre."""
