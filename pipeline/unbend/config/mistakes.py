"""Describe each mistake in the values of a mission file in a sentence."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from unbend.config.keys import as_written, in_words
from unbend.config.likely_meant import (
    comma_in_words,
    key_in_other_unit,
    metric_key_of,
    unit_of,
)
from unbend.config.schema import Node, alternatives, campaign_schema, nodes_at
from unbend.config.section import SectionError
from unbend.config.yaml_text import Place, has_place, line_of, open_questions

LEAST_SIMILARITY = 0.5  # by difflib, of a key to suggest: a wrong letter, or one word of several
MOST_SENTENCES = 100
"""Of one refusal: nobody reads more."""
MOST_REFUSED = 1000  # errors of pydantic that are looked at
LONGEST_ALLOWED = 150  # characters: longer lists of allowed values are left out behind a text
LONGEST_VALUE = 40  # characters of a value that is shown whole
OF_LIMITS = ("less_than_equal", "greater_than_equal")
"""Pydantic's types of the error that a number is beyond its limits."""
_SHOWN_OF_BEGIN = 20  # characters of a longer value
_SHOWN_OF_END = 16  # the same of its end


@dataclass(frozen=True)
class Mistake:
    """A mistake in the values of a file."""

    place: Place  # of the refused value
    what: str  # is wrong, in words
    line_place: Place  # whose line is shown: the place, or one that ``what`` names


@dataclass(frozen=True)
class Refused:
    """An error of pydantic.

    kind : its type.
    place, value : the refused value and its place in the file; None for a missing key.
    line_place : whose line is shown: the place, or one inside that the text names.
    text : of the validator that refuses the value; empty if pydantic itself does.
    """

    kind: str
    place: Place
    value: Any
    line_place: Place
    text: str = ""


def sentences_of(
    items: Sequence[Mapping[str, Any]],
    values: dict[str, Any],
    node: yaml.Node | None,
    own: dict[str, Any] | None = None,
) -> list[str]:
    """One sentence for each mistake, in the order of the file, with the line of the mistake.

    Of more than `MOST_SENTENCES` mistakes, `MOST_SENTENCES` + 1 are returned. Only the first
    `MOST_REFUSED` items are looked at.

    Parameters
    ----------
    items : errors of pydantic about the values; open questions are mistakes too.
    values : of the mission, or of a campaign file.
    node : with the lines of the values; None for values that are not from a file.
    own : the values of the mission file itself, None if these are all. A mistake in another value
        is in the defaults of the campaign; its sentence names these instead of a line.
    """
    sentences: set[tuple[int, str]] = set()
    for mistake in mistakes_of(items[:MOST_REFUSED], values):
        if len(sentences) > MOST_SENTENCES:
            break
        line = 0 if node is None else line_of(node, mistake.line_place)
        origin = "" if node is None else f"line {line}"
        if own is not None and not has_place(own, _nearest_place(values, mistake.line_place)):
            origin = "defaults of the campaign"
        key = _place_in_words(mistake.place)
        parts = [part for part in (origin, key, mistake.what) if part]
        sentences.add((line, ": ".join(parts)))
    return [sentence for _, sentence in sorted(sentences)]


def mistakes_of(items: Iterable[Mapping[str, Any]], values: dict[str, Any]) -> Iterator[Mistake]:
    """The mistakes in the values of a file: open questions, then errors with other causes.

    ``items`` are errors of pydantic. Left out are those that only follow from another mistake.
    """
    is_campaign = "campaign" in values
    # Where a key does not exist, the models refuse it with any value, TODO too.
    questions = [place for place in open_questions(values) if nodes_at(place)]
    for place in questions:
        yield Mistake(place, f"still TODO: allowed are {allowed_at(place)}", place)
    all_refused = [_as_refused(values, item) for item in items]
    misspelt = _misspelt_keys(all_refused, is_campaign=is_campaign)
    for refused in all_refused:
        # TODO is refused as a value too, and so may be the section around it.
        follows = any(_overlap(refused.place, question) for question in questions)
        is_misspelt = refused.kind == "missing" and refused.place in misspelt
        if follows or is_misspelt or _is_arm(refused, all_refused):
            continue
        yield Mistake(refused.place, _problem(refused, values), refused.line_place)


