"""A camera by COLMAP's name and parameters, and what does not fit."""

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from unbend.config.cameras import CameraSection
from unbend.config.metric_cameras import MetricDistortion, MetricTable
from unbend.refraction.calibration import MODELS

FORMAT = {"width_px": 4000, "height_px": 3000, "calibration": "laboratory"}
PARAMS = yaml.safe_load("""
SIMPLE_PINHOLE: [3200.0, 1990.0, 1510.0]
PINHOLE: [3200.0, 3210.0, 1990.0, 1510.0]
SIMPLE_RADIAL: [3200.0, 1990.0, 1510.0, -0.05]
RADIAL: [3200.0, 1990.0, 1510.0, -0.05, 0.01]
OPENCV: [3200.0, 3210.0, 1990.0, 1510.0, -0.05, 0.01, 0.0002, -0.0003]
FULL_OPENCV:
  [3200.0, 3210.0, 1990.0, 1510.0, 0.08, -0.02, 0.0002, -0.0003, 0.001, 0.1, -0.01, 0.001]
SIMPLE_FISHEYE: [1500.0, 1990.0, 1510.0]
FISHEYE: [1500.0, 1510.0, 1990.0, 1510.0]
SIMPLE_RADIAL_FISHEYE: [1500.0, 1990.0, 1510.0, -0.02]
RADIAL_FISHEYE: [1500.0, 1990.0, 1510.0, -0.02, 0.004]
OPENCV_FISHEYE: [1500.0, 1510.0, 1990.0, 1510.0, -0.02, 0.004, -0.001, 0.0001]
""")


def test_every_model_is_tried_here():
    assert {*PARAMS, "BROWN", "GENERAL_FRAME"} == set(MODELS)


@pytest.mark.parametrize("model", sorted(PARAMS))
def test_names_and_order_are_colmaps(model):
    pycolmap = pytest.importorskip("pycolmap")
    params = PARAMS[model]
    section = CameraSection(**FORMAT, model=model, params=params)
    camera = section.interior_orientation_by("centre")
    reference = pycolmap.Camera(model=model, width=4000, height=3000, params=params)
    columns = np.linspace(-0.6, 0.6, 13)
    rows = np.linspace(-0.45, 0.45, 9)
    u, v = np.reshape(np.meshgrid(columns, rows), (2, -1))
    rays = np.stack([u, v, np.ones_like(u)], axis=1)
    expected = reference.img_from_cam(rays)
    pixels = np.stack(camera.project(u, v), axis=1)
    np.testing.assert_allclose(pixels, expected, rtol=0.0, atol=1e-9)


def test_pixels_of_another_rule_are_turned_into_colmaps():
    section = CameraSection(
        **FORMAT,
        model="SIMPLE_PINHOLE",
        params=PARAMS["SIMPLE_PINHOLE"],
        pixel_origin="centre",
    )
    camera = section.interior_orientation
    assert (camera.cx_px, camera.cy_px) == (1990.5, 1510.5)


REFUSED = yaml.safe_load(r"""
- ['model: OPENCV', together]
- ['params: [1.0]', together]
- ['{model: FOV, params: [3200.0, 1.0, 1.0, 1.0]}', SIMPLE_PINHOLE]
- ['{model: RADIAL, params: [3200.0, 1990.0, 1510.0]}', RADIAL has 5 parameters]
- - '{model: PINHOLE, params: [320.0, 320.0, 1.0, 2.0], f_px: 320.0}'
  - each of them gives the interior orientation
- - '{model: SIMPLE_RADIAL, params: [3200.0, 1990.0, 1510.0, 0.0], distortion: {k1: 0.1}}'
  - each of them gives the interior orientation
- ['{model: PINHOLE, params: [0.8, 0.8, 0.5, 0.5]}', '10 to 1000000 pixels']
- ['{f_px: 3200.0, cx_px: 2000.0}', "cy_px\n  Value error, is missing"]
""")


@pytest.mark.parametrize(("keys", "why"), REFUSED)
def test_what_does_not_fit_is_refused(keys, why):
    with pytest.raises(ValidationError, match=why):
        CameraSection(**FORMAT, **yaml.safe_load(keys))


def test_a_camera_of_colmap_may_be_named_by_its_number(tmp_path):
    file = tmp_path / "cameras.txt"
    file.write_text(
        "1 PINHOLE 40 30 100 100 20 15\n7 PINHOLE 4000 3000 3200 3210 2001 1502\n",
        "utf-8",
    )
    for name in (7, "7"):
        section = CameraSection(file="cameras.txt", camera=name, calibration="laboratory")
        assert section.with_file(file).interior_orientation.fy_px == 3210.0


def test_a_table_by_field_angle_is_by_the_radius_of_its_tangent():
    """At 30 degrees of a lens of 150 mm the radius is 150 / sqrt(3) = 86.603 mm."""
    rows_um = [[0.0, 0.0], [30.0, -4.0], [45.0, 12.0]]
    rows_mm = [[0.0, 0.0], [86.60254, -0.004], [150.0, 0.012]]
    by_angle = MetricTable(sense="distortion", by="field_angle_deg", rows=rows_um)
    rows, sense = by_angle.in_mm(150.0)
    np.testing.assert_allclose(rows, rows_mm, atol=1e-5)
    assert sense == "distortion"
    by_radius = MetricTable(sense="correction", by="radius_mm", rows=rows_um)
    rows, _ = by_radius.in_mm(150.0)
    assert rows[:, 0].tolist() == [0.0, 30.0, 45.0]


COEFFICIENTS = {"k0", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2"}


def test_coefficients_that_a_report_does_not_have_are_zero():
    coefficients = MetricDistortion(sense="correction").model_dump(include=COEFFICIENTS)
    assert coefficients == dict.fromkeys(COEFFICIENTS, 0.0)
