"""The missions of a command: files, and campaign files with what their missions share."""

from __future__ import annotations

import glob
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from unbend.config.reading import Place, merged, mission_of, open_questions, read_yaml, refusal_of
from unbend.config.schema import PATH, alternatives, nodes_at
from unbend.config.sections import CampaignFile, Mission
from unbend.errors import ConfigError

_NO_LINES = yaml.MappingNode("", [], yaml.Mark("", 0, 0, 0, None, 0))
_IS_CAMPAIGN = re.compile(r"""^["']?(campaign|missions)["']?\s*:|^\s*\{""", re.MULTILINE)
_URL = re.compile("[A-Za-z][A-Za-z0-9+.-]+:/")  # as `is_url` of the rooms above has it


@dataclass(frozen=True)
class MissionRef:
    """A mission to run, small and of plain values: it can be sent to another process or machine.

    ``defaults`` are sections that stand where the file has none, as JSON; ``own`` those of one
    that stands in the campaign file itself.
    """

    path: Path
    defaults: str = ""
    own: str = ""
    campaign: str = ""

    @classmethod
    def of(cls, mission: MissionRef | Path | str) -> MissionRef:
        """The reference itself, or that of a mission file alone."""
        return mission if isinstance(mission, MissionRef) else cls(Path(mission))

    @property
    def folder(self) -> Path:
        """The folder from which its relative paths resolve."""
        return self.path.parent

    @property
    def label(self) -> str:
        """What messages call it: its file, and its name where that is a campaign's."""
        own = json.loads(self.own) if self.own else {}
        return f"{self.path}: {own['mission']['name']}" if own else str(self.path)

    @property
    def words(self) -> tuple[str, ...]:
        """What follows `unbend run` to run this mission alone."""
        name = json.loads(self.own)["mission"]["name"] if self.own else str(self.path)
        return (self.campaign, "--mission", name) if self.campaign else (name,)

    def load(self) -> Mission:
        defaults = json.loads(self.defaults) if self.defaults else None
        if self.own:
            return mission_of(json.loads(self.own), _NO_LINES, self.label, defaults)
        values, node = read_yaml(self.path)
        return mission_of(values, node, str(self.path), defaults)


@dataclass(frozen=True)
class Campaign:
    """A campaign file as understood: its name, the folder of its page, and its missions."""

    path: Path
    name: str
    output: Path
    missions: tuple[MissionRef, ...]


def open_configs(paths: Iterable[Path]) -> tuple[list[MissionRef], list[Campaign]]:
    """The missions of mission files and campaign files, in their order and once, and the campaigns.

    Refuses as `campaign_of`; what cannot be read is a mission, which is refused at its turn.
    """
    missions: list[MissionRef] = []
    campaigns = []
    for path in {os.path.join(os.path.realpath(p.parent), p.name): p for p in paths}.values():
        values: dict[str, Any] = {}
        with suppress(OSError, UnicodeDecodeError, ConfigError):
            if _IS_CAMPAIGN.search(path.read_text(encoding="utf-8")):
                values, node = read_yaml(path)
        if values.keys() & {"campaign", "missions"} and "mission" not in values:
            campaigns.append(campaign_of(path, values, node))
            missions += campaigns[-1].missions
        else:
            missions.append(MissionRef(path))
    return missions, campaigns


def campaign_of(path: Path, values: dict[str, Any], node: yaml.Node) -> Campaign:
    """Check the values of a campaign file; refuses (ConfigError) every mistake with its line.

    Its defaults and the missions that stand in it are checked too; of mission files only that
    patterns match some. Opens nothing.
    """
    defaults = values.get("defaults", {})
    stated = values.get("missions", [])
    items = [*_refused(CampaignFile, values), *_refused(Mission, defaults, ("defaults",))]
    whole = dict(values)
    if isinstance(stated, list) and isinstance(defaults, dict):
        whole["missions"] = [merged(defaults, m) if isinstance(m, dict) else m for m in stated]
        output = {"path": "-"} if isinstance(values.get("campaign"), dict) else {}
        for number, mission in enumerate(whole["missions"]):
            if isinstance(mission, dict):
                complete = merged({"output": output}, mission)
                items += _refused(Mission, complete, ("missions", number), complete=True)
    if items or open_questions(values):
        raise refusal_of(items, whole, node, str(path))
    section = values["campaign"]
    if _URL.match(section["output"]):
        raise ConfigError.of("URL-INVALID/campaign", path)
    shared = merged({"output": {"path": os.path.join(section["output"], "{mission}")}}, defaults)
    refs = [
        MissionRef(file, json.dumps(_seen_from(shared, path.parent, file.parent)), own, str(path))
        for file, own in mission_files(path, stated)
    ]
    return Campaign(path, section["name"], path.parent / section["output"], tuple(refs))


