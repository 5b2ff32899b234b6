"""Camera images to positions: what it costs, how near the photon limit it is, beside the peers.

    python benchmarks/metrology.py [--repeats 3] [--slow] [--only centroids|matching|chain]
                                   [--out build/bench/metrology.json]

Images are those of tests/metrology/scenes.py (peak 2 000 to 50 000 electrons, background 100, read
noise 10) and lie in memory. CPU seconds of the whole process, the best of several runs. R is the rms
error over the rms of the Cramer-Rao bound; missed and false count spots. sep, photutils and OpenCV
are used where they are installed (`.venv/bin/pip install sep photutils opencv-python-headless`);
photutils only with --slow.
"""

import argparse
import importlib
import json
import platform
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree

from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology import SpotSettings, find_expected, find_spots, fit_transform
from fiberloom.metrology.acquisition import AcquisitionSettings, acquire
from fiberloom.metrology.matching import match_spots
from fiberloom.metrology.pipeline import ImageCamera, ReductionSettings
from fiberloom.metrology.transform import Distortion, PlaceErrors
from fiberloom.metrology.turbulence import remove_turbulence, rms_um
from fiberloom.twin import static_fibre_um
from fiberloom.twin.camera.imaging import ImagingCamera, StillScene
from fiberloom.twin.camera.models import camera_model
from fiberloom.version import __version__

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "metrology"))
import scenes
from test_matching import Field

FEW = scenes.Scene(n=500, width=8192, height=5210)
MANY = scenes.Scene(n=5000, width=6000, height=6000)
SMALL = scenes.Scene(n=800, width=3000, height=3000)


