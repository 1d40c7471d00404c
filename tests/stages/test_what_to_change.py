"""What a message about tie points asks to change, in the mission file or in a table."""

import math

import pytest

from tests.stages.mistaken import changed, sample_sections
from unbend.block.diagnosis import Finding
from unbend.config import Mission
from unbend.stages.multi_image.tie_point_checks import what_to_change


def sample(changes):
    return Mission.model_validate(changed(sample_sections("sample_bin"), changes))


def of_pixels(label, *cameras):
    key = "observations.columns"
    return Finding("TIES-PIXELS", key, "", math.inf, 1.0, cameras=cameras, label=label)


@pytest.mark.parametrize(
    ("changes", "change"),
    [
        (
            {},
            "y_px of nadir, oblique to 10600 - y_px in the table of observations",
        ),
        (
            {"observations.pixel_origin": "centre", "observations.columns": {"y_px": "row"}},
            "row of nadir, oblique to 10599 - row in the table of observations",
        ),
        (
            {"cameras.oblique.height_px": 10700},
            "y_px of nadir to 10600 - y_px and y_px of oblique to 10700 - y_px in the table of "
            "observations",
        ),
    ],
)
def test_an_axis_that_counts_upward_is_turned_in_the_table(changes, change):
    finding = of_pixels("upward", "nadir", "oblique")
    assert what_to_change(sample(changes), finding) == change


def test_exchanged_axes_are_columns():
    change = what_to_change(sample({}), of_pixels("exchanged", "nadir"))
    assert change == "observations.columns: x_px, y_px"
