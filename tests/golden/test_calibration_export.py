"""`unbend export --format calibration`, loaded by the programs it is for: poses are held.

The clients are pycolmap, which reads the exported cameras.txt and adjusts the points, and for
programs that correct measured points the formula of the report, written out here.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
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
    brown,
    fly,
    intersected,
    write_mission,
)
from tests.helpers import refused
from unbend.batch.finished_run.export import export_run

from .conftest import run_mission

pycolmap = pytest.importorskip("pycolmap")


class Exported:
    """A block, its run and the folder of its calibrations."""

    def __init__(self, block: HeldBlock, folder: Path, **options: float) -> None:
        self.block = block
        self.folder = folder / "calibration"
        outcome = run_mission(write_mission(block, folder))
        assert outcome.exit_code == 0
        self.run = outcome.output
        written = export_run(self.run, "calibration", self.folder, options)
        assert written.rows == len(block.image)
        self.ledger = written.ledger
        self.report = (self.folder / "calibration.txt").read_text(encoding="utf-8")
        images = pd.read_csv(self.folder / "images.csv").set_index("image")
        self.names = images["calibration"].unique().tolist()
        calibrations = images["calibration"][block.image]
        self.of_image = pd.Index(self.names).get_indexer(calibrations)

    @property
    def measured(self) -> np.ndarray:
        """(r, 2) the measured pixels."""
        return self.block.rows[["x_px", "y_px"]].to_numpy()

    def corrected(self) -> np.ndarray:
        """(r, 2) the run's own corrected pixels, in the order of the block's rows."""
        table = pd.read_parquet(self.run / "observations")
        return table[["x_corrected_px", "y_corrected_px"]].to_numpy()


@pytest.fixture(scope="module")
def nadir(tmp_path_factory) -> Exported:
    return Exported(fly(6000.0, NADIR, seed=11), tmp_path_factory.mktemp("nadir"), pixel_um=5.0)


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> Exported:
    return Exported(fly(6000.0, FIVE, seed=12), tmp_path_factory.mktemp("five"))


def colmap_cameras(folder: Path, work: Path) -> dict:
    """The cameras of an exported cameras.txt, read by pycolmap as part of a model."""
    work.mkdir()
    (work / "cameras.txt").write_bytes((folder / "cameras.txt").read_bytes())
    for name in ("images.txt", "points3D.txt"):
        (work / name).write_text("", encoding="utf-8")
    return dict(pycolmap.Reconstruction(str(work)).cameras)


def adjusted(block: HeldBlock, pixels: np.ndarray, cameras: dict, of_image: np.ndarray):
    """(p, 3) errors of points that pycolmap adjusts with poses and cameras held."""
    model = pycolmap.Reconstruction()
    config = pycolmap.BundleAdjustmentConfig()
    for camera in cameras.values():
        model.add_camera_with_trivial_rig(camera)
        config.set_constant_cam_intrinsics(camera.camera_id)
    centre = block.in_frame(block.centre)
    rotation = block.camera_from_frame
    true = block.in_frame(block.place)
    station = block.rows["image"].to_numpy()
    tracks: dict[int, list] = {}
    for k in range(len(block.image)):
        rows = np.flatnonzero(station == k)
        image = pycolmap.Image(
            name=block.image[k],
            keypoints=pixels[rows],
            camera_id=int(of_image[k]) + 1,
            image_id=k + 1,
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation[k]), -rotation[k] @ centre[k])
        model.add_image_with_trivial_frame(image, pose)
        config.add_image(k + 1)
        for i, row in enumerate(rows):
            point = int(block.rows["point"][row])
            tracks.setdefault(point, []).append(pycolmap.TrackElement(k + 1, i))
    ids = {p: model.add_point3D(true[p], pycolmap.Track(track)) for p, track in tracks.items()}
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_rig_from_world = False
    options.ceres.solver_options.gradient_tolerance = 1e-10
    options.ceres.solver_options.function_tolerance = 1e-12
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    return np.array([model.points3D[number].xyz - true[p] for p, number in ids.items()])


def calibrated(names: list[str]) -> dict:
    """The user's own calibration as one camera for each name."""
    k1, k2, p1, p2, k3 = LENS
    camera = {
        "model": "FULL_OPENCV",
        "width": WIDTH,
        "height": HEIGHT,
        "params": [FOCAL, FOCAL, CX, CY, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
    }
    numbers = range(1, len(names) + 1)
    return {number: pycolmap.Camera(**camera, camera_id=number) for number in numbers}


def rms_z(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors[:, 2] ** 2)))