def _misspelt_keys(all_refused: Iterable[Refused], *, is_campaign: bool) -> set[Place]:
    """The places of the keys that unknown keys seem to mean.

    A key that is missing at such a place is misspelt: it is no mistake of its own.
    """
    meant_places = set()
    for refused in all_refused:
        if refused.kind == "extra_forbidden":
            key = _suggested_key(refused.place, is_campaign=is_campaign)
            meant_places.add((*refused.place[:-1], key))
    return meant_places


def _as_refused(values: object, item: Mapping[str, Any]) -> Refused:
    """An error of pydantic with its place in the file; that is the key, if the error names one."""
    error = item.get("ctx", {}).get("error")
    place, value = _located(values, item["loc"])
    line_place = place
    if isinstance(error, SectionError):
        if error.key:
            place = (*place, error.key)
        line_place = (*place, *error.at)
    text = "" if error is None else str(error)
    return Refused(item["type"], place, value, line_place, text)


def _is_within(place: Place, outer: Place) -> bool:
    """Whether a place is ``outer`` itself, or inside it."""
    return place[: len(outer)] == outer


def _overlap(place: Place, other: Place) -> bool:
    """Whether two places are equal, or one is inside the other."""
    return _is_within(place, other) or _is_within(other, place)


def _is_arm(refused: Refused, others: Iterable[Refused]) -> bool:
    """Whether a section is refused as a whole only because of a mistake inside it.

    pydantic refuses such a section once for each kind of value (arm of a union) that it could be,
    and the key inside it as well. Only the mistake of the key is useful.
    """
    # These kinds are mistakes of the section itself.
    if refused.kind in ("value_error", "extra_forbidden", "missing"):
        return False
    if not isinstance(refused.value, dict | list):
        return False
    return any(
        other.place != refused.place and _is_within(other.place, refused.place) for other in others
    )


def _problem(refused: Refused, values: dict[str, Any]) -> str:
    """What is wrong with a value in words, and the allowed values.

    ``values`` are those of the whole file.
    """
    match refused.kind:
        case "value_error":
            return refused.text
        case "extra_forbidden":
            return _unknown_key(refused.place, is_campaign="campaign" in values)
        case "missing":
            return _missing_key(refused.place)
    allowed = allowed_at(refused.place)
    if refused.value is None:
        return f"is empty; use {allowed}"
    advice = _advice_on_type(refused)
    if advice:
        return advice
    return f"{_value_in_words(refused.value)} is not allowed; use {allowed}"


def _advice_on_type(refused: Refused) -> str:
    """What to write instead of a value that YAML read as another type; "" if that is unknown.

    YAML reads [0,5, 1,2] as four numbers, and {camera} without quotes as a section of empty keys.
    Also for a lever arm that is longer than an aircraft, and so in another unit.
    """
    arms = [arm for node in nodes_at(refused.place) for arm in alternatives(node)]
    types = {arm.get("type") for arm in arms}
    match refused.value:
        case str() if not types.isdisjoint({"number", "integer"}):
            return comma_in_words(refused.value)
        case list() if any(len(refused.value) == 2 * arm.get("maxItems", -1) for arm in arms):
            allowed = allowed_at(refused.place)
            number = len(refused.value)
            return f"a list of {number}: numbers have a decimal point, not a comma; use {allowed}"
        case int() | float() if refused.kind in OF_LIMITS and "lever_arm_m" in refused.place:
            return (
                f"{_value_in_words(refused.value)} is not allowed; use "
                f"{allowed_at(refused.place)}: lever arms are in metres, and this looks like "
                "millimetres or centimetres"
            )
        case dict() if "string" in types and _has_only_keys(refused.value):
            keys = ", ".join(map(str, refused.value))
            return f'put quotes around a text with braces: "{{{keys}}}"'
    return ""


def _has_only_keys(section: Mapping[str, object]) -> bool:
    """Whether a section has keys, all without a value."""
    values = section.values()
    return bool(values) and all(value is None for value in values)


def _keys_at(section: Place, *, is_campaign: bool) -> set[str]:
    """The allowed keys of the section at a place; ``is_campaign`` : in a campaign file."""
    nodes = nodes_at(section)
    if is_campaign and not section:  # the file itself, which `nodes_at` takes for a mission's
        nodes = [campaign_schema()]
    allowed_keys: set[str] = set()
    for node in nodes:
        for arm in alternatives(node):
            allowed_keys.update(arm.get("properties", {}))
    return allowed_keys


