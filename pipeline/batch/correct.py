"""The one large stream: observations in, corrected observations out, a batch at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pipeline.batch.store import RunFolder
from pipeline.ledger import Ledger
from pipeline.refraction.camera import Camera
from pipeline.refraction.image import Corrections, Exposures, correct_observations
from pipeline.refraction.ray import PublishedRays, RayTable
from pipeline.refraction.spread import SPREADS, Extent, ImageGrid, Spread
from pipeline.refraction.status import NO_STATION, STATUS_NAMES
from pipeline.tables.observations import Batch, Observations
from pipeline.tables.schemas import OBSERVATION_COLUMNS, schema_of
from pipeline.tables.writing import observation_table, write_parquet

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """One camera: its interior orientation, window and which stations are its own."""

    camera: Camera
    window_normal: Array
    pixel_offset: float


LOWEST_GROUND_M, HIGHEST_GROUND_M = -600.0, 10_000.0
"""Ground heights outside this are no ground heights [m]."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Heights of the points above sea level: a constant, or a column plus what makes it so.

    ``offset_m`` (s,) is added per station: minus the undulation for ellipsoidal heights, the
    take-off height for relative ones.
    """

    constant_m: float | None
    offset_m: Array

    def heights(self, batch: Batch, row: NDArray[np.int64]) -> Array:
        """(n,) heights above sea level [m] of the points of a batch."""
        if batch.ground is not None:
            given = batch.ground
        else:
            given = np.full(len(batch), self.constant_m, dtype=np.float64)
        given = np.where((given >= LOWEST_GROUND_M) & (given <= HIGHEST_GROUND_M), given, np.nan)
        offset = np.append(self.offset_m, np.nan)[row]
        # Without a station there is nothing to reduce with; the status says no_station anyway.
        return np.asarray(given + np.where(row < 0, 0.0, offset))


@dataclass
class Tally:
    """What the stream amounted to: counts, and how large the correction was in each camera."""

    extents: dict[str, Extent]
    rows: int = 0
    parts: int = 0
    status: dict[str, int] = field(default_factory=dict)

    def correction(self) -> dict[str, Any]:
        """How large the correction was, over all and camera by camera, for the manifest."""
        together = {
            name: sum((e.spreads()[name] for e in self.extents.values()), Spread()).summary()
            for name in SPREADS
        }
        return together | {"cameras": {n: e.summary() for n, e in self.extents.items()}}

    def report_flagged(self, ledger: Ledger) -> None:
        """A line in the ledger for each reason why observations were not corrected."""
        for name, count in self.status.items():
            if name == "ok" or count == 0:
                continue
            what = f"{count} of {self.rows} observations are {name}"
            if name == "beyond_grazing":
                ledger.loss("OBS-BEYOND-GRAZING", what + ": near branch used", count=count)
            else:
                ledger.loss("OBS-FLAGGED", what, count=count)


def correct_stream(
    observations: Observations,
    stations_image: NDArray[np.object_],
    stations_camera: NDArray[np.object_],
    exposures: Exposures,
    ground: Ground,
    cameras: Mapping[str, CameraSetup],
    table: RayTable | PublishedRays,
    folder: RunFolder,
    batch_rows: int,
    metadata: Mapping[str, str],
    progress: Callable[[int], None],
) -> Tally:
    """Correct all observations and write them as ``observations/part-*.parquet``.

    Memory holds one batch, whatever the number of rows. ``progress`` hears of every batch's rows.
    """
    schema = schema_of(OBSERVATION_COLUMNS, metadata, list(observations.user_fields))
    names = pa.array(stations_image, pa.string())
    number_of = {name: number for number, name in enumerate(cameras)}
    # An image that no exposure was found for has a station without a camera; the last entry is
    # for observations without a station.
    camera_of = np.array([number_of.get(name, -1) for name in stations_camera] + [-1], np.int64)
    tally = Tally(
        {n: Extent(ImageGrid(s.camera.width_px, s.camera.height_px)) for n, s in cameras.items()}
    )
    for number, batch in enumerate(observations.batches(batch_rows)):
        row = _station_rows(batch.image, names)
        h_g = ground.heights(batch, row)
        camera = camera_of[row]
        corrections = _correct_batch(batch, row, h_g, exposures, cameras, camera, table)
        name = f"observations/part-{number:05d}.parquet"
        write_parquet(observation_table(batch, corrections, h_g, schema), folder.place(name))
        folder.seal(name)
        _count(tally, batch, corrections, camera)
        tally.parts = number + 1
        progress(len(batch))
    return tally


def _station_rows(image: pa.StringArray, names: pa.StringArray) -> NDArray[np.int64]:
    """(n,) the station of each observation, -1 without one."""
    encoded = image.dictionary_encode()
    station = pc.fill_null(pc.index_in(encoded.dictionary, value_set=names), -1)
    by_code = np.append(station.to_numpy(zero_copy_only=False).astype(np.int64), -1)
    codes = pc.fill_null(encoded.indices, len(by_code) - 1).to_numpy(zero_copy_only=False)
    return np.asarray(by_code[codes])


def _correct_batch(
    batch: Batch,
    row: NDArray[np.int64],
    h_g: Array,
    exposures: Exposures,
    cameras: Mapping[str, CameraSetup],
    camera: NDArray[np.int64],
    table: RayTable | PublishedRays,
) -> Corrections:
    """The corrections of a batch, camera by camera, back in the order of the rows."""
    n = len(batch)
    columns: dict[str, Array] = {
        name: np.full(n, np.nan) for name in Corrections.__dataclass_fields__ if name != "status"
    }
    status = np.full(n, NO_STATION, np.uint8)
    for number, setup in enumerate(cameras.values()):
        mine = np.flatnonzero(camera == number)
        if mine.size == 0:
            continue
        part = correct_observations(
            batch.x_px[mine] + setup.pixel_offset,
            batch.y_px[mine] + setup.pixel_offset,
            h_g[mine],
            row[mine],
            exposures,
            setup.camera,
            table,
            window_normal=setup.window_normal,
        )
        for name, column in columns.items():
            column[mine] = getattr(part, name)
        status[mine] = part.status
        columns["x_px"][mine] -= setup.pixel_offset
        columns["y_px"][mine] -= setup.pixel_offset
    return Corrections(status=status, **columns)


def _count(
    tally: Tally,
    batch: Batch,
    corrections: Corrections,
    camera: NDArray[np.int64],
) -> None:
    tally.rows += len(batch)
    counts = np.bincount(corrections.status, minlength=len(STATUS_NAMES))
    for name, count in zip(STATUS_NAMES, counts.tolist(), strict=True):
        tally.status[name] = tally.status.get(name, 0) + int(count)
    for number, extent in enumerate(tally.extents.values()):
        mine = np.flatnonzero(camera == number)
        extent.add(batch.x_px[mine], batch.y_px[mine], corrections.rows(mine))
