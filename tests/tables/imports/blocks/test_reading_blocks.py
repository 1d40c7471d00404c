"""Blocks of other programs against those programs, and what is refused in them."""

import json
import re
import shutil
import sqlite3
import struct
import zipfile
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.dbat_project import write_project
from tests.tables.checks import assert_within
from tests.tables.imports.blocks.reading import (
    OPENSFM,
    SHARED,
    missed,
    places_of,
    read_everything,
    refusal,
    rows,
)
from unbend.errors import InputError
from unbend.tables.imports.blocks import read_block_images, read_camera

needs_blocks = pytest.mark.shared("ba")

# COLMAP

CAMERA = pycolmap.SensorType.CAMERA


def pose_of(turn, place):
    rotation = pycolmap.Rotation3d(turn.as_matrix())
    return pycolmap.Rigid3d(rotation, np.array(place))


@dataclass(frozen=True)
class Model:
    """A model of COLMAP, as pycolmap wrote it in both forms."""

    block: pycolmap.Reconstruction
    bin: Path
    txt: Path

    def file(self, name, form="txt"):
        return getattr(self, form) / f"{name}.{form}"

    def refusal(self, form="txt"):
        return refusal(getattr(self, form), "colmap")


@pytest.fixture
def model(tmp_path):
    """Eight images, four of a rig of two cameras that moves and turns: poses are composed."""
    draw = np.random.default_rng(13)
    block = pycolmap.Reconstruction()
    sensors = {}
    for number in (1, 2):
        camera = pycolmap.Camera(
            model="OPENCV",
            width=4000,
            height=3000,
            camera_id=number,
            params=[3000, 3010, 2001, 1502, -0.01, 0.002, 1e-4, -2e-4],
        )
        block.add_camera(camera)
        sensors[number] = pycolmap.sensor_t(CAMERA, number)
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(sensors[1])
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.1])
    rig.add_sensor(sensors[2], pose_of(turn, [0.2, -0.1, 0.05]))
    block.add_rig(rig)
    for k in range(4):
        frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
        turn = Rotation.from_rotvec(draw.normal(0.0, 0.2, 3))
        frame.rig_from_world = pose_of(turn, draw.normal(0, 50, 3))
        for camera, sensor in sensors.items():
            frame.add_data_id(pycolmap.data_t(sensor, 2 * k + camera))
        block.add_frame(frame)
        for camera in sensors:
            image = pycolmap.Image(
                name=f"strip {k}/of {camera}.jpg",  # COLMAP's names are paths, and have blanks
                keypoints=draw.uniform(0.0, 3000.0, (5 * k, 2)),
                camera_id=camera,
                image_id=2 * k + camera,
            )
            image.frame_id = k + 1
            block.add_image(image)
        block.register_frame(k + 1)
    for i in range(5):
        elements = [pycolmap.TrackElement(image, i) for image in (3, 4, 5, 6)]
        block.add_point3D(draw.normal(0, 100, 3), pycolmap.Track(elements))
    written = Model(block, tmp_path / "bin", tmp_path / "txt")
    written.bin.mkdir()
    written.txt.mkdir()
    block.write_binary(str(written.bin))
    block.write_text(str(written.txt))
    return written


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_model_is_what_pycolmap_says(model, form):
    folder = getattr(model, form)
    images = {image.name: image for image in model.block.images.values()}

    table = read_block_images(folder, "colmap")

    expected = [images[name] for name in table.image]
    assert len(expected) == len(images)
    assert table.camera.tolist() == [str(image.camera_id) for image in expected]
    centres = [image.projection_center() for image in expected]
    assert_within(table.position, centres, 1e-9)
    turns = Rotation.from_quat(table.angles, scalar_first=True).as_matrix()
    matrices = [image.cam_from_world().rotation.matrix() for image in expected]
    assert_within(turns, matrices, 1e-12)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_points_of_a_model_are_what_pycolmap_says(model, form):
    folder = getattr(model, form)

    image_points = rows(folder, "colmap")
    places = places_of(folder, "colmap")

    for image in model.block.images.values():
        points = []
        for keypoint, point in enumerate(image.points2D):
            name = f"{image.name}:{keypoint}"
            if point.has_point3D():
                name = str(point.point3D_id)
            points.append([*point.xy, name, keypoint])
        of_image = image_points[image_points["image"] == image.name]
        columns = of_image[["x_px", "y_px", "point", "keypoint"]]
        assert columns.to_numpy().tolist() == points
    assert len(places) == 5
    for name, place in places.items():
        assert_array_equal(place, model.block.points3D[int(name)].xyz)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_model_that_is_cut_anywhere_is_refused(model, name, form):
    """By file, and by byte or line; pycolmap takes a cameras.bin that is cut short silently."""
    folder = getattr(model, form)
    file = model.file(name, form)
    content = file.read_bytes()
    for end in np.linspace(0, len(content) - 2, 12).astype(int):
        file.write_bytes(content[:end])
        try:
            read_everything(folder, "colmap")
            places = places_of(folder, "colmap")
        except InputError as error:
            text = str(error)
            assert file.name in text or end == 0 or "OBS-EMPTY" in text or "CAMERA-" in text
            assert re.search(r"cut off|line \d+|model number|OBS-EMPTY|CAMERA-", text), text
        else:
            if places:  # in the last line, of whose end no other file knows
                assert (name, form) in {("cameras", "txt"), ("images", "txt")}, end
                assert b"\n" not in content[end:].strip(), end
                (note,) = read_block_images(folder, "colmap").notes
                assert note.code == "COLMAP-COUNT"
            else:
                assert name == "points3D", end  # which ground.height: block refuses


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("count", [b"1", b"200"])
def test_a_count_in_a_comment_and_a_missing_end_do_not_matter(model, name, count):
    """Nothing else is missing: images and points name each other."""
    whole = rows(model.txt, "colmap")
    file = model.file(name)
    content = file.read_bytes()
    changed = re.sub(rb"(?m)^(# Number of \w+: )\d+", rb"\g<1>" + count, content)
    assert changed != content
    file.write_bytes(changed.removesuffix(b"\n"))

    pd.testing.assert_frame_equal(rows(model.txt, "colmap"), whole)
    assert len(places_of(model.txt, "colmap")) == 5
    notes = read_block_images(model.txt, "colmap").notes
    assert {note.code for note in notes} == {"COLMAP-COUNT"}
    expected_notes = 2 if name == "images" else 1
    assert len(notes) == expected_notes


