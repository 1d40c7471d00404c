"""Blocks of images with known truth, and pycolmap as the adjustment that takes them.

The truth is the simulator's ray, an ODE, through real soundings; only `correct` and
`adjusted_profile` are the package's.
"""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d

from tests.atmosphere import flights
from unbend.atmosphere import profile_from_table, standard_atmosphere
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.geodesy import lambert_gravity
from unbend.messages import Ledger
from unbend.refraction import Camera, Exposures, correct_observations, ray_table
from unbend.simulate.block import GroundPoints, TrueObservations, TrueStations, observe
from unbend.simulate.flight import UNDULATION_M, AirState
from unbend.simulate.optics import (
    NED_FROM_ENU,
    SimulatedCamera,
    body_rotation,
    enu_axes,
    height_and_up,
    quaternion,
    to_ecef,
    unit,
)

from .bundle_adjustment import Adjustment

FOCAL_PX = 20_000.0  # 100 mm, pixels of 5 um
POINTS = 300
FEWEST = 12  # observations an image
GNSS_M = (0.03, 0.03, 0.05)
SIGMA_PX = 0.3  # of tie points; pycolmap counts in whole pixels
US1976 = standard_atmosphere("us1976")


class RealAir(flights.Truth):
    """The air of a balloon, smoothed over 100 m, so that rays through it have a smooth index."""

    def __init__(self, balloon):
        step = 20.0
        h = np.arange(balloon.H[0], balloon.H[0] + 10_800.0, step)

        def smooth(values):
            return gaussian_filter1d(np.interp(h, balloon.H, values), 100.0 / step, mode="nearest")

        vapour = np.exp(smooth(np.log(balloon.e)))
        super().__init__(replace(balloon, H=h, t=smooth(balloon.t), e=vapour))
        every = slice(None, None, round(step))
        self._index = make_interp_spline(self.h[every], self.refractivity[every], k=7)

    @property
    def ground(self):
        """Height of the ground above sea level [m]: its first level, and a camera may hang low."""
        return float(self.h[0]) + 5.0

    def n(self, h_m):
        return 1.0 + self._index(h_m)

    def dn_dh(self, h_m):
        return self._index(h_m, 1)

    def profile(self):
        """The table of the truth, every 5 m, as a profile of the package."""
        columns = (column[::5] for column in (self.h, self.t, self.p, self.e))
        return profile_from_table(*columns, gravity=lambert_gravity(self.latitude))

    def adjusted_profile(self, climb, rng):
        """What the package makes of a flight's sensors, drawn with bias, lag, drift and noise."""
        samples = flights.fly(self, climb, flights.drawn(rng), rng, descent=True)
        background = climatology(
            latitude_rad=self.latitude,
            month=month_of(self.start_ns),
            ground_h_m=self.ground,
        )
        adjusted = build_adjusted_profile(
            samples,
            US1976,
            self.latitude,
            Ledger(),
            background=background,
        )
        return adjusted.profile


def real_airs():
    return [RealAir(balloon) for balloon in flights.balloons()]


def heads(tilt_deg=45.0):
    """A nadir camera and four that look out to all sides."""
    sides = {
        "nadir": (0, 0),
        "left": (1, 0),
        "right": (-1, 0),
        "fore": (0, 1),
        "aft": (0, -1),
    }
    cameras = []
    for name, (roll, pitch) in sides.items():
        camera = SimulatedCamera(
            name,
            0,
            FOCAL_PX,
            7000.0,
            5300.0,
            (0.0,) * 5,
            roll * tilt_deg,
            (0.0,) * 3,
            pitch_deg=pitch * tilt_deg,
        )
        cameras.append(camera)
    return tuple(cameras)


@dataclass(frozen=True, eq=False)
class Block:
    """Stations, points and what the cameras measure, in the simulator's own tables."""

    cameras: tuple[SimulatedCamera, ...]
    stations: TrueStations
    points: GroundPoints
    seen: TrueObservations

    @property
    def measured(self):
        """(n, 2) pixels, bent."""
        return np.stack([self.seen.x_px, self.seen.y_px], axis=1)

    @property
    def straight(self):
        """(n, 2) pixels of the straight chords."""
        return np.stack([self.seen.x_true_px, self.seen.y_true_px], axis=1)

    @property
    def foot(self):
        """Latitude and longitude [rad] of the first station."""
        return self.stations.lat_rad[0], self.stations.lon_rad[0]

    def local(self, ecef):
        """(n, 3) east, north, up at the foot of the first station."""
        origin = to_ecef(*self.foot, np.array(0.0))
        return (ecef - origin) @ enu_axes(*self.foot).T

    @property
    def local_rotation(self):
        """(s, 3, 3) from these axes to the cameras."""
        s = self.stations
        return s.camera_from_enu @ enu_axes(s.lat_rad, s.lon_rad) @ enu_axes(*self.foot).T