def optional(name):
    """A peer, or None."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


sep, cv2, photutils = optional("sep"), optional("cv2"), optional("photutils")


# peers: image, FWHM -> (n, 2) positions


def sep_objects(image):
    data = image.astype(np.float32)
    background = sep.Background(data)
    data -= background.back()
    sep.set_extract_pixstack(20_000_000)
    return data, sep.extract(data, 6.0, err=background.globalrms, minarea=12)


def sep_barycentre(image, fwhm):
    _, found = sep_objects(image)
    return np.column_stack([found["x"], found["y"]])


def sep_winpos(image, fwhm):
    data, found = sep_objects(image)
    x, y, _ = sep.winpos(data, found["x"], found["y"], fwhm / 2.3548)
    return np.column_stack([x, y])


def level_and_noise(image):
    sample = image[::16, ::16].astype(np.float32)
    middle = np.median(sample)
    return middle, 1.4826 * np.median(np.abs(sample - middle))


def opencv_moments(image, fwhm):
    level, noise = level_and_noise(image)
    mask = (image > level + 6 * noise).astype(np.uint8)
    stats = cv2.connectedComponentsWithStats(mask, connectivity=8)[2]
    out = []
    for x, y, w, h, area in stats[1:]:
        if area < 5:
            continue
        light = np.maximum(image[y : y + h, x : x + w] - level, 0)
        m = cv2.moments(light.astype(np.float32))
        out.append([x + m["m10"] / m["m00"], y + m["m01"] / m["m00"]])
    return np.array(out)


def scipy_centre_of_mass(image, fwhm):
    level, noise = level_and_noise(image)
    labels, n = ndimage.label(image > level + 6 * noise, np.ones((3, 3)))
    area = np.bincount(labels.ravel(), minlength=n + 1)
    good = np.flatnonzero(area >= 5)
    centres = ndimage.center_of_mass(image - level, labels, good[good > 0])
    return np.array(centres)[:, ::-1]


def photutils_2dg(image, fwhm):
    from photutils.centroids import centroid_2dg, centroid_sources
    from photutils.detection import DAOStarFinder

    level, noise = level_and_noise(image)
    data = image - level
    found = DAOStarFinder(threshold=6 * noise, fwhm=fwhm)(data)
    names = ("x_centroid", "y_centroid") if "x_centroid" in found.colnames else ("xcentroid", "ycentroid")
    box = 2 * int(1.5 * fwhm) + 1
    x, y = centroid_sources(data, found[names[0]], found[names[1]], box_size=box, centroid_func=centroid_2dg)
    return np.column_stack([x, y])


def peers(slow):
    out = {}
    if sep:
        out |= {"sep.extract barycentre": sep_barycentre, "sep.winpos, matched": sep_winpos}
    if cv2:
        out["OpenCV components + moments"] = opencv_moments
    out["scipy.ndimage label + centre of mass"] = scipy_centre_of_mass
    if photutils and slow:
        out["photutils DAOStarFinder + centroid_2dg"] = photutils_2dg
    return out


# ours


class Ours:
    """With the profile of the first frame kept, as the camera keeps it."""

    def __init__(self):
        self.profile = None

    def first(self, image, fwhm):
        return find_spots(image).spots.xy_px

    def next(self, image, fwhm):
        if self.profile is None:
            self.profile = find_spots(image).profile
        return find_spots(image, profile=self.profile).spots.xy_px

    def guided(self, image, expected):
        return find_expected(image, expected, 8.0, profile=self.profile).spots.xy_px


def cpu(repeats, action, *words):
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.process_time()
        result = action(*words)
        best = min(best, time.process_time() - start)
    return best, result


def judge(frame, xy, index, variance):
    """R over the spots of `index`, missed and false over all."""
    if not len(xy):
        return {"R": None, "missed": len(frame.spots), "false": 0}
    distance, j = cKDTree(xy).query(frame.spots[:, :2])
    ok = distance < 1.5
    keep = ok[index]
    error = xy[j[index[keep]]] - frame.spots[index[keep], :2]
    ratio = np.sqrt(np.sum(error**2) / np.sum(variance[keep]))
    return {"R": round(float(ratio), 3), "missed": int((~ok).sum()), "false": len(xy) - len(np.unique(j[ok]))}


def bounds(frame, most=600):
    index = np.arange(len(frame.spots))[:: max(1, len(frame.spots) // most)]
    return index, scenes.bound(frame, index)


def centroid_table(repeats, slow):
    tools = peers(slow)
    report = {}
    for name, scene in {"500 in 42.7 Mpx": FEW, "5000 in 36 Mpx": MANY}.items():
        frame = scenes.make(scene)
        index, variance = bounds(frame)
        rows = report[name] = {}
        ours = Ours()
        ours.next(frame.image, scene.fwhm)
        for label, tool in {"fiberloom": ours.next, "fiberloom, first frame": ours.first, **tools}.items():
            seconds, xy = cpu(repeats if "fiber" in label else 1, tool, frame.image, scene.fwhm)
            rows[label] = {"cpu_s": round(seconds, 4), **judge(frame, xy, index, variance)}
        expected = frame.spots[:, :2] + np.random.default_rng(0).uniform(-5, 5, (len(frame.spots), 2))
        seconds, _ = cpu(repeats, ours.guided, frame.image, expected)
        rows["fiberloom, guided 8 px"] = {"cpu_s": round(seconds, 4)}
        show(name, rows)
    return report


def width_table():
    """CPU and R over the widths of the goal."""
    report = {}
    for kind in ("gaussian", "moffat"):
        for fwhm in (2.5, 4.0, 7.0):
            rows = report[f"{kind}, FWHM {fwhm:g} px"] = {}
            for label, scene in (("500", FEW), ("5000", MANY)):
                frame = scenes.make(replace(scene, kind=kind, fwhm=fwhm))
                ours = Ours()
                ours.next(frame.image, fwhm)
                seconds, xy = cpu(3, ours.next, frame.image, fwhm)
                index, variance = bounds(frame, 1500)
                rows[label] = {"cpu_s": round(seconds, 4), **judge(frame, xy, index, variance)}
            show(f"{kind}, FWHM {fwhm:g} px", rows)
    return report


def dirt_table(slow):
    report = {}
    for share in (1e-4, 1e-2):
        scene = replace(FEW, gradient=150.0, cosmic=200, hot=share)
        frame = scenes.make(scene)
        index, variance = bounds(frame)
        rows = report[f"{100 * share:g} % hot pixels, gradient, 200 cosmic rays"] = {}
        for label, tool in {"fiberloom": Ours().first, **peers(slow)}.items():
            try:
                seconds, xy = cpu(1, tool, frame.image, scene.fwhm)
                rows[label] = {"cpu_s": round(seconds, 3), **judge(frame, xy, index, variance)}
            except Exception as error:  # a peer that gives up is a result
                rows[label] = {"failed": str(error).splitlines()[0][:80]}
        show(f"{100 * share:g} % hot pixels", rows)
    return report


# matching


def nearest(field):
    return cKDTree(field.spots).query(field.expected)[1]


def nearest_exclusive(field, limit=7.0):
    distance, spot = cKDTree(field.spots).query(field.expected, distance_upper_bound=limit)
    order = np.argsort(distance, kind="stable")
    taken, out = set(), np.full(len(distance), -1)
    for i in order:
        if np.isfinite(distance[i]) and spot[i] not in taken:
            taken.add(spot[i])
            out[i] = spot[i]
    return out


def reach_only(field):
    """One spot each inside the reach, wherever it is expected."""
    low, high = field.reach
    near = cKDTree(field.centres).query_ball_point(field.spots, high)
    k = np.repeat(np.arange(len(field.spots)), [len(n) for n in near])
    i = np.concatenate(near).astype(int)
    inside = np.hypot(*(field.spots[k] - field.centres[i]).T) >= low
    shape = (len(field.centres), len(field.spots))
    graph = csr_array((np.ones(inside.sum()), (i[inside], k[inside])), shape=shape)
    return maximum_bipartite_matching(graph, perm_type="column")


def ours_match(field):
    return field.match().spot


def right_wrong_lost(field, spot):
    rows = np.arange(len(field.expected))
    got = np.where(spot >= 0, field.owner[np.maximum(spot, 0)], -2)
    return [
        int((got == rows).sum()),
        int(((spot >= 0) & (got != rows)).sum()),
        int(((spot < 0) & ~field.dark).sum()),
    ]


def matching_table():
    report = {}
    rules = {
        "nearest": nearest, "nearest, exclusive, 7 mm": nearest_exclusive,
        "assignment by reach": reach_only, "fiberloom": ours_match,
    }  # fmt: skip
    cases = {
        "1 % astray, 1 % dark, 5 strays": {"astray": 0.01, "dark": 0.01, "stray": 5},
        "5 % astray, 3 % dark, 60 strays": {},
        "the same, 20 % dark on one side": {"dark_side": 0.2},
    }
    for case, changes in cases.items():
        for kind in ("sdssv", "desi", "pfs"):
            rows = report[f"{kind}: {case}"] = {}
            fields = [Field(kind, 100 + seed, **changes) for seed in range(3)]
            for label, rule in rules.items():
                seconds, spots = cpu(1, list, map(rule, fields))
                counts = np.sum([right_wrong_lost(f, s) for f, s in zip(fields, spots, strict=True)], axis=0)
                rows[label] = {
                    "right": int(counts[0]), "wrong": int(counts[1]), "lit but lost": int(counts[2]),
                    "cpu_s": round(seconds / 3, 4),
                }  # fmt: skip
            show(f"{kind}: {case} (three fields)", rows)
    return report


# the chain


def chain_sdssv():
    """The whole chain on the SDSS-V preset against the photon noise."""
    plane, model = generate(load_instrument("sdssv"), 0), camera_model("sdssv")
    rng = np.random.default_rng(1)
    expected = plane.forward(*rng.uniform(*plane.limits_deg.T, (len(plane), 2)).T)
    scene = StillScene(expected + rng.normal(0, 0.02, expected.shape))
    source = ImagingCamera(scene, model, fiducials_mm=plane.fiducials, seed=5)
    camera = ImageCamera(source, plane, ReductionSettings(model.optics.geometry, radius_mm=330.0))
    error, seconds = [], []
    for _ in range(4):
        image = source.expose()
        camera.source = Still(image)
        start = time.process_time()
        seen = camera.measure(expected)
        seconds.append(time.process_time() - start)
        error.append((seen.xy_mm - scene.xy_mm)[seen.seen])
    spots = camera.last.spots
    photon = 1e3 * model.optics.geometry.scale_mm_px * np.sqrt(np.mean(np.sum(
        np.diagonal(spots.covariance_px2, axis1=1, axis2=2), axis=1)))  # fmt: skip
    rms = rms_um(np.concatenate(error))
    return {
        "rms_um": round(rms, 3), "photon_noise_um": round(float(photon), 3),
        "ratio": round(rms / float(photon), 2), "seen": int(seen.seen.sum()),
        "cpu_s": {"first image": round(seconds[0], 3), "next": round(min(seconds[1:]), 3)},
    }  # fmt: skip


class Still:
    def __init__(self, image):
        self.image = image

    def expose(self):
        return self.image


def chain_desi(n=5000, standing=720):
    """DESI's camera with turbulence of 5 um per coordinate: what is left after its removal."""
    model, rng = camera_model("desi"), np.random.default_rng(2)
    field = Field("desi", 3, astray=0.0, dark=0.01, stray=0)
    centres = scenes_hexagon(10.4, n)
    field.centres = centres
    expected = field.place()
    true = expected + rng.normal(0, 0.02, expected.shape)
    fiducials = pinholes(rng)
    source = ImagingCamera(StillScene(true), model, fiducials_mm=fiducials, seed=7)
    image = source.expose()
    start = time.process_time()
    found = find_spots(image.pixels, SpotSettings(image.gain_e_adu, image.saturation_adu)).spots
    geometry = replace(model.optics.geometry, rotation_tolerance_deg=1.5)
    acquired = acquire(found.xy_px, fiducials, geometry, expected_mm=expected,
                       errors=PlaceErrors(found.covariance_px2, 5e-3),
                       settings=AcquisitionSettings(coarse_mm=8.0, radius_mm=420.0))  # fmt: skip
    free = np.setdiff1d(np.arange(len(found)), acquired.spot)
    spots_mm = acquired.transform.to_mm(found.xy_px[free])
    match = match_spots(spots_mm, expected, centres, field.reach)
    seen = np.flatnonzero(match.spot >= 0)
    xy = spots_mm[match.spot[seen]]
    still = np.zeros(n, dtype=bool)
    still[rng.permutation(n)[:standing]] = True
    at = np.vstack([fiducials[acquired.fiducial], true[seen][still[seen]]])
    shift = np.vstack([-acquired.fit.residual_mm, (xy - true[seen])[still[seen]]])
    air = remove_turbulence(at, shift, 1.5e-3, xy)
    seconds = time.process_time() - start
    error = (xy - true[seen])[~still[seen]]
    left = error - air.shift_mm[~still[seen]]
    return {
        "spots": len(found), "matched": len(seen), "pinholes": len(acquired.fiducial),
        "wrong pairs": int((np.hypot(*error.T) > 0.1).sum()),
        "turbulence_um": round(model.optics.turbulence_um * np.sqrt(2), 2),
        "before_um": round(rms_um(error), 2), "after_um": round(rms_um(left), 2), "cpu_s": round(seconds, 2),
    }  # fmt: skip


