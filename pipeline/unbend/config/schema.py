"""The JSON schema of a mission file, and its keys one by one."""

import json
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from unbend.config.sections import CampaignFile, Mission

Node = dict[str, Any]

PATH = r"^[^\x00]+$"
"""The pattern of keys that take a path."""

# What validators fill in, where the value of another key makes it known: a block has its own path
# and angles, heights that follow from the camera's are above mean sea level.
_FILLED_IN = {"OrientationSection": {"path", "angles"}, "GroundSection": {"reference"}}


@dataclass(frozen=True)
class MissionKey:
    """One key of a mission file: ``cameras.*.f_px``, where ``*`` is any name or place in a list."""

    path: str
    text: str
    allowed: str
    unit: str
    default: str
    example: str


def all_sections(annotation: Any = Mission | CampaignFile) -> dict[str, type[BaseModel]]:
    """The sections that an annotation names and all within them, by the names of their classes."""
    found, inner = {}, list(typing.get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        found[annotation.__name__] = annotation
        inner = [field.annotation for field in annotation.model_fields.values()]
    for part in inner:
        found |= all_sections(part)
    return found


@cache
def mission_schema() -> Node:
    """The JSON schema (draft 7) of a mission file, without what depends on several keys at once."""
    schema = _with_texts(Mission.model_json_schema(), Mission)
    control = schema["properties"]["control"]
    control["anyOf"].append({"type": "string", "minLength": 1, "pattern": PATH})  # its path alone
    return {"$schema": "http://json-schema.org/draft-07/schema#"} | schema


@cache
def campaign_schema() -> Node:
    """The JSON schema (draft 7) of a campaign file; what its missions share, each may leave out."""
    schema = _with_texts(CampaignFile.model_json_schema(), CampaignFile)
    mission = json.loads(json.dumps(mission_schema()))
    definitions = mission.pop("$defs") | {"Mission": mission}
    for node in definitions.values():
        node.pop("required", None)
    schema["$defs"] |= definitions
    schema["properties"]["defaults"]["$ref"] = "#/$defs/Mission"
    schema["properties"]["missions"]["items"]["anyOf"][1] = {"$ref": "#/$defs/Mission"}
    return {"$schema": mission.pop("$schema")} | schema


SHOWN_LAST = ("description", "unit", "examples", "patternErrorMessage")
"""What people read of a key stands behind what machines do."""


def _with_texts(schema: Node, root: type[BaseModel]) -> Node:
    """The schema of pydantic without its titles, and with the defaults that are made anew."""
    for name, section in all_sections(root).items():
        node = schema if section is root else schema["$defs"][name]
        required = set(node.get("required", ()))
        node["required"] = sorted(required - _FILLED_IN.get(name, set()))
        for key, value in node["properties"].items():
            value.pop("title", None)
            for shown in SHOWN_LAST:
                if shown in value:
                    value[shown] = value.pop(shown)
            factory = section.model_fields[key].default_factory
            if factory is not None:
                value["default"] = factory()  # type: ignore[call-arg]
    return schema


def alternatives(node: Node) -> list[Node]:
    """The nodes that a node of the schema may stand for, without null; references are followed."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        known = mission_schema()["$defs"]
        return [known[name] if name in known else campaign_schema()["$defs"][name]]
    inner = node.get("anyOf") or node.get("oneOf")
    if inner is None:
        return [] if node.get("type") == "null" else [node]
    return [found for arm in inner for found in alternatives(arm)]


def nodes_at(keys: tuple[str | int, ...]) -> list[Node]:
    """The nodes of the schema for a place in a mission or campaign file; empty without the key."""
    of_campaign = bool(keys) and keys[0] in CampaignFile.model_fields
    nodes: list[Node] = [campaign_schema() if of_campaign else mission_schema()]
    for key in keys:
        inner = []
        for node in (found for outer in nodes for found in alternatives(outer)):
            if isinstance(key, int):
                inner += [node["items"]] if "items" in node else []
            elif key in node.get("properties", {}):
                inner.append(node["properties"][key])
            elif isinstance(node.get("additionalProperties"), dict):
                inner.append(node["additionalProperties"])
        nodes = inner
    return nodes


def in_words(node: Node) -> str:
    """What a node of the schema allows, for example ``a number from 10 to 1000000 [px]``."""
    unit = f" [{node['unit']}]" if node.get("unit", "1") != "1" else ""
    form = node.get("patternErrorMessage")
    words = []
    for arm in alternatives(node):
        low, high = (
            arm.get(bound, arm.get(f"exclusive{bound.capitalize()}"))
            for bound in ("minimum", "maximum")
        )
        span = f" from {low:.10g}" if low is not None else ""
        span = f" above {low:.10g}" if "exclusiveMinimum" in arm else span
        span += f" to {high:.10g}" if high is not None else ""
        match arm.get("type"):
            case _ if "enum" in arm or "const" in arm:
                words.append(" | ".join(map(str, arm.get("enum", [arm.get("const")]))))
            case "number":
                words.append(f"a number{span}{unit}")
            case "integer":
                words.append(f"a whole number{span}{unit}")
            case "boolean":
                words.append("true or false")
            case "array":
                count, of = arm.get("minItems"), in_words(arm["items"])
                fixed = count is not None and count == arm.get("maxItems")
                words.append(f"a list of {f'{count}: each ' if fixed else ''}{of}{unit}")
            case "object":
                named = ", ".join(arm.get("properties", {}))
                words.append(f"a section {{{named}}}" if named else "a section for each name")
            case _:
                words.append(form or "text")
    return " or ".join(dict.fromkeys(words))


def as_written(value: Any) -> str:
    match value:
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case list():
            return f"[{', '.join(map(as_written, value))}]"
        case dict():
            return f"{{{', '.join(f'{key}: {as_written(v)}' for key, v in value.items())}}}"
    return str(value) or '""'


def mission_keys(node: Node | None = None, above: str = "") -> Iterator[MissionKey]:
    """All keys of a mission file, each after the one that it stands under.

    >>> keys = {key.path: key for key in mission_keys()}
    >>> keys["cameras.*.f_px"].allowed, keys["log.max_gap_s"].default
    ('a number from 10 to 1000000 [px]', '2.0')
    """
    node = mission_schema() if node is None else node
    for arm in alternatives(node):
        if "items" in arm or isinstance(arm.get("additionalProperties"), dict):
            yield from mission_keys(arm.get("items") or arm["additionalProperties"], f"{above}.*")
        for key, value in arm.get("properties", {}).items():
            path = f"{above}.{key}".removeprefix(".")
            default = value.get("default")
            stated = "none" if default == {} else as_written(default)
            if "default" not in value:
                filled_in = key not in arm.get("required", ())
                stated = "must be given" + ", unless other keys say it" * filled_in
            elif isinstance(default, dict) and default:
                stated = "as its own keys"
            yield MissionKey(
                path, value["description"], in_words(value), value.get("unit", ""), stated,
                as_written(value["examples"][0]) if "examples" in value else "",
            )  # fmt: skip
            yield from mission_keys(value, path)


def campaign_keys() -> list[MissionKey]:
    """The keys of a campaign file that are none of a mission file."""
    keys = mission_keys(campaign_schema())
    return [key for key in keys if not key.path.startswith(("defaults.", "missions."))]