def fly_block(
    air,
    height,
    seed,
    cameras: tuple[SimulatedCamera, ...],
    *,
    lines=4,
    shots=5,
    most=24,
):
    """Lines with all cameras at each exposure, over 300 points 0-300 m high.

    ``height`` above ground [m]; ``most`` observations an image, 12 at least: images that see fewer
    points are left out. Four lines of five span the points; with seven of eleven, heads at 45 deg
    see them from all sides.
    """
    rng = np.random.default_rng(seed)
    count = lines * shots
    # 60 % forward and 30 % side overlap of 0.53 by 0.70 of the height; lines fly east and west.
    line, shot = (grid.ravel() for grid in np.mgrid[:lines, :shots])
    along = 0.212 * (shot - 0.5 * (shots - 1))
    across = 0.49 * (line - 0.5 * (lines - 1))
    x = height * (along + rng.normal(0.0, 0.01, count))
    y = height * (across + rng.normal(0.0, 0.01, count))
    h = air.ground + height * (1.0 + rng.normal(0.0, 0.003, count))
    angles = rng.normal(0.0, 0.02, (count, 3))
    angles[:, 2] += np.pi * np.where(line % 2, 1.5, 0.5)
    body = np.stack([body_rotation(*a).T @ NED_FROM_ENU for a in angles])
    centre, lat, lon = _places(air.latitude, x, y, h)
    camera = np.repeat(np.arange(len(cameras)), count)
    place = np.tile(np.arange(count), len(cameras))
    rotation = np.concatenate([c.from_body() @ body for c in cameras])

    px = height * rng.uniform(-0.5, 0.5, POINTS)
    py = height * rng.uniform(-0.85, 0.85, POINTS)
    ph = air.ground + rng.uniform(0.0, 300.0, POINTS)
    ground, *angle = _places(air.latitude, px, py, ph)
    names = tuple(f"p{i}" for i in range(POINTS))
    points = GroundPoints(names, *angle, ph, ground)

    chord = unit(ground[None] - centre[:, None])[place]
    axes = enu_axes(lat, lon)[place]
    rays = np.einsum("sij,sjk,spk->spi", rotation, axes, chord)
    seen = np.stack([cameras[c].sees(r) for c, r in zip(camera, rays, strict=True)])
    # So many points drawn in each image, and of these the ones that another image has too.
    chance = np.where(seen, rng.random(seen.shape), 2.0)
    seen &= chance <= np.sort(chance, axis=1)[:, most - 1, None]
    kept = seen.sum(axis=1) >= FEWEST
    seen = seen[kept] & (seen[kept].sum(axis=0) > 1)
    camera = camera[kept]
    place = place[kept]
    rotation = rotation[kept]

    unused = np.zeros(place.size)
    state = AirState(
        unused,
        unused,
        unused,
        unused,
        air.n(h[place]),  # the same in the cabin
    )
    images = zip(camera, place, strict=True)
    stations = TrueStations(
        tuple(f"{cameras[c].name}_{p:02d}" for c, p in images),
        camera,
        unused.astype(np.int64),
        centre[place],
        lat[place],
        lon[place],
        h[place] + UNDULATION_M,
        rotation,
        np.stack([quaternion(r) for r in rotation]),
        state,
        state,
    )
    station, point = np.nonzero(seen)
    observations = observe(
        air,
        stations,
        points,
        cameras,
        station=station,
        point=point,
    )
    assert observations.miss_m.max() < 1e-6
    return Block(cameras, stations, points, observations)


def _places(
    latitude,
    x,
    y,
    h_msl,
):
    """ECEF, latitude and longitude of places about x east, y north [m] of a latitude [rad]."""
    lat = latitude + y / 6.37e6
    lon = 0.15 + x / (6.38e6 * np.cos(latitude))
    h_ellipsoid = h_msl + UNDULATION_M
    ecef = to_ecef(lat, lon, h_ellipsoid)
    assert np.allclose(height_and_up(ecef)[0], h_ellipsoid, atol=1e-6)
    return ecef, lat, lon


