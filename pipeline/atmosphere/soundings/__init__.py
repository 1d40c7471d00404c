"""Balloon soundings: the text of a file -> levels from the ground up. One module per format."""

from pipeline.atmosphere.soundings.level_checks import check_levels
from pipeline.atmosphere.soundings.levels import ColumnErrors, RawLevels, Sounding
from pipeline.atmosphere.soundings.registry import FORMATS, nearest_in_time, parse_sounding

__all__ = [
    "FORMATS",
    "ColumnErrors",
    "RawLevels",
    "Sounding",
    "check_levels",
    "nearest_in_time",
    "parse_sounding",
]
