"""How numbers and names are written for people, on the terminal and in the report."""

import math
import re
import textwrap

# C0 and C1 (colours, cursor, line breaks), line separators, lone surrogates, what is invisible or
# turns the direction of writing. Joiners (200c, 200d) stay: scripts and emoji need them.
_UNSEEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff"
    "\ufeff\ufff9-\ufffb\U000e0000-\U000e007f]"
)
_LONGEST_NAME = 40
_METRES_OF_UNIT = (("mm", 1e-3, 0.1), ("cm", 1e-2, 1.0), ("m", 1.0, 1e4), ("km", 1e3, math.inf))


def visible(text: str, *, keep: str = "") -> str:
    r"""A text with controls, bidirectional overrides and what is invisible written out.

    ``keep`` : of these, the characters that stay.

    >>> print(visible("a\x1b[31mred\r\n.jpg"), visible("gpj.\u202e001"), visible("Zürich 7.jpg"))
    a\x1b[31mred\r\n.jpg gpj.\u202e001 Zürich 7.jpg
    >>> visible("two\nlines\x07", keep="\n")
    'two\nlines\\x07'
    """

    def written(match: re.Match[str]) -> str:
        mark = match[0]
        return mark if mark in keep else mark.encode("unicode_escape").decode()

    return _UNSEEN.sub(written, text)


NARROWEST = 40
"""Columns of a terminal that texts are wrapped for at least."""

HANG = 2
"""Blanks by which the further lines of an entry stand behind its first."""


def hanging(line: str, width: int) -> str:
    """A line wrapped to a width, its further lines behind the first; words stay whole.

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
    """A visible name of at most so many characters; what is too long is left out of its middle.

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
    """A number with its noun.

    >>> count(1, "image"), count(2188, "image"), count(0, "entry", "entries")
    ('1 image', '2,188 images', '0 entries')
    """
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def significant(value: float | None, digits: int = 3, *, smallest: float = 0.001) -> str:
    """A number to so many significant digits, all those before the point, without an exponent.

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
    size = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    text = f"{value:.{max(digits - 1 - size, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def with_sigma(value: float, sigma: float | None, unit: str = "", *, signed: bool = False) -> str:
    """A value with its sigma, both to the place that the sigma is known to.

    The sigma has two significant digits. Without one (None, NaN or 0) the value has three.
    ``signed`` : with its sign if it is positive too.

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
        decimals = 1 - math.floor(math.log10(float(f"{sigma:.1e}")))  # 0.0996 counts as 0.10
        shown = max(decimals, 0)
        rounded = round(value, decimals) + 0.0  # 0.0 in the place of -0.0
        text = f"{rounded:.{shown}f}"
        spread = f" ± {round(sigma, decimals):.{shown}f}"
    if signed and not text.startswith(("-", "<", ">")):
        text = f"+{text}"
    return f"{text}{spread} {unit}".rstrip()


def length(metres: float | None) -> str:
    """A length of two significant digits in the unit that reads best, whole metres from 10 m on.

    >>> [length(x) for x in (0.00397, 0.0128, 0.359, 1.06, 123.4, 3004.0, 12_345.0)]
    ['4 mm', '13 mm', '36 cm', '1.1 m', '123 m', '3004 m', '12 km']
    >>> [length(x) for x in (2e-5, 0.0, 0.0996, 0.996, -0.25, None)]
    ['<0.1 mm', '0 mm', '10 cm', '1 m', '-25 cm', '-']
    """
    if metres is None:
        return "-"
    unit, factor = next(
        (unit, factor)
        for unit, factor, below in _METRES_OF_UNIT
        if abs(float(f"{metres:.1e}")) < below
    )
    return f"{significant(metres / factor, 2, smallest=0.1)} {unit}"


def pixels(value: float | None) -> str:
    """Pixels to two significant digits.

    >>> [pixels(x) for x in (0.0271, 1.3996, 123.4, 0.0, 0.0002, None)]
    ['0.027 px', '1.4 px', '123 px', '0 px', '<0.001 px', '-']
    """
    return "-" if value is None else f"{significant(value, 2)} px"
