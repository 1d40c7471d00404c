"""Reading a mission file; a refusal names line, key and the nearest valid key."""

from __future__ import annotations

import difflib
import re
import types
import typing
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ValidationError

from pipeline.config.sections import Mission
from pipeline.errors import ConfigError

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
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(
            "CONFIG-MISSING", "there is no such file", where=str(path), remedy="check the path"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            "CONFIG-UNREADABLE", f"cannot be read: {error}", where=str(path),
            remedy="a mission file is YAML in UTF-8",
        ) from None  # fmt: skip
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        values = loader.construct_document(node) if node is not None else None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise ConfigError(
            "CONFIG-YAML",
            str(getattr(error, "problem", None) or error),
            where=f"{path}{line}",
            remedy="mend the YAML",
        ) from None
    if not isinstance(values, dict):
        required = [name for name, field in Mission.model_fields.items() if field.is_required()]
        raise ConfigError(
            "CONFIG-EMPTY",
            "holds no sections",
            where=str(path),
            remedy=f"it needs {', '.join(required)}",
        )
    try:
        return Mission.model_validate(values)
    except ValidationError as error:
        raise _refusal(error, path, node) from None


def _refusal(error: ValidationError, path: Path, node: yaml.Node | None) -> ConfigError:
    """One refusal that names every mistake."""
    mistakes = []
    for item in error.errors(include_url=False):
        key, line = _place(node, item["loc"])
        what = item["msg"].removeprefix("Value error, ")
        if item["type"] == "extra_forbidden":
            what = "unknown key" + _hint(item["type"], item["loc"])
        elif item["type"] == "missing":
            what = "is missing" + _hint(item["type"], item["loc"])
        mistakes.append((line, f"line {line}: {key}: {what}" if key else f"line {line}: {what}"))
    # A union reports each of its arms; what stands at the same place is one mistake.
    ordered = [text for _, text in sorted(dict.fromkeys(mistakes))]
    unknown = any(item["type"] == "extra_forbidden" for item in error.errors())
    code = "CONFIG-UNKNOWN-KEY" if unknown else "CONFIG-INVALID"
    return ConfigError(
        code,
        ordered[0]
        if len(ordered) == 1
        else f"{len(ordered)} mistakes\n    " + "\n    ".join(ordered),
        where=str(path),
        remedy="mend the file; README.md lists the keys",
    )


def _place(node: yaml.Node | None, loc: tuple[int | str, ...]) -> tuple[str, int]:
    """The dotted key and line of a pydantic location, skipping the names of union arms."""
    keys: list[str] = []
    line = (node.start_mark.line + 1) if node is not None else 1
    for i, part in enumerate(loc):
        if isinstance(node, yaml.MappingNode):
            match = [(k, v) for k, v in node.value if k.value == str(part)]
            if match:
                line, node = match[0][0].start_mark.line + 1, match[0][1]
                keys.append(str(part))
            elif i == len(loc) - 1:
                keys.append(str(part))
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            if part < len(node.value):
                node = node.value[part]
            keys.append(f"[{part}]")
    return ".".join(keys), line


def _models_at(loc: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Sections that may stand at a location."""
    models: list[type[BaseModel]] = [Mission]
    a_name_follows = False
    for part in loc:
        if a_name_follows:  # the name of a camera, which may be the same as a key
            a_name_follows = False
            continue
        fields = [m.model_fields[str(part)] for m in models if str(part) in m.model_fields]
        a_name_follows = any("dict[" in str(field.annotation) for field in fields)
        # The name of a union arm leads to no other section.
        models = [s for field in fields for s in _sections_of(field.annotation)] or models
    return models


def _sections_of(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation):
        return [s for arg in typing.get_args(annotation) for s in _sections_of(arg)]
    return []


def _hint(kind: str, loc: tuple[int | str, ...]) -> str:
    """What to write instead of an unknown key, or the meaning and choices of a missing one."""
    models = _models_at(loc[:-1])
    key = str(loc[-1])
    if kind == "extra_forbidden":
        known = sorted({name for model in models for name in model.model_fields})
        near = difflib.get_close_matches(key, known, 1, 0.5)
        return f"; perhaps {near[0]!r}?" if near else f"; there is {', '.join(known)}"
    field = next((m.model_fields[key] for m in models if key in m.model_fields), None)
    if field is None:
        return ""
    is_literal = typing.get_origin(field.annotation) is Literal
    choices = [a for a in typing.get_args(field.annotation) if is_literal and isinstance(a, str)]
    meaning = f": {field.description}" if field.description else ""
    return (f" ({' | '.join(choices)})" if choices else "") + meaning
