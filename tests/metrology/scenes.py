"""Synthetic frames with a known truth, and the Cramer-Rao bound of every spot in them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from fiberloom._core import metrology as _core

KINDS = {"gaussian": 0, "moffat": 1}
END_Q = {"gaussian": 40.0, "moffat": 300.0}
BIAS = 300.0


@dataclass(frozen=True)
class Scene:
    """What a frame holds; electrons are digital units (gain 1)."""

    n: int = 400
    width: int = 2048
    height: int = 2048
    fwhm: float = 4.0
    kind: str = "gaussian"
    beta: float = 3.0
    ellipticity: float = 0.0
    """Axis ratio less one."""
    angle: float = 0.0
    growth: float = 0.0
    """Width and radial stretch gained towards the corner."""
    background: float = 100.0
    read_noise: float = 10.0
    peaks: tuple[float, float] = (2e3, 5e4)
    gap: float = 3.5
    """Nearest spots, in FWHM."""
    hot: float = 0.0
    cosmic: int = 0
    gradient: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class Frame:
    image: np.ndarray
    spots: np.ndarray
    """(n, 7): x, y, flux, S_xx, S_xy, S_yy, beta."""
    scene: Scene


def places(rng, scene):
    """Random places that keep their distance and stay off the edge."""
    gap, edge = scene.gap * scene.fwhm, 8 * scene.fwhm
    out = rng.uniform(edge, [scene.width - edge, scene.height - edge], (6 * scene.n, 2))
    near = cKDTree(out).query_pairs(gap, output_type="ndarray")
    keep = np.ones(len(out), dtype=bool)
    for i, j in near:
        if keep[i] and keep[j]:
            keep[j] = False
    return out[keep][: scene.n]


def ellipses(scene, xy):
    core = scene.fwhm / 2.3548200450309493
    if scene.kind == "moffat":
        core = scene.fwhm / (2 * np.sqrt(2 ** (1 / scene.beta) - 1))
    middle = np.array([scene.width, scene.height]) / 2
    u = (xy - middle) / np.hypot(*middle)
    size = core**2 * (1 + scene.growth * np.sum(u**2, axis=1)) ** 2
    c, s = np.cos(scene.angle), np.sin(scene.angle)
    a, b = 1 + scene.ellipticity, 1 / (1 + scene.ellipticity)
    turn = np.array([[c, -s], [s, c]])
    shape = turn @ np.diag([a, b]) @ turn.T + scene.growth * u[:, :, None] * u[:, None, :]
    full = size[:, None, None] * shape
    return np.column_stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]])


def light(spots, kind, shape):
    image = np.zeros(shape, dtype=np.float32)
    _core.render_spots(image, np.ascontiguousarray(spots), KINDS[kind], END_Q[kind])
    return image


def make(scene):
    rng = np.random.default_rng([scene.seed, 7])
    xy = places(rng, scene)
    n = len(xy)
    shape = ellipses(scene, xy)
    root = np.sqrt(shape[:, 0] * shape[:, 2] - shape[:, 1] ** 2)
    volume = 2 * np.pi if scene.kind == "gaussian" else np.pi / (scene.beta - 1)
    peak = np.exp(rng.uniform(*np.log(scene.peaks), n))
    spots = np.column_stack([xy, peak * volume * root, shape, np.full(n, scene.beta)])
    image = light(spots, scene.kind, (scene.height, scene.width))
    add_blemishes(image, scene, rng)
    sky = [scene.background, scene.gradient / scene.width, scene.gradient / scene.height]
    detector = [1.0, scene.read_noise, BIAS, 1e9]
    pixels = _core.expose(image, sky, detector, int(rng.integers(2**62)))
    return Frame(pixels, spots, scene)


def add_blemishes(image, scene, rng):
    hot = np.flatnonzero(rng.random(image.size) < scene.hot)
    image.reshape(-1)[hot] += 200 + rng.exponential(3000, len(hot)).astype(np.float32)
    for _ in range(scene.cosmic):
        start, angle = rng.uniform(1, [scene.width - 1, scene.height - 1]), rng.uniform(0, np.pi)
        along = np.arange(0, 1 + rng.exponential(8), 0.5)
        x = (start[0] + along * np.cos(angle)).astype(int).clip(0, scene.width - 1)
        y = (start[1] + along * np.sin(angle)).astype(int).clip(0, scene.height - 1)
        np.add.at(image, (y, x), np.float32(rng.uniform(150, 1500)))


def bound(frame, index):
    """(k, 2) Cramer-Rao variances of x and y, flux unknown, background known: by differences."""
    s = frame.scene
    out = np.empty((len(index), 2))
    for row, spot in enumerate(frame.spots[index]):
        half = int(np.ceil(min(np.sqrt(END_Q[s.kind] * spot[3:6].max()), 60))) + 2
        stamp = spot.copy()
        stamp[:2] += half - np.floor(stamp[:2])
        out[row] = _bound_of(stamp, s, 2 * half + 1)
    return out


def _bound_of(spot, scene, size):
    def at(dx, dy):
        return light((spot + [dx, dy, 0, 0, 0, 0, 0])[None], scene.kind, (size, size)).astype(float)

    h = 0.02
    m = at(0, 0)
    gradients = [m / spot[2], (at(h, 0) - at(-h, 0)) / (2 * h), (at(0, h) - at(0, -h)) / (2 * h)]
    variance = m + scene.background + scene.gradient / 2 + scene.read_noise**2 + 1 / 12
    fisher = [[np.sum(a * b / variance) for b in gradients] for a in gradients]
    return np.diag(np.linalg.inv(fisher))[1:]


@dataclass(frozen=True)
class Score:
    ratio: float
    """Rms over the spots of error over bound, each with its own."""
    pull: float
    missed: int
    false: int


def score(frame, spots, most=400):
    """Found spots against the truth."""
    distance, j = cKDTree(spots.xy_px).query(frame.spots[:, :2])
    found = distance < 1.5
    index = np.flatnonzero(found)
    index = index[:: max(1, len(index) // most)]
    error = spots.xy_px[j[index]] - frame.spots[index, :2]
    variance = bound(frame, index)
    stated = np.stack([spots.x_err_px[j[index]], spots.y_err_px[j[index]]], axis=1)
    return Score(
        float(np.sqrt(np.mean(error**2 / variance))),
        float(np.sqrt(np.mean((error / stated) ** 2))),
        int((~found).sum()),
        len(spots) - len(np.unique(j[found])),
    )


def same_but(scene, **changes):
    return replace(scene, **changes)
