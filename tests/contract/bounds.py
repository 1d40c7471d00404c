"""Are the bounds of pyproject.toml true, and which dependency is at fault if not?

    python tests/contract/bounds.py [--python PYTHON] lowest|latest WORDS OF PYTEST ...

Installs the lowest releases that pyproject.toml allows for what it names itself (or the newest of
everything) into .venv-lowest (.venv-latest), imports all extras, runs the sample missions and the
tests. Where that fails, the first dependencies of the list are held to what is locked, half of the
list or a quarter at a time, until one is found that makes the difference.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / ".locks" / "test.txt"
UV = Path(sysconfig.get_path("scripts")) / "uv"
RESOLUTIONS = {"lowest": "lowest-direct", "latest": "highest"}
SAMPLES = ("sample_bin", "sample_tlog", "sample_mcap")
# What the extras of the program bring, by the names they are imported under.
IMPORTS = (
    "rasterio, pycolmap, pymsis, xarray, h5netcdf, h5py, cfgrib, eccodes, obstore, distributed, "
    "material, mkdocstrings_handlers.python, latex2mathml"
)
# Of the extra `test`, what the tests that are run here import.
TOOLS = {"hypothesis", "mpmath", "pytest", "pytest-xdist"}
# Old releases warn of what newer Pythons lack: no fault of a bound.
WARNINGS = {"lowest": "default", "latest": "error"}

Versions = dict[str, str]


def named(requirement: str) -> str:
    """The name of a distribution as resolvers write it."""
    name = re.match(r"[\w.-]+", requirement)
    assert name is not None, requirement
    return re.sub(r"[-_.]+", "-", name.group()).lower()


def requirements() -> list[str]:
    """What pyproject.toml asks for by name, the program's own first, without other tools."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = dict(project["optional-dependencies"])
    tools = [tool for tool in extras.pop("test") if named(tool) in TOOLS]
    return [*project["dependencies"], *chain.from_iterable(extras.values()), *tools]


@dataclass(frozen=True)
class Trial:
    """One kind of resolution with one Python, and the environment it is tried in."""

    which: str
    python: str
    tests: Sequence[str]

    @property
    def venv(self) -> Path:
        return ROOT / f".venv-{self.which}"

    @property
    def interpreter(self) -> Path:
        return self.venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    def uv(self, *words: object, given: str = "") -> str:
        done = subprocess.run(
            [UV, *map(str, words), "--no-config", "--quiet", "--python", self.interpreter],
            cwd=ROOT,
            input=given,
            check=False,
            stdout=subprocess.PIPE,
            encoding="utf-8",
        )
        if done.returncode:
            sys.exit(f"uv {words[0]} {words[1]} ended with {done.returncode}")
        return done.stdout

    def resolved(self, resolution: str, *constraints: Path) -> Versions:
        """Versions of everything, as this resolution takes them for this Python."""
        held = chain.from_iterable(("--constraint", file) for file in constraints)
        command = "pip compile - --only-binary :all: --no-header --no-annotate --no-emit-index-url"
        asked = "\n".join(requirements())
        said = self.uv(*command.split(), "--resolution", resolution, *held, given=asked)
        pins = (line.split(";")[0].strip() for line in said.splitlines())
        return dict(pin.split("==") for pin in pins if pin)

    def holding(self, held: Versions) -> Versions:
        """The resolution of this trial with some versions held."""
        file = self.venv / "held.txt"
        file.write_text(pinned(held), "utf-8")
        return self.resolved(RESOLUTIONS[self.which], file)

    def install(self, versions: Versions):
        file = self.venv / "versions.txt"
        file.write_text(pinned(versions), "utf-8")
        self.uv("pip", "sync", "--only-binary", ":all:", file)

    def failure(self) -> str | None:
        """The first step that fails in the environment as it stands."""
        work = self.venv / "sample"
        shutil.rmtree(work, ignore_errors=True)
        for folder in ("configs", "sample_logs"):
            shutil.copytree(ROOT / folder, work / folder)
        missions = [f"configs/{name}.yaml" for name in SAMPLES]
        warnings = f"filterwarnings={WARNINGS[self.which]}"
        steps = {
            "the import of all extras": ("-c", f"import {IMPORTS}"),
            "the sample": ("-m", "unbend", "run", *missions),
            "the tests": ("-m", "pytest", "-q", "-x", "-n", "2", "-o", warnings, *self.tests),
        }
        for name, words in steps.items():
            place = ROOT if name == "the tests" else work
            if not self.succeeds(place, *words):
                return name
        return None

    def succeeds(self, place: Path, *words: object) -> bool:
        own = {
            "PYTHONPATH": str(ROOT / "pipeline"),
            "XDG_CACHE_HOME": str(self.venv / "cache"),
            "OPENBLAS_NUM_THREADS": "1",
        }
        done = subprocess.run(
            [self.interpreter, *map(str, words)],
            cwd=place,
            env=os.environ | own,
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
        )
        if done.returncode:
            print(done.stdout[-6000:], flush=True)
        return done.returncode == 0


def pinned(versions: Versions) -> str:
    return "".join(f"{name}=={version}\n" for name, version in versions.items())


def at_fault(trial: Trial, locked: Versions, suspects: Sequence[str]) -> str | None:
    """The dependency without whose locked version the trial fails.

    With the first `works` suspects held to the lock it passes, with the first `fails` it does not.
    """
    fails = 0
    works = len(suspects)
    trial.install(locked)
    if (step := trial.failure()) is not None:
        print(f"with all locked versions {step} fails too: no bound is at fault")
        return None
    while works - fails > 1:
        middle = (fails + works) // 2
        trial.install(trial.holding({name: locked[name] for name in suspects[:middle]}))
        if trial.failure() is None:
            works = middle
        else:
            fails = middle
    return suspects[works - 1]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", choices=RESOLUTIONS)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("tests", nargs=argparse.REMAINDER, help="words of pytest")
    words = parser.parse_args()
    trial = Trial(which=words.which, python=words.python, tests=words.tests)

    subprocess.run([trial.python, "-m", "venv", "--clear", "--without-pip", trial.venv], check=True)
    versions = trial.resolved(RESOLUTIONS[trial.which])
    locked = trial.resolved("highest", LOCK)
    direct = [name for name in map(named, requirements()) if name in versions]
    order = dict.fromkeys([*direct, *versions])
    differing = [name for name in order if versions[name] != locked.get(name)]
    print(f"{len(differing)} of {len(versions)} packages differ from the lock:")
    for name in differing:
        print(f"  {name} {versions[name]} (locked: {locked.get(name, 'none')})")

    trial.install(versions)
    step = trial.failure()
    if step is None:
        print(f"{trial.which}: all extras, the sample and the tests pass")
        return
    print(f"{trial.which}: {step} fails; looking for the package at fault", flush=True)
    suspects = [name for name in differing if name in locked]
    fault = at_fault(trial, locked, suspects)
    if fault is not None:
        print(f"at fault: {fault} {versions[fault]}; {locked[fault]} passes")
    sys.exit(1)


if __name__ == "__main__":
    main()
