"""Keys of a proposed mission file with their values, and tables of usual names for guesses."""

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Proposed:
    """A key of the mission file with its value as YAML text, and a remark for its comment."""

    key: str
    value: str
    remark: str = ""


@cache
def words_of_proposals() -> Mapping[str, Any]:
    """The tables of ``proposal.toml``: usual names of columns, units of sensors, datums."""
    text = resources.files(__package__).joinpath("proposal.toml").read_text("utf-8")
    return tomllib.loads(text)


def yaml_text(text: str) -> str:
    """A text as a YAML scalar, in quotes where it needs them.

    >>> yaml_text("flight.bin"), yaml_text("CAM[0]"), yaml_text("no: 1"), yaml_text("12")
    ('flight.bin', '"CAM[0]"', '"no: 1"', '"12"')
    """
    is_plain = re.fullmatch(r"(?!(?i:true|false|null)$)[A-Za-z./][\w./-]*", text)
    return text if is_plain else json.dumps(text, ensure_ascii=False)
