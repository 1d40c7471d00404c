"""A mission before it is run: its inputs hashed, and the folder or place of its results."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from unbend.batch import messages, remote
from unbend.batch.fingerprint import fingerprint_of, versions_of
from unbend.batch.folders_as_files import folder_refusal
from unbend.batch.input_files import (
    Input,
    NamedInput,
    check_unchanged,
    files_of,
    hash_input,
    named_inputs,
    record_of,
    state_of,
)
from unbend.batch.remote import Place, RemoteInput, is_url
from unbend.batch.results import read_manifest
from unbend.batch.store import would_replace
from unbend.caches import user_cache_folder
from unbend.config import Mission
from unbend.config.stated_nulls import stated_nulls
from unbend.errors import UnbendError
from unbend.tables.manifest.run import MANIFEST_VERSION, Identity, InputRecord
from unbend.tables.manifest.whole import Manifest


@dataclass(frozen=True)
class Plan:
    """A mission with its inputs hashed.

    output : the folder of the results, or a place in object storage.
    camera_names : the mission's name of each camera, by the camera's name in a block.
    text_sha256 : hash of the mission file that the mission was read from; "" if unknown.
    file : the mission file, or the campaign file that names the mission; None if unknown.
    remotes : the inputs in object storage, by their roles.
    """

    mission: Mission
    inputs: tuple[Input, ...]
    output: Path | Place
    camera_names: Mapping[str, str] = field(default_factory=dict)
    text_sha256: str = ""
    file: Path | None = None
    remotes: Mapping[str, RemoteInput] = field(default_factory=dict)

    @cached_property
    def config(self) -> dict[str, Any]:
        """The mission as understood, for the manifest."""
        return self.mission.model_dump(mode="json")

    @cached_property
    def versions(self) -> dict[str, str]:
        """Versions of all software and data that the numbers of the results depend on."""
        roles = [item.role for item in self.inputs]
        return versions_of(roles, self.mission.atmosphere.standard)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 over all that the results depend on."""
        hashes = {item.role: item.sha256 for item in self.inputs}
        return fingerprint_of(self.config, self.versions, hashes, stated_nulls(self.mission))

    @property
    def folder(self) -> Path:
        """The folder that a run writes to: the output, or for a URL one in the user's cache."""
        if isinstance(self.output, Path):
            return self.output
        url = str(self.output)
        key = hashlib.sha256(url.encode()).hexdigest()[:32]
        return Path(user_cache_folder()) / "results" / key / "run"

    @property
    def file_from_output(self) -> str:
        """The path of `file` from the folder of the results; "" if it is unknown.

        It is "" too for results at a URL, for an absolute ``output.path``, and if the file is on
        another drive of Windows.
        """
        output = self.mission.output.path
        if self.file is None or is_url(output) or Path(output).is_absolute():
            return ""
        try:
            return Path(os.path.relpath(self.file, str(self.output))).as_posix()
        except ValueError:  # another drive
            return ""

    def input(self, role: str) -> Input:
        """The input of a role, as `named_inputs` names it: ``log``, ``sounding 1``, ..."""
        return next(item for item in self.inputs if item.role == role)

    def identity(self) -> Identity:
        """The part of the manifest that identifies the run: mission, inputs and versions."""
        return Identity(
            manifest_version=MANIFEST_VERSION,
            mission=self.mission.mission.name,
            mission_file=self.file_from_output,
            fingerprint=self.fingerprint,
            mission_file_sha256=self.text_sha256,
            config=self.config,
            inputs=[item.record for item in self.inputs],
            versions=self.versions,
        )

    def check_unchanged(self, *, folders: bool = True) -> None:
        """Refuse (INPUT-CHANGED) inputs that were written to, or replaced, since they were hashed.

        ``folders`` also checks folders of images and inputs in object storage, which may take long.
        """
        check_unchanged(self.inputs, folders=folders)
        if folders:
            for role, item in self.remotes.items():
                remote.refuse_changed(item, role=role)


def located(name: str, folder: Path = Path()) -> Path | Place:
    """The path from a folder to ``name``, or the place in object storage if ``name`` is a URL."""
    if is_url(name):
        return Place.of(name)
    return folder / name


