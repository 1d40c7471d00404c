"""The correction: batches of observations in, corrected parts of the results out.

Parts are independent: their contents do not depend on how many are in progress.
"""

import math
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from unbend.interrupts import held_back
from unbend.refraction.camera.camera import Camera
from unbend.refraction.forward import apply_refraction
from unbend.refraction.image import COLUMNS, Corrections, correct_observations
from unbend.refraction.kernels.threads import usable_cpus
from unbend.refraction.status_codes import NO_STATION
from unbend.refraction.uncertainty.sigmas import Sigmas
from unbend.stages.correction_setup import CorrectionSetup, GroundHeights
from unbend.stages.statistics import SAMPLED_ROWS, SampledRows, Statistics
from unbend.tables.geodata.object_points import matching_rows
from unbend.tables.observations import Batch, Observations
from unbend.tables.writing import table_of_observations
from unbend.tables.written_columns import DISPLACED_COLUMNS, OBSERVATION_COLUMNS, schema_of
from unbend.units import Array, Integers

BYTES_OF_A_ROW = 1500
"""Memory for each row that is corrected and written: columns, temporaries, Parquet."""

SHARE_OF_MEMORY = 0.25
"""Of the machine's memory, for the parts in progress."""

Done = TypeVar("Done")


@dataclass(frozen=True, eq=False)
class CorrectedPart:
    """A part of the results: its number (from 0), its table as written to a run, its statistics."""

    number: int
    table: pa.Table
    statistics: Statistics


def number_of_parts(observations: Observations, batch_rows: int) -> int:
    """How many parts the results have."""
    return math.ceil(observations.rows / observations.rows_of_part(batch_rows))


def correct_parts(
    observations: Observations,
    setup: CorrectionSetup,
    finish: Callable[[CorrectedPart], Done],
    *,
    numbers: Sequence[int] | None = None,
    batch_rows: int,
    metadata: Mapping[str, str],
) -> Generator[Done, None, None]:
    """Correct all observations, or only the parts with these ``numbers``, in rising order.

    ``finish`` gets each part on the thread that made it, for instance to write it; its results are
    yielded in the order of the parts. At most one part more than there are threads is in memory.
    ``batch_rows`` is the wanted number of rows of a part, ``metadata`` that of the tables.
    """
    columns = OBSERVATION_COLUMNS if setup.direction == "remove" else DISPLACED_COLUMNS
    schema = schema_of(columns, metadata, observations.user_fields)

    def correct_part(number: int, batch: Batch) -> Done:
        sampled_rows = math.ceil(SAMPLED_ROWS * len(batch) / observations.rows)
        corrections, h_g, statistics = correct_counted(batch, setup, sampled_rows)
        table = table_of_observations(batch, corrections, h_g, observations.pixels, schema)
        return finish(CorrectedPart(number, table, statistics))

    if numbers is None:
        numbers = range(number_of_parts(observations, batch_rows))
    threads = threads_for(observations.rows_of_part(batch_rows))
    for run in runs_of_numbers(numbers):
        batches = observations.batches(batch_rows, run.start, run.stop)
        # closing() waits for the threads before the caller removes the folder they write to.
        with closing(on_threads(correct_part, batches, run.start, threads=threads)) as made:
            yield from made


def runs_of_numbers(numbers: Sequence[int]) -> Iterator[range]:
    """Numbers in rising order as ranges, a new one after each gap.

    >>> list(runs_of_numbers([0, 1, 4, 6, 7]))
    [range(0, 2), range(4, 5), range(6, 8)]
    """
    if not numbers:
        return
    first = numbers[0]
    behind_a_gap = numbers[-1] + 2  # + 1 would continue the last range, + 2 ends it
    for number, following in pairwise([*numbers, behind_a_gap]):
        if following != number + 1:
            yield range(first, number + 1)
            first = following


def threads_for(rows: int) -> int:
    """How many parts of ``rows`` rows are corrected at once: one for each CPU.

    Fewer, but at least one, if the parts would take more than a quarter of the memory.
    """
    try:
        memory_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf: assume 8 GiB
        memory_bytes = 8 << 30
    fitting = int(SHARE_OF_MEMORY * memory_bytes / (rows * BYTES_OF_A_ROW))
    return max(1, min(usable_cpus(), fitting))


