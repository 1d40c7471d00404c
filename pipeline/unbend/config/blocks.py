"""What the block of another program fills in: its cameras and orientations are in its files."""

from typing import Any

from unbend.config.section import is_block

INTERIOR_ORIENTATION = {
    "file",
    "model",
    "params",
    "metric",
    "f_px",
    "fx_px",
    "fy_px",
    "cx_px",
    "cy_px",
    "distortion",
}
"""Keys of which a camera has one, unless its orientation is that of the observations' block."""


def with_block(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a mission file, with the cameras and orientations of its block of observations.

    Without a block as observations they stay as they are. ``values`` are unchecked: a section that
    is no mapping is left as it is, to be refused later.
    """
    observations = values.get("observations")
    if not isinstance(observations, dict) or not is_block(observations.get("format")):
        return values
    block = {"file": observations.get("path"), "format": observations["format"]}
    filled = dict(values)
    cameras = values.get("cameras")
    if isinstance(cameras, dict):
        filled["cameras"] = _with_cameras(cameras, block)
    stations = values.get("stations")
    if stations is None:
        stations = {}
    if isinstance(stations, dict):
        others_give_stations = values.get("log") or values.get("events")
        filled["stations"] = _with_orientation(stations, block, alone=not others_give_stations)
    return filled


def _with_orientation(
    stations: dict[str, Any], block: dict[str, Any], *, alone: bool
) -> dict[str, Any]:
    """The section of stations, whose orientation is the block's unless it has a path of its own.

    A section without the key ``orientation`` gets that of the block only where nothing else gives
    stations: neither log nor events (``alone``), nor a trajectory.
    """
    if "orientation" in stations:
        orientation = stations["orientation"]
    elif alone and not stations.get("trajectory"):
        orientation = {}
    else:
        return stations
    if not isinstance(orientation, dict) or "path" in orientation:
        return stations
    of_block = {"path": block["file"], "format": block["format"]}
    return stations | {"orientation": of_block | orientation}


def _with_cameras(cameras: dict[str, Any], block: dict[str, Any]) -> dict[str, Any]:
    """The sections of the cameras; those without an orientation of their own have the block's."""
    filled = {}
    for name, section in cameras.items():
        if not isinstance(section, dict) or section.keys() & INTERIOR_ORIENTATION:
            filled[name] = section
            continue
        of_block = dict(block)
        if len(cameras) > 1:  # which of the block's cameras it is; a single one needs no name
            of_block["camera"] = name
        filled[name] = of_block | section
    return filled
