"""What it is all for: the sample flight adjusted by docs/pages/guide/pycolmap.md, and by COLMAP."""

import json
import re
import shutil
import sqlite3
from contextlib import closing
from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from tests.logs import REPOSITORY
from unbend.batch.finished_run.export import export_run

from .conftest import read_observations, run_sample

pytest.importorskip("pycolmap")
pytest.importorskip("pyproj")

import pycolmap
import pyproj

PAGE = REPOSITORY / "docs" / "pages" / "guide" / "pycolmap.md"
(RECIPE,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S)


@pytest.fixture
def beside_results(runs, tmp_path, monkeypatch):
    """A folder as it looks after `make sample`."""
    shutil.copytree(runs["bin"].output, tmp_path / "results" / "sample_bin")
    logs = tmp_path / "sample_logs"
    logs.mkdir()
    shutil.copy(REPOSITORY / "sample_logs" / "observations.parquet", logs)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def execute(code):
    names = {}
    exec(compile(code, PAGE.name, "exec"), names)
    return names


def height_error(code, truth: dict[str, pd.DataFrame]):
    """RMS error in height [m] of the points that the page's adjustment finds."""
    names = execute(code)
    points = names["points"]
    true = truth["points"].set_index("point").loc[list(points)]
    geographic = true["lon_deg"], true["lat_deg"], true["h_ellipsoid_m"]
    ecef = np.column_stack(names["ecef"].transform(*geographic))
    enu = names["enu"](names["lat0"], names["lon0"])
    expected = enu.apply(ecef - names["origin"])
    error = np.array(list(points.values())) - expected
    assert len(error) > 500
    return np.sqrt(np.mean(error[:, 2] ** 2))


def test_the_page_shows_what_the_correction_is_worth(beside_results, truth):
    """Stations as the log has them; measured 0.027 and 0.136 m."""
    code = RECIPE.replace("flown/results/simulated_bin", "results/sample_bin")
    code = code.replace("flown/observations.parquet", "sample_logs/observations.parquet")
    corrected = '"x_corrected_px", "y_corrected_px"'
    assert code.count(corrected) == 1
    uncorrected = code.replace(corrected, '"x_px", "y_px"')
    # The shift with the wrong sign: as far off on the other side.
    turned = code.replace("\n\n\ndef enu", f"{TURN}\n\n\ndef enu")
    assert turned != code

    without = height_error(uncorrected, truth)

    assert height_error(code, truth) <= 0.03
    assert without >= 0.13
    assert height_error(turned, truth) > 1.5 * without


TURN = """
observations[x] = 2 * observations.x_px - observations[x]
observations[y] = 2 * observations.y_px - observations[y]"""


def write_source(path, rows, cameras: dict[str, list[float]]):
    """A database as COLMAP leaves it: matches, and geometries whose matrices are a nonsense."""
    with closing(pycolmap.Database.open(path)) as database:
        camera_ids = {}
        for name, params in cameras.items():
            camera = pycolmap.Camera(
                width=14000,
                height=10600,
                model="FULL_OPENCV",
                has_prior_focal_length=True,
                params=params,
            )
            camera_ids[name] = database.write_camera(camera)
        keypoints = {}
        for name, rows_of_image in rows.groupby("image"):
            image = pycolmap.Image(name=name, camera_id=camera_ids[name.split("_")[0]])
            image_id = database.write_image(image)
            pixels = rows_of_image[["x_px", "y_px"]].to_numpy(np.float32)
            database.write_keypoints(image_id, pixels)
            keypoints[image_id] = {point: k for k, point in enumerate(rows_of_image["point"])}
        for first, other in combinations(keypoints, 2):
            shared = [point for point in keypoints[first] if point in keypoints[other]]
            if shared:
                pairs = [(keypoints[first][point], keypoints[other][point]) for point in shared]
                matches = np.array(pairs, np.uint32)
                verified = pycolmap.TwoViewGeometry()
                verified.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                verified.E = verified.F = verified.H = np.diag([1.0, 2.0, 3.0])
                verified.inlier_matches = matches
                database.write_matches(first, other, matches)
                database.write_two_view_geometry(first, other, verified)


