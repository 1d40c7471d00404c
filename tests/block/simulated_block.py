"""A block of images with true stations, points and rays, from a local tangent plane of its own.

The truth is independent of the package: numpy and scipy only, centres on a plane that is put on the
ellipsoid by hand.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.small_block import ecef, enu_axes
from unbend.block.image_rays import ImageRays, Orientations

METRES_OF_LATITUDE = 6.37e6
LAT = np.radians(47.0)
LON = np.radians(8.0)
WIDEST_TANGENT = 0.45  # that an image shows, along its sides


def axes(lat, lon):
    """(n, 3, 3) rows east, north, up."""
    places_deg = np.degrees([lat, lon]).T
    return np.array([enu_axes(*place) for place in places_deg])


def centres(lat, lon, h):
    """(n, 3) earth-centred."""
    lat_deg = np.degrees(lat)
    lon_deg = np.degrees(lon)
    return ecef(lat_deg, lon_deg, h)


def unit(vectors):
    return vectors / np.linalg.norm(
        vectors,
        axis=-1,
        keepdims=True,
    )


def turn(vector):
    """(n, 3, 3) rotations by rotation vectors (n, 3)."""
    return Rotation.from_rotvec(vector).as_matrix()


@dataclass
class Block:
    """(s,) images, (r,) rays; what the log says of the stations is the truth plus their errors."""

    camera: np.ndarray
    lat: np.ndarray
    lon: np.ndarray
    h: np.ndarray
    camera_from_enu: np.ndarray
    sigma: np.ndarray  # (s, 6)
    image: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    point_h: np.ndarray
    pixel_rad: float

    @property
    def orientations(self):
        """What the log says of the stations."""
        frames = axes(self.lat, self.lon)
        return Orientations(
            self.camera,
            centres(self.lat, self.lon, self.h),
            self.camera_from_enu @ frames,
            frames,
            self.sigma,
        )

    @property
    def rays(self):
        """What the images show."""
        return ImageRays(self.image, self.point, self.direction, self.pixel_rad)


def simulate_block(
    seed,
    *,
    lines=3,
    each=12,
    height=1000.0,
    base=300.0,
    points=600,
    sigma: tuple[float, ...] = (0.5, 0.5, 1.0, 0.003, 0.003, 0.008),
    pixel_rad=1e-4,
    cameras: tuple[float, ...] = (0.0,),
    errors=True,
):
    """A nadir block at 47 degrees north; ``cameras`` are their tilts across the line [rad]."""
    rng = np.random.default_rng(seed)
    heads = len(cameras)
    count = lines * each
    line = np.tile(np.repeat(np.arange(lines), each), heads)
    x = np.tile(np.arange(each) * base, lines * heads)
    y = line * 2.0 * base
    lat, lon = places(x, y)
    h = height + rng.normal(0.0, 10.0, x.size)
    camera_from_enu = attitudes(rng, line, np.repeat(cameras, count))

    margin = 0.4 * height
    point_x = rng.uniform(-margin, x.max() + margin, points)
    point_y = rng.uniform(-margin, y.max() + margin, points)
    point_h = rng.uniform(0.0, 60.0, points)
    ground = centres(*places(point_x, point_y), point_h)
    to_ground = ground[None] - centres(lat, lon, h)[:, None]
    camera_from_ecef = camera_from_enu @ axes(lat, lon)
    ray = np.einsum("sij,spj->spi", camera_from_ecef, to_ground)
    tangents = np.abs(ray[..., :2] / ray[..., 2:])
    is_seen = (ray[..., 2] > 0) & (tangents.max(axis=-1) < WIDEST_TANGENT)
    image, point = np.nonzero(is_seen)
    direction = unit(ray[image, point])
    noise = rng.normal(0.0, pixel_rad, direction.shape)
    along = np.sum(noise * direction, -1, keepdims=True) * direction

    logged = rng.normal(0.0, 1.0, (x.size, 6)) * sigma * errors
    east_m, north_m, up_m = logged[:, :3].T
    names = [f"camera{number}" for number in range(heads)]
    return Block(
        camera=np.repeat(names, count).astype(object),
        lat=lat + north_m / 6.367e6,
        lon=lon + east_m / (6.389e6 * np.cos(lat)),
        h=h + up_m,
        camera_from_enu=camera_from_enu @ turn(logged[:, 3:]),
        sigma=np.tile(sigma, (x.size, 1)),
        image=image,
        point=point,
        direction=unit(direction + noise - along),
        point_h=point_h,
        pixel_rad=pixel_rad,
    )


def places(east_m, north_m):
    """Latitude and longitude of places on the plane."""
    lat = LAT + north_m / METRES_OF_LATITUDE
    lon = LON + east_m / (METRES_OF_LATITUDE * np.cos(LAT))
    return lat, lon


def attitudes(rng, line, tilt):
    """(n, 3, 3) camera from east, north, up: lines to and fro, tilted about y, with a wobble."""
    heading = line % 2 * np.pi + rng.normal(0.0, 0.05, line.size)
    o = np.zeros(line.size)
    # Camera x right of the flight, z down.
    x = np.stack(
        [
            np.sin(heading),
            np.cos(heading),
            o,
        ],
        -1,
    )
    z = np.stack([o, o, o - 1.0], -1)
    level = np.stack([x, np.cross(z, x), z], -2)
    tilted = turn(np.stack([o, tilt, o], -1)) @ level
    wobble = rng.normal(0.0, 0.02, (line.size, 3))
    return turn(wobble) @ tilted
