"""Blocks of other programs against those programs, and what is refused in them."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import struct
import zipfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.dbat_project import write_project
from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports.blocks import (
    block_reader,
    block_rows,
    damage_refused,
    read_block_images,
    read_camera,
)
from unbend.tables.observations import open_observations

SHARED = Path(__file__).resolve().parents[5] / "shared" / "ba"
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}
needs_blocks = pytest.mark.shared("ba")


def rows(path: Path, program: str) -> pd.DataFrame:
    return pd.concat([b.to_pandas() for b in block_rows(path, program)], ignore_index=True)


def everything(path: Path, program: str) -> None:
    """All that a mission reads of a block."""
    with damage_refused(path, program):
        files = block_reader(program).block_files(path)
        cameras = list(block_reader(program).read_cameras(path))
    assert path.is_dir() or path in files
    for name in cameras or ["1"]:
        read_camera(path, program, name)
    open_observations(path, COLUMNS, None, Ledger(), file_format=program)
    read_block_images(path, program)


def refusal(path: Path, program: str) -> str:
    with pytest.raises(InputError) as refused:
        everything(path, program)
    text = str(refused.value)
    # No word of Python or of a library.
    assert not re.search(
        r"Error|Traceback|codec|unpack|literal|NoneType|object has|0x|sqlite3", text
    )
    return text


# COLMAP


@pytest.fixture
def model(tmp_path):
    """Twelve images, four a rig of two cameras that moves and turns: poses are composed."""
    pycolmap = pytest.importorskip("pycolmap")
    draw = np.random.default_rng(13)
    block = pycolmap.Reconstruction()
    for number in (1, 2):
        params = [3000, 3010, 2001, 1502, -0.01, 0.002, 1e-4, -2e-4]
        camera = pycolmap.Camera(
            model="OPENCV", width=4000, height=3000, camera_id=number, params=params
        )
        block.add_camera(camera)
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1))
    turn = pycolmap.Rotation3d(Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix())
    rig.add_sensor(
        pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 2),
        pycolmap.Rigid3d(turn, np.array([0.2, -0.1, 0.05])),
    )
    block.add_rig(rig)
    for k in range(4):
        place = Rotation.from_rotvec(draw.normal(0.0, 0.2, 3)).as_matrix()
        frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
        frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(place), draw.normal(0, 50, 3))
        for camera in (1, 2):
            data = pycolmap.data_t(
                pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera), 2 * k + camera
            )
            frame.add_data_id(data)
        block.add_frame(frame)
        for camera in (1, 2):
            name = f"strip {k}/of {camera}.jpg"  # COLMAP's names are paths, and have blanks
            xy = draw.uniform(0.0, 3000.0, (5 * k, 2))
            image = pycolmap.Image(
                name=name, keypoints=xy, camera_id=camera, image_id=2 * k + camera
            )
            image.frame_id = k + 1
            block.add_image(image)
        block.register_frame(k + 1)
    for i in range(5):
        track = pycolmap.Track([pycolmap.TrackElement(n, i) for n in (3, 4, 5, 6)])
        block.add_point3D(draw.normal(0, 100, 3), track)
    for name, write in (("bin", block.write_binary), ("txt", block.write_text)):
        (tmp_path / name).mkdir()
        write(str(tmp_path / name))
    return block, tmp_path


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_model_is_what_pycolmap_says(model, form):
    block, folder = model
    table = read_block_images(folder / form, "colmap")
    found = rows(folder / form, "colmap")
    images = {image.name: image for image in block.images.values()}
    assert set(table.image) == set(images)
    for name, camera, centre, q in zip(
        table.image, table.camera, table.position, table.angles, strict=True
    ):
        image = images[name]
        assert camera == str(image.camera_id)
        np.testing.assert_allclose(centre, image.projection_center(), atol=1e-9)
        wanted = image.cam_from_world().rotation.matrix()
        np.testing.assert_allclose(
            Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), wanted, atol=1e-12
        )
        of_image = found[found["image"] == name]
        points = [
            (*p.xy, str(p.point3D_id) if p.has_point3D() else f"{name}:{i}")
            for i, p in enumerate(image.points2D)
        ]
        assert [*zip(of_image["x_px"], of_image["y_px"], of_image["point"], strict=True)] == points
        assert of_image["keypoint"].tolist() == list(range(len(points)))
    names, places = block_reader("colmap").read_points(folder / form)
    for name, place in zip(names.to_pylist(), places, strict=True):
        np.testing.assert_array_equal(place, block.points3D[int(name)].xyz)
    assert len(names) == 5


def test_a_ray_of_pycolmap_meets_the_same_pixel(model):
    """Half a pixel and the axes: a point in the frame, through our pose and camera."""
    block, folder = model
    table = read_block_images(folder / "bin", "colmap")
    images = {image.name: image for image in block.images.values()}
    for name, camera, centre, q in zip(
        table.image, table.camera, table.position, table.angles, strict=True
    ):
        turn = Rotation.from_quat(q[[1, 2, 3, 0]])
        point = centre + turn.inv().apply([0.21, -0.13, 1.0]) * 300.0
        seen = turn.apply(point - centre)
        u, v = (np.array([c]) for c in seen[:2] / seen[2])
        ours = np.ravel(read_camera(folder / "bin", "colmap", camera).project(u, v))
        np.testing.assert_allclose(ours, images[name].project_point(point), atol=1e-8)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_model_that_is_cut_anywhere_is_refused(model, name, form):
    """By file, and by byte or line; pycolmap takes a cameras.bin that is cut short silently."""
    _, folder = model
    file = folder / form / f"{name}.{form}"
    content = file.read_bytes()
    ends = np.linspace(0, len(content) - 2, 25).astype(int)
    for end in ends:
        file.write_bytes(content[:end])
        try:
            everything(folder / form, "colmap")
            names, _ = block_reader("colmap").read_points(folder / form)
        except InputError as error:
            text = str(error)
            assert file.name in text or end == 0 or "OBS-EMPTY" in text or "CAMERA-" in text
            assert re.search(r"cut off|line \d+|model number|OBS-EMPTY|CAMERA-", text), text
        else:
            if len(names):  # in the last line, of whose end no other file knows
                assert (name, form) in {("cameras", "txt"), ("images", "txt")}, end
                assert b"\n" not in content[end:].strip(), end
                (note,) = read_block_images(folder / form, "colmap").notes
                assert note.code == "COLMAP-COUNT"
            else:
                assert name == "points3D", end  # which ground.height: block refuses


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("count", [b"1", b"200"])
def test_a_count_in_a_comment_and_a_missing_end_do_not_matter(model, name, count):
    """Nothing else is missing: images and points name each other."""
    _, folder = model
    wanted = rows(folder / "txt", "colmap")
    file = folder / "txt" / f"{name}.txt"
    content = file.read_bytes()
    changed = re.sub(rb"(?m)^(# Number of \w+: )\d+", rb"\g<1>" + count, content)
    assert changed != content
    file.write_bytes(changed.removesuffix(b"\n"))
    pd.testing.assert_frame_equal(rows(folder / "txt", "colmap"), wanted)
    assert len(block_reader("colmap").read_points(folder / "txt")[0]) == 5
    notes = read_block_images(folder / "txt", "colmap").notes
    assert {note.code for note in notes} == {"COLMAP-COUNT"}
    assert len(notes) == (2 if name == "images" else 1)


def test_images_without_their_points_are_missing(model):
    """A line of an image is gone, which the tracks of the points name."""
    _, folder = model
    file = folder / "txt" / "images.txt"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-2]))
    assert "cut off after 7 of 8 records" in refusal(folder / "txt", "colmap")


def test_other_versions_and_models(model):
    _, folder = model
    file = folder / "bin" / "cameras.bin"
    content = file.read_bytes()
    file.write_bytes(content[:12] + struct.pack("<i", 40) + content[16:])
    assert "camera model number 40 is not known" in refusal(folder / "bin", "colmap")
    file.write_bytes(content)
    images = folder / "bin" / "images.bin"
    images.write_bytes(images.read_bytes() + b"\0" * 8)
    assert "8 extra bytes at the end" in refusal(folder / "bin", "colmap")
    text = (folder / "txt" / "cameras.txt").read_text()
    (folder / "txt" / "cameras.txt").write_text(text.replace("OPENCV", "THIN_PRISM_FISHEYE"))
    refused = refusal(folder / "txt", "colmap")
    line = 1 + text.splitlines().index(next(t for t in text.splitlines() if "OPENCV" in t))
    assert "CAMERA-MODEL" in refused
    assert f"line {line}" in refused
    assert "camera " in refused


def test_an_image_of_a_camera_that_a_text_has_not(model):
    _, folder = model
    file = folder / "txt" / "images.txt"
    lines = file.read_text().splitlines()
    row = next(k for k, line in enumerate(lines) if line.endswith("strip 2/of 1.jpg"))
    lines[row] = " ".join([*lines[row].split(" ")[:8], "9", "strip 2/of 1.jpg"])
    file.write_text("\n".join(lines) + "\n")
    expected = f"in line {row + 1}, 'strip 2/of 1.jpg' has camera 9, which is not in cameras.txt"
    assert expected in refusal(folder / "txt", "colmap")


def test_poses_that_are_no_rotations_and_images_that_stand_twice(model):
    _, folder = model
    file = folder / "txt" / "images.txt"
    text = file.read_text()
    lines = text.splitlines()
    row = next(k for k, line in enumerate(lines) if line.endswith("strip 2/of 1.jpg"))
    fields = lines[row].split(" ")
    fields[1] = "3.5"
    file.write_text("\n".join([*lines[:row], " ".join(fields), *lines[row + 1 :]]) + "\n")
    assert "'strip 2/of 1.jpg' is not a rotation" in refusal(folder / "txt", "colmap")
    file.write_text(text.replace("strip 2/of 1.jpg", "strip 2/of 2.jpg"))
    assert "'strip 2/of 2.jpg' occurs twice" in refusal(folder / "txt", "colmap")
    fields[1] = "one"
    file.write_text("\n".join([*lines[:row], " ".join(fields), *lines[row + 1 :]]) + "\n")
    assert f"line {row + 1} is not" in refusal(folder / "txt", "colmap")
    (folder / "txt" / "points3D.txt").unlink()
    assert "has a points3D.txt" in refusal(folder / "txt", "colmap")


def database(path: Path, keypoints: dict[str, np.ndarray]) -> Path:
    """By pycolmap, as its feature extractor writes it."""
    pycolmap = pytest.importorskip("pycolmap")
    content = pycolmap.Database.open(str(path))
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=4000, height=3000, params=[3000.0, 2000.0, 1500.0, 0.01]
    )
    number = content.write_camera(camera)
    for name, xy in keypoints.items():
        image = content.write_image(pycolmap.Image(name=name, camera_id=number))
        content.write_keypoints(image, xy.astype(np.float32))
    content.close()
    return path


def test_a_database(tmp_path):
    draw = np.random.default_rng(1)
    given = {
        "b.jpg": draw.uniform(0, 3000, (7, 2)),
        "a.jpg": draw.uniform(0, 3000, (5, 6)),
        "none.jpg": np.empty((0, 2)),
    }
    path = database(tmp_path / "database.db", given)
    found = rows(path, "colmap")
    wanted = np.concatenate([given["b.jpg"], given["a.jpg"][:, :2]]).astype(np.float32)
    np.testing.assert_array_equal(found[["x_px", "y_px"]].to_numpy(), wanted)
    assert found["point"].tolist() == [f"b.jpg:{k}" for k in range(7)] + [
        f"a.jpg:{k}" for k in range(5)
    ]
    camera = read_camera(path, None, "1")
    assert (camera.fx_px, camera.cx_px, camera.distortion.k1) == (3000.0, 2000.0, 0.01)
    assert "neither orientations nor object points" in refusal(path, "colmap")


def test_databases_without_keypoints_or_damaged(tmp_path):
    path = database(tmp_path / "database.db", {})
    assert "no keypoints, but matches of 0 pairs" in refusal(path, "colmap")
    with closing(sqlite3.connect(path)) as content, content:
        content.execute("INSERT INTO matches VALUES (2147483649, 4, 2, NULL)")
    assert "no keypoints, but matches of 1 pair\n" in refusal(path, "colmap")
    log = tmp_path / "database.db-wal"
    log.write_bytes(b"\1" * 100)
    assert "database.db-wal next to it has rows" in refusal(path, "colmap")
    log.unlink()
    whole = database(tmp_path / "whole.db", {"a.jpg": np.ones((4000, 2))})
    with closing(sqlite3.connect(whole)) as content, content:
        content.execute("UPDATE keypoints SET rows = 4001")
    assert "'a.jpg' are 32000 bytes, not 4001 rows" in refusal(whole, "colmap")
    content = database(tmp_path / "cut.db", {"a.jpg": np.ones((40000, 2))}).read_bytes()
    for end in (0, 50, 5000, len(content) // 2, len(content) - 1000):
        (tmp_path / "cut.db").write_bytes(content[:end])
        refusal(tmp_path / "cut.db", "colmap")
    (tmp_path / "other.db").write_bytes(b"SQLite format 3\0" + b"\7" * 5000)
    assert "not such a database, or it is damaged" in refusal(tmp_path / "other.db", "colmap")


# OpenSfM


@pytest.fixture
def project(tmp_path):
    """A project of OpenSfM that was written for these tests: eight images, camera brown."""
    own = Path(__file__).resolve().parents[3] / "data" / "opensfm"
    shutil.copytree(own, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def berlin(tmp_path):
    """OpenSfM's own example as the folder of a project."""
    source = SHARED / "opensfm_berlin"
    shutil.copy(source / "reconstruction_example.json", tmp_path / "reconstruction.json")
    shutil.copy(source / "tracks_example.csv", tmp_path / "tracks.csv")
    return tmp_path


