"""Cameras by the name of a model and its parameters or from the calibration report of a metric
camera in millimetres, and whether a camera can be one."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.refraction import messages
from unbend.refraction.camera import model_of
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import LARGEST_ANGLE_RAD, OpenCVFisheye
from unbend.units import Array

_Distortion = type[BrownConrady] | type[GeneralFrame] | type[OpenCVFisheye]
_FULL_OPENCV = ("fx", "fy", "cx", "cy", "k1", "k2", "py", "px", "k3", "q1", "q2", "q3")

MODELS: Mapping[str, tuple[_Distortion, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (BrownConrady, ("f", "cx", "cy")),
    "PINHOLE": (BrownConrady, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": (BrownConrady, ("f", "cx", "cy", "k1")),
    "RADIAL": (BrownConrady, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": (BrownConrady, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (GeneralFrame, _FULL_OPENCV),
    "SIMPLE_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy")),
    "FISHEYE": (OpenCVFisheye, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": (OpenCVFisheye, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV_FISHEYE": (OpenCVFisheye, ("fx", "fy", "cx", "cy", *OpenCVFisheye._fields)),
    # Not COLMAP's: what its models lack.
    "BROWN": (BrownConrady, ("fx", "fy", "cx", "cy", *BrownConrady._fields)),
    "GENERAL_FRAME": (GeneralFrame, ("fx", "fy", "cx", "cy", *GeneralFrame._fields)),
}
"""By name: the distortion, and the names of the parameters in COLMAP's order."""


def camera_of_model(
    model: str, width_px: int, height_px: int, parameters: Sequence[float]
) -> Camera:
    """The camera of a model and its parameters [px and without unit], in COLMAP's pixels.

    Agrees with pycolmap to 1e-9 px over the image, fisheye lenses to 85 degrees off the axis.
    Refuses (PhysicsError CAMERA-MODEL) models that are not in `MODELS` and parameters that do not
    fit.

    >>> camera_of_model("SIMPLE_RADIAL", 4000, 3000, [3200.0, 2000.0, 1500.0, -0.05]).distortion
    BrownConrady(k1=-0.05, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    """
    if model not in MODELS:
        raise messages.camera_model(model=model, models=", ".join(MODELS))
    distortion, names = MODELS[model]
    if len(parameters) != len(names) or not all(map(math.isfinite, parameters)):
        given = ", ".join(f"{value:g}" for value in parameters) or "none"
        raise messages.camera_parameters(
            model=model, count=len(names), names=", ".join(names), given=given
        )
    of = dict(zip(names, map(float, parameters), strict=True))
    fx, fy = of.pop("fx", of.get("f", 0.0)), of.pop("fy", of.pop("f", 0.0))
    cx, cy = of.pop("cx"), of.pop("cy")
    return Camera(width_px, height_px, fx, fy, cx, cy, distortion(**of))


def model_of_camera(camera: Camera) -> tuple[str, list[float]]:
    """The name of a model with all its parameters that is this camera.

    >>> model_of_camera(camera_of_model("SIMPLE_PINHOLE", 40, 30, [32.0, 20.0, 15.0]))
    ('BROWN', [32.0, 32.0, 20.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    """
    # The last of a type is the one that has all parameters.
    name = [name for name, (kind, _) in MODELS.items() if kind is type(camera.distortion)][-1]
    frame = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return name, [float(value) for value in (*frame, *camera.distortion)]


