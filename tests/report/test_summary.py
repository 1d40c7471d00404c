"""What a person reads of a run: what was done to the coordinates, and what they still hold."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.report.summary import findings_first, headline, not_included

NORTH_ARCSEC, EAST_ARCSEC = 0.17, 3.97

PLANE = {"shape": "plane", "in_calibration": "none"}
LENS = {"dc_dp_px_per_hpa": 0.006}


def manifest(
    direction: str = "remove",
    count: int = 3,
    cabin: float | None = None,
    air: float | None = None,
    **cameras: dict,
) -> dict:
    full = {n: {"window": None, "principal_distance": None} | c for n, c in cameras.items()}
    some = {"count": count, "median": 0.3, "maximum": 1.2}
    return {
        "config": {"refraction": {"direction": direction}, "cameras": full},
        "correction": {"shift_px": some, "shift_ground_m": some, "cameras": {}},
        "observations": {"rows": 4},
        "cabin_sigma_share": {"median": cabin},
        "uncertainty": None if air is None else {"scale_sigma": air},
        "stations": {"ok": 2},
        "ledger": [],
    }


@pytest.mark.parametrize(("direction", "done"), [("remove", "corrected"), ("apply", "displaced")])
def test_the_headline_says_what_was_done(direction, done):
    assert headline(manifest(direction)).startswith(f"3 of 4 observations were {done}, by 0.3 px")
    none = headline(manifest(direction, count=0))
    assert none == f"None of the 4 observations could be {done}."


def test_the_headline_says_that_the_cabin_limits_the_result():
    """5 K are 5 % of R at 6 km; up to 2 % nothing is said, nor without a window."""
    for cabin in (None, 0.004, 0.02):
        assert headline(manifest(cabin=cabin, air=0.01)) == headline(manifest())
    assert headline(manifest(cabin=0.05, air=0.012)).endswith(
        " The air in the cabin is uncertain by 5 % of R in the median, the air outside by 1.2 %: "
        "the cabin, not the air, limits the result."
    )
    assert headline(manifest(cabin=0.021, air=0.13)).endswith("the air outside by 13 %.")
    assert headline(manifest(cabin=0.03)).endswith("uncertain by 3 % of R in the median.")


@pytest.mark.parametrize("count", [0, 3])
def test_the_headline_counts_suspect_stations_and_gives_the_first_reason(count):
    entries = [{"code": "ROLE", "what": "x"}] + [
        {"code": "STATIONS-SUSPECT", "what": f"{n} exposures: GPS[0] steps"} for n in (2, 1)
    ]
    suspect = manifest(count=count) | {"stations": {"ok": 2, "suspect": 3}, "ledger": entries}
    assert headline(suspect).endswith(
        " 3 stations are suspect: 2 exposures: GPS[0] steps (and 1 more entries in the ledger)."
    )
    assert headline(suspect | {"ledger": entries[:2]}).endswith("2 exposures: GPS[0] steps.")


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
    assert "Switch the refraction correction off" in text


def test_nothing_is_to_be_switched_off_where_refraction_was_put_in():
    assert not_included(manifest("apply", belly={"principal_distance": LENS})) == []
    (line,) = not_included(manifest("apply", belly={}))
    assert line.endswith("not applied.")


def test_the_report_of_a_run_holds_these_lines(baseline):
    page = (baseline.output / "report.html").read_text(encoding="utf-8")
    config = json.loads((baseline.output / "manifest.json").read_text(encoding="utf-8"))
    lines = not_included(config)
    assert len(lines) == 5
    # PROJ's vgridshift at the middle of the flight, 47.400 N 8.642 E: differences over 1 km.
    heights = config["heights"]
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


def test_medians_are_told_by_camera_and_findings_first():
    """Nadir and oblique are never pooled; a tiny shift is called so only of nearly all rows."""
    several = manifest(count=3)
    shift = {name: {"shift_px": {"count": 2, "median": px}, "shift_ground_m": {"median": px / 2}}
             for name, px in (("nadir", 0.01), ("oblique", 0.5))}  # fmt: skip
    several["correction"]["cameras"] = shift
    text = headline(several)
    assert "by 0.01 px (nadir) and 0.5 px (oblique) in the median and 1.2 px at most" in text
    assert "0.005 m (nadir) and 0.25 m (oblique) and 1.2 m on the ground" in text
    assert findings_first(several) == ""
    found = {"kind": "finding", "code": "PLAUSIBLE-VIEW", "what": "f in mm", "where": "f_px"}
    assert "likely mistakes" in findings_first(several | {"ledger": [found, found]}).lower()
    assert findings_first(several | {"ledger": [found, found]}).count("PLAUSIBLE-VIEW") == 1
    tiny = manifest(count=3)
    tiny["correction"]["shift_px"] = {"count": 3, "median": 0.001, "maximum": 0.01}
    assert "far below" not in headline(tiny)  # 3 of 4 rows
    tiny["observations"]["rows"] = 3
    assert "far below" in headline(tiny)
