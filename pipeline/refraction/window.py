"""The window of a pressurised compartment: Snell's law at a plane, in vectors.

Plane-parallel glass displaces a ray and does not bend it, so only the air on either side counts
(Gyer 1996, Eq. 36-39 with the sign of Eq. 39; Saastamoinen 1974, Eq. 9). Dense cabin air has
pulled the image point inward; the correction moves it outward.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import PhysicsError
from pipeline.units import HECTOPASCAL

Array = NDArray[np.float64]

OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])

SCHEDULE_TEMPERATURE_K = 294.26  # 70 F
SCHEDULE_PRESSURE_PA = 701.2 * HECTOPASCAL  # of 3 km pressure altitude
SCHEDULE_CEILING_M = 10_000.0  # Table 7 ends here


@dataclass(frozen=True)
class Cabin:
    """Air in the compartment: logged with each exposure, constant, or Gyer's schedule.

    Pressure [Pa], temperature [K] and relative humidity 0 to 1 belong to ``constant``.
    """

    source: Literal["log", "constant", "standard_schedule"]
    pressure_pa: float = float("nan")
    temperature_k: float = float("nan")
    relative_humidity: float = 0.0


@dataclass(frozen=True)
class Window:
    """What a camera looks through.

    Parameters
    ----------
    cabin : the air behind it; None where nobody knows, which only a spherical window allows.
    normal : unit vector out of the compartment.
    frame : of ``normal``: the camera (x right, y down, z forward) or the body of the aircraft
        (x forward, y right, z down), which a stabilised camera moves in.
    shape : plane, or a sphere about the projection centre, which every ray meets at right angles
        and which therefore bends nothing.
    in_calibration : whether the camera was calibrated with the glass in front of it. It changes
        no number here.

    Raises PhysicsError (WINDOW-NORMAL, WINDOW-AIR).

    >>> Window(Cabin("log"), normal=(0.0, 0.0, 1.0), frame="body").shape
    'plane'
    """

    cabin: Cabin | None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    frame: Literal["camera", "body"] = "camera"
    shape: Literal["plane", "spherical"] = "plane"
    in_calibration: Literal["none", "glass"] = "none"

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not abs(length - 1.0) < 1e-9:
            raise PhysicsError(
                "WINDOW-NORMAL",
                f"the normal of a window has the length {length:.9g}",
                remedy="give a unit vector that points out of the compartment",
            )
        if self.cabin is None and self.shape == "plane":
            raise PhysicsError(
                "WINDOW-AIR",
                "a plane window bends by the air behind it, which is not given",
                remedy="give the cabin's air",
            )


def scheduled_pressure(ambient_pa: ArrayLike) -> Array:
    """Pressure in a compartment under the usual pressurisation [Pa].

    ``ambient_pa`` outside, any shape [Pa]. The compartment is as thin as the air outside up to 3 km
    pressure altitude (701.2 hPa) and stays at that above; its temperature is
    ``SCHEDULE_TEMPERATURE_K``. Valid to 10 km. Source: Gyer 1996, Table 7, after Ebeling 1968.

    >>> scheduled_pressure([89876.0, 26500.0]).round(1).tolist()
    [89876.0, 70120.0]
    """
    return np.maximum(np.asarray(ambient_pa, dtype=np.float64), SCHEDULE_PRESSURE_PA)


def leave_compartment(
    direction: Array,
    refractivity_cabin: ArrayLike,
    refractivity_outside: ArrayLike,
    normal: Array = OPTICAL_AXIS,
) -> tuple[Array, Array]:
    """Change of direction of rays traced from the camera out through a plane window.

    Parameters
    ----------
    direction : (n, 3) unit vectors inside, in the frame of ``normal``.
    refractivity_cabin, refractivity_outside : n - 1 of the air on either side, () or (n,).
    normal : (3,) or (n, 3) unit vectors of the window, pointing outside.

    Returns
    -------
    change : (n, 3), to be added to ``direction``; NaN for a ray that the window reflects wholly,
        and for one along the window or from outside it (normal . direction <= 0).
    r_cc : (n,) angle between the two [rad], positive when the cabin moved the image inward; NaN
        with ``change``.

    Exact, without differencing. Source: Gyer 1996, Eq. 36 in vector form.

    >>> ray = np.array([[0.70710678118654752, 0.0, 0.70710678118654752]])
    >>> _, r_cc = leave_compartment(ray, 187.84e-6, 93.57e-6)
    >>> (r_cc * 180 * 3600 / np.pi).round(2).tolist()  # Gyer's Table 7, 10 km: 19.44
    [19.44]
    """
    n_out = np.asarray(refractivity_outside, dtype=np.float64)
    excess = (np.asarray(refractivity_cabin, np.float64) - n_out) / (1.0 + n_out)
    cos_inside = np.einsum("ij,ij->i", direction, np.broadcast_to(normal, direction.shape))
    cos_inside = np.where(cos_inside > 0.0, cos_inside, np.nan)
    tangent = direction - cos_inside[:, None] * normal
    sin2_inside = np.einsum("ij,ij->i", tangent, tangent)
    ratio = 1.0 + excess
    with np.errstate(invalid="ignore"):
        cos_outside = np.sqrt(1.0 - ratio * ratio * sin2_inside)
        along = -excess * (2.0 + excess) * sin2_inside / (cos_outside + cos_inside)
    change = np.broadcast_to(excess, sin2_inside.shape)[:, None] * tangent
    change = change + along[:, None] * normal
    length = np.sqrt(np.einsum("ij,ij->i", change, change))
    return change, np.asarray(np.copysign(2.0 * np.arcsin(0.5 * length), excess))