@pytest.mark.parametrize(("name", "least", "most"), [("nadir", 0.3, 0.05), ("five", 0.6, 0.03)])
def test_pycolmap_finds_the_points_with_the_exported_cameras(
    name, least, most, request, tmp_path, capsys
):
    """Uncorrected points, held poses: 0.35 m become 0.013 m, five heads' 0.81 m 0.017 m."""
    done: Exported = request.getfixturevalue(name)
    block = done.block
    cameras = colmap_cameras(done.folder, tmp_path / "model")
    laboratory = calibrated(done.names)
    before = adjusted(block, done.measured, laboratory, done.of_image)
    after = adjusted(block, done.measured, cameras, done.of_image)
    lattice = adjusted(block, done.corrected(), laboratory, done.of_image)
    with capsys.disabled():
        print(
            f"\n{name}: Z rms {rms_z(before):.4f} m, calibration {rms_z(after):.4f}, "
            f"corrected points {rms_z(lattice):.5f}"
        )
    assert rms_z(before) > least
    assert rms_z(after) < most * rms_z(before)
    assert rms_z(lattice) < 0.001
    assert np.mean(before[:, 2]) > 0.9 * rms_z(before)  # too high: the calibration's sign
    assert not done.ledger.has_losses


NUMBER = r"([-+0-9.e]+)"


def change_in(report: str, name: str, unit: str) -> dict[str, float]:
    """What a user reads in the report: numbers of a calibration, in px or mm."""
    part = report[report.index(f"{name}: ") :]
    text = part[part.index(f"    in {unit}: c ") :]
    frame = re.match(rf".*c {NUMBER} \S+ -> {NUMBER}; principal point {NUMBER}, {NUMBER}\n", text)
    c0, c, x0, y0 = map(float, frame.groups())
    change = {"c0": c0, "c": c, "x0": x0, "y0": y0}
    for term in ("K1", "K2", "K3", "P1", "P2", "B1", "B2"):
        change[term] = float(re.search(rf"{term} {NUMBER}", text).group(1))
    return change


@pytest.mark.parametrize(
    ("name", "unit", "most"), [("nadir", "px", 0.05), ("nadir", "mm", 0.05), ("five", "px", 0.03)]
)
def test_a_program_that_corrects_points_finds_them_with_the_report(name, unit, most, request):
    """BINGO's, Inpho's and the USGS' way: x right, y up, what is added, and a new c."""
    done: Exported = request.getfixturevalue(name)
    block = done.block
    # The user's own calibration, by the inverse of the lens: pycolmap's.
    laboratory = calibrated(["one"])[1]
    ideal = np.array([laboratory.cam_from_img(xy) for xy in done.measured])
    size = 1.0 if unit == "px" else 0.005
    x, y = ((done.measured - [CX, CY]) * [size, -size]).T
    u, v = (ideal * [FOCAL * size, -FOCAL * size]).T
    tangents = np.empty_like(ideal)
    of_row = done.of_image[block.rows["image"]]
    for number, calibration in enumerate(done.names):
        c = change_in(done.report, calibration, unit)
        assert c["c0"] == pytest.approx(FOCAL * size)
        r2 = x * x + y * y
        radial = c["K1"] * r2 + c["K2"] * r2**2 + c["K3"] * r2**3
        dx = -c["x0"] + x * radial + c["P1"] * (r2 + 2 * x * x) + 2 * c["P2"] * x * y
        dy = -c["y0"] + y * radial + c["P2"] * (r2 + 2 * y * y) + 2 * c["P1"] * x * y
        dx += c["B1"] * x + c["B2"] * y
        ray = np.stack([(u + dx) / c["c"], -(v + dy) / c["c"]], axis=1)
        tangents[of_row == number] = ray[of_row == number]
    before = intersected(block, ideal)
    assert rms_z(intersected(block, tangents)) < most * rms_z(before)


