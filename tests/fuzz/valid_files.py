"""A valid file for each reader, as the project writes it (or, where it only reads the kind, by hand)."""

import gzip
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table

import fiberloom as fl
from fiberloom.calibration.fibres.dithered import DitheredField, hexagon
from fiberloom.calibration.fibres.exposures_file import write_exposures
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.focal_plane.arms_file import save_arms
from fiberloom.calibration.focal_plane.fit import N_GEOMETRY, FocalPlaneFit
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.drive.steppers import AxisSteps, KnownUnits
from fiberloom.drive.steppers.kept import save_units
from fiberloom.instruments import write_layout
from fiberloom.instruments.model import Modules
from fiberloom.metrology import CameraImage, write_image, write_spots
from fiberloom.planning import write_configuration
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, ArrayPlaces
from fiberloom.store.learnt import OBSERVE, Learnt, LearntHistory
from fiberloom.tables import write_ecsv
from fiberloom.targets import TargetList, write_targets

PLANE = fl.FocalPlane.of("sdssv", seed=0, n=7)
IDS = PLANE.positioner_id
MARKS = {"version": "0.1.0", "seed": 0, "instrument": "sdssv", "config_hash": "cafe", "utc": "2026-01-01"}


def _targets() -> TargetList:
    rng = np.random.default_rng(0)
    return TargetList(
        target_id=np.array([f"t{k}" for k in range(12)]),
        x_mm=rng.uniform(-30, 30, 12).round(3),
        y_mm=rng.uniform(-30, 30, 12).round(3),
        priority=np.arange(12.0),
        fibre=np.array(["BOSS", "", "APOGEE"] * 4),
        positioner_id=np.array([*IDS, *[-1] * 5]),
    )


def targets_csv(path: Path) -> None:
    write_targets(_targets(), path, comments=("of a test",))


def targets_table(path: Path) -> None:
    made = _targets()
    names = ("target_id", "x_mm", "y_mm", "priority", "fibre", "positioner_id")
    Table({name: getattr(made, name) for name in names}).write(path)


CONFSUMMARY = """# confSummary of a test
configuration_id 12
typedef struct {
    int positionerId;
    char fiberType[10];
    int assigned;
    int valid;
    double xwok;
    double ywok;
    double extra[3];
    char name[20];
    long catalogid;
} FIBERMAP;

FIBERMAP 3 BOSS 1 1 1.5 -2.5 {1.0 nan 3} "two words" 900
FIBERMAP 3 APOGEE 0 1 9 9 {1 2 3} "" -999
FIBERMAP 4 APOGEE 1 1 3.5 4.5 {1 2 3} "" 901
FIBERMAP 6 BOSS 1 1 5 6 { 1 2 3 } x -999
"""


def targets_par(path: Path) -> None:
    text = CONFSUMMARY.encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)


def configuration(path: Path) -> None:
    write_configuration(path, IDS, PLANE.park_deg)


def layout(path: Path) -> None:
    write_layout(PLANE, path.parent)


def sdssv_layout(path: Path) -> None:
    """As the calibrations of SDSS-V: two positioners, a fiducial, one guide camera less."""
    frame = "1,0,0,0,1,0,0,0,1"
    path.with_name("positionerTable.csv").write_text(
        "holeID,positionerID,alphaArmLen,alphaOffset,betaOffset,dx,dy,metX,metY,bossX,bossY,apX,apY\n"
        "A,4,7.4,1.0,0.1,0.01,0.02,14.3,0.1,14.9,0.2,14.9,-0.3\n"
        "B,9,7.4,-2.0,0.2,0.0,0.03,14.3,0.1,14.9,0.2,14.9,-0.3\n"
    )
    path.with_name("wokCoords.csv").write_text(
        "holeID,holeType,xWok,yWok,ix,iy,iz,jx,jy,jz,kx,ky,kz\n"
        f"A,ApogeeBoss,0.0,0.0,{frame}\nB,Boss,22.4,0.0,{frame}\nF1,Fiducial,11.2,19.4,{frame}\n"
    )
    path.with_name("fiducialCoords.csv").write_text("holeID,xWok,yWok\nF1,11.2,19.4\n")


