"""What an observation keeps of its exposures: pages with figures, and the images themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import write_image
from fiberloom.metrology.pipeline import ImageCamera, Reduction
from fiberloom.typing import Floats

FOLDER = "exposures"


class ExposureLog:
    """Writes pages and images of a camera's exposures into a folder."""

    def __init__(self, plane: FocalPlane, out: Path, pages: str, save_images: bool) -> None:
        """`plane`: layout for the labels; `out`: folder of the observation.

        `pages`: none, last or all, the exposures that get a page: the image with labels, residual
        vectors, the distortion field; `save_images`: whether every image is kept as FITS.
        """
        self.plane, self.folder = plane, out / FOLDER
        self.pages, self.save_images = pages, save_images
        self._number: Callable[[], int] | None = None
        self._compares: Callable[[], bool] = lambda: False
        self._taken: Counter[int] = Counter()
        self._goal_mm: Floats | None = None
        self._last: Reduction | None = None
        self._last_name = ""
        self._watched: ImageCamera | None = None

    def watch(self, camera: Any) -> None:
        """Keeps the exposures of this camera from now on. A camera without images has nothing to keep:
        with `save_images` that is an InputError."""
        if isinstance(camera, ImageCamera):
            camera.watchers.append(self.seen)
            self._watched = camera
        elif self.save_images:
            raise InputError("--save-images goes with --camera image: this camera takes no images")

    def follow(
        self, number: Callable[[], int], goal_mm: Floats, compares: Callable[[], bool] = lambda: False
    ) -> None:
        """From now on exposures have the number of the move before them: `number()`, 0 before the first move.

        `goal_mm` (N, 2): where the metrology fibres should be after a move, NaN without a target;
        `compares()`: that move is a comparison, whose exposures are not the last of the observation.
        """
        self._number, self._goal_mm, self._compares = number, goal_mm, compares

    def seen(self, reduction: Reduction) -> None:
        """Takes the next exposure; what is kept of each one is written before the loop goes on."""
        name = self._next_name()
        if self.save_images:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_image(reduction.image, self.folder / f"{name}.fits")
        if self.pages == "all":
            self._plot(reduction, name)
        if not self._compares():
            self._last, self._last_name = reduction, name

    def stop(self) -> None:
        """Keeps no further exposures."""
        if self._watched is not None:
            self._watched.watchers.remove(self.seen)
            self._watched = None

    def close(self) -> None:
        """Writes the pages of the last exposure, where only those are wanted."""
        if self.pages == "last" and self._last is not None:
            self._plot(self._last, self._last_name)

    def _next_name(self) -> str:
        """With the number of the move; further exposures of the same move count on behind it."""
        move = self._taken.total() + 1 if self._number is None else self._number()
        self._taken[move] += 1
        again = f"-{self._taken[move]}" if self._taken[move] > 1 else ""
        return f"exposure-{move:02d}{again}"

    def _plot(self, reduction: Reduction, name: str) -> None:
        from fiberloom.report.exposure import plot_reduction  # matplotlib takes a second

        moved = self._number is not None and self._number() > 0
        goal_mm = self._goal_mm if moved else None  # before the first move none is at its target
        plot_reduction(self.folder, name, self.plane, reduction, goal_mm)
