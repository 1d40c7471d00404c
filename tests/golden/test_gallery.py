"""The gallery's page against its scripts: all numbers of the quick ones, a part of the others."""

from __future__ import annotations

import math
import tomllib
from importlib import import_module

import pytest

pytest.importorskip("pycolmap")

from docs.gallery.plates import FOLDER, THEMES, numbers_of

TEXTS = tomllib.loads((FOLDER.parents[1] / "gallery" / "texts.toml").read_text(encoding="utf-8"))
PARTS = {"sources": {"numbers": (5,)}, "adjusted_block": {"names": ("uncorrected", "corrected")}}
"""Arguments for less than all rows."""


def same(cell: str, shown: str) -> bool:
    """Equal words, or numbers within two units of the last digit or 2 % (another processor)."""
    computed = cell.replace(",", "").split()
    printed = shown.replace(",", "").split()
    for a, b in zip(computed, printed, strict=True):
        try:
            digits = len(b.split(".")[1]) if "." in b else 0
            if not math.isclose(float(a), float(b), rel_tol=0.02, abs_tol=2.1 * 10.0**-digits):
                return False
        except ValueError:
            if a != b:
                return False
    return True


@pytest.mark.parametrize("name", [name for name in TEXTS if name != "sample_flight"])
def test_the_numbers_of_the_page_come_out_again(name):
    printed = {row[0]: row for row in numbers_of(name)}
    head, *rows = import_module(f"docs.gallery.{name}").rows(**PARTS.get(name, {}))
    assert next(iter(printed.values())) == head
    assert rows
    for row in rows:
        pairs = zip(row, printed[row[0]], strict=True)
        assert all(same(cell, shown) for cell, shown in pairs), (row, printed[row[0]])


@pytest.mark.parametrize("name", TEXTS)
def test_a_picture_is_there_in_both_themes(name):
    page = (FOLDER / "index.md").read_text(encoding="utf-8")
    for theme in THEMES:
        assert (FOLDER / f"{name}-{theme}.png").stat().st_size > 10_000
        assert f"![{TEXTS[name]['title']}]({name}-{theme}.png#only-{theme})" in page
    assert TEXTS[name]["text"] in page


def test_scripts_are_short():
    for path in (FOLDER.parents[1] / "gallery").glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 90, path.name


def test_another_number_is_noticed():
    assert same("0.421 px, 3 m", "0.422 px, 3 m")
    assert not same("0.421 px, 3 m", "0.521 px, 3 m")
    assert not same("0.421 px", "0.421 m")
