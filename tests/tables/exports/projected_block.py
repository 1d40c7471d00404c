"""A block whose image points are projected by straight rays, without the package.

Truth: PROJ for places and frames, the lens' formulas written out. Two cameras in 14 km of flight,
so that the vertical turns by 450 arcsec; pixels counted from the centre of the first.
"""

import itertools
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pyproj
from scipy.spatial.transform import Rotation

from tests.lens import brown
from tests.tables.exports.export_runs import (
    DOWN,
    ecef_of,
    enu_axes,
    finished_run,
    read_table,
    stations_at,
)
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import ExportCamera

NADIR = Camera(
    width_px=14000,
    height_px=10600,
    fx_px=20000.0,
    fy_px=20010.0,
    cx_px=7012.4,
    cy_px=5291.7,
    distortion=BrownConrady(
        k1=-0.018,
        k2=0.009,
        k3=-0.002,
        p1=1.5e-4,
        p2=-1e-4,
    ),
)
SQUARE = replace(NADIR, fy_px=NADIR.fx_px)
SIDE = Camera(
    width_px=9000,
    height_px=12000,
    fx_px=15000.0,
    fy_px=15000.0,
    cx_px=4500.0,
    cy_px=6010.0,
)

IMAGES = 12
POINTS = 400
H_MSL = 6000.0
GROUND = 300.0
UNDULATION = 47.5
SIGMA_HORIZONTAL = 0.03
SIGMA_HEIGHT = 0.05


def distorted(camera, u, v):
    x, y = brown(u, v, **camera.distortion._asdict())
    x_px = camera.fx_px * x + camera.cx_px
    y_px = camera.fy_px * y + camera.cy_px
    return x_px, y_px


class Frame:
    """East, north, up at an origin (latitude, longitude, height), by PROJ."""

    def __init__(self, origin):
        self.origin = [float(value) for value in origin]
        lat, lon, h = self.origin
        self.proj = pyproj.Transformer.from_pipeline(
            f"+proj=topocentric +ellps=WGS84 +lat_0={lat!r} +lon_0={lon!r} +h_0={h!r}"
        )

    def __call__(self, ecef):
        """(n, 3) places in the frame, of earth-centred ones."""
        return np.stack(self.proj.transform(*ecef.T), axis=1)


def frame_of(written):
    """The frame whose origin the ledger states."""
    message = written.message("EXPORT-FRAME").what
    assert "neither earth curvature nor a map projection is applied" in message
    return Frame(re.findall(r"(-?[0-9.]+) (?:N|E|m above)", message))


def point_names(folder):
    """Names of the points that are not numbers, by the numbers they have in the files."""
    table = read_table(folder / "points.csv")
    return dict(zip(table.id, table.point, strict=True))


def names_of_points(folder, numbers):
    """Names of points by their numbers in the files; those without one are called by the number."""
    names = point_names(folder)
    return [names.get(number, str(number)) for number in numbers]