def output_of(mission: Mission, folder: Path) -> Path | Place:
    """The folder or place of a mission's results; ``folder`` is that of the mission file."""
    output = located(mission.output.path, folder)
    if isinstance(output, Place):
        return output
    return Path(os.path.normpath(output))


def make_plan(
    mission: Mission,
    folder: Path,
    *,
    verify: bool = False,
    text_sha256: str = "",
    file: Path | None = None,
) -> Plan:
    """Hash the inputs of a mission; relative paths resolve from ``folder``, the mission file's.

    An input that has the size and the time of its record in the manifest of an earlier run is not
    read, and keeps the hash of that record; with ``verify`` each input is read. ``text_sha256`` is
    the hash of the mission file, "" if unknown, and ``file`` that file, or its campaign file.
    Refuses inputs that are missing or cannot be read, and results that would replace an input.
    """
    output = output_of(mission, folder)
    refuse_among_results("mission", folder, output)
    earlier = read_manifest(output, ignore_damaged=True)
    earlier_records: dict[str, InputRecord] = {}  # by role
    if earlier is not None and not verify:
        earlier_records = {record.role: record for record in earlier.run.inputs}
    inputs = []
    remotes = {}
    for named in named_inputs(mission):
        place = located(named.name, folder)
        earlier_record = earlier_records.get(named.role)
        with refuse_unreadable(named, place):
            if isinstance(place, Place):
                in_storage = look_up_input(named, place)
                remotes[named.role] = in_storage
                refuse_among_results(named.role, place, output)
                inputs.append(remote_input(named, in_storage, earlier_record, verify=verify))
            else:
                refuse_missing(named, place)
                refuse_among_results(named.role, place, output)
                inputs.append(local_input(named, place, earlier_record, verify=verify))
    return Plan(
        mission=with_camera_files(mission, {item.role: item.path for item in inputs}),
        inputs=tuple(inputs),
        output=output,
        camera_names=camera_names_by_block(mission),
        text_sha256=text_sha256,
        file=file,
        remotes=remotes,
    )


@contextmanager
def refuse_unreadable(named: NamedInput, place: Path | Place) -> Iterator[None]:
    """Context that turns an OSError about an input into a refusal (InputError)."""
    try:
        yield
    except FileNotFoundError:
        raise messages.input_missing(role=named.role, path=str(place), key=named.key) from None
    except OSError as error:
        raise messages.input_unreadable(path=str(place), error=str(error.strerror)) from None


def refuse_missing(named: NamedInput, path: Path) -> None:
    """Refuse a missing input (INPUT-MISSING), or a folder in place of a file (INPUT-FOLDER)."""
    if path.is_file() or (path.is_dir() and named.may_be_folder):
        return
    if path.is_dir():
        raise folder_refusal(named, path)
    raise messages.input_missing(role=named.role, path=str(path), key=named.key)


def local_input(
    named: NamedInput, path: Path, earlier_record: InputRecord | None, *, verify: bool
) -> Input:
    """An input on a disk with its hash.

    ``earlier_record`` is its record in an earlier run, None without one: an input of the same size
    and time is not read. Otherwise, with ``verify``, each file is read even if another mission of
    this process has hashed it.
    """
    files = files_of(path, named.program)
    states = tuple(state_of(file) for file in files)
    record = record_of(named, files, states)
    if earlier_record is not None and record.is_unchanged_since(earlier_record):
        record = earlier_record
    else:
        states_of_known_hashes = () if verify else states
        sha256 = hash_input(path, named.program, files, states_of_known_hashes)
        record = record.with_hash(sha256)
    return Input(record, path, states, named.program)


def look_up_input(named: NamedInput, place: Place) -> RemoteInput:
    """The present version of an input in object storage.

    Raises FileNotFoundError if there is none. Refuses (INPUT-FOLDER) a folder in the place of a
    file.
    """
    if place.is_folder and not named.may_be_folder:
        raise messages.folder_as_input(role=named.role, path=str(place), key=named.key)
    return remote.look_up(place)


