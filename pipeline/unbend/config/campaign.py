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
    defaults : sections of the campaign, as JSON; they hold where the mission has none.
    own : sections of the mission, as JSON, if it stands in the campaign file itself.
    campaign : the campaign file; empty for a mission without one.
    """

    path: Path
    defaults: str = ""
    own: str = ""
    campaign: str = ""

    @classmethod
    def of(cls, mission: MissionRef | Path | str) -> MissionRef:
        """A reference as it is, or the reference to a mission file without a campaign."""
        if isinstance(mission, MissionRef):
            return mission
        return cls(Path(mission))

    @property
    def folder(self) -> Path:
        """The folder from which relative paths of the mission resolve."""
        return self.path.parent

    @property
    def _own_name(self) -> str:
        """The name of a mission that stands in the campaign file itself."""
        if not self.own:
            return ""
        sections = json.loads(self.own)
        return str(sections["mission"]["name"])

    @property
    def label(self) -> str:
        """What messages call the mission: its file; its name too if it stands in a campaign."""
        if not self.own:
            return str(self.path)
        return f"{self.path}: {self._own_name}"

    @property
    def words(self) -> tuple[str, ...]:
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
    """A campaign file as understood: its name, the folder of its page, and its missions."""

    path: Path
    name: str
    output: Path
    missions: tuple[MissionRef, ...]


def open_configs(paths: Iterable[Path]) -> tuple[list[MissionRef], list[Campaign]]:
    """The missions of some mission files and campaign files, and the campaigns.

    Missions stand in the order of ``paths``; a file that is named twice counts once. Refuses as
    `campaign_of`; a file that cannot be read counts as a mission file, which is refused when the
    mission's turn comes.
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
    """The campaign of a file; None for a file that holds something else, or cannot be read."""
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
    opened; a pattern that matches none is refused.
    """
    values_with_defaults = _with_defaults(values)
    # What the models refuse of the campaign's sections, of its defaults and of its missions.
    items = _refused(CampaignFile, values)
    items += _refused_defaults(values)
    items += _refused_missions(values_with_defaults)
    if items or open_questions(values):
        raise refusal_of(items, values_with_defaults, node, str(path))
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
        complete = merged(defaults, section) if isinstance(section, dict) else section
        missions.append(complete)
    return values | {"missions": missions}


def _refused(model: type[BaseModel], values: object, *, at: Place = ()) -> list[Mapping[str, Any]]:
    """What a model refuses of the values at a place of the file."""
    if not isinstance(values, dict):
        return []
    try:
        model.model_validate(values)
    except ValidationError as error:
        items = error.errors(include_url=False)
        return [{**item, "loc": (*at, *item["loc"])} for item in items]
    return []


def _refused_defaults(values: dict[str, Any]) -> Iterator[Mapping[str, Any]]:
    """What is wrong with the defaults of a campaign, whatever a mission adds to them.

    Passed over is what a mission may still set right:

    * a missing key, which the mission may state;
    * keys of a section that do not go together, of which the mission may replace one. The validator
      of a section reports them; a mistake of one key, which it may report too, it names.
    """
    for item in _refused(Mission, values.get("defaults", {}), at=("defaults",)):
        error = item.get("ctx", {}).get("error")
        names_one_key = isinstance(error, SectionError) and bool(error.key)
        is_of_section = item["type"] == "value_error" and isinstance(item["input"], dict)
        is_of_several_keys = is_of_section and not names_one_key
        if item["type"] == "missing" or is_of_several_keys:
            continue
        yield item


def _refused_missions(values: dict[str, Any]) -> Iterator[Mapping[str, Any]]:
    """What is wrong with the missions that stand in a campaign file.

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
            yield from _refused(Mission, mission_with_output, at=("missions", number))


class ListedMission(NamedTuple):
    """A mission of a campaign: its file, or the campaign file and as JSON its ``own`` sections."""

    file: Path
    own: str = ""


def missions_listed(path: Path, stated: Sequence[Any]) -> Iterator[ListedMission]:
    """The missions of a campaign; ``stated`` are the entries under ``missions``, in their order.

    * Sections are a mission that stands in the campaign file itself.
    * A path is a mission file. So is a text with ``[`` or ``*`` if a file has exactly this name.
    * Another pattern gives the files that match it, but for those that an entry names, or that an
      earlier pattern gave.
    """
    taken: set[str] = set()  # files that no pattern gives any more
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
    """The files that a pattern of a campaign matches, without the campaign file itself."""
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
    """Values of a campaign with relative paths in them as seen from the folder of a mission.

    ``place`` : where in the mission file the values stand, which shows which texts are paths.
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
    """A path that counts from the folder of a campaign, as counted from that of a mission.

    URLs and absolute paths stay. The path becomes absolute where a relative one leads astray: to
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
    """Whether a text at a place of a mission file is a path, not one of the words it takes."""
    is_path = False
    for node in nodes_at(place):
        for arm in alternatives(node):
            if value == arm.get("const") or value in arm.get("enum", ()):
                return False
            is_path = is_path or arm.get("pattern") == PATH
    return is_path


def refuse_twins(campaign: Campaign, named: Iterable[tuple[MissionRef, str, object]]) -> None:
    """Refuse (ConfigError) a campaign with two missions of one name, or one folder of results.

    ``named`` : missions with their names and folders. Folders are compared after symbolic links
    are resolved, and on Windows without case.
    """
    names: dict[str, MissionRef] = {}
    folders: dict[str, tuple[MissionRef, str]] = {}
    for ref, name, output in named:
        namesake = names.setdefault(os.path.normcase(name), ref)
        if namesake is not ref:
            raise messages.campaign_same_name(
                path=campaign.path, name=name, first=namesake.path, second=ref.path
            )
        folder = os.path.normcase(os.path.realpath(str(output)))
        first, name_of_first = folders.setdefault(folder, (ref, name))
        if first is not ref:
            raise messages.campaign_same_output(
                path=campaign.path, first=name_of_first, second=name, output=str(output)
            )
