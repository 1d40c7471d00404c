"""The gallery's page against its scripts: all numbers of the quick ones, a part of the others."""

import tomllib
from importlib import import_module

import pytest

pytest.importorskip("pycolmap")

from docs.gallery.plates import FOLDER, THEMES, numbers_of

SCRIPTS = FOLDER.parents[1] / "gallery"
TEXTS = tomllib.loads((SCRIPTS / "texts.toml").read_text("utf-8"))
PARTS = {
    "sources": {"numbers": (5,)},
    "adjusted_block": {"names": ("uncorrected", "corrected")},
}
"""Arguments for less than all rows."""


def same(cell, shown):
    """Equal words, or numbers within two units of the last digit or 2 % (another processor)."""
    computed = cell.replace(",", "").split()
    printed = shown.replace(",", "").split()
    for word, expected in zip(computed, printed, strict=True):
        try:
            number = float(expected)
        except ValueError:
            if word != expected:
                return False
            continue
        decimals = len(expected.partition(".")[2])
        if float(word) != pytest.approx(number, rel=0.02, abs=2.1 * 10.0**-decimals):
            return False
    return True


@pytest.mark.parametrize("name", sorted(TEXTS.keys() - {"sample_flight"}))
def test_the_numbers_of_the_page_come_out_again(name):
    shown_head, *shown_rows = numbers_of(name)
    shown = {row[0]: row for row in shown_rows}

    script = import_module(f"docs.gallery.{name}")
    head, *rows = script.rows(**PARTS.get(name, {}))

    assert head == shown_head
    assert rows
    for row in rows:
        for cell, shown_cell in zip(row, shown[row[0]], strict=True):
            assert same(cell, shown_cell), row


@pytest.mark.parametrize("name", TEXTS)
def test_a_picture_is_there_in_both_themes(name):
    page = (FOLDER / "index.md").read_text("utf-8")
    title = TEXTS[name]["title"]
    for theme in THEMES:
        file = f"{name}-{theme}.png"
        assert (FOLDER / file).stat().st_size > 10_000
        assert f"![{title}]({file}#only-{theme})" in page
    assert TEXTS[name]["text"] in page


def test_scripts_are_short():
    for path in SCRIPTS.glob("*.py"):
        lines = path.read_text("utf-8").splitlines()
        assert len(lines) <= 90, path.name


def test_another_number_is_noticed():
    assert same("0.421 px, 3 m", "0.422 px, 3 m")
    assert not same("0.421 px, 3 m", "0.521 px, 3 m")
    assert not same("0.421 px", "0.421 m")
