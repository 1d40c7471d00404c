"""Cameras, exposures and corrections of a few observations, for the tests of images."""

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.refraction import (
    BrownConrady,
    Camera,
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


def turned(axes, degrees):
    """Rotation matrix by Euler angles, of one axis or several."""
    return Rotation.from_euler(axes, degrees, degrees=True).as_matrix()


def looking(tilt_deg, azimuth_deg=0.0, swing_deg=0.0):
    """Rotation of a camera tilted from the nadir towards an azimuth."""
    towards = turned("z", azimuth_deg)
    tilt_and_swing = turned("xz", [-tilt_deg, swing_deg])
    return tilt_and_swing @ DOWN @ towards


def exposure(
    air,
    rotation=DOWN,
    *,
    h_c=3450.0,
    cabin_excess=0.0,
    normal=AHEAD,
    change_px=0.0,
    radius_m=RADIUS,
):
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


NO_EXPOSURES = Exposures(
    usable=np.empty(0, bool),
    rotation=np.empty((0, 3, 3)),
    latitude_rad=np.empty(0),
    height_m=np.empty(0),
    refractivity_outside=np.empty(0),
    refractivity_cabin=np.empty(0),
)


def together(*exposures):
    """Exposures that have one radius, one after the other."""
    columns = {}
    for field in fields(Exposures):
        values = [getattr(exposure, field.name) for exposure in exposures]
        if field.name == "radius_m":
            columns[field.name] = values[0]
        else:
            columns[field.name] = np.concatenate(values)
    return Exposures(**columns)


def _of_columns(function):
    """A correction whose columns broadcast to the shape of the pixels."""

    def with_columns(
        x,
        y,
        exposures,
        table,
        *,
        camera=PINHOLE,
        h_g=0.0,
        row=0,
        uncertainty=None,
        **columns,
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

    return with_columns


corrected = _of_columns(correct_observations)
displaced = _of_columns(apply_refraction)


def station_sigmas(
    count=1,
    *,
    tilt=0.0,
    yaw=0.0,
    height=0.0,
    axis=AHEAD,
    cabin=None,
):
    """Exposures that are known alike."""
    return StationSigmas(
        tilt_rad=np.full(count, tilt),
        yaw_rad=np.full(count, yaw),
        yaw_axis=np.tile(axis, (count, 1)),
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

    def exposure(self, air, *, higher_m=0.0, denser=0.0):
        """As this air has it: the cabin of the schedule follows the pressure outside."""
        h_c = self.h_c + higher_m
        outside = float(air.refractivity(h_c))
        scheduled = air.index.refractivity(294.26, air.pressure(h_c), 0.0)
        inside = {OPEN: outside, SEALED: CABIN, SCHEDULED: scheduled}[self.kind]
        return exposure(
            air,
            self.rotation,
            h_c=h_c,
            normal=self.normal,
            cabin_excess=inside + denser - outside,
        )


def uncertainties(profile, covariance, exposures, camera, stations, **options):
    """What `uncertainty_of` makes of exposures of one camera."""
    cameras = [(camera, np.ones(exposures.usable.size, bool))]
    settings = {"ground_heights_m": (-600.0, 10_000.0), **options}
    return uncertainty_of(profile, covariance, exposures, stations, cameras, **settings)
