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

# Keys that validators fill in if the value of another key decides them: a block has its own path
# and angles, heights that follow from those of the cameras are above mean sea level.
_FILLED_IN = {"OrientationSection": {"path", "angles"}, "GroundSection": {"reference"}}

SHOWN_LAST = ("description", "unit", "examples", "patternErrorMessage")
"""Entries of a key for people; in the schema they come after those for machines."""


def all_sections(annotation: object = Mission | CampaignFile) -> dict[str, type[BaseModel]]:
    """The sections in the type of a key, and all sections inside them, by the names of classes.

    ``annotation`` is the type: a section, or a union, list or mapping of types.
    """
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
    """The JSON schema (draft 7) of a mission file; a copy, which the caller may change.

    It does not contain the conditions on several keys that validators check.
    """
    return deepcopy(_schema_of_missions())


def campaign_schema() -> Node:
    """The JSON schema (draft 7) of a campaign file; a copy, which the caller may change.

    It requires no key of a mission: the defaults of the campaign may state what a mission leaves
    out, and the reverse.
    """
    return deepcopy(_schema_of_campaigns())


@cache
def _schema_of_missions() -> Node:
    """As `mission_schema`, but always the same object."""
    schema = _in_order(Mission.model_json_schema(), Mission)
    path_alone = {"type": "string", "minLength": 1, "pattern": PATH}
    schema["properties"]["control"]["anyOf"].append(path_alone)
    return {"$schema": "http://json-schema.org/draft-07/schema#"} | schema


@cache
def _schema_of_campaigns() -> Node:
    """As `campaign_schema`, but always the same object."""
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
    """Change the schema that pydantic makes of the model ``root``, and return it.

    Titles are removed and texts for people moved to the end. Keys that validators fill in are not
    required, and defaults from factories are added.
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
    """Change the schema of a key: remove its title, and move texts for people to the end."""
    value.pop("title", None)
    for shown in SHOWN_LAST:
        if shown in value:
            value[shown] = value.pop(shown)


def alternatives(node: Node) -> list[Node]:
    """The alternatives (arms) of a node of the schema, without null; references are followed.

    A node without alternatives is its only one.
    """
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
    """The nodes of the schema for a place in a mission or campaign file.

    There are several if a section on the way may be of several kinds, and none if the place does
    not exist.
    """
    nodes = [_schema_of_missions()]
    if keys and keys[0] in CampaignFile.model_fields:
        nodes = [_schema_of_campaigns()]
    for key in keys:
        inner: list[Node] = []
        for node in nodes:
            for arm in alternatives(node):
                inner += _nodes_under(arm, key)
        nodes = inner
    return nodes


def _nodes_under(node: Node, key: str | int) -> list[Node]:
    """The node under a key, or of an item of a list; empty without such a key."""
    if isinstance(key, int):
        return [node["items"]] if "items" in node else []
    if key in node.get("properties", {}):
        return [node["properties"][key]]
    if isinstance(node.get("additionalProperties"), dict):
        return [node["additionalProperties"]]
    return []