SMALL_PFS = fl.Instrument.of("pfs").model_copy(
    update={
        "layout": fl.Instrument.of("pfs").layout.model_copy(
            update={"n_positioners": 6, "modules": Modules(fields=1, per_field=2, positioners=3)}
        )
    }
)
"""PFS with two modules of three cobras."""


def desi_layout(path: Path) -> None:
    """As the calibrations of DESI: three units in two petals, one of them there twice."""
    names = [
        "petal_id", "location", "time_recorded", "length_r1", "length_r2", "offset_x", "offset_y", "offset_t",
        "offset_p", "physical_range_t", "physical_range_p", "device_classified_nonfunctional", "zeno_motor_p",
        "keepout_expansion_theta_radial", "keepout_expansion_theta_angular", "keepout_expansion_phi_radial",
        "keepout_expansion_phi_angular",
    ]  # fmt: skip
    rows = [
        "4,11,2023-05-01,3.01,3.06,60.5,20.25,10.0,-1.0,392.0,191.0,False,,0,0,0,0",
        "4,11,2021-05-01,2.90,3.00,60.4,20.25,10.0,-1.0,392.0,191.0,True,,0,0,0,0",
        "4,12,2023-05-01,2.95,3.10,70.5,20.25,-170.0,2.0,391.0,190.0,False,True,0,5.5,0,5.5",
        "5,1300,2023-05-01,3.00,3.05,200.5,-20.25,80.0,0.0,390.0,189.0,True,,0,0,0,0",
    ]
    path.with_name("calib-20260101.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    surface = "".join(f"{r},{-1e-4 * r**2},{r + 1e-9 * r**3}\n" for r in range(430))
    path.with_name("focal_surface_lookup.csv").write_text(f"# R mm\nR,Z,S\n{surface}")
    aligned = "".join(
        f"{k}:\n  Tx: {0.01 * k}\n  Ty: -0.02\n  alpha: 0.0\n  beta: 0.0\n  gamma: {0.6283 * k - 1.885}\n"
        for k in range(10)
    )
    path.with_name("petal-alignments.yaml").write_text(f"# petals\n{aligned}")
    path.with_name("fp-metrology.csv").write_text(
        "DEVICE_TYPE,PINHOLE_ID,X_FP,Y_FP\nFIF,1,10.0,20.0\nFIF,2,10.5,21.0\nGIF,1,390.0,1.0\nPOS,0,1.0,2.0\n"
    )


def pfs_layout(path: Path) -> None:
    """As the tables of PFS, of six cobras, the last of which has failed fits."""
    path.with_name("pfs_6_cobras_scalars.csv").write_text(
        "module,positioner,theta_ccw_home_deg,theta_cw_home_deg,phi_cw_limit_deg,phi_ccw_limit_deg,link1_px,link2_px\n"
        "SC01,1,78.0,94.9,181.8,-2.6,29.0,29.8\nSC01,2,248.6,270.5,184.9,-1.7,30.8,30.2\n"
        "SC01,3,350.0,12.0,189.0,2.0,29.5,29.9\nSC02,1,10.0,30.5,186.0,0.0,25.0,25.0\n"
        "SC02,2,100.0,121.0,187.0,1.0,25.5,24.8\nSC02,3,0,0,0,0,0,0\n"
    )
    path.with_name("black_dots_mm-2024-01-01.csv").write_text(
        "spotId,x,y,r\n" + "".join(f"{k},{-7.0 * k},{6.5 - k},0.75\n" for k in range(1, 7))
    )
    path.with_name("fiducial_positions_20240101.csv").write_text(
        "# measured\nfiducialId,x_mm,y_mm,flag\n1,-15.7,9.9,2\n2,-30.5,17.1,0\n3,,,1\n"
    )


def megara_layout(path: Path) -> None:
    """As the table of MEGARA: two robots, and a disabled one."""
    ends = "-0.043633,6.326819,-0.043633,3.185226"
    path.with_name("derived_megara_3_rps.csv").write_text(
        "Id,L01,L12,x0,y0,thetaO1,Disabled,theta_1min,theta_1max,theta___3min,theta___3max\n"
        f"1,5.972,5.936,-0.019,52.218,0.01,False,{ends}\n2,5.987,5.936,-60.325,87.049,-0.02,False,{ends}\n"
        f"93,5.8025,5.8025,-80.4,87.04,0.0,True,{ends}\n"
    )


def pfs_module(path: Path) -> None:
    """As the file of a module: two cobras with three bins."""
    edges = "3,200,133.3,266.7,400.0"
    text = []
    for k in range(2):
        rows = "".join(
            f"<Joint{j}_{w}_regions>{edges}</Joint{j}_{w}_regions>"
            f"<Joint{j}_{w}_stepsizes>3,200,0.0{j}1,0.0{j}2,0.0{k + 3}</Joint{j}_{w}_stepsizes>"
            for j in (1, 2)
            for w in ("fwd", "rev")
        )
        pulses = "".join(
            f"<Link{j}_{w}_Duration{s}>0.0{2 * j + (not s)}</Link{j}_{w}_Duration{s}>"
            for j in (1, 2)
            for w in ("fwd", "rev")
            for s in ("", "_Slow")
        )
        tables = "".join(f"<{s}_CALIBRATION_TABLE>{rows}</{s}_CALIBRATION_TABLE>" for s in ("SLOW", "FAST"))
        text.append(f"<ARM_DATA_CONTAINER><KINEMATICS>{pulses}</KINEMATICS>{tables}</ARM_DATA_CONTAINER>")
    path.write_text(f"<?xml version='1.0' encoding='UTF-8'?>\n<ARM_DATA>{''.join(text)}</ARM_DATA>\n")


def instrument(path: Path) -> None:
    presets = Path(fl.__file__).parent / "instruments" / "presets"
    path.write_bytes((presets / "sdssv.toml").read_bytes())


SITE = """bus = "cannet://10.1.10.31,10.1.10.32"
camera = "alpaca://10.1.10.40:11111/0?exposure=5"
layout = "layout"
calibration = "transmission.npz"
store = "arrays.sqlite"
positioners = 37
seed = 4
exclude = [12, 40]

[limits]
disk_mb = 2000
clock_s = 1.5
"""


def site(path: Path) -> None:
    path.write_text(SITE)


def maps(path: Path) -> None:
    output = np.broadcast_to(np.linspace(0.0, 360.0, 20), (len(IDS), 2, 2, 20)).copy()
    TransmissionMaps(IDS, output + 0.1, output, Provenance(seed=0, note="of a test")).save(path)


def trajectories(path: Path) -> None:
    fl.plan(PLANE, PLANE.park_deg, PLANE.park_deg - [20.0, 30.0]).save(path, **MARKS)


def arms(path: Path) -> None:
    n = len(IDS)
    fit = FocalPlaneFit(
        positioner_id=IDS,
        parameters=np.column_stack([PLANE.arms[:, :3], np.full(n, 15.0), PLANE.arms[:, 3:]]),
        covariance=np.tile(np.eye(N_GEOMETRY) * 1e-6, (n, 1, 1)),
        rank=np.full(n, 6),
        reason=[""] * (n - 1) + ["seen only 3 times"],
        used=np.ones((n, 8), dtype=bool),
        n_outliers=np.zeros(n, dtype=np.int64),
        rms_um=np.full(n, 1.5),
        chi2_dof=np.ones(n),
        angles_deg=(0.01, 0.01),
    )
    save_arms(path, fit, MARKS)


def fibres(path: Path) -> None:
    rows = [
        {"positioner_id": int(p), "fibre": "BOSS", "move": 1, "error_um": 1.25, "status": "on_target"}
        for p in IDS
    ]
    write_ecsv(path, rows, MARKS)


def offsets(path: Path) -> None:
    n = len(IDS)
    FibreOffsets(
        positioner_id=IDS,
        fibre=np.full(n, "BOSS"),
        offset_mm=np.full((n, 2), 0.0125),
        covariance_mm2=np.tile(1e-6 * np.eye(2), (n, 1, 1)),
        lever_mm=PLANE.points["BOSS"] - PLANE.points["metrology"],
    ).write(path, MARKS)


def exposures(path: Path) -> None:
    rng, n = np.random.default_rng(2), len(IDS)
    xy = PLANE.centres_mm.round(3)
    fluxes = rng.integers(100, 1000, (5, n)).astype(float)
    arm = rng.uniform(0.0, 360.0, n).round(2)
    field = DitheredField(
        "a", IDS, np.full(n, "BOSS"), xy, xy, arm, hexagon(n=5).round(3), fluxes, np.sqrt(fluxes)
    )
    write_exposures(path, field, MARKS)


def picture() -> np.ndarray:
    y, x = np.mgrid[:40, :60]
    noise = np.random.default_rng(3).normal(200.0, 3.0, (40, 60))
    return noise + sum(
        4000.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 4.0) for u, v in [(20.2, 11.3), (44.1, 27.9)]
    )