def is_fisheye(camera: Camera) -> bool:
    """Whether the lens is equidistant, and no frame camera's."""
    return isinstance(camera.distortion, OpenCVFisheye)


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Angles [rad] seen across and down through the principal point, but for the distortion.

    >>> camera = Camera(2000, 1000, 1000.0, 1000.0, 1000.0, 500.0)
    >>> np.degrees(field_of_view(camera)).round(2).tolist()
    [90.0, 53.13]
    """
    size = np.array([camera.width_px, camera.height_px])
    centre = np.array([camera.cx_px, camera.cy_px])
    ends = np.array([centre, size - centre]) / [camera.fx_px, camera.fy_px]
    across, down = (ends if is_fisheye(camera) else np.arctan(ends)).sum(axis=0)
    return float(across), float(down)


def refuse_impossible(camera: Camera) -> None:
    """Refuse (PhysicsError) a camera that cannot be one.

    CAMERA-FIELD: a frame camera that sees more than 150 degrees, or a fisheye that sees more than
    360. CAMERA-TURNS: a distortion that turns back inside the image, so that two directions share a
    pixel. Beyond the calibrated radius, and 89.5 degrees off the axis of a fisheye, observations
    have the status outside_camera instead.
    """
    seen = np.degrees(max(field_of_view(camera)))
    if seen > (360.0 if is_fisheye(camera) else 150.0):
        raise messages.camera_field(
            fx_px=camera.fx_px, width_px=camera.width_px, height_px=camera.height_px, seen_deg=seen
        )
    end = min(float(getattr(camera.distortion, "limit", np.inf)), float(np.tan(LARGEST_ANGLE_RAD)))
    theta = np.linspace(0.0, np.arctan(min(end, camera.largest_radius)), 200)[:, None]
    right = (np.array([0, camera.width_px]) - camera.cx_px) / camera.fx_px
    down = (np.array([[0], [camera.height_px]]) - camera.cy_px) / camera.fy_px
    azimuth = np.append(np.linspace(0.0, 2.0 * np.pi, 25), np.arctan2(down, right))
    u, v = np.tan(theta) * np.cos(azimuth), np.tan(theta) * np.sin(azimuth)
    with np.errstate(all="ignore"):
        x, y = camera.project(u, v)
        uu, uv, vv = model_of(type(camera.distortion)).slopes(u, v, camera.distortion)
        folded = np.asarray(uu * vv - uv * uv) <= 0.0
    # Where the distortion turns, and nothing limits it earlier, the circle lies outside the image.
    folded[-1] |= camera.largest_radius < end * (1.0 - 1e-9)
    folded &= (x >= 0.0) & (x <= camera.width_px) & (y >= 0.0) & (y <= camera.height_px)
    if folded.any():
        i, k = np.argwhere(folded)[0]
        off_axis_deg = np.degrees(theta[i, 0])
        raise messages.camera_turns(off_axis_deg=off_axis_deg, x=x[i, k], y=y[i, k])


DIRECTIONS = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "down": (0.0, 1.0), "up": (0.0, -1.0)}
"""In the image, x to the right and y down."""

SENSES = {"distortion": 1.0, "correction": -1.0}
"""What the lens does to ideal coordinates, or what is added to measured ones."""

LARGEST_DISAGREEMENT_MM = 0.002
"""Farther than this the coefficients and the table of one report do not mean the same lens."""

LARGEST_OFFSET = 0.25
"""Part of the format by which no principal point of a metric camera is off its centre."""


@dataclass(frozen=True, eq=False)
class MetricReport:
    """What the calibration report of a metric frame camera states, in millimetres.

    Pairs are (across, down) or (x, y); ``origin_px`` is where millimetres count from, in COLMAP's
    pixels, ``axes`` the directions of x and y, as ``right up``. ``coefficients`` [powers of mm]:
    dr = r (k0 + k1 r^2 + ... k4 r^8), dx = p1 (r^2 + 2 x^2) + 2 p2 x y, dx = b1 x + b2 y;
    ``table`` (n, 2) radius and dr [mm] with its sense. Calibrated to ``radius_mm`` about the PPBS,
    or the end of the table.
    """

    focal_mm: float
    pixel_mm: ArrayLike
    format_mm: ArrayLike
    origin_px: ArrayLike
    axes: str
    ppa_mm: ArrayLike
    ppbs_mm: ArrayLike
    coefficients: Mapping[str, float]
    sense: str = "distortion"
    table: tuple[ArrayLike, str] | None = None
    radius_mm: float = np.inf


def camera_of_report(report: MetricReport, size_px: tuple[int, int]) -> Camera:
    """The camera in pixels: projection from the PPA, distortion about the PPBS.

    Refuses (PhysicsError) pixels that do not fill the format (CAMERA-FORMAT), a principal point far
    from the centre (CAMERA-PRINCIPAL-POINT), a table that contradicts the coefficients, or without
    these a polynomial (CAMERA-REPORT).
    """
    size, pixel, c = np.array(size_px), np.asarray(report.pixel_mm), report.focal_mm
    ppa_mm, table, radius_mm = report.ppa_mm, report.table, report.radius_mm
    part = size * pixel / report.format_mm
    if not (part.min() > 0.95 and part.max() < 1.15):
        raise messages.camera_format(
            width_px=int(size[0]),
            height_px=int(size[1]),
            pixel_x_um=pixel[0] * 1e3,
            pixel_y_um=pixel[1] * 1e3,
            part_of_width=part[0],
            part_of_height=part[1],
        )
    to_image = np.array([DIRECTIONS[axis] for axis in report.axes.split()]).T
    point = np.asarray(report.origin_px) + to_image @ ppa_mm / pixel
    off = np.abs(point / size - 0.5).max()
    if off > LARGEST_OFFSET:
        raise messages.camera_principal_point(percent=100.0 * off)
    sign, given = SENSES[report.sense], report.coefficients.get
    known = np.array([given(f"k{i}", 0.0) for i in range(5)])
    if table is not None:
        r, dr = np.asarray(table[0], np.float64).T
        # To first order a correction is the distortion with the other sign.
        known = _agreed(known, r, dr * SENSES[table[1]] * sign)
        radius_mm = min(radius_mm, r[-1])
    offset = to_image @ np.subtract(ppa_mm, report.ppbs_mm) / c
    px, py = to_image @ (given("p1", 0.0), given("p2", 0.0)) * c
    stretch = [[1.0 + given("b1", 0.0), given("b2", 0.0)], [0.0, 1.0]]
    affine = to_image @ (stretch if sign > 0.0 else np.linalg.inv(stretch)) @ to_image.T
    # Slope of a correction in the corners, and so many steps that it is inverted to 1e-17.
    corner = 0.6 * np.hypot(*size * pixel) * np.linspace(0.0, 1.0, 50)[:, None]
    slope = np.abs((known * np.arange(1, 10, 2) * corner ** np.arange(0, 10, 2)).sum(axis=1)).max()
    slope += 6.0 * (abs(given("p1", 0.0)) + abs(given("p2", 0.0))) * corner[-1, 0]
    steps = np.ceil(np.log(1e-17) / np.log(np.clip(slope, 1e-9, 0.27)))
    numbers = (
        *known * c ** np.arange(0, 10, 2), 0.0, 0.0, 0.0, px, py, *offset,
        affine[0, 1] / affine[0, 0], affine[1, 0] / affine[1, 1], sign,
        min(radius_mm / c - np.hypot(*offset), 1e9), steps,
    )  # fmt: skip
    fx, fy, cx, cy = map(float, (*c / pixel * affine.diagonal(), *point))
    return Camera(*size_px, fx, fy, cx, cy, GeneralFrame(*map(float, numbers)))


def _agreed(known: Array, r: Array, wanted: Array) -> Array:
    """(5,) k0 to k4, fitted where all are zero, once they agree with the table."""
    powers, fitted = r[:, None] ** np.arange(1, 10, 2), not known.any()
    if fitted:
        terms, scale = min(5, max(1, np.count_nonzero(r) - 1)), r[-1] ** np.arange(1, 10, 2)
        known[:terms] = np.linalg.lstsq((powers / scale)[:, :terms], wanted, rcond=None)[0]
        known = known / scale
    apart = np.abs(powers @ known - wanted)
    if not apart.max() <= LARGEST_DISAGREEMENT_MM:
        raise messages.camera_report(
            fit="a polynomial" if fitted else "the coefficients",
            apart_um=apart.max() * 1000.0,
            radius_mm=r[apart.argmax()],
        )
    return known
