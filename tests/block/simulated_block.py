"""A block of images with true stations, points and rays, from a local tangent plane of its own.

Independent of the package: numpy only, centres on a plane that is put on the ellipsoid by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

A = 6378137.0
F = 1.0 / 298.257223563
E2 = F * (2.0 - F)


def axes(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rows east, north, up."""
    zero = np.zeros_like(lat)
    east = np.stack([-np.sin(lon), np.cos(lon), zero], -1)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)
    return np.stack([east, np.cross(up, east), up], -2)


def ecef(lat: np.ndarray, lon: np.ndarray, h: np.ndarray) -> np.ndarray:
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    flat = np.stack([(n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon)], -1)
    return np.concatenate([flat, ((n * (1.0 - E2) + h) * np.sin(lat))[:, None]], 1)


def turn(vector: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations by rotation vectors (n, 3), after Rodrigues."""
    angle = np.linalg.norm(vector, axis=-1)[:, None, None]
    x, y, z = (vector / np.maximum(angle[:, 0], 1e-30)).T
    o = np.zeros_like(x)
    k = np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


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
    true_centre: np.ndarray


def simulate_block(
    rng: np.random.Generator,
    *,
    lines: int = 3,
    each: int = 12,
    height: float = 1000.0,
    base: float = 300.0,
    points: int = 600,
    sigma: tuple[float, ...] = (0.5, 0.5, 1.0, 0.003, 0.003, 0.008),
    pixel_rad: float = 1e-4,
    cameras: tuple[float, ...] = (0.0,),
    errors: bool = True,
) -> Block:
    """A nadir block at 47 degrees north; ``cameras`` are their tilts across the line [rad]."""
    count = lines * each
    y = np.repeat(np.arange(lines) * 2.0 * base, each)
    x = np.tile(np.arange(each) * base, lines)
    lat0 = np.radians(47.0)
    lon0 = np.radians(8.0)
    lat = np.tile(lat0 + y / 6.37e6, len(cameras))
    lon = np.tile(lon0 + x / (6.37e6 * np.cos(lat0)), len(cameras))
    h = height + rng.normal(0.0, 10.0, lat.size)
    heading = np.tile(np.repeat(np.arange(lines) % 2 * np.pi, each), len(cameras))
    heading = heading + rng.normal(0.0, 0.05, lat.size)
    tilt = np.repeat(cameras, count)
    # Camera x right of the flight, y back, z down, then tilted about y.
    c = np.cos(heading)
    s = np.sin(heading)
    o = np.zeros(lat.size)
    i = np.ones(lat.size)
    level = np.stack([-s, -c, o, -c, s, o, o, o, -i], -1).reshape(-1, 3, 3)
    level[:, 0] *= -1.0
    level[:, 1] = np.cross(level[:, 2], level[:, 0])
    wobble = turn(rng.normal(0.0, 0.02, (lat.size, 3)))
    true = wobble @ turn(np.stack([o, tilt, o], -1)) @ level
    true_centre = ecef(lat, lon, h)
    frames = axes(lat, lon)
    px = rng.uniform(-0.4 * height, x.max() + 0.4 * height, points)
    py = rng.uniform(-0.4 * height, y.max() + 0.4 * height, points)
    ph = rng.uniform(0.0, 60.0, points)
    ground = ecef(lat0 + py / 6.37e6, lon0 + px / (6.37e6 * np.cos(lat0)), ph)
    ray = np.einsum("sij,sjk,spk->spi", true, frames, ground[None] - true_centre[:, None])
    d = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    seen = (d[..., 2] > 0) & (np.abs(ray[..., :2] / ray[..., 2:]).max(axis=-1) < 0.45)
    image, point = np.nonzero(seen)
    direction = d[image, point]
    noise = rng.normal(0.0, pixel_rad, direction.shape)
    direction = direction + noise - np.sum(noise * direction, -1, keepdims=True) * direction
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    said = rng.normal(0.0, 1.0, (lat.size, 6)) * sigma * errors
    return Block(
        camera=np.repeat([f"camera{n}" for n in range(len(cameras))], count).astype(object),
        lat=lat + said[:, 1] / 6.367e6,
        lon=lon + said[:, 0] / (6.389e6 * np.cos(lat)),
        h=h + said[:, 2],
        camera_from_enu=true @ turn(said[:, 3:]),
        sigma=np.tile(sigma, (lat.size, 1)),
        image=image,
        point=point,
        direction=direction,
        point_h=ph,
        pixel_rad=pixel_rad,
        true_centre=true_centre,
    )
