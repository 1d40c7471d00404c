"""Converts numbers and names to text for people, on the terminal and in the report."""

import math
import re
import textwrap

# C0 and C1 (colours, cursor, line breaks), line separators, lone surrogates, invisible characters,
# and those that reverse the direction of writing. Joiners (200c, 200d) are not among them: scripts
# and emoji need these.
_UNSEEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff"
    "\ufeff\ufff9-\ufffb\U000e0000-\U000e007f]"
)
_LONGEST_NAME = 40
# Unit of length, metres of one, and the length [m] below which it is used.
_UNITS_OF_LENGTH = (("mm", 1e-3, 0.1), ("cm", 1e-2, 1.0), ("m", 1.0, 1e4), ("km", 1e3, math.inf))


def visible(text: str, *, keep: str = "") -> str:
    r"""A text with control, invisible and direction-reversing characters replaced by escapes.

    The characters in ``keep`` are not replaced.

    >>> print(visible("a\x1b[31mred\r\n.jpg"), visible("gpj.\u202e001"), visible("Zürich 7.jpg"))
    a\x1b[31mred\r\n.jpg gpj.\u202e001 Zürich 7.jpg
    >>> visible("two\nlines\x07", keep="\n")
    'two\nlines\\x07'
    """

    def escaped(match: re.Match[str]) -> str:
        character = match[0]
        if character in keep:
            return character
        return character.encode("unicode_escape").decode()

    return _UNSEEN.sub(escaped, text)


NARROWEST = 40
"""Texts are wrapped to at least so many columns, also in a narrower terminal."""

HANG = 2
"""Blanks by which the second and further lines of a wrapped text are indented."""


def hanging(line: str, width: int) -> str:
    """A line wrapped to ``width`` columns, with its further lines indented; words stay whole.

    >>> print(hanging("  loss A-B: two images have no exposure in this log", 40))
      loss A-B: two images have no exposure
        in this log
    >>> hanging("short", 40)
    'short'
    """
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(
        line,
        max(NARROWEST, width),
        subsequent_indent=indent + " " * HANG,
        break_on_hyphens=False,
        break_long_words=False,
    )


def shortened(name: str, most: int = _LONGEST_NAME) -> str:
    """A name of at most ``most`` characters; the middle of a longer one is replaced by "…".

    >>> shortened("flight_2025-06-12_block_north_strip_07_oblique_left_00001.jpg")
    'flight_2025-06-12_bl…ique_left_00001.jpg'
    >>> shortened("nadir_00001"), shortened("nadir_00001", 7)
    ('nadir_00001', 'nad…001')
    """
    name = visible(name)
    if len(name) <= most:
        return name
    return f"{name[: most // 2]}…{name[len(name) - (most - 1) // 2 :]}"


def count(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun; ``plural`` only if it is not the noun with an s.

    >>> count(1, "image"), count(2188, "image"), count(0, "entry", "entries")
    ('1 image', '2,188 images', '0 entries')
    """
    word = noun if number == 1 else plural or f"{noun}s"
    return f"{number:,} {word}"


def significant(value: float | None, digits: int = 3, *, smallest: float = 0.001) -> str:
    """A number to ``digits`` significant digits, without an exponent; "-" for None.

    Digits before the decimal point are all kept, and zeros at the end of a fraction are not. Less
    than half of ``smallest`` is written as below it.

    >>> [significant(x) for x in (0.006234, 12.345, 1234.5, 2e-9, -2e-9, 0.0, None)]
    ['0.00623', '12.3', '1234', '<0.001', '>-0.001', '0', '-']
    >>> significant(61.778543, 5), significant(2e-5, 5, smallest=1e-6)
    ('61.779', '0.00002')
    """
    if value is None:
        return "-"
    if value == 0.0:
        return "0"
    if abs(value) < smallest / 2.0:
        return f"<{smallest:g}" if value > 0.0 else f">-{smallest:g}"
    rounded = float(f"{value:.{digits - 1}e}")  # 9.996 has the exponent of 10.0
    exponent = math.floor(math.log10(abs(rounded)))
    decimals = max(digits - 1 - exponent, 0)
    text = f"{value:.{decimals}f}"
    if "." not in text:
        return text
    return text.rstrip("0").rstrip(".")


def with_sigma(value: float, sigma: float | None, unit: str = "", *, signed: bool = False) -> str:
    """A value with its sigma, rounded to the same decimal place, and the unit.

    The sigma has two significant digits. Without a sigma (None, NaN or 0) the value has three.
    ``signed``: a positive value gets a plus sign.

    >>> with_sigma(14.32, 80.2, "%", signed=True), with_sigma(-2.627, 0.325, "%", signed=True)
    ('+14 ± 80 %', '-2.63 ± 0.33 %')
    >>> with_sigma(6.5336, 0.0218, "arcsec"), with_sigma(0.0002, 12.6, "K"), with_sigma(1234.5, 996)
    ('6.534 ± 0.022 arcsec', '0 ± 13 K', '1200 ± 1000')
    >>> with_sigma(6.8637, None, "arcsec"), with_sigma(-0.2, math.nan), with_sigma(1.0, 0.0996)
    ('6.86 arcsec', '-0.2', '1.00 ± 0.10')
    """
    if sigma is None or not 0.0 < sigma < math.inf:
        text = significant(value)
        spread = ""
    else:
        # Of the last of two significant digits; 0.0996 counts as 0.10. Negative: tens, hundreds.
        decimals = 1 - math.floor(math.log10(float(f"{sigma:.1e}")))
        shown_decimals = max(decimals, 0)
        rounded = round(value, decimals) + 0.0  # 0.0 in the place of -0.0
        text = f"{rounded:.{shown_decimals}f}"
        spread = f" ± {round(sigma, decimals):.{shown_decimals}f}"
    if signed and not text.startswith(("-", "<", ">")):
        text = f"+{text}"
    return f"{text}{spread} {unit}".rstrip()


def length(metres: float | None) -> str:
    """A length with two significant digits in mm, cm, m or km; whole metres from 10 m to 10 km.

    "-" for None.

    >>> [length(x) for x in (0.00397, 0.0128, 0.359, 1.06, 123.4, 3004.0, 12_345.0)]
    ['4 mm', '13 mm', '36 cm', '1.1 m', '123 m', '3004 m', '12 km']
    >>> [length(x) for x in (2e-5, 0.0, 0.0996, 0.996, -0.25, None)]
    ['<0.1 mm', '0 mm', '10 cm', '1 m', '-25 cm', '-']
    """
    if metres is None:
        return "-"
    rounded_m = abs(float(f"{metres:.1e}"))
    unit, metres_of_unit = next(
        (unit, metres_of_unit)
        for unit, metres_of_unit, limit_m in _UNITS_OF_LENGTH
        if rounded_m < limit_m
    )
    return f"{significant(metres / metres_of_unit, 2, smallest=0.1)} {unit}"


def pixels(value: float | None) -> str:
    """A number of pixels with two significant digits; "-" for None.

    >>> [pixels(x) for x in (0.0271, 1.3996, 123.4, 0.0, 0.0002, None)]
    ['0.027 px', '1.4 px', '123 px', '0 px', '<0.001 px', '-']
    """
    return "-" if value is None else f"{significant(value, 2)} px"
