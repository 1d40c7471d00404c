"""A small block with known truth, written as other programs write it.

Everything is computed here, by plain formulas: stations above one place, a camera at each that
looks down, object points, and their pixels by a pinhole with Brown's distortion. A test compares
what the program reads with `SmallBlock`, in which each attitude is against the station's own
vertical.
"""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

A = 6378137.0
E2 = 0.00669437999014
WIDTH = 6000
HEIGHT = 4000
FOCAL = 5000.0
CX = 3011.5
CY = 1992.25
DISTORTION = {"k1": -0.021, "k2": 0.008, "k3": -0.001, "p1": 0.0004, "p2": -0.0003}


def ecef(lat_deg, lon_deg, h, *, a: float = A, e2: float = E2) -> np.ndarray:
    """(n, 3) earth-centred coordinates, written out here."""
    lat = np.radians(lat_deg)
    lon = np.radians(lon_deg)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    x = (n + h) * np.cos(lat) * np.cos(lon)
    y = (n + h) * np.cos(lat) * np.sin(lon)
    z = (n * (1 - e2) + h) * np.sin(lat)
    return np.stack([x, y, z], axis=-1)


def enu_axes(lat_deg: float, lon_deg: float) -> np.ndarray:
    """(3, 3) rows east, north, up at a place, in earth-centred coordinates."""
    lat = np.radians(lat_deg)
    lon = np.radians(lon_deg)
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, north, up])


