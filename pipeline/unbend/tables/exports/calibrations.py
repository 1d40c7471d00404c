"""Calibrations that contain the refraction of a block, for programs that keep their tie points.

A folder: a report, the images of each calibration, cameras in the files of programs that project
rays into the image, and, for programs that correct measured points, the change of the correction
with its radial table. The fit is in `unbend.block.calibration_fit`.
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

_REPORTED_SHARE = 0.1  # residual over refraction from which a calibration is a loss
_REFUSED_SHARE = 0.5  # and from which it is refused,
_NEGLIGIBLE_PX = 0.02  # unless the residual is smaller than this, which no adjustment notices
_GOOD_SHARE = 0.05  # f and k1 suffice if their residual is less than this share of the refraction,
_GOOD_RATIO = 1.2  # or than this times the residual of all parameters

# Nodes of a lattice over some images constrain the calibration where nothing was measured.
_MOST_IMAGES_WITH_NODES = 60
_NODE_COLUMNS = 15
_NODE_ROWS = 11
_NODES_WEIGHT = 0.1  # of all nodes together, that of all observations being 1

_MOST_OBSERVATIONS = 200_000  # that are read, of all cameras
_LARGEST_ZETA_RAD = np.radians(80.0)  # nadir angle of nodes
_LARGEST_MISFIT_PX = 0.02  # of a simplified lens that is not reported
_RADII = 25  # of a table of radial corrections
_PIXELS = ["x_px", "y_px", "x_corrected_px", "y_corrected_px"]


class Rms(NamedTuple):
    """Root mean square of shifts, in the image [px] and across the rays at the ground [m]."""

    px: float
    m: float


@dataclass(frozen=True, eq=False)
class FittedCalibration:
    """The calibration of a camera for one flying height.

    ``name`` is that of the calibration. ``stations`` (n,) are the rows of its images. ``base`` is
    the calibrated camera in the lens model that is written, ``camera`` the same with refraction;
    ``change`` is the equivalent for programs that correct measured points. ``pixel_mm`` is NaN if
    it is unknown; ``heights`` describes the flying height. ``effect`` is the size of the
    refraction, the residuals are what ``camera`` and ``change`` do not reproduce of it.
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
    residual_of_camera: Rms
    residual_of_change: Rms

    @property
    def residual_share(self) -> float:
        """The larger of the two residuals over the refraction, in the image."""
        residual_px = max(self.residual_of_camera.px, self.residual_of_change.px)
        return residual_px / max(self.effect.px, 1e-12)


def write_calibrations(run: FinishedRun, values: Values, path: Path, ledger: Ledger) -> int:
    """Write the files of all calibrations; returns the number of images that have one.

    Refuses (MissionError) a run without ground heights (EXPORT-NO-GROUND), and a calibration that
    does not contain most of the refraction (EXPORT-RESIDUAL).
    """
    observed = observed_corrections(run)
    calibrations = []
    for name, stations in flying_heights(run, values["same_height"] / 100.0, ledger):
        fitted = fit_calibration(run, name, stations, observed, values=values, ledger=ledger)
        calibrations.append(fitted)
    if not calibrations:
        raise messages.no_calibration(where="observations")
    rows = []
    for fitted in calibrations:
        _check_residual(fitted, ledger)
        for station in fitted.stations:
            rows.append((run.stations.image[station], fitted.camera_name, fitted.name))
    (path / "calibration.txt").write_text(report_of(calibrations), encoding="utf-8")
    images = pd.DataFrame(rows, columns=["image", "camera", "calibration"])
    images.to_csv(path / "images.csv", index=False)
    corrections = pd.concat([radial_corrections(fitted) for fitted in calibrations])
    corrections.to_csv(path / "corrections.csv", index=False)
    write_cameras(calibrations, path)
    return len(rows)


def _check_residual(fitted: FittedCalibration, ledger: Ledger) -> None:
    """Add a loss for a calibration with a large residual; refuse one with a very large residual."""
    where = f"cameras.{fitted.camera_name}"
    residual = max(fitted.residual_of_camera, fitted.residual_of_change)  # the larger in px
    share = fitted.residual_share
    if share > _REFUSED_SHARE and residual.px > _NEGLIGIBLE_PX:
        raise messages.calibration_impossible(
            where=where,
            name=fitted.name,
            percent=100.0 * share,
            residual=residual,
            effect=fitted.effect,
        )
    if share > _REPORTED_SHARE:
        leaves = messages.calibration_leaves(
            where=where,
            count=fitted.stations.size,
            name=fitted.name,
            percent=100.0 * share,
            residual=residual,
            effect=fitted.effect,
        )
        ledger.add(leaves)


STATION = 0  # row of the station
MEASURED = slice(1, 3)  # x and y, COLMAP's pixels
CORRECTED = slice(3, 5)  # x and y, COLMAP's pixels
NADIR_ANGLE = 5  # of the ray at the camera [rad]
GROUND = 6  # height of the point above sea level [m]
"""Rows of `observed_corrections`."""


