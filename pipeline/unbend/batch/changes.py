"""Why a mission would run: what differs from the run whose results are there.

An entry of the index repeats what `run` found when it read everything, as long as inode, size and
times of its files stay, and the program and libraries do: missions are known without being read.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import unbend
from unbend.batch.file_hashes import is_settled, stamp
from unbend.batch.keys import (
    GRIDS,
    NOT_IN_KEY,
    STAGES,
    code_hash,
    code_of_stages,
    grids_of_proj,
    key_of_drawn,
    stage_of_key,
    stage_of_role,
)
from unbend.batch.object_store import Place
from unbend.batch.plan import Plan, input_paths, is_raster, located, make_plan
from unbend.batch.store import MANIFEST, STAGING, find_damage, read_manifest
from unbend.batch.value_cache import is_kept
from unbend.caches import read_entry, write_entries
from unbend.config.campaign import MissionRef
from unbend.errors import UnbendError
from unbend.tables.geodata.gdal import raster_files
from unbend.tables.imports.blocks import BLOCKS


def reasons_to_run(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """Why a manifest's results are not a plan's, whole and unchanged; contents are not read."""
    return changes_since(plan, manifest) or find_damage(plan.output, dict(manifest), read=False)


def changes_since(plan: Plan, manifest: Mapping[str, Any]) -> list[str]:
    """What differs between a plan and the run of a manifest, by the stage that begins again for it.

    Empty where fingerprints agree. The last one says where the log or the corrections stay known.
    """
    if manifest["fingerprint"] == plan.fingerprint:
        return []
    changes = [*changed_inputs(plan, manifest), *changed_keys(plan, manifest)]
    of_run, codes = manifest.get("versions", {}), manifest.get("code", {})
    for stage, code in code_of_stages().items():
        if codes.get(stage) != code:
            text = f"another version of unbend ({of_run.get('unbend')} -> {unbend.__version__})"
            changes.append((stage, text))
            break  # the later ones begin again all the same
    changes += [
        (stage, f"{name} {_shown(of_run.get(name))} -> {_shown(version)}")
        for stage, of_stage in plan.libraries.items()
        for name, version in of_stage.items()
        if of_run.get(name) != version
    ]
    if not changes:
        return ["the mission file is read in another way"]
    changes.sort(key=lambda change: STAGES.index(change[0]))
    texts = [f"{stage}: {text}" for stage, text in changes]
    before, now = manifest.get("keys", {}), plan.keys
    if before.get("correction") == now["correction"] and is_kept(drawn_before(manifest)):
        texts[-1] += "; nothing is corrected again"
    elif before.get("ingest") == now["ingest"] and plan.mission.log is not None:
        texts[-1] += "; the log is not read again" if is_kept(plan.decoded_log) else ""
    return texts


def drawn_before(manifest: Mapping[str, Any]) -> str:
    """What the figures of a finished run's report are kept under."""
    batch_rows = manifest["config"]["output"]["batch_rows"]
    return key_of_drawn(manifest["keys"]["correction"], batch_rows)


