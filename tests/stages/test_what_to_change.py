"""What a message about tie points asks to change, in the mission file or in a table."""

import math

import pytest

from tests.stages.mistaken import changed, sample_sections
from unbend.block.diagnosis import Finding
from unbend.config import Mission
from unbend.stages.multi_image.tie_point_checks import (
    is_of_another_flight,
    of_another_flight,
    what_to_change,
)

ORIENTATION = {
    "path": "opk.csv",
    "frame": "geographic",
    "angles": "omega_phi_kappa",
    "heights": "msl",
}


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


def of_heights(*, beyond_datums):
    what = "the stations are 975.4 m too low"
    return Finding("TIES-HEIGHT", "ground", what, 99.0, 4.4, beyond_datums=beyond_datums)


@pytest.mark.parametrize(
    ("beyond_datums", "sigma_factor", "is_other"),
    [
        (True, 4.4, True),
        (True, 1.1, False),
        (False, 4.4, False),
    ],
)
def test_another_flight_is_a_cause_beyond_datums_where_rays_still_miss(
    beyond_datums, sigma_factor, is_other
):
    finding = of_heights(beyond_datums=beyond_datums)
    assert is_of_another_flight(finding, sigma_factor) == is_other


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({}, "log.path"),
        (
            {"stations": {"orientation": ORIENTATION}},
            "stations.orientation.path",
        ),
    ],
)
def test_another_flight_is_named_first(changes, path):
    finding = of_heights(beyond_datums=True)
    named, change = of_another_flight(sample(changes), finding, "ground.height")
    paths = f"{path} or observations.path"
    assert named.what == f"{paths} may be of another flight: {finding.what}"
    assert change == f"{paths}; if both are of this flight, ground.height"
