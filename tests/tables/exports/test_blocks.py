"""Blocks for bundle adjustment, written from a block that is projected here, read by others.

Truth: PROJ for places and frames, the lens' formulas written out, pycolmap for COLMAP's files, a
real reconstruction of OpenSfM's for its conventions. Two cameras in 14 km of flight, so that the
vertical turns by 450 arcsec; pixels counted from the centre of the first; a name with a comma.
"""

from __future__ import annotations

import csv
import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pycolmap
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.errors import ConfigError, InputError, MissionError
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import empty_stations
from unbend.messages import Ledger
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.image import Exposures
from unbend.refraction.ray import rays_by
from unbend.tables.exports import FORMATS, ExportCamera, FinishedRun, find_format
from unbend.tables.exports.bingo import short_names
from unbend.tables.imports.blocks import block_rows, read_block_images, read_camera
from unbend.tables.pixels import PixelSystem
from unbend.tables.refraction_mark import refuse_marked

BERLIN = Path(__file__).resolve().parents[4] / "shared" / "ba" / "opensfm_berlin"
TO_ECEF = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
BLOCKS = ["colmap", "colmap-database", "bundler", "opensfm", "bingo"]

NADIR = Camera(
    14000,
    10600,
    20000.0,
    20010.0,
    7012.4,
    5291.7,
    BrownConrady(-0.018, 0.009, -0.002, 1.5e-4, -1e-4),
)
SIDE = Camera(9000, 12000, 15000.0, 15000.0, 4500.0, 6010.0)
H = 6000.0
GROUND = 300.0
UNDULATION = 47.5
STATIONS = [(8.0 + 0.03 * (i // 2), 47.0 + 0.01 * (i % 2)) for i in range(12)]  # 14 km to the east


def distorted(camera: Camera, u, v):
    """OpenCV's formulas."""
    k1, k2, k3, p1, p2 = camera.distortion
    r2 = u * u + v * v
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        camera.fx_px * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + camera.cx_px,
        camera.fy_px * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) + camera.cy_px,
    )


class Block:
    """Stations, points, and the image points that straight rays give."""

    def __init__(self, folder: Path, name: str = "strip_{}/{:04d}.tif") -> None:
        rng = np.random.default_rng(11)
        n = len(STATIONS)
        lon, lat = np.array(STATIONS).T
        h = np.full(n, H + UNDULATION) + rng.uniform(-50, 50, n)
        camera = np.array(["nadir", "side"] * (n // 2), object)
        tilt = np.where(camera == "side", 20.0, 0.0) + rng.uniform(-2, 2, n)
        yaw = rng.uniform(0, 360, n)
        roll = rng.uniform(-2, 2, n)
        down = np.diag([1.0, -1.0, -1.0])
        self.turn = (
            Rotation.from_euler(
                "zxy", np.stack([yaw, tilt, roll], axis=1), degrees=True
            ).as_matrix()
            @ down
        )  # from east, north, up at each station to the camera
        self.centre = np.stack(TO_ECEF.transform(lon, lat, h), axis=1)
        self.image = np.array([name.format(i // 6, i) for i in range(n)], object)
        self.camera = camera
        points = rng.uniform([7.97, 46.97], [8.18, 47.04], (400, 2))
        heights = rng.uniform(GROUND, GROUND + 200.0, 400)
        self.point = np.array([str(7 * i + 5) if i % 3 else f"p{i}" for i in range(400)], object)
        self.place = dict(
            zip(
                self.point,
                np.stack(TO_ECEF.transform(*points.T, heights + UNDULATION), axis=1),
                strict=True,
            )
        )
        self.lon, self.lat, self.h = lon, lat, h
        rows = []
        for i in range(n):
            own = NADIR if camera[i] == "nadir" else SIDE
            enu = Rotation.from_euler("ZX", [90.0 + lon[i], 90.0 - lat[i]], degrees=True).inv()
            ray = enu.apply(np.array(list(self.place.values())) - self.centre[i]) @ self.turn[i].T
            u = ray[:, 0] / ray[:, 2]
            v = ray[:, 1] / ray[:, 2]
            x, y = distorted(own, u, v)
            seen = (ray[:, 2] > 0) & (x > 0) & (x < own.width_px) & (y > 0) & (y < own.height_px)
            rows += [
                (self.image[i], self.point[p], x[p], y[p], heights[p], u[p], v[p])
                for p in np.flatnonzero(seen)
            ]
        order = rng.permutation(len(rows))
        self.rows = [rows[k] for k in order]
        self.of_image = {name: [r for r in self.rows if r[0] == name] for name in self.image}
        seen = [r[1] for r in self.rows]
        self.tied = {p for p in set(seen) if seen.count(p) > 1}
        self.parts = tuple(folder / f"part-{k}.parquet" for k in range(2))
        for k, path in enumerate(self.parts):
            pq.write_table(table_of(self.rows[k * 300 : (k + 1) * 300 if k == 0 else None]), path)

    def run(self, **changes) -> FinishedRun:
        n = len(self.image)
        air = standard_atmosphere("us1976")
        stations = replace(
            empty_stations(self.image, self.camera, "ok"),
            lat_rad=np.radians(self.lat),
            lon_rad=np.radians(self.lon),
            h_ellipsoid_m=self.h,
            h_msl_m=self.h - UNDULATION,
            sigma_horizontal_m=np.full(n, 0.03),
            sigma_height_m=np.full(n, 0.05),
            quaternion=Rotation.from_matrix(self.turn).as_quat(canonical=True, scalar_first=True),
        )
        outside = air.refractivity(stations.h_msl_m)
        exposures = Exposures(
            np.full(n, True), self.turn, stations.lat_rad, stations.h_msl_m, outside, outside
        )
        run = FinishedRun(
            "block",
            stations,
            exposures,
            constant_series(TimedProfile(None, air), n),
            (rays_by(air, "spherical"),),
            "spherical",
            {"nadir": ExportCamera(NADIR, False, 0.005), "side": ExportCamera(SIDE, False)},
            lambda _: np.full(n, GROUND),
            PixelSystem("centre"),
            self.parts,
            {"unbend.mission": "block"},
        )
        return replace(run, **changes)

    def frame(self, origin) -> pyproj.Transformer:
        """From earth-centred coordinates to east, north, up at an origin, by PROJ."""
        lat, lon, h = (repr(float(v)) for v in origin)
        return pyproj.Transformer.from_pipeline(
            f"+proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={h}"
        )


def table_of(rows, status="ok") -> pa.Table:
    """As a run writes it, pixels counted from the centre of the first."""
    columns = list(zip(*rows, strict=True))
    return pa.table(
        {
            "image": columns[0],
            "point": columns[1],
            "x_corrected_px": np.array(columns[2]) - 0.5,
            "y_corrected_px": np.array(columns[3]) - 0.5,
            "h_g_m": columns[4],
            "status": [status] * len(rows),
        }
    )


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> Block:
    return Block(tmp_path_factory.mktemp("block"))


@pytest.fixture(scope="module")
def spaced(tmp_path_factory) -> Block:
    """The same with blanks and a comma in the names of images."""
    return Block(tmp_path_factory.mktemp("spaced"), "strip {}, {:04d}.tif")


def written(run: FinishedRun, name: str, folder: Path, **values) -> tuple[Path, Ledger]:
    form = FORMATS[name]
    ledger = Ledger()
    path = folder / f"{name}{form.ending}"
    if not form.ending:
        path.mkdir()
    assert form.write(run, form.values(values), path, ledger) > 0
    return path, ledger


def origin_of(ledger: Ledger) -> list[float]:
    (what,) = [entry.what for entry in ledger if entry.code == "EXPORT-FRAME"]
    assert "neither earth curvature nor a map projection is applied" in what
    return [float(n) for n in re.findall(r"(-?[0-9.]+) (?:N|E|m above)", what)]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def in_frame(block: Block, origin, places) -> np.ndarray:
    return np.stack(block.frame(origin).transform(*np.array(places).T), axis=1)


# ---------------------------------------------------------------- COLMAP


def test_a_model_that_pycolmap_reads_loses_nothing(spaced, tmp_path):
    block = spaced
    path, ledger = written(block.run(), "colmap", tmp_path)
    model = pycolmap.Reconstruction(path)
    origin = origin_of(ledger)
    names = {int(r["id"]): r["point"] for r in read_csv(path / "points.csv")}
    assert all(not text.isdigit() for text in names.values())
    assert [model.images[i + 1].name for i in range(len(block.image))] == block.image.tolist()
    assert [model.cameras[k].model.name for k in (1, 2)] == ["FULL_OPENCV", "PINHOLE"]
    noted = {entry.code: entry for entry in ledger}
    cameras = ", ".join(f"{k} {name}" for k, name in enumerate(dict.fromkeys(block.camera), 1))
    assert noted["EXPORT-CAMERAS"].what == f"camera {cameras}"
    images = len(block.image)
    points = len({row[1] for row in block.rows})
    assert noted["EXPORT-POINTS"].count == len(block.rows)
    assert f"of {points:,} points in {images:,} images" in noted["EXPORT-POINTS"].what
    largest = 0.0
    missed = 0.0
    tied = set()
    for image in model.images.values():
        rows = block.of_image[image.name]
        given = np.array([row[2:4] for row in rows])
        here = np.array([p.xy for p in image.points2D])
        # Half a pixel there and back: 1 ulp of 14,000 px.
        largest = max(largest, np.abs(here - given).max())
        centre = in_frame(block, origin, block.centre[block.image == image.name])[0]
        np.testing.assert_allclose(image.projection_center(), centre, atol=1e-6)
        places = in_frame(block, origin, [block.place[row[1]] for row in rows])
        for point, row, place in zip(image.points2D, rows, places, strict=True):
            missed = max(missed, np.linalg.norm(image.project_point(place) - point.xy))
            assert point.has_point3D() == (row[1] in block.tied)
            if point.has_point3D():
                number = point.point3D_id
                assert names.get(number, str(number)) == row[1]
                tied.add(row[1])
                found = model.points3D[number].xyz
                np.testing.assert_allclose(found, place, atol=1e-3)
    assert largest < 2e-12, "0 px"
    # Poses and points in one frame: 1e-6 px are 0.3 micrometres on the ground.
    assert missed < 1e-6
    assert tied == block.tied
    assert [(e.code, e.count) for e in ledger if e.code == "EXPORT-SINGLE"] == [
        ("EXPORT-SINGLE", len({row[1] for row in block.rows} - block.tied))
    ]


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        (BrownConrady(), "PINHOLE"),
        (BrownConrady(k1=-0.02, p2=1e-4), "OPENCV"),
        (GeneralFrame(k1=0.02, q2=0.01, px=1e-4, py=-2e-4), "FULL_OPENCV"),
        (OpenCVFisheye(0.01, -0.002, 0.0003, 1e-5), "OPENCV_FISHEYE"),
    ],
)
def test_lenses_that_colmap_holds(block, tmp_path, distortion, model):
    """COLMAP projects as the camera does."""
    camera = replace(SIDE, distortion=distortion)
    cameras = {"nadir": ExportCamera(NADIR, False), "side": ExportCamera(camera, False)}
    path, _ = written(block.run(cameras=cameras), "colmap", tmp_path)
    theirs = pycolmap.Reconstruction(path).cameras[2]
    assert theirs.model.name == model
    u, v = np.random.default_rng(2).uniform(-0.3, 0.3, (2, 50))
    x, y = camera.project(u, v)
    np.testing.assert_allclose(
        theirs.img_from_cam(np.stack([u, v, np.ones(50)], axis=1)),
        np.stack([x, y], axis=1),
        atol=1e-8,
    )


@pytest.mark.parametrize("name", ["colmap", "colmap-database", "opensfm"])
@pytest.mark.parametrize(
    ("distortion", "word"),
    [
        (GeneralFrame(k4=0.1), "k4"),
        (GeneralFrame(skew_x=1e-4), "skew_x"),
        (GeneralFrame(k1=0.1, sense=-1.0), "sense"),
    ],
)
def test_lenses_that_a_format_cannot_hold(block, tmp_path, name, distortion, word):
    camera = ExportCamera(replace(SIDE, distortion=distortion), False)
    run = block.run(cameras={"nadir": ExportCamera(NADIR, False), "side": camera})
    with pytest.raises(MissionError, match=r"EXPORT-DISTORTION.*camera side") as caught:
        written(run, name, tmp_path)
    assert word in caught.value.what
    # Without distortion there is a way.
    path, _ = written(run, "bundler", tmp_path)
    assert (path / "bundle.out").stat().st_size > 1000


def test_opensfm_has_no_denominator(block, tmp_path):
    camera = ExportCamera(replace(SIDE, distortion=GeneralFrame(k1=0.1, q1=0.01)), False)
    run = block.run(cameras={"nadir": ExportCamera(NADIR, False), "side": camera})
    with pytest.raises(MissionError, match="EXPORT-DISTORTION"):
        written(run, "opensfm", tmp_path)


def test_a_database_that_pycolmap_reads(block, tmp_path):
    path, ledger = written(block.run(), "colmap-database", tmp_path)
    origin = origin_of(ledger)
    with closing(pycolmap.Database.open(path)) as database:
        images = {image.name: image.image_id for image in database.read_all_images()}
        assert [images[name] for name in block.image] == list(range(1, len(images) + 1))
        lost = 0.0
        for name, number in images.items():
            given = np.array([row[2:4] for row in block.of_image[name]])
            lost = max(lost, np.abs(database.read_keypoints(number)[:, :2] - given).max())
        assert 0.0 < lost <= 0.0005, "float32"
        # Matches: for every pair of images the points in both, by brute force.
        for one, other in combinations(block.image, 2):
            points = [[row[1] for row in block.of_image[name]] for name in (one, other)]
            pair = images[one], images[other]
            matches = database.read_matches(*pair)
            common = {(points[0][i], points[1][j]) for i, j in matches}
            assert common == {(p, p) for p in set(points[0]) & set(points[1])}
            assert len(matches) == len(common)
            if common:
                verified = database.read_two_view_geometry(*pair)
                np.testing.assert_array_equal(verified.inlier_matches, matches)
                assert verified.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED
        priors = database.read_all_pose_priors()
    assert len(priors) == len(images)
    frame = block.frame(origin)
    for prior in priors:
        i = prior.corr_data_id.id - 1
        centre = in_frame(block, origin, block.centre[i : i + 1])[0]
        np.testing.assert_allclose(prior.position, centre, atol=1e-6)
        assert prior.coordinate_system == pycolmap.PosePriorCoordinateSystem.CARTESIAN
        # One metre east, north and up of the station, in the frame.
        steps = np.eye(3) * 1e-6
        lat = block.lat[i]
        lon = block.lon[i]
        h = block.h[i]
        near = (
            np.array(
                [
                    frame.transform(
                        *TO_ECEF.transform(
                            lon + np.degrees(s[0]), lat + np.degrees(s[1]), h + 1e6 * s[2]
                        )
                    )
                    for s in steps
                ]
            )
            - centre
        )
        axes = near / np.linalg.norm(near, axis=1, keepdims=True)
        expected = axes.T @ np.diag([0.03**2, 0.03**2, 0.05**2]) @ axes
        np.testing.assert_allclose(prior.position_covariance, expected, atol=1e-8)
    assert max(abs(p.position_covariance[0, 2]) for p in priors) > 1e-7  # the vertical turns


def test_the_schema_is_that_of_colmap(block, tmp_path):
    path, _ = written(block.run(), "colmap-database", tmp_path)
    theirs = tmp_path / "theirs.db"
    pycolmap.Database.open(theirs).close()

    def schema(file: Path) -> list[str]:
        with closing(sqlite3.connect(file)) as database:
            found = database.execute("SELECT name, sql FROM sqlite_master WHERE sql NOT NULL")
            texts = sorted(re.sub(r"\s+", "", sql) for name, sql in found if name != "unbend")
            return [*texts, *database.execute("PRAGMA user_version").fetchone()]

    assert schema(path) == schema(theirs)


def test_a_database_adjusts_with_its_priors(block, tmp_path):
    """Poses of the model disturbed by metres come back to the stations, by the priors alone."""
    path, ledger = written(block.run(), "colmap", tmp_path)
    file, _ = written(block.run(), "colmap-database", tmp_path)
    model = pycolmap.Reconstruction(path)
    with closing(pycolmap.Database.open(file)) as database:
        priors = database.read_all_pose_priors()
    centres = in_frame(block, origin_of(ledger), block.centre)
    rng = np.random.default_rng(1)
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        pose = image.cam_from_world()
        turned = Rotation.from_rotvec(rng.normal(0, 1e-4, 3)).as_matrix() @ pose.rotation.matrix()
        centre = image.projection_center() + rng.normal(0, 0.5, 3)
        model.frames[image.frame_id].rig_from_world = pycolmap.Rigid3d(
            pycolmap.Rotation3d(turned), -turned @ centre
        )
        config.add_image(image.image_id)
    for camera in model.cameras:
        config.set_constant_cam_intrinsics(camera)
    options = pycolmap.PosePriorBundleAdjustmentOptions()
    options.alignment_ransac.max_error = 10.0
    adjuster = pycolmap.create_pose_prior_bundle_adjuster(
        pycolmap.BundleAdjustmentOptions(print_summary=False), options, config, priors, model
    )
    adjuster.solve()
    found = np.array([model.images[i + 1].projection_center() for i in range(len(centres))])
    np.testing.assert_allclose(found, centres, atol=2e-3)


@pytest.mark.parametrize("missing", ["images", "matches", "two_view_geometries"])
def test_a_database_without_a_table_of_matches_is_refused(block, tmp_path, missing):
    source = tmp_path / "source.db"
    pycolmap.Database.open(source).close()
    with closing(sqlite3.connect(source)) as database, database:
        database.execute(f"DROP TABLE {missing}")
    alone = [(i, f"{i}:{k}", *rest) for k, (i, _, *rest) in enumerate(block.rows)]
    pq.write_table(table_of(alone), tmp_path / "alone.parquet")
    run = block.run(parts=(tmp_path / "alone.parquet",), database=lambda: source)
    with pytest.raises(InputError, match="IMPORT-FORMAT") as refused:
        written(run, "colmap-database", tmp_path)
    assert refused.value.where == str(source)
    assert f"no such table: {missing}" in refused.value.what


def test_priors_without_sigma_and_wide_images(block, tmp_path):
    run = block.run()
    n = len(block.image)
    wide = replace(SIDE, width_px=60000, cx_px=55000.0)
    path, ledger = written(
        replace(
            run,
            stations=replace(run.stations, sigma_height_m=np.full(n, np.nan)),
            cameras=run.cameras | {"side": ExportCamera(wide, False)},
        ),
        "colmap-database",
        tmp_path,
    )
    with closing(pycolmap.Database.open(path)) as database:
        prior = database.read_all_pose_priors()[0]
    assert prior.has_position()
    assert not prior.has_position_cov()
    assert ("fallback", "EXPORT-NO-SIGMA", n) in [(e.kind, e.code, e.count) for e in ledger]
    assert "EXPORT-ROUNDED" not in [e.code for e in ledger]
    far = [(i, p, x + 50000.0, *rest) for i, p, x, *rest in block.rows]
    pq.write_table(table_of(far), tmp_path / "far.parquet")
    (tmp_path / "far").mkdir()
    run = replace(run, parts=(tmp_path / "far.parquet",))
    _, ledger = written(run, "colmap-database", tmp_path / "far")
    assert ("warning", "EXPORT-ROUNDED") in [(e.kind, e.code) for e in ledger]


def test_without_ties_a_database_says_so(block, tmp_path):
    """As a database of keypoints gives them, each with a name of its own."""
    alone = [(i, f"{i}:{k}", *rest) for k, (i, _, *rest) in enumerate(block.rows)]
    pq.write_table(table_of(alone), tmp_path / "alone.parquet")
    _, ledger = written(block.run(parts=(tmp_path / "alone.parquet",)), "colmap-database", tmp_path)
    assert ("loss", "EXPORT-NO-TIES") in [(e.kind, e.code) for e in ledger]


# ---------------------------------------------------------------- Bundler


def test_bundler_is_undistorted_centred_and_intersects(block, tmp_path):
    """Read by its definition: P = R X + t, p = -P / P_z, x = f p, the centre (0, 0), y up."""
    names = {old: f"{k:03d}.tif" for k, old in enumerate(block.image)}
    run = renamed(block, tmp_path, names)
    path, ledger = written(run, "bundler", tmp_path)
    origin = origin_of(ledger)
    lines = (path / "bundle.out").read_text().splitlines()
    assert lines[0] == "# Bundle file v0.3"
    images, points = map(int, lines[1].split())
    assert (path / "list.txt").read_text().split() == list(names.values())
    assert (images, points) == (len(block.image), len(block.tied))
    numbers = [np.array(line.split(), float) for line in lines[2 : 2 + 5 * images]]
    f = np.array([head[0] for head in numbers[::5]])
    assert {tuple(head[1:]) for head in numbers[::5]} == {(0.0, 0.0)}
    turn = np.array(numbers).reshape(images, 5, 3)[:, 1:4]
    centre = -np.einsum("nji,nj->ni", turn, np.array(numbers).reshape(images, 5, 3)[:, 4])
    np.testing.assert_allclose(centre, in_frame(block, origin, block.centre), atol=1e-6)
    ideal = {(row[0], round(row[5], 12), round(row[6], 12)): row[1] for row in block.rows}
    seen = set()
    off = 0.0
    missed = 0.0
    count = 0
    for head, views in zip(lines[2 + 5 * images :: 3], lines[4 + 5 * images :: 3], strict=True):
        place = np.array(head.split(), float)
        track = np.array(views.split()[1:], float)
        image = track[::4].astype(int)
        x = track[2::4]
        y = track[3::4]
        rays = np.stack([x / f[image], y / f[image], -np.ones(x.size)], axis=1)
        directions = np.einsum("nji,nj->ni", turn[image], rays)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        # The point nearest to all rays, in object space.
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        meet = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, centre[image]))
        # Which point it is: by the ideal image coordinates.
        u = x / f[image]
        v = -y / f[image]
        near = min(
            (row for row in block.of_image[block.image[image[0]]]),
            key=lambda row: np.hypot(row[5] - u[0], row[6] - v[0]),
        )
        truth = in_frame(block, origin, [block.place[near[1]]])[0]
        missed = max(missed, np.linalg.norm(meet - truth), np.linalg.norm(place - truth))
        for i, a, b in zip(image, u, v, strict=True):
            (row,) = [r for r in block.of_image[block.image[i]] if r[1] == near[1]]
            off = max(off, f[i] * np.hypot(a - row[5], b - row[6]))
        seen.add(near[1])
        count += image.size
    assert seen == block.tied
    assert off < 1e-6, "px of the undistorted"
    assert missed < 1e-3, "m"
    assert len(ideal) == len(block.rows)
    left = [e.count for e in ledger if e.code in ("EXPORT-LEFT-OUT", "EXPORT-SINGLE")]
    assert count == len(block.rows) - sum(left)
    known = json.loads((path / "calibration.json").read_text())
    assert known["side"]["images"] == [f"{k:03d}.tif" for k in range(1, images, 2)]
    assert known["nadir"]["taken_with"]["distortion"]["k1"] == -0.018
    assert known["nadir"]["taken_with"]["cx_px"] == NADIR.cx_px
    ideal_camera = {"f_px": 20000.0, "k1": 0.0, "k2": 0.0, "cx_px": 0.0, "cy_px": 0.0}
    assert known["nadir"]["written"] == ideal_camera


def renamed(block: Block, folder: Path, names: dict[str, str], points=None) -> FinishedRun:
    """The run with other names of images, and of points."""
    points = points or {}
    rows = [(names[i], points.get(p, p), *rest) for i, p, *rest in block.rows]
    pq.write_table(table_of(rows), folder / "renamed.parquet")
    run = block.run(parts=(folder / "renamed.parquet",))
    image = np.array([names[i] for i in block.image], object)
    return replace(run, stations=replace(run.stations, image=image))


# ---------------------------------------------------------------- OpenSfM


def opensfm_pixels(camera, shot, places):
    """OpenSfM's projection, normalised, as its documentation has it."""
    turn = Rotation.from_rotvec(shot["rotation"])
    x, y, z = (turn.apply(places) + np.array(shot["translation"])).T
    x = x / z
    y = y / z
    r2 = x * x + y * y
    k1, k2, k3, p1, p2 = (camera.get(name, 0.0) for name in ("k1", "k2", "k3", "p1", "p2"))
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            camera.get("focal", camera.get("focal_x"))
            * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x))
            + camera.get("c_x", 0.0),
            camera.get("focal", camera.get("focal_y"))
            * (y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y))
            + camera.get("c_y", 0.0),
        ],
        axis=1,
    )


