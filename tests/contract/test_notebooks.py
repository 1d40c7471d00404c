"""The notebooks print what they show; a reader gets no path of a machine, no warning, no number."""

import importlib.util
import json
import os
import re
import subprocess
import sys

import pytest

from docs import notebooks
from tests.contract.sources import ROOT, text_of

PATHS = {path.stem: path for path in notebooks.notebooks()}
MACHINE = re.compile(r"/(?:tmp|home|root|Users|usr|opt|work)/|[A-Z]:\\|site-packages")


def test_there_are_two():
    assert [*PATHS] == ["arrays", "block"]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("nbclient") is None, reason="nbclient is missing")
@pytest.mark.skipif(importlib.util.find_spec("ipykernel") is None, reason="ipykernel is missing")
@pytest.mark.parametrize("name", PATHS)
def test_a_notebook_prints_what_it_shows(name):
    paths = [str(ROOT / "pipeline"), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", "docs.notebooks", PATHS[name]],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", PATHS)
def test_a_notebook_is_kept_without_what_belongs_to_a_machine(name):
    notebook = json.loads(text_of(PATHS[name]))
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    for cell in notebook["cells"]:
        assert not MACHINE.search("".join(cell["source"]))
        assert set(cell["metadata"]) <= {"alt"}
        if cell["cell_type"] == "code":
            assert cell["execution_count"] is None
        for output in notebooks.outputs_of(cell):
            assert not MACHINE.search(output.text)
            assert "Warning" not in output.text


@pytest.mark.parametrize("name", PATHS)
def test_the_page_of_a_notebook_has_its_outputs_and_can_be_downloaded(name):
    page = notebooks.text_of_page(PATHS[name])
    assert page.startswith("# ")
    assert f"]({name}.ipynb)" in page
    pictures = notebooks.pictures_of(PATHS[name])
    assert len(pictures) >= 2
    for file, picture in pictures.items():
        assert picture.startswith(b"\x89PNG")
        assert re.search(rf"!\[[^\]]{{20,}}\]\({file}\)", page), "a picture has words in its place"


def kept_cell(**output):
    """A cell as nbclient leaves it, with one output; what is kept of it."""
    cell = {
        "cell_type": "code",
        "id": "a",
        "source": "print(1)",
        "execution_count": 7,
        "metadata": {"execution": {"shell.execute_reply": "2026-01-01"}},
        "outputs": [output],
    }
    return notebooks.kept(cell)


def notebook_that_prints(text):
    cell = kept_cell(output_type="stream", name="stdout", text=text)
    return {"cells": [cell]}


def test_another_output_is_noticed(tmp_path):
    shown = notebook_that_prints("1\n")
    file = tmp_path / "a.ipynb"
    file.write_text(json.dumps(shown), "utf-8")
    assert notebooks.differences(file, shown) == []
    now = notebook_that_prints("2\n")
    (difference,) = notebooks.differences(file, now)
    assert "print(1)" in difference
    assert "2026" not in json.dumps(now)


def test_a_result_without_print_is_text():
    data = {"text/plain": "3.0", "text/html": "<b>3</b>"}
    cell = kept_cell(output_type="execute_result", data=data)
    assert notebooks.outputs_of(cell) == [notebooks.Output("3.0\n", "")]