def test_images_without_their_points_are_missing(model):
    """A line of an image is gone, which the tracks of the points name."""
    file = model.file("images")
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-2]))
    assert "cut off after 7 of 8 records" in model.refusal()


def test_other_versions_and_models(model):
    cameras = model.file("cameras", "bin")
    content = cameras.read_bytes()
    model_40 = struct.pack("<i", 40)
    cameras.write_bytes(content[:12] + model_40 + content[16:])
    assert "camera model number 40 is not known" in model.refusal("bin")

    cameras.write_bytes(content)
    images = model.file("images", "bin")
    images.write_bytes(images.read_bytes() + b"\0" * 8)
    assert "8 extra bytes at the end" in model.refusal("bin")


def test_a_model_of_a_camera_that_is_not_known_is_named_with_its_line(model):
    file = model.file("cameras")
    content = file.read_text()
    before, *_ = content.partition("OPENCV")
    line = before.count("\n") + 1
    file.write_text(content.replace("OPENCV", "THIN_PRISM_FISHEYE"))

    text = model.refusal()

    assert "CAMERA-MODEL" in text
    assert f"line {line}" in text
    assert "camera " in text


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        (1, "3.5", "'strip 2/of 1.jpg' is not a rotation"),
        (1, "one", "line {} is not"),
        (8, "9", "in line {}, 'strip 2/of 1.jpg' has camera 9, which is not in cameras.txt"),
    ],
)
def test_poses_that_are_no_rotations_and_cameras_that_are_not_there(model, field, value, words):
    file = model.file("images")
    lines = file.read_text().splitlines()
    (row,) = [k for k, line in enumerate(lines) if line.endswith("strip 2/of 1.jpg")]
    fields = lines[row].split(" ", 9)
    fields[field] = value
    lines[row] = " ".join(fields)
    file.write_text("\n".join(lines) + "\n")

    assert words.format(row + 1) in model.refusal()


