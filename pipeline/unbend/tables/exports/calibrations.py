"""Calibrations that stand for the refraction of a block, for programs that keep their tie points.

A folder: a report, which images each calibration is for, cameras in the files of programs that
project rays into the image, and the change and its radial table for those that correct measured
points. The fit is in `unbend.block.calibration_fit`.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

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
from unbend.tables.exports.format import (
    CORRECTIONS_USE,
    PIXEL_UM,
    ExportFormat,
    FinishedRun,
    Option,
    Values,
    frame_of_corrections,
    pixel_mm,
)
from unbend.tables.exports.opensfm_project import opensfm_camera
from unbend.units import Array, Integers, Mask

# Parts of the refraction that a calibration may leave, and what no adjustment sees.
_FLAGGED, _REFUSED, _NOTHING_PX = 0.1, 0.5, 0.02
# f and k1 do where they leave this part of it, or so many times what all parameters leave.
_GOOD, _AS_GOOD = 0.05, 1.2
# A lattice over some images holds the calibration where nothing was measured.
_MOST_IMAGES, _COLUMNS, _ROWS, _NODE_WEIGHT = 60, 15, 11, 0.1
_MOST_ROWS = 200_000
_LARGEST_ZETA_RAD = np.radians(80.0)
_LARGEST_MISFIT_PX = 0.02


@dataclass(frozen=True, eq=False)
class FittedCalibration:
    """The calibration of a camera for one flying height.

    ``stations`` are the rows of its images; ``base`` is the calibrated camera in the model that is
    written, ``camera`` that which stands for refraction, ``change`` the same for measured points.
    ``effect`` and what both leave are root mean squares in the image [px] and across the rays at
    the ground [m]; ``pixel_mm`` is NaN where it is not known.
    """

    name: str
    camera_name: str
    stations: Integers
    base: Camera
    camera: Camera
    change: fit.CorrectionChange
    pixel_mm: float
    heights: str
    effect: tuple[float, float]
    left_by_camera: tuple[float, float]
    left_by_change: tuple[float, float]

    @property
    def part(self) -> float:
        """The largest part of the effect that is left."""
        return max(self.left_by_camera[0], self.left_by_change[0]) / max(self.effect[0], 1e-12)


def write_calibrations(run: FinishedRun, values: Values, path: Path, ledger: Ledger) -> int:
    """The files of all calibrations; the number of images they are for."""
    observed = observed_corrections(run)
    found = [
        fit_calibration(run, name, stations, observed, values=values, ledger=ledger)
        for name, stations in flying_heights(run, values["same_height"] / 100.0, ledger)
    ]
    if not found:
        raise messages.no_calibration(where="observations")
    for fitted in found:
        where = f"cameras.{fitted.camera_name}"
        left = max(fitted.left_by_camera, fitted.left_by_change)
        percent = 100.0 * fitted.part
        if fitted.part > _REFUSED and left[0] > _NOTHING_PX:
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
    (path / "calibration.txt").write_text(report_of(found), encoding="utf-8")
    for_images = [(run.stations.image[i], f.camera_name, f.name) for f in found for i in f.stations]
    images = pd.DataFrame(for_images, columns=["image", "camera", "calibration"])
    images.to_csv(path / "images.csv", index=False)
    pd.concat(map(radial_corrections, found)).to_csv(path / "corrections.csv", index=False)
    write_cameras(found, path)
    return len(for_images)


def observed_corrections(run: FinishedRun) -> Array:
    """(7, n) corrected observations spread over the run's, in COLMAP's pixels.

    Rows: station, measured x and y, corrected x and y, nadir angle [rad], height of the point [m].
    """
    pixels = ["x_px", "y_px", "x_corrected_px", "y_corrected_px"]
    parts = [np.empty((7, 0))]
    columns = [*pixels, "zeta_c_rad", "h_g_m", "status"]
    for station, table in run.observations(columns, _MOST_ROWS):
        points = [run.pixels.to_colmap(table[name].to_numpy()) for name in pixels]
        rows = np.stack([station, *points, table["zeta_c_rad"], table["h_g_m"]])
        parts.append(rows[:, pc.equal(table["status"], "ok").to_numpy()])
    return np.concatenate(parts, axis=1)


def seen_rays(
    run: FinishedRun, camera: str, stations: Integers, observed: Array
) -> tuple[fit.SeenRays, Array, Array, Mask]:
    """What some stations of a camera saw, at their observations and at the nodes of a lattice.

    Beside it (n, 2) the correction [px], (n,) the metres of a pixel across the ray at the ground,
    and which rows are to judge by: observations, or nodes where there is none. Observations
    together have the weight 1 a row in the mean, nodes a tenth of theirs.
    """
    given = run.cameras[camera].camera
    some = np.linspace(0, stations.size - 1, min(stations.size, _MOST_IMAGES)).round()
    x, y = lattice_nodes(given, _COLUMNS, _ROWS)
    parts = []
    for part, corrections in lattice_parts(run, camera, stations[some.astype(int)], (x, y)):
        columns = [
            np.repeat(part, x.size),
            np.tile(x, part.size),
            np.tile(y, part.size),
            corrections.x_corrected_px,
            corrections.y_corrected_px,
            corrections.zeta_c_rad,
            np.repeat(run.ground_m[part], x.size),
        ]
        parts.append(np.stack(columns))
    nodes = np.concatenate(parts, axis=1)
    nodes = nodes[:, nodes[5] < _LARGEST_ZETA_RAD]
    rows = np.concatenate([observed[:, np.isin(observed[0], stations)], nodes], axis=1)
    is_node = np.arange(rows.shape[1]) >= rows.shape[1] - nodes.shape[1]
    u, v, covered = given.rays(rows[3], rows[4])
    rows, is_node = rows[:, covered], is_node[covered]
    weight = np.where(is_node, _NODE_WEIGHT / is_node.sum(), 1.0 / max(1, (~is_node).sum()))
    rays = fit.SeenRays(np.stack([u, v], axis=1)[covered], rows[1:3].T, weight * is_node.size)
    height = run.exposures.height_m[rows[0].astype(int)]
    metres = (height - rows[6]) / np.cos(rows[5]) / given.fx_px
    return rays, (rows[3:5] - rows[1:3]).T, metres, ~is_node if not is_node.all() else is_node


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
    given = run.cameras[name]
    if given.has_refraction:
        ledger.add(
            messages.calibration_holds_refraction(where=f"cameras.{name}.calibration", name=name)
        )
    rays, moved, metres, judged = seen_rays(run, name, stations, observed)

    def rms(left: Array) -> tuple[float, float]:
        square = np.sum(left**2, axis=1)[judged]
        in_metres = float(np.sqrt(np.mean(square * metres[judged] ** 2)))
        return float(np.sqrt(np.mean(square))), in_metres

    base, effect = as_written(given.camera, name, ledger), rms(moved)
    few, full = (fit.changed_camera(base, rays, names) for names in (fit.FEW, fit.FULL))
    of_few, of_full = (rms(rays.left_px(camera)) for camera in (few, full))
    few_do = of_few[0] <= max(_GOOD * effect[0], _AS_GOOD * of_full[0])
    free = ("c", "k1") if few_do else fit.CORRECTIONS
    change, left = fit.correction_change(given.camera, rays, free)
    height, ground = run.exposures.height_m[stations], run.ground_m[stations]
    above = height - ground
    return FittedCalibration(
        f"{re.sub(r'[^0-9A-Za-z._-]', '_', name)}_{np.median(above):.4g}m",
        name, stations, base, few if few_do else full, change,
        pixel_mm(run, name, values),
        f"{above.min():.0f} to {above.max():.0f} m above the ground (cameras "
        f"{np.median(height):.0f}, ground {np.median(ground):.0f} m above sea level)",
        effect, of_few if few_do else of_full, rms(left),
    )  # fmt: skip


def as_written(camera: Camera, name: str, ledger: Ledger) -> Camera:
    """A camera as Brown-Conrady or fisheye, which all programs have (ledger: EXPORT-MODEL)."""
    if isinstance(camera.distortion, BrownConrady | OpenCVFisheye):
        return camera
    x, y = lattice_nodes(camera, 2 * _COLUMNS, 2 * _ROWS)
    u, v, covered = camera.rays(x, y)
    uv, xy = (np.stack(pair, axis=1)[covered] for pair in ((u, v), (x, y)))
    pixels = fit.SeenRays(uv, xy, np.ones(covered.sum()))
    lens = camera.distortion
    plain = replace(camera, distortion=BrownConrady(lens.k1, lens.k2, lens.k3))
    written = fit.changed_camera(plain, pixels, fit.FULL)
    misfit = float(np.hypot(*pixels.left_px(written).T).max())
    if misfit > _LARGEST_MISFIT_PX:
        ledger.add(messages.lens_simplified(where=f"cameras.{name}", name=name, misfit=misfit))
    return written


def report_of(found: Sequence[FittedCalibration]) -> str:
    """What the report says: how calibrations are used, and what each holds and leaves."""
    from jinja2 import StrictUndefined, Template  # which no run needs

    def numbers(fitted: FittedCalibration) -> Iterator[tuple[str, float, float]]:
        names = ("fx", "fy", "cx", "cy", *fitted.base.distortion._fields)
        return zip(names, _numbers(fitted.base), _numbers(fitted.camera), strict=True)

    text = files("unbend.tables").joinpath("data/calibrations.txt.j2").read_text("utf-8")
    made = Template(text, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    return str(made.render(found=found, numbers=numbers))


def _numbers(camera: Camera) -> list[float]:
    frame = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    return [float(number) for number in (*frame, *camera.distortion)]


def radial_corrections(fitted: FittedCalibration) -> pd.DataFrame:
    """What is added to radii, with the new principal distance and with the calibrated one."""
    camera, c = fitted.base, fitted.base.fx_px
    x, y = lattice_nodes(camera, 2, 2)
    corner = np.hypot(x - camera.cx_px, y - camera.cy_px).max()
    r = np.linspace(0.0, np.ceil(corner), 25) / c
    dr = fitted.change.radial(r)
    same_c = (r + dr) / (1.0 + fitted.change.c) - r
    mm = c * fitted.pixel_mm
    return pd.DataFrame({
        "calibration": fitted.name, "radius_px": r * c, "dr_px": dr * c, "dr_same_c_px": same_c * c,
        "radius_mm": r * mm, "dr_um": dr * mm * 1e3, "dr_same_c_um": same_c * mm * 1e3,
    })  # fmt: skip


def write_cameras(found: Sequence[FittedCalibration], path: Path) -> None:
    """cameras.txt of COLMAP, camera_models.json of OpenSfM; for each an XML and OpenCV's YAML."""
    colmap = ["#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    opensfm = {}
    for number, fitted in enumerate(found, 1):
        camera, lens = fitted.camera, fitted.camera.distortion._asdict()
        w, h, (fx, fy, cx, cy) = camera.width_px, camera.height_px, _numbers(camera)[:4]
        fisheye = isinstance(camera.distortion, OpenCVFisheye)
        model, params = colmap_camera(camera, fitted.camera_name, simplest=False)
        params = [float(number) for number in params]
        ordered = params[4 : 8 if fisheye else 9]
        colmap += [f"# {number}: {fitted.name}",
                   f"{number} {model} {w} {h} {' '.join(map(repr, params))}"]  # fmt: skip
        opensfm[fitted.name] = opensfm_camera(camera, fitted.camera_name)
        # Metashape: x is projected with f + b1, and P1 belongs to x.
        p1, p2 = lens.pop("p1", 0.0), lens.pop("p2", 0.0)
        root = ElementTree.Element("calibration")
        for tag, value in {
            "projection": "fisheye" if fisheye else "frame", "width": w, "height": h, "f": fy,
            "cx": cx - 0.5 * w, "cy": cy - 0.5 * h, "b1": fx - fy, **lens, "p1": p2, "p2": p1,
        }.items():  # fmt: skip
            ElementTree.SubElement(root, tag).text = str(value)
        ElementTree.indent(root)
        tree = ElementTree.ElementTree(root)
        tree.write(path / f"{fitted.name}.xml", encoding="UTF-8", xml_declaration=True)
        # OpenCV: the centre of the first pixel is (0, 0).
        matrix = [fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0]
        yaml = f"%YAML:1.0\n---\nimage_width: {w}\nimage_height: {h}\n"
        for key, rows, values in (("camera_matrix", 3, matrix),
                                  ("distortion_coefficients", 1, ordered)):  # fmt: skip
            yaml += f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {len(values) // rows}\n"
            yaml += f"   dt: d\n   data: [ {', '.join(map(repr, values))} ]\n"
        (path / f"{fitted.name}.yaml").write_text(yaml, encoding="utf-8")
    (path / "cameras.txt").write_text("\n".join([*colmap, ""]), encoding="utf-8")
    (path / "camera_models.json").write_text(json.dumps(opensfm, indent=4), encoding="utf-8")


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
