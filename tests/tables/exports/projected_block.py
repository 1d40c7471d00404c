"""A block whose image points are projected by straight rays, without the package.

Truth: PROJ for places and frames, the lens' formulas written out. Two cameras in 14 km of flight,
so that the vertical turns by 450 arcsec; pixels counted from the centre of the first.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
from scipy.spatial.transform import Rotation

from tests.tables.exports.export_runs import (
    DOWN,
    Written,
    ecef_of,
    enu_axes,
    finished_run,
    read_table,
    stations_at,
)
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import ExportCamera, FinishedRun

NADIR = Camera(
    14000,
    10600,
    20000.0,
    20010.0,
    7012.4,
    5291.7,
    BrownConrady(-0.018, 0.009, -0.002, 1.5e-4, -1e-4),
)
SQUARE = replace(NADIR, fy_px=NADIR.fx_px)
SIDE = Camera(9000, 12000, 15000.0, 15000.0, 4500.0, 6010.0)

IMAGES = 12
POINTS = 400
H_MSL = 6000.0
GROUND = 300.0
UNDULATION = 47.5
SIGMA_HORIZONTAL = 0.03
SIGMA_HEIGHT = 0.05


def distorted(camera: Camera, u, v):
    """OpenCV's formulas."""
    k1, k2, k3, p1, p2 = camera.distortion
    r2 = u * u + v * v
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    y = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return camera.fx_px * x + camera.cx_px, camera.fy_px * y + camera.cy_px


class Frame:
    """East, north, up at an origin (latitude, longitude, height), by PROJ."""

    def __init__(self, origin) -> None:
        self.origin = [float(value) for value in origin]
        lat, lon, h = self.origin
        self.proj = pyproj.Transformer.from_pipeline(
            f"+proj=topocentric +ellps=WGS84 +lat_0={lat!r} +lon_0={lon!r} +h_0={h!r}"
        )

    def __call__(self, ecef: np.ndarray) -> np.ndarray:
        """(n, 3) places in the frame, of earth-centred ones."""
        return np.stack(self.proj.transform(*ecef.T), axis=1)


def frame_of(written: Written) -> Frame:
    """The frame whose origin the ledger states."""
    what = written.message("EXPORT-FRAME").what
    assert "neither earth curvature nor a map projection is applied" in what
    return Frame(re.findall(r"(-?[0-9.]+) (?:N|E|m above)", what))


def point_names(folder: Path) -> dict[int, str]:
    """Names of the points that are no numbers, by the numbers they have in the files."""
    table = read_table(folder / "points.csv")
    return dict(zip(table.id, table.point, strict=True))


