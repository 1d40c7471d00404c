"""The missions of a command: files, and campaign files with what their missions share."""

from __future__ import annotations

import glob
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from pydantic import BaseModel, ValidationError

from unbend.config import messages
from unbend.config.campaign_defaults import merged
from unbend.config.campaign_file import CampaignFile
from unbend.config.mission_file import Mission
from unbend.config.reading import mission_of, refusal_of
from unbend.config.schema import PATH, alternatives, nodes_at
from unbend.config.section import SectionError
from unbend.config.yaml_text import Place, open_questions, read_yaml
from unbend.errors import ConfigError

_IS_CAMPAIGN = re.compile(r"""^["']?(campaign|missions)["']?\s*:|^\s*\{""", re.MULTILINE)
_URL = re.compile("[A-Za-z][A-Za-z0-9+.-]+:/")  # as `is_url` of the packages above has it


@dataclass(frozen=True)
class MissionRef:
    """A mission to run, small and of plain values: it can be sent to another process or machine.

    path : the mission file, or the campaign file in which the mission stands.
    defaults : sections of the campaign, as JSON, for keys that the mission does not state.
    own : sections of the mission, as JSON, if it stands in the campaign file itself.
    campaign : the campaign file; empty for a mission without one.
    """

    path: Path
    defaults: str = ""
    own: str = ""
    campaign: str = ""

    @classmethod
    def of(cls, mission: MissionRef | Path | str) -> MissionRef:
        """A reference as it is; for a path, the reference to this mission file."""
        if isinstance(mission, MissionRef):
            return mission
        return cls(Path(mission))

    @property
    def folder(self) -> Path:
        """The folder from which relative paths of the mission resolve."""
        return self.path.parent

    @property
    def _own_name(self) -> str:
        """The name of a mission that stands in the campaign file itself; else empty."""
        if not self.own:
            return ""
        sections = json.loads(self.own)
        return str(sections["mission"]["name"])

    @property
    def label(self) -> str:
        """How messages name the mission: its file, and its name if it is in a campaign file."""
        if not self.own:
            return str(self.path)
        return f"{self.path}: {self._own_name}"

    @property
    def run_arguments(self) -> tuple[str, ...]:
        """The arguments of `unbend run` that run this mission alone; the last names the mission."""
        name = self._own_name or str(self.path)
        if not self.campaign:
            return (name,)
        return (self.campaign, "--mission", name)

    def load(self) -> Mission:
        """Read and check the mission; refuses as `load_mission`."""
        defaults = json.loads(self.defaults) if self.defaults else None
        if self.own:
            sections = json.loads(self.own)
            return mission_of(sections, None, self.label, defaults)
        values, node = read_yaml(self.path)
        return mission_of(values, node, str(self.path), defaults)


@dataclass(frozen=True)
class Campaign:
    """A campaign file that was read and checked."""

    path: Path
    name: str
    output: Path  # folder of its page and table
    missions: tuple[MissionRef, ...]


def open_configs(paths: Iterable[Path]) -> tuple[list[MissionRef], list[Campaign]]:
    """The missions of some mission files and campaign files, and the campaigns among these.

    Missions are in the order of ``paths``; a file that is named twice counts once. Refuses as
    `campaign_of`. A file that cannot be read counts as a mission file: it is refused when the
    mission is loaded.
    """
    missions: list[MissionRef] = []
    campaigns: list[Campaign] = []
    path_of_file = {}
    for path in paths:
        # A link to a file is a file of its own: relative paths count from the folder of the link.
        path_of_file[os.path.join(os.path.realpath(path.parent), path.name)] = path
    for path in path_of_file.values():
        campaign = _campaign_at(path)
        if campaign is None:
            missions.append(MissionRef(path))
        else:
            campaigns.append(campaign)
            missions += campaign.missions
    return missions, campaigns


def _campaign_at(path: Path) -> Campaign | None:
    """The campaign of a file; None for any other file, and for one that cannot be read."""
    if not path.is_file():  # a pipe might never end; `read_yaml` says what is wrong
        return None
    try:
        # Most files are those of missions: this search spares reading their YAML twice.
        if not _IS_CAMPAIGN.search(path.read_text(encoding="utf-8")):
            return None
        values, node = read_yaml(path)
    except (OSError, UnicodeDecodeError, ConfigError):
        return None
    is_mission = "mission" in values
    has_key_of_campaign = not values.keys().isdisjoint({"campaign", "missions"})
    if is_mission or not has_key_of_campaign:
        return None
    return campaign_of(path, values, node)