def read_opensfm(tracks: Path, reconstruction: Path):
    """Residuals (n, 2) of each image's points, in units of its longer side."""
    lines = tracks.read_text().splitlines()
    assert lines[0] == "OPENSFM_TRACKS_VERSION_v2"
    (model,) = json.loads(reconstruction.read_text())[:1]
    for name, shot in model["shots"].items():
        rows = [line.split("\t") for line in lines[1:] if line.split("\t")[0] == name]
        rows = [row for row in rows if row[1] in model["points"]]
        places = np.array([model["points"][row[1]]["coordinates"] for row in rows])
        xy = np.array([row[3:5] for row in rows], float)
        camera = model["cameras"][shot["camera"]]
        yield name, rows, xy, opensfm_pixels(camera, shot, places) - xy, camera


OPENSFM = [Path(__file__).resolve().parents[2] / "data" / "opensfm"]
OPENSFM += [folder for folder in [BERLIN] if folder.is_dir()]


@pytest.mark.parametrize("folder", OPENSFM, ids=lambda folder: folder.name)
def test_a_reconstruction_of_opensfm_projects_as_assumed(folder):
    """The formulas above, signs and axes: half a pixel, the noise of the tie points."""
    (tracks,), (reconstruction,) = folder.glob("tracks*.csv"), folder.glob("reconstruction*.json")
    found = list(read_opensfm(tracks, reconstruction))
    residual = np.concatenate([residual * camera["width"] for *_, residual, camera in found])
    assert len(residual) > (1000 if folder == BERLIN else 80)
    assert np.median(np.abs(residual)) < 0.5


