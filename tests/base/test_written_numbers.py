"""Numbers and angles as people write them: read whole, or not at all."""

import math

import pytest
import yaml

from unbend.written_numbers import angle_of, height_of, number_of

NUMBERS = yaml.safe_load("""
- ['-89,9', -89.9]
- ['2.3e-05', 2.3e-05]
- ['2,3E-5', 2.3e-05]
- [' +7 ', 7.0]
- ['.5', 0.5]
- ['5.', 5.0]
- ['300034/100', 3000.34]
- ['0,123', 0.123]
- ['1234,567', 1234.567]
""")


@pytest.mark.parametrize(("text", "number"), NUMBERS)
def test_numbers(text, number):
    assert number_of(text) == pytest.approx(number, rel=1e-12)
    assert angle_of(text) == pytest.approx(number, rel=1e-12)


@pytest.mark.parametrize("text", ["", " ", "nan", "undef", "0/0", "inf", "[0/0, 0/0, 0/0]"])
def test_what_says_that_it_is_unknown(text):
    assert math.isnan(angle_of(text))


@pytest.mark.parametrize(
    "text", ["1,234", "-12,345,678", "1.234,5", "1_000", "12 34", "IMG_1", "1,5,2", "--5", "0x10"]
)
def test_what_is_no_number(text):
    with pytest.raises(ValueError, match=r"is not|may be"):
        number_of(text)


ANGLES = """
46 deg 56' 40.58" N = 46.944605556
46 deg 56' 40,58" S = -46.944605556
46\xb056\u203240.58\u2033W = -46.944605556
46:56:40.58 = 46.944605556
-46 56 40.58 = -46.944605556
[46, 56, 2029/50] = 46.944605556
46 deg 56.676' = 46.9446
46,56.676S = -46.9446
46,56,40.58N = 46.944605556
46.9446 S = -46.9446
46,9446\xb0 = 46.9446
-0 30 0 = -0.5
46.5 deg = 46.5
7.438184 East = 7.438184
N46\xb056'40.58" = 46.944605556
S 46.5 = -46.5
46/1 56/1 4058/100 = 46.944605556
46/1, 56/1, 4058/100 = 46.944605556
[95/2, 0, 0] = 47.5
"""


@pytest.mark.parametrize("row", ANGLES.strip().splitlines())
def test_angles(row):
    text, degrees = row.split(" = ")
    assert angle_of(text) == pytest.approx(float(degrees), abs=1e-9)


def test_a_hemisphere_that_is_stated_elsewhere():
    assert angle_of("[8, 30, 0]", "West") == -8.5
    assert angle_of("-33.5", "S") == -33.5
    assert angle_of("8.5", "E") == 8.5
    assert angle_of("46 deg 30' S", "South") == -46.5
    assert angle_of("8.5 E", "Unknown ()") == 8.5


CONTRADICTIONS = yaml.safe_load("""
- ['46.5 N', 'S']
- ['-46.5 N', '']
- ['-8.5', East]
- [N-46.5, '']
- ['8.5 E', 'N']
""")


@pytest.mark.parametrize(("text", "hemisphere"), CONTRADICTIONS)
def test_hemispheres_that_contradict_are_not_read(text, hemisphere):
    with pytest.raises(ValueError, match=r"hemisphere|negative|is not"):
        angle_of(text, hemisphere)


def test_a_letter_of_the_other_axis_is_not_read():
    assert angle_of("8.5 E", letters="EW") == 8.5
    with pytest.raises(ValueError, match="other axis"):
        angle_of("8.5 E", letters="NS")


@pytest.mark.parametrize(
    "text",
    [
        "46 deg 75' 0\"",
        "[95/2, 30, 0]",
        "46.5 deg 30' 0\"",
        "46 deg 5.5' 10\"",
        "46,5N",
        "46 deg N E",
        "N",
        "46 56 61",
    ],
)
def test_what_is_no_angle(text):
    with pytest.raises(ValueError, match="is not degrees"):
        angle_of(text)


def test_heights_of_tags():
    assert height_of("3000,3 m Above Sea Level") == 3000.3
    assert height_of("12 m Below Sea Level") == -12.0
    assert height_of("+85.40") == 85.4
    with pytest.raises(ValueError, match="is not a number"):
        height_of("3000 ft")