def restore_measured_keypoints(path, rows):
    """What the keypoints of an exported database were before, by the rows of the run."""
    with closing(sqlite3.connect(path)) as database, database:
        (matrices,) = database.execute(
            "SELECT COUNT(*) FROM two_view_geometries WHERE coalesce(F, E, H) NOT NULL"
        ).fetchone()
        assert matrices == 0
        for number, name in database.execute("SELECT image_id, name FROM images").fetchall():
            pixels = rows.loc[rows["image"] == name, ["x_px", "y_px"]]
            data = pixels.to_numpy("<f4").tobytes()
            database.execute("UPDATE keypoints SET data = ? WHERE image_id = ?", (data, number))


def true_heights(notes, points):
    """Up [m] by point in the frame that the notes of an exported database tell."""
    origin = re.search(r"from (\S+) N, (\S+) E, (\S+) m above", " ".join(notes))
    assert origin is not None
    lat, lon, height = origin.groups()
    frame = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        "+step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={height}"
    )
    _, _, up = frame.transform(points["lon_deg"], points["lat_deg"], points["h_ellipsoid_m"])
    return dict(zip(points["point"], up, strict=True))


def test_colmap_maps_the_database_that_comes_out(tmp_path, truth):
    """Its incremental mapper, from nothing but the database: matches without F, E and H, corrected
    keypoints, cameras and pose priors. Height RMS 0.029 m, and 0.136 m from measured keypoints."""
    pycolmap.logging.minloglevel = 2
    measured = pd.read_parquet(REPOSITORY / "sample_logs" / "observations.parquet")
    lenses = execute(RECIPE.split("lens =")[0])["brown"]
    source = tmp_path / "source.db"
    write_source(source, measured, lenses)
    run = run_sample(
        "bin",
        tmp_path / "run",
        observations={"path": str(source), "format": "colmap"},
        ground={"height": 450.0},
    )
    corrected = tmp_path / "corrected.db"
    ledger = export_run(run.output, "colmap-database", corrected, {}).ledger
    assert "EXPORT-USE" in {message.code for message in ledger}
    uncorrected = tmp_path / "uncorrected.db"
    shutil.copy(corrected, uncorrected)
    restore_measured_keypoints(uncorrected, read_observations(run.output))
    sidecar = json.loads((tmp_path / "corrected.db.unbend.json").read_text("utf-8"))
    up_m = true_heights(sidecar["notes"], truth["points"])
    points = {name: rows["point"].to_list() for name, rows in measured.groupby("image")}

    assert rms_of_mapped(corrected, points, up_m) <= 0.035
    assert rms_of_mapped(uncorrected, points, up_m) >= 0.13


def rms_of_mapped(database, points: dict[str, list[str]], up_m: dict[str, float]):
    """RMS error in height [m] of COLMAP's map; a point is known by its first keypoint."""
    options = pycolmap.IncrementalPipelineOptions(
        use_prior_position=True,
        extract_colors=False,
        multiple_models=False,
        random_seed=1,
        ba_refine_focal_length=False,
        ba_refine_extra_params=False,
        min_num_matches=5,
    )
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    # COLMAP has thousands of keypoints in an image, the sample flight 40.
    options.mapper.init_min_num_inliers = 10
    options.mapper.abs_pose_min_num_inliers = 6
    options.mapper.init_min_tri_angle = 4.0
    options.triangulation.ignore_two_view_tracks = False
    folder = database.with_suffix("")
    folder.mkdir()

    model = pycolmap.incremental_mapping(database, folder, folder, options)[0]

    assert model.num_reg_images() == len(points)
    errors = []
    for mapped in model.points3D.values():
        first = mapped.track.elements[0]
        name = model.images[first.image_id].name
        point = points[name][first.point2D_idx]
        errors.append(mapped.xyz[2] - up_m[point])
    assert len(errors) > 600
    return np.sqrt(np.mean(np.square(errors)))