def test_opensfm_keeps_nine_digits_and_names(block, tmp_path):
    path, ledger = written(block.run(), "opensfm", tmp_path)
    reference = json.loads((path / "reference_lla.json").read_text())
    origin = [reference[key] for key in ("latitude", "longitude", "altitude")]
    assert origin == pytest.approx(origin_of(ledger), abs=1e-7)
    cameras = json.loads((path / "camera_models.json").read_text())
    names = {row["id"]: row["point"] for row in read_csv(path / "points.csv")}
    found = list(read_opensfm(path / "tracks.csv", path / "reconstruction.json"))
    assert [name for name, *_ in found] == block.image.tolist()
    missed = lost = 0.0
    for name, rows, xy, residual, camera in found:
        assert (
            cameras[
                json.loads((path / "reconstruction.json").read_text())[0]["shots"][name]["camera"]
            ]
            == camera
        )
        size = np.array([camera["width"], camera["height"]])
        given = {row[1]: row[2:4] for row in block.of_image[name]}
        # A pixel (0, 0) of OpenSfM's is the centre of the first: denormalised, and half a pixel.
        theirs = xy * size.max() + 0.5 * size - 0.5
        points = [names.get(row[1], row[1]) for row in rows]
        expected = np.array([given[point] for point in points]) - 0.5
        lost = max(lost, np.abs(theirs - expected).max())
        missed = max(missed, np.abs(residual * size.max()).max())
        assert set(points) == set(given) & block.tied
    assert lost <= 1e-5
    assert missed < 0.01, "px: the points are intersected to a millimetre"
    text = (path / "tracks.csv").read_text().splitlines()[1:]
    assert len(text) == len(block.rows)
    assert all(len(n.split(".")[1]) == 9 for line in text for n in line.split("\t")[3:5])
    shot = json.loads((path / "reconstruction.json").read_text())[0]["shots"][block.image[3]]
    centre = in_frame(block, origin, block.centre[3:4])[0]
    np.testing.assert_allclose(shot["gps_position"], centre, atol=1e-6)
    assert shot["gps_dop"] == pytest.approx(0.03, rel=1e-6)


