"""Image coordinates in the frame of a metric camera, and coordinates that are no pixels."""

from __future__ import annotations

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


def mission(unit: str, cameras: dict | None = None, **observations):
    columns = {"x_px": "x", "y_px": "y"}
    sections = {
        "mission": {"name": "mm"},
        "observations": {"path": "o.csv", "unit": unit, "columns": columns, **observations},
        "cameras": cameras or {"c": CAMERA},
        "stations": {
            "orientation": {
                "path": "s.csv",
                "angles": "omega_phi_kappa",
                "camera": "c",
                "frame": "geographic",
                "heights": "msl",
                "date": "2026-05-01",
            }
        },
        "ground": {"height": 0.0, "reference": "msl"},
        "output": {"path": "results"},
    }
    return mission_of(copy.deepcopy(sections), None, "sections")


@pytest.fixture
def opened(tmp_path):
    """Opens a table of coordinates as a mission states it."""

    def open_coordinates(mission, xy: np.ndarray):
        table = pd.DataFrame(xy, columns=["x", "y"]).assign(image="a", point=range(len(xy)))
        table.to_csv(tmp_path / "o.csv", index=False)
        return open_table(mission, tmp_path / "o.csv", Ledger())

    return open_coordinates


FRAMES = {
    "right up": lambda px: np.stack([px[:, 0] - 3000.0, 1000.0 - px[:, 1]], 1) * [0.01, 0.02],
    "right down": lambda px: (px - [3000.0, 1000.0]) * [0.01, 0.02],
    "up left": lambda px: np.stack([1000.0 - px[:, 1], 3000.0 - px[:, 0]], 1) * [0.02, 0.01],
}
"""Millimetres of pixels, by hand: 10 um across and 20 um down, from the middle."""


def metric(**changed) -> dict:
    """A camera whose report has other values."""
    return CAMERA | {"metric": METRIC | changed}


@pytest.mark.parametrize("axes", FRAMES)
@pytest.mark.parametrize(("unit", "size"), [("mm", 1.0), ("um", 1000.0)])
def test_coordinates_of_each_frame_are_pixels(opened, axes, unit, size):
    given = FRAMES[axes](PIXELS) * size
    (batch,) = opened(mission(unit, {"c": metric(axes=axes)}), given).batches(100)
    assert np.stack([batch.x_px, batch.y_px], 1) == pytest.approx(PIXELS)
    assert np.stack([batch.x_given_px, batch.y_given_px], 1) == pytest.approx(PIXELS)
    assert batch.users["x"].to_pylist() == pytest.approx(given[:, 0].tolist())


def test_results_count_pixels_as_is_stated(opened):
    stated = mission("mm", pixel_origin="centre")
    (batch,) = opened(stated, FRAMES["right up"](PIXELS)).batches(100)
    assert batch.x_px == pytest.approx(PIXELS[:, 0])
    assert batch.x_given_px == pytest.approx(PIXELS[:, 0] - 0.5)


def test_the_origin_may_be_a_pixel(opened):
    stated = mission("mm", {"c": metric(origin=[3001.0, 998.0])})
    (batch,) = opened(stated, np.zeros((1, 2))).batches(100)
    assert batch.x_px[0] == 3001.0
    assert batch.y_px[0] == 998.0


OTHER = {"c": CAMERA, "d": metric(axes="right down")}
PLAIN = {
    "width_px": 6000,
    "height_px": 2000,
    "f_px": 9000.0,
    "cx_px": 3000.0,
    "cy_px": 1000.0,
    "calibration": "laboratory",
}


@pytest.mark.parametrize(
    ("cameras", "why"), [({"c": PLAIN}, "needs cameras.c.metric"), (OTHER, "needs one frame")]
)
def test_millimetres_need_one_metric_frame(cameras, why):
    with refused("CONFIG-INVALID") as refusal:
        mission("mm", cameras)
    assert why in str(refusal.value)


def spread(share: float, seed: int = 3) -> np.ndarray:
    """Pixels of a share of the image, about its middle."""
    draw = np.random.default_rng(seed).uniform(-0.5 * share, 0.5 * share, (200, 2))
    return np.array([3000.0, 1000.0]) + draw * [6000.0, 2000.0]


IN_MM = FRAMES["right up"](spread(0.9))


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
    stated = mission(unit)
    refuse_other_unit(stated, opened(stated, coordinates))


@pytest.mark.parametrize(
    ("camera", "unit", "size"),
    [(CAMERA, "mm", 1.0), (CAMERA, "um", 1000.0), (PLAIN, "mm", 1.0)],
    ids=["mm", "um", "no report"],
)
def test_millimetres_that_are_taken_for_pixels_are_named(opened, camera, unit, size):
    stated = mission("px", {"c": camera})
    table = opened(stated, IN_MM * size)
    with refused("OBS-UNIT") as refusal:
        refuse_other_unit(stated, table)
    assert f"perhaps {unit} from its centre" in refusal.value.what
    assert f"observations.unit: {unit}" in refusal.value.remedy


def test_pixels_that_are_taken_for_millimetres_are_named(opened):
    stated = mission("mm")
    table = opened(stated, spread(0.9))
    with refused("OBS-UNIT") as refusal:
        refuse_other_unit(stated, table)
    assert "read in mm, " in refusal.value.what
    assert " are outside the image" in refusal.value.what
