"""The one large stream: observations in, corrected observations out, a batch at a time.

Batches are independent of each other: while one is read, others are corrected and written, each to
a part of its own. What a part holds does not depend on how many are under way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.batch.store import RunFolder
from pipeline.interrupts import held_back
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.chord import target_heights
from pipeline.refraction.forward import apply_refraction
from pipeline.refraction.image import COLUMNS, Corrections, Exposures, correct_observations
from pipeline.refraction.kernels.threads import usable_cpus
from pipeline.refraction.ray import PublishedRays, RayTable
from pipeline.refraction.status import NO_STATION
from pipeline.refraction.uncertainty.budget import at_the_window
from pipeline.refraction.uncertainty.sigmas import Sigmas, Uncertainty
from pipeline.stages.ground import Ground, plausible
from pipeline.stages.statistics import Tally, evenly
from pipeline.tables.marks import Direction
from pipeline.tables.observations import Batch, Observations
from pipeline.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of
from pipeline.tables.writing import observation_table, write_parquet

Array = NDArray[np.float64]

# Reading and writing leave no work for more, and each holds a batch: 250,000 rows by default.
_MOST_WORKERS = 4

_RAYS_OF_A_PART = 128


@dataclass(frozen=True, eq=False)
class Recipe:
    """All that turns a batch of observations into corrections.

    ``images``, ``cameras_of`` and ``air_of`` (s,) belong to the rows of ``exposures``; ``air_of``
    numbers ``tables``, the air in which the rays of an exposure bend, and ``uncertainties``; where
    all of these are None no standard deviations are computed. ``views`` (s,) tells through what
    each exposure looks.
    """

    images: NDArray[np.object_]
    cameras_of: NDArray[np.object_]
    exposures: Exposures
    ground: Ground
    cameras: Mapping[str, Camera]
    tables: tuple[RayTable | PublishedRays, ...]
    air_of: NDArray[np.int64]
    direction: Direction = "remove"
    uncertainties: tuple[Uncertainty | None, ...] = (None,)
    views: NDArray[np.int64] | None = None

    @property
    def in_doubt(self) -> bool:
        """Whether standard deviations are asked for."""
        return any(one is not None for one in self.uncertainties)

    def groups(
        self, row: NDArray[np.int64], camera: NDArray[np.int64]
    ) -> Iterator[tuple[NDArray[np.intp], Camera, int]]:
        """The observations of each camera in each air, from their stations and cameras (n,)."""
        for number, model in enumerate(self.cameras.values()):
            mine = np.flatnonzero(camera == number)
            if len(self.tables) == 1:
                if mine.size:
                    yield mine, model, 0
                continue
            air = self.air_of[row[mine]]
            for i in np.unique(air).tolist():
                yield mine[air == i], model, i


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
        table = observation_table(batch, corrections, h_g, observations.pixels, schema)
        write_parquet(table, folder.place(name))
        folder.seal(name)
        tally = Tally.of(recipe.cameras)
        tally.add(batch, corrections, camera)
        tally.odd_heights += recipe.ground.count_odd(batch)
        if recipe.in_doubt:
            tally.rays.append(_some_rays(batch, corrections, row, h_g, camera, recipe))
        return tally

    total = Tally.of(recipe.cameras)
    # Closed, and its threads waited for, before anyone clears the folder they write to.
    with closing(_overlapped(one, observations.batches(batch_rows))) as parts:
        for part in parts:
            total.merge(part)
            progress(part.rows)
    return total


def _overlapped(
    one: Callable[[int, Batch], Tally], batches: Iterator[Batch]
) -> Generator[Tally, None, None]:
    """Results for numbered batches, in their order.

    As many at a time as this process may use CPUs, four at most; one more is read meanwhile, and
    no other before the oldest of them is done.
    """
    workers = min(_MOST_WORKERS, usable_cpus())
    waiting: deque[Future[Tally]] = deque()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="batch")
    try:
        for number, batch in enumerate(batches):  # a signal ends the reading at once
            with held_back():
                waiting.append(pool.submit(one, number, batch))
            if len(waiting) > workers:
                yield _oldest(waiting)
        while waiting:
            yield _oldest(waiting)
    finally:
        with held_back():
            for future in waiting:
                future.cancel()
            pool.shutdown()


def _oldest(waiting: deque[Future[Tally]]) -> Tally:
    with held_back():
        return waiting.popleft().result()


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
        for mine, model, air in recipe.groups(row, camera):
            h_g[mine] = target_heights(
                batch.x_px[mine],
                batch.y_px[mine],
                batch.distance_m[mine],
                row[mine],
                recipe.exposures,
                model,
                recipe.tables[air],
                ideal=recipe.direction == "apply",
            )
        h_g = plausible(h_g)
    return h_g


def _correct_batch(
    batch: Batch, row: NDArray[np.int64], h_g: Array, camera: NDArray[np.int64], recipe: Recipe
) -> Corrections:
    """The corrections of a batch, camera by camera, back in the order of the rows."""
    parts = []
    for mine, model, air in recipe.groups(row, camera):
        if mine.size == len(batch):
            return _correct_rows(batch, slice(None), row, h_g, model, air, recipe)
        parts.append((mine, _correct_rows(batch, mine, row, h_g, model, air, recipe)))
    columns: dict[str, Any] = {name: np.full(len(batch), np.nan) for name in COLUMNS}
    columns["status"] = np.full(len(batch), NO_STATION, np.uint8)
    sigmas = Sigmas.unknown(len(batch)) if recipe.in_doubt else None
    for mine, part in parts:
        for name, column in columns.items():
            column[mine] = getattr(part, name)
        if sigmas is not None and part.sigmas is not None:
            sigmas.put(mine, part.sigmas)
    return Corrections(**columns, sigmas=sigmas)


def _some_rays(
    batch: Batch,
    corrections: Corrections,
    row: NDArray[np.int64],
    h_g: Array,
    camera: NDArray[np.int64],
    recipe: Recipe,
) -> Array:
    """(6, m) rays of a batch as `Tally.sampled` has them, evenly spread over its rows."""
    ex = recipe.exposures
    h_c = np.append(ex.height_m, np.nan)[row]
    good = np.flatnonzero(np.isfinite(corrections.r_c_rad) & (h_c > h_g))
    some = good[evenly(good.size, _RAYS_OF_A_PART)]
    at = row[some]
    direction = np.full((some.size, 3), np.nan)
    # Of pixels as measured, which are where the rays went through the window.
    x, y = (batch.x_px, batch.y_px) if recipe.direction == "remove" else (
        corrections.x_px, corrections.y_px)  # fmt: skip
    for number, model in enumerate(recipe.cameras.values()):
        mine = camera[some] == number
        u, v, _ = model.rays(x[some[mine]], y[some[mine]])
        direction[mine] = np.stack([u, v, np.ones(u.size)], axis=1)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    turns = at_the_window(direction, -ex.rotation[at, :, 2], ex.normals[at])
    kind = np.zeros(at.size) if recipe.views is None else recipe.views[at]
    rays = np.stack([h_c[some], h_g[some], corrections.zeta_c_rad[some], kind, *turns])
    return np.asarray(rays[:, np.isfinite(rays).all(axis=0)])


def _correct_rows(
    batch: Batch,
    mine: NDArray[np.intp] | slice,
    row: NDArray[np.int64],
    h_g: Array,
    model: Camera,
    air: int,
    recipe: Recipe,
) -> Corrections:
    """The corrections of the rows of one camera in one air."""
    uncertainty = recipe.uncertainties[air]
    way = correct_observations if recipe.direction == "remove" else apply_refraction
    return way(
        batch.x_px[mine],
        batch.y_px[mine],
        h_g[mine],
        row[mine],
        recipe.exposures,
        model,
        recipe.tables[air],
        distance_m=None if batch.distance_m is None else batch.distance_m[mine],
        uncertainty=uncertainty,
        sigma_h_g=None if uncertainty is None else recipe.ground.sigmas(batch)[mine],
    )
