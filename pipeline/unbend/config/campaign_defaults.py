"""What the missions of a campaign share, and what each says itself."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

WHOLE = (
    "atmosphere.model",
    "atmosphere.sensors.*",
    "cameras.*",
    "control",
    "events.csv",
    "events.first_image.*",
    "events.images",
    "events.positions.*",
    "ground.height",
    "log.channels.*",
    "log.local_origin",
    "mount.*",
    "stations.orientation",
    "stations.trajectory",
)
"""Sections whose values belong together: a mission's own replaces the default as a whole."""

LEADING = ("ground.height", "mission.geoid", "mission.undulation_m", "events.log.*.channel")
"""A mission that states one of these keys takes nothing of its section from the defaults: the other
keys of the section describe this one."""


def merged(defaults: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """A mission's own values, and the defaults where it has none; null takes a default away.

    ``{mission}`` in a default path of results is replaced by the mission's name. The values of a
    section of `WHOLE`, and those beside a key of `LEADING`, are the mission's own or the defaults',
    never a mixture.

    >>> merged({"log": {"path": "a", "max_gap_s": 2.0}, "mount": {"nadir": {"roll_deg": 1.0}}},
    ...        {"log": {"path": "b"}, "mount": {"nadir": {"yaw_deg": 90.0}}})
    {'log': {'path': 'b', 'max_gap_s': 2.0}, 'mount': {'nadir': {'yaw_deg': 90.0}}}
    """
    values = _merged_sections(defaults, own)
    states_output = isinstance(own.get("output"), dict) and "path" in own["output"]
    if states_output:  # a path of its own is taken literally
        return values
    match values:
        case {"output": {"path": str(path)}, "mission": {"name": str(name)}}:
            values["output"] = values["output"] | {"path": path.replace("{mission}", name)}
    return values


def _merged_sections(
    defaults: dict[str, Any], own: dict[str, Any], above: str = ""
) -> dict[str, Any]:
    """The values of two mappings, section by section; ``above`` are the keys that lead to them.

    For a key of both mappings:

    * null in ``own`` takes the key away;
    * two sections are merged, but for those of `WHOLE`, and those in which ``own`` has a key of
      `LEADING`;
    * everything else is as in ``own``.
    """
    values = defaults | own
    for key in defaults.keys() & own.keys():
        place = f"{above}.{key}".removeprefix(".")
        if own[key] is None:
            del values[key]
            continue
        if not isinstance(defaults[key], dict) or not isinstance(own[key], dict):
            continue  # with the mission's own value
        has_leading = any(_is_one_of(LEADING, f"{place}.{inner}") for inner in own[key])
        if not has_leading and not _is_one_of(WHOLE, place):
            values[key] = _merged_sections(defaults[key], own[key], place)
    return values


def _is_one_of(patterns: Sequence[str], place: str) -> bool:
    """Whether a place, as ``cameras.nadir``, matches one of some patterns, as ``cameras.*``."""
    return any(fnmatchcase(place, pattern) for pattern in patterns)
