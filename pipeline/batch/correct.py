"""The one large stream: observations in, corrected observations out, a batch at a time.

Batches are independent of each other: while one is read, others are corrected and written, each to
a part of its own. What a part holds does not depend on how many are under way.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.batch.store import RunFolder
from pipeline.ledger import Ledger
from pipeline.refraction.camera import Camera
from pipeline.refraction.chord import target_heights
from pipeline.refraction.forward import apply_refraction
from pipeline.refraction.image import Corrections, Exposures, correct_observations
from pipeline.refraction.ray import PublishedRays, RayTable
from pipeline.refraction.spread import SPREADS, Extent, ImageGrid, Spread
from pipeline.refraction.status import NO_STATION, STATUS_NAMES
from pipeline.tables.marks import Direction
from pipeline.tables.observations import Batch, Observations
from pipeline.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of
from pipeline.tables.writing import observation_table, write_parquet

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """One camera: its interior orientation, and what takes the user's pixels to COLMAP's."""

    camera: Camera
    pixel_offset: float


LOWEST_GROUND_M, HIGHEST_GROUND_M = -600.0, 10_000.0
"""Ground heights outside this are no ground heights [m]."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights of the points above sea level: a constant, or a column plus what makes it so.

    ``offset_m`` (s,) is added per station: minus the undulation for ellipsoidal heights, the
    take-off height for relative ones. ``from_distance`` where they follow from the slant ranges.
    """

    constant_m: float | None
    offset_m: Array
    from_distance: bool = False

    def heights(self, batch: Batch, row: NDArray[np.int64]) -> Array:
        """(n,) heights above sea level [m] of the points of a batch."""
        if batch.ground is not None:
            given = batch.ground
        else:
            given = np.full(len(batch), self.constant_m, dtype=np.float64)
        given = plausible(given)
        offset = np.append(self.offset_m, np.nan)[row]
        # Without a station there is nothing to reduce with; the status says no_station anyway.
        return np.asarray(given + np.where(row < 0, 0.0, offset))


def plausible(height_m: Array) -> Array:
    """Heights [m] with NaN for those of no ground."""
    sound = (height_m >= LOWEST_GROUND_M) & (height_m <= HIGHEST_GROUND_M)
    return np.where(sound, height_m, np.nan)


@dataclass(frozen=True, eq=False)
class Recipe:
    """All that turns a batch of observations into corrections.

    ``images`` and ``cameras_of`` (s,) belong to the rows of ``exposures``.
    """

    images: NDArray[np.object_]
    cameras_of: NDArray[np.object_]
    exposures: Exposures
    ground: Ground
    cameras: Mapping[str, CameraSetup]
    table: RayTable | PublishedRays
    direction: Direction = "remove"


@dataclass
class Tally:
    """What the stream amounted to: counts, and how large the correction was in each camera."""

    extents: dict[str, Extent]
    rows: int = 0
    parts: int = 0
    status: dict[str, int] = field(default_factory=dict)
    no_distance: int = 0

    @classmethod
    def of(cls, cameras: Mapping[str, CameraSetup]) -> Tally:
        """Nothing yet."""
        grids = {n: ImageGrid(s.camera.width_px, s.camera.height_px) for n, s in cameras.items()}
        return cls({name: Extent(grid) for name, grid in grids.items()})

    def add(self, batch: Batch, corrections: Corrections, camera: NDArray[np.int64]) -> None:
        """Count a batch; ``camera`` (n,) numbers the cameras, -1 without one."""
        self.rows += len(batch)
        self.no_distance += batch.no_distance
        self.parts += 1
        counts = np.bincount(corrections.status, minlength=len(STATUS_NAMES))
        for name, count in zip(STATUS_NAMES, counts.tolist(), strict=True):
            self.status[name] = self.status.get(name, 0) + int(count)
        for number, extent in enumerate(self.extents.values()):
            mine = camera == number
            if bool(mine.all()):
                extent.add(batch.x_px, batch.y_px, corrections)
            elif bool(mine.any()):
                extent.add(batch.x_px[mine], batch.y_px[mine], corrections.rows(mine))

    def merge(self, other: Tally) -> None:
        """Count what another counted."""
        self.rows += other.rows
        self.no_distance += other.no_distance
        self.parts += other.parts
        for name, count in other.status.items():
            self.status[name] = self.status.get(name, 0) + count
        for name, extent in other.extents.items():
            self.extents[name].merge(extent)

    def correction(self) -> dict[str, Any]:
        """How large the correction was, over all and camera by camera, for the manifest."""
        together = {
            name: sum((e.spreads()[name] for e in self.extents.values()), Spread()).summary()
            for name in SPREADS
        }
        return together | {"cameras": {n: e.summary() for n, e in self.extents.items()}}

    def report_flagged(self, ledger: Ledger) -> None:
        """A line in the ledger for each reason why observations were not corrected."""
        if self.no_distance:
            ledger.warning(
                "OBS-DISTANCE",
                f"{self.no_distance} slant ranges are zero, negative, infinite or no number: taken "
                "as absent",
                where="observations.columns.distance_m",
                count=self.no_distance,
            )
        for name, count in self.status.items():
            what = f"{count} of {self.rows} observations are {name}"
            if name == "ok" or count == 0:
                continue
            if name == "beyond_grazing":
                ledger.loss("OBS-BEYOND-GRAZING", what + ": near branch used", count=count)
            elif name == "far_branch":
                ledger.note("OBS-FAR-BRANCH", what + ", by their slant range", count=count)
            else:
                ledger.loss("OBS-FLAGGED", what, count=count)


def correct_stream(
    observations: Observations,
    recipe: Recipe,
    folder: RunFolder,
    batch_rows: int,
    metadata: Mapping[str, str],
    progress: Callable[[int], None],
) -> Tally:
    """Correct all observations and write them as ``observations/part-*.parquet``.

    Memory holds a few batches, whatever the number of rows. ``progress`` hears of every batch's
    rows.
    """
    columns = OBSERVATION_COLUMNS if recipe.direction == "remove" else DISPLACED_COLUMNS
    schema = schema_of(columns, metadata, list(observations.user_fields))
    names = pa.array(recipe.images, pa.string())
    number_of = {name: number for number, name in enumerate(recipe.cameras)}
    # An image that no exposure was found for has a station without a camera; the last entry is
    # for observations without a station.
    camera_of = np.array([number_of.get(n, -1) for n in recipe.cameras_of] + [-1], np.int64)

    def one(number: int, batch: Batch) -> Tally:
        row = _station_rows(batch.image, names)
        camera = camera_of[row]
        h_g = _heights(batch, row, camera, recipe)
        corrections = _correct_batch(batch, row, h_g, camera, recipe)
        name = f"observations/part-{number:05d}.parquet"
        write_parquet(observation_table(batch, corrections, h_g, schema), folder.place(name))
        folder.seal(name)
        tally = Tally.of(recipe.cameras)
        tally.add(batch, corrections, camera)
        return tally

    total = Tally.of(recipe.cameras)
    for part in _overlapped(one, observations.batches(batch_rows)):
        total.merge(part)
        progress(part.rows)
    return total


def _overlapped(one: Callable[[int, Batch], Tally], batches: Iterator[Batch]) -> Iterator[Tally]:
    """Results for numbered batches, in their order; as many at a time as there are cores."""
    workers = os.cpu_count() or 1
    waiting: deque[Future[Tally]] = deque()
    with ThreadPoolExecutor(workers, thread_name_prefix="batch") as pool:
        try:
            for number, batch in enumerate(batches):
                waiting.append(pool.submit(one, number, batch))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _station_rows(image: pa.StringArray, names: pa.StringArray) -> NDArray[np.int64]:
    """(n,) the station of each observation, -1 without one."""
    encoded = image.dictionary_encode()
    station = pc.fill_null(pc.index_in(encoded.dictionary, value_set=names), -1)
    by_code = np.append(station.to_numpy(zero_copy_only=False).astype(np.int64), -1)
    codes = pc.fill_null(encoded.indices, len(by_code) - 1).to_numpy(zero_copy_only=False)
    return np.asarray(by_code[codes])


def _heights(
    batch: Batch, row: NDArray[np.int64], camera: NDArray[np.int64], recipe: Recipe
) -> Array:
    """(n,) heights of the points above sea level [m], NaN where there is none."""
    h_g = recipe.ground.heights(batch, row)
    if recipe.ground.from_distance and batch.distance_m is not None:
        for number, setup in enumerate(recipe.cameras.values()):
            mine = np.flatnonzero(camera == number)
            h_g[mine] = target_heights(
                batch.x_px[mine] + setup.pixel_offset,
                batch.y_px[mine] + setup.pixel_offset,
                batch.distance_m[mine],
                row[mine],
                recipe.exposures,
                setup.camera,
                recipe.table,
                ideal=recipe.direction == "apply",
            )
        h_g = plausible(h_g)
    return h_g


def _correct_batch(
    batch: Batch, row: NDArray[np.int64], h_g: Array, camera: NDArray[np.int64], recipe: Recipe
) -> Corrections:
    """The corrections of a batch, camera by camera, back in the order of the rows."""
    parts = []
    for number, setup in enumerate(recipe.cameras.values()):
        mine = np.flatnonzero(camera == number)
        if mine.size == len(batch):
            return _correct_rows(batch, slice(None), row, h_g, setup, recipe)
        if mine.size:
            parts.append((mine, _correct_rows(batch, mine, row, h_g, setup, recipe)))
    columns: dict[str, Any] = {
        name: np.full(len(batch), np.nan) for name in Corrections.__dataclass_fields__
    }
    columns["status"] = np.full(len(batch), NO_STATION, np.uint8)
    for mine, part in parts:
        for name, column in columns.items():
            column[mine] = getattr(part, name)
    return Corrections(**columns)


def _correct_rows(
    batch: Batch,
    mine: NDArray[np.intp] | slice,
    row: NDArray[np.int64],
    h_g: Array,
    setup: CameraSetup,
    recipe: Recipe,
) -> Corrections:
    """The corrections of the rows of one camera, in the user's pixels."""
    way = correct_observations if recipe.direction == "remove" else apply_refraction
    found = way(
        batch.x_px[mine] + setup.pixel_offset,
        batch.y_px[mine] + setup.pixel_offset,
        h_g[mine],
        row[mine],
        recipe.exposures,
        setup.camera,
        recipe.table,
        distance_m=None if batch.distance_m is None else batch.distance_m[mine],
    )
    if setup.pixel_offset == 0.0:
        return found
    return replace(
        found, x_px=found.x_px - setup.pixel_offset, y_px=found.y_px - setup.pixel_offset
    )
