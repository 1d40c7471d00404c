"""What the results of a mission depend on, as one SHA-256.

The sources of this package, the versions of libraries that numbers depend on, the mission as
understood, and the contents of the inputs: where none of these differs, no number does.
"""

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import unbend
from unbend.atmosphere.standard import MSIS

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "pandas",
    "pyarrow",
    "pymavlink",
    "mcap",
    "mcap-ros2-support",
    "mcap-protobuf-support",
    "protobuf",
    "lz4",
    "zstandard",
    "metar",
    "exifread",
    "pillow",
    "pyproj",
    "jinja2",
    "markupsafe",
)
"""Libraries that the results of every mission depend on; the last two write the report."""

LIBRARIES_OF_INPUTS = {
    "weather model": ("xarray", "h5netcdf", "h5py", "cfgrib", "eccodes", "eccodeslib", "ecmwflibs"),
    "elevation model": ("rasterio",),
}
"""Libraries that read some inputs, by the beginning of the input's role."""

LIBRARIES_OF_ATMOSPHERES = {MSIS: ("pymsis",)}
"""Libraries that make standard atmospheres."""

GRIDS = "grids of pyproj"
"""The name of `grids_of_proj` among the versions."""

NOT_IN_FINGERPRINT = ("output.batch_rows",)
"""Keys of a mission file that no number depends on."""

_WITHOUT_PROJ = re.compile(r"log|observations|events|images|sounding \d+|weather model")
"""Roles of inputs that have no coordinates for PROJ to transform."""

_HASH_DIGITS = 16  # of the grids' hash: enough to tell two installations apart


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 over all files of the package: sources, tables of the climatologies, constants."""
    return hash_of_files(Path(str(resources.files(unbend))))


def hash_of_files(root: Path) -> str:
    """SHA-256 over names and contents of the files below a folder, without compiled code."""
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if not path.is_file() or "__pycache__" in path.parts:
            continue
        content = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


@lru_cache
def version(library: str) -> str | None:
    """The installed version of a library; None if it is not installed."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


@lru_cache(maxsize=1)
def grids_of_proj() -> str:
    """PROJ's version, and a hash of names and sizes of its grid files.

    A grid that is installed later changes coordinates.
    """
    import pyproj

    folders = pyproj.datadir.get_data_dir().split(os.pathsep)
    folders.append(pyproj.datadir.get_user_data_dir())
    files = []
    for folder in folders:
        if not os.path.isdir(folder):  # an empty name would be the current folder
            continue
        for path in sorted(Path(folder).iterdir()):
            if path.is_file():
                files.append(f"{path.name} {path.stat().st_size}")
    digest = hashlib.sha256("\n".join(files).encode()).hexdigest()
    return f"PROJ {pyproj.proj_version_str}, {digest[:_HASH_DIGITS]}"


def versions_of(roles: Iterable[str], standard: str) -> dict[str, str]:
    """Versions of the program, Python and libraries that a mission's numbers depend on.

    ``roles`` are those of its inputs, ``standard`` is the name of its standard atmosphere: some
    inputs and atmospheres need further libraries. A library that is not installed has no entry.
    """
    names = [*LIBRARIES, *LIBRARIES_OF_ATMOSPHERES.get(standard, ())]
    needs_grids = False
    for role in roles:
        needs_grids = needs_grids or not _WITHOUT_PROJ.fullmatch(role)
        for beginning, libraries in LIBRARIES_OF_INPUTS.items():
            if role.startswith(beginning):
                names.extend(libraries)
    versions = {
        "unbend": unbend.__version__,
        "code_sha256": code_hash(),
        "python": platform.python_version(),
    }
    for name in names:
        installed = version(name)
        if installed is not None:
            versions[name] = installed
    if needs_grids:
        versions[GRIDS] = grids_of_proj()
    return versions


def all_versions() -> dict[str, str]:
    """Versions of the program, Python and all libraries that any mission may need."""
    return versions_of(roles=LIBRARIES_OF_INPUTS, standard=MSIS)  # iterates over its keys, roles


def fingerprint_of(
    config: Mapping[str, Any],
    versions: Mapping[str, str],
    inputs: Mapping[str, str],
    nulls: Sequence[str] = (),
) -> str:
    """SHA-256 over all that the results of a mission depend on.

    ``config`` has the values of the mission file by section, ``versions`` those of `versions_of`,
    ``inputs`` the hash of each input by its role. ``nulls`` are the keys that the mission file
    states with null (`config.stated_nulls`).
    """
    sections = dict(config)
    for key in NOT_IN_FINGERPRINT:
        section, name = key.split(".")
        sections[section] = {k: v for k, v in sections[section].items() if k != name}
    content = {
        "config": sections,
        "versions": dict(versions),
        "inputs": dict(inputs),
        "nulls": list(nulls),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
