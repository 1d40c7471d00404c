"""docs/accuracy.md is what the command writes, and says what the figures say."""

import io
import re
import zlib

import pytest

from tests.logs import REPOSITORY
from unbend.report.accuracy import compare_all, text_hash

PAGE = REPOSITORY / "docs" / "accuracy.md"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    from unbend.cli.physics import write_comparison

    path = tmp_path_factory.mktemp("page") / "accuracy.md"
    write_comparison(compare_all("us1976"), path)
    return path


def description(picture):
    """The text chunk of a PNG with the key Description."""
    png = io.BytesIO(picture.read_bytes())
    png.seek(8)
    while head := png.read(4):
        length = int.from_bytes(head)
        content = png.read(4 + length)  # its kind before it
        checksum = int.from_bytes(png.read(4))
        assert checksum == zlib.crc32(content)
        kind, _, text = content.partition(b"\0")
        if kind == b"tEXtDescription":
            return text.decode()
    return ""


def table(text, before):
    """The table that follows a line, by its first column."""
    from_line = text[text.index(before) :]
    _, lines, *_ = from_line.split("\n\n", 2)
    rows = {}
    for line in lines.splitlines():
        cells = line.strip("|").split("|")
        name, *numbers = map(str.strip, cells)
        if not name.startswith(":"):
            rows[name] = numbers
    return rows


def test_the_page_is_as_generated(written):
    """After a change of the physics: unbend tables accuracy --out docs/accuracy.md"""
    assert PAGE.read_text("utf-8") == written.read_text("utf-8")


def test_the_picture_belongs_to_the_page():
    picture = PAGE.with_suffix(".png")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size < 200_000
    page = PAGE.read_text("utf-8")
    assert description(picture) == text_hash(page)


def test_nothing_but_the_page_and_its_picture_is_written(written):
    picture = written.with_suffix(".png")
    assert {*written.parent.iterdir()} == {written, picture}


def test_the_figures_are_the_known_ones():
    """Check values of the issue: US 1976, Gyer's index, radius 6371 km."""
    text = PAGE.read_text("utf-8")
    exact = table(text, "R_c by `spherical` [arcsec], ground at 0 m:")
    angles = exact["camera"]
    at_45 = angles.index("45°")
    assert exact["10 km"][at_45] == "16.4"
    assert exact["10 km"][angles.index("75°")] == "61.8"
    assert exact["3 km"][at_45] == "7.089"
    manual = table(text, "`manual` (Manual of Photogrammetry, 2410 H / (H² - 6 H + 250)) minus")
    manual_rad = 2410 * 3 / (9 - 18 + 250) * 1e-6
    error = float(manual["3 km"][at_45])
    assert error == pytest.approx(manual_rad * 206264.80625 - 7.088778, abs=6e-4)
    title = "`saastamoinen1974_quadratic` (Saastamoinen 1974, Eq. 6, to 9 km) minus"
    quadratic = table(text, title)
    assert quadratic["10 km"] == [""] * len(angles)


def test_the_tables_of_angles_agree_with_those_of_errors():
    """Every error printed at an angle that is called good is small."""
    text = PAGE.read_text("utf-8")
    good = table(text, "Largest whole degree")
    heights = good.pop("")
    checked = 0
    for name, cells in good.items():
        if not name.startswith("`"):
            continue
        title = re.escape(name) + r" \([^\n]*minus `spherical`[^\n]*ground at 0 m:"
        start = re.search(title, text)
        errors = table(text, start[0])
        angles = [float(angle.rstrip("°")) for angle in errors["camera"]]
        for km, cell in zip(heights, cells, strict=True):
            if not cell:
                continue
            largest_deg = float(cell.split("/")[1])
            for angle, error in zip(angles, errors[km], strict=True):
                if angle <= largest_deg:
                    assert abs(float(error)) <= 1.0005, (name, km, angle)
                    checked += 1
    assert checked > 300


def test_no_figure_is_a_minus_zero_or_no_number():
    text = PAGE.read_text("utf-8")
    assert "nan" not in text.split("## Nadir angle up to")[1]
    assert "-0.000 " not in text
