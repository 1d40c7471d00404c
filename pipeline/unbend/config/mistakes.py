"""What is wrong with the values of a mission file, in a sentence for each mistake."""

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

LEAST_SIMILARITY = 0.5  # of the similarity of difflib: a letter wrong, or a word of several
MOST_SENTENCES = 100
"""Of one refusal: who has more mistakes does not read them all."""
MOST_REFUSED = 1000  # things that the models refuse, of which the first mistakes are told
LONGEST_ALLOWED = 150  # characters of what a key takes, beside its text
LONGEST_VALUE = 40  # characters of a value that is shown whole
OF_LIMITS = ("less_than_equal", "greater_than_equal")
"""Pydantic's types of the error that a number is beyond its limits."""
_SHOWN_OF_BEGIN = 20  # characters of a longer value
_SHOWN_OF_END = 16  # the same of its end


@dataclass(frozen=True)
class Mistake:
    """A value that is not allowed: where it stands, and what is wrong.

    The line of the mistake is that of ``line_place``, which the text names.
    """

    place: Place
    what: str
    line_place: Place


@dataclass(frozen=True)
class Refused:
    """One thing that the models refuse.

    kind : pydantic's type of the error.
    place, value : where in the file it is, and what stands there; None for a missing key.
    line_place : whose line is named; inside the place, where the text names keys of several
        sections.
    text : that of the validator that refuses it, empty if pydantic itself does.
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

    Of more than `MOST_SENTENCES` mistakes some are left out, and one more than that many are
    returned. Only the first `MOST_REFUSED` items are looked at.

    ``items`` is what the models refuse of the ``values``; open questions are mistakes too. ``node``
    knows the lines of the values; values that stand in no file have none. ``own`` are the values
    that stand in the mission file itself; a mistake in another value is in the defaults of the
    campaign, and its sentence says so instead of a line.
    """
    sentences: set[tuple[int, str]] = set()
    for mistake in mistakes_of(items[:MOST_REFUSED], values):
        if len(sentences) > MOST_SENTENCES:
            break
        line = 0 if node is None else line_of(node, mistake.line_place)
        origin = "" if node is None else f"line {line}"
        if own is not None and not has_place(own, _nearest_place(values, mistake.line_place)):
            origin = "defaults of the campaign"
        key = _written(mistake.place)
        parts = [part for part in (origin, key, mistake.what) if part]
        sentences.add((line, ": ".join(parts)))
    return [sentence for _, sentence in sorted(sentences)]


def mistakes_of(items: Iterable[Mapping[str, Any]], values: dict[str, Any]) -> Iterator[Mistake]:
    """The open questions of a file, and what the models refuse of it for other reasons."""
    is_campaign = "campaign" in values
    questions = open_questions(values)
    for place in questions:
        sentence = f"still TODO: allowed are {allowed_at(place)}"
        if not nodes_at(place):
            sentence = _unknown_key(place, is_campaign=is_campaign)
        yield Mistake(place, sentence, place)
    all_refused = [_refused(values, item) for item in items]
    misspelt = _misspelt_keys(all_refused, is_campaign=is_campaign)
    for refused in all_refused:
        # TODO is refused as a value too, and so may be the section around it.
        follows = any(_overlap(refused.place, question) for question in questions)
        is_misspelt = refused.kind == "missing" and refused.place in misspelt
        if follows or is_misspelt or _is_arm(refused, all_refused):
            continue
        yield Mistake(refused.place, _what(refused, values), refused.line_place)


def _misspelt_keys(all_refused: Iterable[Refused], *, is_campaign: bool) -> set[Place]:
    """The places that unknown keys seem to mean: what is missing there is not missing."""
    meant = set()
    for refused in all_refused:
        if refused.kind == "extra_forbidden":
            key = _suggested_key(refused.place, is_campaign=is_campaign)
            meant.add((*refused.place[:-1], key))
    return meant


def _refused(values: object, item: Mapping[str, Any]) -> Refused:
    """An error of pydantic, at its place in the file, which may be the key that it names."""
    error = item.get("ctx", {}).get("error")
    place, value = _found_at(values, item["loc"])
    line_place = place
    if isinstance(error, SectionError):
        if error.key:
            place = (*place, error.key)
        line_place = (*place, *error.at)
    text = "" if error is None else str(error)
    return Refused(item["type"], place, value, line_place, text)