def campaign_of(path: Path, values: dict[str, Any], node: yaml.Node) -> Campaign:
    """Check the values of a campaign file; refuses (ConfigError) every mistake with its line.

    The defaults and the missions that stand in the file are checked too. Mission files are not
    opened; a pattern without a matching file is refused. ``node`` has the lines of ``values``.
    """
    values_with_defaults = _with_defaults(values)
    errors = _errors_of(CampaignFile, values)
    errors += _errors_of_defaults(values)
    errors += _errors_of_missions(values_with_defaults)
    if errors or open_questions(values):
        raise refusal_of(errors, values_with_defaults, node, str(path))
    section = values["campaign"]
    output = section["output"]
    if _URL.match(output):
        raise messages.campaign_output_is_url(path=path)
    output_of_missions = {"output": {"path": os.path.join(output, "{mission}")}}
    defaults = merged(output_of_missions, values.get("defaults", {}))
    missions = []
    for mission in missions_listed(path, values["missions"]):
        # Relative paths of the defaults count from the campaign's folder, a mission's from its own.
        defaults_there = _seen_from(defaults, path.parent, mission.file.parent)
        missions.append(
            MissionRef(
                path=mission.file,
                defaults=json.dumps(defaults_there),
                own=mission.own,
                campaign=str(path),
            )
        )
    return Campaign(path, section["name"], path.parent / output, tuple(missions))