class Block:
    """Stations, points, and their image points in an order that is drawn.

    ``rows`` : image, point, pixels as COLMAP counts them, height, and u, v without distortion.
    """

    def __init__(self, folder, nadir=NADIR):
        rng = np.random.default_rng(11)
        number = np.arange(IMAGES)
        is_side = number % 2
        self.folder = folder
        self.numbers = itertools.count()
        self.cameras = {
            "nadir": ExportCamera(nadir, False),
            "side": ExportCamera(SIDE, False),
        }
        self.image = np.array([f"strip_{i // 6}/{i:04d}.tif" for i in number], object)
        self.camera = np.array(["nadir", "side"], object)[is_side]
        self.lon = 8.0 + 0.03 * (number // 2)
        self.lat = 47.0 + 0.01 * is_side
        self.h = H_MSL + UNDULATION + rng.uniform(-50, 50, IMAGES)
        self.centre = ecef_of(self.lon, self.lat, self.h)
        tilt = 20.0 * is_side + rng.uniform(-2, 2, IMAGES)
        yaw = rng.uniform(0, 360, IMAGES)
        roll = rng.uniform(-2, 2, IMAGES)
        angles = np.stack([yaw, tilt, roll], axis=1)
        turned_from_down = Rotation.from_euler("zxy", angles, degrees=True)
        # From east, north, up at each station to the camera.
        self.turn = turned_from_down.as_matrix() @ DOWN

        south_west = [7.97, 46.97]
        north_east = [8.18, 47.04]
        lon, lat = rng.uniform(south_west, north_east, (POINTS, 2)).T
        height = rng.uniform(GROUND, GROUND + 200.0, POINTS)
        names = [str(7 * i + 5) if i % 3 else f"p{i}" for i in range(POINTS)]
        self.points = pd.DataFrame({"point": names, "h_g_m": height})
        places = ecef_of(lon, lat, height + UNDULATION)
        self.place = dict(zip(names, places, strict=True))

        rows = pd.concat([self.seen_in(i) for i in range(IMAGES)])
        self.rows = rows.sample(frac=1.0, random_state=11, ignore_index=True)
        images_of_point = self.rows.point.value_counts()
        self.tied = set(images_of_point.index[images_of_point > 1])

    def seen_in(self, i):
        """The points of an image."""
        camera = self.cameras[self.camera[i]].camera
        axes = enu_axes(self.lon[i], self.lat[i])
        steps = self.places(self.points.point) - self.centre[i]
        rays = steps @ axes.T @ self.turn[i].T
        u = rays[:, 0] / rays[:, 2]
        v = rays[:, 1] / rays[:, 2]
        x, y = distorted(camera, u, v)
        rows = self.points.assign(
            image=self.image[i],
            x_px=x,
            y_px=y,
            u=u,
            v=v,
        )
        is_before = rays[:, 2] > 0
        is_in_width = (x > 0) & (x < camera.width_px)
        is_in_height = (y > 0) & (y < camera.height_px)
        return rows[is_before & is_in_width & is_in_height]

    @property
    def ordered(self):
        """The rows image by image, in each in the order of the run."""
        return pd.concat([self.of_image(image) for image in self.image], ignore_index=True)

    def of_image(self, image):
        return self.rows[self.rows.image == image]

    def places(self, points):
        """(n, 3) earth-centred places of points."""
        return np.array([self.place[point] for point in points])

    def axes(self, frame):
        """(n, 3, 3) from a frame to east, north, up at each station."""
        axes = []
        for lon, lat, centre in zip(
            self.lon,
            self.lat,
            self.centre,
            strict=True,
        ):
            steps_of_1_km = 1e3 * enu_axes(lon, lat)
            ends = frame(centre + steps_of_1_km)
            axes.append((ends - frame(centre[None])) * 1e-3)
        return np.array(axes)

    def run(self, rows=None, **changes):
        """The finished run of all rows, or of others, as two files as it writes them."""
        if rows is None:
            rows = self.rows
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
        run = finished_run(
            stations,
            self.turn,
            self.cameras,
            GROUND,
            parts=(
                self.part_of(rows[:300]),
                self.part_of(rows[300:]),
            ),
        )
        return replace(run, **changes)

    def part_of(self, rows):
        path = self.folder / f"part-{next(self.numbers)}.parquet"
        columns = {
            "image": pa.array(rows.image, pa.string()),
            "point": pa.array(rows.point, pa.string()),
            "x_corrected_px": rows.x_px - 0.5,
            "y_corrected_px": rows.y_px - 0.5,
            "h_g_m": rows.h_g_m,
            "status": rows.get("status", ["ok"] * len(rows)),
        }
        pq.write_table(pa.table(columns), path)
        return path

    def with_stations(self, rows=None, **columns):
        """The run with other values of its stations."""
        run = self.run(rows)
        return replace(run, stations=replace(run.stations, **columns))

    def renamed(self, names):
        """The run with other names of the images."""
        new_names = dict(zip(self.image, names, strict=True))
        rows = self.rows.assign(image=self.rows.image.map(new_names))
        return self.with_stations(rows, image=np.array(names, object))

    def with_side_camera(self, camera, rows=None):
        side = ExportCamera(camera, False)
        return self.run(rows, cameras=self.cameras | {"side": side})
