"""``report.html``, a page a mission: no scripts, no network."""

import base64
import hashlib
import io
import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import jinja2
import numpy as np
from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from unbend.caches import parsed_templates
from unbend.report import cover, summary, words
from unbend.report.flown import QUANTITIES, Flown, track_of_camera, utc
from unbend.report.map_grid_lines import grid_lines
from unbend.report.summary import is_applied, next_steps, remarks, verdict
from unbend.tables.manifest.results import CameraShifts, Quantiles, ShiftField, SigmaRecord
from unbend.tables.manifest.whole import Manifest
from unbend.units import Array, round_step

Range = tuple[float, float]
_STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14_400, 21_600, 43_200)


class Axes:
    """``box`` is left, top, width, height [px]; ``x``, ``y`` limits; ``log_x`` to powers of ten."""

    def __init__(self, box: Sequence[float], x: Range, y: Range, *, log_x: bool = False) -> None:
        self.box, self.log_x = tuple(box), log_x
        if log_x:
            x = 10.0 ** math.floor(math.log10(x[0])), 10.0 ** math.ceil(math.log10(x[1]))
        self.x, self.y = (
            (low, high) if high != low else (low - 0.5, high + 0.5) for low, high in (x, y)
        )

    def at(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Pixels of places."""
        left, top, width, height = self.box
        share, (low, high) = np.asarray(x, np.float64), self.x
        if self.log_x:
            with np.errstate(divide="ignore", invalid="ignore"):
                share, low, high = np.log10(share), math.log10(low), math.log10(high)
        across = np.asarray((share - low) / (high - low))
        up = (np.asarray(y, np.float64) - self.y[0]) / (self.y[1] - self.y[0])
        return left + width * across, top + height * (1.0 - up)

    def place(self, x: float, y: float) -> tuple[float, float]:
        across, down = self.at(x, y)
        return round(float(across), 1), round(float(down), 1)

    def line(self, x: ArrayLike, y: ArrayLike, end: str = "") -> str:
        """A line through places (n,), with gaps; ``end`` Z to close it.

        >>> Axes((0, 0, 4, 4), (0, 4), (4, 0)).line([0, 1, np.nan, 3, 4], np.zeros(5))
        'M0.0 0.0L1.0 0.0M3.0 0.0L4.0 0.0'
        """
        words, pen = [], "M"
        for a, b in zip(*(column.tolist() for column in self.at(x, y)), strict=True):
            known = math.isfinite(a) and math.isfinite(b)
            if known:
                words.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L" if known else "M"
        return "".join(words) + (end if words else "")

    def marks(self, x: ArrayLike, y: ArrayLike, mark: str = "h0") -> str:
        """A mark at each known place (n,), drawn from there; a dot by default."""
        px, py = (np.atleast_1d(column) for column in self.at(x, y))
        good = np.isfinite(px) & np.isfinite(py)
        return "".join(f"M{a:.1f} {b:.1f}{mark}" for a, b in zip(px[good], py[good], strict=True))

    def areas(self, corners: Array) -> str:
        """Closed areas (m, k, 2) of x and y."""
        return "".join(self.line(area[:, 0], area[:, 1], "Z") for area in corners)

    def band(self, low: Array, high: Array, y: Array) -> str:
        """What lies between two curves (n,) against ``y``."""
        return self.line(np.concatenate([low, high[::-1]]), np.concatenate([y, y[::-1]]), "Z")

    def bars(self, first: float, step: float, counts: Sequence[float]) -> str:
        """A bar from zero for each count."""
        edges, zero = self.at(first + step * np.arange(len(counts) + 1.0), 0.0)
        _, tops = self.at(0.0, np.array(counts, np.float64))
        return "".join(
            f"M{a + 0.5:.1f} {zero:.1f}V{top:.1f}H{b - 0.5:.1f}V{zero:.1f}Z"
            for a, b, top in zip(edges[:-1], edges[1:], tops, strict=True)
            if top < zero
        )

    def ticks(self, of: Range, most: int, begin_ns: int | None = None) -> list[tuple[float, str]]:
        """Round values of an axis, texts; times of day of seconds after ``begin_ns`` [Unix ns].

        >>> Axes((0, 0, 1, 1), (0.13, 0.42), (0, 1)).ticks((0.13, 0.42), 4)
        [(0.2, '0.2'), (0.3, '0.3'), (0.4, '0.4')]
        """
        low, high = min(of), max(of)
        if begin_ns is not None:
            step = next((s for s in _STEPS_S if s >= (high - low) / most), 0)
            step = step or 86_400 * math.ceil((high - low) / most / 86_400)
            from_s = begin_ns * 1e-9 + low
            seconds = range(-(-int(from_s) // step) * step, int(from_s + high - low) + 1, step)
            cut = slice(5, 10) if step >= 86_400 else slice(11, 19 if step < 60 else 16)
            return [(s - begin_ns * 1e-9, str(np.datetime64(s, "s"))[cut]) for s in seconds]
        if self.log_x and of == self.x:
            powers = range(round(math.log10(low)), round(math.log10(high)) + 1)
            return [(10.0**p, f"{10.0**p:.12g}") for p in powers[:: -(-len(powers) // 7)]]
        width = round_step((high - low) / most)
        digits = max(0, -math.floor(math.log10(width)))
        numbers = range(math.ceil(low / width - 1e-9), math.floor(high / width + 1e-9) + 1)
        return [(round(n * width, digits), f"{n * width:,.{digits}f}") for n in numbers]


def arrows(x: ArrayLike, y: ArrayLike, dx: ArrayLike, dy: ArrayLike) -> str:
    """Arrows (n,) from pixels by pixels, each with a head of a third of its length."""
    words = []
    for a, b, u, v in zip(*(np.atleast_1d(c).tolist() for c in (x, y, dx, dy)), strict=True):
        back, side = 0.34, 0.2
        words.append(f"M{a:.1f} {b:.1f}l{u:.1f} {v:.1f}")
        for k in (1.0, -1.0):
            head = -back * u - k * side * v, -back * v + k * side * u
            words.append(f"l{head[0]:.1f} {head[1]:.1f}M{a + u:.1f} {b + v:.1f}")
    return "".join(words)


def field_arrows(axes: Axes, field: ShiftField) -> tuple[str, str, float]:
    """Arrows of a mean shift over an image, the longest 0.92 of a cell long; one for reference.

    Returns both paths, the second an arrow at the upper left, and the shift that it stands for
    [px], with one digit of 1, 2 or 5.
    """
    dx = np.array(field.dx_px)
    dy = np.array(field.dy_px)
    longest = float(np.hypot(dx, dy).max()) or 1.0
    scale = 0.92 * axes.box[2] / field.columns / longest
    reference = round_step(longest / 2.2)
    example = arrows(axes.box[0] + 44.0, axes.box[1] - 11.0, reference * scale, 0.0)
    x, y = axes.at(np.array(field.x_px), np.array(field.y_px))
    return arrows(x, y, dx * scale, dy * scale), example, reference


def map_axes(limits_deg: Sequence[float], width: float) -> tuple[Axes, float]:
    """Axes of west, east, south, north [deg] at equal scale, ``width`` wide, and metres across."""
    west, east, south, north = limits_deg
    shrink = max(math.cos(math.radians(0.5 * (south + north))), 0.01)
    inner = width - 72.0
    across = max(1.1 * (east - west) * shrink, 2e-4)
    down = max(1.1 * (north - south), 2e-4, 0.35 * across)
    across = max(across, down * inner / (0.9 * width))
    lon, lat = 0.5 * (west + east), 0.5 * (south + north)
    box = 62.0, 22.0, inner, round(inner * down / across, 1)
    half = 0.5 * across / shrink
    axes = Axes(box, (lon - half, lon + half), (lat - 0.5 * down, lat + 0.5 * down))
    return axes, across * 111_200.0


def light_png(light: Array) -> str:
    """Light (rows, columns) from -1 (shade) to 1 as greys, clear where unknown, as data URL."""
    from PIL import Image

    grey = np.stack([np.nan_to_num(140.0 + 80.0 * light), 120.0 * np.isfinite(light)], axis=2)
    buffer = io.BytesIO()
    Image.fromarray(grey.astype(np.uint8)).save(buffer, format="png")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


_MOST_CAMERAS = 8  # with figures of their own; the manifest has the others too
_DATA = files("unbend.report") / "data"


def write_report(path: Path, manifest: Manifest, flown: Flown) -> None:
    """Write the report of a run. The same manifest and flight give the same bytes."""
    path.write_text(report_page(manifest, flown), encoding="utf-8")


def report_page(manifest: Manifest, flown: Flown) -> str:
    """The report of a run as HTML."""
    results = manifest.results
    ledger: dict[str, list[tuple[str, str]]] = {}
    for kind, code, what in summary.ledger_rows(results.ledger):
        ledger.setdefault(kind, []).append((code, what))
    cameras = dict(list(results.correction.cameras.items())[:_MOST_CAMERAS])
    budget = {}
    for name, camera in cameras.items():
        if parts := results.sigma_budget.get(name):
            budget[name] = {"shift": size_of_shift(camera), **parts}
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
        relief=None if flown.relief is None else light_png(flown.relief[1]),
        suspects=[entry.what for entry in results.ledger if entry.code == "STATIONS-SUSPECT"],
        mission_file=json.dumps(manifest.run.config, indent=1, ensure_ascii=False),
    )


def size_of_shift(camera: CameraShifts) -> SigmaRecord:
    """Median and 95 % of a camera's correction, to stand beside its standard deviations."""
    pixels = camera.shift_px
    metres = camera.shift_ground_m
    return SigmaRecord(Quantiles(pixels.median, pixels.p95), Quantiles(metres.median, metres.p95))


class ParsedTemplates(FileSystemBytecodeCache):
    """Parsed templates in a folder; where it has gone meanwhile they are parsed again."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a parsed template."""
        with suppress(OSError):
            super().dump_bytecode(bucket)


@lru_cache(maxsize=1)
def environment() -> Environment:
    """Templates of the package; all that is no markup is escaped, unseen characters written out."""
    cache, folder = None, parsed_templates()
    code = [path.read_bytes() for path in sorted(Path(str(files("unbend.report"))).rglob("*.py"))]
    pattern = hashlib.sha256(repr([jinja2.__version__, code]).encode()).hexdigest() + "-%s.jinja"
    with suppress(OSError):  # nothing can be kept: templates are parsed again
        os.makedirs(folder, exist_ok=True)
        cache = ParsedTemplates(folder, pattern) if os.access(folder, os.W_OK) else None
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
        "shortened": words.shortened, "utc": utc, "with_sigma": words.with_sigma,
        "css_text": lambda text: Markup(cover.css_text(words.visible(text))),
    }  # fmt: skip
    made.globals |= {
        "Axes": Axes, "arrows": arrows, "field_arrows": field_arrows, "map_axes": map_axes,
        "grid_lines": grid_lines, "track_of_camera": track_of_camera,
        "count": words.count, "round_step": round_step, "quantities": QUANTITIES,
        "summary": summary, "is_applied": is_applied, "verdict": verdict, "remarks": remarks,
        "next_steps": next_steps,
        "texts": summary.report_texts(),
        "style": Markup((_DATA / "report.css").read_text("utf-8")),
    }  # fmt: skip
    return made


def _code(text: str) -> Markup:
    """A text whose parts in backticks are what a computer reads."""
    parts = str(escape(words.visible(text))).split("`")
    return Markup("".join(f"<code>{p}</code>" if i % 2 else p for i, p in enumerate(parts)))
