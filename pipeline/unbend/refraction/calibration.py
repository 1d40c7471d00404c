"""Cameras from the parameters of a camera model or from a calibration report, and their checks.

A model has parameters in pixels; the report of a metric camera is in millimetres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unbend.refraction import messages
from unbend.refraction.camera import DISTORTION_MODELS, model_of
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import LARGEST_ANGLE_RAD, OpenCVFisheye
from unbend.units import Array, Mask


def _camera_models() -> dict[str, tuple[Any, tuple[str, ...]]]:
    """By the name of a camera model: the type of its distortion, and its parameters."""
    models = {}
    for module in DISTORTION_MODELS.values():
        for name, parameters in module.MODELS.items():
            models[name] = (module.Parameters, parameters)
    return models


MODELS = _camera_models()
"""By name: the type of the distortion, and the names of the parameters in COLMAP's order."""


SHORTEST_DISTANCE_PX = 10.0  # a focal length in millimetres is shorter than its image has pixels
LONGEST_DISTANCE_PX = 1e6
LARGEST_PARAMETER = 1e15
"""Of a camera model, as an absolute value. The largest possible one is the coefficient of r^6 of a
lens with a field of view of 0.1 degree; `refuse_impossible` checks the effect of coefficients.
"""
LARGEST_SIDE_PX = 1_000_000  # of an image, and the farthest that a principal point lies from it


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
    if len(parameters) != len(names):
        raise messages.camera_parameters(model=model, names=names, given=parameters)
    value_of = dict(zip(names, map(float, parameters), strict=True))
    if "f" in value_of:
        fx = value_of.pop("f")
        fy = fx
    else:
        fx = value_of.pop("fx")
        fy = value_of.pop("fy")
    cx = value_of.pop("cx")
    cy = value_of.pop("cy")
    _refuse_impossible_numbers(model, (width_px, height_px), (fx, fy), (cx, cy))
    if not all(abs(value) <= LARGEST_PARAMETER for value in parameters):
        raise messages.camera_parameters(model=model, names=names, given=parameters)
    return Camera(
        width_px=width_px,
        height_px=height_px,
        fx_px=fx,
        fy_px=fy,
        cx_px=cx,
        cy_px=cy,
        distortion=distortion(**value_of),
    )


def _refuse_impossible_numbers(
    model: str,
    size: tuple[int, int],
    distances: tuple[float, float],
    point: tuple[float, float],
) -> None:
    """Refuse a size, principal distances or a principal point [px] that no camera has."""
    has_size = all(1 <= side <= LARGEST_SIDE_PX for side in size)
    has_distances = all(
        SHORTEST_DISTANCE_PX <= distance <= LONGEST_DISTANCE_PX for distance in distances
    )
    has_point = all(abs(coordinate) <= LARGEST_SIDE_PX for coordinate in point)
    if not (has_size and has_distances and has_point):
        raise messages.camera_numbers(
            model=model,
            size=f"{size[0]:.6g} x {size[1]:.6g}",
            distances=f"{distances[0]:.6g} and {distances[1]:.6g}",
            point=f"{point[0]:.6g}, {point[1]:.6g}",
        )


def model_of_camera(camera: Camera) -> tuple[str, list[float]]:
    """The name and all parameters of the model in `MODELS` that has every coefficient of a camera.

    >>> model_of_camera(camera_of_model("SIMPLE_PINHOLE", 40, 30, [32.0, 20.0, 15.0]))
    ('BROWN', [32.0, 32.0, 20.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    """
    name = ""
    for model, (distortion, _) in MODELS.items():
        if distortion is type(camera.distortion):
            name = model  # the last of a type has all parameters
    parameters = [
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        *camera.distortion,
    ]
    return name, [float(value) for value in parameters]


LARGEST_FRAME_FIELD_DEG = 150.0
LARGEST_FISHEYE_FIELD_DEG = 360.0

LARGEST_STRETCH = 2.0
"""Largest factor by which a distortion may increase a distance from the principal point.

Pincushion distortions of real lenses are below 1.3; barrel distortions shorten distances.
"""

_BORDER_POINTS = 9  # on each border of the image, both corners counted
_SLACK_PX = 1.0  # added to the limit: a principal point on the border has the distance 0

