"""Reading mission files: YAML of plain values, and what is wrong with them, in a sentence each."""

import difflib
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from unbend.config.cameras import mistakes
from unbend.config.schema import alternatives, as_written, campaign_schema, in_words, nodes_at
from unbend.config.sections import Mission
from unbend.errors import ConfigError

Place = tuple[str | int, ...]
"""The keys that lead to a value, and places in lists, from 0."""

TODO = "TODO"
"""What stands in a mission file for a question that is still open."""


def open_questions(values: Any) -> list[Place]:
    """The places of a mission file where `TODO` stands; what aliases repeat counts once."""
    found: list[Place] = []
    walked: set[int] = set()
    left: list[tuple[Place, Any]] = [((), values)]
    while left:
        place, value = left.pop()
        if value == TODO:
            found.append(place)
        if not isinstance(value, dict | list) or id(value) in walked:
            continue
        walked.add(id(value))
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        left += [((*place, key), held) for key, held in reversed(list(inner))]
    return found


def sentences_of(
    items: Sequence[Mapping[str, Any]],
    values: dict[str, Any],
    node: yaml.Node,
    own: dict[str, Any] | None = None,
) -> list[str]:
    """One sentence for each mistake, in the order of the file.

    ``items`` is what the models refuse, ``values`` and ``node`` are the file. Open questions come
    as such. What is not in ``own``, where that is given, is of a campaign's defaults: no line.
    """
    todo = open_questions(values)
    found: dict[tuple[Place, str], None] = {
        (place, f"still TODO: {_allowed(place)}"): None for place in todo
    }
    placed = [(*_found_at(values, item["loc"]), item) for item in items]
    for place, value, item in placed:
        of_question = any(t[: len(place)] == place or place[: len(t)] == t for t in todo)
        inside = any(other[: len(place)] == place != other for other, *_ in placed)
        # A union reports each of its arms: a section's own mistakes say more.
        arm = inside and isinstance(value, dict | list)
        match item["type"]:
            case _ if of_question:
                continue
            case "value_error":
                what = item["msg"].removeprefix("Value error, ")
            case "extra_forbidden":
                root = [campaign_schema()] if "campaign" in values else nodes_at(())
                of_place = nodes_at(place[:-1]) if place[:-1] else root
                nodes = [arm for node in of_place for arm in alternatives(node)]
                known = sorted({key for arm in nodes for key in arm.get("properties", {})})
                near = difflib.get_close_matches(str(place[-1]), known, 1, 0.5)
                what = f"unknown key; there is {', '.join(known)}"
                what = f"unknown key; perhaps {near[0]!r}?" if near else what
            case "missing":
                texts = [n["description"] for n in nodes_at(place) if "description" in n][:1]
                allowed = _allowed(place)
                texts += [allowed] if len(allowed) < 160 or not texts else []
                what = f"is missing: {'; '.join(texts)}"
            case _ if arm:
                continue
            case _:
                what = f"{_shown(value)} stands there, and {_allowed(place)}"
        found[place, what] = None
    lines = []
    for place, what in found:
        line = _line(node, place)
        key = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place).removeprefix(".")
        stands = place
        while not _stands(values, stands):
            stands = stands[:-1]
        inherited = own is not None and not _stands(own, stands)
        begin = "defaults of the campaign" if inherited else f"line {line}"
        lines.append((line, f"{begin}: {key}: {what}" if key else f"{begin}: {what}"))
    return [text for _, text in sorted(dict.fromkeys(lines))]


def _found_at(values: Any, loc: tuple[int | str, ...]) -> tuple[Place, Any]:
    """Place and value of an error of the models, without the arms of unions; None if missing."""
    place: list[str | int] = []
    for i, part in enumerate(loc):
        inside = isinstance(part, int) and isinstance(values, list) and part < len(values)
        if inside or (isinstance(values, dict) and part in values):
            values = values[part]
            place.append(part)
        elif i == len(loc) - 1 and isinstance(values, dict) and nodes_at((*place, part)):
            values = None
            place.append(part)  # a key that is missing
    return tuple(place), values


def _stands(values: Any, place: Place) -> bool:
    for key in place:
        inside = range(len(values)) if isinstance(values, list) else values
        if not isinstance(inside, dict | range) or key not in inside:
            return False
        values = values[key]
    return True


def _line(node: yaml.Node, place: Place) -> int:
    """The line of the key that a place ends with, or of the last on the way that is there."""
    line = int(node.start_mark.line) + 1
    for key in place:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
            node = node.value[key]
            continue
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        match = next(((k, v) for k, v in pairs if k.value == key), None)
        if match is None:
            break
        line, node = int(match[0].start_mark.line) + 1, match[1]
    return line


def _shown(value: Any) -> str:
    """A value in a message: short, and on one line."""
    match value:
        case None:
            return "nothing"
        case dict():
            return "a section"
        case list():
            return f"a list of {len(value)}"
        case str():
            return repr(value if len(value) <= 40 else f"{value[:20]}...{value[-16:]}")
    return as_written(value)


def _allowed(place: Place) -> str:
    """What may stand at a place, with an example."""
    nodes = nodes_at(place)
    words = " or ".join(dict.fromkeys(in_words(node) for node in nodes)) or "something else"
    examples = [as_written(node["examples"][0]) for node in nodes if "examples" in node]
    as_in = f", as {examples[0]}" if examples and " | " not in words else ""
    return f"it takes {words}{as_in}"


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
    """Read and check a mission file; refuses with every mistake, its line and the nearest key."""
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
        problem = str(getattr(error, "problem", None) or error)
        known = (
            words
            for beginning, words in mistakes()["yaml"].items()
            if problem.startswith(beginning)
        )
        own = problem.startswith(("the key ", "a key "))
        what = problem if own else next(known, "here the text is no YAML")
        remedy = "mend the YAML"
        raise ConfigError("CONFIG-YAML", what, where=f"{path}{line}", remedy=remedy) from None
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

    ``{mission}`` in a path of results is its name; `WHOLE` and `LEADING` values stay together.

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
