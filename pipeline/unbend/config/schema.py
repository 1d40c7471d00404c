"""The JSON schema of mission files and campaign files."""

import typing
from copy import deepcopy
from functools import cache
from typing import Any

from pydantic import BaseModel

from unbend.config.campaign_file import CampaignFile
from unbend.config.mission_file import Mission

Node = dict[str, Any]

PATH = r"^[^\x00]+$"
"""The pattern of keys that take a path."""

# What validators fill in, where the value of another key makes it known: a block has its own path
# and angles, heights that follow from the camera's are above mean sea level.
_FILLED_IN = {"OrientationSection": {"path", "angles"}, "GroundSection": {"reference"}}

SHOWN_LAST = ("description", "unit", "examples", "patternErrorMessage")
"""What people read of a key stands behind what machines do."""


def all_sections(annotation: object = Mission | CampaignFile) -> dict[str, type[BaseModel]]:
    """The sections in the type of a key, and all within these, by the names of their classes."""
    sections: dict[str, type[BaseModel]] = {}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        sections[annotation.__name__] = annotation
        inner: list[Any] = [field.annotation for field in annotation.model_fields.values()]
    else:
        inner = list(typing.get_args(annotation))  # of a union, a list or a mapping
    for part in inner:
        sections |= all_sections(part)
    return sections


def mission_schema() -> Node:
    """The JSON schema (draft 7) of a mission file, without what depends on several keys at once.

    It is a copy, which the caller may change.
    """
    return deepcopy(_schema_of_missions())


def campaign_schema() -> Node:
    """The JSON schema (draft 7) of a campaign file; a copy, which the caller may change.

    No key of a mission is required in it: the defaults of the campaign may state what a mission
    leaves out, and the missions what the defaults leave out.
    """
    return deepcopy(_schema_of_campaigns())


@cache
def _schema_of_missions() -> Node:
    """As `mission_schema`, made once."""
    schema = _in_order(Mission.model_json_schema(), Mission)
    path_alone = {"type": "string", "minLength": 1, "pattern": PATH}
    schema["properties"]["control"]["anyOf"].append(path_alone)
    return {"$schema": "http://json-schema.org/draft-07/schema#"} | schema


@cache
def _schema_of_campaigns() -> Node:
    """As `campaign_schema`, made once."""
    schema = _in_order(CampaignFile.model_json_schema(), CampaignFile)
    mission = mission_schema()
    draft = mission.pop("$schema")
    definitions = mission.pop("$defs")
    definitions["Mission"] = mission
    for node in definitions.values():
        node.pop("required", None)
    schema["$defs"] |= definitions
    schema["properties"]["defaults"]["$ref"] = "#/$defs/Mission"
    mission_kinds = schema["properties"]["missions"]["items"]["anyOf"]  # a path, or sections
    mission_kinds[1] = {"$ref": "#/$defs/Mission"}
    return {"$schema": draft} | schema


def _in_order(schema: Node, root: type[BaseModel]) -> Node:
    """The schema of pydantic, changed where it stands: no titles, texts for people last.

    Keys that validators fill in are not required, and a default that a factory makes is stated.
    """
    for name, section in all_sections(root).items():
        node = schema if section is root else schema["$defs"][name]
        required = set(node.get("required", ()))
        node["required"] = sorted(required - _FILLED_IN.get(name, set()))
        for key, value in node["properties"].items():
            _put_in_order(value)
            factory = section.model_fields[key].default_factory
            if factory is not None:
                value["default"] = factory()  # type: ignore[call-arg]
    return schema


def _put_in_order(value: Node) -> None:
    """Remove the title of a key, and move what people read of it to the end."""
    value.pop("title", None)
    for shown in SHOWN_LAST:
        if shown in value:
            value[shown] = value.pop(shown)


def alternatives(node: Node) -> list[Node]:
    """The nodes that a node of the schema may stand for, without null; references are followed."""
    if "$ref" in node:
        return [_definition(node["$ref"].rpartition("/")[2])]
    arms = node.get("anyOf") or node.get("oneOf")
    if arms is not None:
        nodes: list[Node] = []
        for arm in arms:
            nodes += alternatives(arm)
        return nodes
    if node.get("type") == "null":
        return []
    return [node]


def _definition(name: str) -> Node:
    """The schema of a section, by the name of its class."""
    definitions: Node = _schema_of_missions()["$defs"]
    if name not in definitions:
        definitions = _schema_of_campaigns()["$defs"]
    definition: Node = definitions[name]
    return definition


def nodes_at(keys: tuple[str | int, ...]) -> list[Node]:
    """The nodes of the schema for a place in a mission or campaign file; empty for no such place.

    There are several where a value may be of several kinds.
    """
    nodes = [_schema_of_missions()]
    if keys and keys[0] in CampaignFile.model_fields:
        nodes = [_schema_of_campaigns()]
    for key in keys:
        inner: list[Node] = []
        for node in nodes:
            for arm in alternatives(node):
                inner += _at(arm, key)
        nodes = inner
    return nodes


def _at(node: Node, key: str | int) -> list[Node]:
    """The node under a key, or at a place in a list; empty without one."""
    if isinstance(key, int):
        return [node["items"]] if "items" in node else []
    if key in node.get("properties", {}):
        return [node["properties"][key]]
    if isinstance(node.get("additionalProperties"), dict):
        return [node["additionalProperties"]]
    return []
