"""The sample mission with its cameras from files and from a report: the same corrections."""

import json

import numpy as np
import pytest
import yaml

from tests.helpers import refused
from unbend.batch.finished_run.export import rebuild_run
from unbend.config import load_mission
from unbend.errors import ConfigError
from unbend.messages import Ledger

from .conftest import read_observations, run_sample, sample_sections, write_mission

# Metashape: offsets from the centre of the image, p1 and p2 exchanged.
NADIR = """<calibration><projection>frame</projection><width>14000</width><height>10600</height>
<f>20000</f><cx>12.4</cx><cy>-8.3</cy><k1>-0.018</k1><k2>0.009</k2><k3>-0.002</k3>
<p1>-0.0001</p1><p2>0.00015</p2></calibration>"""
# OpenSfM: in units of 14000 px.
OBLIQUE = {
    "v2 oblique": {
        "projection_type": "brown",
        "width": 14000,
        "height": 10600,
        "focal_x": 20000.0 / 14000.0,
        "focal_y": 20000.0 / 14000.0,
        "c_x": -10.8 / 14000.0,
        "c_y": 8.1 / 14000.0,
        "k1": -0.015,
        "k2": 0.007,
        "k3": -0.001,
        "p1": -0.00012,
        "p2": 0.00008,
    },
    "v2 other": {"projection_type": "spherical", "width": 10, "height": 5},
}
# 100 mm and pixels of 5 um; x is up and y right in the image; k in powers of mm, Brown's p.
REPORT = yaml.safe_load("""
focal_mm: 100.0
pixel_um: [5.0, 5.0]
format_mm: [70.0, 53.0]
origin: image_centre
axes: up right
ppa_mm: [0.0415, 0.062]
distortion:
  sense: distortion
  k1: -0.018e-4
  k2: 0.009e-8
  k3: -0.002e-12
  p1: -0.00015e-2
  p2: -0.0001e-2
""")
SAME = {"calibration": "laboratory", "window": {"cabin": "log"}}


@pytest.fixture(scope="module")
def as_it_is(runs):
    return read_observations(runs["bin"].output)


def with_cameras(folder, **changes):
    (folder / "nadir.xml").write_text(NADIR)
    (folder / "camera_models.json").write_text(json.dumps(OBLIQUE))
    oblique = {"file": "camera_models.json", "camera": "v2 oblique"}
    return {"nadir": {"file": "nadir.xml"} | SAME, "oblique": oblique | SAME} | changes


def test_cameras_of_files(tmp_path, as_it_is):
    outcome = run_sample("bin", tmp_path, cameras=with_cameras(tmp_path))
    rows = read_observations(outcome.output)
    for name in ("x_corrected_px", "y_corrected_px", "r_c_rad", "r_cc_rad"):
        np.testing.assert_allclose(rows[name], as_it_is[name], rtol=0.0, atol=1e-9)
    assert (rows["status"] == as_it_is["status"]).all()
    inputs = {item["role"]: item["name"] for item in outcome.manifest.values["inputs"]}
    assert inputs["camera nadir"] == "nadir.xml"
    # The results can be opened without the files, and know the cameras.
    (tmp_path / "nadir.xml").unlink()
    cameras = rebuild_run(outcome.output, outcome.manifest, None, Ledger()).cameras
    assert cameras["nadir"].camera.cx_px == pytest.approx(7012.4, abs=1e-9)


def test_a_camera_of_a_report(tmp_path, as_it_is):
    cameras = sample_sections("bin", tmp_path)["cameras"]
    cameras["nadir"] = {"width_px": 14000, "height_px": 10600, "metric": REPORT} | SAME
    outcome = run_sample("bin", tmp_path, cameras=cameras)
    rows = read_observations(outcome.output)
    for name in ("x_corrected_px", "y_corrected_px"):
        np.testing.assert_allclose(rows[name], as_it_is[name], rtol=0.0, atol=1e-9)
    exported = rebuild_run(outcome.output, outcome.manifest, None, Ledger()).cameras
    assert exported["nadir"].camera.fx_px == pytest.approx(20000.0)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"file": "gone.xml"}, "INPUT-MISSING", "cameras.nadir.file"),
        (
            {"file": "nadir.xml", "width_px": 10600, "height_px": 14000},
            "CAMERA-SIZE",
            "14000 x 10600 px, but the mission file states 10600 x 14000",
        ),
        ({"file": "camera_models.json"}, "CAMERA-NAME", "'v2 oblique', 'v2 other'"),
        ({"file": "camera_models.json", "camera": "v2 other"}, "CAMERA-MODEL", "spherical"),
        ({"file": "wide.txt"}, "CAMERA-FILE", "CAMERA-FIELD"),
    ],
)
def test_files_that_do_not_fit(tmp_path, change, code, words):
    (tmp_path / "wide.txt").write_text("1 PINHOLE 14000 10600 100 100 7000 5300\n")
    cameras = with_cameras(tmp_path, nadir=change | SAME)
    with refused(code, says=words):
        run_sample("bin", tmp_path, cameras=cameras)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f_px": 35.0}, "CAMERA-FIELD: with a principal distance of 35 px"),
        ({"f_px": 20000.0, "distortion": {"k1": -3.0}}, "CAMERA-TURNS"),
        ({"metric": REPORT | {"pixel_um": [5.0, 6.0]}}, "CAMERA-FORMAT"),
        ({"metric": REPORT | {"ppa_mm": [26.4, 35.1]}}, "CAMERA-PRINCIPAL-POINT"),
    ],
)
def test_numbers_that_cannot_be(tmp_path, change, words):
    sections = sample_sections("bin", tmp_path)
    point = {} if "metric" in change else {"cx_px": 7000.0, "cy_px": 5300.0}
    sections["cameras"]["nadir"] = {"width_px": 14000, "height_px": 10600} | point | change | SAME
    with pytest.raises(ConfigError, match=words):
        load_mission(write_mission(tmp_path / "m.yaml", **sections))
