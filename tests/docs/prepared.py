"""What blocks of the pages take as given: `<!-- given: NAME -->` before a block names one of these.

Each is a function of a folder and of pytest's monkeypatch, and returns the names that the block may use.
"""

import asyncio
import importlib.util
from pathlib import Path

import matplotlib
import numpy as np

from fiberloom.bus import CanNetTransport, Client
from fiberloom.calibration import TransmissionMaps, identity
from fiberloom.instruments import METROLOGY, FocalPlane, generate, load_instrument
from fiberloom.store import Store
from fiberloom.twin import Twin, TwinTransport, bench_units, draw_units

TESTS = Path(__file__).resolve().parents[1]
N = 3


def small_plane(n: int = N) -> FocalPlane:
    """A few positioners of SDSS-V."""
    return generate(load_instrument("sdssv"), seed=0, n_positioners=n)


def store(folder, monkeypatch):
    """`plane`, and a `store` in which the run `run_id` has a start and two moves."""
    plane = small_plane()
    kept = Store.open(folder / "store.sqlite")
    with kept.start_run(command_line="fiberloom observe", instrument="sdssv") as run:
        for number, kind in enumerate(("start", "blind", "correction 1")):
            theta_deg = np.array([30.0 + number, 90.0])
            xy_mm = plane.forward(*np.tile(theta_deg, (N, 1)).T)
            run.record_move(
                number,
                kind,
                {
                    "positioner_id": plane.positioner_id,
                    "x_mm": xy_mm[:, 0],
                    "y_mm": xy_mm[:, 1],
                    "seen": np.ones(N, dtype=bool),
                    "alpha_deg": theta_deg[0],
                    "beta_deg": theta_deg[1],
                    "wire_alpha_deg": theta_deg[0],
                    "wire_beta_deg": theta_deg[1],
                    "status": np.array(["on_target"] * N, dtype=object),
                },
            )
    return {"plane": plane, "store": kept, "run_id": run.id}


def units(folder, monkeypatch):
    """`plane` and `units` of the twin, and `wire_deg` (N, 2)."""
    plane, drawn = bench_units("sdssv", seed=1, units=range(N))
    return {"plane": plane, "units": drawn, "wire_deg": np.full((N, 2), 90.0)}


def wire(folder, monkeypatch):
    """`wire_deg` (50, 2)."""
    return {"wire_deg": np.full((50, 2), 90.0)}


def bench(folder, monkeypatch):
    """`client`, `camera` and `plane` of a bench without physics, and `theta_deg` (N, 2)."""
    spec = importlib.util.spec_from_file_location("bench", TESTS / "calibration" / "bench.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plane = small_plane()
    both = module.Bench(plane)
    return {"client": both, "camera": both, "plane": plane, "theta_deg": np.full((N, 2), 90.0)}


def parameters(folder, monkeypatch):
    """`client` of the bus of three positioners on the twin's bench, already found."""
    plane = small_plane()
    client = Client(TwinTransport(Twin(plane, draw_units(plane, 0), seed=0, neighbours=False)))
    asyncio.run(client.discover())
    return {"client": client}


def survey(folder, monkeypatch):
    """`layout`, and `theta_deg` and `xy_mm` (N, S, 2) of S configurations."""
    layout = small_plane()
    theta_deg = np.random.default_rng(0).uniform((0, 60), (360, 180), (N, 40, 2))
    xy_mm = np.stack([layout.forward(*theta_deg[:, k].T) for k in range(40)], axis=1)
    return {"layout": layout, "theta_deg": theta_deg, "xy_mm": xy_mm}


def maps(folder, monkeypatch):
    """`plane`, its `maps`, and `theta_deg` and measured `xy_mm` (N, 2)."""
    plane = small_plane()
    linear: TransmissionMaps = identity(plane.positioner_id)
    theta_deg = np.full((N, 2), 90.0)
    xy_mm = plane.forward(*theta_deg.T, fibre=METROLOGY) + 0.003
    return {"plane": plane, "maps": linear, "theta_deg": theta_deg, "xy_mm": xy_mm}


def gateways(folder, monkeypatch):
    """The twin answers where the block opens gateways."""
    plane = small_plane()
    twin = Twin(plane, draw_units(plane, seed=0), seed=0, neighbours=False)

    async def opened(hosts):
        assert hosts
        return TwinTransport(twin)

    monkeypatch.setattr(CanNetTransport, "open", opened)
    return {}


def first_field(folder, monkeypatch):
    """targets.csv in the current folder, and a field of seven positioners where more are asked for."""
    matplotlib.use("Agg")
    (folder / "targets.csv").write_bytes((TESTS.parent / "examples" / "targets_sdssv.csv").read_bytes())
    of = FocalPlane.of
    monkeypatch.setattr(FocalPlane, "of", lambda name, seed=0, n=None: of(name, seed, 7))
    return {}


def sky_list(folder, monkeypatch):
    """stars.csv and field.toml in the current folder."""
    (folder / "stars.csv").write_text(
        "source_id,ra,dec,pmra,pmdec,ref_epoch\n1,213.71,53.08,10,-20,2016\n2,213.70,53.09,,,\n"
    )
    (folder / "field.toml").write_text(
        'ra_deg = 213.7042\ndec_deg = 53.08333\ntime = "2024-04-26T06:00:00"\ntime_scale = "utc"\n'
    )
    return {}
