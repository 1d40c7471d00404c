"""What a result depends on: inputs, mission file, code, libraries; and how a mission ended."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any, cast

from unbend.batch import file_hashes
from unbend.batch.executors import Outcome
from unbend.batch.file_hashes import GDAL, Input, files_of, remembered_hash
from unbend.batch.keys import TABLES, keys_of, libraries
from unbend.batch.object_store import Place, copy_of, fetched, is_url, version_of
from unbend.batch.store import would_replace
from unbend.caches import user_cache
from unbend.config import Mission
from unbend.errors import ConfigError, InputError, UnbendError
from unbend.tables.imports.blocks import BLOCKS

MANIFEST_VERSION = 1
INPUTS: dict[str, str] = TABLES["inputs"]
_EXIF_BYTES = 1 << 18


@dataclass(frozen=True)
class Plan:
    """A mission with its inputs hashed; ``camera_names`` by what a block calls its cameras."""

    mission: Mission
    inputs: tuple[Input, ...]
    output: Path | Place
    camera_names: Mapping[str, str] = field(default_factory=dict)

    @property
    def keys(self) -> dict[str, str]:
        """The key of each stage, as in the manifest."""
        config = self.mission.model_dump(mode="json")
        return keys_of(config, {item.role: item.sha256 for item in self.inputs})

    @property
    def libraries(self) -> dict[str, dict[str, str | None]]:
        return libraries([item.role for item in self.inputs], self.mission.atmosphere.standard)

    @property
    def fingerprint(self) -> str:
        """SHA-256 over the keys of all stages."""
        return hashlib.sha256(json.dumps(self.keys, sort_keys=True).encode()).hexdigest()

    @property
    def folder(self) -> Path:
        """The folder its results are made in: the output, or one in the user's cache."""
        if isinstance(self.output, Path):
            return self.output
        key = hashlib.sha256(str(self.output).encode()).hexdigest()[:32]
        return Path(user_cache()) / "results" / key / "run"

    @property
    def decoded_log(self) -> str:
        """What its log is kept under once it is decoded: its key, and its path, which it names."""
        words = f"{self.keys['ingest']} {self.input('log').path}"
        return f"log-{hashlib.sha256(words.encode()).hexdigest()}"

    def input(self, role: str) -> Input:
        """The input of a role: log, observations, events, orientation, or ``sounding 1``."""
        return next(item for item in self.inputs if item.role == role)


def outcome_of(plan: Plan, manifest: dict[str, Any], *, repeated: bool) -> Outcome:
    return Outcome(
        plan.mission.mission.name, plan.output, manifest, int(manifest["exit_code"]), repeated
    )


def located(name: str, folder: Path = Path()) -> Path | Place:
    """Where a path of a mission file leads: from its folder, or a URL to object storage."""
    return Place.of(name) if is_url(name) else folder / name


def input_paths(mission: Mission, folder: Path) -> dict[str, tuple[str, Path | Place]]:
    """role -> (name in the mission file, path) of the files a mission reads."""
    rasters = mission.ground.model.paths if mission.ground.model is not None else ()
    several = {
        "elevation model": {f"elevation model {i}": path for i, path in enumerate(rasters, 1)},
        "camera": {f"camera {name}": c.file for name, c in mission.cameras.items() if c.file},
        "events of": {f"events of {c}": of.path for c, of in mission.position_events.items()},
        "sounding": {sounding_role(i): s.path for i, s in enumerate(mission.atmosphere.soundings)},
    }
    named: dict[str, str] = {}
    for role, key in INPUTS.items():
        path = reduce(lambda of, name: getattr(of, name, None), key.split("."), cast(Any, mission))
        if role in several:
            named |= several[role]
        elif isinstance(path, str) and (key, path) != ("mission.geoid", "egm96"):
            named[role] = path
    return {role: (name, located(name, folder)) for role, name in named.items()}


def sounding_role(number: int) -> str:
    """The role of a sounding among the inputs, counted from 0."""
    return f"sounding {number + 1}"


def is_raster(role: str) -> bool:
    return role == "geoid" or role.startswith("elevation model")


