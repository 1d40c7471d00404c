"""docs/accuracy.md is what the command writes, and says what the figures say."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import pytest

from unbend.report.accuracy import compare_all, text_hash

PAGE = Path(__file__).resolve().parents[2] / "docs" / "accuracy.md"


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    from unbend.cli.physics import write_comparison

    path = tmp_path_factory.mktemp("page") / "accuracy.md"
    write_comparison(compare_all("us1976"), path)
    return path


def description(png: bytes) -> str:
    """The text chunk of a PNG with the key Description."""
    start = 8
    while start < len(png):
        (length,) = struct.unpack(">I", png[start : start + 4])
        end = start + 8 + length
        kind_and_content = png[start + 4 : end]
        (checksum,) = struct.unpack(">I", png[end : end + 4])
        assert checksum == zlib.crc32(kind_and_content)
        if kind_and_content.startswith(b"tEXtDescription\0"):
            return kind_and_content.split(b"\0", 1)[1].decode()
        start = end + 4
    return ""


def table(text: str, before: str) -> dict[str, list[str]]:
    """The table that follows a line, by its first column."""
    lines = text[text.index(before) :].split("\n\n", 2)[1].splitlines()
    rows = {}
    for line in lines:
        name, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not name.startswith(":"):
            rows[name] = cells
    return rows


def test_the_page_is_as_generated(written):
    """After a change of the physics: unbend tables accuracy --out docs/accuracy.md"""
    assert PAGE.read_text(encoding="utf-8") == written.read_text(encoding="utf-8")


def test_the_picture_belongs_to_the_page():
    png = PAGE.with_suffix(".png").read_bytes()
    assert png.startswith(b"\x89PNG")
    assert len(png) < 200_000
    assert description(png) == text_hash(PAGE.read_text(encoding="utf-8"))


def test_nothing_but_the_page_and_its_picture_is_written(written):
    assert {p.name for p in written.parent.iterdir()} == {"accuracy.md", "accuracy.png"}
    assert description(written.with_suffix(".png").read_bytes()) == text_hash(written.read_text())


def test_the_figures_are_the_known_ones():
    """Check values of the issue: US 1976, Gyer's index, radius 6371 km."""
    text = PAGE.read_text(encoding="utf-8")
    exact = table(text, "R_c by `spherical` [arcsec], ground at 0 m:")
    head = exact["camera"]
    assert exact["10 km"][head.index("45°")] == "16.4"
    assert exact["10 km"][head.index("75°")] == "61.8"
    assert exact["3 km"][head.index("45°")] == "7.089"
    manual = table(text, "`manual` (Manual of Photogrammetry, 2410 H / (H² - 6 H + 250)) minus")
    error = 2410 * 3 / (9 - 18 + 250) * 1e-6 * 206264.80625 - 7.088778
    assert float(manual["3 km"][head.index("45°")]) == pytest.approx(error, abs=6e-4)
    quadratic = table(
        text, "`saastamoinen1974_quadratic` (Saastamoinen 1974, Eq. 6, to 9 km) minus"
    )
    assert quadratic["10 km"] == [""] * len(head)


def test_the_tables_of_angles_agree_with_those_of_errors():
    """Every error printed at an angle that is called good is small."""
    text = PAGE.read_text(encoding="utf-8")
    good = table(text, "Largest whole degree")
    heights = good.pop("")
    checked = 0
    for name, cells in good.items():
        if not name.startswith("`"):
            continue
        start = re.search(re.escape(name) + r" \([^\n]*minus `spherical`[^\n]*ground at 0 m:", text)
        errors = table(text, start[0])
        for km, cell in zip(heights, cells, strict=True):
            if not cell:
                continue
            largest_deg = float(cell.split("/")[1])
            for angle, error in zip(errors["camera"], errors[km], strict=True):
                if float(angle[:-1]) <= largest_deg:
                    assert abs(float(error)) <= 1.0005, (name, km, angle)
                    checked += 1
    assert checked > 300


def test_no_figure_is_a_minus_zero_or_no_number():
    text = PAGE.read_text(encoding="utf-8")
    assert "nan" not in text.split("## Nadir angle up to")[1]
    assert "-0.000 " not in text
