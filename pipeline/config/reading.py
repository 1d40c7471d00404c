"""Reading a mission file; a refusal names line, key and the nearest valid key."""

import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from pipeline.config.mistakes import of_yaml, open_questions, sentences_of
from pipeline.config.sections import Mission
from pipeline.errors import ConfigError

WHOLE = (
    "atmosphere.model", "atmosphere.sensors.*", "cameras.*", "control", "events.csv",
    "events.first_image.*", "events.images", "events.positions.*", "ground.height",
    "log.channels.*", "log.local_origin", "mount.*", "stations.orientation", "stations.trajectory",
)  # fmt: skip
"""Sections whose values belong together: a mission's own replaces the default as a whole."""

LEADING = ("ground.height", "mission.geoid", "mission.undulation_m", "events.log.*.channel")
"""Keys that the others of their section describe: of a mission that has one, these are its own."""

_REPLACED = ("bool", "int", "float", "timestamp")


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars (1e-6 is a number, no, on and 1:30 are words) and no repeated keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be a word", key.start_mark
                )
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value!r} stands here twice", key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if tag.rsplit(":", 1)[1] not in _REPLACED]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|false|False)$"), list("tTfF")
)
# A leading zero is left to the next rule: YAML 1.1 would read 0100 as 64.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$|^[-+]?\.(?:inf|Inf|INF)$"
        r"|^\.(?:nan|NaN|NAN)$"
    ),
    list("-+0123456789."),
)


def load_mission(path: Path | str) -> Mission:
    """Read and check a mission file; refuses with every mistake, its line and the nearest key.

    Opens nothing but the file itself.
    """
    path = Path(path)
    values, node = read_yaml(path)
    return mission_of(values, node, str(path))


def read_yaml(path: Path) -> tuple[dict[str, Any], yaml.Node]:
    """The sections of a file, and its nodes, which know their lines; refuses what is not YAML."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError.of("CONFIG-MISSING", path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError.of("CONFIG-UNREADABLE", path, error=error) from None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        values = loader.construct_document(node) if node is not None else None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise ConfigError(
            "CONFIG-YAML",
            of_yaml(str(getattr(error, "problem", None) or error)),
            where=f"{path}{line}",
            remedy="mend the YAML",
        ) from None
    if node is None or not isinstance(values, dict):
        required = [name for name, field in Mission.model_fields.items() if field.is_required()]
        raise ConfigError.of("CONFIG-EMPTY", path, required=", ".join(required))
    return values, node


def mission_of(
    own: dict[str, Any], node: yaml.Node, where: str, defaults: dict[str, Any] | None = None
) -> Mission:
    """Check the values of a mission; ``defaults`` stand where it has none of its own."""
    if "campaign" in own and "mission" not in own:
        raise ConfigError.of("CONFIG-CAMPAIGN", where)
    values = own if defaults is None else merged(defaults, own)
    mission: Mission | None = None
    items: list[Any] = []
    try:
        mission = Mission.model_validate(values)
    except ValidationError as error:
        items = error.errors(include_url=False, include_context=False)
    if mission is not None and not open_questions(values):
        return mission
    raise refusal_of(items, values, node, where, own=None if defaults is None else own)


def refusal_of(
    items: Sequence[Mapping[str, Any]],
    values: dict[str, Any],
    node: yaml.Node,
    where: str,
    *,
    own: dict[str, Any] | None = None,
) -> ConfigError:
    """The refusal of a file with what the models refuse of it; ``own`` as in `sentences_of`."""
    what = sentences_of(items, values, node, own)
    todo = bool(open_questions(values))
    kinds = {item["type"] for item in items}
    code = "CONFIG-UNKNOWN-KEY" if "extra_forbidden" in kinds else "CONFIG-INVALID"
    code = "CONFIG-TODO" if todo else code
    several = f"{len(what)} {'questions are open' if todo else 'mistakes'}\n    "
    return ConfigError(
        code, what[0] if len(what) == 1 else several + "\n    ".join(what), where=where,
        remedy="mend the file; `unbend help KEY` explains a key, `unbend schema` has them all",
    )  # fmt: skip


def merged(defaults: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """A mission's own values, and the defaults where it has none; null takes a default away.

    ``{mission}`` in the path of results of the defaults is the name of the mission.

    Values that belong together are all the mission's (`WHOLE`, `LEADING`).

    >>> merged({"log": {"path": "a", "max_gap_s": 2.0}, "mount": {"nadir": {"roll_deg": 1.0}}},
    ...        {"log": {"path": "b"}, "mount": {"nadir": {"yaw_deg": 90.0}}})
    {'log': {'path': 'b', 'max_gap_s': 2.0}, 'mount': {'nadir': {'yaw_deg': 90.0}}}
    """
    values = _merged(defaults, own)
    output, section = values.get("output"), values.get("mission")
    stated = isinstance(own.get("output"), dict) and "path" in own["output"]
    if isinstance(output, dict) and isinstance(section, dict) and not stated:
        path, name = output.get("path"), section.get("name")
        if isinstance(path, str) and isinstance(name, str):
            values["output"] = output | {"path": path.replace("{mission}", name)}
    return values


def _merged(defaults: dict[str, Any], own: dict[str, Any], above: str = "") -> dict[str, Any]:
    values = defaults | own
    for key in defaults.keys() & own.keys():
        place = f"{above}.{key}".removeprefix(".")
        if own[key] is None:
            del values[key]
        elif isinstance(defaults[key], dict) and isinstance(own[key], dict):
            leading = any(_is_of(LEADING, f"{place}.{inner}") for inner in own[key])
            if not leading and not _is_of(WHOLE, place):
                values[key] = _merged(defaults[key], own[key], place)
    return values


def _is_of(patterns: Sequence[str], place: str) -> bool:
    return any(fnmatchcase(place, pattern) for pattern in patterns)
