"""The keys of mission files one by one, with their allowed values in words."""

from collections.abc import Iterator
from dataclasses import dataclass

from unbend.config.schema import Node, alternatives, campaign_schema, mission_schema


@dataclass(frozen=True)
class MissionKey:
    """One key of a mission file, all in words; an empty text for what it does not have."""

    path: str  # as ``cameras.*.f_px``, where ``*`` is any name or place in a list
    text: str  # its description
    allowed: str  # values
    unit: str
    default: str
    example: str


def in_words(node: Node) -> str:
    """The values that a node of the schema allows, as ``a number from 10 to 1000000 [px]``."""
    unit = node.get("unit", "1")
    shown_unit = "" if unit == "1" else f" [{unit}]"
    form = node.get("patternErrorMessage", "text")
    words = [_arm_in_words(arm, shown_unit, form) for arm in alternatives(node)]
    return " or ".join(dict.fromkeys(words))


def _arm_in_words(arm: Node, unit: str, form: str) -> str:
    """The values that one alternative (arm of a union) of a node allows, in words.

    ``unit`` is put behind numbers, as `` [px]``. ``form`` describes a text, if the arm is a text.
    """
    if "enum" in arm:
        return " | ".join(str(value) for value in arm["enum"])
    if "const" in arm:
        return str(arm["const"])
    match arm.get("type"):
        case "number":
            return f"a number{_range_in_words(arm)}{unit}"
        case "integer":
            return f"a whole number{_range_in_words(arm)}{unit}"
        case "boolean":
            return "true or false"
        case "array":
            items = in_words(arm["items"])
            count = arm.get("minItems")
            if count is not None and count == arm.get("maxItems"):
                return f"a list of {count}: each {items}{unit}"
            return f"a list of {items}{unit}"
        case "object":
            keys = ", ".join(arm.get("properties", {}))
            return f"a section {{{keys}}}" if keys else "a section for each name"
    return form


def _range_in_words(arm: Node) -> str:
    """The limits of a number, as `` from 0 to 1``; empty without limits."""
    words = ""
    if "exclusiveMinimum" in arm:
        words += f" above {arm['exclusiveMinimum']:.10g}"
    elif "minimum" in arm:
        words += f" from {arm['minimum']:.10g}"
    highest = arm.get("maximum", arm.get("exclusiveMaximum"))
    if highest is not None:
        words += f" to {highest:.10g}"
    return words


def as_written(value: object) -> str:
    """A value as it is written in a mission file."""
    match value:
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case list():
            return f"[{', '.join(as_written(item) for item in value)}]"
        case dict():
            items = ", ".join(f"{key}: {as_written(item)}" for key, item in value.items())
            return f"{{{items}}}"
    return str(value) or '""'  # an empty text


def mission_keys(node: Node | None = None, above: str = "") -> Iterator[MissionKey]:
    """All keys of a mission file, each section before its own keys.

    With a ``node`` of the schema, only the keys of that node; ``above`` is then its own key.

    >>> keys = {key.path: key for key in mission_keys()}
    >>> keys["cameras.*.f_px"].allowed, keys["log.max_gap_s"].default
    ('a number from 10 to 1000000 [px]', '2.0')
    """
    for arm in alternatives(mission_schema() if node is None else node):
        value_of_any_name = arm.get("additionalProperties")  # a node if keys are names, else False
        if "items" in arm:
            yield from mission_keys(arm["items"], f"{above}.*")
        elif isinstance(value_of_any_name, dict):
            yield from mission_keys(value_of_any_name, f"{above}.*")
        required = arm.get("required", ())
        for key, value in arm.get("properties", {}).items():
            path = f"{above}.{key}".removeprefix(".")
            yield MissionKey(
                path,
                text=value["description"],
                allowed=in_words(value),
                unit=value.get("unit", ""),
                default=_default_in_words(value, is_required=key in required),
                example=as_written(value["examples"][0]) if "examples" in value else "",
            )
            yield from mission_keys(value, path)


def _default_in_words(value: Node, *, is_required: bool) -> str:
    """The default of a key in words; for a key without a default, whether it must be given."""
    if "default" not in value:
        return "must be given" if is_required else "must be given, unless other keys state it"
    default = value["default"]
    if isinstance(default, dict):
        return "as its keys" if default else "none"  # the defaults of the keys of a section
    return as_written(default)


def campaign_keys() -> list[MissionKey]:
    """The keys of a campaign file, without those of the mission files that it may contain."""
    keys = mission_keys(campaign_schema())
    return [key for key in keys if not key.path.startswith(("defaults.", "missions."))]