def image(path: Path) -> None:
    kind = np.float32 if path.name.startswith("float") else np.uint16
    write_image(CameraImage(picture().astype(kind), gain_e_adu=2.0, saturation_adu=6e4, exposure_s=1.5), path)


def tiles(path: Path) -> None:
    fits.CompImageHDU(picture().astype(np.uint16)).writeto(path, overwrite=True)


def spots(path: Path) -> None:
    write_spots(fl.centroid(picture()), path, {"version": "x"})


def store(path: Path) -> None:
    path.unlink(missing_ok=True)
    with Store.open(path) as made:
        with made.start_run(
            command_line="fiberloom observe", instrument="sdssv", config_hash="cafe", seed=1
        ) as run:
            for move in range(4):
                measured = {
                    "positioner_id": np.arange(1, 60),
                    "x_mm": np.linspace(-3.0, 3.0, 59),
                    "y_mm": np.linspace(0.0, 1.0, 59),
                    "alpha_deg": 12.5,
                    "target_id": np.array([f"t{k}" for k in range(59)]),
                    "status": np.array(["on_target"] * 59),
                    "error_um": np.linspace(0.0, 9.0, 59),
                }
                run.record_move(move, "blind", measured, time_s=float(move))
            run.record_event("flag", "positioner 3 is late", positioner_id=3)
            run.record_calibration(range(1, 20), "alpha", "transmission", "maps.npz", "12ab")
        history = LearntHistory(made, "cafe")
        data = np.random.default_rng(0).bytes(400)
        history.put(history.begin(OBSERVE, "sdssv", "cafe"), {p: Learnt(3, 0.5, data) for p in range(1, 12)})
        book = ArrayBook(made, "bus")
        book.exclude([4], "ann", "beta slips")
        book.note_places(
            IDS, ArrayPlaces(PLANE.park_deg, PLANE.park_deg, ["seen"] * 7, np.ones(7, dtype=bool), [None] * 7)
        )
    for beside in ("-wal", "-shm"):
        path.with_name(path.name + beside).unlink(missing_ok=True)