RECONSTRUCTIONS = [("project", (12_000, 9000), 80)]
if SHARED.is_dir():
    RECONSTRUCTIONS.append(("berlin", (3264, 2448), 2500))


@pytest.mark.parametrize(("fixture", "size_px", "least"), RECONSTRUCTIONS)
def test_points_of_opensfm_through_its_poses_land_on_its_tracks(request, fixture, size_px, least):
    """The definition: pixels of COLMAP, half a pixel and the axes included."""
    folder = request.getfixturevalue(fixture)
    table = read_block_images(folder, "opensfm")
    found = rows(folder, "opensfm")
    names, places = block_reader("opensfm").read_points(folder)
    place = dict(zip(names.to_pylist(), places, strict=True))
    camera = read_camera(folder, "opensfm", None)
    off = []
    for image, centre, q in zip(table.image, table.position, table.angles, strict=True):
        turn = Rotation.from_quat(q[[1, 2, 3, 0]])
        for row in found[(found["image"] == image) & found["point"].isin(place)].itertuples():
            seen = turn.apply(place[row.point] - centre)
            x, y = camera.project(*(np.array([c]) for c in seen[:2] / seen[2]))
            off.append((x[0] - row.x_px, y[0] - row.y_px))
    off = np.array(off)
    assert len(off) > least
    assert np.median(np.hypot(*off.T)) < 1.5
    # Half a pixel would be seen: the residuals have no mean.
    assert np.abs(np.median(off, axis=0)).max() < 0.2
    if fixture == "berlin":
        place = np.degrees([table.frame.lat_rad, table.frame.lon_rad])
        assert place.round(6).tolist() == [52.518963, 13.400377]
    assert {"scale", "red", "keypoint"} <= set(found)
    first = (folder / "tracks.csv").read_text().splitlines()[1].split("\t")
    row = found[(found["image"] == first[0]) & (found["keypoint"] == int(first[2]))].iloc[0]
    assert row["point"] == first[1]
    # Normalised by the longer side, from the middle; its own pixels count from a pixel's centre.
    assert row["x_px"] == pytest.approx(float(first[3]) * max(size_px) + (size_px[0] - 1) / 2 + 0.5)
    assert row["scale"] == float(first[5])


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("tracks.csv", ("_v2", "_v1"), "OPENSFM_TRACKS_VERSION_v1"),
        ("tracks.csv", ("IMG_0006.JPG\t1\t", "IMG_0006.JPG\t1\tx", 1), "line 3"),
        ("tracks.csv", ("OPENSFM_TRACKS_VERSION_v2\n", ""), "its first line is"),
        ("reconstruction.json", ('"brown"', '"spherical"'), "CAMERA-MODEL"),
        ("reconstruction.json", ('"rotation"', '"turn"'), "'IMG_0001.JPG' has no rotation"),
        ("reconstruction.json", ("[", "[[", 1), "is not valid JSON"),
        ("reconstruction.json", ('"cameras"', '"lenses"'), "it has no 'cameras'"),
    ],
)
def test_what_of_opensfm_cannot_be_read(project, file, change, words):
    text = (project / file).read_text()
    (project / file).write_text(text.replace(*change))
    assert words in refusal(project, "opensfm")