def test_images_that_stand_twice_and_points_that_are_missing(model):
    file = model.file("images")
    text = file.read_text()
    file.write_text(text.replace("strip 2/of 1.jpg", "strip 2/of 2.jpg"))
    assert "'strip 2/of 2.jpg' occurs twice" in model.refusal()

    model.file("points3D").unlink()
    assert "has a points3D.txt" in model.refusal()


def write_database(name, keypoints: dict[str, np.ndarray]):
    """By pycolmap, as its feature extractor writes it."""
    path = Path(name)
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL",
        width=4000,
        height=3000,
        params=[3000.0, 2000.0, 1500.0, 0.01],
    )
    with closing(pycolmap.Database.open(str(path))) as database:
        number = database.write_camera(camera)
        for image_name, xy in keypoints.items():
            image = pycolmap.Image(name=image_name, camera_id=number)
            image_id = database.write_image(image)
            database.write_keypoints(image_id, xy.astype(np.float32))
    return path


def test_a_database():
    draw = np.random.default_rng(1)
    keypoints = {
        "b.jpg": draw.uniform(0, 3000, (7, 2)),
        "a.jpg": draw.uniform(0, 3000, (5, 6)),
        "none.jpg": np.empty((0, 2)),
    }
    path = write_database("database.db", keypoints)

    table = rows(path, "colmap")
    camera = read_camera(path, None, "1")

    pixels = np.concatenate([keypoints["b.jpg"], keypoints["a.jpg"][:, :2]])
    assert_array_equal(table[["x_px", "y_px"]], pixels.astype(np.float32))
    points_of_b = [f"b.jpg:{k}" for k in range(7)]
    points_of_a = [f"a.jpg:{k}" for k in range(5)]
    assert table["point"].tolist() == points_of_b + points_of_a
    assert camera.fx_px == 3000.0
    assert camera.cx_px == 2000.0
    assert camera.distortion.k1 == 0.01
    assert "neither orientations nor object points" in refusal(path, "colmap")


def test_databases_without_keypoints():
    path = write_database("database.db", {})
    assert "no keypoints, but matches of 0 pairs" in refusal(path, "colmap")

    with closing(sqlite3.connect(path)) as content, content:
        content.execute("INSERT INTO matches VALUES (2147483649, 4, 2, NULL)")
    assert "no keypoints, but matches of 1 pair\n" in refusal(path, "colmap")

    Path("database.db-wal").write_bytes(b"\1" * 100)
    assert "database.db-wal next to it has rows" in refusal(path, "colmap")


def test_damaged_databases():
    keypoints = {"a.jpg": np.ones((4000, 2))}
    path = write_database("whole.db", keypoints)
    with closing(sqlite3.connect(path)) as content, content:
        content.execute("UPDATE keypoints SET rows = 4001")
    assert "'a.jpg' are 32000 bytes, not 4001 rows" in refusal(path, "colmap")

    keypoints = {"a.jpg": np.ones((40000, 2))}
    path = write_database("cut.db", keypoints)
    content = path.read_bytes()
    ends = (
        0,
        50,
        5000,
        len(content) // 2,
        len(content) - 1000,
    )
    for end in ends:
        path.write_bytes(content[:end])
        refusal(path, "colmap")

    path.write_bytes(b"SQLite format 3\0" + b"\7" * 5000)
    assert "not such a database, or it is damaged" in refusal(path, "colmap")


# Points through poses and cameras


