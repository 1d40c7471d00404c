"""Calibrations that stand for the refraction of a block, for programs that keep their tie points.

A folder: a report, which images each calibration is for, cameras in the files of programs that
project rays into the image, and the change and its radial table for those that correct measured
points. The fit is in `unbend.block.calibration_fit`.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from unbend.block import calibration_fit as fit
from unbend.messages import Ledger
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.image import lattice_nodes
from unbend.tables.exports import messages
from unbend.tables.exports.colmap_files import colmap_camera
from unbend.tables.exports.correction_tables import flying_heights, lattice_parts
from unbend.tables.exports.export_format import (
    CORRECTIONS_USE,
    PIXEL_UM,
    ExportFormat,
    FinishedRun,
    Option,
    Values,
    frame_of_corrections,
    pixel_mm,
)
from unbend.tables.exports.metashape_calibration import name_of_file, write_metashape
from unbend.tables.exports.opensfm_project import opensfm_camera
from unbend.units import Array, Integers, Mask

_FLAGGED = 0.1  # part of the refraction that is left, beyond which a calibration is reported
_REFUSED = 0.5  # and refused
_NOTHING_PX = 0.02  # what no adjustment sees
_GOOD = 0.05  # f and k1 do where they leave this part of the refraction
_AS_GOOD = 1.2  # or so many times what all parameters leave
# A lattice over some images holds the calibration where nothing was measured.
_MOST_IMAGES = 60
_COLUMNS = 15
_ROWS = 11
_NODE_WEIGHT = 0.1  # of all nodes together, of the observations' 1
_MOST_ROWS = 200_000
_LARGEST_ZETA_RAD = np.radians(80.0)
_LARGEST_MISFIT_PX = 0.02
_RADII = 25  # of a table of radial corrections
_PIXELS = ["x_px", "y_px", "x_corrected_px", "y_corrected_px"]


class Rms(NamedTuple):
    """Root mean squares in the image [px], and across the rays at the ground [m]."""

    px: float
    m: float


@dataclass(frozen=True, eq=False)
class FittedCalibration:
    """The calibration of a camera for one flying height.

    ``stations`` are the rows of its images; ``base`` is the calibrated camera in the model that is
    written, ``camera`` that which stands for refraction, ``change`` the same for measured points.
    ``effect`` is that of refraction; what both calibrations leave of it stands beside it.
    ``pixel_mm`` is NaN where it is not known.
    """

    name: str
    camera_name: str
    stations: Integers
    base: Camera
    camera: Camera
    change: fit.CorrectionChange
    pixel_mm: float
    heights: str
    effect: Rms
    left_by_camera: Rms
    left_by_change: Rms

    @property
    def part(self) -> float:
        """The largest part of the effect that is left."""
        left_px = max(self.left_by_camera.px, self.left_by_change.px)
        return left_px / max(self.effect.px, 1e-12)


def write_calibrations(run: FinishedRun, values: Values, path: Path, ledger: Ledger) -> int:
    """The files of all calibrations; the number of images they are for."""
    observed = observed_corrections(run)
    calibrations = []
    for name, stations in flying_heights(run, values["same_height"] / 100.0, ledger):
        fitted = fit_calibration(run, name, stations, observed, values=values, ledger=ledger)
        calibrations.append(fitted)
    if not calibrations:
        raise messages.no_calibration(where="observations")
    rows = []
    for fitted in calibrations:
        _judge(fitted, ledger)
        for station in fitted.stations:
            rows.append((run.stations.image[station], fitted.camera_name, fitted.name))
    (path / "calibration.txt").write_text(report_of(calibrations), encoding="utf-8")
    images = pd.DataFrame(rows, columns=["image", "camera", "calibration"])
    images.to_csv(path / "images.csv", index=False)
    corrections = pd.concat([radial_corrections(fitted) for fitted in calibrations])
    corrections.to_csv(path / "corrections.csv", index=False)
    write_cameras(calibrations, path)
    return len(rows)


def _judge(fitted: FittedCalibration, ledger: Ledger) -> None:
    """Report a calibration that leaves a part of the refraction; refuse one that leaves most."""
    where = f"cameras.{fitted.camera_name}"
    left = max(fitted.left_by_camera, fitted.left_by_change)
    percent = 100.0 * fitted.part
    if fitted.part > _REFUSED and left.px > _NOTHING_PX:
        raise messages.calibration_impossible(
            where=where,
            name=fitted.name,
            percent=percent,
            left=left,
            effect=fitted.effect,
        )
    if fitted.part > _FLAGGED:
        leaves = messages.calibration_leaves(
            where=where,
            count=fitted.stations.size,
            name=fitted.name,
            percent=percent,
            left=left,
            effect=fitted.effect,
        )
        ledger.add(leaves)


STATION = 0
MEASURED = slice(1, 3)
CORRECTED = slice(3, 5)
NADIR_ANGLE = 5
GROUND = 6
"""Rows of `observed_corrections`: x and y in COLMAP's pixels, nadir angle [rad], height [m]."""


