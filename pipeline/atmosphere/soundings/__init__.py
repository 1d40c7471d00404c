"""Balloon soundings: the text of a file -> levels from the ground up."""

from pipeline.atmosphere.soundings.formats import FORMATS, nearest_in_time, parse_sounding
from pipeline.atmosphere.soundings.level_checks import check_levels
from pipeline.atmosphere.soundings.levels import ColumnErrors, RawLevels, Sounding

__all__ = [
    "FORMATS",
    "ColumnErrors",
    "RawLevels",
    "Sounding",
    "check_levels",
    "nearest_in_time",
    "parse_sounding",
]
