"""`unbend export --format calibration`, loaded by the programs it is for: poses are held.

The clients are pycolmap, which reads the exported cameras.txt and adjusts the points, and for
programs that correct measured points the formula of the report, written out here.
"""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import yaml

from tests.golden.held_block import (
    CX,
    CY,
    FIVE,
    FOCAL,
    HEIGHT,
    LENS,
    NADIR,
    WIDTH,
    HeldBlock,
    fly,
    intersected,
    write_mission,
)
from tests.helpers import refused
from tests.lens import brown, metashape_pixels
from unbend.batch.finished_run.export import export_run

from .conftest import run_mission

pytest.importorskip("pycolmap")

import pycolmap

from .bundle_adjustment import Adjustment

PIXEL_MM = 0.005


class Exported:
    """A block, its run and the folder of its calibrations."""

    def __init__(
        self,
        block,
        folder,
        **options,
    ):
        self.block = block
        self.folder = folder / "calibration"
        outcome = run_mission(write_mission(block, folder))
        assert outcome.exit_code == 0
        self.run = outcome.output
        written = export_run(self.run, "calibration", self.folder, options)
        assert written.rows == len(block.image)
        self.ledger = written.ledger
        self.report = (self.folder / "calibration.txt").read_text("utf-8")
        images = pd.read_csv(self.folder / "images.csv", index_col="image")
        self.names = images["calibration"].unique().tolist()
        calibrations = images["calibration"][block.image]
        self.calibration_of_image = pd.Index(self.names).get_indexer(calibrations)

    @property
    def measured(self):
        """(r, 2) the measured pixels."""
        return self.block.rows[["x_px", "y_px"]].to_numpy()

    def corrected(self):
        """(r, 2) the run's own corrected pixels, in the order of the block's rows."""
        table = pd.read_parquet(self.run / "observations")
        return table[["x_corrected_px", "y_corrected_px"]].to_numpy()


@pytest.fixture(scope="module")
def nadir(tmp_path_factory):
    return Exported(
        fly(
            6000.0,
            NADIR,
            seed=11,
        ),
        tmp_path_factory.mktemp("nadir"),
        pixel_um=1000.0 * PIXEL_MM,
    )


@pytest.fixture(scope="module")
def five(tmp_path_factory):
    return Exported(
        fly(
            6000.0,
            FIVE,
            seed=12,
        ),
        tmp_path_factory.mktemp("five"),
    )


def colmap_cameras(folder, work):
    """The cameras of an exported cameras.txt, read by pycolmap as part of a model."""
    work.mkdir()
    (work / "cameras.txt").write_bytes((folder / "cameras.txt").read_bytes())
    for name in ("images.txt", "points3D.txt"):
        (work / name).write_text("", "utf-8")
    return dict(pycolmap.Reconstruction(str(work)).cameras)


def adjusted(exported, pixels, cameras):
    """(p, 3) errors of points that pycolmap adjusts with poses and cameras held."""
    block = exported.block
    adjustment = Adjustment()
    for camera in cameras.values():
        adjustment.add_camera(camera)
    centre = block.in_frame(block.centre)
    rotation = block.camera_from_frame
    for k, rows in block.rows.groupby("image"):
        adjustment.add_image(
            block.image[k],
            int(exported.calibration_of_image[k]) + 1,
            pixels[rows.index],
            rows["point"],
            rotation[k],
            centre[k],
        )
    true = block.in_frame(block.place)
    for point in adjustment.tracks:
        adjustment.add_point(point, true[point])

    adjustment.options.refine_rig_from_world = False
    adjustment.converge_tightly()
    adjustment.solve()

    errors = [adjustment.position(point) - true[point] for point in adjustment.numbers]
    return np.array(errors)


