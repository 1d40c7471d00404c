"""Keys of the stages of a run: what each depends on, so that a change says which begins again.

A key is a hash over the key of the stage before, the inputs and sections that the stage reads, its
libraries, and the code it reaches: modules imported at any place, and the data beside them.
"""

import hashlib
import json
import os
import platform
import re
import tomllib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import unbend
from unbend.atmosphere.standard import MSIS
from unbend.batch.file_hashes import recalled, remember

STAGES = ("ingest", "air", "correction", "report")
"""In their order: a stage that begins again has all later ones begin again."""

NOT_IN_KEY = ("output.batch_rows",)
"""Keys of a mission file that no number depends on."""

_STORY = "unbend.batch.runs"
_AFTERWARDS = {"unbend.batch.changes"}
TABLES = tomllib.loads(resources.files(__package__).joinpath("stages.toml").read_text("utf-8"))
"""``modules``, ``sections``, ``roles``, ``libraries`` of stages, and ``inputs`` of missions."""

GRIDS = "grids of pyproj"
"""The name of `grids_of_proj` among the libraries."""

_WITHOUT_PROJ = re.compile(r"log|observations|events|images|sounding \d+|weather model")

_GAP = r"(?:[ \t]|\\\n)+"
_IMPORT = re.compile(
    rf"\bfrom{_GAP}(\.*[\w.]*){_GAP}import{_GAP}(\((?:[^)#]|#[^\n]*)*\)|(?:\\\n|[^\n])*)"
)
_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t][^\n]*\n|\n)+", re.MULTILINE)
_NAMED = re.compile(r"\bunbend(?:\.\w+)+")


def stage_of_role(role: str) -> str:
    return str(TABLES["roles"].get(role, "air"))


def stage_of_key(key: str) -> str:
    """The first stage that depends on a key of the mission file, as ``section.key``."""
    return str(TABLES["sections"].get(key.partition(".")[0], "air"))


def keys_of(config: Mapping[str, Any], inputs: Mapping[str, str]) -> dict[str, str]:
    """The key of each stage: of a mission file as understood, and the hashes of its inputs."""
    config = dict(config)
    for key in NOT_IN_KEY:
        section, name = key.split(".")
        config[section] = {k: v for k, v in config[section].items() if k != name}
    codes, known, before = code_of_stages(), libraries(inputs, config["atmosphere"]["standard"]), ""
    keys = {}
    for stage in STAGES:
        sections = {n: s for n, s in config.items() if stage_of_key(n) == stage != "ingest"}
        content = {
            "before": before,
            "code": codes[stage],
            "libraries": known[stage],
            "inputs": {r: sha256 for r, sha256 in inputs.items() if stage_of_role(r) == stage},
            "config": sections,
        }
        text = json.dumps(content, sort_keys=True)
        keys[stage] = before = hashlib.sha256(text.encode()).hexdigest()
    return keys


def libraries(roles: Iterable[str], standard: str) -> dict[str, dict[str, str | None]]:
    """Versions of the libraries that the numbers depend on, by stage; None if not installed.

    ``roles`` of the inputs and the name of the atmosphere: some need libraries of their own.
    """
    known = {s: {name: version(name) for name in TABLES["libraries"][s]} for s in STAGES}
    roles = list(roles)
    words = {role.split()[0] for role in roles}
    for word in sorted({*words, standard} & TABLES["libraries_of"].keys()):
        known["air"] |= {name: version(name) for name in TABLES["libraries_of"][word]}
    if not all(map(_WITHOUT_PROJ.fullmatch, roles)):
        known["air"][GRIDS] = grids_of_proj()
    return known


@lru_cache
def version(library: str) -> str | None:
    """The installed version of a library, or of Python; None where there is none."""
    if library == "python":
        return platform.python_version()
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