@pytest.mark.parametrize(("above", "ppm"), [(3000.0, 34.0), (6000.0, 59.0)])
def test_straight_down_the_change_is_k(above, ppm, tmp_path):
    """34 ppm at 3 km and 59 ppm at 6 km over ground at sea level, in both kinds of model."""
    block = fly(above, NADIR, seed=3, wobble_deg=0.1, ground=0.0, relief=0.0)
    done = Exported(block, tmp_path)
    change = change_in(done.report, done.names[0], "px")
    assert change["c"] / change["c0"] - 1.0 == pytest.approx(ppm * 1e-6, rel=0.02)
    assert change["K1"] * change["c0"] ** 2 == pytest.approx(-ppm * 1e-6, rel=0.05)
    (camera,) = colmap_cameras(done.folder, tmp_path / "model").values()
    assert camera.params[0] / FOCAL - 1.0 == pytest.approx(ppm * 1e-6, rel=0.02)
    assert camera.params[4] - LENS[0] == pytest.approx(ppm * 1e-6, rel=0.05)
    table = pd.read_csv(done.folder / "corrections.csv")
    # With c as it was, all of it is in the table: -K (r + r^3 / c^2).
    r = table["radius_px"] / FOCAL
    expected = -ppm * 1e-6 * (r + r**3) * FOCAL
    np.testing.assert_allclose(table["dr_same_c_px"], expected, atol=0.02 * expected.abs().max())
    assert table["radius_mm"].isna().all()


def test_every_file_is_the_same_camera(five):
    """Metashape's, OpenSfM's and OpenCV's formulas, written out, give pycolmap's pixels."""
    text = (five.folder / "cameras.txt").read_text(encoding="utf-8")
    models = json.loads((five.folder / "camera_models.json").read_text(encoding="utf-8"))
    u, v = np.meshgrid([-0.3, 0.1, 0.33], [-0.25, 0.05, 0.2])
    names = re.findall(r"^# \d+: (.*)$", text, re.M)
    assert names == five.names == list(models)
    for line, name in zip(re.findall(r"^\d.*$", text, re.M), names, strict=True):
        _, model, width, height, *params = line.split()
        assert (model, int(width), int(height)) == ("FULL_OPENCV", WIDTH, HEIGHT)
        camera = pycolmap.Camera(
            model=model, width=WIDTH, height=HEIGHT, params=[float(p) for p in params]
        )
        rays = np.stack([u.ravel(), v.ravel(), np.ones(9)], axis=1)
        expected = np.array([camera.img_from_cam(ray) for ray in rays]).T.reshape(2, 3, 3)

        xml = ElementTree.parse(five.folder / f"{name}.xml").getroot()
        m = {tag.tag: float(tag.text) for tag in xml if tag.tag != "projection"}
        # Metashape's p1 and p2 are OpenCV's p2 and p1.
        x, y = brown(u, v, m["k1"], m["k2"], m["p2"], m["p1"], m["k3"])
        x_px = m["width"] * 0.5 + m["cx"] + x * m["f"] + x * m["b1"]
        y_px = m["height"] * 0.5 + m["cy"] + y * m["f"]
        np.testing.assert_allclose((x_px, y_px), expected, atol=1e-7)

        o = models[name]
        assert o["projection_type"] == "brown"
        x, y = brown(u, v, o["k1"], o["k2"], o["p1"], o["p2"], o["k3"])
        # OpenSfM: pixel = normalised * max(w, h) + (w - 1) / 2, its first pixel's centre at 0.
        x_px = (o["focal_x"] * x + o["c_x"]) * WIDTH + (WIDTH - 1) / 2 + 0.5
        y_px = (o["focal_y"] * y + o["c_y"]) * WIDTH + (HEIGHT - 1) / 2 + 0.5
        np.testing.assert_allclose((x_px, y_px), expected, atol=1e-7)

        body = (five.folder / f"{name}.yaml").read_text(encoding="utf-8")
        body = body.removeprefix("%YAML:1.0\n---\n").replace("!!opencv-matrix", "")
        cv = yaml.safe_load(body)
        fx, _, cx, _, fy, cy, *_ = cv["camera_matrix"]["data"]
        x, y = brown(u, v, *cv["distortion_coefficients"]["data"])
        np.testing.assert_allclose((fx * x + cx + 0.5, fy * y + cy + 0.5), expected, atol=1e-7)


def test_the_report_says_what_is_left_and_what_to_do(nadir, five):
    for done in (nadir, five):
        for words in ("must keep all parameters", "0.16 m for each", "flying height", "px", " m"):
            assert words in done.report
    pair = rf" +{NUMBER} px +{NUMBER} m"
    effect = re.search("refraction" + pair, nadir.report).groups()
    effect_px, effect_m = map(float, effect)
    left_px = float(re.search("left by the cameras in the files" + pair, nadir.report).group(1))
    moved = nadir.corrected() - nadir.measured
    rms_px = np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    assert effect_px == pytest.approx(rms_px, abs=2e-4)
    # Across the ray 6 km below, obliquely a little more: a pixel is 0.3 m.
    assert effect_m == pytest.approx(0.3 * effect_px, rel=0.1)
    assert left_px < 0.1 * effect_px


