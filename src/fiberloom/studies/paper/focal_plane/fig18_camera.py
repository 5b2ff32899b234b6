"""Fig. 18: repeatability of the bench's two cameras on a fibre that does not move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity
from fiberloom.twin import static_fibre_um
from fiberloom.twin.camera.models import camera_model
from fiberloom.typing import Floats

IMAGES, MANY_IMAGES = 300, 1000
PAPER_NM = {"close-up": 101.0, "workspace": 669.0}


@dataclass(frozen=True)
class Static:
    """Positions of one fibre in many images, um about their mean, and what the centroids state."""

    xy_um: Floats
    stated_nm: float

    @property
    def rms_nm(self) -> float:
        """Two-dimensional."""
        return 1e3 * float(np.sqrt(np.mean(np.sum(self.xy_um**2, axis=1))))


def look(name: str, images: int, seed: int) -> Static:
    """Images rendered, exposed and measured again."""
    xy, stated_um = static_fibre_um(name, images, seed)
    return Static(xy, 1e3 * stated_um)


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's 101 nm close up and 669 nm over the whole workspace."""
    images = MANY_IMAGES if settings.full else IMAGES
    found: dict[str, list[Static]] = {name: [] for name in PAPER_NM}
    averaged = []
    for seed in settings.seeds:
        settings.say(f"Figure 18: seed {seed}")
        for name in PAPER_NM:
            found[name].append(look(name, images, seed))
        four = replace(camera_model("workspace"), average=4)
        averaged.append(
            1e3 * float(np.sqrt(np.mean(np.sum(static_fibre_um(four, images, seed)[0] ** 2, axis=1))))
        )
    return FigureOutcome(
        quantities=[
            *(q for name in PAPER_NM for q in _quantities(name, found[name])),
            _average(found, averaged),
        ],
        drawings=[_draw({name: runs[0] for name, runs in found.items()})],
        how=(
            f"{images} images of a standing fibre by each camera and seed: light, optics, photon and read "
            "noise, pixels, then the centroids that operators use. The close-up camera averages ten "
            "exposures."
        ),
        beyond=[
            "Every centroid states its own covariance, and the corrections and the learning use it: what "
            "the noise is need not be told."
        ],
    )


def _quantities(name: str, runs: list[Static]) -> list[Quantity]:
    key = name.replace("-", "_")
    return [
        quantity(
            f"fig18.{key}.rms_nm",
            f"{name} camera: repeatability on a static fibre, rms",
            [s.rms_nm for s in runs],
            "nm",
            Kind.TUNED,
            paper=PAPER_NM[name],
            note="the light of the model was chosen so; lens, pixels and exposure are assumed",
        ),
        quantity(
            f"fig18.{key}.stated_over_seen",
            f"{name} camera: scatter that the centroids state over that seen",
            [s.stated_nm / s.rms_nm for s in runs],
            "1",
            beyond=True,
        ),
    ]


def _average(found: dict[str, list[Static]], averaged: list[float]) -> Quantity:
    single = [s.rms_nm for s in found["workspace"]]
    return quantity(
        "fig18.four_images_over_one",
        "scatter of four images averaged over that of one",
        [a / b for a, b in zip(averaged, single, strict=True)],
        "1",
        note="photons alone: one half",
        beyond=True,
    )


def _draw(found: dict[str, Static]) -> Drawing:
    canvas, panels = plt.subplots(1, 2, figsize=(9.5, 4.6), layout="constrained")
    for axes, (name, seen) in zip(panels, found.items(), strict=True):
        axes.plot(*(1e3 * seen.xy_um.T), ".", markersize=3)
        edge = 4.0 * PAPER_NM[name] / np.sqrt(2.0)
        axes.set(aspect="equal", xlabel="x [nm]", ylabel="y [nm]", xlim=(-edge, edge), ylim=(-edge, edge))
        axes.set_title(f"{name}: {seen.rms_nm:.0f} nm rms (paper: {PAPER_NM[name]:.0f})")
        axes.grid(True, alpha=0.3)
    return drawing("static", "Every dot is one measurement of a fibre that stands.", canvas)
