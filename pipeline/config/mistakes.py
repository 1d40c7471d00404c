"""What is wrong with a mission file, in sentences: the key, what stands there, what may stand."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from pipeline.config.schema import alternatives, as_written, campaign_schema, in_words, nodes_at

Place = tuple[str | int, ...]
"""The keys that lead to a value, and places in lists, from 0."""

TODO = "TODO"
"""What stands in a mission file for a question that is still open."""

_YAML = {
    "mapping values are not allowed here": "there is a colon where none can stand: put quotes "
    "around the text, or check the indentation",
    "found character '\\t' that cannot start any token": "there is a tab: YAML is indented by "
    "spaces",
    "could not find expected ':'": "a key without a colon stands here or above",
    "expected <block end>": "the indentation differs from that of the lines above",
    "expected ',' or": "a bracket or a brace is not closed, or a comma is missing",
    "could not determine a constructor": "tags (!) are not taken",
    "found undefined alias": "an alias (*) has no anchor (&)",
    "expected a single document": "there are several documents (---); a mission file is one",
}
"""Beginnings of what the YAML parser says, and the same in plain words."""


def of_yaml(problem: str) -> str:
    """What keeps a text from being YAML."""
    own = problem.startswith(("the key ", "a key "))
    known = (words for beginning, words in _YAML.items() if problem.startswith(beginning))
    return problem if own else next(known, "here the text is no YAML")


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
    as such; what the models say of them, and of what holds them, is left out. What is not in
    ``own``, where that is given, has no line in the file: a campaign's defaults say it.
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
    """Whether there is a value at a place."""
    for key in place:
        held: Any = values
        inside = (isinstance(held, dict) and key in held) or (
            isinstance(held, list) and isinstance(key, int) and key < len(held)
        )
        if not inside:
            return False
        values = held[key]
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
