"""Balloon soundings: the text of a file -> levels from the ground up."""

from unbend.atmosphere.soundings.formats import (
    FORMATS,
    ascents_of_text,
    nearest_in_time,
    parse_sounding,
)
from unbend.atmosphere.soundings.level_checks import check_levels
from unbend.atmosphere.soundings.levels import ColumnErrors, RawLevels, Sounding

__all__ = [
    "FORMATS",
    "ColumnErrors",
    "RawLevels",
    "Sounding",
    "ascents_of_text",
    "check_levels",
    "nearest_in_time",
    "parse_sounding",
]
