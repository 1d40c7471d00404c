"""``report.html``, the page of a mission, without scripts and without access to a network."""

import base64
import hashlib
import io
import json
import os
from contextlib import suppress
from functools import lru_cache
from importlib.resources import files
from itertools import islice
from pathlib import Path

import jinja2
import numpy as np
from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup, escape

from unbend.caches import parsed_templates_folder
from unbend.report import cover, summary, words
from unbend.report.air_curves import QUANTITIES
from unbend.report.figure_data import Flown, track_of_camera, utc
from unbend.report.map_grid_lines import grid_lines
from unbend.report.summary import is_applied, next_steps, remarks, verdict
from unbend.report.svg_axes import Axes, arrows, field_arrows, map_axes
from unbend.tables.manifest.results import CameraShifts, Quantiles, SigmaRecord
from unbend.tables.manifest.whole import Manifest
from unbend.units import Array, round_step

MAX_CAMERAS = 8  # with separate figures; further cameras are only in the manifest

DATA = files("unbend.report") / "data"

# Of the relief, from 0 to 255.
LIGHT_GREY = 140.0  # of level ground
LIGHT_CONTRAST = 80.0  # between level ground and the brightest slope
LIGHT_OPACITY = 120.0  # map lines below it stay visible


def light_png(light: Array) -> str:
    """Light (rows, columns) from -1 (shade) to 1 as a PNG of greys, in a data URL.

    Pixels with NaN are transparent.
    """
    from PIL import Image

    grey = np.nan_to_num(LIGHT_GREY + LIGHT_CONTRAST * light)
    opacity = LIGHT_OPACITY * np.isfinite(light)
    pixels = np.stack([grey, opacity], axis=2).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="png")
    png = base64.b64encode(buffer.getvalue()).decode()
    return f"data:image/png;base64,{png}"


def write_report(path: Path, manifest: Manifest, flown: Flown) -> None:
    """Write the report of a run to a file. The same manifest and flight give the same bytes."""
    path.write_text(report_page(manifest, flown), encoding="utf-8")


def report_page(manifest: Manifest, flown: Flown) -> str:
    """The report of a run as HTML."""
    results = manifest.results
    ledger: dict[str, list[tuple[str, str]]] = {}
    for kind, code, text in summary.ledger_rows(results.ledger):
        ledger.setdefault(kind, []).append((code, text))
    cameras = dict(islice(results.correction.cameras.items(), MAX_CAMERAS))
    budget = {}
    for name, camera in cameras.items():
        parts = results.sigma_budget.get(name)
        if parts:
            budget[name] = {"shift": quantiles_of_shift(camera), **parts}
    relief = None
    if flown.relief is not None:
        _, light = flown.relief
        relief = light_png(light)
    page = environment().get_template("report.html.j2")
    return page.render(
        manifest=manifest,
        run=manifest.run,
        results=results,
        config=manifest.run.config,
        title=cover.title_of(manifest),
        cover_rows=cover.cover_rows(manifest, flown),
        cover_remarks=cover.paragraphs(manifest.sections.mission.remarks),
        processed=Markup(cover.PROCESSED),
        client=manifest.sections.mission.client or "",
        flown=flown,
        few={name: camera for name, camera in cameras.items() if camera.shift_px.count},
        budget=budget,
        ledger=ledger,
        relief=relief,
        suspects=[entry.what for entry in results.ledger if entry.code == "STATIONS-SUSPECT"],
        mission_file=json.dumps(manifest.run.config, indent=1, ensure_ascii=False),
    )


def quantiles_of_shift(camera: CameraShifts) -> SigmaRecord:
    """Median and 95 % of a camera's correction, as a row of the table of standard deviations."""
    pixels = camera.shift_px
    metres = camera.shift_ground_m
    return SigmaRecord(Quantiles(pixels.median, pixels.p95), Quantiles(metres.median, metres.p95))


class ParsedTemplates(FileSystemBytecodeCache):
    """A cache of parsed templates in a folder; without effect if the folder was deleted."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Write a parsed template to the folder, if that is possible."""
        with suppress(OSError):
            super().dump_bytecode(bucket)


@lru_cache(maxsize=1)
def environment() -> Environment:
    """The jinja environment of the package's templates, with their filters and globals.

    Values are escaped for HTML, and invisible characters are replaced by escapes.
    """
    templates = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
        bytecode_cache=template_cache(),
        loader=FunctionLoader(lambda name: (DATA / name).read_text("utf-8")),
        finalize=shown_value,
    )
    templates.filters |= {
        "size": len,
        "code": marked_code,
        "metres": words.length,
        "pixels": words.pixels,
        "shortened": words.shortened,
        "utc": utc,
        "with_sigma": words.with_sigma,
        "css_text": css_text,
    }
    templates.globals |= {
        "Axes": Axes,
        "arrows": arrows,
        "field_arrows": field_arrows,
        "map_axes": map_axes,
        "grid_lines": grid_lines,
        "track_of_camera": track_of_camera,
        "count": words.count,
        "round_step": round_step,
        "quantities": QUANTITIES,
        "summary": summary,
        "is_applied": is_applied,
        "verdict": verdict,
        "remarks": remarks,
        "next_steps": next_steps,
        "texts": summary.report_texts(),
        "style": Markup((DATA / "report.css").read_text("utf-8")),
    }
    return templates


def template_cache() -> ParsedTemplates | None:
    """The cache of templates parsed for the present code; None if its folder cannot be written."""
    folder = parsed_templates_folder()
    code = [path.read_bytes() for path in sorted(Path(str(files("unbend.report"))).rglob("*.py"))]
    version = hashlib.sha256(repr([jinja2.__version__, code]).encode()).hexdigest()
    with suppress(OSError):
        os.makedirs(folder, exist_ok=True)
        if os.access(folder, os.W_OK):
            return ParsedTemplates(folder, f"{version}-%s.jinja")
    return None


def shown_value(value: object) -> object:
    """A value as a text for a template, with invisible characters escaped; markup is unchanged."""
    if isinstance(value, Markup):
        return value
    return words.visible(str(value))


def css_text(text: str) -> Markup:
    """A text as a string literal of a style sheet, safe within HTML."""
    return Markup(cover.css_text(words.visible(text)))


def marked_code(text: str) -> Markup:
    """A text as markup, with its parts in backticks as code."""
    parts = str(escape(words.visible(text))).split("`")
    for number in range(1, len(parts), 2):  # every second part is between backticks
        parts[number] = f"<code>{parts[number]}</code>"
    return Markup("".join(parts))
