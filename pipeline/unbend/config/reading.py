"""Reading mission files, and refusing those with mistakes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from unbend.config import messages
from unbend.config.campaign_defaults import merged
from unbend.config.mission_file import Mission
from unbend.config.mistakes import MOST_REFUSED, MOST_SENTENCES, sentences_of
from unbend.config.yaml_text import open_questions, read_yaml
from unbend.errors import Code, ConfigError


def load_mission(path: Path | str) -> Mission:
    """Read and check a mission file; refuses (ConfigError) with each mistake and its line."""
    path = Path(path)
    values, node = read_yaml(path)
    mission = mission_of(values, node, str(path))
    mission._folder = path.parent
    return mission


def folder_of(mission: Mission) -> Path:
    """The folder that relative paths of a mission are relative to.

    It is that of the file that `load_mission` read; the working directory for a mission that was
    made in memory.
    """
    return mission._folder


def mission_of(
    own: dict[str, Any],
    node: yaml.Node | None,
    where: str,
    defaults: dict[str, Any] | None = None,
) -> Mission:
    """Check the values of a mission and return the mission that they state.

    ``own`` are the values of the mission itself, ``defaults`` those of its campaign for keys that
    the mission does not state. ``node`` has the lines of ``own``; None if they are unknown.
    ``where`` names the mission in a refusal.
    """
    if "campaign" in own and "mission" not in own:
        raise messages.config_campaign(where=where)
    values = own if defaults is None else merged(defaults, own)
    own_in_campaign = None if defaults is None else own
    try:
        mission = Mission.model_validate(values)
    except ValidationError as error:
        items = error.errors(include_url=False)
        raise refusal_of(items, values, node, where, own=own_in_campaign) from None
    if open_questions(values):  # TODO in the place of a text; the refusal lists them
        raise refusal_of([], values, node, where, own=own_in_campaign)
    return mission


def refusal_of(
    items: Sequence[Mapping[str, Any]],
    values: dict[str, Any],
    node: yaml.Node | None,
    where: str,
    *,
    own: dict[str, Any] | None = None,
) -> ConfigError:
    """The refusal of a mission or campaign file, with its first `MOST_SENTENCES` mistakes.

    Arguments as in `sentences_of`; ``where`` names the file.
    """
    sentences = sentences_of(items, values, node, own)
    has_more = len(sentences) > MOST_SENTENCES or len(items) > MOST_REFUSED
    code = _code_of(items, has_questions=bool(open_questions(values)))
    return messages.mission_file_refused(
        code, where=where, mistakes=sentences[:MOST_SENTENCES], has_more=has_more
    )


def _code_of(items: Sequence[Mapping[str, Any]], *, has_questions: bool) -> Code:
    """The code of a refusal: of open questions, else of unknown keys, else of other mistakes."""
    if has_questions:
        return messages.CONFIG_TODO
    if any(item["type"] == "extra_forbidden" for item in items):
        return messages.CONFIG_UNKNOWN_KEY
    return messages.CONFIG_INVALID
