"""The notebooks of the documentation: executed here, shown as pages of the site.

    python -m docs.notebooks                  # executes all, and compares what they print
    python -m docs.notebooks --write PAGE...  # writes what comes out into the notebook

A notebook is kept with its outputs, so that the site needs no kernel. Each is executed in an empty
folder. Kept are the cells, what they print and their pictures; not kept are times, versions and
numbers of cells, so that a new execution changes nothing else.
"""

import base64
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from unbend.arithmetic import use_same_arithmetic

PAGES = Path(__file__).resolve().parent / "pages"
SECONDS_OF_A_CELL = 1200
KERNEL = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}

Cell = dict[str, Any]


class Output(NamedTuple):
    """What a cell gives: text, or a picture in base64."""

    text: str
    picture: str


def notebooks() -> list[Path]:
    return sorted(PAGES.rglob("*.ipynb"))


def cells_of(notebook: Path) -> list[Cell]:
    cells: list[Cell] = json.loads(notebook.read_text("utf-8"))["cells"]
    return cells


def executed(notebook: Path) -> dict[str, Any]:
    """The notebook with the outputs of a new execution in an empty folder."""
    import nbformat
    from nbclient import NotebookClient

    fresh = nbformat.read(notebook, as_version=4)
    use_same_arithmetic()
    programs = str(Path(sys.executable).parent)  # where `!unbend` is found
    env = os.environ | {
        "PATH": os.pathsep.join((programs, os.environ["PATH"])),
        "COLUMNS": "80",
    }
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            fresh,
            timeout=SECONDS_OF_A_CELL,
            kernel_name="python3",
            resources={"metadata": {"path": folder}},
            record_timing=False,
        )
        client.execute(env=env)
    cells = [kept(cell) for cell in fresh.cells]
    return {"cells": cells, "metadata": KERNEL, "nbformat": 4, "nbformat_minor": 5}


def kept(cell: Cell) -> Cell:
    """A cell without what differs from one execution to the other."""
    alt = cell["metadata"].get("alt")
    bare: Cell = {
        "cell_type": cell["cell_type"],
        "id": cell["id"],
        "metadata": {"alt": alt} if alt else {},
        "source": cell["source"].splitlines(keepends=True),
    }
    if cell["cell_type"] == "code":
        bare["execution_count"] = None
        bare["outputs"] = list(kept_outputs(cell["outputs"]))
    return bare


def kept_outputs(outputs: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Outputs as plain text or pictures; the text of one stream is joined."""
    printed = ""
    for output in outputs:
        if output["output_type"] == "stream":
            printed += output["text"]
        elif "image/png" in output["data"]:
            picture = {"image/png": output["data"]["image/png"].strip()}
            yield {"data": picture, "metadata": {}, "output_type": "display_data"}
        else:
            printed += output["data"]["text/plain"] + "\n"
    if printed:
        text = printed.splitlines(keepends=True)
        yield {"name": "stdout", "output_type": "stream", "text": text}


def outputs_of(cell: Cell) -> list[Output]:
    """The outputs of a cell that is kept."""
    found = []
    for output in cell.get("outputs", ()):
        if output["output_type"] == "stream":
            found.append(Output("".join(output["text"]), ""))
        else:
            found.append(Output("", output["data"]["image/png"]))
    return found


def text_of_page(notebook: Path) -> str:
    """The page of a notebook as Markdown, with a link to the notebook below its title."""
    title, *parts = cells_of(notebook)
    lines = [
        "".join(title["source"]),
        f"[Download this notebook]({notebook.name}){{ .md-button download }}",
    ]
    for number, cell in enumerate(parts, start=1):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines.append(source)
            continue
        lines.append(f"```python\n{source}\n```")
        for output in outputs_of(cell):
            if output.text:
                lines.append(f"```text\n{output.text.rstrip()}\n```")
            else:
                lines.append(f"![{cell['metadata']['alt']}]({picture_name(notebook, number)})")
    return "\n\n".join(lines)


def pictures_of(notebook: Path) -> dict[str, bytes]:
    """The pictures of a notebook's page, by the names that the page gives them."""
    pictures = {}
    for number, cell in enumerate(cells_of(notebook)):
        for output in outputs_of(cell):
            if output.picture:
                pictures[picture_name(notebook, number)] = base64.b64decode(output.picture)
    return pictures


def picture_name(notebook: Path, number: int) -> str:
    """The name of the picture that a cell draws: at most one a cell."""
    return f"{notebook.stem}_{number}.png"


def differences(notebook: Path, now: dict[str, Any]) -> list[str]:
    """Where a new execution prints another text, or draws where nothing was drawn."""
    found = []
    for shown, fresh in zip(cells_of(notebook), now["cells"], strict=True):
        texts = [output.text for output in outputs_of(shown)]
        texts_now = [output.text for output in outputs_of(fresh)]
        if texts != texts_now:
            source = "".join(fresh["source"])
            found.append(f"{source}\nshown: {texts}\nprinted: {texts_now}")
    return found


def main() -> int:
    words = sys.argv[1:]
    named = [Path(word).resolve() for word in words if not word.startswith("-")]
    different = 0
    for notebook in named or notebooks():
        now = executed(notebook)
        found = differences(notebook, now)
        different += len(found)
        print("\n".join([f"{notebook.name}: {len(found)} cells print something else", *found]))
        if "--write" in words:
            text = json.dumps(now, indent=1, ensure_ascii=False, sort_keys=True)
            notebook.write_text(text + "\n", "utf-8")
    return int(different > 0 and "--write" not in words)


if __name__ == "__main__":
    sys.exit(main())