# ---------------------------------------------------------------- BINGO


def read_bingo(path: Path) -> dict[str, tuple[str, dict[str, tuple[float, float]]]]:
    images = {}
    lines = iter(path.read_text().splitlines())
    for line in lines:
        image, camera = line.split()
        points = {}
        for point in lines:
            if point == "-99":
                break
            name, x, y = point.split()
            points[name] = float(x), float(y)
        images[image] = camera, points
    return images


def test_bingo_counts_millimetres_from_the_centre(spaced, tmp_path):
    block = spaced
    path, ledger = written(block.run(), "bingo", tmp_path, pixel_um=4.0)
    images = read_bingo(path / "image.dat")
    rows = read_csv(path / "names.csv")
    names = {(row["kind"], row["written"]): row["name"] for row in rows}
    assert all(len(name) <= 15 for image in images for name in (image, *images[image][1]))
    assert {names[("image", image)] for image in images} == set(block.image)
    for image, (camera, points) in images.items():
        own = {"nadir": NADIR, "side": SIDE}[camera]
        assert len(points) == len(block.of_image[names[("image", image)]])
        for _, point, x, y, *_ in block.of_image[names[("image", image)]]:
            expected = (x - 0.5 * own.width_px) * 0.004, (0.5 * own.height_px - y) * 0.004
            assert points[point] == pytest.approx(expected, abs=6e-8)
    assert "switch off the corrections of refraction" in FORMATS["bingo"].use
    assert origin_of(ledger)