# Points at which a distortion is checked: circles about the principal point, and directions.
_CIRCLES = 200
_AZIMUTHS = 25  # evenly spaced, both ends counted; those of the corners are added
_ROUNDING = 1e-9  # of a radius, as a share


def is_fisheye(camera: Camera) -> bool:
    """Whether the lens is an equidistant fisheye; False for all frame cameras."""
    return isinstance(camera.distortion, OpenCVFisheye)


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Angles of view [rad] across and down, through the principal point and without distortion.

    >>> camera = Camera(2000, 1000, 1000.0, 1000.0, 1000.0, 500.0)
    >>> np.degrees(field_of_view(camera)).round(2).tolist()
    [90.0, 53.13]
    """
    size = np.array([camera.width_px, camera.height_px])
    centre = np.array([camera.cx_px, camera.cy_px])
    distances = [camera.fx_px, camera.fy_px]
    to_borders = np.array([centre, size - centre]) / distances
    angles = to_borders if is_fisheye(camera) else np.arctan(to_borders)
    across, down = angles.sum(axis=0)
    return float(across), float(down)


def refuse_impossible(camera: Camera) -> None:
    """Refuse (PhysicsError) a camera with a field of view or a distortion that no camera has.

    CAMERA-FIELD: a frame camera that sees more than 150 degrees, or a fisheye that sees more than
    360. CAMERA-DISTORTION: a distortion that more than doubles a distance from the principal point.
    CAMERA-TURNS: a distortion that turns back inside the image, so that two directions share a
    pixel. Beyond the calibrated radius, and 89.5 degrees off the axis of a fisheye, observations
    have the status outside_camera instead.
    """
    seen_deg = np.degrees(max(field_of_view(camera)))
    largest_deg = LARGEST_FRAME_FIELD_DEG
    if is_fisheye(camera):
        largest_deg = LARGEST_FISHEYE_FIELD_DEG
    if seen_deg > largest_deg:
        raise messages.camera_field(
            fx_px=camera.fx_px,
            width_px=camera.width_px,
            height_px=camera.height_px,
            seen_deg=seen_deg,
        )
    _refuse_large_distortion(camera)
    _refuse_turning_distortion(camera)


def _refuse_large_distortion(camera: Camera) -> None:
    """Refuse (PhysicsError CAMERA-DISTORTION) a distortion that moves points too far outwards.

    Points on the borders of the image are taken as undistorted and are distorted. Their distance
    from the principal point may become `LARGEST_STRETCH` times as long, and must not become NaN.
    """
    without_distortion = replace(camera, distortion=type(camera.distortion)())
    x, y = _border(camera)
    u, v, covered = without_distortion.rays(x, y)
    covered &= np.hypot(u, v) <= camera.largest_radius
    with np.errstate(all="ignore"):
        distorted_x, distorted_y = camera.project(u, v)
        distance_px = np.hypot(x - camera.cx_px, y - camera.cy_px)
        distorted_px = np.hypot(distorted_x - camera.cx_px, distorted_y - camera.cy_px)
        largest_px = LARGEST_STRETCH * distance_px + _SLACK_PX
        is_large = ~(distorted_px <= largest_px) & covered  # NaN is large too
    if is_large.any():
        first = is_large.argmax()
        raise messages.camera_distortion(
            x=x[first],
            y=y[first],
            distance_px=distance_px[first],
            distorted_px=distorted_px[first],
        )


def _border(camera: Camera) -> tuple[Array, Array]:
    """x and y (n,) [px] of points on the four borders of an image, its corners included."""
    across = np.linspace(0.0, camera.width_px, _BORDER_POINTS)
    down = np.linspace(0.0, camera.height_px, _BORDER_POINTS)
    zeros = np.zeros(_BORDER_POINTS)
    x = np.concatenate([across, across, zeros, zeros + camera.width_px])
    y = np.concatenate([zeros, zeros + camera.height_px, down, down])
    return x, y


def _refuse_turning_distortion(camera: Camera) -> None:
    """Refuse (PhysicsError CAMERA-TURNS) a distortion that turns back inside the image.

    Circles about the principal point are checked, to where observations are outside_camera.
    """
    calibrated = float(getattr(camera.distortion, "limit", np.inf))
    stated_end = min(calibrated, float(np.tan(LARGEST_ANGLE_RAD)))
    largest_theta = np.arctan(min(stated_end, camera.largest_radius))
    theta = np.linspace(0.0, largest_theta, _CIRCLES)[:, None]
    evenly = np.linspace(0.0, 2.0 * np.pi, _AZIMUTHS)
    azimuth = np.append(evenly, _azimuths_of_corners(camera))
    radius = np.tan(theta)
    u = radius * np.cos(azimuth)
    v = radius * np.sin(azimuth)
    with np.errstate(all="ignore"):
        x, y = camera.project(u, v)
        folded = _is_folded(camera, u, v)
    # If the last circle is not a stated end, the distortion turns back there.
    folded[-1] |= camera.largest_radius < stated_end * (1.0 - _ROUNDING)
    folded &= _is_in_image(camera, x, y)
    if folded.any():
        circle, ray = np.argwhere(folded)[0]
        raise messages.camera_turns(
            off_axis_deg=np.degrees(theta[circle, 0]),
            x=x[circle, ray],
            y=y[circle, ray],
        )


def _is_folded(camera: Camera, u: Array, v: Array) -> Mask:
    """Whether the distortion turns back at (u, v): the determinant of its derivatives is <= 0."""
    model = model_of(type(camera.distortion))
    uu, uv, vv = model.slopes(u, v, camera.distortion)
    return np.asarray(uu * vv - uv * uv) <= 0.0


def _is_in_image(camera: Camera, x: Array, y: Array) -> Mask:
    """Whether pixels are inside the format of the camera."""
    is_in_width = (x >= 0.0) & (x <= camera.width_px)
    is_in_height = (y >= 0.0) & (y <= camera.height_px)
    return np.asarray(is_in_width & is_in_height)


def _azimuths_of_corners(camera: Camera) -> Array:
    """(2, 2) azimuths [rad] of the corners of the image about the principal point, from x to y."""
    x = np.array([0, camera.width_px])
    y = np.array([0, camera.height_px])
    right = (x - camera.cx_px) / camera.fx_px
    down = (y - camera.cy_px) / camera.fy_px
    return np.asarray(np.arctan2(down[:, None], right))


DIRECTIONS = {
    "right": (1.0, 0.0),
    "left": (-1.0, 0.0),
    "down": (0.0, 1.0),
    "up": (0.0, -1.0),
}
"""Unit vectors of the directions in the image, x to the right and y down."""

SENSES = {"distortion": 1.0, "correction": -1.0}
"""Sense of coefficients, and its sign in `GeneralFrame`. A distortion is added to ideal coordinates
(by the lens), a correction to measured ones (to get ideal ones)."""

LARGEST_DISAGREEMENT_MM = 0.002
"""With a larger difference the coefficients and the table of a report are not for the same lens."""

LARGEST_OFFSET = 0.25
"""Largest offset of a metric camera's principal point from the centre, as a share of the format."""