def remote_input(
    named: NamedInput,
    in_storage: RemoteInput,
    earlier_record: InputRecord | None,
    *,
    verify: bool,
) -> Input:
    """An input in object storage with its hash.

    ``earlier_record`` is its record in an earlier run, None without one: an input of the same
    version keeps the hash of the record. Any other input is copied to this machine and read, and
    the file of a camera always, because it completes the mission. ``verify`` makes a new copy even
    if there is one.
    """
    record = InputRecord(
        role=named.role,
        name=named.name,
        sha256="",
        bytes=in_storage.size_bytes,
        mtime_ns=in_storage.mtime_ns,
        version=in_storage.version,
    )
    is_of_camera = named.role.startswith("camera ")
    if (
        earlier_record is not None
        and record.is_unchanged_since(earlier_record)
        and not is_of_camera
    ):
        record = earlier_record
    else:
        copy = remote.fetch(in_storage, anew=verify)
        files = files_of(copy, named.program)
        sha256 = hash_input(copy, named.program, files)
        record = record.with_hash(sha256)
    return Input(record, in_storage.copy, program=named.program, url=str(in_storage.place))


def with_camera_files(mission: Mission, paths: Mapping[str, Path]) -> Mission:
    """The mission with its cameras completed by their files; ``paths`` are those of all inputs."""
    cameras = {}
    for name, camera in mission.cameras.items():
        path = paths.get(f"camera {name}")
        cameras[name] = camera if path is None else camera.with_file(path)
    return mission.model_copy(update={"cameras": cameras})


def camera_names_by_block(mission: Mission) -> dict[str, str]:
    """The mission's name of each camera, by the camera's name in a block.

    The only camera of a mission also has the key "", which fits any name in a block.
    """
    names = {}
    for name, camera in mission.cameras.items():
        names[str(camera.camera or name)] = name
    if len(mission.cameras) == 1:
        (only,) = mission.cameras.values()
        if only.camera is None:  # the mission file does not state the name in the block
            names[""] = next(iter(names.values()))
    return names


def refuse_other_mission(plan: Plan, manifest: Manifest | None) -> None:
    """Refuse (OUTPUT-OTHER) an output with the manifest of a mission of another name."""
    name = plan.mission.mission.name
    if manifest is not None and manifest.run.mission != name:
        raise messages.output_of_other_mission(
            path=str(plan.output), other=manifest.run.mission, name=name
        )


def refuse_among_results(role: str, path: Path | Place, output: Path | Place) -> None:
    """Refuse (OUTPUT-OVER-INPUT) an input that a run would remove or replace.

    ``path`` is that of the input. A folder on a disk and a place in object storage are never in
    each other.
    """
    if isinstance(output, Place) and isinstance(path, Place):
        replaced = remote.would_replace(output, path)
    elif isinstance(output, Path) and isinstance(path, Path):
        replaced = would_replace(output, path)
    else:
        replaced = False
    if replaced:
        raise messages.output_over_input(role=role, path=str(path), output=str(output))


def fetch_inputs(plan: Plan) -> None:
    """Copy the inputs in object storage to this machine, unless there are complete copies.

    Refuses (INPUT-CHANGED) an input if also a new copy has another hash than the plan.
    """
    for role, in_storage in plan.remotes.items():
        item = plan.input(role)
        copy = remote.fetch(in_storage)
        if has_planned_hash(item, copy):
            continue
        new_copy = remote.fetch(in_storage, anew=True)  # the one before may be damaged
        if not has_planned_hash(item, new_copy):
            raise messages.input_changed(role=role, path=item.url)


def has_planned_hash(item: Input, copy: Path) -> bool:
    """Whether the copy of an input has the hash that the plan states."""
    files = files_of(copy, item.program)
    return hash_input(copy, item.program, files) == item.sha256


@contextmanager
def urls_in_refusals(plan: Plan) -> Iterator[None]:
    """Context that replaces paths in the user's cache by their URLs in the text of a refusal.

    They are the copies of inputs, and the folder of the results, of a plan with object storage.
    """
    try:
        yield
    except UnbendError as error:
        for item in plan.inputs:
            if item.url:
                error.where = error.where.replace(str(item.path), item.url)
        error.where = error.where.replace(str(plan.folder), str(plan.output))
        raise
