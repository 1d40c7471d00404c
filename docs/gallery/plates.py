"""What the pictures of the gallery share: colours, light and dark, tables, and the page.

Each script of this folder has `rows`, the numbers as a table of texts, and `draw`, which draws them
on a figure of `SIZE`. `python -m docs.gallery` writes all of them to docs/pages/gallery, with the
texts of texts.toml; tests/golden/test_gallery.py computes numbers again.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "pages" / "gallery"
BLUE = "#3b8ec9"
ORANGE = "#e58a1f"
GREEN = "#3aa678"
PURPLE = "#c45ab3"
GREY = "#8a8a8a"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, "#b8a31d", "#d9534f", "#56b4b4", "#7f6fd0", GREY)
THEMES = {"light": ("#333333", "#d9d9d9"), "dark": ("#dddddd", "#50566a")}
"""Colours of words and of lines, on the ground of the page."""


def save(name: str, title: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """A picture in both themes; returns what stands on the page for it."""
    shown = ""
    for theme, (words, lines) in THEMES.items():
        style = {
            "text.color": words,
            "axes.labelcolor": words,
            "axes.edgecolor": lines,
            "axes.titlecolor": words,
            "xtick.color": words,
            "ytick.color": words,
            "axes.facecolor": "none",
            "figure.facecolor": "none",
            "savefig.facecolor": "none",
            "grid.color": lines,
            "axes.grid": True,
            "grid.linewidth": 0.5,
            "font.size": 9,
            "axes.titlesize": 10,
            "legend.frameon": False,
            "axes.axisbelow": True,
            "axes.prop_cycle": mpl.cycler(color=COLOURS),
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.unicode_minus": False,
        }
        with mpl.rc_context(style):
            figure = Figure(figsize=size, layout="constrained")
            draw(figure)
            figure.savefig(FOLDER / f"{name}-{theme}.png", dpi=110, metadata={"Software": None})
        shown += f"![{title}]({name}-{theme}.png#only-{theme})\n"
    return shown


def bars(axis: Axes, values: dict[str, list[str]]) -> None:
    """Root mean squares as bars from the top, and the values themselves as points, log scale."""
    for y, (colour, texts) in enumerate(zip(COLOURS, values.values(), strict=False)):
        found = abs(np.array(texts, float))
        axis.barh(-y, np.sqrt(np.mean(found**2)), color=colour, alpha=0.55)
        axis.plot(found, np.full(found.size, -y), ".", color=colour)
    axis.set_yticks([-y for y in range(len(values))], list(values))
    axis.set_xscale("log")
    axis.set_xlim(0.005, 50.0)
    axis.set_xticks([0.01, 0.1, 1.0, 10.0], ["0.01", "0.1", "1", "10"])


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of texts as Markdown, the first of them the head."""
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "| :-- |" + " --: |" * (len(rows[0]) - 1), *body])


def numbers_of(name: str) -> list[list[str]]:
    """The table of a script as it stands on the page."""
    page = (FOLDER / "index.md").read_text(encoding="utf-8")
    lines = page.split(f"docs/gallery/{name}.py")[1].split("## ")[0].splitlines()
    cells = [line.strip()[1:-1].split("|") for line in lines if line.startswith("    |")]
    rows = [[cell.strip() for cell in row] for row in cells]
    return [rows[0], *rows[2:]]
