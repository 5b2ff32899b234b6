"""`fiberloom sky guide`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import require_file
from fiberloom.cli.sky.place import SkyOptions
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.sky.chain import Chain
    from fiberloom.sky.guiding import GuideFit


@dataclass(frozen=True, kw_only=True)
class GuideOptions(SkyOptions):
    """Of `fiberloom sky guide`."""

    stars: Annotated[
        Path, typer.Argument(help="CSV, ECSV or FITS: ra, dec, ..., and x_mm, y_mm where each star was seen.")
    ]
    out: Annotated[
        Path | None, typer.Option(help="Field file to write: with the rotation and scale that were found.")
    ] = None


def guide(options: GuideOptions) -> None:
    """Offset, rotation and scale of a field from guide stars, with their errors.

    Stars beyond 3.5 robust sigmas are left out. The offset is the telescope's to take off; rotation and scale
    go into the field file of the next placing.
    """
    from fiberloom.sky.guiding import fit_guiding
    from fiberloom.tables import read_table
    from fiberloom.targets.read import read_sky

    options.check()
    require_file(options.stars)
    found, _ = read_sky(options.stars)
    table = read_table(options.stars)
    table.require("x_mm", "y_mm")
    field = options.read_field()
    chain = field.chain(options.model(), options.field)
    import numpy as np

    measured_mm = np.column_stack([table.numbers("x_mm"), table.numbers("y_mm")])
    fit = fit_guiding(found.checked(chain, "metrology").xy_mm, measured_mm)
    told = report(chain, fit)
    if options.out is not None:
        prepare_file(options.out)
        keys = {"position_angle_deg": told["position_angle_deg"], "scale": told["scale"]}
        field.model_copy(update=keys).write(options.out)
        told["file"] = str(options.out)
    options.show(told | {"left_out": found.targets.target_id[~fit.used].tolist()})


_STEP_DEG = 0.01


def _sense(chain: Chain) -> float:
    """Which way places turn in the focal plane where the position angle grows: 1 counter-clockwise, or -1."""
    import math

    from fiberloom.sky.drift import guide_stars
    from fiberloom.sky.guiding import fit_guiding

    stars = guide_stars(chain)
    turned = chain.turned(_STEP_DEG)
    fit = fit_guiding(chain.place(stars).xy_mm, turned.place(stars).xy_mm)
    return math.copysign(1.0, fit.rotation_deg)


def _edge_mm(chain: Chain) -> float:
    """Radius of the field in the focal plane."""
    import numpy as np

    from fiberloom.sky.drift import field_grid

    edge_mm = chain.place(field_grid(chain, rings=(1.0,)), "metrology").xy_mm
    return float(np.hypot(*(edge_mm - edge_mm.mean(axis=0)).T).mean())


def report(chain: Chain, fit: GuideFit) -> dict[str, Any]:
    """What a fit of guide stars says of the telescope, for people and machines."""
    import numpy as np

    from fiberloom.sky.sky_targets import SkyTargets

    p, view = chain.pointing, chain.view
    centre_mm = chain.place(SkyTargets.at(p.ra_deg, p.dec_deg), "metrology").xy_mm
    here, there = (chain.sky(centre_mm - by, chain.guide_A)[0] for by in (np.zeros(2), fit.offset_mm))
    off_arcsec = 3600.0 * ((there - here + 180.0) % 360.0 - 180.0)
    sigma = np.sqrt(np.diag(fit.covariance))
    turned_deg = fit.rotation_deg * _sense(chain)
    return {
        "stars": len(fit.used),
        "used": int(fit.used.sum()),
        "star_sigma_um": fit.sigma_um,
        "offset_x_um": 1e3 * fit.offset_mm[0],
        "offset_y_um": 1e3 * fit.offset_mm[1],
        "offset_error_um": 1e3 * float(np.hypot(*sigma[:2]) / np.sqrt(2.0)),
        "points_off_ra_arcsec": float(off_arcsec[0] * np.cos(np.radians(p.dec_deg))),
        "points_off_dec_arcsec": float(off_arcsec[1]),
        "rotation_arcsec": 3600.0 * turned_deg,
        "rotation_error_arcsec": 3600.0 * float(np.degrees(sigma[2])),
        "scale_ppm": 1e6 * (fit.scale - 1.0),
        "scale_error_ppm": 1e6 * float(sigma[3]),
        "error_at_edge_um": float(fit.error_um(_edge_mm(chain))),
        "position_angle_deg": p.pa_deg + turned_deg,
        "scale": view.scale / fit.scale,
    }