@pytest.fixture
def project(tmp_path):
    """A project of OpenSfM that was written for these tests: eight images, camera brown."""
    shutil.copytree(OPENSFM, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def berlin(tmp_path):
    """OpenSfM's own example as the folder of a project."""
    source = SHARED / "opensfm_berlin"
    shutil.copy(source / "reconstruction_example.json", tmp_path / "reconstruction.json")
    shutil.copy(source / "tracks_example.csv", tmp_path / "tracks.csv")
    return tmp_path


@pytest.fixture
def archive():
    """The archive of Metashape's beside DBAT's example."""
    return SHARED / "dbat_sxb" / "sxb.psz"


BLOCKS = [("project", "opensfm", 80)]
if SHARED.is_dir():
    BLOCKS += [
        ("berlin", "opensfm", 2500),
        ("archive", "metashape", 1000),
    ]


@pytest.mark.parametrize(("fixture", "program", "least"), BLOCKS)
def test_points_through_poses_and_camera_land_on_their_image_points(
    request, fixture, program, least
):
    """The definition: pixels of COLMAP, half a pixel and the axes included."""
    path = request.getfixturevalue(fixture)
    places = places_of(path, program)

    missed_px = missed(path, program, places)

    assert len(missed_px) > least
    assert np.median(np.hypot(*missed_px.T)) < 1.5
    # Half a pixel would be seen: the residuals have no mean.
    assert np.abs(np.median(missed_px, axis=0)).max() < 0.2


# OpenSfM


@needs_blocks
def test_a_project_of_opensfm_says_where_it_is(berlin):
    frame = read_block_images(berlin, "opensfm").frame
    assert_within(np.degrees(frame.lat_rad), 52.518963, 5e-7)
    assert_within(np.degrees(frame.lon_rad), 13.400377, 5e-7)


def test_a_track_of_opensfm_is_normalised_by_the_longer_side(project):
    """From the middle; its own pixels count from a pixel's centre."""
    table = rows(project, "opensfm")
    first = (project / "tracks.csv").read_text().splitlines()[1]
    image, point, keypoint, x, y, scale, *_ = first.split("\t")
    of_image = table[table["image"] == image].set_index("keypoint")
    row = of_image.loc[int(keypoint)]
    assert row["point"] == point
    assert row["x_px"] == pytest.approx(float(x) * 12_000 + 6000.0)
    assert row["y_px"] == pytest.approx(float(y) * 12_000 + 4500.0)
    assert row["scale"] == float(scale)
    assert "red" in table


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (
            "tracks.csv",
            ("_v2", "_v1"),
            "OPENSFM_TRACKS_VERSION_v1",
        ),
        (
            "tracks.csv",
            ("IMG_0006.JPG\t1\t", "IMG_0006.JPG\t1\tx", 1),
            "line 3",
        ),
        (
            "tracks.csv",
            ("OPENSFM_TRACKS_VERSION_v2\n", ""),
            "its first line is",
        ),
        (
            "reconstruction.json",
            ('"brown"', '"spherical"'),
            "CAMERA-MODEL",
        ),
        (
            "reconstruction.json",
            ('"rotation"', '"turn"'),
            "'IMG_0001.JPG' has no rotation",
        ),
        (
            "reconstruction.json",
            ("[", "[[", 1),
            "is not valid JSON",
        ),
        (
            "reconstruction.json",
            ('"cameras"', '"lenses"'),
            "it has no 'cameras'",
        ),
    ],
)
def test_what_of_opensfm_cannot_be_read(project, file, change, words):
    path = project / file
    path.write_text(path.read_text().replace(*change))
    assert words in refusal(project, "opensfm")


def test_a_project_of_two_reconstructions_or_without_tracks(project):
    path = project / "reconstruction.json"
    (reconstruction,) = json.loads(path.read_text())
    path.write_text(json.dumps([reconstruction, reconstruction]))
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