SMALLEST_PART = 0.95
LARGEST_PART = 1.15
"""Share of the format that the pixels fill: scans have a border; others are of another format."""

_RADIAL_POWERS = np.arange(1, 10, 2)  # of r in dr
_SLOPE_POWERS = np.arange(0, 10, 2)  # of r in d(dr)/dr, and of the focal length in k0 to k4
_COEFFICIENTS = ("k0", "k1", "k2", "k3", "k4")  # of these powers
_TO_CORNER = 0.6  # of the format's diagonal: to a corner, with an offset of the principal point
_INVERSION_ERROR = 1e-17  # of a correction, to which its inversion is iterated
_SMALLEST_SLOPE = 1e-9  # takes 2 steps
_LARGEST_SLOPE = 0.27  # takes 30 steps
_UNLIMITED = 1e9  # radius in units of the principal distance


@dataclass(frozen=True, eq=False)
class MetricReport:
    """The calibration report of a metric frame camera, in millimetres.

    Pairs are (across, down) or (x, y) along ``axes``. With (x, y) from the PPBS, r its length [mm],

        dr = r (k0 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8),
        dx = p1 (r^2 + 2 x^2) + 2 p2 x y,   dx = b1 x + b2 y.
    """

    focal_mm: float
    pixel_mm: ArrayLike
    format_mm: ArrayLike
    origin_px: ArrayLike  # where millimetres count from, in COLMAP's pixels
    axes: str  # directions of x and y in the image, as ``right up``
    ppa_mm: ArrayLike  # principal point of autocollimation
    ppbs_mm: ArrayLike  # principal point of best symmetry
    coefficients: Mapping[str, float]  # k0 to k4, p1, p2, b1, b2 [powers of mm]; 0 by default
    sense: str = "distortion"  # of the coefficients, one of `SENSES`
    table: tuple[ArrayLike, str] | None = None  # (n, 2) r and dr [mm], and the sense of dr
    radius_mm: float = np.inf  # calibrated, about the PPBS; the table's end limits it too

    def coefficient(self, name: str) -> float:
        """A coefficient, 0 where the report has none."""
        return self.coefficients.get(name, 0.0)