def units(path: Path) -> None:
    plane = fl.FocalPlane.of("megara", seed=0, n=3)
    known = KnownUnits.nominal(AxisSteps.of(plane.instrument), 3)
    save_units(known, plane, path)


WRITERS = {
    "targets.csv": targets_csv,
    "targets.ecsv": targets_table,
    "targets.fits": targets_table,
    "targets.par": targets_par,
    "targets.par.gz": targets_par,
    "configuration.csv": configuration,
    "layout/layout.toml": layout,
    "layout/positioners.ecsv": layout,
    "layout/fiducials.ecsv": layout,
    "sdssv/positionerTable.csv": sdssv_layout,
    "sdssv/wokCoords.csv": sdssv_layout,
    "desi/calib-20260101.csv": desi_layout,
    "desi/petal-alignments.yaml": desi_layout,
    "desi/focal_surface_lookup.csv": desi_layout,
    "desi/fp-metrology.csv": desi_layout,
    "pfs/pfs_6_cobras_scalars.csv": pfs_layout,
    "pfs/black_dots_mm-2024-01-01.csv": pfs_layout,
    "pfs/fiducial_positions_20240101.csv": pfs_layout,
    "megara/derived_megara_3_rps.csv": megara_layout,
    "module.xml": pfs_module,
    "instrument.toml": instrument,
    "site.toml": site,
    "maps.npz": maps,
    "units.npz": units,
    "trajectories.json": trajectories,
    "arms.ecsv": arms,
    "fibres.ecsv": fibres,
    "offsets.ecsv": offsets,
    "exposures.ecsv": exposures,
    "spots.csv": spots,
    "image.fits": image,
    "float.fits": image,
    "tiles.fits": tiles,
    "image.fits.gz": image,
    "store.sqlite": store,
}
"""By the name of the reader, which is that of the file."""
