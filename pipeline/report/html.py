"""``report.html``: how large the correction was, the air, the ledger and the inputs of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.statistics import ShiftGrid
from pipeline.report import summary
from pipeline.report.figures import as_svg, correction_figure, profile_figure
from pipeline.report.verdict import is_applied, next_steps, verdict

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #0f172a; max-width: 52rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
table { border-collapse: collapse; } td, th { padding: .2rem .9rem .2rem 0; text-align: left;
       vertical-align: top; border-bottom: 1px solid #e2e8f0; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
svg { max-width: 100%; height: auto; } .lead { font-size: 1.05rem; }
.finding, .loss { color: #b91c1c; } .warning { color: #b45309; } .fallback { color: #1d4ed8; }
.note { color: #475569; } code { font-size: .9em; }
"""

_MOST_CONTROL = 200


def write_report(
    path: Path,
    manifest: Mapping[str, Any],
    air: FlightAir,
    samples: AirSamples,
    grids: Mapping[str, ShiftGrid],
) -> None:
    """Write the report of a run, a page without scripts or external files."""
    title = escape(str(manifest["mission"]))
    change, left = (
        ("displacement", "What is not applied")
        if is_applied(manifest)
        else ("correction", "What is not removed")
    )
    control = summary.control_sentence(manifest)
    lines = summary.effect_lines(manifest["profile"]["effect"], manifest["profile"]["standard"])
    channels = ", ".join(
        f"{role.replace('_', ' ')} from {name}" for role, name in manifest["channels"].items()
    )
    ledger = "".join(
        f'<tr class="{kind}"><td>{kind}</td><td><code>{escape(code)}</code></td>'
        f"<td>{escape(what)}</td></tr>"
        for kind, code, what in summary.ledger_rows(manifest["ledger"])
    )
    sections = [
        f"<h1>{title}</h1>",
        f'<p class="lead">{escape(verdict(manifest))}</p>',
        _list("<h2>What to do next</h2>", next_steps(manifest)),
        f"<h2>How large the {change} is</h2>",
        _table(summary.CORRECTION_HEAD, summary.correction_rows(manifest), numeric=True),
        as_svg(correction_figure(grids)),
        f"<h2>Control points</h2><p>{escape(control)}</p>" if control else "",
        _table(summary.CONTROL_HEAD, summary.control_rows(manifest, _MOST_CONTROL), numeric=True),
        "<h2>The air</h2>",
        *(f"<p>{escape(line)}</p>" for line in (summary.air_sentences(manifest), *lines)),
        as_svg(profile_figure(air, samples)),
        _table(summary.SOURCE_HEAD, summary.source_rows(manifest), numeric=True),
        _list("<p>Not used:</p>", summary.unused_sources(manifest)),
        _table(summary.SENSOR_HEAD, summary.sensor_rows(manifest), numeric=True),
        "<h2>What became of the rows</h2>",
        _table(("observations", ""), _counts(manifest["observations"]["status"]), numeric=True),
        _table(("stations", ""), _counts(manifest["stations"]), numeric=True),
        "<h2>Ledger</h2>",
        f"<table>{ledger}</table>" if ledger else "<p>Nothing.</p>",
        _list(f"<h2>{left}</h2>", summary.not_included(manifest)),
        "<h2>Inputs</h2>",
        _table(
            ("", "file", "SHA-256"),
            [(i["role"], i["name"], i["sha256"][:16] + "…") for i in manifest["inputs"]],
        ),
        f"<p>Channels: {escape(channels)}</p>",
    ]
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width">'
        f"<title>unbend: {title}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(section for section in sections if section)
        + "\n</body></html>\n"
    )
    path.write_text(page, encoding="utf-8")


def _counts(counts: Mapping[str, int]) -> list[tuple[str, str]]:
    return [(name, f"{count:,}") for name, count in counts.items() if count]


def _list(title: str, lines: Sequence[str]) -> str:
    """A title and a list under it; nothing if there are no lines."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"{title}\n<ul>{items}</ul>" if items else ""


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, numeric: bool = False) -> str:
    """A table; nothing if there are no rows. ``numeric``: all columns but the first."""

    def cells(row: tuple[str, ...], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=n' if numeric and i else ''}>{escape(cell)}</{tag}>"
            for i, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<table><tr>{cells(head, 'th')}</tr>{body}</table>" if body else ""
