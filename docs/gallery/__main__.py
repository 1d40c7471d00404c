"""Draws the gallery and writes its page: python -m docs.gallery [NAME...], in the root.

Pictures that are not named keep the numbers of the page and are drawn again.
"""

import os
import sys
import tomllib
from functools import partial
from importlib import import_module
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for each other
from docs.gallery.plates import FOLDER, numbers_of, save, table

PAGE = FOLDER / "index.md"
TEXTS = Path(__file__).with_name("texts.toml")
HEAD = """\
# Gallery

The scripts in `docs/gallery` make these pictures, and the table below each of them.
`python -m docs.gallery` runs them and writes this page (after `make sample`, with the requirements
of the tests). Tests compute the numbers again; of those that take long, a part.
"""


def main(named: list[str]) -> None:
    page = HEAD
    texts = tomllib.loads(TEXTS.read_text("utf-8"))
    for name, about in texts.items():
        script = import_module(f"docs.gallery.{name}")
        rows = script.rows() if name in named or not named else numbers_of(name)
        title = about["title"]
        drawn = partial(script.draw, table=rows)
        picture = save(name, title, script.SIZE, drawn)
        page += f"\n## {title}\n\n{about['text']}\n{picture}\n"
        page += f'??? note "The numbers (`docs/gallery/{name}.py`)"\n\n'
        page += "".join(f"    {line}\n" for line in table(rows).splitlines())
    PAGE.write_text(page, "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