def test_a_project_of_two_reconstructions_or_without_tracks(project):
    (one,) = json.loads((project / "reconstruction.json").read_text())
    (project / "reconstruction.json").write_text(json.dumps([one, one]))
    assert "2 reconstructions" in refusal(project, "opensfm")
    (project / "tracks.csv").unlink()
    assert "a project of OpenSfM has a tracks.csv" in refusal(project, "opensfm")


# Metashape

MARKERS = """<document version="1.5.0"><chunk label="1"><sensors><sensor id="0" label="cam">
<calibration type="frame" class="adjusted"><resolution width="4000" height="3000"/><f>3000</f>
<cx>1</cx><cy>-2</cy></calibration></sensor></sensors><cameras>
<camera id="0" label="a.jpg" sensor_id="0"><transform>1 0 0 10 0 -1 0 20 0 0 -1 30 0 0 0 1
</transform></camera><camera id="1" label="b.jpg" sensor_id="0"/></cameras>
<markers><marker id="5" label="GCP 1"/></markers>
<frames><frame id="0"><markers><marker marker_id="5"><location camera_id="0" x="100.5" y="200.25"/>
<location camera_id="1" x="7.5" y="8.5"/></marker></markers></frame></frames>
<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>4100000 600000 4830000</translation>
<scale>2</scale></transform>
<reference>GEOGCS["WGS 84",DATUM["World Geodetic System 1984",
SPHEROID["WGS 84",6378137,298.257223563]],
PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]</reference></chunk></document>"""