@lru_cache(maxsize=1)
def grids_of_proj() -> str:
    """PROJ's version and a hash of its grids: one installed later changes coordinates."""
    import pyproj

    folders = [*pyproj.datadir.get_data_dir().split(os.pathsep), pyproj.datadir.get_user_data_dir()]
    folders = list(filter(os.path.isdir, folders))  # an empty name would be the current folder
    paths = [path for folder in folders for path in sorted(Path(folder).iterdir())]
    files = [f"{path.name} {path.stat().st_size}" for path in paths if path.is_file()]
    digest = hashlib.sha256("\n".join(files).encode()).hexdigest()
    return f"PROJ {pyproj.proj_version_str}, {digest[:16]}"


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 over all files of the package: sources, tables of the climatologies, constants."""
    return hash_of_files(Path(str(resources.files(unbend))))


def hash_of_files(root: Path) -> str:
    """SHA-256 over names and contents of the files below a folder, without compiled code."""
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            content = path.read_bytes()
            digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


def versions(known: Mapping[str, Mapping[str, str | None]] | None = None) -> dict[str, Any]:
    """Versions of code, Python and libraries (``known`` of a plan, or all), for the manifest."""
    known = known or libraries(("weather model", "elevation model"), MSIS)
    found = {"unbend": unbend.__version__, "code_sha256": code_hash()}
    for of_stage in known.values():
        found |= {name: version for name, version in of_stage.items() if version is not None}
    return found


def code_of_stages() -> dict[str, str]:
    return {stage: code_of_package()[stage] for stage in STAGES}


@lru_cache(maxsize=1)
def code_of_package() -> dict[str, str]:
    """`code_below` of this package, remembered by the hash of its files: it takes 0.16 s of CPU."""
    root, of_files = Path(str(resources.files(unbend))), code_hash()
    if known := recalled(f"code of {root}", of_files):
        return dict(json.loads(known))
    codes = code_below(root)
    if hash_of_files(root) == of_files:  # nobody has edited one in between
        remember({f"code of {root}": (of_files, json.dumps(codes))})
    return codes


def key_of_drawn(correction: str, batch_rows: int) -> str:
    """What the figures of a report are kept under; rows that stand for all differ by the parts."""
    code = code_of_package()["flown"]
    return f"flown-{hashlib.sha256(f'{correction} {code} {batch_rows}'.encode()).hexdigest()}"


def code_below(root: Path) -> dict[str, str]:
    """SHA-256 of the code and the data that each stage reaches, and the figures of a report."""
    digests: dict[str, str] = {}
    data: dict[str, list[str]] = {}
    packages = {path.parent for path in root.rglob("__init__.py")}
    texts: dict[str, set[str]] = {}
    for path in sorted(root.rglob("*")):
        if not path.is_file() or "__pycache__" in path.parts:
            continue
        content, place = path.read_bytes(), path.relative_to(root.parent)
        name = place.as_posix()
        if path.suffix == ".py":
            name = ".".join(place.with_suffix("").parts).removesuffix(".__init__")
            package = name if path.stem == "__init__" else name.rpartition(".")[0]
            texts[name] = imported(content.decode(), package)
        else:
            folder = next(folder for folder in path.parents if folder in packages)
            owner = ".".join(folder.relative_to(root.parent).parts)
            data.setdefault(owner, []).append(name)
        digests[name] = hashlib.sha256(content).hexdigest()
    edges = {name: names & texts.keys() for name, names in texts.items()}
    # Names of modules that these two hold are no imports: no module asks the first for one.
    edges |= {root.name: set(), __name__: {root.name}}
    codes = {}
    for stage, modules in stage_modules(edges[_STORY]).items():
        reached = closure(modules, edges)
        reached |= {_STORY} if stage != "ingest" else set()
        owners = reached - {"unbend.report"} if stage == "flown" else reached  # it reads no text
        names = reached | {name for owner in owners for name in data.get(owner, ())}
        text = "\n".join(f"{name} {digests[name]}" for name in sorted(names))
        codes[stage] = hashlib.sha256(text.encode()).hexdigest()
    return codes


def imported(text: str, package: str = "unbend") -> set[str]:
    """Names in a source of a ``package`` that may be modules: imported anywhere, or in texts.

    >>> sorted(imported("def f():\\n    from unbend.ingest import (\\n        log,\\n    )"))
    ['unbend', 'unbend.ingest', 'unbend.ingest.log']
    """
    text = _TYPES.sub("", text)
    names = set(_NAMED.findall(text))
    for module, members in _IMPORT.findall(text):
        if module.startswith("."):
            name = module.lstrip(".")
            above = package.split(".")[: 1 - (len(module) - len(name)) or None]
            module = ".".join([*above, *filter(None, [name])])
        if module.partition(".")[0] == "unbend":
            names |= {module, *(f"{module}.{n}" for n in re.findall(r"\w+", members))}
    return {
        ".".join(parts[: k + 1])
        for parts in (name.split(".") for name in names)
        for k in range(len(parts))
    }


def stage_modules(story: Iterable[str]) -> dict[str, set[str]]:
    """The modules each stage begins with; ``flown`` is the part of the report that is kept."""
    after = {name for name in story if name.startswith("unbend.report")}
    return {stage: {*names} for stage, names in TABLES["modules"].items()} | {
        "correction": {*story} - after - _AFTERWARDS,
        "report": after,
        "flown": {"unbend.report.flown"},
    }


def closure(modules: Iterable[str], edges: Mapping[str, set[str]]) -> set[str]:
    """The modules that some reach, with themselves."""
    reached: set[str] = set()
    waiting = {*modules}
    while waiting:
        name = waiting.pop()
        reached.add(name)
        waiting |= edges[name] - reached
    return reached
