"""What a stranger gets: the main names, the licence, one version, a whole distribution."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import unbend
from tests.contract.sources import PROJECT, ROOT, text_of
from unbend.atmosphere import standard_atmosphere
from unbend.batch.runs import run_mission
from unbend.config import load_mission
from unbend.errors import UnbendError
from unbend.ingest import open_log
from unbend.library import correct
from unbend.refraction import correct_observations, refraction_angle

MAIN_NAMES = {
    "UnbendError": UnbendError,
    "correct": correct,
    "correct_observations": correct_observations,
    "load_mission": load_mission,
    "open_log": open_log,
    "refraction_angle": refraction_angle,
    "run_mission": run_mission,
    "standard_atmosphere": standard_atmosphere,
}


def test_the_main_names_are_those_of_their_rooms():
    assert set(unbend.__all__) == {"__version__", *MAIN_NAMES}
    for name, function in MAIN_NAMES.items():
        assert getattr(unbend, name) is function
        assert name in dir(unbend)


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        unbend.nothing  # noqa: B018


def test_the_version_stands_in_one_place():
    assert "version" not in PROJECT["project"]
    assert PROJECT["tool"]["hatch"]["version"]["path"] == "pipeline/unbend/__init__.py"
    changelog = text_of(ROOT / "docs" / "changelog.md")
    newest = re.search(r"^## .*?(\d+\.\d+\.\d+)", changelog, re.MULTILINE)
    assert newest is not None
    assert newest[1] == unbend.__version__
    assert citation()["version"] == unbend.__version__


def test_each_version_of_the_changelog_is_a_dozen_lines():
    changelog = text_of(ROOT / "docs" / "changelog.md")
    for section in re.split(r"^## ", changelog, flags=re.MULTILINE)[1:]:
        title, *lines = section.strip().splitlines()
        assert sum(bool(line.strip()) for line in lines) <= 16, title


def citation():
    return yaml.safe_load(text_of(ROOT / "CITATION.cff"))


def test_the_citation_names_the_three_papers():
    fields = ("year", "volume", "issue", "start", "end")
    papers = {
        paper["authors"][0]["family-names"]: tuple(int(paper[field]) for field in fields)
        for paper in citation()["references"]
    }
    assert papers == {
        "Gyer": (1996, 62, 3, 301, 310),
        "Saastamoinen": (1974, 40, 3, 295, 301),
        "Bertram": (1966, 32, 1, 76, 84),
    }
    assert citation()["license"] == PROJECT["project"]["license"]


def test_the_licence_is_apache():
    assert "Apache License" in text_of(ROOT / "LICENSE")
    assert PROJECT["project"]["license"] == "Apache-2.0"


def test_types_and_tables_lie_in_the_package():
    package = Path(unbend.__file__).parent  # as installed
    assert (package / "py.typed").is_file()
    tables = {path.name for path in package.rglob("*.csv")}
    assert {"standard_atmospheres.csv", "supplements1966.csv", "gyer1996_tables3_4.csv"} <= tables


def test_the_source_distribution_names_what_a_stranger_reads():
    included = set(PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    for name in ("LICENSE", "CITATION.cff", "CONTRIBUTING.md", "README.md", "configs", "docs"):
        assert f"/{name}" in included
        assert (ROOT / name).exists()


def test_the_installed_distribution_says_whose_it_is():
    try:
        meta = importlib.metadata.metadata("unbend")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("unbend is not installed, only on the path")
    if meta["Version"] != unbend.__version__:
        pytest.skip(f"the installed metadata is that of {meta['Version']}")
    assert meta["License-Expression"] == "Apache-2.0"
    assert meta["Author"] == "The unbend authors"


@pytest.mark.parametrize("script", ["fit_air", "judge_air", "judge_faults"])
def test_a_script_that_no_test_runs_starts(script):
    """It imports names of the package, which may have others since."""
    command = [sys.executable, str(ROOT / f"benchmarks/{script}.py"), "--help"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "usage:" in ended.stdout


def test_what_the_makefile_runs_is_there():
    makefile = text_of(ROOT / "Makefile")
    paths = set(re.findall(r"\b(?:tests|benchmarks|docs)/[\w/]+(?:\.\w+)?", makefile))
    made = {"docs/site", "docs/site/index.html"}  # the site is built by it
    assert [path for path in sorted(paths - made) if not (ROOT / path).exists()] == []
