"""What a person reads of a run: what was done to the coordinates, and what they still hold."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from unbend.report.campaign import DONE, campaign_page, row_of, row_without
from unbend.report.summary import not_included, size_of_shift
from unbend.tables.manifest.results import DistributionRecord
from unbend.tables.manifest.whole import Manifest

from .manifests import manifest_of
from .test_page import whole_manifest

NORTH_ARCSEC = 0.17
EAST_ARCSEC = 3.97

PLANE = {"shape": "plane", "in_calibration": "none"}
LENS = {"dc_dp_px_per_hpa": 0.006}


def manifest(direction="remove", **cameras) -> Manifest:
    nothing = {"window": None, "principal_distance": None}
    sections = {name: nothing | camera for name, camera in cameras.items()}
    refraction = {"direction": direction}
    return manifest_of({"config": {"refraction": refraction, "cameras": sections}})


def test_cameras_whose_lens_is_not_corrected_are_named():
    lines = not_included(manifest(tail={"principal_distance": LENS}, nose={}, left={}))
    assert lines[0].startswith("The principal distance of nose, left changes")
    assert lines[0].endswith("not removed.")
    assert "tail" not in " ".join(lines)


@pytest.mark.parametrize(
    ("window", "is_named"),
    [
        (PLANE, True),
        (PLANE | {"in_calibration": "glass"}, False),
        (PLANE | {"shape": "spherical"}, False),
        (None, False),
    ],
)
def test_glass_is_named_where_the_calibration_lacks_it(window, is_named):
    text = " ".join(not_included(manifest(belly={"window": window, "principal_distance": LENS})))
    assert ("The glass in front of belly" in text) == is_named
    assert "Earth curvature" in text


def test_nothing_is_to_be_switched_off_where_refraction_was_put_in():
    assert not_included(manifest("apply", belly={"principal_distance": LENS})) == []
    (line,) = not_included(manifest("apply", belly={}))
    assert line.endswith("not applied.")


def test_the_report_of_a_run_holds_these_lines(baseline):
    page = (baseline.output / "report.html").read_text("utf-8")
    values = baseline.manifest()
    lines = not_included(Manifest(values))
    assert len(lines) == 5  # two lenses, the glass, the plumb line, the curvature
    # PROJ's vgridshift at the middle of the flight, 47.400 N 8.642 E: differences over 1 km.
    heights = values["heights"]
    assert heights["deflection"]["north_arcsec"] == pytest.approx(NORTH_ARCSEC, abs=0.2)
    assert heights["deflection"]["east_arcsec"] == pytest.approx(EAST_ARCSEC, abs=0.2)
    size = np.hypot(NORTH_ARCSEC, EAST_ARCSEC)
    assert f"deviates by {size:.0f}" in " ".join(lines)
    assert heights["undulation"] == {"source": "mission.undulation_m", "min_m": 47.6, "max_m": 47.6}
    assert heights["log"] == ["msl", "ellipsoid"]
    assert heights["stations"].startswith("GPS")
    for line in lines:
        assert f"<li>{line}</li>" in page
    assert "What is not removed" in page


def test_the_row_of_a_campaign_has_the_numbers_of_the_manifest():
    """Of 97 images two were never exposed; of the cameras the larger sigma counts."""
    values = whole_manifest()
    values["stations"]["unmatched"] = 2
    row = row_of(manifest_of(values))
    assert row.pop("what").startswith("41 of 5,021 observations were corrected")
    assert row == yaml.safe_load("""
    mission: ridge <north> & [red]south
    state: done with losses or findings
    exit_code: 3
    code: null
    begin_utc: "2025-06-12T09:38:17Z"
    end_utc: "2025-06-12T09:44:19Z"
    lat_deg: -47.4233
    lon_deg: 8.6624
    h_msl_m: 3450.1
    images: 97
    exposures: 95
    observations: 5021
    corrected: 41
    shift_median_px: 3.01
    shift_maximum_px: 3.03
    sigma_px: 0.031
    shift_median_m: 3.11
    shift_maximum_m: 3.13
    sigma_m: 0.0093
    losses: 2
    findings: 0
    warnings: 1
    results: null
    fingerprint: f00df00df00df00df00df00df00df00df00df00df00df00df00df00df00df00d
    """)


def test_how_far_points_were_moved_is_said_by_median_and_95_percent():
    """One steep turn makes the maximum: 2.7 m, where 95 % are within 9 cm."""
    shift = DistributionRecord(count=9, median=0.11, p95=0.42, maximum=12.5)
    ground = DistributionRecord(count=9, median=0.031, p95=0.093, maximum=2.7)
    text = size_of_shift(SimpleNamespace(shift_px=shift, shift_ground_m=ground))
    assert text == "31 mm on the ground, 0.11 px in the image (median; 95 %: 93 mm, 0.42 px)"
    unknown = DistributionRecord(count=0, median=None, p95=None, maximum=None)
    text = size_of_shift(SimpleNamespace(shift_px=shift, shift_ground_m=unknown))
    assert text == "0.11 px in the image (median; 95 %: 0.42 px)"


def places_on_the_page(*longitudes_deg):
    """Where the map of a campaign has its missions, one line for each screen."""
    rows = []
    for number, longitude_deg in enumerate(longitudes_deg):
        place = {"state": DONE, "lat_deg": -17.0 + 0.1 * number, "lon_deg": longitude_deg}
        rows.append(row_without(f"m{number}", 0, "", "") | place)
    return re.findall(r'<path class="dots ok" d="(M[^"]+ [^"]+)"', campaign_page("s", rows, "d"))


def test_a_campaign_across_the_180th_meridian_is_one_place():
    elsewhere = places_on_the_page(9.9, 10.1)
    assert len(elsewhere) == 3  # of a wide and a narrow screen, and the key to the map
    assert places_on_the_page(179.9, -179.9) == elsewhere