def test_quarter_turns(block, tmp_path):
    """A point in the upper right of the image, its axes turned counter-clockwise, by hand."""
    first = read_bingo(written(block.run(), "bingo", tmp_path, pixel_um=4.0)[0] / "image.dat")
    image, (_, points) = next(iter(first.items()))
    point, (x, y) = next(iter(points.items()))
    for turns, expected in enumerate([(x, y), (y, -x), (-x, -y), (-y, x)]):
        folder = tmp_path / str(turns)
        folder.mkdir()
        path, _ = written(block.run(), "bingo", folder, pixel_um=4.0, quarter_turns=turns)
        assert read_bingo(path / "image.dat")[image][1][point] == pytest.approx(expected, abs=1e-9)


def test_the_size_of_pixels_must_be_known(block, tmp_path):
    with pytest.raises(ConfigError, match=r"EXPORT-OPTION.*camera side"):
        written(block.run(), "bingo", tmp_path)
    run = block.run()
    both = {name: replace(camera, pixel_mm=0.005) for name, camera in run.cameras.items()}
    (tmp_path / "known").mkdir()
    path, _ = written(replace(run, cameras=both), "bingo", tmp_path / "known")
    row = block.of_image[block.image[0]][0]
    x, _ = read_bingo(path / "image.dat")[block.image[0][-15:].replace(" ", "_")][1][row[1]]
    assert x == pytest.approx((row[2] - 7000.0) * 0.005, abs=6e-8)


