"""Numbers and angles as people, spreadsheets and tag readers write them: one reader for all.

A number has a decimal point, or a decimal comma: ``-89.9``, ``-89,9``, ``2.3e-05``. An angle is a
number of degrees, or degrees, minutes and seconds with marks between them. Any other text is a
`ValueError` with the accepted forms; no text is read in part.
"""

import math
import re

_DIGITS = r"(?:\d+(?:[.,]\d*)?|[.,]\d+)"
_NUMBER = re.compile(rf"[-+]?{_DIGITS}(?:[eE][-+]?\d{{1,3}})?")
_FRACTION = re.compile(rf"(?P<above>[-+]?{_DIGITS})\s*/\s*(?P<below>{_DIGITS})")
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")  # 1,234 is a number of thousands, or not
_GROUPED_BEYOND_DOUBT = re.compile(  # by the other mark than that of the decimals, or by 8'927
    r"[-+]?[1-9]\d{0,2}"
    r"(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:['’\u00a0\u202f]\d{3})+(?:[.,]\d*)?)"
)
_UNKNOWN = {"", "nan", "inf", "+inf", "-inf", "undef", "none", "null", "n/a", "-"}

_PART = rf"[-+]?{_DIGITS}(?:\s*/\s*\d+)?"
_MARKED = re.compile(
    rf"(?P<degrees>{_PART})\s*(?:deg(?:rees)?|d|°|º)"
    rf"(?:\s*(?P<minutes>{_PART})\s*(?:'|′|’|m|min)(?:\s*(?P<seconds>{_PART})\s*(?:\"|″|''|”|s|sec))?)?"
)
_LISTED = re.compile(
    rf"\[\s*(?P<degrees>{_PART})\s*,\s*(?P<minutes>{_PART})\s*(?:,\s*(?P<seconds>{_PART})\s*)?\]"
)
_RATIONALS = re.compile(  # as exiv2 prints them
    r"(?P<degrees>\d+/\d+),?\s+(?P<minutes>\d+/\d+),?\s+(?P<seconds>\d+/\d+)"
)
_SPACED = re.compile(
    r"(?P<degrees>[-+]?\d+)[:\s]\s*(?P<minutes>\d+)[:\s]\s*(?P<seconds>\d+(?:[.,]\d*)?)"
)
_OF_XMP = re.compile(
    r"(?P<degrees>\d+),(?P<minutes>\d+\.\d+|\d+(?=,))(?:,(?P<seconds>\d+(?:\.\d+)?))?"
)
_WITH_HEMISPHERE = re.compile(
    r"(?P<angle>.*[^A-Za-z\s])\s*(?P<hemisphere>[NSEW]|north|south|east|west)", re.IGNORECASE
)
_HEMISPHERE_FIRST = re.compile(r"(?P<hemisphere>[NSEW])\s*(?P<angle>\d.*)", re.IGNORECASE)
_DEGREES_OR_MINUTES = re.compile(r"\d+,[0-5]?\d")  # 46,30N of XMP, or a decimal comma

LONGEST_TEXT = 200  # characters of a number or an angle; patterns take long on a hundred thousand
LETTERS_OF_AXIS = {"latitude": "NS", "longitude": "EW"}
NUMBERS_TAKEN = "a number like -89.9, -89,9 or 2.3e-05"
ANGLES_TAKEN = (
    "degrees like -89.9 or 46,9446, or degrees, minutes and seconds like 46 deg 56' 40.58\" N, "
    "46°56'40.58\"N, 46:56:40.58 or [46, 56, 2029/50]"
)


def is_number(text: str) -> bool:
    """Whether a text is a number, with a decimal point or a decimal comma.

    >>> [is_number(text) for text in ("-89,9", "2.3e-05", "1,234,567", "IMG_1", "")]
    [True, True, False, False, False]
    """
    return _NUMBER.fullmatch(text.strip()) is not None


def may_be_thousands(text: str) -> bool:
    """Whether the commas of a text may group thousands, as in 1,234.

    >>> [may_be_thousands(text) for text in ("1,234", "1234,567", "0,123", "12,5")]
    [True, False, False, False]
    """
    return _GROUPED.fullmatch(text.strip()) is not None


def has_grouped_thousands(text: str) -> bool:
    """Whether a text is a number whose thousands are grouped beyond doubt.

    >>> [has_grouped_thousands(text) for text in ("8.927,4661", "8,927.4661", "8'927", "1,234")]
    [True, True, True, False]
    """
    return _GROUPED_BEYOND_DOUBT.fullmatch(text.strip()) is not None


def number_of(text: str) -> float:
    """The number that a text states, also as a fraction; NaN for a word for unknown, as n/a.

    Raises ValueError for any other text, and for 1,234, which may be 1.234 or 1234.

    >>> number_of("-89,9"), number_of("2.3e-05"), number_of("300034/100"), number_of("undef")
    (-89.9, 2.3e-05, 3000.34, nan)
    """
    plain = text.strip()
    _refuse_long(plain)
    if plain.lower() in _UNKNOWN:
        return math.nan
    if may_be_thousands(plain):
        raise ValueError(f"{text!r} may be thousands or a decimal comma; write a decimal point")
    fraction = _FRACTION.fullmatch(plain)
    if fraction is not None:
        divisor = _value(fraction["below"])
        quotient = _value(fraction["above"]) / divisor if divisor else math.nan
        if math.isinf(quotient):
            raise ValueError(f"{text!r} is not {NUMBERS_TAKEN}")
        return quotient
    if not is_number(plain):
        raise ValueError(f"{text!r} is not {NUMBERS_TAKEN}")
    return _value(plain)


