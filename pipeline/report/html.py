"""``report.html``: one page a mission, and ``campaign.html``: all missions, one row each.

Without scripts and without anything from a network.
"""

import hashlib
import json
import os
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pyarrow as pa
from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

from pipeline.caches import parsed_templates
from pipeline.report import summary, words
from pipeline.report.flown import QUANTITIES, Flown, utc
from pipeline.report.summary import is_applied, next_steps, remarks, verdict
from pipeline.report.svg import Axes, arrows, field_arrows, light_png, map_axes
from pipeline.tables.schemas import columns_of, schema_of
from pipeline.units import round_step

_MOST_CAMERAS = 8  # with figures of their own; the manifest has the others too
_DATA = files("pipeline.report") / "data"


def write_report(path: Path, manifest: Mapping[str, Any], flown: Flown) -> None:
    """Write the report of a run. The same manifest and flight give the same bytes."""
    path.write_text(report_page(manifest, flown), encoding="utf-8")


def report_page(manifest: Mapping[str, Any], flown: Flown) -> str:
    """The page as HTML."""
    ledger: dict[str, list[tuple[str, str]]] = {}
    for kind, code, what in summary.ledger_rows(manifest["ledger"]):
        ledger.setdefault(kind, []).append((code, what))
    cameras = dict(list(manifest["correction"]["cameras"].items())[:_MOST_CAMERAS])
    budget = {
        name: {"shift": {"px": camera["shift_px"], "m": camera["shift_ground_m"]}} | parts
        for name, camera in cameras.items()
        if (parts := manifest["sigma_budget"].get(name))
    }
    page = environment().get_template("report.html.j2")
    return page.render(
        manifest=manifest,
        flown=flown,
        few={name: camera for name, camera in cameras.items() if camera["shift_px"]["count"]},
        budget=budget,
        ledger=ledger,
        relief=None if flown.relief is None else light_png(flown.relief[1]),
        suspects=[e["what"] for e in manifest["ledger"] if e["code"] == "STATIONS-SUSPECT"],
        config=json.dumps(manifest["config"], indent=1, ensure_ascii=False),
    )


@lru_cache(maxsize=1)
def environment() -> Environment:
    """Templates of the package; all that is no markup is escaped, unseen characters written out."""
    cache, folder = None, parsed_templates()
    code = [path.read_bytes() for path in sorted(Path(str(files("pipeline.report"))).rglob("*.py"))]
    pattern = hashlib.sha256(repr([jinja2.__version__, code]).encode()).hexdigest() + "-%s.jinja"
    with suppress(OSError):  # nothing can be kept: templates are parsed again
        os.makedirs(folder, exist_ok=True)
        cache = FileSystemBytecodeCache(folder, pattern) if os.access(folder, os.W_OK) else None
    made = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
        bytecode_cache=cache,
        loader=FunctionLoader(lambda name: (_DATA / name).read_text("utf-8")),
        finalize=lambda value: value if isinstance(value, Markup) else words.visible(str(value)),
    )
    made.filters |= {
        "size": len, "code": _code, "metres": words.length, "pixels": words.pixels,
        "shortened": words.shortened, "utc": utc,
    }  # fmt: skip
    made.globals |= {
        "Axes": Axes, "arrows": arrows, "field_arrows": field_arrows, "map_axes": map_axes,
        "count": words.count, "round_step": round_step, "quantities": QUANTITIES,
        "summary": summary, "is_applied": is_applied, "verdict": verdict, "remarks": remarks,
        "next_steps": next_steps,
        "texts": tomllib.loads((_DATA / "report.toml").read_text("utf-8")),
        "style": Markup((_DATA / "report.css").read_text("utf-8")),
    }  # fmt: skip
    return made


def _code(text: str) -> Markup:
    """A text whose parts in backticks are what a computer reads."""
    parts = str(escape(words.visible(text))).split("`")
    return Markup("".join(f"<code>{p}</code>" if i % 2 else p for i, p in enumerate(parts)))


COLUMNS = columns_of("campaign")
DONE, WITH_LOSSES = "done", "done with losses or findings"


def row_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a mission that is done, by the names of the columns of ``campaign.parquet``."""
    flight, correction = manifest["flight"], manifest["correction"]
    rows, kinds = manifest["observations"], Counter(e["kind"] for e in manifest["ledger"])
    sigma = [of["all"] for of in manifest["sigma_budget"].values() if "all" in of]
    row = dict.fromkeys(COLUMNS) | {
        "mission": manifest["mission"],
        "state": WITH_LOSSES if manifest["exit_code"] else DONE,
        "exit_code": manifest["exit_code"],
        "what": verdict(manifest),
        "begin_utc": flight["begin_utc"],
        "end_utc": flight["end_utc"],
        "exposures": sum(manifest["stations"].values()),
        "observations": rows["rows"],
        "corrected": correction["shift_px"]["count"],
        "fingerprint": manifest["fingerprint"],
    }
    for name, of in (("lat_deg", "latitude_deg"), ("lon_deg", "longitude_deg"),
                     ("h_msl_m", "h_msl_m")):  # fmt: skip
        if flight[of]:
            row[name] = flight[of][1]
    for unit, of in (("px", "shift_px"), ("m", "shift_ground_m")):
        for part in ("median", "maximum"):
            row[f"shift_{part}_{unit}"] = correction[of][part]
        medians = [camera[unit]["median"] for camera in sigma]
        row[f"sigma_{unit}"] = max((m for m in medians if m is not None), default=None)
    return row | {f"{kind}s" if kind != "loss" else "losses": kinds[kind]
                  for kind in ("loss", "finding", "warning")}  # fmt: skip


def row_without(name: str, exit_code: int | None, code: str, what: str) -> dict[str, Any]:
    """The row of a mission that has no results: refused, or not run yet (no exit code)."""
    state = "refused" if exit_code is not None else "not run"
    own = {"mission": name, "state": state, "exit_code": exit_code, "code": code or None}
    return dict.fromkeys(COLUMNS) | own | {"what": what}


def campaign_table(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """The rows as a table, with units and meanings."""
    values = [
        {k: datetime.fromisoformat(v) if v and k.endswith("_utc") else v for k, v in row.items()}
        for row in rows
    ]
    return pa.Table.from_pylist(values, schema_of(COLUMNS, {"unbend.campaign": name}))


def campaign_page(name: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The page as HTML; the same rows give the same bytes."""
    placed = [row for row in rows if row["lat_deg"] is not None]
    # Longitudes in the turn of the first, so that a campaign at 180 degrees is one place.
    turn = placed[0]["lon_deg"] if placed else 0.0
    lon = np.array([(row["lon_deg"] - turn + 180.0) % 360.0 - 180.0 + turn for row in placed])
    lat = np.array([row["lat_deg"] for row in placed])
    state = np.array([row["state"] for row in placed])
    page = environment().get_template("campaign.html.j2")
    return page.render(
        name=name,
        rows=rows,
        states=Counter(row["state"] for row in rows),
        places={s: (lon[state == s], lat[state == s]) for s in (DONE, WITH_LOSSES)},
        limits=(lon.min(), lon.max(), lat.min(), lat.max()) if placed else None,
    )
