"""The window of a pressurised compartment: Snell's law at a plane, in vectors.

Plane-parallel glass displaces a ray and does not bend it, so only the air on either side counts
(Gyer 1996, Eq. 36-39 with the sign of Eq. 39; Saastamoinen 1974, Eq. 9). Dense cabin air has
pulled the image point inward; the correction moves it outward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cabin:
    """Air behind a window: logged with each exposure, constant, or the same as outside.

    Pressure [Pa], temperature [K], relative humidity 0 to 1; None and not ``logged`` means that
    there is no window.
    """

    logged: bool = False
    pressure_pa: float | None = None
    temperature_k: float | None = None
    relative_humidity: float = 0.0


NO_WINDOW = Cabin()

OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])


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
    normal : (3,) unit vector of the window, pointing outside.

    Returns
    -------
    change : (n, 3), to be added to ``direction``; NaN for a ray that the window reflects wholly.
    r_cc : (n,) angle between the two [rad], positive when the cabin moved the image inward.

    Exact, without differencing. Source: Gyer 1996, Eq. 36 in vector form.

    >>> ray = np.array([[0.70710678118654752, 0.0, 0.70710678118654752]])
    >>> _, r_cc = leave_compartment(ray, 187.84e-6, 93.57e-6)
    >>> (r_cc * 180 * 3600 / np.pi).round(2).tolist()  # Gyer's Table 7, 10 km: 19.44
    [19.44]
    """
    n_out = np.asarray(refractivity_outside, dtype=np.float64)
    excess = (np.asarray(refractivity_cabin, np.float64) - n_out) / (1.0 + n_out)
    cos_inside = direction @ normal
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