def observed_corrections(run: FinishedRun) -> Array:
    """(7, n) observations of status ok, every k-th of the run: rows `STATION` to `GROUND`."""
    parts = [np.empty((7, 0))]
    columns = [*_PIXELS, "zeta_c_rad", "h_g_m", "status"]
    for station, table in run.observations(columns, _MOST_OBSERVATIONS):
        points = [run.pixels.to_colmap(table[name].to_numpy()) for name in _PIXELS]
        rows = np.stack([station, *points, table["zeta_c_rad"], table["h_g_m"]])
        is_ok = pc.equal(table["status"], "ok").to_numpy()
        parts.append(rows[:, is_ok])
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class CorrectionSample:
    """Corrections of a camera at some stations: at observations and at nodes of a lattice, (n,).

    ``rays`` : the straight rays with the measured pixels and weights. ``correction_px`` (n, 2) :
    corrected less measured pixels. ``pixel_m`` (n,) : size of a pixel across the ray at the ground.
    ``is_in_rms`` (n,) : the rows that `rms` uses: observations, or nodes if there are none.
    """

    rays: fit.SeenRays
    correction_px: Array
    pixel_m: Array
    is_in_rms: Mask

    def rms(self, shift_px: Array) -> Rms:
        """Root mean square length of shifts (n, 2) in the image."""
        square_px2 = np.sum(shift_px**2, axis=1)[self.is_in_rms]
        square_m2 = square_px2 * self.pixel_m[self.is_in_rms] ** 2
        return Rms(
            px=float(np.sqrt(np.mean(square_px2))),
            m=float(np.sqrt(np.mean(square_m2))),
        )