class Block:
    """Stations, points, and their image points in an order that is drawn.

    ``rows`` : image, point, pixels as COLMAP counts them, height, and u, v without distortion.
    """

    def __init__(self, folder: Path, nadir: Camera = NADIR) -> None:
        rng = np.random.default_rng(11)
        number = np.arange(IMAGES)
        self.folder = folder
        self.numbers = itertools.count()
        self.cameras = {"nadir": nadir, "side": SIDE}
        self.image = np.array([f"strip_{i // 6}/{i:04d}.tif" for i in number], object)
        self.camera = np.where(number % 2 == 0, "nadir", "side").astype(object)
        self.lon = 8.0 + 0.03 * (number // 2)
        self.lat = 47.0 + 0.01 * (number % 2)
        self.h = H_MSL + UNDULATION + rng.uniform(-50, 50, IMAGES)
        self.centre = ecef_of(self.lon, self.lat, self.h)
        tilt = 20.0 * (number % 2) + rng.uniform(-2, 2, IMAGES)
        yaw = rng.uniform(0, 360, IMAGES)
        roll = rng.uniform(-2, 2, IMAGES)
        angles = np.stack([yaw, tilt, roll], axis=1)
        # From east, north, up at each station to the camera.
        self.turn = Rotation.from_euler("zxy", angles, degrees=True).as_matrix() @ DOWN
        lon, lat = rng.uniform([7.97, 46.97], [8.18, 47.04], (POINTS, 2)).T
        height = rng.uniform(GROUND, GROUND + 200.0, POINTS)
        self.point = np.array([str(7 * i + 5) if i % 3 else f"p{i}" for i in range(POINTS)], object)
        self.place = dict(zip(self.point, ecef_of(lon, lat, height + UNDULATION), strict=True))
        seen = [self.seen_in(i, height) for i in range(IMAGES)]
        self.rows = pd.concat(seen).sample(frac=1.0, random_state=11, ignore_index=True)
        images_of_point = self.rows.point.value_counts()
        self.tied = set(images_of_point.index[images_of_point > 1])

    def seen_in(self, i: int, height: np.ndarray) -> pd.DataFrame:
        """The points of an image."""
        camera = self.cameras[self.camera[i]]
        enu = (np.array(list(self.place.values())) - self.centre[i]) @ enu_axes(
            self.lon[i], self.lat[i]
        ).T
        rays = enu @ self.turn[i].T
        u = rays[:, 0] / rays[:, 2]
        v = rays[:, 1] / rays[:, 2]
        x, y = distorted(camera, u, v)
        columns = {"point": self.point, "x_px": x, "y_px": y, "h_g_m": height, "u": u, "v": v}
        rows = pd.DataFrame({"image": self.image[i], **columns})
        is_inside = (x > 0) & (x < camera.width_px) & (y > 0) & (y < camera.height_px)
        return rows[is_inside & (rays[:, 2] > 0)]

    @property
    def ordered(self) -> pd.DataFrame:
        """The rows image by image, in each in the order of the run."""
        return pd.concat([self.of_image(image) for image in self.image], ignore_index=True)

    def of_image(self, image: str) -> pd.DataFrame:
        return self.rows[self.rows.image == image]

    def places(self, points) -> np.ndarray:
        """(n, 3) earth-centred places of points."""
        return np.array([self.place[point] for point in points])

    def axes(self, frame: Frame) -> np.ndarray:
        """(n, 3, 3) from a frame to east, north, up at each station."""
        axes = []
        for lon, lat, centre in zip(self.lon, self.lat, self.centre, strict=True):
            ends = frame(centre + 1e3 * enu_axes(lon, lat))
            axes.append((ends - frame(centre[None])) * 1e-3)
        return np.array(axes)

    def run(self, rows: pd.DataFrame | None = None, **changes) -> FinishedRun:
        """The finished run of all rows, or of others, as two files as it writes them."""
        stations = stations_at(
            self.image,
            self.camera,
            self.lon,
            self.lat,
            self.h - UNDULATION,
            self.h,
            self.turn,
            sigma_horizontal_m=np.full(IMAGES, SIGMA_HORIZONTAL),
            sigma_height_m=np.full(IMAGES, SIGMA_HEIGHT),
        )
        rows = self.rows if rows is None else rows
        run = finished_run(
            stations,
            self.turn,
            {name: ExportCamera(camera, False) for name, camera in self.cameras.items()},
            GROUND,
            parts=(self.part_of(rows[:300]), self.part_of(rows[300:])),
        )
        return replace(run, **changes)

    def part_of(self, rows: pd.DataFrame) -> Path:
        path = self.folder / f"part-{next(self.numbers)}.parquet"
        columns = {
            "image": pa.array(rows.image, pa.string()),
            "point": pa.array(rows.point, pa.string()),
            "x_corrected_px": rows.x_px - 0.5,
            "y_corrected_px": rows.y_px - 0.5,
            "h_g_m": rows.h_g_m,
            "status": rows.get("status", pd.Series("ok", index=rows.index)),
        }
        pq.write_table(pa.table(columns), path)
        return path

    def renamed(self, names) -> FinishedRun:
        """The run with other names of the images."""
        new = dict(zip(self.image, names, strict=True))
        run = self.run(self.rows.assign(image=self.rows.image.map(new)))
        stations = replace(run.stations, image=np.array(names, object))
        return replace(run, stations=stations)

    def with_side_camera(self, camera: Camera) -> FinishedRun:
        run = self.run()
        return replace(run, cameras={**run.cameras, "side": ExportCamera(camera, False)})