def changed_inputs(plan: Plan, manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The inputs that differ from those of a run, each behind its stage."""
    before = {item["role"]: item["sha256"] for item in manifest.get("inputs", ())}
    now = {item.role: item for item in plan.inputs}
    for role in before.keys() - now.keys():
        yield stage_of_role(role), f"{role} is no longer read"
    for role, item in now.items():
        if before.get(role) != item.sha256:
            how = "changed" if role in before else "is new"
            yield stage_of_role(role), f"{role} {how} ({item.name})"


def changed_keys(plan: Plan, manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The keys of the mission file that differ, with both values, each behind its stage."""
    then = dict(_keys(manifest.get("config", {})))
    own = dict(_keys(plan.mission.model_dump(mode="json")))
    for key in sorted(then.keys() | own.keys()):
        if key not in NOT_IN_KEY and then.get(key) != own.get(key):
            yield stage_of_key(key), f"{key}: {_shown(then.get(key))} -> {_shown(own.get(key))}"


def _keys(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested mappings and lists by their keys, as ``sections.0.key``."""
    items: Any = ()
    if isinstance(values, Mapping):
        items = values.items()
    elif isinstance(values, list):
        items = enumerate(values)
    else:
        yield key, values
    for name, value in items:
        yield from _keys(value, f"{key}.{name}" if key else str(name))


def _shown(value: Any) -> str:
    return "nothing" if value is None else str(value)


Row = Mapping[str, Any]
"""What a campaign's page shows of a mission."""

_MOST_ENTRIES = 20_000
"""Remembered; of more those that were written longest ago are forgotten."""

_DATABASE = "missions.sqlite"


@dataclass(frozen=True)
class IndexEntry:
    """A mission whose file is as it was: its name and folder, and whether all else is too."""

    name: str
    output: Path
    exit_code: int
    row: Row
    unchanged: bool


def look_up(refs: Iterable[MissionRef]) -> dict[MissionRef, IndexEntry]:
    """What is known of missions whose file and defaults, and the program, are as they were."""
    program, known = _program(), {}
    for ref in refs:
        content = read_entry(_DATABASE, _key(ref))
        if content is None or content["program"] != program:
            continue
        files, file = content["files"], os.path.abspath(ref.path)
        if stamp(file) != files.get(file):
            continue
        if content["grids"] is not None and content["grids"] != grids_of_proj():
            continue
        # A run that is under way, or was interrupted, has a staging folder.
        staged = os.path.lexists(os.path.join(content["output"], STAGING))
        unchanged = not staged and all(stamp(path) == was for path, was in files.items())
        unchanged = unchanged and _with_sidecars(content["rasters"]) <= files.keys()
        output = Path(os.path.normpath(ref.folder / content["stated"]))
        known[ref] = IndexEntry(
            content["name"], output, content["exit_code"], content["row"], unchanged
        )
    return known


def remember(refs: Iterable[MissionRef], describe: Callable[[Row], Row]) -> None:
    """Keep which missions are unchanged, compared as `run` does; ``describe`` : their rows.

    None with folders, blocks or URLs as inputs, nor one that changed in the last two seconds.
    """
    program, entries = _program(), {}
    for ref in refs:
        with suppress(UnbendError, OSError):
            if content := entry_of(ref, describe):
                entries[_key(ref)] = content | {"program": program}
    write_entries(_DATABASE, entries, _MOST_ENTRIES)


def entry_of(ref: MissionRef, describe: Callable[[Row], Row]) -> dict[str, Any] | None:
    """The entry of a mission that is unchanged, and stays so while it is looked at."""
    file = os.path.abspath(ref.path)
    began = stamp(file)
    mission = ref.load()
    named = input_paths(mission, ref.folder)
    inputs = [path for _, path in named.values()]
    output = located(mission.output.path, ref.folder)
    if any(isinstance(path, Place) for path in (*inputs, output)):
        return None
    rasters = [os.path.abspath(str(path)) for role, (_, path) in named.items() if is_raster(role)]
    read = {os.path.abspath(str(path)) for path in inputs} | _with_sidecars(rasters)
    files = {path: stamp(path) for path in read} | {file: began}
    if not all(map(is_settled, files.values())):
        return None
    plan = make_plan(mission, ref.folder)
    manifest = read_manifest(plan.folder, damaged=True)
    if manifest is None or any(i.program in BLOCKS or i.path.is_dir() for i in plan.inputs):
        return None
    results = [plan.folder / str(item["name"]) for item in manifest["outputs"]]
    results += {path.parent for path in results} - {plan.folder}
    files |= {os.path.abspath(path): stamp(path) for path in [*results, plan.folder / MANIFEST]}
    if not all(map(is_settled, files.values())) or reasons_to_run(plan, manifest):
        return None
    if any(stamp(path) != known for path, known in files.items()):
        return None
    return {
        "name": mission.mission.name, "output": os.path.abspath(plan.folder),
        "stated": mission.output.path, "exit_code": int(manifest["exit_code"]),
        "row": dict(describe(manifest)), "files": files,
        "grids": plan.libraries["air"].get(GRIDS), "rasters": rasters,
    }  # fmt: skip


def _with_sidecars(rasters: Iterable[str]) -> set[str]:
    """Paths of rasters, and of the files beside them that are read with them."""
    return {str(file) for raster in rasters for file in raster_files(Path(raster))}


def known_stamps(name: str) -> dict[str, Any] | None:
    """What `keep_stamps` was given under a name, if the files are as they were then."""
    content: dict[str, Any] | None = read_entry(_DATABASE, name)
    if content is None or any(stamp(path) != known for path, known in content["files"].items()):
        return None
    return content


def keep_stamps(name: str, files: Iterable[Path], **content: Any) -> None:
    """Keep values that hold as long as these files, which this process wrote, stay as they are."""
    stamps = {os.path.abspath(path): stamp(path) for path in files}
    write_entries(_DATABASE, {name: content | {"files": stamps}}, _MOST_ENTRIES)


def _key(ref: MissionRef) -> str:
    words = [os.path.abspath(ref.path), ref.defaults, ref.own]
    return hashlib.sha256(json.dumps(words).encode()).hexdigest()


@lru_cache(maxsize=1)
def installed() -> str:
    """All that is installed, with versions: the names of the folders that describe it."""
    folders = [folder for folder in sys.path if os.path.isdir(folder)]
    names = {name for folder in folders for name in os.listdir(folder)}
    return json.dumps(sorted(name for name in names if name.endswith((".dist-info", ".egg-info"))))


def _program() -> str:
    """SHA-256 over the code, Python, and every library that is installed, whether used or not."""
    content = [code_hash(), sys.version, installed()]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
