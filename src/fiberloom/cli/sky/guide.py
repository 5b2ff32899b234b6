"""`fiberloom sky guide`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fiberloom.cli.options import require_file
from fiberloom.cli.sky.place import SkyOptions
from fiberloom.report.folder import prepare_file


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
    from fiberloom.sky.pointed import guide_report
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
    told = guide_report(chain, fit)
    if options.out is not None:
        prepare_file(options.out)
        keys = {"position_angle_deg": told["position_angle_deg"], "scale": told["scale"]}
        field.model_copy(update=keys).write(options.out)
        told["file"] = str(options.out)
    options.show(told | {"left_out": found.targets.target_id[~fit.used].tolist()})
