"""How values show themselves where a person works with them: lines, HTML tables, and axes.

pandas and matplotlib are imported when something is shown, not before.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from unbend.messages import matplotlib_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_OF_AXES = 3.2  # [inch]
HEIGHT_OF_AXES = 4.0  # [inch]


def html_table(title: str, columns: Mapping[str, Any]) -> str:
    """A title and a table as HTML; of a long table the first and the last five rows are shown."""
    import pandas as pd

    table = pd.DataFrame(dict(columns))
    return f"<p>{escape(title)}</p>{table.to_html(index=False, max_rows=10)}"


def new_axes(count: int) -> list[Axes]:
    """``count`` axes side by side in a new figure, with a common vertical axis.

    Refuses (PLOT-MATPLOTLIB) if matplotlib is not installed.
    """
    try:
        from matplotlib.pyplot import subplots
    except ImportError:
        raise matplotlib_missing() from None
    size = (WIDTH_OF_AXES * count, HEIGHT_OF_AXES)
    _, axes = subplots(1, count, sharey=True, squeeze=False, figsize=size, layout="constrained")
    return list(axes.ravel())
