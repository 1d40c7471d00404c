"""Merge the defaults of a campaign with the values of a mission."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

WHOLE_SECTIONS = (
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
"""Sections with values that belong together: that of a mission replaces the default as a whole."""

LEADING_KEYS = ("ground.height", "mission.geoid", "mission.undulation_m", "events.log.*.channel")
"""If a mission states one of these keys, its section gets nothing from the defaults, because the
other keys of the section describe this one."""


def merged(defaults: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The values of a mission (``own``), and the defaults for keys that it does not state.

    null in ``own`` removes a default. A section of `WHOLE_SECTIONS`, or with a key of
    `LEADING_KEYS` in ``own``, is never a mixture of both. ``{mission}`` in a default path of
    results is replaced by the name of the mission.

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
    """Two mappings merged section by section.

    ``above`` is the place of both in the mission file, as ``events.log``. For a key of both:

    * null in ``own`` removes the key;
    * two sections are merged, except those of `WHOLE_SECTIONS`, and those in which ``own`` has a
      key of `LEADING_KEYS`;
    * any other value is that of ``own``.
    """
    values = defaults | own
    for key in defaults.keys() & own.keys():
        place = f"{above}.{key}".removeprefix(".")
        if own[key] is None:
            del values[key]
            continue
        if not isinstance(defaults[key], dict) or not isinstance(own[key], dict):
            continue  # the value of ``own`` stays
        has_leading = any(_matches_any(LEADING_KEYS, f"{place}.{inner}") for inner in own[key])
        if not has_leading and not _matches_any(WHOLE_SECTIONS, place):
            values[key] = _merged_sections(defaults[key], own[key], place)
    return values


def _matches_any(patterns: Sequence[str], place: str) -> bool:
    """Whether a place, as ``cameras.nadir``, matches one of the patterns, as ``cameras.*``."""
    return any(fnmatchcase(place, pattern) for pattern in patterns)
