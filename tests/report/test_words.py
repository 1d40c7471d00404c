"""How names and numbers are written: nothing of a name steers a terminal, no digit is noise."""

from __future__ import annotations

import math
import re
import sys
import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from unbend.report.words import length, pixels, shortened, visible, with_sigma

DIRECTIONS = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
"""Bidirectional classes of the marks that turn the direction of a text."""


def test_every_character_that_steers_or_hides_is_written_out():
    """By the categories of the Unicode database: control, format, surrogate, separators."""
    joiners = {"\u200c", "\u200d"}
    for point in range(sys.maxunicode + 1):
        mark = chr(point)
        category = unicodedata.category(mark)
        steers = category in ("Cc", "Cs", "Zl", "Zp")
        steers |= unicodedata.bidirectional(mark) in DIRECTIONS
        if steers and mark not in joiners:
            text = visible(f"a{mark}b")
            assert mark not in text
            assert re.fullmatch(r"a\\([nrt]|x[0-9a-f]{2}|u[0-9a-f]{4}|U[0-9a-f]{8})b", text)
        elif category[0] in "LMNPS":
            assert visible(mark) == mark


@given(st.text(), st.integers(3, 60))
def test_a_shortened_name_keeps_both_ends(name, most):
    whole = visible(name)
    text = shortened(name, most)
    assert len(text) <= most
    if len(whole) <= most:
        assert text == whole
    else:
        begin, end = text.split("…", 1) if text.count("…") == 1 else (text[:1], text[-1:])
        assert whole.startswith(begin)
        assert whole.endswith(end)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_value_and_sigma_end_at_the_same_place_and_lose_nothing(value, sigma):
    text, spread = with_sigma(value, sigma).split(" ± ")
    assert "e" not in text + spread
    assert text.partition(".")[2].isdigit() == spread.partition(".")[2].isdigit()
    assert len(text.partition(".")[2]) == len(spread.partition(".")[2])
    assert math.isclose(float(spread), sigma, rel_tol=0.051)
    assert abs(float(text) - value) <= 0.06 * sigma
    assert 1 <= len(spread.replace(".", "").strip("0")) <= 2


@given(st.floats(1e-3, 1e7))
def test_lengths_and_pixels_are_right_to_five_percent(value):
    number, unit = length(value).split()
    metres = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3}[unit]
    assert math.isclose(float(number) * metres, value, rel_tol=0.051)
    assert len(number) <= 5
    assert math.isclose(float(pixels(value).removesuffix(" px")), value, rel_tol=0.051)
