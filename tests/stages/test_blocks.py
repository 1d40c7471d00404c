"""Missions whose observations, cameras and orientations come from the block of another program.

The answer is that of the mission by its log, whose stations and points were written by that
program, or by its published formulas.
"""

from __future__ import annotations

import json
import re
import sys
from contextlib import closing
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.dbat_project import write_project

sys.path.insert(0, str(Path(__file__).parent))
from block_files import CABIN, in_enu, write_colmap

pytestmark = pytest.mark.usefixtures("plain_report")

ORIGIN = (47.0, 8.5, 500.0)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "ba"
CAMERAS = {  # of the simulated mission, in COLMAP's order
    "nadir": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 7012.4, 5291.7, -0.018, 0.009,
                                            0.00015, -0.0001, -0.002, 0.0, 0.0, 0.0]),
    "oblique": ("FULL_OPENCV", 14000, 10600, [20000.0, 20000.0, 6989.2, 5308.1, -0.015, 0.007,
                                              -0.00012, 0.00008, -0.001, 0.0, 0.0, 0.0]),
}  # fmt: skip


@pytest.fixture(scope="module")
def points(flown):
    return pq.read_table(flown.truth / "points.parquet").to_pandas()


@pytest.fixture
def block(mission_factory, tmp_path):
    """The same without its log, its cameras and its table."""
    mission = mission_factory(tmp_path / "mission")
    config = mission.config
    for section in ("log", "mount", "events"):
        del config[section]
    config["mission"]["undulation_m"] = 47.6
    config["atmosphere"] = {"adjust": False}
    config["observations"] = {"path": "sparse", "format": "colmap"}
    same = {"calibration": "laboratory", "window": {"cabin": CABIN}}
    config["cameras"] = {"nadir": {"camera": 1} | same, "oblique": {"camera": 2} | same}
    config["stations"] = {"orientation": {"frame": enu(ORIGIN)}}
    config["ground"] = {"height": "block"}
    return mission


def enu(origin) -> dict:
    return {"enu": dict(zip(("lat_deg", "lon_deg", "h_ellipsoid_m"), origin, strict=True))}


def colmap(block, by_log, points, **options) -> dict[str, int]:
    observations = by_log.measurements().to_pandas()
    return write_colmap(
        block.folder / "sparse",
        CAMERAS,
        by_log.stations().to_pandas(),
        observations,
        points,
        origin=ORIGIN,
        **options,
    )