def scenes_hexagon(pitch, n):
    side = np.arange(-60, 61)
    i, j = np.meshgrid(side, side)
    xy = np.column_stack([(pitch * (i + 0.5 * j)).ravel(), (pitch * np.sqrt(0.75) * j).ravel()])
    return xy[np.argsort(np.hypot(*xy.T), kind="stable")[:n]]


def pinholes(rng, n=118):
    """Fiducials of four pinholes around and between the positioners."""
    radius = np.where(np.arange(n) % 3 == 0, 412.0, 400 * np.sqrt(rng.random(n)))
    angle = rng.uniform(0, 2 * np.pi, n)
    body = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    pattern = np.array([[0.0, 0.0], [1.6, 0.2], [0.7, 0.7], [0.9, -0.8]])
    turn = np.exp(1j * rng.uniform(0, 2 * np.pi, n))
    z = turn[:, None] * (pattern[:, 0] + 1j * pattern[:, 1])[None, :]
    return (body[:, None] + np.stack([z.real, z.imag], axis=2)).reshape(-1, 2)


def desi_spots():
    """The real DESI spots, where the data lie beside the checkout."""
    import csv
    import gzip

    for parent in Path(__file__).resolve().parents:
        folder = parent / "shared" / "data" / "desi" / "desimeter"
        if folder.is_dir():
            break
    else:
        return "no ../shared/data/desi beside the checkout"
    with gzip.open(folder / "fp-metrology.csv.gz", "rt") as file:
        rows = [r for r in csv.DictReader(file) if r["PINHOLE_ID"] not in ("", "0")]
    table = {(r["LOCATION"], r["PINHOLE_ID"]): (float(r["X_FP"]), float(r["Y_FP"])) for r in rows}
    with open(folder / "test-spots.csv") as file:
        spots = [r for r in csv.DictReader(file) if (r["LOCATION"], r["PINHOLE_ID"]) in table]
    px = np.array([(float(r["XPIX"]), float(r["YPIX"])) for r in spots])
    mm = np.array([table[r["LOCATION"], r["PINHOLE_ID"]] for r in spots])
    out = {"desimeter with distortion terms fitted": {"rms_um": 22.6}}
    for n in (13, 33):
        distortion = Distortion(420.0) if n == 13 else Distortion(420.0, range(33))
        fit = fit_transform(px, mm, distortion, flipped=True)
        out[f"fiberloom, {n} terms"] = {
            "rms_um": round(fit.rms_um, 2), "left_out_um": round(fit.leave_one_out_rms_um, 2),
        }  # fmt: skip
    return out


