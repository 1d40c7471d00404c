"""The correction: batches of observations in, corrected observations out, one part each.

Batches are independent: what a part holds does not depend on how many are in progress.
"""

import math
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from unbend.interrupts import held_back
from unbend.refraction.camera.camera import Camera
from unbend.refraction.forward import apply_refraction
from unbend.refraction.image import COLUMNS, Corrections, Exposures, correct_observations
from unbend.refraction.kernels.threads import usable_cpus
from unbend.refraction.ray import PublishedRays
from unbend.refraction.ray_table import RayTable
from unbend.refraction.status_codes import NO_STATION
from unbend.refraction.uncertainty.sigmas import Sigmas, Uncertainty
from unbend.stages.ground_heights import Ground, GroundHeights
from unbend.stages.statistics import SAMPLED_ROWS, SampledRows, Statistics
from unbend.tables.geodata.object_points import matching_rows
from unbend.tables.observations import Batch, Observations
from unbend.tables.refraction_mark import Direction
from unbend.tables.schemas import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of
from unbend.tables.writing import table_of_observations
from unbend.units import Array, Integers, Names

_MOST_WORKERS = 4
"""Batches corrected at the same time: each holds 250,000 rows, and reading and writing take the
rest of the time."""


@dataclass(frozen=True, eq=False)
class CorrectionSetup:
    """Everything that a batch of observations is corrected with.

    ``images``, ``camera_names`` and ``profile_number`` (s,) belong to the rows of ``exposures``;
    the last indexes ``rays`` and ``uncertainties`` (None: no standard deviations).
    """

    images: Names
    camera_names: Names
    exposures: Exposures
    ground: Ground
    cameras: Mapping[str, Camera]
    rays: tuple[RayTable | PublishedRays, ...]
    profile_number: Integers
    direction: Direction = "remove"
    uncertainties: tuple[Uncertainty | None, ...] = (None,)

    @property
    def computes_sigmas(self) -> bool:
        return any(uncertainty is not None for uncertainty in self.uncertainties)

    @cached_property
    def camera_number(self) -> Integers:
        """(s + 1,) the position in ``cameras`` of each station's camera, -1 without one.

        An image without an exposure has a station without a camera. The last entry is for
        observations without a station, whose station is -1.
        """
        number_of = {name: number for number, name in enumerate(self.cameras)}
        return np.array([number_of.get(n, -1) for n in self.camera_names] + [-1], np.int64)

    def groups(self, station: Integers) -> Iterator[tuple[Integers, Camera, int]]:
        """The observations (n,) of each camera in each profile: rows, camera, profile number."""
        camera_number = self.camera_number[station]
        for number, camera in enumerate(self.cameras.values()):
            rows = np.flatnonzero(camera_number == number)
            if len(self.rays) == 1:
                if rows.size:
                    yield rows, camera, 0
                continue
            profile = self.profile_number[station[rows]]
            for i in np.unique(profile).tolist():
                yield rows[profile == i], camera, i

    def directions(self, x_px: Array, y_px: Array, station: Integers) -> tuple[Array, Array]:
        """(n, 3) unit vectors of pixels in their cameras, and (n,) the size of a pixel [rad]."""
        direction, sigma = np.full((station.size, 3), np.nan), np.ones(station.size)
        for rows, camera, _ in self.groups(station):
            u, v, _ = camera.rays(x_px[rows], y_px[rows])
            direction[rows] = np.stack([u, v, np.ones(u.size)], axis=1)
            sigma[rows] = 1.0 / camera.fx_px
        return direction / np.linalg.norm(direction, axis=1)[:, None], sigma


class Parts(Protocol):
    """Where the corrected parts of the observations go, by number."""

    def finished(self, number: int) -> Statistics | None:
        """The counts of a part that is there already; None where it must be made."""

    def write(self, number: int, table: pa.Table, statistics: Statistics) -> None:
        """Write a part; called on threads."""


