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
SCHEDULE_CEILING_M = 10_000.0  # Gyer's Table 7 ends here

SIGMA_BAROMETER_PA = 3.0 * HECTOPASCAL
"""Standard deviation of an uncalibrated barometer; and of the pressure in a vented cabin from that
outside, as the alternate static sources of light aircraft show (some 25 m of height)."""

SIGMA_THERMOMETER_K = 1.0
"""Standard deviation of an uncalibrated thermometer in the cabin from the air at the window."""

UNKNOWN = float("nan")


@dataclass(frozen=True)
class Cabin:
    """The statements of a mission about the air in the compartment; NaN where there is none.

    ``source`` of the pressure: logged with each exposure, constant (``pressure_pa``), ambient (as
    outside), or Gyer's schedule. ``temperature_k`` and ``relative_humidity`` (0 to 1) that are not
    stated are taken from the log or assumed; ``temperature_logged`` is True where the mission
    states that the log has the temperature. The sigmas are standard deviations.

    The source ``opening`` is for a compartment without glass: its air is that outside, ``warmer_k``
    warmer and with ``excess_pa`` more pressure.
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

    ``cabin`` is the air behind it, None where it is unknown, which only a spherical window allows.
    ``normal`` is a unit vector out of the compartment in the ``frame`` of the camera (x right, y
    down, z forward) or of the aircraft's body (x forward, y right, z down; for a camera that turns
    behind the window). A window of spherical ``shape``, about the projection centre, bends nothing:
    every ray meets it at right angles. ``in_calibration``: whether the camera was calibrated with
    the glass in front of it; it changes no number here.

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
        """Whether there is no glass, and the air behind the opening is nearly that outside."""
        return self.cabin is not None and self.cabin.source == "opening"

    @property
    def section(self) -> str:
        """Name of the section of the mission file that describes it: opening or window."""
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

    ``ambient_pa``: pressure outside [Pa], any shape. The pressure inside is that outside up to 3 km
    pressure altitude (701.2 hPa) and stays at 701.2 hPa above; the temperature inside is
    `SCHEDULE_TEMPERATURE_K`. Valid to 10 km. Source: Gyer 1996, Table 7, after Ebeling 1968.

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

    direction : (n, 3) unit vectors of the rays before the window, in the frame of ``normal``.
    refractivity_before, refractivity_after : n - 1 of the air that the rays come from and of the
        air that they go into, () or (n,). Rays may go out of the compartment or into it.
    normal : (3,) or (n, 3) unit vectors of the window; to the side that the rays go to.

    Returns the change (n, 3) to be added to ``direction``, and the angle (n,) [rad] between the
    directions before and after. The angle is positive where the air before is denser: then the ray
    turns away from the normal. For rays out of the compartment it is R_cc. Both are NaN for a ray
    that the window reflects totally or that does not go through it (normal . direction <= 0).

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
