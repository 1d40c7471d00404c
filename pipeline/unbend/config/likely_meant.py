"""What a refused key or value of a mission file was probably meant to be."""

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
"""Units at the end of keys, in small letters, and their names."""

METRIC_KEYS: Mapping[str, Sequence[str]] = {
    "focal_mm": ("f", "fx", "fy", "focal", "focal_length", "principal_distance", "camera_constant"),
    "pixel_um": ("pixel", "pixel_size", "pixel_pitch", "pixelsize", "pitch", "pixel_spacing"),
    "format_mm": ("sensor", "sensor_width", "sensor_height", "sensor_size", "width", "height"),
    "ppa_mm": ("cx", "cy", "x0", "y0", "xp", "yp", "ppx", "ppy", "principal_point", "ppa"),
}
"""Keys of the section ``metric`` of a camera, each with wrong names that users give it."""


def comma_in_words(text: str) -> str:
    """What is wrong with a number that has a comma, and what to write; "" for any other text.

    >>> comma_in_words("-0,018")
    "'-0,018' has a decimal comma: write -0.018"
    >>> comma_in_words("20,000")
    "'20,000' has a comma: write 20.000 or 20000"
    """
    number = number_with_point(text)
    if number is None:
        return ""
    if _MAY_BE_GROUPS.fullmatch(text.strip()):
        return f"{text!r} has a comma: write {number} or {number.replace('.', '')}"
    mark = "a decimal comma" if "," in text and "." not in text.rpartition(",")[2] else "a comma"
    return f"{text!r} has {mark}: write {number}"


def number_with_point(text: str) -> str | None:
    """A number with a comma, rewritten with a point; None for any other text.

    >>> [number_with_point(text) for text in ("-0,018", "20.000,5", "20,000.5", "a,b")]
    ['-0.018', '20000.5', '20000.5', None]
    """
    text = text.strip()
    if _GROUPS_BY_COMMAS.fullmatch(text):
        return text.replace(",", "")
    if _NUMBER_WITH_COMMA.fullmatch(text) is None:
        return None
    whole, _, decimals = text.rpartition(",")
    return f"{re.sub(r'[^0-9+-]', '', whole)}.{decimals}"


def metric_key_of(key: str) -> str:
    """The key under ``metric`` that a wrong key of a camera, in mm or um, means; else empty.

    >>> metric_key_of("f_mm"), metric_key_of("pixel_size_um")
    ('metric.focal_mm', 'metric.pixel_um')
    >>> metric_key_of("focal_length"), metric_key_of("f_px")
    ('metric.focal_mm', '')
    """
    stem = key.lower()
    parts = _UNIT_AT_END.fullmatch(stem)
    if parts is not None and parts["unit"] in UNITS:
        if parts["unit"] not in ("mm", "um", "cm"):
            return ""
        stem = parts["stem"]
    elif stem not in ("focal_length", "pixel_size", "pixel_pitch", "sensor_width", "sensor_size"):
        return ""
    for metric, names in METRIC_KEYS.items():
        if stem in names:
            return f"metric.{metric}"
    return ""


def key_in_other_unit(key: str, allowed_keys: Collection[str]) -> str:
    """The allowed key for the same quantity in another unit; "" without one.

    >>> key_in_other_unit("roll_rad", {"roll_deg", "yaw_deg"}), key_in_other_unit("pitch", {"a"})
    ('roll_deg', '')
    """
    parts = _UNIT_AT_END.fullmatch(key.lower())
    stem = key.lower()
    if parts is not None and parts["unit"] in UNITS:
        stem = parts["stem"]
    for allowed_key in sorted(allowed_keys):
        other = _UNIT_AT_END.fullmatch(allowed_key)
        if other is not None and other["unit"] in UNITS and other["stem"] == stem:
            return allowed_key
    return ""


def unit_of(key: str) -> str:
    """The unit that a key ends in, in words; "" without one.

    >>> unit_of("lever_arm_m"), unit_of("name")
    ('metres', '')
    """
    parts = _UNIT_AT_END.fullmatch(key.lower())
    return "" if parts is None else UNITS.get(parts["unit"], "")