def ran(mission, code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def shift(mission) -> pd.DataFrame:
    table = mission.results().to_pandas()
    for axis in "xy":
        table[f"d{axis}"] = table[f"{axis}_corrected_px"] - table[f"{axis}_px"]
    return table


def assert_same(block, by_log, names: dict[str, str], atol: float) -> None:
    """The corrections of every row, found again by image and point, are those by the log."""
    wanted = shift(by_log).set_index(["image", "point"])
    found = shift(block)
    assert len(found) == len(wanted)
    wanted = wanted.loc[list(zip(found["image"], found["point"].map(names), strict=True))]
    assert np.abs(wanted["dx"]).max() > 0.3
    for column, most in (("dx", atol), ("dy", atol), ("x_px", 1e-9), ("y_px", 1e-9)):
        np.testing.assert_allclose(found[column], wanted[column], rtol=0.0, atol=most)


@pytest.mark.parametrize("text", [False, True], ids=["bin", "txt"])
def test_a_model_of_colmap(block, by_log, points, text):
    numbers = colmap(block, by_log, points, text=text)
    manifest = ran(block)
    assert_same(block, by_log, {str(k): name for name, k in numbers.items()}, 2e-6)
    assert {i["role"] for i in manifest["inputs"]} == {
        "observations",
        "orientation",
        "camera nadir",
        "camera oblique",
    }
    found = block.results().to_pandas()
    assert (found.groupby("image")["keypoint"].apply(list).apply(lambda k: k == sorted(k))).all()
    assert "GROUND-BLOCK" in {entry["code"] for entry in manifest["ledger"]}


def test_the_mission_of_the_page(block, by_log, points):
    page = Path(__file__).resolve().parents[2] / "docs/pages/guide/oriented_block.md"
    text = next(
        t
        for t in re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
        if "sparse/0" in t
    )
    assert text.count("\n") < 20
    colmap(block, by_log, points)
    (block.folder / "sparse").rename(block.folder / "0")
    (block.folder / "sparse").mkdir()
    (block.folder / "0").rename(block.folder / "sparse" / "0")
    block.config["observations"]["path"] = "sparse/0"
    for camera in block.config["cameras"].values():
        del camera["window"]
    ran(block)
    wanted = shift(block)
    block.config = yaml.load(text, yaml.BaseLoader)
    (block.folder / "mission.yaml").write_text(text)
    from unbend.batch.runs import run_mission

    outcome = run_mission(block.folder / "mission.yaml")
    assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
    found = shift(block)
    assert (found["status"] == "ok").all()
    # The climatology of the day in place of the US 1976 atmosphere.
    ratio = np.hypot(found["dx"], found["dy"]) / np.hypot(wanted["dx"], wanted["dy"])
    assert ratio.between(0.93, 1.07).all()
    assert np.ptp(ratio) > 0.0


def test_keypoints_without_a_point_keep_their_rows(block, by_log, points):
    without = frozenset(range(0, 59, 7))
    colmap(block, by_log, points, without_point=without)
    ran(block)
    found = shift(block)
    own = found[found["point"].str.contains(":")]
    assert len(found) == 59
    assert len(own) == len(without)
    assert (own["point"] == own["image"] + ":" + own["keypoint"].astype(str)).all()
    assert (own["status"] == "ok").all()
    # The heights of the points differ by less than 100 m from 2500 m below: under 4 % of each.
    wanted = shift(by_log)
    wanted = wanted.set_index([wanted["image"], wanted["x_px"].round(6)]).loc[
        list(zip(own["image"], own["x_px"].round(6), strict=True))
    ]
    size = np.hypot(wanted["dx"], wanted["dy"]).to_numpy()
    off = np.hypot(own["dx"].to_numpy() - wanted["dx"], own["dy"].to_numpy() - wanted["dy"])
    assert (off.to_numpy() < 0.04 * size).all()


def refused(mission, code: str, *words: str) -> None:
    ended = mission.run()
    assert ended.code in (2, 6), ended.text
    assert "Traceback" not in ended.text
    text = " ".join(ended.err.split())
    for word in (code, *words):
        assert word in text, ended.err


def opensfm(block, by_log, points, *, altitude_m: float) -> None:
    """A project by the published conventions of OpenSfM, written out here."""
    stations = by_log.stations().to_pandas()
    table = by_log.measurements().to_pandas()
    origin = (47.0, 8.5, altitude_m)
    centre, turn, xyz = in_enu(stations, points, origin)
    cameras = {}
    for name, (_, width, height, (f, _, cx, cy, k1, k2, p1, p2, k3, *_)) in CAMERAS.items():
        cameras[name] = {
            "projection_type": "brown",
            "width": width,
            "height": height,
            "focal_x": f / width,
            "focal_y": f / width,
            "c_x": (cx - width / 2) / width,
            "c_y": (cy - height / 2) / width,
            "k1": k1,
            "k2": k2,
            "k3": k3,
            "p1": p1,
            "p2": p2,
        }
    shots = {
        s.image: {
            "rotation": Rotation.from_matrix(turn[k]).as_rotvec().tolist(),
            "translation": (-turn[k] @ centre[k]).tolist(),
            "camera": s.camera,
        }
        for k, s in enumerate(stations.itertuples())
    }
    track = {name: k for k, name in enumerate(points["point"])}
    placed = {
        str(track[name]): {"coordinates": place.tolist()}
        for name, place in zip(points["point"], xyz, strict=True)
    }
    lla = dict(zip(("latitude", "longitude", "altitude"), origin, strict=True))
    (block.folder / "opensfm").mkdir()
    (block.folder / "opensfm" / "reconstruction.json").write_text(
        json.dumps([{"cameras": cameras, "shots": shots, "points": placed}])
    )
    (block.folder / "opensfm" / "reference_lla.json").write_text(json.dumps(lla))
    lines = ["OPENSFM_TRACKS_VERSION_v2"]
    for k, row in enumerate(table.itertuples()):
        # OpenSfM's pixels count from the centre of the upper left one.
        x = ((row.x_px - 0.5) + 0.5 - 7000) / 14000
        y = ((row.y_px - 0.5) + 0.5 - 5300) / 14000
        lines.append(f"{row.image}\t{track[row.point]}\t{k}\t{x!r}\t{y!r}\t0.001\t1\t2\t3\t-1\t-1")
    (block.folder / "opensfm" / "tracks.csv").write_text("\n".join(lines) + "\n")
    block.config["observations"] = {"path": "opensfm", "format": "opensfm"}
    for name in CAMERAS:
        block.config["cameras"][name]["camera"] = name
    del block.config["stations"]["orientation"]


@pytest.mark.parametrize("heights", ["ellipsoid", "msl"])
def test_a_project_of_opensfm(block, by_log, points, heights):
    """Its frame is reference_lla's; whether its altitudes are above the sea has to be said."""
    opensfm(block, by_log, points, altitude_m=500.0)
    refused(block, "CONFIG-INVALID", "give heights (msl or ellipsoid)")
    if heights == "msl":  # altitudes above the sea: the same block, as OpenSfM would have it
        lla = block.folder / "opensfm" / "reference_lla.json"
        lla.write_text(lla.read_text().replace("500.0", "452.4"))
    block.config["stations"] = {"orientation": {"heights": heights}}
    ran(block)
    names = {str(k): name for k, name in enumerate(points["point"])}
    assert_same(block, by_log, names, 2e-6)


def test_a_project_without_a_reference_has_no_frame(block, by_log, points):
    opensfm(block, by_log, points, altitude_m=500.0)
    (block.folder / "opensfm" / "reference_lla.json").unlink()
    block.config["stations"] = {"orientation": {"heights": "msl"}}
    refused(block, "ORIENTATION-FRAME", "stations.orientation.frame: ecef")


def test_cameras_of_the_mission_file_and_by_their_names(block, by_log, points):
    """Numbers in the mission file, found by the camera's number; and entries called by theirs."""
    numbers = colmap(block, by_log, points)
    names = {str(k): name for name, k in numbers.items()}
    own = by_log.config["cameras"]["nadir"] | {"camera": 1}
    block.config["cameras"]["nadir"] = own
    ran(block)
    assert_same(block, by_log, names, 2e-6)
    both = block.config["cameras"]
    block.config["cameras"] = {"1": own, "2": both["oblique"]}
    del block.config["cameras"]["1"]["camera"], block.config["cameras"]["2"]["camera"]
    ran(block)
    assert_same(block, by_log, names, 2e-6)


def test_a_stated_frame_holds_and_a_contradiction_is_told(block, by_log, points):
    opensfm(block, by_log, points, altitude_m=500.0)
    for h, count in ((500.0, 0), (501.0, 1)):
        block.config["stations"] = {"orientation": {"frame": enu((47.0, 8.5, h))}}
        told = [e for e in ran(block)["ledger"] if e["code"] == "IMPORT-CONTRADICTED"]
        assert len(told) == count


def test_what_a_block_does_not_say_is_asked_for(block, by_log, points):
    colmap(block, by_log, points)
    block.config["stations"]["orientation"] = {"heights": "msl"}
    refused(block, "CONFIG-INVALID", "stations.orientation.frame: is missing")
    block.config["stations"]["orientation"] = {"frame": "ecef"}
    refused(block, "ORIENTATION-FRAME", "m above sea level", "a local frame is not ecef")
    block.config["stations"]["orientation"] = {"frame": enu(ORIGIN)}
    del block.config["cameras"]["oblique"]
    refused(block, "BLOCK-CAMERA", "3 images, the first oblique_00001, are of camera '2'")


def test_a_model_without_points_has_no_ground(block, by_log, points):
    colmap(block, by_log, points, without_point=frozenset(range(59)))
    refused(block, "POINTS-EMPTY", "ground.height")


def test_a_database_beside_a_model(block, by_log, points):
    """Keypoints of the database, float32; orientations, heights and cameras of the model."""
    pycolmap = pytest.importorskip("pycolmap")
    numbers = colmap(block, by_log, points)
    content = pycolmap.Database.open(str(block.folder / "database.db"))
    table = by_log.measurements().to_pandas()
    for model, width, height, params in CAMERAS.values():
        content.write_camera(
            pycolmap.Camera(model=model, width=width, height=height, params=params)
        )
    for name, rows in table.groupby("image"):
        image = pycolmap.Image(name=name, camera_id=1 + name.startswith("oblique"))
        xy = rows[["x_px", "y_px"]].to_numpy(np.float32)
        content.write_keypoints(content.write_image(image), xy)
    content.close()
    block.config["observations"]["path"] = "database.db"
    block.config["stations"]["orientation"] |= {"path": "sparse", "format": "colmap"}
    ran(block)
    found = shift(block)
    wanted = shift(by_log)
    assert found["point"].str.fullmatch(r"(nadir|oblique)_\d+:\d+").all()
    wanted = wanted.assign(keypoint=wanted.groupby("image").cumcount())
    wanted = wanted.set_index(["image", "keypoint"]).loc[
        list(zip(found["image"], found["keypoint"], strict=True))
    ]
    assert np.abs(found["x_px"].to_numpy() - wanted["x_px"]).max() <= 0.0005
    # Heights are medians of the images here, tens of metres from those of 2500 m below.
    size = np.hypot(wanted["dx"], wanted["dy"]).to_numpy()
    assert (np.abs(found["dx"].to_numpy() - wanted["dx"]) < 0.05 * size).all()
    assert len(numbers) == len(points)
    del block.config["stations"]["orientation"]["path"]
    refused(block, "neither orientations nor object points", "a model, as sparse/0")


def test_matches_of_a_database_come_out_with_its_keypoints(block, by_log, points, unbend):
    """By name of the points, which the program never sees: with a keypoint outside the image as the
    first of each, and images numbered the other way round."""
    pycolmap = pytest.importorskip("pycolmap")
    colmap(block, by_log, points)
    table = by_log.measurements().to_pandas()
    source = block.folder / "database.db"
    names = {}
    numbers = {}
    with closing(pycolmap.Database.open(str(source))) as content:
        for model, width, height, params in CAMERAS.values():
            camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
            content.write_camera(camera)
        for name, rows in reversed([*table.groupby("image")]):
            image = pycolmap.Image(name=name, camera_id=1 + name.startswith("oblique"))
            numbers[name], names[name] = content.write_image(image), ["outside", *rows["point"]]
            xy = np.vstack([[-900.0, 50.0], rows[["x_px", "y_px"]]]).astype(np.float32)
            content.write_keypoints(numbers[name], xy)
        for pair in combinations(names, 2):
            place = {point: k for k, point in enumerate(names[pair[1]])}
            both = [(k, place[p]) for k, p in enumerate(names[pair[0]]) if p in place]
            both.insert(0, (0, 1))  # the one outside with one inside
            both = np.array(both, np.uint32)
            ids = [numbers[name] for name in pair]
            content.write_matches(*ids, both)
            verified = pycolmap.TwoViewGeometry()
            verified.config = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
            verified.inlier_matches = both[:-1]
            content.write_two_view_geometry(*ids, verified)
    block.config["observations"]["path"] = "database.db"
    block.config["stations"]["orientation"] |= {"path": "sparse", "format": "colmap"}
    ended = block.run()
    assert ended.code == 3, ended.text  # a loss: keypoints outside the image
    words = ("export", block.output, "--format", "colmap-database", "--out")
    assert "EXPORT-NO-TIES" not in unbend(*words, block.folder / "out.db").text
    rows = block.results().to_pandas().query("status == 'ok'").sort_values("keypoint")
    assert (rows["keypoint"] > 0).all()
    count = 0
    with closing(pycolmap.Database.open(str(block.folder / "out.db"))) as content:
        ids = {image.name: image.image_id for image in content.read_all_images()}
        assert sorted(ids, key=ids.get) != sorted(numbers, key=numbers.get)
        for name, own in rows.groupby("image"):
            xy = content.read_keypoints(ids[name])[:, :2]
            assert np.abs(xy - own[["x_corrected_px", "y_corrected_px"]]).to_numpy().max() < 0.0006
        points_of = {
            name: [names[name][k] for k in own] for name, own in rows.groupby("image")["keypoint"]
        }
        for one, other in combinations(names, 2):
            both = content.read_matches(ids[one], ids[other])
            found = [(points_of[one][i], points_of[other][k]) for i, k in both]
            common = [p for p in points_of[one] if p in points_of[other]]
            assert found == [(p, p) for p in common]
            verified = content.read_two_view_geometry(ids[one], ids[other])
            last = [p for p in names[one] if p in names[other]][-1]
            kept = [k for k, p in enumerate(common) if p != last]
            np.testing.assert_array_equal(verified.inlier_matches, both[kept])
            if kept:
                assert verified.config == pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
            count += len(both)
    assert count > 30
    with closing(pycolmap.Database.open(str(source))) as content:
        content.write_camera(pycolmap.Camera(model="PINHOLE", width=9, height=9, params=[9] * 4))
    changed = unbend(*words, block.folder / "again.db")
    assert (changed.code, "EXPORT-NO-TIES" in changed.text) == (3, True)


def test_a_point_twice_in_an_image_is_a_loss(block, by_log, points):
    colmap(block, by_log, points, text=True)
    file = block.folder / "sparse" / "images.txt"
    lines = file.read_text().splitlines()
    row = next(k for k, line in enumerate(lines) if line.endswith("nadir_00001")) + 1
    fields = lines[row].split()
    first, fields[5] = fields[2], fields[2]
    lines[row] = " ".join(fields)
    file.write_text("\n".join(lines) + "\n")
    entries = {e["code"]: e for e in ran(block, 3)["ledger"] if e["kind"] == "loss"}
    assert f"{first} in nadir_00001" in entries["OBS-REPEATED-POINT"]["what"]


REAL_BLOCKS = ["dbat", "metashape"] if SHARED.is_dir() else []


@pytest.mark.parametrize("program", ["written", *REAL_BLOCKS])
def test_a_block_as_a_mission_without_a_log(tmp_path, program):
    """Five images over Strasbourg: DBAT's script, real and written, and PhotoScan's archive."""
    from unbend.batch.runs import run_mission

    folder = SHARED / "dbat_sxb"
    count = {"dbat": 1196, "metashape": 4066}
    if program == "written":
        folder = tmp_path
        program = "dbat"
        count = {"dbat": len(write_project(tmp_path).marks)}
    mission = {
        "mission": {"name": "sxb"},
        "observations": {
            "path": str(folder / {"dbat": "sxb.xml", "metashape": "sxb.psz"}[program]),
            "format": program,
        },
        "cameras": {"aerial": {"calibration": "laboratory"}},
        "stations": {
            "orientation": {
                "frame": "projected",
                "crs": "EPSG:27561",
                "heights": "msl",
                "date": "2013-08-22",
            }
        },
        "ground": {"height": "block"},
        "output": {"path": str(tmp_path / "out")},
    }
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(mission))
    outcome = run_mission(tmp_path / "m.yaml")
    assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
    found = pd.read_parquet(outcome.output / "observations")
    assert (found["status"] == "ok").all()
    assert len(found) == count[program]
    size = np.hypot(
        found["x_corrected_px"] - found["x_px"], found["y_corrected_px"] - found["y_px"]
    )
    assert 0.05 < size.median() < 0.12
    # Strasbourg, 1.8 km above the town, in NTF to 2 m.
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    assert stations["lat_deg"].between(48.579, 48.587).all()
    assert stations["lon_deg"].between(7.757, 7.770).all()
    assert stations["h_msl_m"].between(1906, 1938).all()


