"""Image coordinates in the frame of a metric camera, and coordinates that are no pixels."""

import copy

import numpy as np
import pandas as pd
import pytest

from tests.helpers import refused
from unbend.batch.opening import open_table
from unbend.config.reading import mission_of
from unbend.messages import Ledger
from unbend.stages.observation_units import refuse_other_unit

METRIC = {
    "focal_mm": 100.0,
    "pixel_um": [10.0, 20.0],
    "format_mm": [60.0, 40.0],
    "origin": "image_centre",
    "axes": "right up",
    "ppa_mm": [0.0, 0.0],
}
CAMERA = {"width_px": 6000, "height_px": 2000, "calibration": "laboratory", "metric": METRIC}
PIXELS = np.array([[3000.0, 1000.0], [100.0, 50.0], [5900.0, 1950.0], [2000.0, 1500.0]])


def mission(unit, *, camera=CAMERA, pixel_origin=None, **more_cameras):
    """A mission of a camera, and perhaps of more; without an origin it has the default."""
    orientation = {
        "path": "s.csv",
        "angles": "omega_phi_kappa",
        "camera": "c",
        "frame": "geographic",
        "heights": "msl",
        "date": "2026-05-01",
    }
    sections = {
        "mission": {"name": "mm"},
        "observations": {
            "path": "o.csv",
            "unit": unit,
            "columns": {"x_px": "x", "y_px": "y"},
        },
        "cameras": {"c": camera, **more_cameras},
        "stations": {"orientation": orientation},
        "ground": {"height": 0.0, "reference": "msl"},
        "output": {"path": "results"},
    }
    if pixel_origin is not None:
        sections["observations"]["pixel_origin"] = pixel_origin
    return mission_of(copy.deepcopy(sections), None, "sections")


@pytest.fixture
def opened(tmp_path):
    """Opens a table of coordinates as a mission states it."""

    def open_coordinates(mission, xy):
        table = pd.DataFrame(xy, columns=["x", "y"])
        table["image"] = "a"
        table["point"] = table.index
        path = tmp_path / "o.csv"
        table.to_csv(path, index=False)
        return open_table(mission, path, Ledger())

    return open_coordinates


def millimetres(pixels, axes="right up"):
    """Millimetres of pixels, by hand: 10 um across and 20 um down, from the middle."""
    right, down = ((pixels - [3000.0, 1000.0]) * [0.01, 0.02]).T
    frames = {
        "right up": [right, -down],
        "right down": [right, down],
        "up left": [-down, -right],
    }
    return np.column_stack(frames[axes])


def metric(**changed):
    """A camera whose report has other values."""
    return CAMERA | {"metric": METRIC | changed}


@pytest.mark.parametrize("axes", ["right up", "right down", "up left"])
@pytest.mark.parametrize(("unit", "size"), [("mm", 1.0), ("um", 1000.0)])
def test_coordinates_of_each_frame_are_pixels(opened, axes, unit, size):
    coordinates = millimetres(PIXELS, axes) * size
    metric_mission = mission(unit, camera=metric(axes=axes))
    (batch,) = opened(metric_mission, coordinates).batches(100)
    for x, y in ((batch.x_px, batch.y_px), (batch.x_given_px, batch.y_given_px)):
        assert np.column_stack([x, y]) == pytest.approx(PIXELS)
    assert batch.users["x"].to_numpy() == pytest.approx(coordinates[:, 0])


def test_results_count_pixels_as_is_stated(opened):
    from_centre = mission("mm", pixel_origin="centre")
    (batch,) = opened(from_centre, millimetres(PIXELS)).batches(100)
    assert batch.x_px == pytest.approx(PIXELS[:, 0])
    assert batch.x_given_px == pytest.approx(PIXELS[:, 0] - 0.5)


def test_the_origin_may_be_a_pixel(opened):
    camera = metric(origin=[3001.0, 998.0])
    (batch,) = opened(mission("mm", camera=camera), np.zeros((1, 2))).batches(100)
    assert batch.x_px.tolist() == [3001.0]
    assert batch.y_px.tolist() == [998.0]


PLAIN = {
    "width_px": 6000,
    "height_px": 2000,
    "f_px": 9000.0,
    "cx_px": 3000.0,
    "cy_px": 1000.0,
    "calibration": "laboratory",
}


@pytest.mark.parametrize(
    ("cameras", "why"),
    [
        ({"camera": PLAIN}, "needs cameras.c.metric"),
        ({"d": metric(axes="right down")}, "needs one frame"),
    ],
)
def test_millimetres_need_one_metric_frame(cameras, why):
    with refused("CONFIG-INVALID", says=why):
        mission("mm", **cameras)


def spread(share):
    """Pixels of a share of the image, about its middle."""
    half = 0.5 * share
    draw = np.random.default_rng(3).uniform(-half, half, (200, 2))
    return (draw + 0.5) * [6000.0, 2000.0]


IN_MM = millimetres(spread(0.9))


@pytest.mark.parametrize(
    ("unit", "coordinates"),
    [
        ("mm", IN_MM),
        ("um", IN_MM * 1000.0),
        ("px", spread(0.9)),
        ("px", spread(1.3)),  # many outside, on all sides
        ("px", IN_MM[:9]),  # few decide nothing
    ],
    ids=["mm", "um", "px", "outside", "few"],
)
def test_coordinates_in_their_unit_pass(opened, unit, coordinates):
    in_unit = mission(unit)
    refuse_other_unit(in_unit, opened(in_unit, coordinates))


@pytest.mark.parametrize(
    ("camera", "unit", "size"),
    [(CAMERA, "mm", 1.0), (CAMERA, "um", 1000.0), (PLAIN, "mm", 1.0)],
    ids=["mm", "um", "no report"],
)
def test_millimetres_that_are_taken_for_pixels_are_named(opened, camera, unit, size):
    in_pixels = mission("px", camera=camera)
    table = opened(in_pixels, IN_MM * size)
    with refused(
        "OBS-UNIT", what=f"perhaps {unit} from its centre", remedy=f"observations.unit: {unit}"
    ):
        refuse_other_unit(in_pixels, table)


def test_pixels_that_are_taken_for_millimetres_are_named(opened):
    in_millimetres = mission("mm")
    table = opened(in_millimetres, spread(0.9))
    with refused("OBS-UNIT") as refusal:
        refuse_other_unit(in_millimetres, table)
    assert "read in mm, " in refusal.value.what
    assert " are outside the image" in refusal.value.what
