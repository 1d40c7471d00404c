"""``report.html``: one page that says what was done and how large it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.refraction.effect import FlightAir
from pipeline.refraction.spread import ImageGrid
from pipeline.report.figures import as_svg, correction_figure, profile_figure
from pipeline.report.summary import (
    CORRECTION_HEAD,
    SENSOR_HEAD,
    SOURCE_HEAD,
    correction_rows,
    effect_lines,
    headline,
    is_applied,
    ledger_rows,
    not_included,
    sensor_rows,
    source_rows,
    unused_sources,
    where_from,
)

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #0f172a; max-width: 52rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
table { border-collapse: collapse; } td, th { padding: .2rem .9rem .2rem 0; text-align: left;
       vertical-align: top; border-bottom: 1px solid #e2e8f0; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
svg { max-width: 100%; height: auto; } .lead { font-size: 1.05rem; }
.loss { color: #b91c1c; } .warning { color: #b45309; } .fallback { color: #1d4ed8; }
.note { color: #475569; } code { font-size: .9em; }
"""


def write_report(
    path: Path,
    manifest: Mapping[str, Any],
    air: FlightAir,
    samples: AirSamples,
    grids: Mapping[str, ImageGrid],
) -> None:
    """Write the report of a run; it needs no network and no script."""
    title = escape(str(manifest["mission"]))
    change, left = (
        ("displacement", "What is not applied")
        if is_applied(manifest)
        else ("correction", "What is not removed")
    )
    stays = "".join(f"<li>{escape(line)}</li>" for line in not_included(manifest))
    sections = [
        f"<h1>{title}</h1>",
        f'<p class="lead">{escape(headline(manifest))}</p>',
        f"<h2>How large the {change} is</h2>",
        _table(CORRECTION_HEAD, correction_rows(manifest), numeric=True),
        as_svg(correction_figure(grids)),
        "<h2>The air</h2>",
        f"<p>{escape(where_from(manifest))}</p>",
        *(f"<p>{escape(line)}</p>" for line in _effects(manifest)),
        as_svg(profile_figure(air, samples)),
        *_sources(manifest),
        "<h2>What became of the rows</h2>",
        _table(("observations", ""), _counts(manifest["observations"]["status"]), numeric=True),
        _table(("stations", ""), _counts(manifest["stations"]), numeric=True),
        "<h2>Ledger</h2>",
        _ledger(manifest),
        f"<h2>{left}</h2>\n<ul>{stays}</ul>" if stays else "",
        "<h2>Inputs</h2>",
        _table(
            ("", "file", "SHA-256"),
            [(i["role"], i["name"], i["sha256"][:16] + "…") for i in manifest["inputs"]],
        ),
        f"<p>Channels: {escape(_channels(manifest))}</p>",
    ]
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width">'
        f"<title>unbend: {title}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(sections)
        + "\n</body></html>\n"
    )
    path.write_text(page, encoding="utf-8")


def _effects(manifest: Mapping[str, Any]) -> list[str]:
    profile = manifest["profile"]
    return effect_lines(profile["effect"], profile["standard"])


def _sources(manifest: Mapping[str, Any]) -> list[str]:
    """What the air was made from, what was not used, and what is wrong with the sensors."""
    parts = []
    if rows := source_rows(manifest):
        parts.append(_table(SOURCE_HEAD, rows, numeric=True))
    if unused := unused_sources(manifest):
        items = "".join(f"<li>{escape(line)}</li>" for line in unused)
        parts.append(f"<p>Not used:</p>\n<ul>{items}</ul>")
    if sensors := sensor_rows(manifest):
        parts.append(_table(SENSOR_HEAD, sensors, numeric=True))
    return parts


def _counts(counts: Mapping[str, int]) -> list[tuple[str, str]]:
    return [(name, f"{count:,}") for name, count in counts.items() if count]


def _channels(manifest: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{role.replace('_', ' ')} from {name}" for role, name in manifest["channels"].items()
    )


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, numeric: bool = False) -> str:
    def cells(row: tuple[str, ...], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=n' if numeric and i else ''}>{escape(cell)}</{tag}>"
            for i, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<table><tr>{cells(head, 'th')}</tr>{body}</table>"


def _ledger(manifest: Mapping[str, Any]) -> str:
    rows = "".join(
        f'<tr class="{kind}"><td>{kind}</td><td><code>{escape(code)}</code></td>'
        f"<td>{escape(what)}</td></tr>"
        for kind, code, what in ledger_rows(manifest)
    )
    return f"<table>{rows}</table>" if rows else "<p>Nothing.</p>"
