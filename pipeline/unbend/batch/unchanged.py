"""Find missions that are unchanged since their last run, without checking their mission files.

That takes a fifth of the time of a full comparison. The manifest contains a hash of the text of the
mission file. If that hash is the same, and so are the versions, the sizes and times of the inputs,
and the results, the mission need not run.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from errno import ENOENT
from pathlib import Path
from typing import Any

import yaml

from unbend.batch.fingerprint import versions_of
from unbend.batch.input_files import (
    GDAL,
    NamedInput,
    files_of,
    is_raster,
    record_of,
    state_of,
)
from unbend.batch.remote import is_url
from unbend.batch.store import STAGING, find_damage, read_manifest
from unbend.config import Mission
from unbend.config.campaign import MissionRef
from unbend.config.campaign_defaults import merged
from unbend.tables.manifest.run import InputRecord
from unbend.tables.manifest.whole import Manifest

NOT_A_MISSION_FILE = (
    OSError,
    AttributeError,
    KeyError,
    TypeError,
    ValueError,
    yaml.YAMLError,
)
"""Errors of `text_of` and `name_and_output` with a file that is missing, or not a mission file."""


@dataclass(frozen=True)
class Unchanged:
    """A mission that would not run: its name, output folder, and the manifest in that folder."""

    name: str
    output: Path
    manifest: Manifest


@dataclass(frozen=True)
class LoadedMission:
    """A mission as understood; ``text_sha256`` is the hash of the text that it was read from.

    The hash is "" if the text changed while it was read.
    """

    mission: Mission
    text_sha256: str


def load(ref: MissionRef) -> LoadedMission:
    """Read and check a mission file."""
    hash_before = text_hash(ref)
    mission = ref.load()
    is_same_text = text_hash(ref) == hash_before
    return LoadedMission(mission, hash_before if is_same_text else "")


def text_hash(ref: MissionRef) -> str:
    """SHA-256 of the text of a mission with its defaults; "" if its file cannot be read."""
    try:
        return hash_of_text(ref, text_of(ref))
    except OSError:
        return ""


def text_of(ref: MissionRef) -> bytes:
    """The text of a mission: of its file, or its sections in a campaign file.

    OSError if the file cannot be read.
    """
    if ref.own:
        return ref.own.encode()
    if not ref.path.is_file():  # reading a pipe might never end
        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(ref.path))
    return ref.path.read_bytes()


def hash_of_text(ref: MissionRef, text: bytes) -> str:
    """SHA-256 of the text of a mission with the defaults of its campaign."""
    return hashlib.sha256(ref.defaults.encode() + b"\0" + text).hexdigest()


def find_unchanged(ref: MissionRef) -> Unchanged | None:
    """The mission, if it is certainly unchanged since its last run; otherwise None.

    None may also mean that only a full comparison can show that it is unchanged.
    """
    try:
        text = text_of(ref)
        name, output_path = name_and_output(ref, text)
    except NOT_A_MISSION_FILE:  # `load` refuses such a file later
        return None
    if is_url(output_path):
        return None
    output = Path(os.path.normpath(ref.folder / output_path))
    # A run that has not ended, or was interrupted, has a staging folder.
    if os.path.lexists(output / STAGING):
        return None
    manifest = read_manifest(output, ignore_damaged=True)
    if manifest is None or manifest.run.mission != name:
        return None
    run = manifest.run
    if run.mission_file_sha256 != hash_of_text(ref, text):
        return None
    roles = [record.role for record in run.inputs]
    standard = run.config["atmosphere"]["standard"]
    if versions_of(roles, standard) != run.versions:
        return None
    if not all(is_as_recorded(record, ref.folder) for record in run.inputs):
        return None
    if find_damage(output, manifest, hash_all=False):
        return None
    return Unchanged(name, output, manifest)


def name_and_output(ref: MissionRef, text: bytes) -> tuple[str, str]:
    """Name and output path of a mission, from its text alone; KeyError if one is missing.

    All values of the text are read as words, which is fast. Name and path are words in each mission
    file that has run.
    """
    sections = yaml.load(text, yaml.CBaseLoader)
    defaults = json.loads(ref.defaults) if ref.defaults else {}
    values = merged(_naming_sections(defaults), _naming_sections(sections))
    return str(values["mission"]["name"]), str(values["output"]["path"])


def _naming_sections(sections: Mapping[str, Any]) -> dict[str, Any]:
    """The two sections that contain the name of a mission and the path of its results."""
    return {name: sections[name] for name in ("mission", "output") if name in sections}


def is_as_recorded(record: InputRecord, folder: Path) -> bool:
    """Whether an input has the size and time of its record in a manifest.

    ``folder`` is that of the mission file. False for inputs in object storage, blocks and folders
    of images, which take the full comparison: only the readers of their formats know their files.
    """
    read_by_gdal = is_raster(record.role)
    has_several_files = bool(record.version)  # an input of one file has no version
    if is_url(record.name) or (has_several_files and not read_by_gdal):
        return False
    program = GDAL if read_by_gdal else None
    named = NamedInput(record.role, key="", name=record.name, program=program)
    path = folder / record.name
    if not path.is_file():
        return False
    files = files_of(path, program)
    now = record_of(named, files, tuple(state_of(file) for file in files))
    return now.is_unchanged_since(record)
