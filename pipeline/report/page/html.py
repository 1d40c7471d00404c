"""``report.html``: one page a mission, without scripts and without anything from a network."""

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

from pipeline.caches import parsed_templates
from pipeline.report import summary, words
from pipeline.report.flown import QUANTITIES, Flown, utc
from pipeline.report.page.svg import Axes, arrows, field_arrows, light_png, map_axes
from pipeline.report.verdict import is_applied, next_steps, remarks, verdict
from pipeline.units import round_step

_MOST_CAMERAS = 8  # with figures of their own; the manifest has the others too
_DATA = files("pipeline.report.page") / "data"


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
