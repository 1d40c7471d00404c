"""Cameras, exposures and corrections of a few observations, for the tests of images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.atmosphere.profile import Profile
from unbend.refraction import (
    BrownConrady,
    Camera,
    Corrections,
    Exposures,
    StationSigmas,
    apply_refraction,
    correct_observations,
    uncertainty_of,
)
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED

RADIUS = 6_371_000.0
CABIN = 2.4e-4  # n - 1 behind a sealed window
AHEAD = (0.0, 0.0, 1.0)
TILTED = (0.0, np.sin(0.3), np.cos(0.3))  # normal of a window
# East-north-up to camera (x right, y down, z forward): straight down, image top to the north.
DOWN = np.diag([1.0, -1.0, -1.0])

PINHOLE = Camera(14_000, 10_600, 11_000.0, 11_000.0, 7012.4, 5291.7)
DISTORTED = replace(PINHOLE, distortion=BrownConrady(-0.018, 0.009, -0.002, 1.5e-4, -1e-4))
SKEWED = replace(PINHOLE, fy_px=11_200.0, distortion=BrownConrady(-0.02, 0.01, -0.002, 2e-4, -1e-4))
NARROW = Camera(200, 200, 20_000.0, 20_000.0, 100.0, 100.0)


def looking(tilt_deg: float, azimuth_deg: float = 0.0, swing_deg: float = 0.0) -> np.ndarray:
    """Rotation of a camera tilted from the nadir towards an azimuth."""
    towards = Rotation.from_euler("z", azimuth_deg, degrees=True).as_matrix()
    tilt = Rotation.from_euler("x", -tilt_deg, degrees=True).as_matrix()
    swing = Rotation.from_euler("z", swing_deg, degrees=True).as_matrix()
    return swing @ tilt @ DOWN @ towards


def exposure(
    air: Profile,
    rotation: np.ndarray = DOWN,
    *,
    h_c: float = 3450.0,
    cabin_excess: float = 0.0,
    normal: tuple[float, ...] = AHEAD,
    change_px: float = 0.0,
    radius_m: float | None = RADIUS,
) -> Exposures:
    """One exposure at 0.8 rad of latitude; in its cabin n - 1 is ``cabin_excess`` larger."""
    height = np.array([h_c])
    outside = air.refractivity(height)
    return Exposures(
        usable=np.array([True]),
        rotation=rotation[None],
        latitude_rad=np.array([0.8]),
        height_m=height,
        refractivity_outside=outside,
        refractivity_cabin=outside + cabin_excess,
        window_normal=np.array([normal]),
        principal_change_px=np.array([change_px]),
        radius_m=radius_m,
    )


def together(*exposures: Exposures) -> Exposures:
    """Exposures that have one radius, one after the other."""
    columns = {}
    for field in fields(Exposures):
        values = [getattr(one_exposure, field.name) for one_exposure in exposures]
        columns[field.name] = values[0] if field.name == "radius_m" else np.concatenate(values)
    return Exposures(**columns)


def _of_columns(function: Callable[..., Corrections]) -> Callable[..., Corrections]:
    """A correction whose columns broadcast to the shape of the pixels."""

    def made(
        x, y, exposures, table, *, camera=PINHOLE, h_g=0.0, row=0, uncertainty=None, **columns
    ):
        shapes = [np.shape(values) for values in (x, y, h_g, row, *columns.values())]
        shape = np.broadcast_shapes((1,), *shapes)

        def column(values, kind=np.float64):
            return np.array(np.broadcast_to(values, shape), kind)

        return function(
            column(x),
            column(y),
            column(h_g),
            column(row, np.int64),
            exposures,
            camera=camera,
            table=table,
            uncertainty=uncertainty,
            **{name: column(values) for name, values in columns.items()},
        )

    return made


corrected = _of_columns(correct_observations)
displaced = _of_columns(apply_refraction)


def station_sigmas(
    count: int = 1,
    *,
    tilt: float = 0.0,
    yaw: float = 0.0,
    height: float = 0.0,
    axis: tuple[float, ...] | np.ndarray = AHEAD,
    cabin: float | None = None,
) -> StationSigmas:
    """Exposures that are known alike."""
    return StationSigmas(
        tilt_rad=np.full(count, tilt),
        yaw_rad=np.full(count, yaw),
        yaw_axis=np.tile(np.asarray(axis, float), (count, 1)),
        height_m=np.full(count, height),
        cabin=None if cabin is None else np.full((count, 4), cabin),
    )


@dataclass(frozen=True)
class Look:
    """A camera above its ground, and what is in front of it."""

    rotation: np.ndarray
    h_c: float
    normal: tuple[float, ...] = AHEAD
    kind: int = OPEN
    camera: Camera = SKEWED

    def exposure(self, air: Profile, *, higher_m: float = 0.0, denser: float = 0.0) -> Exposures:
        """As this air has it: the cabin of the schedule follows the pressure outside."""
        h_c = self.h_c + higher_m
        outside = float(air.refractivity(h_c))
        scheduled = float(air.index.refractivity(294.26, air.pressure(h_c), 0.0))
        inside = {OPEN: outside, SEALED: CABIN, SCHEDULED: scheduled}[self.kind]
        excess = inside + denser - outside
        return exposure(air, self.rotation, h_c=h_c, normal=self.normal, cabin_excess=excess)


def uncertainties(profile, covariance, exposures, camera, stations, **options):
    """What `uncertainty_of` makes of exposures of one camera."""
    cameras = [(camera, np.ones(exposures.usable.size, bool))]
    settings = {"ground_heights_m": (-600.0, 10_000.0), **options}
    return uncertainty_of(profile, covariance, exposures, stations, cameras, **settings)