def test_names_that_become_the_same_are_refused(block, tmp_path):
    with pytest.raises(MissionError, match="EXPORT-NAMES") as caught:
        short_names(["a/strip/DSC_00012345.tif", "b/strip/DSC_00012345.tif"], "images")
    assert "'a/strip/DSC_00012345.tif' and 'b/strip/DSC_00012345.tif'" in caught.value.what
    assert short_names(["strip 7", "strip\t8"], "images") == ["strip_7", "strip_8"]


@pytest.mark.parametrize(("name", "image"), [("bundler", "a b.tif"), ("opensfm", "a\tb.tif")])
def test_names_that_columns_would_break_at_are_refused(block, tmp_path, name, image):
    names = {old: f"{k}.tif" for k, old in enumerate(block.image)}
    run = renamed(block, tmp_path, names | {block.image[2]: image})
    with pytest.raises(MissionError, match="EXPORT-NAMES"):
        written(run, name, tmp_path)


# ---------------------------------------------------------------- there and back


LARGEST = {"colmap": 2e-12, "colmap-database": 5e-4, "opensfm": 1e-5}
"""Pixels: of a model half a pixel and back, of a database float32, of OpenSfM nine decimals."""


@pytest.mark.parametrize("name", LARGEST)
def test_there_and_back(block, tmp_path, name):
    """Read by the imports: numbers, names, places, angles and cameras survive."""
    path, ledger = written(block.run(), name, tmp_path)
    program = name.partition("-")[0]
    names = {}
    if name != "colmap-database":
        names = {row["id"]: row["point"] for row in read_csv(path / "points.csv")}
    table = pa.Table.from_batches(block_rows(path, program)).to_pandas()
    assert len(table) == len(block.rows)
    largest = 0.0
    for image, rows in table.groupby("image"):
        given = block.of_image[image]
        here = rows[["x_px", "y_px"]].to_numpy()
        largest = max(largest, np.abs(here - np.array([row[2:4] for row in given])).max())
        for point, row in zip(rows["point"], given, strict=True):
            if name == "opensfm" or (name == "colmap" and row[1] in block.tied):
                assert names.get(point, point) == row[1]
    assert largest <= LARGEST[name]
    if name != "colmap-database":  # which has no orientations
        found = read_block_images(path, program)
        order = [list(found.image).index(image) for image in block.image]
        centre = in_frame(block, origin_of(ledger), block.centre)
        np.testing.assert_allclose(found.position[order], centre, atol=1e-6)
        to_frame = block.frame(origin_of(ledger))
        for i, turn in zip(order, block.turn, strict=True):
            # What lies 1 km before the camera, in the frame and in the image.
            own = turn.T @ [0.1, -0.2, 1.0]
            enu = Rotation.from_euler(
                "ZX", [90.0 + block.lon[i], 90.0 - block.lat[i]], degrees=True
            )
            ahead = np.array(to_frame.transform(*(block.centre[i] + 1e3 * enu.apply(own))))
            seen = matrices_of(found.angles[order])[i] @ (ahead - centre[i]) * 1e-3
            np.testing.assert_allclose(seen, [0.1, -0.2, 1.0], atol=1e-8)
    file, number = (path / "camera_models.json", "nadir") if name == "opensfm" else (path, "1")
    camera = read_camera(file, program, number)
    u, v = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, -0.25]])
    np.testing.assert_allclose(camera.project(u, v), distorted(NADIR, u, v), atol=1e-8)