def test_markers_of_metashape(tmp_path):
    path = tmp_path / "markers.xml"
    path.write_text(MARKERS)
    table = read_block_images(path, "metashape")
    found = rows(path, "metashape")
    assert table.frame == "ecef"
    # By hand: (10, 20, 30) turned about z by 90 degrees, twice as large, and moved.
    np.testing.assert_allclose(table.position[0], [4099960.0, 600020.0, 4830060.0])
    # The camera's x is the chunk's x, which is the earth's y; it looks down the third axis.
    turn = Rotation.from_quat(table.angles[0][[1, 2, 3, 0]])
    np.testing.assert_allclose(turn.apply([0, 1, 0]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn.apply([0, 0, -1]), [0, 0, 1], atol=1e-12)
    assert np.isnan(table.position[1]).all()
    assert found[["image", "point", "x_px", "y_px"]].to_numpy().tolist() == [
        ["a.jpg", "GCP 1", 100.5, 200.25],
        ["b.jpg", "GCP 1", 7.5, 8.5],
    ]
    local = MARKERS.replace('GEOGCS["WGS 84"', 'LOCAL_CS["Local Coordinates (m)"')
    path.write_text(local)
    assert read_block_images(path, "metashape").frame is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("1.5.0", "9.0"), "of version 9.0"),
        (('x="100.5"', ""), "it has no 'x'"),
        (("</document>", ""), "is not valid XML"),
        (("<chunk ", '<chunk label="old"/><chunk '), "it has 2 chunks ('old', "),
        (('class="adjusted"', 'class="initial"'), "no adjusted calibration"),
        (("1 0 0 10 0", "1 0 ten 10 0"), "not as that program writes it"),
        (("<cx>1</cx>", "<p3>0.1</p3>"), "p3 of a frame calibration"),
        (("a.jpg", "b.jpg"), "'b.jpg' occurs twice"),
    ],
)
def test_what_of_metashape_cannot_be_read(tmp_path, change, words):
    path = tmp_path / "markers.xml"
    path.write_text(MARKERS.replace(*change))
    assert words in refusal(path, "metashape")


