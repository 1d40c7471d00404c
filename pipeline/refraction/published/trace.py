"""A published method as the correction of images asks for it: with a status for every ray."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.atmosphere.profile import Profile
from pipeline.refraction.published.column import Array, rays
from pipeline.refraction.status import BAD_MEASUREMENT, MISSES_GROUND, OK, OUTSIDE_PROFILE

Method = Callable[[Profile, ArrayLike, ArrayLike, ArrayLike, ArrayLike], Array]


def trace(
    method: Method,
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    sin_zeta_c: ArrayLike,
    cos_zeta_c: ArrayLike,
    radius: ArrayLike,
) -> tuple[Array, NDArray[np.uint8]]:
    """Refraction angles by a published method, each with a status, as `pipeline.refraction.bend`.

    ``method`` is one of `pipeline.refraction.published.PUBLISHED`; the others are as for `bend`.
    The status is ``bad_measurement`` where a height, the angle or the radius is none, whether the
    method looks at it or not; ``outside_profile`` where the method does not cover the heights (a
    ground above the camera among them), ``misses_ground`` where it has no ray in that direction.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.refraction.published import plane
    >>> air = standard_atmosphere("us1976")
    >>> r_c, status = trace(plane, air, 6000.0, [0.0, 0.0, 7000.0], [0.6, 1.0, 0.6], 0.8, 6.4e6)
    >>> np.isnan(r_c).tolist(), status.tolist()
    ([False, False, True], [0, 0, 7])
    """
    h_c, h_g, sin_z, cos_z, radius = rays(h_c, h_g, sin_zeta_c, cos_zeta_c, radius)
    zeta_c = np.arctan2(sin_z, cos_z)
    good = np.isfinite(h_c) & np.isfinite(h_g) & (radius > 0.0)
    good &= (zeta_c >= 0.0) & (zeta_c <= math.pi)
    r_c = np.full(good.shape, np.nan)
    r_c[good] = method(profile, h_c[good], h_g[good], zeta_c[good], radius[good])
    status = np.where(good, OK, BAD_MEASUREMENT).astype(np.uint8)
    lost = np.isnan(r_c) & good
    # Straight down every ray reaches the ground: what is missing there is missing for the heights.
    at_nadir = np.asarray(method(profile, h_c[lost], h_g[lost], 0.0, radius[lost]))
    status[lost] = np.where(np.isnan(at_nadir), OUTSIDE_PROFILE, MISSES_GROUND)
    return r_c, status
