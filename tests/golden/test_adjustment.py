"""What it is all for: the sample flight adjusted by docs/pages/guide/pycolmap.md, and by COLMAP."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from contextlib import closing
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from unbend.batch.finished_run.export import export_run

from .conftest import REPOSITORY, read_observations, run_sample

PAGE = REPOSITORY / "docs" / "pages" / "guide" / "pycolmap.md"
(RECIPE,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.fixture
def beside_results(runs, tmp_path, monkeypatch) -> Path:
    """A folder as it looks after `make sample`."""
    shutil.copytree(runs["bin"].output, tmp_path / "results" / "sample_bin")
    (tmp_path / "sample_logs").mkdir()
    shutil.copy(REPOSITORY / "sample_logs" / "observations.parquet", tmp_path / "sample_logs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def execute(code: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(code, PAGE.name, "exec"), names)
    return names


def height_error(code: str, truth: dict[str, pd.DataFrame]) -> float:
    """RMS error in height [m] of the points that the page's adjustment finds."""
    names = execute(code)
    true = truth["points"].set_index("point").loc[list(names["points"])]
    ecef = np.stack(
        names["ecef"].transform(true["lon_deg"], true["lat_deg"], true["h_ellipsoid_m"]), axis=1
    )
    expected = names["enu"](names["lat0"], names["lon0"]).apply(ecef - names["origin"])
    error = np.array(list(names["points"].values())) - expected
    assert len(error) > 500
    return float(np.sqrt(np.mean(error[:, 2] ** 2)))


def test_the_page_shows_what_the_correction_is_worth(beside_results, truth, capsys):
    """Stations as the log has them; measured 0.027 and 0.136 m."""
    code = RECIPE.replace("flown/results/simulated_bin", "results/sample_bin")
    code = code.replace("flown/observations.parquet", "sample_logs/observations.parquet")
    corrected = '"x_corrected_px", "y_corrected_px"'
    assert code.count(corrected) == 1
    uncorrected = code.replace(corrected, '"x_px", "y_px"')
    # The shift with the wrong sign: as far off on the other side.
    turn = "".join(
        f"\nobservations[{a}] = 2 * observations.{a}_px - observations[{a}]" for a in "xy"
    )
    turned = code.replace("\n\n\ndef enu", f"{turn}\n\n\ndef enu")
    assert turned != code
    errors = {
        name: height_error(text, truth)
        for name, text in (("with", code), ("without", uncorrected), ("turned", turned))
    }
    with capsys.disabled():
        print("\nheight rms [m] " + ", ".join(f"{k} {v:.4f}" for k, v in errors.items()))
    assert errors["with"] <= 0.03
    assert errors["without"] >= 0.13
    assert errors["turned"] > 1.5 * errors["without"]


CAMERA = {"width": 14000, "height": 10600, "model": "FULL_OPENCV", "has_prior_focal_length": True}


def write_source(path: Path, rows: pd.DataFrame, cameras: dict[str, list[float]]) -> None:
    """A database as COLMAP leaves it: matches, and geometries whose matrices are a nonsense."""
    pycolmap = pytest.importorskip("pycolmap")
    with closing(pycolmap.Database.open(path)) as database:
        number = {
            name: database.write_camera(pycolmap.Camera(**CAMERA, params=params))
            for name, params in cameras.items()
        }
        places = {}
        for name, rows_of_image in rows.groupby("image"):
            image = pycolmap.Image(name=name, camera_id=number[name.split("_")[0]])
            image_id = database.write_image(image)
            database.write_keypoints(image_id, rows_of_image[["x_px", "y_px"]].to_numpy(np.float32))
            places[image_id] = {point: k for k, point in enumerate(rows_of_image["point"])}
        for first, other in combinations(places, 2):
            shared = [(k, places[other][p]) for p, k in places[first].items() if p in places[other]]
            if shared:
                matches = np.array(shared, np.uint32)
                verified = pycolmap.TwoViewGeometry()
                verified.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                verified.E = verified.F = verified.H = np.diag([1.0, 2.0, 3.0])
                verified.inlier_matches = matches
                database.write_matches(first, other, matches)
                database.write_two_view_geometry(first, other, verified)


def test_colmap_maps_the_database_that_comes_out(tmp_path, truth, capsys):
    """Its incremental mapper, from nothing but the database: matches without F, E and H, corrected
    keypoints, cameras and pose priors. Height RMS 0.029 m, and 0.136 m from measured keypoints."""
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.logging.minloglevel = 2
    given = pd.read_parquet(REPOSITORY / "sample_logs" / "observations.parquet")
    lenses = execute(RECIPE.split("lens =")[0])["brown"]
    write_source(tmp_path / "source.db", given, lenses)
    observations = {"path": str(tmp_path / "source.db"), "format": "colmap"}
    run = run_sample("bin", tmp_path / "run", observations=observations, ground={"height": 450.0})
    ledger = export_run(run.output, "colmap-database", tmp_path / "with.db", {}).ledger
    assert "EXPORT-USE" in {message.code for message in ledger}
    notes = json.loads((tmp_path / "with.db.unbend.json").read_text(encoding="utf-8"))["notes"]
    place = re.search(r"from (\S+) N, (\S+) E, (\S+) m above", " ".join(notes))
    assert place is not None
    pyproj = pytest.importorskip("pyproj")
    frame = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        "+ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        + "+lat_0={} +lon_0={} +h_0={}".format(*place.groups())
    )
    points = truth["points"]
    places = frame.transform(points["lon_deg"], points["lat_deg"], points["h_ellipsoid_m"])
    true = dict(zip(points["point"], places[2], strict=True))
    names = {name: own["point"].to_list() for name, own in given.groupby("image")}
    rows = read_observations(run.output)
    shutil.copy(tmp_path / "with.db", tmp_path / "without.db")
    with closing(sqlite3.connect(tmp_path / "without.db")) as database, database:
        (left,) = database.execute(
            "SELECT COUNT(*) FROM two_view_geometries WHERE coalesce(F, E, H) NOT NULL"
        ).fetchone()
        assert left == 0
        for number, name in database.execute("SELECT image_id, name FROM images").fetchall():
            xy = rows[rows["image"] == name][["x_px", "y_px"]].to_numpy("<f4").tobytes()
            database.execute("UPDATE keypoints SET data = ? WHERE image_id = ?", (xy, number))
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
    options.mapper.init_min_num_inliers, options.mapper.abs_pose_min_num_inliers = 10, 6
    options.mapper.init_min_tri_angle = 4.0
    options.triangulation.ignore_two_view_tracks = False
    errors = {}
    for name in ("with", "without"):
        (tmp_path / name).mkdir()
        models = pycolmap.incremental_mapping(
            tmp_path / f"{name}.db", tmp_path, tmp_path / name, options
        )
        assert models[0].num_reg_images() == len(names)
        found = [
            (names[models[0].images[seen.image_id].name][seen.point2D_idx], point.xyz[2])
            for point in models[0].points3D.values()
            for seen in point.track.elements[:1]
        ]
        assert len(found) > 600
        errors[name] = np.sqrt(np.mean([(z - true[point]) ** 2 for point, z in found]))
    with capsys.disabled():
        print("\nheight rms [m] " + ", ".join(f"{k} {v:.4f}" for k, v in errors.items()))
    assert errors["with"] <= 0.035
    assert errors["without"] >= 0.13