def bench_cameras(seeds=3):
    """Kronig 2020, Fig. 18: 669 and 101 nm; the flux of each is tuned to that."""
    out = {}
    for name, images in (("workspace", 1000), ("close-up", 400)):
        runs = [static_fibre_um(name, images, seed) for seed in range(seeds)]
        out[name] = {
            "rms_nm": round(
                1e3 * float(np.sqrt(np.mean([np.sum(xy**2, axis=1).mean() for xy, _ in runs]))), 1
            ),
            "stated_nm": round(1e3 * float(np.mean([stated for _, stated in runs])), 1),
        }
    return out


def show(title, rows):
    print(f"\n{title}")
    for label, row in rows.items():
        print(f"  {label:42s}" + "  ".join(f"{k} {v}" for k, v in row.items()), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--slow", action="store_true", help="photutils too: minutes")
    parser.add_argument("--only", choices=["centroids", "widths", "dirt", "matching", "chain"])
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    parts = {
        "centroids": lambda: centroid_table(args.repeats, args.slow),
        "widths": width_table,
        "dirt": lambda: dirt_table(args.slow),
        "matching": matching_table,
        "chain": lambda: {
            "sdssv": chain_sdssv(),
            "desi": chain_desi(),
            "desi spots": desi_spots(),
            "bench": bench_cameras(),
        },
    }
    report = {"version": __version__, "machine": platform.processor() or platform.machine()}
    for name, part in parts.items():
        if args.only in (None, name):
            report[name] = part()
    if "chain" in report:
        print(json.dumps(report["chain"], indent=1))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