def pixels(cam: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of points in the axes of a camera, upper left corner (0, 0)."""
    x = cam[:, 0] / cam[:, 2]
    y = cam[:, 1] / cam[:, 2]
    r2 = x * x + y * y
    d = DISTORTION
    radial = 1 + d["k1"] * r2 + d["k2"] * r2**2 + d["k3"] * r2**3
    x_d = x * radial + 2 * d["p1"] * x * y + d["p2"] * (r2 + 2 * x * x)
    y_d = y * radial + d["p1"] * (r2 + 2 * y * y) + 2 * d["p2"] * x * y
    return np.stack([CX + FOCAL * x_d, CY + FOCAL * y_d], axis=1)


@dataclass
class SmallBlock:
    """Stations (n,) with attitudes cam_from_enu (n, 3, 3) against their own verticals, points."""

    lat: np.ndarray
    lon: np.ndarray
    h: np.ndarray
    cam_from_enu: np.ndarray
    point_lat: np.ndarray
    point_lon: np.ndarray
    point_h: np.ndarray
    observations: pd.DataFrame
    names: list[str]
    origin: tuple[float, float, float]

    @classmethod
    def make(cls, lat0: float = 46.95, lon0: float = 7.45, *, spacing_m: float = 300.0):
        """Twelve images in three lines 1.5 km above 60 points."""
        draw = np.random.default_rng(5)
        line, place = np.divmod(np.arange(12), 4)
        degree_m = np.radians(1.0) * A
        lat = lat0 + (line - 1.0) * spacing_m / degree_m
        lon = lon0 + (place - 1.5) * spacing_m / (degree_m * np.cos(np.radians(lat0)))
        h = 2000.0 + draw.normal(0.0, 8.0, 12)
        down = np.diag([1.0, -1.0, -1.0])  # x east, y south, z down
        tilts = draw.normal(0.0, 2.0, (12, 3)) + np.array([0.0, 0.0, 90.0])
        tilts[4:8, 2] += 180.0  # the aircraft comes back
        turns = Rotation.from_euler("xyz", tilts, degrees=True).as_matrix()
        cam_from_enu = down @ turns.transpose(0, 2, 1)
        point_lat = lat0 + draw.uniform(-900, 900, 60) / degree_m
        point_lon = lon0 + draw.uniform(-900, 900, 60) / (degree_m * np.cos(np.radians(lat0)))
        point_h = 500.0 + draw.uniform(0.0, 60.0, 60)
        names = [f"IMG_{k:04d}.JPG" for k in range(1, 13)]
        block = cls(lat, lon, h, cam_from_enu, point_lat, point_lon, point_h,
                    pd.DataFrame(), names, (lat0, lon0, 0.0))  # fmt: skip
        block.observations = block.observed()
        return block

    def cam_from_ecef(self) -> np.ndarray:
        axes = [enu_axes(*place) for place in zip(self.lat, self.lon, strict=True)]
        return self.cam_from_enu @ np.array(axes)

    def observed(self) -> pd.DataFrame:
        places = ecef(self.point_lat, self.point_lon, self.point_h)
        rows = []
        for name, centre, turn in zip(
            self.names, ecef(self.lat, self.lon, self.h), self.cam_from_ecef(), strict=True
        ):
            cam = (places - centre) @ turn.T
            uv = pixels(cam)
            inside = (uv > 0).all(axis=1) & (uv < [WIDTH, HEIGHT]).all(axis=1)
            for k in np.flatnonzero(inside):
                rows.append((name, f"{k + 1}", *uv[k]))
        return pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])

    def in_enu(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres (n, 3), rotations to the camera (n, 3, 3), and points (p, 3), at the origin."""
        axes = enu_axes(*self.origin[:2])
        zero = ecef(*self.origin)
        centres = (ecef(self.lat, self.lon, self.h) - zero) @ axes.T
        points = (ecef(self.point_lat, self.point_lon, self.point_h) - zero) @ axes.T
        return centres, self.cam_from_ecef() @ axes.T, points

    def table(self) -> dict[str, tuple]:
        """Latitude, longitude, height and cam_from_enu by image."""
        values = zip(self.lat, self.lon, self.h, self.cam_from_enu, strict=True)
        return dict(zip(self.names, values, strict=True))

    def write_colmap(self, folder: Path, *, scale=1.0, turn=None) -> None:
        """A sparse model as text, in ``scale`` * (``turn`` applied to east, north, up)."""
        turn = np.eye(3) if turn is None else turn
        centres, rotations, points = self.in_enu()
        centres = scale * centres @ turn.T
        points = scale * points @ turn.T
        rotations = rotations @ turn.T
        folder.mkdir(parents=True, exist_ok=True)
        coefficients = " ".join(str(DISTORTION[k]) for k in ("k1", "k2", "p1", "p2", "k3"))
        (folder / "cameras.txt").write_text(
            f"1 FULL_OPENCV {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {CX} {CY} {coefficients} 0 0 0\n"
        )
        lines = []
        tracks = {k + 1: "" for k in range(len(points))}
        for number, name in enumerate(self.names):
            x, y, z, w = Rotation.from_matrix(rotations[number]).as_quat()
            step = -rotations[number] @ centres[number]
            lines.append(f"{number + 1} {w} {x} {y} {z} {step[0]} {step[1]} {step[2]} 1 {name}")
            rows = self.observations[self.observations["image"] == name]
            lines.append(" ".join(f"{r.x_px} {r.y_px} {r.point}" for r in rows.itertuples()))
            for k, point in enumerate(rows["point"]):
                tracks[int(point)] += f" {number + 1} {k}"
        (folder / "images.txt").write_text("\n".join(lines) + "\n")
        rows = []
        for number, (x, y, z) in enumerate(points, 1):
            if tracks[number]:
                rows.append(f"{number} {x} {y} {z} 0 0 0 -1{tracks[number]}")
        (folder / "points3D.txt").write_text("\n".join(rows) + "\n")

    def write_colmap_database(self, path: Path, *, known: np.ndarray | None, system: int = 0):
        """A database with keypoints and pose priors ``known`` (n, 3), of COLMAP 3.9's tables."""
        with sqlite3.connect(path) as base:
            base.executescript(
                "CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER,"
                " height INTEGER, params BLOB, prior_focal_length INTEGER);"
                "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER);"
                "CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER,"
                " data BLOB);"
                "CREATE TABLE matches (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER,"
                " data BLOB);"
                "CREATE TABLE pose_priors (image_id INTEGER PRIMARY KEY, position BLOB,"
                " coordinate_system INTEGER, position_covariance BLOB);"
            )
            coefficients = [DISTORTION[k] for k in ("k1", "k2", "p1", "p2", "k3")]
            params = np.array([FOCAL, FOCAL, CX, CY, *coefficients, 0, 0, 0])
            base.execute(
                "INSERT INTO cameras VALUES (1, 6, ?, ?, ?, 1)", (WIDTH, HEIGHT, params.tobytes())
            )
            for number, name in enumerate(self.names, 1):
                base.execute("INSERT INTO images VALUES (?, ?, 1)", (number, name))
                rows = self.observations[self.observations["image"] == name]
                xy = rows[["x_px", "y_px"]].to_numpy(np.float32)
                base.execute(
                    "INSERT INTO keypoints VALUES (?, ?, 2, ?)", (number, len(xy), xy.tobytes())
                )
                if known is not None:
                    prior = (number, known[number - 1].astype(float).tobytes(), system)
                    base.execute("INSERT INTO pose_priors VALUES (?, ?, ?, NULL)", prior)

    def write_opensfm(self, folder: Path, *, name: str = "reconstruction.json", linear=None):
        """A project; ``linear`` (3, 4) is ODM's transformation from east, north, up, if any."""
        centres, rotations, points = self.in_enu()
        known = centres + np.random.default_rng(2).normal(0.0, 0.5, centres.shape)
        if linear is not None:
            centres = centres @ linear[:, :3].T + linear[:, 3]
            points = points @ linear[:, :3].T + linear[:, 3]
            # As OpenSfM does it: R inv(A), of which Rodrigues takes the nearest rotation.
            u, _, vt = np.linalg.svd(rotations @ np.linalg.inv(linear[:, :3]))
            rotations = u @ vt
        size = max(WIDTH, HEIGHT)
        camera = {
            "projection_type": "brown", "width": WIDTH, "height": HEIGHT,
            "focal_x": FOCAL / size, "focal_y": FOCAL / size,
            "c_x": (CX - WIDTH / 2) / size, "c_y": (CY - HEIGHT / 2) / size, **DISTORTION,
        }  # fmt: skip
        shots = {}
        for k, image in enumerate(self.names):
            shots[image] = {
                "rotation": Rotation.from_matrix(rotations[k]).as_rotvec().tolist(),
                "translation": (-rotations[k] @ centres[k]).tolist(),
                "camera": "c",
                "gps_position": known[k].tolist(),
                "gps_dop": 5.0,
            }
        coordinates = {
            str(k): {"coordinates": place.tolist()} for k, place in enumerate(points, 1)
        }
        content = [{"cameras": {"c": camera}, "shots": shots, "points": coordinates}]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(content))
        lat, lon, h = self.origin
        reference = {"latitude": lat, "longitude": lon, "altitude": h}
        (folder / "reference_lla.json").write_text(json.dumps(reference))
        rows = ["OPENSFM_TRACKS_VERSION_v2"]
        for k, r in enumerate(self.observations.itertuples()):
            x = (r.x_px - WIDTH / 2) / size
            y = (r.y_px - HEIGHT / 2) / size
            rows.append(f"{r.image}\t{r.point}\t{k}\t{x!r}\t{y!r}\t0.001\t0\t0\t0\t-1\t-1")
        (folder / "tracks.csv").write_text("\n".join(rows) + "\n")

    def write_metashape(
        self, path: Path, *, reference: str, shift=(0.0, 0.0, 0.0), known=None, chunk_scale=23.0,
        head: SmallRig | None = None,
    ) -> None:  # fmt: skip
        """An exported document; the chunk is earth-centred, moved by ``shift``, turned and scaled.

        Slave cameras of a rig have their place in the master's axes, in the chunk's units.
        """
        chunk_turn = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True).as_matrix()
        middle = ecef(*self.origin) + shift
        centres = ecef(self.lat, self.lon, self.h) + shift
        cameras = []
        markers: dict[str, list[str]] = {}
        for k, name in enumerate(self.names):
            pose = np.eye(4)
            pose[:3, :3] = chunk_turn.T @ self.cam_from_ecef()[k].T
            pose[:3, 3] = chunk_turn.T @ (centres[k] - middle) / chunk_scale
            given = ""
            if known is not None:
                x, y, z = known[k].tolist()
                given = f'<reference x="{x!r}" y="{y!r}" z="{z!r}" enabled="true"/>'
            cameras.append(
                f'<camera id="{k}" sensor_id="0" component_id="0" label="{name}">'
                f"<transform>{text_of(pose)}</transform>{given}</camera>"
            )
            if head is not None:
                cameras.append(
                    f'<camera id="{100 + k}" sensor_id="1" master_id="{k}" component_id="0" '
                    f'label="{head.prefix}{name}"></camera>'
                )
            for r in self.observations[self.observations["image"] == name].itertuples():
                place = f'<location camera_id="{k}" pinned="true" x="{r.x_px!r}" y="{r.y_px!r}"/>'
                markers.setdefault(r.point, []).append(place)
        d = DISTORTION
        calibration = (
            f'<resolution width="{WIDTH}" height="{HEIGHT}"/><calibration type="frame" '
            f'class="adjusted"><resolution width="{WIDTH}" height="{HEIGHT}"/><f>{FOCAL}</f>'
            f"<cx>{CX - WIDTH / 2}</cx><cy>{CY - HEIGHT / 2}</cy><k1>{d['k1']}</k1><k2>{d['k2']}"
            f"</k2><k3>{d['k3']}</k3><p1>{d['p2']}</p1><p2>{d['p1']}</p2></calibration>"
        )
        sensors = f'<sensor id="0" label="c" type="frame">{calibration}</sensor>'
        if head is not None:
            step = " ".join(repr(v) for v in (np.asarray(head.place_m) / chunk_scale).tolist())
            sensors += (
                f'<sensor id="1" label="head" type="frame" master_id="0">{calibration}'
                f'<rotation locked="false">{text_of(head.master_from_head)}</rotation>'
                f'<translation locked="false">{step}</translation></sensor>'
            )
        labels = "".join(f'<marker id="{k}" label="{k}"/>' for k in markers)
        places = "".join(
            f'<marker marker_id="{k}">{"".join(found)}</marker>' for k, found in markers.items()
        )
        path.write_text(
            f'<document version="2.0.0"><chunk label="1" enabled="true"><sensors>{sensors}'
            '</sensors><components><component id="0"><transform><rotation locked="false">'
            f"{text_of(chunk_turn)}</rotation><translation>{text_of(middle)}</translation>"
            f"<scale>{chunk_scale}</scale></transform></component></components>"
            f"<cameras>{''.join(cameras)}</cameras><markers>{labels}</markers>"
            f'<frames><frame id="0"><markers>{places}</markers></frame></frames>'
            f"<reference>{reference}</reference></chunk></document>"
        )


@dataclass
class SmallRig:
    """A second head: its place in the master's axes [m], and how it turns to these."""

    prefix: str
    place_m: tuple[float, float, float]
    master_from_head: np.ndarray


def text_of(values: np.ndarray) -> str:
    """The numbers of an array, one behind the other."""
    return " ".join(repr(value) for value in np.ravel(values).tolist())


def largest_difference(stations: pd.DataFrame, block: SmallBlock) -> tuple[float, float]:
    """Of positions [m] and attitudes [deg] of the stations of a run from the truth."""
    away = []
    turned = []
    truth = block.table()
    for row in stations.itertuples():
        lat, lon, h, wanted = truth[row.image]
        here = ecef(row.lat_deg, row.lon_deg, row.h_ellipsoid_m)
        away.append(np.linalg.norm(here - ecef(lat, lon, h)))
        found = Rotation.from_quat([row.q_x, row.q_y, row.q_z, row.q_w]).as_matrix()
        cosine = (np.trace(found @ wanted.T) - 1) / 2
        turned.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return max(away), max(turned)
