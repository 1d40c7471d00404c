"""The page of costs and accuracy has the figures of the pages and tests that it takes them from."""

import re

import numpy as np
import pytest

from tests.logs import REPOSITORY
from unbend import refraction_angle, standard_atmosphere

DOCS = REPOSITORY / "docs"
PAGE = (DOCS / "pages" / "guide" / "exact.md").read_text("utf-8")
WHEN = (DOCS / "when.md").read_text("utf-8")


def row(text, label):
    """The cells of the one row of a table that begins with a label."""
    (line,) = re.findall(rf"^\| {re.escape(label)}.*", text, re.MULTILINE)
    return re.split(r"\s*\|\s*", line.strip("| "))[1:]


@pytest.mark.parametrize(
    ("label", "factor"),
    [
        ("$R$ at 45°, US 1976 [arcsec]", np.degrees(1.0) * 3600.0),
        ("the same in pixels, f = 4,000 px", 4_000.0),
        ("the same, f = 20,000 px", 20_000.0),
    ],
)
def test_the_size_of_refraction(label, factor):
    air = standard_atmosphere("us1976")
    heights = np.array([120.0, 3000.0, 6000.0, 9000.0])
    angles_rad = refraction_angle(
        air,
        heights,
        0.0,
        np.pi / 4,
    )
    values = angles_rad * factor
    for shown, value in zip(row(PAGE, label), values, strict=True):
        digits = len(shown.partition(".")[2])
        assert float(shown) == pytest.approx(value, abs=0.51 * 10.0**-digits)


def range_of(label):
    """The smallest and the largest figure of a row over nine atmospheres."""
    values = [float(cell) for cell in row(WHEN, label)]
    return min(values), max(values)


def test_the_height_errors_of_a_nadir_block():
    shown = row(PAGE, "height error of a nadir block")[1:]
    for cell, km in zip(shown, (3, 6, 9), strict=True):
        low_high = [float(word) for word in cell.split(" to ")]
        expected = range_of(f"uncorrected [m], {km} km")
        assert low_high == pytest.approx(expected, abs=0.006)


def test_what_us_1976_leaves():
    """0.3 to 21 % over all heights, and the range of each height beside it."""
    ranges = [range_of(f"left by US 1976 [%], {km} km") for km in (3, 6, 9)]
    least, most = np.transpose(ranges)

    ((low, high),) = re.findall(r"^\| ([\d.]+) to (\d+) % \| height error", PAGE, re.MULTILINE)
    assert float(low) == round(min(least), 1)
    assert float(high) == round(max(most))
    (each,) = re.findall(r"3, 6 and 9 km: ([^|]+) \|", PAGE)
    figures = re.findall(r"([\d.]+) to (\d+) %", each)
    lows, highs = np.transpose(figures).astype(float)
    assert lows == pytest.approx(least, abs=0.5)
    assert highs.tolist() == np.round(most).tolist()


@pytest.mark.parametrize(
    ("label", "page", "label_there", "columns"),
    [
        ("[US 1976]", "theory/air.md", "US 1976", (0, 1, 2)),
        (
            "thermometer and barometer, climb alone",
            "theory/air.md",
            "thermometer and barometer with bias",
            (0, 1, 2),
        ),
        (
            "thermometer and barometer, climb and descent",
            "theory/air.md",
            "the same, climb and descent",
            (0, 1, 2),
        ),
        ("[climatology]", "air/climatology.md", "`auto`", (1, 3, 4)),
    ],
)
def test_the_errors_of_each_source_are_those_of_its_page(label, page, label_there, columns):
    text = (DOCS / "pages" / page).read_text("utf-8")
    there = row(text, label_there)
    expected = [there[column].removesuffix(" %") for column in columns]
    assert row(PAGE, label)[:3] == expected
