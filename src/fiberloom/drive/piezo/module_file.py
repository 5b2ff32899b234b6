"""Motor maps of the cobras of a module, from its XML file (Subaru-PFS/pfs_instdata)."""

from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from fiberloom.drive.piezo.maps import MotorMaps
from fiberloom.errors import InputError, one_line
from fiberloom.files import MB, read_bytes
from fiberloom.typing import Floats

MODULE_BYTES = 64 * MB
"""The largest file that is read; 57 cobras have 0.5 MB."""
MOST_BINS = 10_000
US_PER_MS = 1000.0
EVEN_DEG = 0.05
"""By how much the edge of a bin may be off where all are equally wide; the first ones are by 0.03."""

Speed = Literal["slow", "fast"]
_SUFFIX = {"slow": "_Slow", "fast": ""}


def read_module_maps(path: str | Path, speed: Speed = "slow") -> MotorMaps:
    """The maps in a module's file.

    Parameters
    ----------
    path : str or Path
        SCnn_final.xml, or packed: .xml.gz.
    speed : {"slow", "fast"}
        Of two tables, that for short pulses or that for long ones. In the published files the fast tables and
        the fast pulses do not belong together.

    Returns
    -------
    MotorMaps
        Of 2 C motors: theta and phi of the first cobra of the file, of the second, and so on.

    Raises
    ------
    InputError
        Not such a file, or a table that is missing, or holds no steps.
    """
    path = Path(path)
    cobras = [_Cobra(path, k, node) for k, node in enumerate(_root(path).iter("ARM_DATA_CONTAINER"), start=1)]
    if not cobras:
        raise InputError(f"{path}: no ARM_DATA_CONTAINER in it; give the XML file of a module")
    tables = [cobra.table(speed, link, way) for cobra in cobras for link in (1, 2) for way in ("fwd", "rev")]
    edges = {float(table[0]) for table in tables}
    if len({len(table) for table in tables}) > 1 or len(edges) > 1:
        raise InputError(f"{path}: maps with different bins in one file; all must have the same")
    step = np.array([table[1:] for table in tables]).reshape(2 * len(cobras), 2, -1)
    pulse = [
        cobra.pulse_us(speed, link, way) for cobra in cobras for link in (1, 2) for way in ("fwd", "rev")
    ]
    return MotorMaps(step, edges.pop() / step.shape[2], np.array(pulse).reshape(-1, 2))


def _root(path: Path) -> ElementTree.Element:
    content = read_bytes(path, MODULE_BYTES)
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise InputError(f"{path}: declares entities, which a module's file does not need; not read")
    try:
        return ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not XML: {one_line(error)}") from None


class _Cobra:
    """One entry of the file, which names its place in complaints."""

    def __init__(self, path: Path, number: int, node: ElementTree.Element) -> None:
        self.where, self.node = f"{path}, cobra {number}", node

    def table(self, speed: Speed, link: int, way: str) -> Floats:
        """(1 + B,): the last edge in deg, then deg per step of each bin."""
        key = f"{speed.upper()}_CALIBRATION_TABLE/Joint{link}_{way}"
        edges, steps = self._row(f"{key}_regions"), self._row(f"{key}_stepsizes")
        even = edges[-1] / len(edges) * np.arange(1, len(edges) + 1)
        if len(edges) != len(steps) or not np.abs(edges - even).max() <= EVEN_DEG:
            raise InputError(f"{self.where}: {key}: needs as many steps as bins, and bins of equal width")
        for k in np.flatnonzero(~(steps > 0.0))[:1]:
            raise InputError(f"{self.where}: {key}_stepsizes, bin {k}: {steps[k]:g} deg; must be above 0")
        return np.append(edges[-1], steps)

    def pulse_us(self, speed: Speed, link: int, way: str) -> float:
        """Length of the pulse that belongs to the table."""
        key = f"KINEMATICS/Link{link}_{way}_Duration{_SUFFIX[speed]}"
        ms = self._numbers(key, self._text(key))
        if len(ms) != 1 or not ms[0] > 0.0:
            raise InputError(f"{self.where}: {key}: must be one number above 0, in ms")
        return float(ms[0]) * US_PER_MS

    def _row(self, key: str) -> Floats:
        """The bins of a row, whose first two numbers are how many there are, and how many there may be."""
        numbers = self._numbers(key, self._text(key))
        n = int(numbers[0]) if len(numbers) > 2 and 0 < numbers[0] <= MOST_BINS else 0
        if n == 0 or len(numbers) < 2 + n:
            raise InputError(
                f"{self.where}: {key}: the first number says how many follow after the second one"
            )
        return numbers[2 : 2 + n]

    def _text(self, key: str) -> str:
        node = self.node.find(key)
        if node is None or not (node.text or "").strip():
            raise InputError(f"{self.where}: no {key}")
        return node.text or ""

    def _numbers(self, key: str, text: str) -> Floats:
        try:
            numbers = np.array([float(cell) for cell in text.split(",") if cell.strip()])
        except ValueError:
            raise InputError(f"{self.where}: {key}: must be numbers, divided by commas") from None
        if not np.isfinite(numbers).all():
            raise InputError(f"{self.where}: {key}: must be finite numbers")
        return numbers