# ---------------------------------------------------------------- what is left out, and refused


@pytest.mark.parametrize("name", BLOCKS)
def test_what_is_not_ok_is_left_out_and_counted(block, tmp_path, name):
    names = {old: f"{k:03d}.tif" for k, old in enumerate(block.image)}
    good = [(names[i], *rest) for i, *rest in block.rows]
    flagged = table_of(good[:7], "beyond_grazing")
    again = table_of([(good[20][0], good[20][1], 1.0, 2.0, *good[20][4:])])
    unnamed = table_of(good[7:9]).set_column(1, "point", pa.array([None, None], pa.string()))
    path = tmp_path / "some.parquet"
    pq.write_table(pa.concat_tables([table_of(good[9:]), flagged, again, unnamed]), path)
    run = renamed(block, tmp_path, names)
    status = run.stations.status.copy()
    status[4] = "in_gap"
    run = replace(run, parts=(path,), stations=replace(run.stations, status=status))
    values = {"pixel_um": 4.0} if name == "bingo" else {}
    form = FORMATS[name]
    ledger = Ledger()
    out = tmp_path / f"out{form.ending}"
    if not form.ending:
        out.mkdir()
    count = form.write(run, form.values(values), out, ledger)
    of_station = sum(row[0] == names[block.image[4]] for row in good[9:])
    losses = {
        re.split(" are left out|, the", e.what)[0]: e.count for e in ledger if e.kind == "loss"
    }
    without = "without a usable position, attitude and ellipsoidal height"
    assert losses.pop(f"left out: 1 station {without}") == 1
    left = 7 + 1 + 2 + of_station
    total = len(good) + 1
    assert losses.pop(f"{left} of {total} observations") == left
    assert losses == {}
    not_written = sum(e.count for e in ledger if "not written" in e.what)
    assert count == total - left - not_written
    assert bool(not_written) == (name in ("bundler", "blocksexchange"))
    if name == "colmap":
        (image,) = [
            image
            for image in pycolmap.Reconstruction(out).images.values()
            if image.name == good[20][0]
        ]
        places = [tuple(point.xy) for point in image.points2D]
        assert (1.0, 2.0) not in places, "the second measurement of a point"