def correct(block, profile, pixels=None):
    """(n, 2) pixels that the package makes of the measured ones, or of others beside them."""
    if pixels is None:
        pixels = block.measured
    s = block.stations
    seen = block.seen
    n = profile.refractivity(s.h_msl_m)
    exposures = Exposures(
        np.ones(n.size, bool),
        s.camera_from_enu,
        s.lat_rad,
        s.h_msl_m,
        n,
        n,
    )
    table = ray_table(profile)
    corrected = np.empty_like(pixels)
    for number, c in enumerate(block.cameras):
        rows = s.camera[seen.station] == number
        camera = Camera(
            c.width_px,
            c.height_px,
            c.focal_px,
            c.focal_px,
            c.cx_px,
            c.cy_px,
        )
        done = correct_observations(
            *pixels[rows].T.copy(),
            block.points.h_msl_m[seen.point[rows]],
            seen.station[rows],
            exposures,
            camera=camera,
            table=table,
        )
        assert not done.status.any()
        corrected[rows] = np.column_stack([done.x_corrected_px, done.y_corrected_px])
    return corrected


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Errors (n, 3) east, north, up [m] of points that are not control, and the cameras."""

    error: np.ndarray
    interior: dict[int, list[float]]

    @property
    def z(self):
        """Root mean square error in height [m]."""
        return float(np.sqrt(np.mean(self.error[:, 2] ** 2)))


def adjust(
    block,
    pixels,
    *,
    control=0,
    gnss=False,
    calibrate=False,
    interior: dict[int, list[float]] | None = None,
):
    """The points with orientations held; with ``control`` or ``gnss`` these are adjusted too.

    ``control``: so many points held at their true places; ``gnss``: places of the cameras as
    priors of 3 and 5 cm, at their true values, against 0.3 px; ``calibrate``: f, k1 and k2 of each
    camera adjusted, instead of held at the true ones or at ``interior`` of another adjustment.
    """
    s = block.stations
    seen = block.seen
    adjustment = Adjustment()
    for number, c in enumerate(block.cameras, start=1):
        params = [c.focal_px, c.cx_px, c.cy_px, 0.0, 0.0]
        if interior is not None:
            params = interior[number]
        camera = pycolmap.Camera(
            model="RADIAL",
            width=c.width_px,
            height=c.height_px,
            params=params,
            camera_id=number,
        )
        adjustment.add_camera(camera, constant=not calibrate)
    centre = block.local(s.ecef_m)
    true = block.local(block.points.ecef_m)
    priors = []
    for k, rotation in enumerate(block.local_rotation):
        rows = seen.station == k
        image = adjustment.add_image(
            s.image[k],
            int(s.camera[k]) + 1,
            pixels[rows],
            seen.point[rows].tolist(),
            rotation,
            centre[k],
        )
        prior = pycolmap.PosePrior(
            corr_data_id=image.data_id,
            position=centre[k],
            position_covariance=(np.diag(GNSS_M) / SIGMA_PX) ** 2,
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        priors.append(prior)

    tracks = adjustment.tracks
    points = sorted(tracks)
    often_seen = sorted(points, key=lambda p: -len(tracks[p]))[: len(points) // 2]
    fixed = _control(true, often_seen)[:control]
    for p in points:
        adjustment.add_point(p, true[p], constant=p in fixed)

    options = adjustment.options
    options.refine_rig_from_world = bool(control or gnss)
    options.ceres.solver_options.num_threads = 1
    adjustment.converge_tightly()
    if gnss:
        prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
        prior_options.alignment_ransac.max_error = 1.0
        prior_options.alignment_ransac.random_seed = 0
        solver = pycolmap.create_pose_prior_bundle_adjuster(
            options,
            prior_options,
            adjustment.config,
            priors,
            adjustment.model,
        )
        adjustment.solve(solver)
    else:
        adjustment.solve()
    error = [adjustment.position(p) - true[p] for p in points if p not in fixed]
    cameras = adjustment.model.cameras
    params = {number: list(camera.params) for number, camera in cameras.items()}
    return Adjusted(np.array(error), params)


# Nodes of a grid over the block, in parts of its size: corners first.
NODES = np.array(
    [
        [0.1, 0.1],
        [0.1, 0.9],
        [0.9, 0.1],
        [0.9, 0.9],
        [0.1, 0.5],
        [0.5, 0.1],
        [0.5, 0.9],
        [0.9, 0.5],
        [0.5, 0.5],
    ]
)


def _control(true, usable):
    """Of some points, those nearest to the nodes."""
    plane = true[:, :2]
    low = plane.min(axis=0)
    size = np.ptp(plane, axis=0)
    gaps = plane[usable] - (low + NODES * size)[:, None]
    nearest = np.linalg.norm(gaps, axis=2).argmin(axis=1)
    return list(dict.fromkeys(usable[k] for k in nearest))
