"""The locks hold what pyproject.toml asks for; what is at fault beside them is found."""

import re
from dataclasses import dataclass, field

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.contract.bounds import at_fault
from tests.contract.sources import PROJECT, ROOT, text_of

OF_PROJECT = PROJECT["project"]
LOCKS = ROOT / ".locks"
FILES = ("main", "cluster", "build", "test")


def text_of_lock(name):
    return text_of(LOCKS / f"{name}.txt")


def pins(name):
    """Names and versions of a lock; a name may have several, for several Pythons."""
    pinned = set()
    for match in re.finditer(r"^([\w.-]+)==([^\s;\\]+)", text_of_lock(name), re.MULTILINE):
        release, version = match.groups()
        pinned.add((canonicalize_name(release), version))
    return pinned


@pytest.mark.parametrize("name", FILES)
def test_every_release_has_hashes_and_no_registry_is_named(name):
    text = text_of_lock(name)
    entries = re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]
    assert len(entries) >= len(pins(name))
    for entry in entries:
        assert "--hash=sha256:" in entry
    assert re.findall(r"https?:|file:|pypi|index-url|find-links|@", text) == []


@pytest.mark.parametrize("name", ["main", "cluster"])
def test_a_smaller_lock_is_a_part_of_the_whole(name):
    assert pins(name) < pins("test")


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        ("main", ()),
        ("cluster", ("rasters", "nwp", "dask", "cloud")),
        ("test", ("test", "docs")),
    ],
)
def test_a_lock_holds_what_pyproject_asks_for(lock, extras):
    asked = list(OF_PROJECT["dependencies"])
    for extra in extras:
        asked.extend(OF_PROJECT["optional-dependencies"][extra])
    locked = pins(lock)
    for requirement in map(Requirement, asked):
        name = canonicalize_name(requirement.name)
        versions = [version for release, version in locked if release == name]
        if name != OF_PROJECT["name"]:
            assert versions, f"{requirement} is not in the lock: make lock"
        for version in versions:
            assert version in requirement.specifier, f"{requirement}: make lock"


NAMES = "abcdefg"


@dataclass
class Pretended:
    """A trial that fails unless a dependency has its locked version."""

    needed: str
    installed: dict[str, str] = field(default_factory=dict)

    def holding(self, held):
        return dict.fromkeys(NAMES, "1.0") | held

    def install(self, versions):
        self.installed = versions

    def failure(self):
        if self.installed[self.needed] == "1.0":
            return "the sample"
        return None


@pytest.mark.parametrize("fault", NAMES)
def test_the_dependency_at_fault_is_found(fault):
    locked = dict.fromkeys(NAMES, "2.0")
    assert at_fault(Pretended(fault), locked, NAMES) == fault


def test_what_fails_with_the_lock_too_is_no_fault_of_a_bound(capsys):
    locked = dict.fromkeys(NAMES, "1.0")
    assert at_fault(Pretended("a"), locked, NAMES) is None
    assert "no bound is at fault" in capsys.readouterr().out
