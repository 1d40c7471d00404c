"""Fill in cameras and orientations that a block of another program has in its own files."""

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
"""A camera without any of these keys gets its interior orientation from the block."""


def with_block(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a mission file; if its observations are a block, with references to the block.

    Cameras and ``stations.orientation`` then name the file of the block where they state no source
    of their own. ``values`` are unchecked: a section that is not a mapping stays, and is refused
    later.
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
        has_log_or_events = bool(values.get("log") or values.get("events"))
        filled["stations"] = _with_orientation(stations, block, has_log_or_events=has_log_or_events)
    return filled


def _with_orientation(
    stations: dict[str, Any], block: dict[str, Any], *, has_log_or_events: bool
) -> dict[str, Any]:
    """The section ``stations``, with path and format of the block in its ``orientation``.

    * An ``orientation`` without a path gets them.
    * A missing ``orientation`` is added if nothing else gives stations: neither log nor events nor
      a trajectory.
    * Any other section stays as it is.
    """
    if "orientation" in stations:
        orientation = stations["orientation"]
    elif not has_log_or_events and not stations.get("trajectory"):
        orientation = {}
    else:
        return stations
    if not isinstance(orientation, dict) or "path" in orientation:
        return stations
    of_block = {"path": block["file"], "format": block["format"]}
    return stations | {"orientation": of_block | orientation}  # a format of its own stays


def _with_cameras(cameras: dict[str, Any], block: dict[str, Any]) -> dict[str, Any]:
    """The sections of the cameras; one without `INTERIOR_ORIENTATION` gets file and format."""
    filled = {}
    for name, section in cameras.items():
        if not isinstance(section, dict) or section.keys() & INTERIOR_ORIENTATION:
            filled[name] = section
            continue
        of_block = dict(block)  # its file and format
        if len(cameras) > 1:  # which of the block's cameras it is; a single one needs no name
            of_block["camera"] = name
        filled[name] = of_block | section
    return filled
