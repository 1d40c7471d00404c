"""What a key or a value that is not taken was probably meant to be."""

import re
from collections.abc import Collection, Mapping, Sequence

_NUMBER_WITH_COMMA = re.compile(r"[-+]?[0-9][0-9.' ]*,[0-9]+(?:[eE][-+]?[0-9]+)?|[-+]?,[0-9]+")
_GROUPS_BY_COMMAS = re.compile(r"[-+]?[0-9]{1,3}(?:,[0-9]{3})+\.[0-9]+")  # 20,000.5
_MAY_BE_GROUPS = re.compile(r"[-+]?[1-9][0-9]{0,2}(?:,[0-9]{3})+")  # 20,000: 20 or 20 thousand
_UNIT_AT_END = re.compile(r"(?P<stem>.+)_(?P<unit>[a-z]+)")

UNITS = {
    "px": "pixels",
    "m": "metres",
    "km": "kilometres",
    "ft": "feet",
    "cm": "centimetres",
    "mm": "millimetres",
    "um": "micrometres",
    "nm": "nanometres",
    "deg": "degrees",
    "rad": "radians",
    "grad": "grads",
    "gon": "gons",
    "hpa": "hectopascals",
    "pa": "pascals",
    "kpa": "kilopascals",
    "mbar": "millibars",
    "c": "degrees Celsius",
    "k": "kelvins",
    "f": "degrees Fahrenheit",
    "s": "seconds",
    "ms": "milliseconds",
    "us": "microseconds",
    "h": "hours",
}
"""Units that keys end in, in small letters."""

METRIC_KEYS: Mapping[str, Sequence[str]] = {
    "focal_mm": ("f", "fx", "fy", "focal", "focal_length", "principal_distance", "camera_constant"),
    "pixel_um": ("pixel", "pixel_size", "pixel_pitch", "pixelsize", "pitch", "pixel_spacing"),
    "format_mm": ("sensor", "sensor_width", "sensor_height", "sensor_size", "width", "height"),
    "ppa_mm": ("cx", "cy", "x0", "y0", "xp", "yp", "ppx", "ppy", "principal_point", "ppa"),
}
"""Keys of the section ``metric`` of a camera, each by names that a length in mm or um may have."""


def comma_in_words(text: str) -> str:
    """What is wrong with a number that has a comma, and what to write; "" for any other text.

    >>> comma_in_words("-0,018")
    "'-0,018' has a decimal comma: write -0.018"
    >>> comma_in_words("20,000")
    "'20,000' has a comma: write 20.000 or 20000"
    """
    number = with_point(text)
    if number is None:
        return ""
    if _MAY_BE_GROUPS.fullmatch(text.strip()):
        return f"{text!r} has a comma: write {number} or {number.replace('.', '')}"
    mark = "a decimal comma" if "," in text and "." not in text.rpartition(",")[2] else "a comma"
    return f"{text!r} has {mark}: write {number}"


def with_point(text: str) -> str | None:
    """A number with a point that was written with a comma; None for any other text.

    >>> with_point("-0,018"), with_point("20.000,5"), with_point("20,000.5"), with_point("a,b")
    ('-0.018', '20000.5', '20000.5', None)
    """
    text = text.strip()
    if _GROUPS_BY_COMMAS.fullmatch(text):
        return text.replace(",", "")
    if _NUMBER_WITH_COMMA.fullmatch(text) is None:
        return None
    whole, _, decimals = text.rpartition(",")
    return f"{re.sub(r'[^0-9+-]', '', whole)}.{decimals}"


def camera_in_millimetres(key: str) -> str:
    """The key of ``metric`` for a key of a camera in millimetres or micrometres; "" for no such.

    >>> camera_in_millimetres("f_mm"), camera_in_millimetres("pixel_size_um")
    ('metric.focal_mm', 'metric.pixel_um')
    >>> camera_in_millimetres("focal_length"), camera_in_millimetres("f_px")
    ('metric.focal_mm', '')
    """
    stem = key.lower()
    unit = _UNIT_AT_END.fullmatch(stem)
    if unit is not None and unit["unit"] in UNITS:
        if unit["unit"] not in ("mm", "um", "cm"):
            return ""
        stem = unit["stem"]
    elif stem not in ("focal_length", "pixel_size", "pixel_pitch", "sensor_width", "sensor_size"):
        return ""
    for metric, names in METRIC_KEYS.items():
        if stem in names:
            return f"metric.{metric}"
    return ""


def same_in_other_unit(key: str, known: Collection[str]) -> str:
    """The known key of the same quantity in another unit; "" without one.

    >>> same_in_other_unit("roll_rad", {"roll_deg", "yaw_deg"}), same_in_other_unit("pitch", {"a"})
    ('roll_deg', '')
    """
    wanted = _UNIT_AT_END.fullmatch(key.lower())
    stem = key.lower()
    if wanted is not None and wanted["unit"] in UNITS:
        stem = wanted["stem"]
    for name in sorted(known):
        other = _UNIT_AT_END.fullmatch(name)
        if other is not None and other["unit"] in UNITS and other["stem"] == stem:
            return name
    return ""


def unit_of(key: str) -> str:
    """The unit that a key ends in, in words; "" without one.

    >>> unit_of("lever_arm_m"), unit_of("name")
    ('metres', '')
    """
    unit = _UNIT_AT_END.fullmatch(key.lower())
    return "" if unit is None else UNITS.get(unit["unit"], "")