@pytest.mark.parametrize(("wobble_deg", "exit_code"), [(6.0, 3), (25.0, 6)])
def test_images_that_differ_are_flagged_or_refused(tmp_path, unbend, wobble_deg, exit_code):
    """One camera whose pitch changes by 10 degrees, and by 30, from image to image."""
    block = fly(3000.0, NADIR, seed=5, wobble_deg=wobble_deg)
    run = run_mission(write_mission(block, tmp_path)).output
    ended = unbend("export", run, "--format", "calibration", "--out", tmp_path / "out")
    assert ended.code == exit_code, ended.text
    assert "EXPORT-RESIDUAL" in ended.text
    assert (tmp_path / "out").exists() == (exit_code == 3)
    if exit_code == 6:
        assert "export the lattice" in ended.text


def test_each_flying_height_has_its_own(tmp_path):
    """Half of a block at 3 km, half at 6 km: two calibrations of one camera."""
    low = fly(3000.0, NADIR, seed=7)
    high = fly(6000.0, NADIR, seed=8)
    high.image = np.array([f"high_{name}" for name in high.image])
    rows = high.rows.assign(image=high.rows["image"] + 20, point=high.rows["point"] + 300)
    both = HeldBlock(
        image=np.concatenate([low.image, high.image]),
        camera=np.concatenate([low.camera, high.camera]),
        centre=np.concatenate([low.centre, high.centre]),
        camera_from_enu=np.concatenate([low.camera_from_enu, high.camera_from_enu]),
        point=np.array([f"p{number}" for number in range(600)]),
        place=np.concatenate([low.place, high.place]),
        rows=pd.concat([low.rows, rows], ignore_index=True),
    )
    done = Exported(both, tmp_path)
    assert len(done.names) == 2
    assert (done.of_image == np.repeat([0, 1], 20)).all()
    low_c, high_c = (change_in(done.report, name, "px")["c"] for name in done.names)
    assert (high_c - FOCAL) / (low_c - FOCAL) == pytest.approx(59.0 / 34.0, rel=0.05)


def test_a_calibration_that_has_refraction_in_would_count_twice(nadir, tmp_path):
    path = write_mission(nadir.block, tmp_path)
    sections = yaml.safe_load(path.read_text(encoding="utf-8"))
    sections["cameras"]["nadir"]["calibration"] = "in_flight_uncorrected"
    path.write_text(yaml.safe_dump(sections), encoding="utf-8")
    run = run_mission(path).output
    ledger = export_run(run, "calibration", tmp_path / "out", {}).ledger
    assert [entry.code for entry in ledger if entry.kind == "loss"] == ["EXPORT-CALIBRATION"]


def test_a_lens_that_no_program_holds_is_written_as_near_as_it_can(nadir, tmp_path):
    """A report in mm with a turn of the scale: the change for measured points does not need it."""
    metric = {
        "focal_mm": 100.0,
        "pixel_um": [5.0, 5.0],
        "format_mm": [70.0, 53.0],
        "origin": "image_centre",
        "axes": "right up",
        "ppa_mm": [0.062, 0.0415],
        "distortion": {"sense": "correction", "k1": -2e-8, "b2": 1.5e-5},
    }
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "calibration": "laboratory",
        "metric": metric,
    }
    run = run_mission(write_mission(nadir.block, tmp_path, cameras={"nadir": camera})).output
    ledger = export_run(run, "calibration", tmp_path / "out", {}).ledger
    assert "EXPORT-MODEL" in [entry.code for entry in ledger if entry.kind == "loss"]
    report = (tmp_path / "out" / "calibration.txt").read_text(encoding="utf-8")
    c = change_in(report, nadir.names[0], "mm")  # the report's own size of a pixel
    assert c["c0"] == pytest.approx(100.0)
    assert c["c"] / c["c0"] - 1.0 == pytest.approx(57e-6, rel=0.05)


def test_a_run_without_ground_below_its_images_has_no_calibration(nadir, tmp_path):
    with refused("EXPORT-NO-GROUND"):
        export_run(nadir.run, "calibration", tmp_path / "out", {}, ground_height_m=8000.0)
    assert not (tmp_path / "out").exists()
