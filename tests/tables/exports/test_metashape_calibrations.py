"""Calibrations for Metashape beside Bundler's block: the cameras that the images were taken with.

Truth: the formulas of Metashape's user manual, written out, against image points that
`projected_block` projects by OpenCV's.
"""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.lens import metashape_pixels
from tests.tables.checks import assert_within
from tests.tables.exports.export_runs import write_export
from tests.tables.exports.projected_block import NADIR, SIDE
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import ExportCamera
from unbend.tables.imports.blocks import read_camera

LENS_CHANGE_PX = -2.0


def calibration_in(path):
    """The numbers of a calibration, and its projection."""
    root = ElementTree.parse(path).getroot()
    assert root.tag == "calibration"
    numbers = {}
    for element in root:
        if element.tag != "projection":
            numbers[element.tag] = float(element.text)
    return numbers, root.findtext("projection")


def exported(block, camera=NADIR, *, name="nadir", change_px=0.0):
    """Bundler's folder of the block, and what its calibration.json has of the first camera."""
    run = block.run()
    first = run.stations.camera == "nadir"
    changes_px = np.where(first, change_px, 0.0)
    names = np.where(first, name, "side")
    cameras = {
        name: ExportCamera(camera, False),
        "side": run.cameras["side"],
    }
    run = replace(
        run,
        exposures=replace(run.exposures, principal_change_px=changes_px),
        stations=replace(run.stations, camera=names.astype(object)),
        cameras=cameras,
    )
    folder = write_export(run, "bundler").path
    text = (folder / "calibration.json").read_text(encoding="utf-8")
    return folder, json.loads(text)


def test_metashape_projects_to_the_measured_points(block):
    folder, calibrations = exported(block)
    of_camera = {
        "nadir": block.image[0::2],
        "side": block.image[1::2],
    }

    for name, images in of_camera.items():
        assert calibrations[name]["metashape"] == f"taken_with_{name}.xml"
        numbers, projection = calibration_in(folder / f"taken_with_{name}.xml")
        rows = block.rows[block.rows.image.isin(images)]
        pixels = metashape_pixels(numbers, projection, rows.u, rows.v)
        assert projection == "frame"
        assert_within(pixels.T, rows[["x_px", "y_px"]], 1e-8)
        # What typing OpenCV's p1 and p2 of the JSON into Metashape would exchange.
        assert "Metashape exchanges p1 and p2" in calibrations[name]["taken_with"]["coefficients"]


def test_the_calibration_contains_the_air_in_the_lens(block):
    folder, calibrations = exported(block, change_px=LENS_CHANGE_PX)

    numbers, _ = calibration_in(folder / "taken_with_nadir.xml")
    of_side, _ = calibration_in(folder / "taken_with_side.xml")

    taken_with = calibrations["nadir"]["taken_with"]
    fx = NADIR.fx_px + LENS_CHANGE_PX
    fy = NADIR.fy_px * fx / NADIR.fx_px
    b1 = fx - fy
    assert numbers["f"] == pytest.approx(fy, abs=1e-9)
    assert numbers["b1"] == pytest.approx(b1, abs=1e-9)
    assert numbers["f"] == taken_with["fy_px"]
    assert taken_with["fx_px"] == pytest.approx(fx)
    assert taken_with["lens_change_ppm"] == pytest.approx(1e6 * LENS_CHANGE_PX / NADIR.fx_px)
    assert calibrations["nadir"]["written"]["f_px"] == NADIR.fx_px
    assert calibrations["side"]["taken_with"]["lens_change_ppm"] == 0.0
    assert numbers["cx"] == pytest.approx(NADIR.cx_px - 7000.0)
    assert numbers["cy"] == pytest.approx(NADIR.cy_px - 5300.0)
    assert of_side["f"] == SIDE.fx_px


# Of Metashape's own calibrations: k4 and b2.
OWN = GeneralFrame(
    k1=-0.02,
    k2=0.01,
    k3=-0.004,
    k4=0.001,
    px=4e-4,
    py=-9e-4,
    skew_x=3e-5,
)
FISHEYE = OpenCVFisheye(
    k1=0.01,
    k2=-0.002,
    k3=3e-4,
    k4=1e-5,
)


@pytest.mark.parametrize("lens", [OWN, FISHEYE])
def test_other_lenses_that_metashape_has(block, lens):
    """The reader of calibrations, which is tested by Metashape's formulas, has the same camera."""
    camera = replace(NADIR, distortion=lens)
    folder, calibrations = exported(block, camera)

    file = calibrations["nadir"]["metashape"]
    path = folder / file
    read = read_camera(path, None, None)
    u = np.linspace(-0.3, 0.25, 9)
    v = np.tile([-0.2, 0.05, 0.22], 3)
    expected = camera.project(u, v)
    numbers, projection = calibration_in(path)
    pixels = metashape_pixels(numbers, projection, u, v)

    assert "coefficients" not in calibrations["nadir"]["taken_with"]
    assert_allclose(read.project(u, v), expected, rtol=0.0, atol=1e-8)
    assert_allclose(pixels, expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(
    "lens",
    [
        GeneralFrame(k1=0.02, q2=0.01),
        GeneralFrame(k1=0.02, sense=-1.0),
        GeneralFrame(k0=1e-4),
        GeneralFrame(skew_y=1e-4),
        GeneralFrame(offset_u=1e-4),
    ],
)
def test_a_lens_that_metashape_has_not_is_only_in_the_json(block, lens):
    folder, calibrations = exported(block, replace(NADIR, distortion=lens))

    assert calibrations["nadir"]["metashape"] is None
    assert calibrations["nadir"]["taken_with"]["model"] == "general_frame"
    (file,) = folder.glob("*.xml")
    assert file.name == "taken_with_side.xml"


def test_each_camera_has_a_file_of_its_own(block):
    """Names that no file can have; two of which only the case differs."""
    folder, calibrations = exported(block, name="SIDE")

    names = [calibrations["SIDE"]["metashape"], calibrations["side"]["metashape"]]
    written = [path.name for path in folder.glob("*.xml")]
    assert sorted(names) == sorted(written)
    assert names[0].lower() != names[1].lower()

    _, calibrations = exported(block, name="left/nadir 2")
    assert calibrations["left/nadir 2"]["metashape"] == "taken_with_left_nadir_2.xml"
