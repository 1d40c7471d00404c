"""How names and numbers are written: nothing of a name steers a terminal, no digit is noise."""

import math
import re
import sys
import unicodedata

from hypothesis import given
from hypothesis.strategies import floats, integers, text

from unbend.report.words import length, pixels, shortened, visible, with_sigma

DIRECTIONS = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
"""Bidirectional classes of the marks that turn the direction of a text."""
STEERING = {"Cc", "Cs", "Zl", "Zp"}
JOINERS = {"\u200c", "\u200d"}
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3}


def test_every_character_that_steers_or_hides_is_written_out():
    """By the categories of the Unicode database: control, format, surrogate, separators."""
    escape = re.compile(r"a\\([nrt]|x[0-9a-f]{2}|u[0-9a-f]{4}|U[0-9a-f]{8})b")
    for point in range(sys.maxunicode + 1):
        mark = chr(point)
        category = unicodedata.category(mark)
        steers = category in STEERING
        turns = unicodedata.bidirectional(mark) in DIRECTIONS
        if (steers or turns) and mark not in JOINERS:
            written = visible(f"a{mark}b")
            assert mark not in written
            assert escape.fullmatch(written)
        elif category[0] in "LMNPS":
            assert visible(mark) == mark


@given(text(), integers(3, 60))
def test_a_shortened_name_keeps_both_ends(name, most):
    whole = visible(name)
    short = shortened(name, most)
    assert len(short) <= most
    if len(whole) <= most:
        assert short == whole
        return
    begin = short[0]
    end = short[-1]
    if short.count("…") == 1:  # the name has none
        begin, end = short.split("…")
    assert whole.startswith(begin)
    assert whole.endswith(end)


@given(floats(-1e6, 1e6), floats(1e-6, 1e6))
def test_value_and_sigma_end_at_the_same_place_and_lose_nothing(value, sigma):
    shown, spread = with_sigma(value, sigma).split(" ± ")
    assert "e" not in shown + spread
    _, _, decimals = shown.partition(".")
    _, _, decimals_of_sigma = spread.partition(".")
    assert len(decimals) == len(decimals_of_sigma)
    assert decimals.isdigit() == decimals_of_sigma.isdigit()
    assert math.isclose(float(spread), sigma, rel_tol=0.051)
    assert abs(float(shown) - value) <= 0.06 * sigma
    digits_of_sigma = spread.replace(".", "")
    significant = digits_of_sigma.strip("0")
    assert 1 <= len(significant) <= 2


@given(floats(1e-3, 1e7))
def test_lengths_and_pixels_are_right_to_five_percent(value):
    number, unit = length(value).split()
    metres = float(number) * METRES[unit]
    assert math.isclose(metres, value, rel_tol=0.051)
    assert len(number) <= 5
    px = float(pixels(value).removesuffix(" px"))
    assert math.isclose(px, value, rel_tol=0.051)