def test_points_that_cannot_be_undistorted_are_a_loss(block, tmp_path):
    """The distortion turns back within the image; what is beyond has no ideal coordinates."""
    run = block.run()
    turning = replace(NADIR, distortion=BrownConrady(k1=-4.0))
    cameras = {name: replace(camera, camera=turning) for name, camera in run.cameras.items()}
    ledger = Ledger()
    count = FORMATS["bundler"].write(replace(run, cameras=cameras), {}, tmp_path, ledger)
    (single,) = [e.count for e in ledger if e.code == "EXPORT-SINGLE"]
    (beyond,) = [e.count for e in ledger if e.code == "EXPORT-LEFT-OUT"]
    assert count == len(block.rows) - single - beyond
    assert 0 < beyond < len(block.rows)


@pytest.mark.parametrize("name", BLOCKS)
def test_a_run_without_places_and_a_camera_without_calibration(block, tmp_path, name):
    run = block.run()
    n = len(block.image)
    lost = replace(run, stations=replace(run.stations, h_ellipsoid_m=np.full(n, np.nan)))
    with pytest.raises(MissionError, match="EXPORT-NO-STATIONS"):
        written(lost, name, tmp_path)
    (tmp_path / "other").mkdir()
    alone = replace(run, cameras={"nadir": run.cameras["nadir"]})
    with pytest.raises(MissionError, match=r"EXPORT-CAMERA.*'side'"):
        written(alone, name, tmp_path / "other")


def test_points_whose_rays_do_not_meet_lie_on_the_ground(block, tmp_path):
    """Two images of one place: the point is where its ray reaches the height that was taken."""
    run = block.run()
    image = block.image[0]
    rows = block.of_image[image]
    stations = run.stations.rows(np.array([0, 0]))
    stations = replace(stations, image=np.array([image, "twin"], object))
    both = table_of([*rows, *[("twin", *row[1:]) for row in rows]])
    pq.write_table(both, tmp_path / "twins.parquet")
    path, ledger = written(
        replace(run, stations=stations, parts=(tmp_path / "twins.parquet",)), "colmap", tmp_path
    )
    assert ("fallback", "EXPORT-POINT-HEIGHT", len(rows)) in [
        (e.kind, e.code, e.count) for e in ledger
    ]
    model = pycolmap.Reconstruction(path)
    origin = origin_of(ledger)
    names = {int(r["id"]): r["point"] for r in read_csv(path / "points.csv")}
    for number, point in model.points3D.items():
        truth = in_frame(block, origin, [block.place[names.get(number, str(number))]])[0]
        # A sphere for the ellipsoid, over 3 km.
        np.testing.assert_allclose(point.xyz, truth, atol=0.02)


def test_a_folder_is_no_file():
    assert find_format("colmap", Path("model")).name == "colmap"
    assert find_format("colmap", Path("model.v2")).ending == ""
    with pytest.raises(ConfigError, match=r"EXPORT-ENDING.*a folder"):
        find_format("bundler", Path("out.csv"))
    with pytest.raises(ConfigError, match=r"EXPORT-ENDING.*a file that ends in \.db"):
        find_format("colmap-database", Path("model"))


# ---------------------------------------------------------------- the command


@pytest.mark.parametrize("name", BLOCKS)
def test_from_the_command_line_with_its_mark(unbend, baseline, tmp_path, name):
    form = FORMATS[name]
    out = tmp_path / f"out{form.ending}"
    more = ["--pixel-um", 5] if name == "bingo" else []
    ended = unbend("export", baseline.output, "--format", name, "--out", out, *more)
    text = " ".join(ended.text.split())
    assert ended.code == (3 if "EXPORT-LEFT-OUT" in text else 0), text
    assert "neither earth curvature nor a map projection is applied" in text
    assert form.use in text
    rows = baseline.results().to_pandas()
    points = rows["point"].nunique()
    assert f"{len(rows)} observations of {points} points in " in text
    assert ("camera 1 nadir, 2 oblique" in text) == name.startswith("colmap")
    marked = [out / file for file in form.marked]
    sidecar = marked[0].with_name(marked[0].name + ".unbend.json")
    content = json.loads(sidecar.read_text())
    assert [item["name"] for item in content["files"]] == [file.name for file in marked]
    assert form.use in content["notes"]
    assert any("neither earth curvature" in note for note in content["notes"])
    assert not list(tmp_path.glob(".*")), "a draft"
    again = unbend("export", baseline.output, "--format", name, "--out", out, "--force", *more)
    assert ("EXPORT-EXISTS" in again.err) == (form.ending == "")
    for file in marked:
        with pytest.raises(InputError, match="OBS-ALREADY-CORRECTED"):
            refuse_marked(file)


@pytest.mark.parametrize("name", ["colmap", "colmap-database", "opensfm"])
def test_run_refuses_what_was_exported(unbend, baseline, mission, tmp_path, name):
    """By the imports of blocks, a folder under another name too."""
    out = tmp_path / f"out{FORMATS[name].ending}"
    unbend("export", baseline.output, "--format", name, "--out", out)
    if out.is_dir():
        out = out.rename(tmp_path / "measured")
    mission.config["observations"] = {"path": str(out), "format": name.partition("-")[0]}
    for command in ("run", "check"):
        ended = unbend(command, mission.save())
        assert "OBS-ALREADY-CORRECTED" in ended.err, ended.text
        assert ended.code == 6