def correct_counted(
    batch: Batch, setup: CorrectionSetup, most_sampled: int = SAMPLED_ROWS
) -> tuple[Corrections, Array, Statistics]:
    """The corrections of a batch (n,), the heights of its points (n,) [m], and their statistics.

    The statistics keep at most ``most_sampled`` evenly spaced rows, which represent the others.
    """
    station = matching_rows(batch.image, pa.array(setup.images, pa.string()))
    ground = setup.ground.heights(batch, station, setup)
    corrections = ground.with_ground_status(correct_batch(batch, station, ground, setup))
    statistics = Statistics.of(setup.cameras)
    statistics.add(batch, corrections, setup.camera_number[station])
    statistics.implausible_heights += ground.implausible
    corrected_h_m = ground.h_m[np.isfinite(corrections.dx_px)]
    if corrected_h_m.size:
        statistics.ground_m = float(corrected_h_m.min()), float(corrected_h_m.max())
    statistics.sampled.append(SampledRows.of(batch, corrections, ground.h_m, station, most_sampled))
    return corrections, ground.h_m, statistics


def on_threads(
    correct_part: Callable[[int, Batch], Done],
    batches: Iterator[Batch],
    first: int = 0,
    *,
    threads: int,
) -> Generator[Done, None, None]:
    """Results of ``correct_part`` for batches, computed on threads and yielded in their order.

    ``first`` is the number of the first batch. At most ``threads`` + 1 batches are being corrected
    or wait to be yielded. A signal is held back while a batch is submitted or waited for. At the
    end, or after an error, batches that have not begun are cancelled, and the others waited for.
    """
    pending: deque[Future[Done]] = deque()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="batch")

    def oldest() -> Done:
        with held_back():
            return pending.popleft().result()

    try:
        for number, batch in enumerate(batches, first):  # a signal ends the reading at once
            with held_back():
                pending.append(pool.submit(correct_part, number, batch))
            if len(pending) > threads:
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
    """The corrections of a batch in the order of its rows, computed for each camera and profile.

    ``station`` (n,) is the number of each row's station, -1 without one; ``ground`` has the heights
    of the batch. Rows without a station, or with a station without a camera, get the status
    no_station.
    """
    parts: list[tuple[Integers, Corrections]] = []
    for rows, camera, profile in setup.groups(station):
        correct = partial(correct_rows, batch, camera=camera, profile=profile)
        if rows.size == len(batch):  # the only group: a slice of all rows spares the copies
            return correct(slice(None), station, ground, setup)
        corrections = correct(rows, station, ground, setup)
        parts.append((rows, corrections))
    columns: dict[str, Any] = {name: np.full(len(batch), np.nan) for name in COLUMNS}
    columns["status"] = np.full(len(batch), NO_STATION, np.uint8)
    sigmas = Sigmas.unknown(len(batch)) if setup.computes_sigmas else None
    for rows, part in parts:
        for name, column in columns.items():
            column[rows] = getattr(part, name)
        if sigmas is not None and part.sigmas is not None:
            sigmas.put(rows, part.sigmas)
    return Corrections(**columns, sigmas=sigmas)


def correct_rows(
    batch: Batch,
    rows: Integers | slice,
    station: Integers,
    ground: GroundHeights,
    setup: CorrectionSetup,
    *,
    camera: Camera,
    profile: int,
) -> Corrections:
    """The corrections of some rows of a batch, seen by one camera in one profile (its number).

    ``station`` and ``ground`` are of the whole batch. Slant ranges are those of the batch, else
    those of an elevation model, else none.
    """
    method = correct_observations if setup.direction == "remove" else apply_refraction
    uncertainty = setup.uncertainties[profile]
    distance_m = ground.distance_m if batch.distance_m is None else batch.distance_m
    return method(
        batch.x_px[rows],
        batch.y_px[rows],
        ground.h_m[rows],
        station[rows],
        setup.exposures,
        camera=camera,
        table=setup.rays[profile],
        distance_m=None if distance_m is None else distance_m[rows],
        uncertainty=uncertainty,
        sigma_h_g=None if uncertainty is None else ground.sigma_m[rows],
    )
