"""The conda recipe and the container file agree with pyproject.toml; one field has the address."""

import re
from email.message import Message

import pytest
import yaml
from packaging.requirements import Requirement

import unbend
from docs import reference
from tests.contract.sources import PROJECT, ROOT, text_of
from unbend.cli.app import print_bug

RECIPE = yaml.safe_load(text_of(ROOT / "packaging" / "conda" / "recipe" / "recipe.yaml"))
CONTAINER = text_of(ROOT / "packaging" / "Containerfile")

CONDA_NAMES = {"matplotlib": "matplotlib-base"}
"""Packages with another name on conda-forge: there `matplotlib` brings a window system too."""


def as_in_conda(requirement):
    """A requirement of pyproject.toml as a recipe writes it."""
    parsed = Requirement(requirement)
    assert not parsed.extras, requirement
    assert parsed.marker is None, requirement
    return f"{CONDA_NAMES.get(parsed.name, parsed.name)} {parsed.specifier}"


def test_the_recipe_asks_for_what_pyproject_asks_for():
    run = RECIPE["requirements"]["run"]
    dependencies = [as_in_conda(line) for line in PROJECT["project"]["dependencies"]]
    assert run == ["python >=${{ python_min }}", *dependencies]
    build = [as_in_conda(line) for line in PROJECT["build-system"]["requires"]]
    assert RECIPE["requirements"]["host"] == ["python ${{ python_min }}.*", "pip", *build]
    assert f">={RECIPE['context']['python_min']}" == PROJECT["project"]["requires-python"]


def test_the_recipe_names_this_release():
    project = PROJECT["project"]
    assert RECIPE["context"]["version"] == unbend.__version__
    assert RECIPE["package"]["name"] == project["name"]
    scripts = [f"{name} = {target}" for name, target in project["scripts"].items()]
    assert RECIPE["build"]["python"]["entry_points"] == scripts
    about = RECIPE["about"]
    assert about["summary"] == project["description"]
    assert about["license"] == project["license"]
    assert [about["license_file"]] == project["license-files"]


def test_what_the_recipe_tries_works(unbend):
    (commands,) = [test["script"] for test in RECIPE["tests"] if "script" in test]
    for command in commands:
        program, *words = command.split()
        assert program == "unbend"
        assert unbend(*words).code == 0, command


def test_what_the_container_copies_and_installs_exists():
    copied = re.findall(r"^COPY (.+) \S+$", CONTAINER, flags=re.MULTILINE)
    for name in " ".join(copied).split():
        assert (ROOT / name).exists(), name
    locks = re.findall(r"/source/(\.locks/\w+\.txt)", CONTAINER)
    assert set(locks) == {".locks/build.txt", ".locks/cluster.txt"}
    assert all((ROOT / lock).is_file() for lock in locks)
    tag = re.search(r"^FROM python:(3\.\d+)-slim$", CONTAINER, flags=re.MULTILINE)
    assert tag is not None
    assert f"Programming Language :: Python :: {tag[1]}" in PROJECT["project"]["classifiers"]
    assert 'ENTRYPOINT ["unbend"]' in CONTAINER


def test_the_install_page_names_every_extra():
    page = text_of(ROOT / "docs" / "pages" / "install.md")
    extras = set(PROJECT["project"]["optional-dependencies"]) - {"test", "docs"}
    assert set(re.findall(r'`pip install "\.\[(\w+)\]"`', page)) == extras
    cluster = "`rasters`, `nwp`, `dask` and `cloud`"  # as `make lock` gives them to cluster.txt
    assert cluster in page


@pytest.mark.parametrize(
    ("entries", "receiver"),
    [
        (["Issues, https://example.org/issues"], "at https://example.org/issues"),
        (["Repository, https://example.org"], "to the maintainer of this copy"),
        (None, "to the maintainer of this copy"),
    ],
)
def test_a_bug_says_where_it_is_reported(entries, receiver, monkeypatch, capsys):
    found = Message()
    for entry in entries or ():
        found["Project-URL"] = entry
    monkeypatch.setattr("importlib.metadata.metadata", lambda name: found)
    print_bug("Traceback ...")
    said = capsys.readouterr().err
    assert f"this is a bug in unbend: please report the lines above {receiver}" in said


def test_the_documentation_reads_the_same_address(monkeypatch):
    urls = {"Issues": "https://example.org/issues"}
    monkeypatch.setattr(reference, "project_urls", lambda: urls)
    assert reference.address_of("Issues") == "<https://example.org/issues>"
    assert "pyproject.toml" in reference.address_of("Repository")


def test_the_addresses_are_those_that_are_read():
    assert set(reference.project_urls()) <= {"Repository", "Issues"}
