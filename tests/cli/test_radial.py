"""Tables of angles, of methods, and `export` as a person meets them: eighty columns, codes."""

import pandas as pd
import pytest
import yaml

from tests.helpers import one_line
from unbend.report.accuracy import text_hash

from .printed import longest

pytestmark = pytest.mark.usefixtures("eighty_columns")

TEN_KM = ("angle", "--atmosphere", "us1976", "--camera-height", 10_000, "--ground-height", 0)
TWO_HEIGHTS = (*TEN_KM, "--camera-height", 3000)
WITH_PIXELS = (*TWO_HEIGHTS, "--focal-px", 20_000)


def test_radial_tables_in_a_terminal(obeyed):
    text = obeyed(*WITH_PIXELS)
    assert longest(text) <= 80
    # K of the Manual, 2410 H / (H^2 - 6 H + 250) at 3 and 10 km
    assert "camera 3000 m, ground 0 m: R at 45 deg" in text
    assert f"the Manual's formula {2410 * 3 / 241:.2f}" in text
    assert f"the Manual's formula {2410 * 10 / 290:.2f}" in text
    assert "20000.0" in text  # f tan 45
    assert "-0.0000" not in text


def test_radial_tables_as_csv(obeyed, tmp_path):
    out = tmp_path / "radial.csv"
    text = obeyed(*WITH_PIXELS, "--csv", out, "--max-angle", 75, "--step", 15)
    assert text.split() == [str(out)]
    rows = pd.read_csv(out)
    assert len(rows) == 2 * 6
    at_75 = rows[(rows["h_c_m"] == 10_000.0) & (rows["nadir_angle_deg"] > 74.0)]
    # 61.778543 arcsec with the index of 0.589 um; Ciddor's at 0.55 um is 0.23 % more.
    assert at_75["r_c_arcsec"].item() == pytest.approx(61.778543 * 1.0023, rel=2e-4)
    assert at_75["status"].item() == "ok"


def test_without_a_principal_distance_there_are_no_pixels(obeyed):
    text = obeyed(*TWO_HEIGHTS)
    assert "px" not in text


def test_a_ray_that_misses_says_so(obeyed):
    text = obeyed(*WITH_PIXELS, "--max-angle", 89)
    assert "misses_ground" in text
    assert "nan" not in text
    assert longest(text) <= 80


def test_metres_that_do_not_exist_are_explained(unbend):
    """At 86.9 degrees from 10 km only the bent ray lands."""
    words = (*TEN_KM, "--step", 40, "--max-angle")
    text = one_line(unbend(*words, 86.9).out)
    assert "No metres on the ground: the straight ray" in text
    assert "nan" not in text
    assert "No metres" not in unbend(*words, 80).out
    # A ray that misses has its own word.
    assert "No metres" not in unbend(*words, 89).out


def test_the_air_of_a_mission(unbend, baseline, obeyed):
    heights = ("angle", "--camera-height", 2800, "--ground-height", 300)
    text = obeyed(*heights, "--config", baseline.file)
    standard = unbend(*heights, "--atmosphere", "us1976")
    assert text.splitlines()[0] != standard.out.splitlines()[0]


IMPOSSIBLE = yaml.safe_load("""
- ['--distance 4000', ANGLE-ARGUMENTS]
- ['--nadir-angle 45 --csv a.csv', ANGLE-ARGUMENTS]
- ['--nadir-angle 45 --max-angle 60', ANGLE-ARGUMENTS]
- ['--nadir-angle 45 --step 5', ANGLE-ARGUMENTS]
- ['--atmosphere us1976 --config a.yaml', PROFILE-ARGUMENTS]
- ['--atmosphere us1967', ATMOSPHERE-NAME]
- ['--config nowhere.yaml', CONFIG-MISSING]
- ['--atmosphere us1976 --max-angle 90', RADIAL-ANGLE]
- ['--atmosphere us1976 --max-angle nan', RADIAL-ANGLE]
- ['--atmosphere us1976 --camera-height 100', RADIAL-HEIGHTS]
- ['--atmosphere us1976 --camera-height 1e8', RAY-OUTSIDE-PROFILE]
- ['--atmosphere us1976 --focal-px -1', RADIAL-FOCAL]
- ['--atmosphere us1976 --radius nan', RAY-BAD-MEASUREMENT]
""")


@pytest.mark.parametrize(("options", "code"), IMPOSSIBLE)
def test_a_table_that_does_not_exist(refusal_of, options, code):
    heights = ("--camera-height", 3000, "--ground-height", 500)
    refusal_of(code, 2, "angle", *heights, *options.split())


def test_compare_in_a_terminal(obeyed):
    text = obeyed("tables", "accuracy")
    assert longest(text) <= 80
    for name in ("plane", "gyer1996", "s1974_quadratic", "bertram1966", "manual"):
        assert f"\n{name} " in text


def test_compare_writes_page_and_picture(obeyed, tmp_path):
    obeyed("tables", "accuracy", "--atmosphere", "icao", "--out", tmp_path / "other.md")
    text = (tmp_path / "other.md").read_text("utf-8")
    assert "standard atmosphere icao" in text
    assert "](other.png)" in text
    assert text_hash(text).encode() in (tmp_path / "other.png").read_bytes()


@pytest.mark.parametrize(
    ("out", "code", "exit_code"),
    [("no/page.md", "STORAGE-WRITE", 5), ("page.png", "PAGE-FORMAT", 2)],
)
def test_a_page_that_cannot_be_written(refusal_of, tmp_path, out, code, exit_code):
    refusal_of(code, exit_code, "tables", "accuracy", "--out", tmp_path / out)