def camera_of_report(report: MetricReport, size_px: tuple[int, int]) -> Camera:
    """The camera in pixels: projection from the PPA, distortion about the PPBS.

    Refuses (PhysicsError) pixels that do not fill the format (CAMERA-FORMAT), a principal point far
    from the centre (CAMERA-PRINCIPAL-POINT), a table that contradicts the coefficients, or without
    these a polynomial (CAMERA-REPORT).
    """
    size = np.array(size_px)
    pixel_mm = np.asarray(report.pixel_mm)
    _refuse_other_format(report, size)
    axes = [DIRECTIONS[axis] for axis in report.axes.split()]
    to_image = np.array(axes).T
    point = np.asarray(report.origin_px) + to_image @ report.ppa_mm / pixel_mm
    off_centre = np.abs(point / size - 0.5).max()
    if off_centre > LARGEST_OFFSET:
        raise messages.camera_principal_point(percent=100.0 * off_centre)
    affine = _affinity(report, to_image)
    principal_px = report.focal_mm / pixel_mm * affine.diagonal()
    diagonal_mm = np.hypot(*size * pixel_mm)
    return Camera(
        width_px=size_px[0],
        height_px=size_px[1],
        fx_px=float(principal_px[0]),
        fy_px=float(principal_px[1]),
        cx_px=float(point[0]),
        cy_px=float(point[1]),
        distortion=_distortion_of_report(report, to_image, affine, diagonal_mm),
    )


def _refuse_other_format(report: MetricReport, size: Array) -> None:
    """Refuse an image of ``size`` (2,) [px] that does not fill the format of a report."""
    pixel_mm = np.asarray(report.pixel_mm)
    part = size * pixel_mm / report.format_mm
    fills_format = part.min() > SMALLEST_PART and part.max() < LARGEST_PART
    if not fills_format:
        raise messages.camera_format(
            width_px=int(size[0]),
            height_px=int(size[1]),
            pixel_x_um=pixel_mm[0] * 1e3,
            pixel_y_um=pixel_mm[1] * 1e3,
            part_of_width=part[0],
            part_of_height=part[1],
        )


def _affinity(report: MetricReport, to_image: Array) -> Array:
    """(2, 2) matrix of the distortion by b1 and b2 of a report, in the axes of the image.

    ``to_image`` (2, 2) takes the axes of the report to those of the image.
    """
    stretch: Array = np.eye(2)
    stretch[0, 0] += report.coefficient("b1")
    stretch[0, 1] = report.coefficient("b2")
    if SENSES[report.sense] < 0.0:
        stretch = np.asarray(np.linalg.inv(stretch), np.float64)
    return np.asarray(to_image @ stretch @ to_image.T)


