"""The window of a pressurised compartment: Snell's law at a plane, in vectors.

Plane-parallel glass displaces a ray and does not bend it, so only the air on either side counts
(Gyer 1996, Eq. 36-39 with the sign of Eq. 39; Saastamoinen 1974, Eq. 9). Dense cabin air has
pulled the image point inward; the correction moves it outward.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from unbend.refraction import messages
from unbend.units import HECTOPASCAL, Array

OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])

SCHEDULE_TEMPERATURE_K = 294.26  # 70 F
SCHEDULE_PRESSURE_PA = 701.2 * HECTOPASCAL  # of 3 km pressure altitude
SCHEDULE_CEILING_M = 10_000.0  # Table 7 ends here

SIGMA_BAROMETER_PA = 3.0 * HECTOPASCAL
"""Of a barometer that nobody calibrated; and of a vented cabin against the air outside, which the
alternate static sources of light aircraft show (some 25 m of height)."""

SIGMA_THERMOMETER_K = 1.0
"""Of a thermometer in the cabin that nobody calibrated, against the air before the window."""

UNKNOWN = float("nan")


@dataclass(frozen=True)
class Cabin:
    """What is stated about the air in the compartment; NaN where nothing is.

    ``source`` of the pressure: logged with each exposure, constant (``pressure_pa``), ambient (as
    outside), or Gyer's schedule. ``temperature_k`` and ``relative_humidity`` (0 to 1) may be logged
    or have to be assumed where they are not stated; ``temperature_logged`` says that the log is
    stated to have the former. The sigmas are standard deviations [Pa, K].

    An ``opening`` is no cabin: its air is that outside, ``warmer_k`` warmer and with ``excess_pa``
    more pressure.
    """

    source: Literal["log", "constant", "ambient", "standard_schedule", "opening"]
    pressure_pa: float = UNKNOWN
    temperature_k: float = UNKNOWN
    relative_humidity: float = UNKNOWN
    sigma_pressure_pa: float = UNKNOWN
    sigma_temperature_k: float = UNKNOWN
    temperature_logged: bool = False
    warmer_k: float = UNKNOWN
    excess_pa: float = UNKNOWN


@dataclass(frozen=True)
class Window:
    """The window in front of a camera.

    ``cabin`` is the air behind it, None where it is unknown, which only a spherical window allows;
    ``normal`` a unit vector out of the compartment in the ``frame`` of the camera (x right, y down,
    z forward) or of the aircraft's body (x forward, y right, z down), in which a stabilised camera
    moves. A spherical ``shape``, about the projection centre, bends nothing: every ray meets it at
    right angles. ``in_calibration``: whether the camera was calibrated with the glass in front of
    it; it changes no number here.

    Raises PhysicsError (WINDOW-NORMAL, WINDOW-AIR).

    >>> Window(Cabin("log"), normal=(0.0, 0.0, 1.0), frame="body").shape
    'plane'
    """

    cabin: Cabin | None
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    frame: Literal["camera", "body"] = "camera"
    shape: Literal["plane", "spherical"] = "plane"
    in_calibration: Literal["none", "glass"] = "none"

    @property
    def is_opening(self) -> bool:
        """Whether there is no glass, and air outside that differs little."""
        return self.cabin is not None and self.cabin.source == "opening"

    @property
    def section(self) -> str:
        """The section of a camera in the mission file that describes it."""
        return "opening" if self.is_opening else "window"

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not abs(length - 1.0) < 1e-9:
            raise messages.window_normal(length=length)
        if self.frame == "camera" and not self.normal[2] > 0.0:
            raise messages.window_normal_inwards()
        if self.cabin is None and self.shape == "plane":
            raise messages.window_without_air()


def scheduled_pressure(ambient_pa: ArrayLike) -> Array:
    """Pressure in a compartment under the usual pressurisation [Pa].

    ``ambient_pa`` outside, any shape [Pa]. The compartment is as thin as the air outside up to 3 km
    pressure altitude (701.2 hPa) and stays at that above; its temperature is
    ``SCHEDULE_TEMPERATURE_K``. Valid to 10 km. Source: Gyer 1996, Table 7, after Ebeling 1968.

    >>> scheduled_pressure([89876.0, 26500.0]).round(1).tolist()
    [89876.0, 70120.0]
    """
    return np.maximum(np.asarray(ambient_pa, dtype=np.float64), SCHEDULE_PRESSURE_PA)


def refract_at_window(
    direction: Array,
    refractivity_before: ArrayLike,
    refractivity_after: ArrayLike,
    normal: Array = OPTICAL_AXIS,
) -> tuple[Array, Array]:
    """Change of direction of rays that cross a plane window, by Snell's law.

    Rays traced from the camera go out from the cabin's air (before) into that outside (after), or
    back in from outside; either way the normal points to where they go.

    direction : (n, 3) unit vectors before the window, in the frame of ``normal``.
    refractivity_before, refractivity_after : n - 1 of the air on either side, () or (n,).
    normal : (3,) or (n, 3) unit vectors of the window.

    Returns the change (n, 3) to be added to ``direction``, and the angle (n,) between the two
    [rad], positive where the air before is the denser: R_cc of a ray out of the compartment, whose
    image point the cabin has moved inward. Both are NaN for a ray that the window reflects wholly,
    and for one along the window or against the normal (normal . direction <= 0).

    Exact, without differencing. Source: Gyer 1996, Eq. 36 in vector form.

    >>> ray = np.array([[0.70710678118654752, 0.0, 0.70710678118654752]])
    >>> _, r_cc = refract_at_window(ray, 187.84e-6, 93.57e-6)
    >>> (r_cc * 180 * 3600 / np.pi).round(2).tolist()  # Gyer's Table 7, 10 km: 19.44
    [19.44]
    """
    from unbend.refraction.kernels.window import refract_directions

    before = np.asarray(refractivity_before, dtype=np.float64)
    after = np.asarray(refractivity_after, dtype=np.float64)
    excess = (before - after) / (1.0 + after)  # n_before / n_after - 1
    rays = np.array(direction, np.float64, order="C")
    normals = np.array(np.broadcast_to(normal, rays.shape), np.float64)
    change = np.empty(rays.shape)
    angle = np.empty(rays.shape[0])
    excess_of_ray = np.array(np.broadcast_to(excess, angle.shape))
    refract_directions(rays, normals, excess_of_ray, change, angle)
    return change, angle