def observed_corrections(run: FinishedRun) -> Array:
    """(7, n) corrected observations spread over the run's, in COLMAP's pixels.

    Rows: station, measured x and y, corrected x and y, nadir angle [rad], height of the point [m].
    """
    parts = [np.empty((7, 0))]
    columns = [*_PIXELS, "zeta_c_rad", "h_g_m", "status"]
    for station, table in run.observations(columns, _MOST_ROWS):
        points = [run.pixels.to_colmap(table[name].to_numpy()) for name in _PIXELS]
        rows = np.stack([station, *points, table["zeta_c_rad"], table["h_g_m"]])
        is_ok = pc.equal(table["status"], "ok").to_numpy()
        parts.append(rows[:, is_ok])
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class SeenCorrections:
    """What some stations of a camera saw, at their observations and at the nodes of a lattice.

    ``moved_px`` (n, 2) is the correction, ``pixel_m`` (n,) the size of a pixel across the ray at
    the ground; ``is_judged`` (n,) are the rows to judge by: observations, or nodes where there is
    none.
    """

    rays: fit.SeenRays
    moved_px: Array
    pixel_m: Array
    is_judged: Mask

    def rms(self, left_px: Array) -> Rms:
        """Root mean square of (n, 2) what is left in the image."""
        square = np.sum(left_px**2, axis=1)[self.is_judged]
        square_m2 = square * self.pixel_m[self.is_judged] ** 2
        return Rms(
            px=float(np.sqrt(np.mean(square))),
            m=float(np.sqrt(np.mean(square_m2))),
        )


def seen_rays(
    run: FinishedRun,
    camera: str,
    stations: Integers,
    observed: Array,
) -> SeenCorrections:
    """What some stations of a camera saw: observations (7, n) of the run, and nodes.

    Observations together have the weight 1 a row in the mean, nodes a tenth of theirs.
    """
    calibrated = run.cameras[camera].camera
    nodes = _lattice_corrections(run, camera, stations)
    nodes = nodes[:, nodes[NADIR_ANGLE] < _LARGEST_ZETA_RAD]
    of_stations = observed[:, np.isin(observed[STATION], stations)]
    rows = np.concatenate([of_stations, nodes], axis=1)
    is_node = np.arange(rows.shape[1]) >= of_stations.shape[1]
    u, v, covered = calibrated.rays(*rows[CORRECTED])
    rows = rows[:, covered]
    is_node = is_node[covered]
    node_weight = _NODE_WEIGHT / is_node.sum()
    observation_weight = 1.0 / max(1, (~is_node).sum())
    weight = np.where(is_node, node_weight, observation_weight)
    height_m = run.exposures.height_m[rows[STATION].astype(int)]
    distance_m = (height_m - rows[GROUND]) / np.cos(rows[NADIR_ANGLE])
    return SeenCorrections(
        rays=fit.SeenRays(
            np.stack([u, v], axis=1)[covered],
            rows[MEASURED].T,
            weight * is_node.size,
        ),
        moved_px=(rows[CORRECTED] - rows[MEASURED]).T,
        pixel_m=distance_m / calibrated.fx_px,
        is_judged=is_node if is_node.all() else ~is_node,
    )