def laboratory_camera(number):
    """The user's own calibration."""
    k1, k2, p1, p2, k3 = LENS
    return pycolmap.Camera(
        model="FULL_OPENCV",
        width=WIDTH,
        height=HEIGHT,
        params=[FOCAL, FOCAL, CX, CY, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
        camera_id=number,
    )


def rms_z(errors):
    return np.sqrt(np.mean(errors[:, 2] ** 2))


@pytest.mark.parametrize(
    ("name", "least_m", "most_left"), [("nadir", 0.3, 0.05), ("five", 0.6, 0.03)]
)
def test_pycolmap_finds_the_points_with_the_exported_cameras(
    name, least_m, most_left, request, tmp_path
):
    """Uncorrected points, held poses: 0.35 m become 0.013 m, five heads' 0.81 m 0.017 m."""
    exported = request.getfixturevalue(name)
    cameras = colmap_cameras(exported.folder, tmp_path / "model")
    laboratory = {number: laboratory_camera(number) for number in range(1, len(exported.names) + 1)}

    before = adjusted(exported, exported.measured, laboratory)
    after = adjusted(exported, exported.measured, cameras)
    lattice = adjusted(exported, exported.corrected(), laboratory)

    before_m = rms_z(before)
    assert before_m > least_m
    assert rms_z(after) < most_left * before_m
    assert rms_z(lattice) < 0.001
    assert np.mean(before[:, 2]) > 0.9 * before_m  # too high: the calibration's sign
    assert not exported.ledger.has_losses


NUMBER = r"([-+0-9.e]+)"


def change_in(report, name, unit):
    """What a user reads in the report: numbers of a calibration, in px or mm."""
    part = report[report.index(f"{name}: ") :]
    text = part[part.index(f"    in {unit}: c ") :]
    frame = re.match(rf".*c {NUMBER} \S+ -> {NUMBER}; principal point {NUMBER}, {NUMBER}\n", text)
    change = dict(zip(("c0", "c", "x0", "y0"), map(float, frame.groups()), strict=True))
    for term in ("K1", "K2", "K3", "P1", "P2", "B1", "B2"):
        change[term] = float(re.search(rf"{term} {NUMBER}", text).group(1))
    return change


@pytest.mark.parametrize(
    ("name", "unit", "size", "most_left"),
    [("nadir", "px", 1.0, 0.05), ("nadir", "mm", PIXEL_MM, 0.05), ("five", "px", 1.0, 0.03)],
)
def test_a_program_that_corrects_points_finds_them_with_the_report(
    name, unit, size, most_left, request
):
    """BINGO's, Inpho's and the USGS' way: x right, y up, what is added, and a new c."""
    exported = request.getfixturevalue(name)
    block = exported.block
    # The user's own calibration, by the inverse of the lens: pycolmap's.
    ideal = laboratory_camera(1).cam_from_img(exported.measured)
    upwards = np.array([size, -size])
    x, y = ((exported.measured - [CX, CY]) * upwards).T
    r2 = x * x + y * y

    tangents = np.empty_like(ideal)
    calibration_of_row = exported.calibration_of_image[block.rows["image"]]
    for number, calibration in enumerate(exported.names):
        c = change_in(exported.report, calibration, unit)
        assert c["c0"] == pytest.approx(FOCAL * size)
        radial = c["K1"] * r2 + c["K2"] * r2**2 + c["K3"] * r2**3
        dx = -c["x0"] + x * radial + c["P1"] * (r2 + 2 * x * x) + 2 * c["P2"] * x * y
        dy = -c["y0"] + y * radial + c["P2"] * (r2 + 2 * y * y) + 2 * c["P1"] * x * y
        dx += c["B1"] * x + c["B2"] * y
        ray = (ideal * FOCAL + np.column_stack([dx, dy]) / upwards) / (c["c"] / size)
        rows = calibration_of_row == number
        tangents[rows] = ray[rows]

    before_m = rms_z(intersected(block, ideal))
    assert rms_z(intersected(block, tangents)) < most_left * before_m


@pytest.mark.parametrize(("above", "ppm"), [(3000.0, 34.0), (6000.0, 59.0)])
def test_straight_down_the_change_is_k(above, ppm, tmp_path):
    """34 ppm at 3 km and 59 ppm at 6 km over ground at sea level, in both kinds of model."""
    k = 1e-6 * ppm
    block = fly(
        above,
        NADIR,
        seed=3,
        wobble_deg=0.1,
        ground=0.0,
        relief=0.0,
    )

    exported = Exported(block, tmp_path)

    change = change_in(exported.report, exported.names[0], "px")
    assert change["c"] / change["c0"] - 1.0 == pytest.approx(k, rel=0.02)
    assert change["K1"] * change["c0"] ** 2 == pytest.approx(-k, rel=0.05)
    (camera,) = colmap_cameras(exported.folder, tmp_path / "model").values()
    assert camera.focal_length_x / FOCAL - 1.0 == pytest.approx(k, rel=0.02)
    assert camera.params[4] - LENS[0] == pytest.approx(k, rel=0.05)
    table = pd.read_csv(exported.folder / "corrections.csv")
    # With c as it was, all of it is in the table: -K (r + r^3 / c^2).
    r = table["radius_px"] / FOCAL
    expected = -k * (r + r**3) * FOCAL
    np.testing.assert_allclose(
        table["dr_same_c_px"],
        expected,
        atol=0.02 * expected.abs().max(),
    )
    assert table["radius_mm"].isna().all()


def pixels_of_metashape(
    folder,
    name,
    u,
    v,
):
    xml = ElementTree.parse(folder / f"{name}.xml").getroot()
    numbers = {tag.tag: float(tag.text) for tag in xml if tag.tag != "projection"}
    return metashape_pixels(numbers, "frame", u, v)


def opensfm_pixels(
    folder,
    name,
    u,
    v,
):
    """pixel = normalised * max(w, h) + (w - 1) / 2, its first pixel's centre at 0."""
    models = json.loads((folder / "camera_models.json").read_text("utf-8"))
    o = models[name]
    assert o["projection_type"] == "brown"
    x, y = brown(
        u,
        v,
        o["k1"],
        o["k2"],
        o["p1"],
        o["p2"],
        o["k3"],
    )
    x_px = (o["focal_x"] * x + o["c_x"]) * WIDTH + (WIDTH - 1) / 2 + 0.5
    y_px = (o["focal_y"] * y + o["c_y"]) * WIDTH + (HEIGHT - 1) / 2 + 0.5
    return np.array([x_px, y_px])


def opencv_pixels(
    folder,
    name,
    u,
    v,
):
    text = (folder / f"{name}.yaml").read_text("utf-8")
    text = text.removeprefix("%YAML:1.0\n---\n").replace("!!opencv-matrix", "")
    cv = yaml.safe_load(text)
    fx, _, cx, _, fy, cy, *_ = cv["camera_matrix"]["data"]
    x, y = brown(u, v, *cv["distortion_coefficients"]["data"])
    return np.array([fx * x + cx + 0.5, fy * y + cy + 0.5])


def test_every_file_is_the_same_camera(five, tmp_path):
    """Metashape's, OpenSfM's and OpenCV's formulas, written out, give pycolmap's pixels."""
    text = (five.folder / "cameras.txt").read_text("utf-8")
    names = re.findall(r"^# \d+: (.*)$", text, re.M)
    models = json.loads((five.folder / "camera_models.json").read_text("utf-8"))
    assert names == five.names == list(models)

    u, v = map(np.ravel, np.meshgrid([-0.3, 0.1, 0.33], [-0.25, 0.05, 0.2]))
    cameras = colmap_cameras(five.folder, tmp_path / "model")
    assert len(cameras) == len(names)
    for number, name in enumerate(names, start=1):
        camera = cameras[number]
        assert camera.model.name == "FULL_OPENCV"
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
        rays = np.column_stack([u, v, np.ones(u.size)])
        expected = camera.img_from_cam(rays).T
        for pixels_of in (pixels_of_metashape, opensfm_pixels, opencv_pixels):
            pixels = pixels_of(five.folder, name, u, v)
            np.testing.assert_allclose(pixels, expected, atol=1e-7)


def test_the_report_says_what_is_left_and_what_to_do(nadir, five):
    for exported in (nadir, five):
        for words in ("must keep all parameters", "0.16 m for each", "flying height", "px", " m"):
            assert words in exported.report

    pair = rf" +{NUMBER} px +{NUMBER} m"
    effect = re.search("refraction" + pair, nadir.report)
    effect_px, effect_m = map(float, effect.groups())
    left = re.search("left by the cameras in the files" + pair, nadir.report)
    moved_px = np.linalg.norm(nadir.corrected() - nadir.measured, axis=1)
    rms_px = np.sqrt(np.mean(moved_px**2))
    assert effect_px == pytest.approx(rms_px, abs=2e-4)
    # Across the ray 6 km below, obliquely a little more: a pixel is 0.3 m.
    assert effect_m == pytest.approx(0.3 * effect_px, rel=0.1)
    assert float(left.group(1)) < 0.1 * effect_px


@pytest.mark.parametrize(("wobble_deg", "exit_code"), [(6.0, 3), (25.0, 6)])
def test_images_that_differ_are_flagged_or_refused(tmp_path, unbend, wobble_deg, exit_code):
    """One camera whose pitch changes by 10 degrees, and by 30, from image to image."""
    block = fly(3000.0, NADIR, seed=5, wobble_deg=wobble_deg)
    run = run_mission(write_mission(block, tmp_path)).output
    out = tmp_path / "out"

    ended = unbend("export", run, "--format", "calibration", "--out", out)

    assert ended.code == exit_code, ended.text
    assert "EXPORT-RESIDUAL" in ended.text
    assert out.exists() == (exit_code == 3)
    if exit_code == 6:
        assert "export corrected points (--format bundler" in ended.text


def test_each_flying_height_has_its_own(tmp_path):
    """Half of a block at 3 km, half at 6 km: two calibrations of one camera."""
    low = fly(3000.0, NADIR, seed=7)
    high = fly(6000.0, NADIR, seed=8)
    high.image = np.char.add("high_", high.image)
    high.point = np.char.add("high_", high.point)
    high.rows["image"] += len(low.image)
    high.rows["point"] += len(low.point)
    arrays = {}
    for name in ("image", "camera", "centre", "camera_from_enu", "point", "place"):
        arrays[name] = np.concatenate([getattr(low, name), getattr(high, name)])
    both = HeldBlock(
        **arrays,
        rows=pd.concat([low.rows, high.rows], ignore_index=True),
    )

    exported = Exported(both, tmp_path)

    low_name, high_name = exported.names
    assert (exported.calibration_of_image == np.repeat([0, 1], 20)).all()
    low_c = change_in(exported.report, low_name, "px")["c"]
    high_c = change_in(exported.report, high_name, "px")["c"]
    assert (high_c - FOCAL) / (low_c - FOCAL) == pytest.approx(59.0 / 34.0, rel=0.05)


def test_a_calibration_that_has_refraction_in_would_count_twice(nadir, tmp_path):
    path = write_mission(nadir.block, tmp_path)
    sections = yaml.safe_load(path.read_text("utf-8"))
    sections["cameras"]["nadir"]["calibration"] = "in_flight_uncorrected"
    path.write_text(yaml.safe_dump(sections), "utf-8")
    run = run_mission(path).output

    assert codes_of_losses(run, tmp_path / "out") == ["EXPORT-CALIBRATION"]


def codes_of_losses(run, out):
    """The losses of the run's export."""
    ledger = export_run(run, "calibration", out, {}).ledger
    return [entry.code for entry in ledger if entry.kind == "loss"]


def test_a_lens_that_no_program_holds_is_written_as_near_as_it_can(nadir, tmp_path):
    """A report in mm with a turn of the scale: the change for measured points does not need it."""
    metric = {
        "focal_mm": 100.0,
        "pixel_um": [5.0, 5.0],
        "format_mm": [70.0, 53.0],
        "origin": "image_centre",
        "axes": "right up",
        "ppa_mm": [0.062, 0.0415],
        "distortion": {
            "sense": "correction",
            "k1": -2e-8,
            "b2": 1.5e-5,
        },
    }
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "calibration": "laboratory",
        "metric": metric,
    }
    mission = write_mission(
        nadir.block,
        tmp_path,
        cameras={"nadir": camera},
    )
    run = run_mission(mission).output
    out = tmp_path / "out"

    assert "EXPORT-MODEL" in codes_of_losses(run, out)
    report = (out / "calibration.txt").read_text("utf-8")
    c = change_in(report, nadir.names[0], "mm")  # the report's own size of a pixel
    assert c["c0"] == pytest.approx(100.0)
    assert c["c"] / c["c0"] - 1.0 == pytest.approx(57e-6, rel=0.05)


def test_a_run_without_ground_below_its_images_has_no_calibration(nadir, tmp_path):
    out = tmp_path / "out"
    with refused("EXPORT-NO-GROUND"):
        export_run(
            nadir.run,
            "calibration",
            out,
            {},
            ground_height_m=8000.0,
        )
    assert not out.exists()