def test_markers_of_metashape():
    path = Path("markers.xml")
    path.write_text(MARKERS)

    table = read_block_images(path, "metashape")

    assert table.frame == "ecef"
    # By hand: (10, 20, 30) turned about z by 90 degrees, twice as large, and moved.
    assert_allclose(table.position[0], [4099960.0, 600020.0, 4830060.0])
    # The camera's x is the chunk's x, which is the earth's y; it looks down the third axis.
    turn = Rotation.from_quat(table.angles[0], scalar_first=True)
    assert_within(turn.apply([0, 1, 0]), [1, 0, 0], 1e-12)
    assert_within(turn.apply([0, 0, -1]), [0, 0, 1], 1e-12)
    assert np.isnan(table.position[1]).all()
    image_points = rows(path, "metashape")
    columns = image_points[["image", "point", "x_px", "y_px"]]
    assert columns.to_numpy().tolist() == [
        ["a.jpg", "GCP 1", 100.5, 200.25],
        ["b.jpg", "GCP 1", 7.5, 8.5],
    ]


def test_a_local_system_of_metashape_is_no_frame():
    path = Path("markers.xml")
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
        (("1 0 0 10 0", "1 0.5 0 10 0"), "'a.jpg' is not a rotation"),
        (("1 0 0 10 0", "-1 0 0 10 0"), "'a.jpg' is not a rotation"),
        (("<cx>1</cx>", "<p3>0.1</p3>"), "p3 of a frame calibration"),
        (("a.jpg", "b.jpg"), "'b.jpg' occurs twice"),
    ],
)
def test_what_of_metashape_cannot_be_read(change, words):
    path = Path("markers.xml")
    path.write_text(MARKERS.replace(*change))
    assert words in refusal(path, "metashape")


@needs_blocks
@pytest.mark.parametrize(
    ("part", "content", "words"),
    [
        ("projections3.ply", slice(None, -5), "projections3.ply was cut off"),
        ("projections0.ply", None, "it does not contain projections0.ply"),
    ],
)
def test_damaged_parts_of_archives(archive, part, content, words):
    path = Path("a.psz")
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(path, "w") as damaged:
        for name in source.namelist():
            if name != part:
                damaged.writestr(name, source.read(name))
            elif content is not None:
                damaged.writestr(name, source.read(name)[content])
    assert words in refusal(path, "metashape")


def test_an_archive_that_is_cut_off():
    path = Path("a.psz")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("doc.xml", MARKERS)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "IMPORT-FORMAT" in refusal(path, "metashape")


# DBAT