def _lattice_corrections(
    run: FinishedRun,
    camera: str,
    stations: Integers,
) -> Array:
    """As `observed_corrections`, at the nodes of a lattice over some images of a camera."""
    sampled = np.linspace(0, stations.size - 1, min(stations.size, _MOST_IMAGES)).round()
    sampled_stations = stations[sampled.astype(int)]
    x, y = lattice_nodes(run.cameras[camera].camera, _COLUMNS, _ROWS)
    parts = []
    for part, corrections in lattice_parts(run, camera, sampled_stations, (x, y)):
        rows = [
            np.repeat(part, x.size),
            np.tile(x, part.size),
            np.tile(y, part.size),
            corrections.x_corrected_px,
            corrections.y_corrected_px,
            corrections.zeta_c_rad,
            np.repeat(run.ground_m[part], x.size),
        ]
        parts.append(np.stack(rows))
    return np.concatenate(parts, axis=1)


def fit_calibration(
    run: FinishedRun,
    name: str,
    stations: Integers,
    observed: Array,
    *,
    values: Values,
    ledger: Ledger,
) -> FittedCalibration:
    """The calibration of some images of a camera, by as few parameters as do."""
    calibrated = run.cameras[name]
    if calibrated.has_refraction:
        ledger.add(
            messages.calibration_holds_refraction(where=f"cameras.{name}.calibration", name=name)
        )
    seen = seen_rays(run, name, stations, observed)
    base = as_written(calibrated.camera, name, ledger)
    effect = seen.rms(seen.moved_px)
    camera = fit.fitted_camera(base, seen.rays, fit.NADIR_PARAMETERS)
    full_camera = fit.fitted_camera(base, seen.rays, fit.ALL_PARAMETERS)
    left_by_camera = seen.rms(seen.rays.residual_px(camera))
    left_by_full = seen.rms(seen.rays.residual_px(full_camera))
    unknowns: Sequence[str] = ("c", "k1")
    if left_by_camera.px > max(_GOOD * effect.px, _AS_GOOD * left_by_full.px):
        camera = full_camera
        left_by_camera = left_by_full
        unknowns = fit.CORRECTION_TERMS
    change, left_px = fit.correction_change(calibrated.camera, seen.rays, unknowns)
    height_m = run.exposures.height_m[stations]
    ground_m = run.ground_m[stations]
    above_m = height_m - ground_m
    heights = (
        f"{above_m.min():.0f} to {above_m.max():.0f} m above the ground (cameras "
        f"{np.median(height_m):.0f}, ground {np.median(ground_m):.0f} m above sea level)"
    )
    return FittedCalibration(
        name=f"{name_of_file(name)}_{np.median(above_m):.4g}m",
        camera_name=name,
        stations=stations,
        base=base,
        camera=camera,
        change=change,
        pixel_mm=pixel_mm(run, name, values),
        heights=heights,
        effect=effect,
        left_by_camera=left_by_camera,
        left_by_change=seen.rms(left_px),
    )


def as_written(camera: Camera, name: str, ledger: Ledger) -> Camera:
    """A camera as Brown-Conrady or fisheye, which all programs have (ledger: EXPORT-MODEL)."""
    if isinstance(camera.distortion, BrownConrady | OpenCVFisheye):
        return camera
    x, y = lattice_nodes(camera, 2 * _COLUMNS, 2 * _ROWS)
    u, v, covered = camera.rays(x, y)
    rays = fit.SeenRays(
        np.stack([u, v], axis=1)[covered],
        np.stack([x, y], axis=1)[covered],
        np.ones(covered.sum()),
    )
    lens = camera.distortion
    radial = BrownConrady(lens.k1, lens.k2, lens.k3)
    written = fit.fitted_camera(replace(camera, distortion=radial), rays, fit.ALL_PARAMETERS)
    misfit_px = float(np.hypot(*rays.residual_px(written).T).max())
    if misfit_px > _LARGEST_MISFIT_PX:
        ledger.add(messages.lens_simplified(where=f"cameras.{name}", name=name, misfit=misfit_px))
    return written