def _distortion_of_report(
    report: MetricReport, to_image: Array, affine: Array, diagonal_mm: float
) -> GeneralFrame:
    """The distortion of a report in units of the principal distance.

    ``to_image`` (2, 2) takes the report's axes to those of the image, ``affine`` (2, 2) is that of
    `_affinity`, ``diagonal_mm`` that of the format.
    """
    sign = SENSES[report.sense]
    focal_mm = report.focal_mm
    radial, radius_mm = _radial_of_report(report)
    tangential = (report.coefficient("p1"), report.coefficient("p2"))
    ppa_from_ppbs = np.subtract(report.ppa_mm, report.ppbs_mm)
    offset = to_image @ ppa_from_ppbs / focal_mm
    limit = radius_mm / focal_mm - np.hypot(*offset)
    px, py = to_image @ tangential * focal_mm
    steps = _inversion_steps(radial, tangential, _TO_CORNER * diagonal_mm)
    k = (radial * focal_mm**_SLOPE_POWERS).tolist()
    return GeneralFrame(
        k0=k[0],
        k1=k[1],
        k2=k[2],
        k3=k[3],
        k4=k[4],
        px=float(px),
        py=float(py),
        offset_u=float(offset[0]),
        offset_v=float(offset[1]),
        skew_x=float(affine[0, 1] / affine[0, 0]),
        skew_y=float(affine[1, 0] / affine[1, 1]),
        sense=sign,
        limit=float(min(limit, _UNLIMITED)),
        steps=steps,
    )


def _radial_of_report(report: MetricReport) -> tuple[Array, float]:
    """(5,) k0 to k4 of a report, and the radius [mm] up to which they are valid.

    A table, by rising r, must agree with the coefficients; without any they are fitted to it.
    """
    radial = np.array([report.coefficient(name) for name in _COEFFICIENTS])
    if report.table is None:
        return radial, report.radius_mm
    columns, sense = report.table
    r, dr = np.asarray(columns, np.float64).T
    # To first order a correction is the distortion with the other sign.
    dr_of_report = dr * SENSES[sense] * SENSES[report.sense]
    agreed = _fitted_or_checked(radial, r, dr_of_report)
    return agreed, min(report.radius_mm, r[-1])


def _inversion_steps(radial: Array, tangential: tuple[float, float], corner_mm: float) -> float:
    """Number of iterations that invert a correction to 1e-17.

    Each multiplies the error by the slope of the correction; the largest one out to ``corner_mm``
    is taken. ``radial`` (5,) are k0 to k4, ``tangential`` p1 and p2.
    """
    shares = np.linspace(0.0, 1.0, 50)
    radius = corner_mm * shares[:, None]
    terms = radial * _RADIAL_POWERS * radius**_SLOPE_POWERS
    slope = np.abs(terms.sum(axis=1)).max()
    p1, p2 = tangential
    slope += 6.0 * (abs(p1) + abs(p2)) * radius[-1, 0]  # dx and dy of p1, p2 change by 6 p r
    error_factor = np.clip(slope, _SMALLEST_SLOPE, _LARGEST_SLOPE)
    steps = np.log(_INVERSION_ERROR) / np.log(error_factor)
    return float(np.ceil(steps))


def _fitted_or_checked(radial: Array, r: Array, dr: Array) -> Array:
    """(5,) k0 to k4: ``radial`` itself, or if all are zero those fitted to the table of a report.

    ``r`` and ``dr`` (n,) [mm] are those of the table. Refuses (PhysicsError CAMERA-REPORT) a table
    that differs by more than `LARGEST_DISAGREEMENT_MM`.
    """
    fit = "the coefficients"
    if not radial.any():
        fit = "a polynomial"
        radial = _fitted_to_table(r, dr)
    powers = r[:, None] ** _RADIAL_POWERS
    apart_mm = np.abs(powers @ radial - dr)
    if not apart_mm.max() <= LARGEST_DISAGREEMENT_MM:
        raise messages.camera_report(
            fit=fit,
            apart_um=apart_mm.max() * 1000.0,
            radius_mm=r[apart_mm.argmax()],
        )
    return radial


def _fitted_to_table(r: Array, dr: Array) -> Array:
    """(5,) k0 to k4 of the polynomial dr(r) fitted to a table (n,) [mm] by least squares.

    It has one term less than the table has radii above 0, but 1 to 5; further terms are 0.
    """
    powers = r[:, None] ** _RADIAL_POWERS
    largest = r[-1] ** _RADIAL_POWERS
    radii = int(np.count_nonzero(r))
    terms = min(_RADIAL_POWERS.size, max(1, radii - 1))
    scaled_powers = (powers / largest)[:, :terms]
    scaled = np.zeros(_RADIAL_POWERS.size)
    scaled[:terms] = np.linalg.lstsq(scaled_powers, dr, rcond=None)[0]
    return np.asarray(scaled / largest)