def _with_defaults(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a campaign file, with its defaults in the missions that stand in it."""
    defaults = values.get("defaults", {})
    stated_missions = values.get("missions", [])
    if not isinstance(stated_missions, list) or not isinstance(defaults, dict):
        return values
    missions = []
    for section in stated_missions:
        is_mission = isinstance(section, dict)  # and not a path
        missions.append(merged(defaults, section) if is_mission else section)
    return values | {"missions": missions}


def _errors_of(
    model: type[BaseModel], values: object, *, place: Place = ()
) -> list[Mapping[str, Any]]:
    """Errors of pydantic when a model checks the values at a place of the file.

    The place is put before their own places (``loc``). Empty for values that are not a mapping.
    """
    if not isinstance(values, dict):
        return []
    try:
        model.model_validate(values)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        return [{**item, "loc": (*place, *item["loc"])} for item in errors]
    return []


def _errors_of_defaults(values: dict[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Errors in the defaults of a campaign that no mission can correct.

    Left out are errors that a mission may still correct:

    * a missing key, which the mission may state;
    * keys of a section that do not go together: the mission may replace one. The validator of the
      section reports these, without naming a key; a mistake of one key has the name of the key.
    """
    for item in _errors_of(Mission, values.get("defaults", {}), place=("defaults",)):
        error = item.get("ctx", {}).get("error")
        names_one_key = isinstance(error, SectionError) and bool(error.key)
        is_of_section = item["type"] == "value_error" and isinstance(item["input"], dict)
        is_of_several_keys = is_of_section and not names_one_key
        if item["type"] == "missing" or is_of_several_keys:
            continue
        yield item


def _errors_of_missions(values: dict[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Errors in the missions that stand in a campaign file.

    ``values`` are those of the file, with its defaults in its missions.
    """
    missions = values.get("missions", [])
    if not isinstance(missions, list) or not isinstance(values.get("defaults", {}), dict):
        return  # the model of the campaign itself reports that
    # A mission without output.path gets a folder below that of the campaign; for the check any path
    # will do. Without a campaign section there is no such folder: output.path is then missing.
    has_campaign = isinstance(values.get("campaign"), dict)
    default_output = {"path": "-"} if has_campaign else {}
    for number, mission in enumerate(missions):
        if isinstance(mission, dict):
            mission_with_output = merged({"output": default_output}, mission)
            yield from _errors_of(Mission, mission_with_output, place=("missions", number))


class ListedMission(NamedTuple):
    """A mission of a campaign."""

    file: Path  # the mission file, or the campaign file if the mission stands there
    own: str = ""  # sections of the mission as JSON, if it stands in the campaign file


def missions_listed(path: Path, stated: Sequence[Any]) -> Iterator[ListedMission]:
    """The missions of a campaign; ``stated`` are the entries under ``missions``, in their order.

    * Sections are a mission that stands in the campaign file itself.
    * A path is a mission file. So is a text with ``[`` or ``*`` if a file has exactly this name.
    * Another pattern gives the files that match it, except those that an entry names and those of
      an earlier pattern.
    """
    taken: set[str] = set()  # files that patterns leave out
    for entry in stated:
        if isinstance(entry, str):
            taken.add(os.path.realpath(path.parent / entry))
    for entry in stated:
        if not isinstance(entry, str):
            yield ListedMission(path, own=json.dumps(entry))
            continue
        file = path.parent / entry
        if file.exists() or not glob.has_magic(entry):
            yield ListedMission(file)
            continue
        for matching in _matching_files(path, entry):
            real = os.path.realpath(matching)
            if real not in taken:
                taken.add(real)
                yield ListedMission(matching)


def _matching_files(path: Path, pattern: str) -> list[Path]:
    """The files that match a pattern, without the campaign file ``path``; refuses if none does."""
    files = []
    for name in sorted(glob.glob(pattern, root_dir=path.parent, recursive=True)):
        file = path.parent / name
        if file.is_file() and not file.samefile(path):
            files.append(file)
    if not files:
        raise messages.campaign_no_match(path=path, pattern=pattern)
    return files


def _seen_from(
    values: object, campaign_folder: Path, mission_folder: Path, place: Place = ()
) -> object:
    """A copy of a campaign's values, with relative paths made relative to a mission's folder.

    ``place`` is where the values are in the mission file: it decides which texts are paths.
    """
    if isinstance(values, dict):
        items: dict[str, object] = {}
        for key, value in values.items():
            items[key] = _seen_from(value, campaign_folder, mission_folder, (*place, key))
        return items
    if isinstance(values, list):
        entries: list[object] = []
        for number, value in enumerate(values):
            entries.append(_seen_from(value, campaign_folder, mission_folder, (*place, number)))
        return entries
    is_elsewhere = campaign_folder != mission_folder
    if isinstance(values, str) and is_elsewhere and _is_path_at(place, values):
        return _path_seen_from(values, campaign_folder, mission_folder)
    return values


def _path_seen_from(path: str, campaign_folder: Path, mission_folder: Path) -> str:
    """A path relative to the folder of a campaign, made relative to the folder of a mission.

    URLs and absolute paths stay. The path becomes absolute if a relative one would be wrong: to
    another drive of Windows, or from a folder that is reached by a symbolic link.
    """
    if _URL.match(path) or os.path.isabs(path):
        return path
    target = os.path.abspath(campaign_folder / path)
    start = os.path.abspath(mission_folder)
    drive_of_target, _ = os.path.splitdrive(target)
    drive_of_start, _ = os.path.splitdrive(start)
    is_linked = start != os.path.realpath(start)
    if drive_of_target != drive_of_start or is_linked:
        return target
    return os.path.relpath(target, start)


def _is_path_at(place: Place, value: str) -> bool:
    """Whether a text at a place of a mission file is a path, not a word that is allowed there."""
    is_path = False
    for node in nodes_at(place):
        for arm in alternatives(node):
            if value == arm.get("const") or value in arm.get("enum", ()):
                return False
            is_path = is_path or arm.get("pattern") == PATH
    return is_path


def refuse_duplicates(
    campaign: Campaign, missions: Iterable[tuple[MissionRef, str, object]]
) -> None:
    """Refuse (ConfigError) a campaign with two missions of one name, or one folder of results.

    ``missions`` are references with names and folders of results. Symbolic links are resolved; on
    Windows case does not count.
    """
    ref_of_name: dict[str, MissionRef] = {}
    first_of_folder: dict[str, tuple[MissionRef, str]] = {}
    for ref, name, output in missions:
        with_same_name = ref_of_name.setdefault(os.path.normcase(name), ref)
        if with_same_name is not ref:
            raise messages.campaign_same_name(
                path=campaign.path, name=name, first=with_same_name.path, second=ref.path
            )
        folder = os.path.normcase(os.path.realpath(str(output)))
        first, name_of_first = first_of_folder.setdefault(folder, (ref, name))
        if first is not ref:
            raise messages.campaign_same_output(
                path=campaign.path, first=name_of_first, second=name, output=str(output)
            )