def _refused(
    model: type[BaseModel], values: Any, at: Place = (), *, complete: bool = False
) -> list[Mapping[str, Any]]:
    """What a model refuses at a place; of defaults not what is missing or does not go together."""
    try:
        if isinstance(values, dict):
            model.model_validate(values)
    except ValidationError as error:
        items = error.errors(include_url=False, include_context=False)
        return [
            {**item, "loc": (*at, *item["loc"])} for item in items
            if complete or not at or (
                item["type"] != "missing"
                and not (item["type"] == "value_error" and isinstance(item["input"], dict))
            )
        ]  # fmt: skip
    return []


def mission_files(path: Path, stated: Sequence[Any]) -> Iterator[tuple[Path, str]]:
    """File of each mission of a campaign, once, and its own sections where they stand in it."""
    listed = {os.path.realpath(path.parent / entry) for entry in stated if isinstance(entry, str)}
    for entry in stated:
        if not isinstance(entry, str):
            yield path, json.dumps(entry)
        elif not glob.has_magic(entry) or (path.parent / entry).exists():
            yield path.parent / entry, ""
        else:
            names = sorted(glob.glob(entry, root_dir=path.parent, recursive=True))
            found = [path.parent / name for name in names]
            files = [file for file in found if file.is_file() and not file.samefile(path)]
            if not files:
                raise ConfigError.of("CAMPAIGN-NO-MATCH", path, pattern=entry)
            for file in files:
                real = os.path.realpath(file)
                if real not in listed:
                    listed.add(real)
                    yield file, ""


def _seen_from(values: Any, campaign: Path, mission: Path, place: Place = ()) -> Any:
    """Values of a campaign with relative paths in them as seen from the folder of a mission."""
    if isinstance(values, dict):
        return {k: _seen_from(v, campaign, mission, (*place, k)) for k, v in values.items()}
    if isinstance(values, list):
        return [_seen_from(v, campaign, mission, (*place, i)) for i, v in enumerate(values)]
    if not isinstance(values, str) or _URL.match(values) or os.path.isabs(values):
        return values
    arms = [arm for node in nodes_at(place) for arm in alternatives(node)]
    names = {arm.get("const") for arm in arms} | {n for arm in arms for n in arm.get("enum", ())}
    if campaign == mission or values in names or all(arm.get("pattern") != PATH for arm in arms):
        return values
    target, start = os.path.abspath(campaign / values), os.path.abspath(mission)
    apart = os.path.splitdrive(target)[0] != os.path.splitdrive(start)[0]
    linked = start != os.path.realpath(start)
    return target if apart or linked else os.path.relpath(target, start)


def refuse_twins(campaign: Campaign, named: Iterable[tuple[MissionRef, str, object]]) -> None:
    """Refuse (ConfigError) a campaign with two missions of one name, or one folder of results.

    ``named`` : missions with their names and folders. Folders are compared after symbolic links
    are resolved, and on Windows without case.
    """
    names: dict[str, MissionRef] = {}
    folders: dict[str, tuple[MissionRef, str]] = {}
    for ref, name, output in named:
        other = names.setdefault(os.path.normcase(name), ref)
        if other is not ref:
            raise ConfigError.of(
                "CAMPAIGN-SAME-NAME", campaign.path, name=name, first=other.path, second=ref.path
            )
        folder = os.path.normcase(os.path.realpath(str(output)))
        first, of_first = folders.setdefault(folder, (ref, name))
        if first is not ref:
            raise ConfigError.of(
                "CAMPAIGN-SAME-OUTPUT", campaign.path, first=of_first, second=name, output=output
            )