def report_of(calibrations: Sequence[FittedCalibration]) -> str:
    """What the report says: how calibrations are used, and what each holds and leaves."""
    from jinja2 import StrictUndefined, Template  # which no run needs

    def numbers(fitted: FittedCalibration) -> Iterator[tuple[str, float, float]]:
        names = ("fx", "fy", "cx", "cy", *fitted.base.distortion._fields)
        return zip(names, _numbers(fitted.base), _numbers(fitted.camera), strict=True)

    text = files("unbend.tables").joinpath("data/calibrations.txt.j2").read_text("utf-8")
    template = Template(
        text,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return str(template.render(found=calibrations, numbers=numbers))


def _numbers(camera: Camera) -> list[float]:
    """fx, fy, cx, cy [px] and the coefficients of a camera."""
    numbers = [
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        *camera.distortion,
    ]
    return [float(number) for number in numbers]


def radial_corrections(fitted: FittedCalibration) -> pd.DataFrame:
    """What is added to radii, with the new principal distance and with the calibrated one."""
    camera = fitted.base
    c = camera.fx_px
    x, y = lattice_nodes(camera, 2, 2)
    corner_px = np.hypot(x - camera.cx_px, y - camera.cy_px).max()
    r = np.linspace(0.0, np.ceil(corner_px), _RADII) / c
    dr = fitted.change.radial(r)
    same_c = (r + dr) / (1.0 + fitted.change.c) - r
    mm = c * fitted.pixel_mm
    return pd.DataFrame(
        {
            "calibration": fitted.name,
            "radius_px": r * c,
            "dr_px": dr * c,
            "dr_same_c_px": same_c * c,
            "radius_mm": r * mm,
            "dr_um": dr * mm * 1e3,
            "dr_same_c_um": same_c * mm * 1e3,
        }
    )


def write_cameras(calibrations: Sequence[FittedCalibration], path: Path) -> None:
    """cameras.txt of COLMAP, camera_models.json of OpenSfM; for each an XML and OpenCV's YAML."""
    colmap = ["#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    opensfm = {}
    for number, fitted in enumerate(calibrations, start=1):
        model, parameters = colmap_camera(fitted.camera, fitted.camera_name, simplest=False)
        parameters = [float(parameter) for parameter in parameters]
        colmap.append(f"# {number}: {fitted.name}")
        size = f"{fitted.camera.width_px} {fitted.camera.height_px}"
        colmap.append(f"{number} {model} {size} {' '.join(map(repr, parameters))}")
        opensfm[fitted.name] = opensfm_camera(fitted.camera, fitted.camera_name)
        write_metashape(fitted.camera, path / f"{fitted.name}.xml")
        _write_opencv(fitted.camera, parameters, path / f"{fitted.name}.yaml")
    (path / "cameras.txt").write_text("\n".join([*colmap, ""]), encoding="utf-8")
    (path / "camera_models.json").write_text(json.dumps(opensfm, indent=4), encoding="utf-8")


def _write_opencv(camera: Camera, parameters: Sequence[float], path: Path) -> None:
    """OpenCV's YAML, of COLMAP's ``parameters``: the centre of the first pixel is (0, 0)."""
    fx, fy = parameters[:2]
    cx, cy = parameters[2:4]
    is_fisheye = isinstance(camera.distortion, OpenCVFisheye)
    coefficients = parameters[4:8] if is_fisheye else parameters[4:9]
    matrix = [fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0]
    yaml = f"%YAML:1.0\n---\nimage_width: {camera.width_px}\nimage_height: {camera.height_px}\n"
    yaml += _opencv_matrix("camera_matrix", matrix, rows=3)
    yaml += _opencv_matrix("distortion_coefficients", coefficients, rows=1)
    path.write_text(yaml, encoding="utf-8")


def _opencv_matrix(name: str, values: Sequence[float], *, rows: int) -> str:
    """The lines of a matrix in OpenCV's YAML."""
    return (
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {len(values) // rows}\n"
        f"   dt: d\n   data: [ {', '.join(map(repr, values))} ]\n"
    )


SAME_HEIGHT = Option(
    "same_height",
    float,
    default=10.0,
    help="largest difference of heights above ground that share a calibration",
    unit="%",
    minimum=0.1,
    maximum=50.0,
)

FORMATS = (
    ExportFormat(
        "calibration",
        "cameras with calibrations that contain the refraction, a folder",
        "",
        write_calibrations,
        frame_of_corrections,
        options=(SAME_HEIGHT, PIXEL_UM),
        use=CORRECTIONS_USE,
    ),
)