def correction_sample(
    run: FinishedRun,
    camera: str,
    stations: Integers,
    observed: Array,
) -> CorrectionSample:
    """The corrections of a camera at some of its stations.

    ``stations`` (s,) are rows, ``observed`` (7, m) the `observed_corrections` of the run. The
    weights of all observations add up to the number of rows, those of all nodes to a tenth of it.
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
    node_weight = _NODES_WEIGHT / max(1, is_node.sum())
    observation_weight = 1.0 / max(1, (~is_node).sum())
    weight = np.where(is_node, node_weight, observation_weight)
    height_m = run.exposures.height_m[rows[STATION].astype(int)]
    distance_m = (height_m - rows[GROUND]) / np.cos(rows[NADIR_ANGLE])
    return CorrectionSample(
        rays=fit.SeenRays(
            np.stack([u, v], axis=1)[covered],
            rows[MEASURED].T,
            weight * is_node.size,
        ),
        correction_px=(rows[CORRECTED] - rows[MEASURED]).T,
        pixel_m=distance_m / calibrated.fx_px,
        is_in_rms=is_node if is_node.all() else ~is_node,
    )


def _lattice_corrections(
    run: FinishedRun,
    camera: str,
    stations: Integers,
) -> Array:
    """(7, n) rows as of `observed_corrections`, at the nodes of a lattice over each image.

    Of the stations (s,) of the camera, some tens are taken at equal steps.
    """
    images = min(stations.size, _MOST_IMAGES_WITH_NODES)
    sampled = np.linspace(0, stations.size - 1, images).round()
    sampled_stations = stations[sampled.astype(int)]
    x, y = lattice_nodes(run.cameras[camera].camera, _NODE_COLUMNS, _NODE_ROWS)
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
    """Fit the calibration of a camera to the corrections at some of its stations.

    It changes f and k1 if they suffice, else all parameters of the camera's model. ``name`` is that
    of the camera, ``stations`` (s,) are rows, ``observed`` (7, m) `observed_corrections`,
    ``values`` the options of the format.
    """
    calibrated = run.cameras[name]
    if calibrated.has_refraction:
        ledger.add(
            messages.calibration_holds_refraction(where=f"cameras.{name}.calibration", name=name)
        )
    sample = correction_sample(run, name, stations, observed)
    base = in_common_model(calibrated.camera, name, ledger)
    effect = sample.rms(sample.correction_px)
    camera = fit.fitted_camera(base, sample.rays, fit.NADIR_PARAMETERS)
    full_camera = fit.fitted_camera(base, sample.rays, fit.ALL_PARAMETERS)
    residual = sample.rms(sample.rays.residual_px(camera))
    full_residual = sample.rms(sample.rays.residual_px(full_camera))
    unknowns_of_change: Sequence[str] = ("c", "k1")
    if residual.px > max(_GOOD_SHARE * effect.px, _GOOD_RATIO * full_residual.px):
        camera = full_camera
        residual = full_residual
        unknowns_of_change = fit.CORRECTION_TERMS
    change, change_residual_px = fit.correction_change(
        calibrated.camera, sample.rays, unknowns_of_change
    )
    height_m = run.exposures.height_m[stations]
    ground_m = run.ground_m[stations]
    above_ground_m = height_m - ground_m
    heights = (
        f"{above_ground_m.min():.0f} to {above_ground_m.max():.0f} m above the ground (cameras "
        f"{np.median(height_m):.0f}, ground {np.median(ground_m):.0f} m above sea level)"
    )
    return FittedCalibration(
        name=f"{name_of_file(name)}_{np.median(above_ground_m):.4g}m",
        camera_name=name,
        stations=stations,
        base=base,
        camera=camera,
        change=change,
        pixel_mm=pixel_mm(run, name, values),
        heights=heights,
        effect=effect,
        residual_of_camera=residual,
        residual_of_change=sample.rms(change_residual_px),
    )


def in_common_model(camera: Camera, name: str, ledger: Ledger) -> Camera:
    """A camera in a lens model that all programs have: Brown-Conrady, or OpenCV's fisheye.

    A camera of another model becomes Brown-Conrady by a fit over the image; a misfit above 0.02 px
    is added as a loss (EXPORT-MODEL). ``name`` is for that message.
    """
    if isinstance(camera.distortion, BrownConrady | OpenCVFisheye):
        return camera
    x, y = lattice_nodes(camera, 2 * _NODE_COLUMNS, 2 * _NODE_ROWS)
    u, v, covered = camera.rays(x, y)
    rays = fit.SeenRays(
        np.stack([u, v], axis=1)[covered],
        np.stack([x, y], axis=1)[covered],
        np.ones(covered.sum()),
    )
    lens = camera.distortion
    first_guess = BrownConrady(lens.k1, lens.k2, lens.k3)
    fitted = fit.fitted_camera(replace(camera, distortion=first_guess), rays, fit.ALL_PARAMETERS)
    misfit_px = float(np.hypot(*rays.residual_px(fitted).T).max())
    if misfit_px > _LARGEST_MISFIT_PX:
        ledger.add(messages.lens_simplified(where=f"cameras.{name}", name=name, misfit=misfit_px))
    return fitted


def report_of(calibrations: Sequence[FittedCalibration]) -> str:
    """The text of the report: how calibrations are used, their parameters and residuals."""
    from jinja2 import StrictUndefined, Template  # imported here because runs do not need it

    def parameters(fitted: FittedCalibration) -> Iterator[tuple[str, float, float]]:
        """Name, value before and value after of each parameter."""
        names = ("fx", "fy", "cx", "cy", *fitted.base.distortion._fields)
        return zip(names, _parameters(fitted.base), _parameters(fitted.camera), strict=True)

    text = files("unbend.tables").joinpath("data/calibrations.txt.j2").read_text("utf-8")
    template = Template(
        text,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return str(template.render(calibrations=calibrations, parameters=parameters))


def _parameters(camera: Camera) -> list[float]:
    """fx, fy, cx, cy [px] and the coefficients of a camera."""
    parameters = [
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        *camera.distortion,
    ]
    return [float(parameter) for parameter in parameters]


def radial_corrections(fitted: FittedCalibration) -> pd.DataFrame:
    """What is added to radii, from the principal point to the farthest corner.

    ``dr`` goes with the new principal distance, ``dr_same_c`` with the calibrated one. Columns in
    mm and um are NaN if the size of a pixel is unknown.
    """
    camera = fitted.base
    c_px = camera.fx_px
    corner_x, corner_y = lattice_nodes(camera, 2, 2)
    farthest_px = np.hypot(corner_x - camera.cx_px, corner_y - camera.cy_px).max()
    # Radii in units of the principal distance c.
    r = np.linspace(0.0, np.ceil(farthest_px), _RADII) / c_px
    dr = fitted.change.radial(r)
    dr_same_c = (r + dr) / (1.0 + fitted.change.c) - r
    c_mm = c_px * fitted.pixel_mm
    return pd.DataFrame(
        {
            "calibration": fitted.name,
            "radius_px": r * c_px,
            "dr_px": dr * c_px,
            "dr_same_c_px": dr_same_c * c_px,
            "radius_mm": r * c_mm,
            "dr_um": dr * c_mm * 1e3,
            "dr_same_c_um": dr_same_c * c_mm * 1e3,
        }
    )


def write_cameras(calibrations: Sequence[FittedCalibration], path: Path) -> None:
    """Write the fitted cameras into the folder ``path``.

    All in cameras.txt of COLMAP and camera_models.json of OpenSfM; each in an XML of Metashape and
    a YAML of OpenCV.
    """
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
    """Write a camera as OpenCV's YAML, in which the centre of the first pixel is (0, 0).

    ``parameters`` are those of COLMAP's OPENCV_FISHEYE or FULL_OPENCV.
    """
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
    """The lines of a matrix in OpenCV's YAML; ``values`` row by row."""
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