@needs_blocks
def test_damaged_archives(tmp_path):
    source = SHARED / "dbat_sxb" / "sxb.psz"
    path = tmp_path / "a.psz"
    content = source.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "IMPORT-FORMAT" in refusal(path, "metashape")
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            part = old.read(name)
            new.writestr(name, part[:-5] if name == "projections3.ply" else part)
    assert "projections3.ply was cut off" in refusal(path, "metashape")
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(path, "w") as new:
        new.writestr("doc.xml", old.read("doc.xml"))
    assert "it does not contain projections0.ply" in refusal(path, "metashape")


# DBAT


@pytest.fixture
def strasbourg(tmp_path):
    """The toolbox's own example."""
    for file in (SHARED / "dbat_sxb").glob("*.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "sxb.xml"


@pytest.fixture(params=["written", "strasbourg"] if SHARED.is_dir() else ["written"])
def script(request, tmp_path):
    """The script of a project that is written here, and of the toolbox's example."""
    if request.param == "strasbourg":
        return request.getfixturevalue("strasbourg")
    write_project(tmp_path)
    return tmp_path / "sxb.xml"


def collinear(table, camera, point: np.ndarray, image: str) -> np.ndarray:
    (row,) = np.flatnonzero(table.image == image)
    seen = Rotation.from_quat(table.angles[row][[1, 2, 3, 0]]).apply(point - table.position[row])
    return np.ravel(camera.project(*(np.array([c]) for c in seen[:2] / seen[2])))


def test_control_points_of_dbat_through_its_report_land_on_its_marks(script):
    """Adjusted control points of the report, through its orientations: 1.1 px RMS, as it says."""
    table = read_block_images(script, "dbat")
    camera = read_camera(script, "dbat", None)
    report = (script.parent / "report.txt").read_text().split("Posterior")
    adjusted = {
        m[1]: np.array([float(m[k]) for k in (2, 3, 4)])
        for part in report[1:]
        for m in re.finditer(
            r"^ +(\d+), +([\d.]+), +([\d.]+), +([\d.]+),", part.split("Diff")[0], re.M
        )
    }
    found = rows(script, "dbat")
    found = found[found["point"].isin(adjusted)]
    # Two coordinates of each control mark, a line each, below the head.
    marked = (script.parent / "markpts.txt").read_text().splitlines()[1:]
    assert len(found) == len(marked) > 40
    off = np.array(
        [
            collinear(table, camera, adjusted[r.point], r.image) - [r.x_px, r.y_px]
            for r in found.itertuples()
        ]
    )
    assert np.sqrt((off**2).sum(axis=1).mean()) < 1.5


def test_archive_and_tables_hold_the_same_marks(strasbourg):
    """No half pixel lies between them: the marks of the archive are those of DBAT's table."""
    ours = rows(strasbourg, "dbat")
    ours = ours[ours["point"].astype(int) < 1000]
    theirs = rows(strasbourg.with_name("sxb.psz"), "metashape")
    theirs = theirs[~theirs["point"].str.startswith("tie:")]
    assert len(theirs) == 47
    for row in theirs.itertuples():
        same = ours[ours["image"] == row.image]
        off = np.hypot(same["x_px"] - row.x_px, same["y_px"] - row.y_px)
        assert off.min() < 6e-4, row
    cameras = [
        read_camera(strasbourg, "dbat", None),
        read_camera(strasbourg.with_name("sxb.psz"), "metashape", None),
    ]
    # 4430 and 6468 are 4429.5 and 6468.5 rounded to even: no rule of pixels moves both ways.
    assert [(c.cx_px, c.cy_px) for c in cameras] == [pytest.approx((4429.5, 6468.5)), (4430, 6468)]
    assert (round(4429.5), round(6468.5)) == (4430, 6468)


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("sxb.xml", ('dbat_script_version="1.0"', 'dbat_script_version="2.0"'), "version 2.0"),
        ("sxb.xml", ("<model>3</model>", "<model>-4</model>"), "model -4"),
        ("sxb.xml", ("<skew>0</skew>", "<skew>0.1</skew>"), "the skew of its camera"),
        ("sxb.xml", ("</document>", ""), "is not valid XML"),
        ("sxb.xml", ("measurements/smartpts.txt", "measurements/lost.txt"), "lost.txt"),
        ("sxb.xml", ("<report>", "<other>", 1), "is not valid XML"),
        ("markpts.txt", (", 1, ", ", 9, ", 1), "markpts.txt, line 2"),
        ("markpts.txt", (".", ",", 1), "line 2 is not"),
        ("smartpts.txt", (".", ".x", 1), "line 2 is not"),
        ("report.txt", ("Value:     ", "Value:x    ", 1), "8811.jpg is incomplete"),
    ],
)
def test_what_of_dbat_cannot_be_read(script, file, change, words):
    path = script.parent / file
    text = path.read_text(encoding="utf-8")
    assert change[0] in text
    path.write_text(text.replace(*change), encoding="utf-8")
    assert words in refusal(script, "dbat")


def test_lens_distortion_of_dbat_is_a_correction_in_powers_of_mm(script):
    """x_mm + K1 r^2 x is what projects: a pixel 20 mm from the centre, by hand."""
    text = script.read_text(encoding="utf-8")
    script.write_text(text.replace("<K>0,0,0</K>", "<K>1e-6,0,0</K>"), encoding="utf-8")
    camera = read_camera(script, "dbat", None)
    u = np.array([20.0 * (1.0 + 1e-6 * 400.0) / 123.9392])
    x, y = camera.project(u, np.zeros(1))
    assert x[0] == pytest.approx(4429.5 + 20.0 / 0.006, abs=1e-6)
    assert y[0] == pytest.approx(6468.5)