def height_of(text: str) -> float:
    """A height [m] from a tag: a number, perhaps with "m" and "above (below) sea level" behind.

    NaN for a word for unknown; raises ValueError for any other text.

    >>> height_of("3000.3 m Above Sea Level"), height_of("12 m Below Sea Level"), height_of("+5,2")
    (3000.3, -12.0, 5.2)
    """
    plain = text.strip().lower()
    _refuse_long(plain)
    number = re.sub(r"\s*(?:m|metres|meters)?\s*(?:(?:above|below) sea level)?$", "", plain)
    height = number_of(number)
    return -abs(height) if plain.endswith("below sea level") else height


def angle_of(text: str, hemisphere: str = "", letters: str = "NSEW") -> float:
    """An angle in degrees; NaN for a word for unknown, ValueError for any other text.

    ``hemisphere`` is a letter or word stated elsewhere: angles of S and W are negative. The sign,
    the letter in the text and ``hemisphere`` must agree. ``letters`` are those that the axis has.
    Minutes and seconds are at most 60, and only the last part that is not zero may have decimals.

    >>> round(angle_of("47 deg 18' 36.00\\" S"), 9), angle_of("[8, 30, 0]", "W"), angle_of("-89,9")
    (-47.31, -8.5, -89.9)
    >>> round(angle_of("46,56.676N"), 9), angle_of("2.3e-05")
    (46.9446, 2.3e-05)
    """
    plain = text.strip()
    _refuse_long(plain)
    letter_in_text = ""
    written = _WITH_HEMISPHERE.fullmatch(plain) or _HEMISPHERE_FIRST.fullmatch(plain)
    if written is not None:
        plain = written["angle"]
        letter_in_text = written["hemisphere"][0].upper()
        if _DEGREES_OR_MINUTES.fullmatch(plain):
            raise ValueError(
                f"{text!r} may be degrees or degrees and minutes; it is not {ANGLES_TAKEN}"
            )
    degrees = _parted_angle(plain, with_letter=bool(letter_in_text))
    if degrees is None:
        try:
            degrees = number_of(re.sub(r"\s*(?:deg(?:rees)?|°|º)$", "", plain))
        except ValueError:
            raise ValueError(f"{text!r} is not {ANGLES_TAKEN}") from None
    stated_letter = hemisphere.strip()[:1].upper()
    _check_letters(text, letter_in_text, stated_letter, letters)
    return _signed(degrees, text, letter_in_text or stated_letter)


def _check_letters(text: str, letter_in_text: str, stated_letter: str, letters: str) -> None:
    """Raise ValueError for a letter of the other axis, and for one that contradicts the stated.

    A letter is empty if there is none.
    """
    if letter_in_text and letter_in_text not in letters:
        raise ValueError(f"{text!r} has a letter of the other axis")
    has_both = letter_in_text and stated_letter and stated_letter in "NSEW"
    if has_both and letter_in_text != stated_letter:
        raise ValueError(
            f"{text!r} is not in the hemisphere {stated_letter}, which is stated for it"
        )


def _signed(degrees: float, text: str, hemisphere: str) -> float:
    """Degrees of ``text`` with the sign of a hemisphere, a letter or empty.

    Raises ValueError for negative degrees in the north or east.
    """
    if hemisphere in ("N", "E") and degrees < 0.0:
        raise ValueError(f"{text!r} is negative, and stated as {hemisphere}")
    return -abs(degrees) if hemisphere in ("S", "W") else degrees


def _parted_angle(text: str, *, with_letter: bool) -> float | None:
    """Degrees of an angle that is written in two or three parts; None for any other text.

    ``with_letter`` : the angle had a letter of its hemisphere. Only then a comma may separate
    degrees and minutes, as in XMP.
    """
    forms = [_LISTED, _RATIONALS, _SPACED, _MARKED]
    if with_letter:
        forms.append(_OF_XMP)
    for form in forms:
        parts = form.fullmatch(text)
        if parts is not None and parts["minutes"] is not None:
            return _sum_of_parts(parts["degrees"], parts["minutes"], parts["seconds"])
    return None


def _sum_of_parts(degrees: str, minutes: str, seconds: str | None) -> float:
    """Degrees of an angle in degrees, minutes and seconds; NaN if a part is 0/0.

    The degrees have the sign of the angle, also if they are -0. Raises ValueError for minutes or
    seconds outside 0 to 60, and for decimals of a part that is followed by another that is not 0.
    """
    degree_size = abs(number_of(degrees))
    minute_size = number_of(minutes)
    second_size = number_of(seconds or "0")
    if not all(map(math.isfinite, (degree_size, minute_size, second_size))):
        return math.nan
    has_seconds = second_size != 0.0
    has_minutes = minute_size != 0.0 or has_seconds
    are_degrees_split = has_minutes and degree_size % 1.0 != 0.0
    are_minutes_split = has_seconds and minute_size % 1.0 != 0.0
    is_in_range = 0.0 <= minute_size <= 60.0 and 0.0 <= second_size <= 60.0
    if are_degrees_split or are_minutes_split or not is_in_range:
        raise ValueError(f"{degrees} {minutes} {seconds or ''} is not {ANGLES_TAKEN}")
    size = degree_size + minute_size / 60.0 + second_size / 3600.0
    return math.copysign(size, -1.0 if degrees.startswith("-") else 1.0)


def _refuse_long(text: str) -> None:
    """Raise ValueError for a text that is longer than any number or angle."""
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"{text[:20]!r}... has {len(text)} characters; it is not {NUMBERS_TAKEN}")


def _value(number: str) -> float:
    """The value of a text that matches `_NUMBER`; ValueError if it is too large, as 1e400."""
    value = float(number.replace(",", "."))
    if math.isinf(value):
        raise ValueError(f"{number!r} is not {NUMBERS_TAKEN}")
    return value