def test_a_model_in_an_unknown_frame(tmp_path):
    """The sample's block turned, moved and 50 times smaller, by four known places: as in its own.

    Truth is the same model in a stated frame; pycolmap turns it.
    """
    import pycolmap

    from unbend.batch.runs import run_mission

    samples = Path(__file__).resolve().parents[2] / "sample_logs"
    stations = pq.read_table(samples / "truth" / "stations.parquet").to_pandas()
    points = pq.read_table(samples / "truth" / "points.parquet").to_pandas()
    observations = pq.read_table(samples / "observations.parquet").to_pandas()
    write_colmap(tmp_path / "stated", CAMERAS, stations, observations, points, origin=ORIGIN)
    model = pycolmap.Reconstruction(str(tmp_path / "stated"))
    turn = pycolmap.Rotation3d(Rotation.from_euler("xyz", [70.0, -40.0, 150.0], True).as_quat())
    model.transform(pycolmap.Sim3d(0.02, turn, np.array([5.0, -3.0, 8.0])))
    (tmp_path / "unknown").mkdir()
    model.write_binary(str(tmp_path / "unknown"))
    nadir = stations[stations["camera"] == "nadir"].reset_index(drop=True)
    known = nadir.loc[[0, 6, 13, 20, 27], ["image", "lat_deg", "lon_deg", "h_ellipsoid_m"]]
    known.set_axis(["image", "latitude", "longitude", "height"], axis=1).to_csv(
        tmp_path / "known.csv", index=False
    )
    same = {"calibration": "laboratory", "window": {"cabin": CABIN}}
    of_unknown = {
        "frame": "unknown",
        "heights": "ellipsoid",
        "known_positions": {"path": "known.csv", "sigma_m": 0.05},
    }
    found = {}
    for name, orientation in {"stated": {"frame": enu(ORIGIN)}, "unknown": of_unknown}.items():
        config = {
            "mission": {"name": name, "undulation_m": 47.6},
            "observations": {"path": name, "format": "colmap"},
            "cameras": {"nadir": {"camera": 1} | same, "oblique": {"camera": 2} | same},
            "stations": {"orientation": orientation},
            "ground": {"height": "block"},
            "atmosphere": {"adjust": False},
            "output": {"path": f"results_{name}"},
        }
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        outcome = run_mission(path)
        assert outcome.exit_code == 0, outcome.manifest.values["ledger"]
        codes = {entry["code"]: entry["what"] for entry in outcome.manifest.values["ledger"]}
        parts = sorted((tmp_path / f"results_{name}" / "observations").glob("*.parquet"))
        table = pd.concat([pq.read_table(part).to_pandas() for part in parts])
        found[name] = table.sort_values(["image", "keypoint"], ignore_index=True)
    assert "5 known positions" in codes["ORIENTATION-FIT"]
    assert (found["unknown"]["status"] == "ok").all()
    moved = {
        k: t[["x_corrected_px", "y_corrected_px"]] - t[["x_px", "y_px"]].to_numpy()
        for k, t in found.items()
    }
    assert np.abs(moved["stated"].to_numpy()).max() > 0.3
    np.testing.assert_allclose(moved["unknown"], moved["stated"], rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(found["unknown"]["h_g_m"], found["stated"]["h_g_m"], atol=1e-3)