def _is_within(place: Place, outer: Place) -> bool:
    """Whether a place is another one, or inside it."""
    return place[: len(outer)] == outer


def _overlap(place: Place, other: Place) -> bool:
    """Whether one of two places is the other, or inside it."""
    return _is_within(place, other) or _is_within(other, place)


def _is_arm(refused: Refused, others: Iterable[Refused]) -> bool:
    """Whether a section is refused as a whole only because of a mistake inside it.

    pydantic refuses such a section once for each kind of value (arm of a union) that it could be,
    and the key inside it. The mistake of the key says more.
    """
    # These kinds are mistakes of their own, whatever is refused inside.
    if refused.kind in ("value_error", "extra_forbidden", "missing"):
        return False
    if not isinstance(refused.value, dict | list):
        return False
    return any(
        other.place != refused.place and _is_within(other.place, refused.place) for other in others
    )


def _what(refused: Refused, values: dict[str, Any]) -> str:
    """What is wrong with a value, and what the key takes instead."""
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
    meant = _likely_meant(refused)
    if meant:
        return meant
    return f"{_shown(refused.value)} is not allowed; use {allowed}"


def _likely_meant(refused: Refused) -> str:
    """What to write in the place of a value that YAML read as another type; "" if unknown.

    YAML reads [0,5, 1,2] as four numbers, and {camera} without quotes as a section of empty keys.
    A lever arm that is longer than an aircraft is in another unit.
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
                f"{_shown(refused.value)} is not allowed; use {allowed_at(refused.place)}: lever "
                "arms are in metres, and this looks like millimetres or centimetres"
            )
        case dict() if "string" in types and _has_only_keys(refused.value):
            keys = ", ".join(map(str, refused.value))
            return f'put quotes around a text with braces: "{{{keys}}}"'
    return ""


def _has_only_keys(section: Mapping[str, object]) -> bool:
    """Whether a section has keys, and none of them a value."""
    values = section.values()
    return bool(values) and all(value is None for value in values)


def _keys_at(section: Place, *, is_campaign: bool) -> set[str]:
    """The keys that a section takes."""
    nodes = nodes_at(section)
    if is_campaign and not section:  # the file itself, which `nodes_at` takes for a mission's
        nodes = [campaign_schema()]
    allowed_keys: set[str] = set()
    for node in nodes:
        for arm in alternatives(node):
            allowed_keys.update(arm.get("properties", {}))
    return allowed_keys


def _suggested_key(place: Place, *, is_campaign: bool) -> str:
    """The key of the same section that an unknown key seems to mean; "" if there is none."""
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
    """What to write instead of a key that there is not."""
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
    """What a key that is missing means; and what it takes, if that is short or all there is."""
    texts = [node["description"] for node in nodes_at(place) if "description" in node][:1]
    allowed = allowed_at(place)
    if not texts or len(allowed) < LONGEST_ALLOWED:
        texts.append(f"it takes {allowed}")
    return f"is missing: {'; '.join(texts)}"


def _found_at(values: object, loc: Sequence[int | str]) -> tuple[Place, object]:
    """Place and value of an error of the models; the value of a missing key is None.

    ``loc`` is pydantic's place of the error. It has besides the keys the names of the arms of
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
            place.append(part)  # a key that is missing, and no arm
    return tuple(place), value


def _nearest_place(values: object, place: Place) -> Place:
    """The place itself, or the section around it that is in the file."""
    while not has_place(values, place):
        place = place[:-1]
    return place


def _written(place: Place) -> str:
    """A place as people write it: ``events.csv``, ``soundings[0].path``."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def _shown(value: object) -> str:
    """A value in a message: short, and on one line."""
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
    """What a place takes, with an example."""
    nodes: list[Node] = nodes_at(place)
    words = " or ".join(dict.fromkeys(in_words(node) for node in nodes))
    examples = [as_written(node["examples"][0]) for node in nodes if "examples" in node]
    if examples and " | " not in words:  # listed words need no example
        return f"{words}, as {examples[0]}"
    return words or "something else"
