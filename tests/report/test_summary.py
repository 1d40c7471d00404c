"""What a person reads of a run: what was done to the coordinates, and what they still hold."""

from __future__ import annotations

import json

import numpy as np
import pytest

from unbend.report.summary import not_included
from unbend.tables.manifest.whole import Manifest

from .manifests import manifest_of

NORTH_ARCSEC, EAST_ARCSEC = 0.17, 3.97

PLANE = {"shape": "plane", "in_calibration": "none"}
LENS = {"dc_dp_px_per_hpa": 0.006}


def manifest(direction: str = "remove", **cameras: dict) -> Manifest:
    full = {n: {"window": None, "principal_distance": None} | c for n, c in cameras.items()}
    return manifest_of({"config": {"refraction": {"direction": direction}, "cameras": full}})


def test_cameras_whose_lens_is_not_corrected_are_named():
    lines = not_included(manifest(tail={"principal_distance": LENS}, nose={}, left={}))
    assert lines[0].startswith("The principal distance of nose, left changes")
    assert lines[0].endswith("not removed.")
    assert "tail" not in " ".join(lines)


@pytest.mark.parametrize(
    ("window", "told"),
    [
        (PLANE, True),
        (PLANE | {"in_calibration": "glass"}, False),
        (PLANE | {"shape": "spherical"}, False),
        (None, False),
    ],
)
def test_glass_is_told_of_where_the_calibration_lacks_it(window, told):
    text = " ".join(not_included(manifest(belly={"window": window, "principal_distance": LENS})))
    assert ("The glass before belly" in text) == told
    assert "Earth curvature" in text


def test_nothing_is_to_be_switched_off_where_refraction_was_put_in():
    assert not_included(manifest("apply", belly={"principal_distance": LENS})) == []
    (line,) = not_included(manifest("apply", belly={}))
    assert line.endswith("not applied.")


def test_the_report_of_a_run_holds_these_lines(baseline):
    page = (baseline.output / "report.html").read_text(encoding="utf-8")
    values = json.loads((baseline.output / "manifest.json").read_text(encoding="utf-8"))
    lines = not_included(Manifest(values))
    assert len(lines) == 5  # two lenses, the glass, the plumb line, the curvature
    # PROJ's vgridshift at the middle of the flight, 47.400 N 8.642 E: differences over 1 km.
    heights = values["heights"]
    assert heights["deflection"]["north_arcsec"] == pytest.approx(NORTH_ARCSEC, abs=0.2)
    assert heights["deflection"]["east_arcsec"] == pytest.approx(EAST_ARCSEC, abs=0.2)
    size = np.hypot(NORTH_ARCSEC, EAST_ARCSEC)
    assert f"leans {size:.0f}" in " ".join(lines)
    assert heights["undulation"] == {
        "source": "mission.undulation_m", "min_m": 47.6, "max_m": 47.6
    }  # fmt: skip
    assert heights["log"] == ["msl", "ellipsoid"]
    assert heights["stations"].startswith("GPS")
    for line in lines:
        assert f"<li>{line}</li>" in page
    assert "What is not removed" in page