def _suggested_key(place: Place, *, is_campaign: bool) -> str:
    """The allowed key of the same section that an unknown key seems to mean.

    "" if none is similar, or if the unknown key belongs to another section.
    """
    key = str(place[-1])
    allowed_keys = _keys_at(place[:-1], is_campaign=is_campaign)
    other_unit = key_in_other_unit(key, allowed_keys)
    if other_unit:
        return other_unit
    if len(sections_with_key(key)) == 1:
        return ""
    near = difflib.get_close_matches(key, sorted(allowed_keys), n=1, cutoff=LEAST_SIMILARITY)
    return near[0] if near else ""


def _unknown_key(place: Place, *, is_campaign: bool) -> str:
    """The sentence on an unknown key, with what to write instead."""
    section = place[:-1]
    allowed_keys = _keys_at(section, is_campaign=is_campaign)
    key = str(place[-1])
    metric = metric_key_of(key)
    if len(section) == 2 and section[0] == "cameras" and metric:
        in_pixels = "the principal distance in pixels is f_px; " if "focal" in metric else ""
        return (
            f"unknown key; {in_pixels}lengths of a camera in millimetres are in its section "
            f"metric: {metric}"
        )
    other_unit = key_in_other_unit(key, allowed_keys)
    if other_unit:
        return f"unknown key; perhaps {other_unit!r}, in {unit_of(other_unit)}?"
    elsewhere = sections_with_key(key)
    if len(elsewhere) == 1:
        return f"unknown key here; it is a key of another section: {elsewhere[0]}.{key}"
    near = _suggested_key(place, is_campaign=is_campaign)
    if near:
        return f"unknown key; perhaps {near!r}?"
    return f"unknown key; allowed: {', '.join(sorted(allowed_keys))}"


def sections_with_key(key: str) -> list[str]:
    """The sections of a mission file that have a key of this name.

    >>> sections_with_key("undulation_m"), sections_with_key("no_such_key")
    (['mission'], [])
    """
    names = []
    for root in nodes_at(()):
        for name in root.get("properties", {}):
            arms = [arm for node in nodes_at((name,)) for arm in alternatives(node)]
            if any(key in arm.get("properties", {}) for arm in arms):
                names.append(name)
    return names


def _missing_key(place: Place) -> str:
    """The sentence on a missing key: its description, and its allowed values if these are short.

    Without a description the allowed values are given at any length.
    """
    texts = [node["description"] for node in nodes_at(place) if "description" in node][:1]
    allowed = allowed_at(place)
    if not texts or len(allowed) < LONGEST_ALLOWED:
        texts.append(f"it takes {allowed}")
    return f"is missing: {'; '.join(texts)}"


def _located(values: object, loc: Sequence[int | str]) -> tuple[Place, object]:
    """The place in the file of an error, and the value there; None for a missing key.

    ``loc`` is pydantic's place of the error. Between the keys it also has the names of the arms of
    unions, which are left out.
    """
    place: list[str | int] = []
    value: Any = values
    for i, part in enumerate(loc):
        if has_place(value, (part,)):
            value = value[part]
            place.append(part)
            continue
        is_last = i == len(loc) - 1
        if is_last and isinstance(value, dict) and nodes_at((*place, part)):
            value = None
            place.append(part)  # a missing key, not an arm
    return tuple(place), value


def _nearest_place(values: object, place: Place) -> Place:
    """The place itself, or if it is not in the file, the innermost section around it that is."""
    while not has_place(values, place):
        place = place[:-1]
    return place


def _place_in_words(place: Place) -> str:
    """A place as one text: ``events.csv``, ``soundings[0].path``."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def _value_in_words(value: object) -> str:
    """A value for a message, short and on one line."""
    match value:
        case dict():
            return "a section"
        case list():
            return f"a list of {len(value)}"
        case str() if len(value) > LONGEST_VALUE:
            return repr(f"{value[:_SHOWN_OF_BEGIN]}...{value[-_SHOWN_OF_END:]}")
        case str():
            return repr(value)
    return as_written(value)


def allowed_at(place: Place) -> str:
    """The allowed values at a place in words, with an example."""
    nodes: list[Node] = nodes_at(place)
    words = " or ".join(dict.fromkeys(in_words(node) for node in nodes))
    examples = [as_written(node["examples"][0]) for node in nodes if "examples" in node]
    if examples and " | " not in words:  # listed words need no example
        return f"{words}, as {examples[0]}"
    return words or "something else"
