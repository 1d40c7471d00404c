"""Whether the numbers of a camera can be those of a camera."""

from __future__ import annotations

import numpy as np

from pipeline.errors import PhysicsError
from pipeline.refraction.camera import model_of
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.camera.opencv_fisheye import LARGEST_ANGLE_RAD, OpenCVFisheye


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Angles [rad] seen across and down through the principal point, but for the distortion.

    >>> camera = Camera(2000, 1000, 1000.0, 1000.0, 1000.0, 500.0)
    >>> np.degrees(field_of_view(camera)).round(2).tolist()
    [90.0, 53.13]
    """
    size = np.array([camera.width_px, camera.height_px])
    centre = np.array([camera.cx_px, camera.cy_px])
    ends = np.array([centre, size - centre]) / [camera.fx_px, camera.fy_px]
    fisheye = isinstance(camera.distortion, OpenCVFisheye)
    across, down = (ends if fisheye else np.arctan(ends)).sum(axis=0)
    return float(across), float(down)


def refuse_impossible(camera: Camera) -> None:
    """Refuse (PhysicsError) a camera that cannot be one.

    CAMERA-FIELD: a frame camera that sees more than 150 degrees, or a fisheye that sees more than
    360. CAMERA-TURNS: a distortion that turns back inside the image, so that two directions share a
    pixel. Beyond the calibrated radius, and 89.5 degrees off the axis of a fisheye, observations
    have the status outside_camera instead.
    """
    fisheye = isinstance(camera.distortion, OpenCVFisheye)
    seen = np.degrees(max(field_of_view(camera)))
    if seen > (360.0 if fisheye else 150.0):
        raise PhysicsError(
            "CAMERA-FIELD",
            f"with a principal distance of {camera.fx_px:g} px an image of {camera.width_px} x "
            f"{camera.height_px} px sees {seen:.0f} degrees",
            remedy="give the principal distance in pixels (millimetres divided by the size of a "
            "pixel in millimetres), or the model of a fisheye",
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
        raise PhysicsError(
            "CAMERA-TURNS",
            "the distortion turns back inside the image (or is a correction of more than 30 %), "
            f"{np.degrees(theta[i, 0]):.1f} degrees off the axis at ({x[i, k]:.0f}, {y[i, k]:.0f}) "
            "px",
            remedy="check signs, order and units of the coefficients",
        )