def correct_stream(
    observations: Observations,
    setup: CorrectionSetup,
    parts: Parts,
    *,
    batch_rows: int,
    metadata: Mapping[str, str],
    progress: Callable[[int], None] = lambda _: None,
    numbers: Sequence[int] | None = None,
) -> Statistics:
    """Correct all observations, or parts of these ``numbers``, and write them part by part.

    Parts that are finished are counted and not made again. Memory holds at most five batches,
    whatever the number of rows. ``progress`` is called with the number of rows of every part.
    """
    columns = OBSERVATION_COLUMNS if setup.direction == "remove" else DISPLACED_COLUMNS
    schema = schema_of(columns, metadata, observations.user_fields)
    there: dict[int, Statistics] = {}

    def correct_part(number: int, batch: Batch) -> Statistics:
        sampled = math.ceil(SAMPLED_ROWS * len(batch) / observations.rows)
        corrections, h_g, statistics = correct_counted(batch, setup, sampled)
        table = table_of_observations(batch, corrections, h_g, observations.pixels, schema)
        parts.write(number, table, statistics)
        return statistics

    def is_there(number: int) -> bool:
        if (statistics := parts.finished(number)) is not None:
            there[number] = statistics
        return statistics is not None

    def in_order(of_all: Sequence[int]) -> Generator[Statistics]:
        for finished, run in groupby(of_all, is_there):
            if finished:
                yield from (there.pop(number) for number in run)
                continue
            first, *others = run
            batches = observations.batches(batch_rows, first, first + 1 + len(others))
            # closing() waits for the threads before the caller removes the folder they write to.
            with closing(on_threads(correct_part, batches, first)) as made:
                yield from made

    if numbers is None:
        numbers = range(math.ceil(observations.rows / observations.rows_of_part(batch_rows)))
    total = Statistics.of(setup.cameras)
    with closing(in_order(numbers)) as counted:
        for part in counted:
            total.merge(part)
            progress(part.rows)
    return total


def correct_counted(
    batch: Batch, setup: CorrectionSetup, sampled: int = SAMPLED_ROWS
) -> tuple[Corrections, Array, Statistics]:
    """Corrections of a batch, heights of its points [m], counts of both with ``sampled`` rows."""
    station = matching_rows(batch.image, pa.array(setup.images, pa.string()))
    ground = setup.ground.heights(batch, station, setup)
    corrections = ground.flagged(correct_batch(batch, station, ground, setup))
    statistics = Statistics.of(setup.cameras)
    statistics.add(batch, corrections, setup.camera_number[station])
    statistics.implausible_heights += ground.implausible
    used = ground.h_m[np.isfinite(corrections.dx_px)]
    if used.size:
        statistics.ground_m = float(used.min()), float(used.max())
    statistics.sampled.append(SampledRows.of(batch, corrections, ground.h_m, station, sampled))
    return corrections, ground.h_m, statistics


def on_threads(
    correct_part: Callable[[int, Batch], Statistics], batches: Iterator[Batch], first: int = 0
) -> Generator[Statistics, None, None]:
    """Results for batches, in their order, computed on threads: one a CPU, four at most."""
    workers = min(_MOST_WORKERS, usable_cpus())
    pending: deque[Future[Statistics]] = deque()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="batch")

    def oldest() -> Statistics:
        with held_back():
            return pending.popleft().result()

    try:
        for number, batch in enumerate(batches, first):  # a signal ends the reading at once
            with held_back():
                pending.append(pool.submit(correct_part, number, batch))
            if len(pending) > workers:
                yield oldest()
        while pending:
            yield oldest()
    finally:
        with held_back():
            for future in pending:
                future.cancel()
            pool.shutdown()


def correct_batch(
    batch: Batch, station: Integers, ground: GroundHeights, setup: CorrectionSetup
) -> Corrections:
    """The corrections of a batch, computed for each camera and profile, in the order of its rows.

    ``station`` (n,) as `matching_rows` returns it, ``ground`` the heights of the batch.
    """
    method = correct_observations if setup.direction == "remove" else apply_refraction
    parts: list[tuple[Integers, Corrections]] = []
    distance = ground.distance_m if batch.distance_m is None else batch.distance_m
    for group, camera, profile in setup.groups(station):
        whole = group.size == len(batch)
        rows = slice(None) if whole else group
        uncertainty = setup.uncertainties[profile]
        corrections = method(
            batch.x_px[rows],
            batch.y_px[rows],
            ground.h_m[rows],
            station[rows],
            setup.exposures,
            camera=camera,
            table=setup.rays[profile],
            distance_m=None if distance is None else distance[rows],
            uncertainty=uncertainty,
            sigma_h_g=None if uncertainty is None else ground.sigma_m[rows],
        )
        if whole:
            return corrections
        parts.append((group, corrections))
    columns: dict[str, Any] = {name: np.full(len(batch), np.nan) for name in COLUMNS}
    columns["status"] = np.full(len(batch), NO_STATION, np.uint8)
    sigmas = Sigmas.unknown(len(batch)) if setup.computes_sigmas else None
    for group, part in parts:
        for name, column in columns.items():
            column[group] = getattr(part, name)
        if sigmas is not None and part.sigmas is not None:
            sigmas.put(group, part.sigmas)
    return Corrections(**columns, sigmas=sigmas)
