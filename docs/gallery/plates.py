"""What the pictures of the gallery share: colours, light and dark, tables, and the page.

Each script has `rows`, a table of texts, and `draw`, which draws them on a figure of `SIZE`.
"""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "pages/gallery"
BLUE = "#3b8ec9"
ORANGE = "#e58a1f"
GREEN = "#3aa678"
PURPLE = "#c45ab3"
GREY = "#8a8a8a"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, "#b8a31d", "#d9534f", "#56b4b4", "#7f6fd0", GREY)
THEMES = {"light": ("#333333", "#d9d9d9"), "dark": ("#dddddd", "#50566a")}  # words, lines


def save(name: str, title: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """A picture in both themes; returns what the page has for it."""
    links = ""
    for theme, (words, lines) in THEMES.items():
        file = f"{name}-{theme}.png"
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
            "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.unicode_minus": False,
        }
        with matplotlib.rc_context(style):
            figure = Figure(figsize=size, layout="constrained")
            draw(figure)
            figure.savefig(FOLDER / file, dpi=110, metadata={"Software": None})
        links += f"![{title}]({file}#only-{theme})\n"
    return links


def bars(axis: Axes, values: dict[str, list[str]]) -> None:
    """Root mean squares as bars from the top, and the values themselves as points, log scale."""
    y = -np.arange(len(values))
    for i, texts in enumerate(values.values()):
        numbers = abs(np.array(texts, float))
        rms = np.sqrt(np.mean(numbers**2))
        axis.barh(y[i], rms, color=COLOURS[i], alpha=0.55)
        axis.plot(numbers, np.full(numbers.size, y[i]), ".", color=COLOURS[i])
    axis.set_yticks(y, list(values))
    axis.set(xscale="log", xlim=(0.005, 50.0))
    axis.set_xticks([0.01, 0.1, 1.0, 10.0], ["0.01", "0.1", "1", "10"])


def table(rows: list[list[str]]) -> str:
    """Rows of texts as Markdown, the first of them the head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    numbers = len(rows[0]) - 1
    lines.insert(1, "| :-- |" + " --: |" * numbers)
    return "\n".join(lines)


def numbers_of(name: str) -> list[list[str]]:
    """The table of a script that the page has."""
    page = FOLDER.joinpath("index.md").read_text("utf-8")
    section = page.split(f"docs/gallery/{name}.py")[1].split("## ")[0]
    rows = []
    for line in section.splitlines():
        if line.startswith("    |"):
            cells = line.strip().strip("|").split("|")
            rows.append([cell.strip() for cell in cells])
    del rows[1]  # the rule below the head
    return rows