def make_plan(mission: Mission, folder: Path, *, verify: bool = False) -> Plan:
    """Hash the inputs of a mission; relative paths resolve from the mission file's folder.

    Unchanged files are read only to ``verify``. Refuses results that would go over an input.
    """
    output = located(mission.output.path, folder)
    output = output if isinstance(output, Place) else Path(os.path.normpath(output))
    _refuse_among_results("mission", folder, output)
    inputs = []
    orientation = mission.stations.orientation
    of_images = orientation is not None and orientation.format == "dji"
    of_folders = ("images", "orientation") if of_images else ("images",)
    programs = {f"camera {name}": camera.format for name, camera in mission.cameras.items()}
    programs |= {"observations": mission.observations.format,
                 "orientation": None if orientation is None else orientation.format}  # fmt: skip
    for role, (name, path) in input_paths(mission, folder).items():
        program = programs.get(role) if programs.get(role) in BLOCKS else None
        may_be_folder, version = role in of_folders or program is not None, ""
        program = GDAL if is_raster(role) else program
        try:
            if isinstance(path, Place):
                with suppress(FileNotFoundError):
                    version = version_of(path) if may_be_folder or not path.is_folder else ""
                is_there = bool(version)
            else:
                is_there = path.is_file() or (path.is_dir() and may_be_folder)
            if not is_there:
                key = INPUTS[max((r for r in INPUTS if role.startswith(r)), key=len)]
                raise InputError.of("INPUT-MISSING/role", path, role=role, named=key)
            _refuse_among_results(role, path, output)
            if isinstance(path, Place):
                key, copy = f"{path} {program}", copy_of(path, version)
                known = None if verify else file_hashes.recalled(key, version)
                if known is None or role.startswith("camera "):  # that is read with the file
                    copy = fetched(path, version, anew=verify)
                sha256 = known or _hash_input(copy, program, verify=verify)
                file_hashes.remember({key: (version, sha256)})
                inputs.append(Input(role, name, copy, sha256, version, program, path))
            else:
                before = tuple(map(file_hashes.stamp, files_of(path, program)))
                sha256 = _hash_input(path, program, verify=verify)
                inputs.append(Input(role, name, path, sha256, before, program))
        except OSError as error:
            raise InputError(
                "INPUT-UNREADABLE", str(error.strerror), where=str(path), remedy="mend permissions"
            ) from None
    files = {item.role: item.path for item in inputs if item.role.startswith("camera ")}
    cameras = {
        name: camera.with_file(files[f"camera {name}"]) if camera.file is not None else camera
        for name, camera in mission.cameras.items()
    }
    names = {str(c.camera or name): name for name, c in mission.cameras.items()}
    only = next(iter(mission.cameras.values()))
    names |= {"": next(iter(names.values()))} if len(names) == 1 and only.camera is None else {}
    return Plan(mission.model_copy(update={"cameras": cameras}), tuple(inputs), output, names)


def refuse_other_mission(plan: Plan, manifest: dict[str, Any] | None) -> None:
    """Refuse (OUTPUT-OTHER) a folder whose manifest is that of a mission of another name."""
    name = plan.mission.mission.name
    if manifest is not None and manifest["mission"] != name:
        raise ConfigError.of(
            "OUTPUT-OTHER", str(plan.output), manifest=manifest["mission"], name=name
        )


def _refuse_among_results(role: str, path: Path | Place, output: Path | Place) -> None:
    if would_replace(output, path):
        raise ConfigError.of("OUTPUT-OVER-INPUT", path, role=role, output=output)


def fetch_inputs(plan: Plan) -> None:
    """Copy inputs in object storage that have no whole copy here; refuses INPUT-CHANGED."""
    for item in plan.inputs:
        if item.place is None:
            continue
        for anew in (False, True):
            copy = fetched(item.place, str(item.stamp), anew=anew)
            if _hash_input(copy, item.program, verify=anew) == item.sha256:
                break
        else:
            raise InputError.of("INPUT-CHANGED", item.place, role=item.role)


@contextmanager
def places_named(plan: Plan) -> Iterator[None]:
    """Let a refusal name the URLs of the mission file, in the place of copies and folders here."""
    try:
        yield
    except UnbendError as error:
        for item in plan.inputs:
            error.where = error.where.replace(str(item.path), str(item.place or item.path))
        error.where = error.where.replace(str(plan.folder), str(plan.output))
        raise


def _hash_input(path: Path, program: str | None, *, verify: bool) -> str:
    """SHA-256 of a file, or of names and hashes of a block's, a raster's or a folder's files."""
    files = files_of(path, program)
    if files == (path,):
        return remembered_hash(path, verify=verify)
    digest = hashlib.sha256()
    for file in files:
        if program is not None:
            digest.update(f"{file.name}\0{remembered_hash(file, verify=verify)}\0".encode())
            continue
        start = remembered_hash(file, verify=verify, of_jpeg=_EXIF_BYTES)
        digest.update(f"{file.relative_to(path)}\0{file.stat().st_size}\0{start}\0".encode())
    return digest.hexdigest()