@pytest.fixture
def strasbourg(tmp_path):
    """The toolbox's own example."""
    for file in (SHARED / "dbat_sxb").glob("*.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "sxb.xml"


SCRIPTS = ["written"]
if SHARED.is_dir():
    SCRIPTS.append("strasbourg")


@pytest.fixture(params=SCRIPTS)
def script(request, tmp_path):
    """The script of a project that is written here, and of the toolbox's example."""
    if request.param == "strasbourg":
        return request.getfixturevalue("strasbourg")
    write_project(tmp_path)
    return tmp_path / "sxb.xml"


ADJUSTED_POINT = re.compile(r"^ +(\d+), +([\d.]+), +([\d.]+), +([\d.]+),", re.MULTILINE)


def adjusted_points(report):
    """The control points of a report as they were adjusted."""
    points = {}
    for part in report.read_text().split("Posterior")[1:]:
        adjusted, *_ = part.split("Diff")
        for name, *place in ADJUSTED_POINT.findall(adjusted):
            points[name] = np.array(place, float)
    return points


def test_control_points_of_dbat_through_its_report_land_on_its_marks(script):
    """Adjusted control points of the report, through its orientations: 1.1 px RMS, as it says."""
    points = adjusted_points(script.with_name("report.txt"))

    missed_px = missed(script, "dbat", points)

    # Two coordinates of each control mark, a line each, below the head.
    marks = script.with_name("markpts.txt").read_text().splitlines()[1:]
    assert len(missed_px) == len(marks) > 40
    distances_px = np.hypot(*missed_px.T)
    assert np.sqrt(np.mean(distances_px**2)) < 1.5


def test_archive_and_tables_hold_the_same_marks(strasbourg):
    """No half pixel lies between them: the marks of the archive are those of DBAT's table."""
    of_tables = rows(strasbourg, "dbat")
    of_tables = of_tables[of_tables["point"].astype(int) < 1000]
    of_archive = rows(strasbourg.with_name("sxb.psz"), "metashape")
    of_archive = of_archive[~of_archive["point"].str.startswith("tie:")]
    assert len(of_archive) == 47
    for row in of_archive.itertuples():
        marks = of_tables[of_tables["image"] == row.image]
        apart = np.hypot(marks["x_px"] - row.x_px, marks["y_px"] - row.y_px)
        assert apart.min() < 6e-4, row


def test_archive_and_tables_hold_the_same_camera(strasbourg):
    of_tables = read_camera(strasbourg, "dbat", None)
    of_archive = read_camera(strasbourg.with_name("sxb.psz"), "metashape", None)
    # DBAT's reading: 123.9392 mm, pixels of 6 um.
    assert of_archive.fx_px == pytest.approx(123.9392 / 0.006, abs=0.05)
    assert of_tables.cx_px == pytest.approx(4429.5)
    assert of_tables.cy_px == pytest.approx(6468.5)
    # 4430 and 6468 are 4429.5 and 6468.5 rounded to even: no rule of pixels moves both ways.
    assert of_archive.cx_px == 4430
    assert of_archive.cy_px == 6468


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (
            "sxb.xml",
            ('dbat_script_version="1.0"', 'dbat_script_version="2.0"'),
            "version 2.0",
        ),
        (
            "sxb.xml",
            ("<model>3</model>", "<model>-4</model>"),
            "model -4",
        ),
        (
            "sxb.xml",
            ("<skew>0</skew>", "<skew>0.1</skew>"),
            "the skew of its camera",
        ),
        (
            "sxb.xml",
            ("</document>", ""),
            "is not valid XML",
        ),
        (
            "sxb.xml",
            ("measurements/smartpts.txt", "measurements/lost.txt"),
            "lost.txt",
        ),
        (
            "sxb.xml",
            ("<report>", "<other>", 1),
            "is not valid XML",
        ),
        (
            "sxb.xml",
            ("report>", "other>"),
            "the script names no report",
        ),
        (
            "markpts.txt",
            (", 1, ", ", 9, ", 1),
            "markpts.txt, line 2",
        ),
        (
            "markpts.txt",
            (".", ",", 1),
            "line 2 is not",
        ),
        (
            "smartpts.txt",
            (".", ".x", 1),
            "line 2 is not",
        ),
        (
            "report.txt",
            ("Value:     ", "Value:x    ", 1),
            "8811.jpg is incomplete",
        ),
    ],
)
def test_what_of_dbat_cannot_be_read(script, file, change, words):
    path = script.parent / file
    text = path.read_text("utf-8")
    assert change[0] in text
    path.write_text(text.replace(*change), "utf-8")
    assert words in refusal(script, "dbat")


def test_a_script_of_dbat_with_two_cameras_says_so(script):
    text = script.read_text("utf-8")
    before, camera, after = re.split("(<camera>.*</camera>)", text, flags=re.DOTALL)
    other = camera.replace("<camera>", "<camera><id>7</id>")
    script.write_text(before + camera + other + after, "utf-8")
    said = refusal(script, "dbat")
    assert "it has 2 cameras; only one can be read" in said
    assert "report" not in said


def test_lens_distortion_of_dbat_is_a_correction_in_powers_of_mm(script):
    """x_mm + K1 r^2 x is what projects: a pixel 20 mm from the centre, by hand."""
    text = script.read_text("utf-8")
    text = text.replace("<K>0,0,0</K>", "<K>1e-6,0,0</K>")
    script.write_text(text, "utf-8")

    camera = read_camera(script, "dbat", None)

    u = 20.0 * (1.0 + 1e-6 * 400.0) / 123.9392
    (x_px,), (y_px,) = camera.project(np.array([u]), np.zeros(1))
    assert x_px == pytest.approx(4429.5 + 20.0 / 0.006, abs=1e-6)
    assert y_px == pytest.approx(6468.5)
