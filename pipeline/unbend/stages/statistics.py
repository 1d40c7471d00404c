"""Statistics of a stream of observations and their corrections, in fixed memory."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M
from unbend.messages import Kind, Ledger, Message
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Corrections
from unbend.refraction.status_codes import NO_STATION, OK, STATUS_NAMES
from unbend.stages import messages
from unbend.stages.distribution import Distribution, median_and_p95, weighted_quantile
from unbend.tables.manifest.results import (
    CameraShifts,
    CorrectionRecord,
    GroundHeightsRecord,
    GroundHistogram,
    ShiftField,
    SigmaRecord,
)
from unbend.tables.observations import Batch
from unbend.units import ARCSEC, Array, evenly_spaced, round_step

SAMPLED_ROWS = 20_000
"""Evenly spaced rows of a run that are kept, to check plausibility and for medians."""

SIGMA_PARTS = ("air", "station", "ground", "cabin")
"""Causes of the uncertainty of corrections; each has its own columns in the results."""

MOST_EXAMPLES = 3
"""Rows that a message names for each status."""

ADDED = (
    "rows",
    "no_distance",
    "no_sigma",
    "no_point",
    "no_image",
    "implausible_heights",
    "parts",
    "air_variance",
    "by_mode",
    "sampled",
    "cabin_share",
)
"""Fields of `Statistics` that `Statistics.merge` adds with +."""

QUANTITIES = ("shift_px", "shift_ground_m", "refraction_arcsec", "window_arcsec")
"""What `ShiftStatistics` keeps distributions of."""

_COLUMNS = 14
_ROWS = 10
"""Cells over an image; the mean shift of each is reported."""

_GROUND_BINS = 24  # about as many bins has the histogram of ground heights
_FINEST_GROUND_BIN_M = 0.1  # least width of these bins


@dataclass
class ShiftStatistics:
    """How far corrections move the points of a camera.

    ``sums`` (3, 10, 14): in each cell of the image the sum of dx and the sum of dy [px], and the
    number of points.
    """

    width_px: int
    height_px: int
    sums: Array = field(default_factory=lambda: np.zeros((3, _ROWS, _COLUMNS)))
    distributions: dict[str, Distribution] = field(
        default_factory=lambda: {name: Distribution() for name in QUANTITIES}
    )

    def add(self, x_px: Array, y_px: Array, corrections: Corrections) -> None:
        """Add the corrections of points measured at (x, y); points that have none do not count."""
        corrected: Any = np.isfinite(corrections.dx_px)
        if corrected.all():
            corrected = slice(None)  # avoids copies
        dx = corrections.dx_px[corrected]
        dy = corrections.dy_px[corrected]
        across = x_px[corrected] / self.width_px * _COLUMNS
        down = y_px[corrected] / self.height_px * _ROWS
        column = np.clip(across, 0, _COLUMNS - 1).astype(np.intp)
        row = np.clip(down, 0, _ROWS - 1).astype(np.intp)
        cell = row * _COLUMNS + column
        for number, addend in enumerate((dx, dy, np.ones(dx.shape))):
            sum_of_cells = np.bincount(cell, addend, _ROWS * _COLUMNS)
            self.sums[number] += sum_of_cells.reshape(_ROWS, _COLUMNS)
        magnitudes = {
            "shift_px": np.sqrt(dx * dx + dy * dy),
            "shift_ground_m": corrections.shift_ground_m[corrected],
            "refraction_arcsec": corrections.r_c_rad[corrected] / ARCSEC,
            "window_arcsec": np.abs(corrections.r_cc_rad[corrected]) / ARCSEC,
        }
        for name, values in magnitudes.items():
            self.distributions[name].add(values)

    def __add__(self, other: ShiftStatistics) -> ShiftStatistics:
        distributions = {}
        for name, distribution in self.distributions.items():
            distributions[name] = distribution + other.distributions[name]
        sums = self.sums + other.sums
        return ShiftStatistics(self.width_px, self.height_px, sums, distributions)

    def summary(self) -> CameraShifts:
        """Counts, medians and maxima, histograms of the shift, and its field, for the manifest."""
        sum_dx, sum_dy, points = self.sums
        filled = points > 0
        row, column = np.nonzero(filled)
        count = points[filled]
        field_of_shifts = ShiftField(
            format_px=[self.width_px, self.height_px],
            columns=_COLUMNS,
            x_px=to_five_digits((column + 0.5) * self.width_px / _COLUMNS),
            y_px=to_five_digits((row + 0.5) * self.height_px / _ROWS),
            dx_px=to_five_digits(sum_dx[filled] / count),
            dy_px=to_five_digits(sum_dy[filled] / count),
        )
        summaries = {name: values.summary() for name, values in self.distributions.items()}
        return CameraShifts(
            **summaries,
            histogram_px=self.distributions["shift_px"].histogram(),
            histogram_m=self.distributions["shift_ground_m"].histogram(),
            field=field_of_shifts,
        )


def to_five_digits(values: Array) -> list[float]:
    """Numbers rounded to five significant digits."""
    return [float(f"{value:.5g}") for value in values]


class SampledRows(NamedTuple):
    """Evenly spaced rows that represent all rows; (n,) each.

    ``station`` is -1 for an image without a station; ``weight`` is how many rows each row
    represents; ``sigma_px`` (n, 4) has a column of standard deviations of the correction for each
    of `SIGMA_PARTS`, NaN if unknown.
    """

    station: NDArray[np.int64]
    x_px: Array
    y_px: Array
    h_g_m: Array
    distance_m: Array
    zeta_c_rad: Array
    r_c_rad: Array
    shift_px: Array
    shift_ground_m: Array
    status: NDArray[np.uint8]
    weight: Array
    sigma_px: Array

    @classmethod
    def of(
        cls,
        batch: Batch,
        corrections: Corrections,
        h_g: Array,
        station: NDArray[np.int64],
        most: int,
    ) -> SampledRows:
        """At most ``most`` rows of a batch, evenly spaced, with their corrections.

        ``h_g`` (n,) are the ground heights [m] and ``station`` (n,) the station numbers of the
        batch.
        """
        rows = evenly_spaced(len(batch), most)
        weight = np.ones(rows.size)
        if batch.weight is not None:
            weight = batch.weight[rows]
        distance_m = np.full(rows.size, np.nan)
        if batch.distance_m is not None:
            distance_m = batch.distance_m[rows]
        return cls(
            station=station[rows],
            x_px=batch.x_px[rows],
            y_px=batch.y_px[rows],
            h_g_m=h_g[rows],
            distance_m=distance_m,
            zeta_c_rad=corrections.zeta_c_rad[rows],
            r_c_rad=corrections.r_c_rad[rows],
            shift_px=np.hypot(corrections.dx_px[rows], corrections.dy_px[rows]),
            shift_ground_m=corrections.shift_ground_m[rows],
            status=corrections.status[rows],
            weight=weight * len(batch) / rows.size,
            sigma_px=sigma_parts(corrections, rows),
        )


@dataclass
class Statistics:
    """Counts of observations, and how large the corrections were in each camera.

    shifts : how far corrections move points, by camera.
    status : how many rows have each status.
    examples : the first images and points of each status but ok, in the order of the rows.
    no_distance, no_sigma, implausible_heights : how many rows have a slant range, a sigma of the
        ground or a height of the ground that cannot be used.
    no_point : how many rows have a point that the table of object points lacks.
    no_image : how many rows have no name of an image; they also count as no_station.
    first_no_image : row number and point of the first row without a name of an image.
    ground_m : the lowest and the highest ground height of corrected rows [m above sea level];
        (inf, -inf) if there are none.
    air_variance : sum of the squares of the sigmas of corrections by the air [px2].
    by_mode : sum of the squares of the derivatives of corrections by the parameter of the leading
        mode of the air [px2].
    sampled : some rows of each part, about `SAMPLED_ROWS` in all, which represent all rows.
    cabin_share : sigma of R_cc by the air in the cabin, as a share of R_c.
    """

    shifts: dict[str, ShiftStatistics]
    rows: int = 0
    parts: int = 0
    status: dict[str, int] = field(default_factory=dict)
    examples: dict[str, list[str]] = field(default_factory=dict)
    no_distance: int = 0
    no_sigma: int = 0
    no_point: int = 0
    no_image: int = 0
    first_no_image: str = ""
    implausible_heights: int = 0
    ground_m: tuple[float, float] = (math.inf, -math.inf)
    air_variance: float = 0.0
    by_mode: float = 0.0
    sampled: list[SampledRows] = field(default_factory=list)
    cabin_share: Distribution = field(default_factory=Distribution)

    @classmethod
    def of(cls, cameras: Mapping[str, Camera]) -> Statistics:
        """The statistics of no observations."""
        shifts = {}
        for name, camera in cameras.items():
            shifts[name] = ShiftStatistics(camera.width_px, camera.height_px)
        return cls(shifts)

    def add(self, batch: Batch, corrections: Corrections, camera: NDArray[np.int64]) -> None:
        """Count a batch; ``camera`` (n,) is the number of each row's camera, -1 without a camera.

        In a sample of the table each row has a weight: it counts as so many rows of the table.
        """
        rows = len(batch) if batch.weight is None else round(batch.weight.sum())
        self.parts += 1
        self.rows += rows
        self.no_distance += round(batch.no_distance * rows / len(batch))
        self.no_sigma += round(batch.no_sigma * rows / len(batch))
        self.no_point += round(batch.no_point * rows / len(batch))
        sigmas = corrections.sigmas
        if sigmas is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                self.cabin_share.add(sigmas.r_cc_rad / np.abs(corrections.r_c_rad))
            self.air_variance += _squares(sigmas.air_dx_px, sigmas.air_dy_px)
            self.by_mode += _squares(sigmas.dx_ds_px, sigmas.dy_ds_px)
        self._add_statuses(batch, corrections)
        for number, shift_statistics in enumerate(self.shifts.values()):
            of_camera = camera == number
            if bool(of_camera.all()):
                shift_statistics.add(batch.x_px, batch.y_px, corrections)
            elif bool(of_camera.any()):
                x_px = batch.x_px[of_camera]
                y_px = batch.y_px[of_camera]
                shift_statistics.add(x_px, y_px, corrections.rows(of_camera))

    def _add_statuses(self, batch: Batch, corrections: Corrections) -> None:
        """Count the statuses of a batch, and keep its first rows of each status but ok as examples.

        They replace the examples of a batch that was added before; `merge` appends examples.
        """
        counts = np.bincount(corrections.status, batch.weight, minlength=len(STATUS_NAMES))
        for name, count in zip(STATUS_NAMES, counts.tolist(), strict=True):
            self.status[name] = self.status.get(name, 0) + round(count)
        for code in np.unique(corrections.status[corrections.status != OK]).tolist():
            rows = np.flatnonzero(corrections.status == code)
            if code == NO_STATION:
                has_no_image = batch.is_image_missing(rows)
                self._add_rows_without_image(batch, rows[has_no_image])
                rows = rows[~has_no_image]
            examples = []
            for row in rows[:MOST_EXAMPLES].tolist():
                point = batch.point[row].as_py() or f"(row {batch.number_of(row)})"
                examples.append(f"{batch.image[row]} {point}")
            if examples:
                self.examples[STATUS_NAMES[code]] = examples

    def _add_rows_without_image(self, batch: Batch, rows: NDArray[np.int64]) -> None:
        """Count the ``rows`` (k,) of a batch, which have no image name, and describe the first."""
        if not rows.size:
            return
        weight = np.ones(rows.size) if batch.weight is None else batch.weight[rows]
        self.no_image += round(weight.sum())
        first = int(rows[0])
        point = batch.point[first].as_py()
        point_text = f" (point {point})" if point else ""
        self.first_no_image = f"{batch.number_of(first)}{point_text}"

    def sampled_rows(self) -> SampledRows:
        """The sampled rows of all parts, one part after the other."""
        columns = []
        for parts_of_column in zip(*self.sampled, strict=True):
            columns.append(np.concatenate(parts_of_column))
        return SampledRows(*columns)

    def merge(self, other: Statistics) -> None:
        """Add the statistics of a later part of the same run to these."""
        for name in ADDED:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        low, high = self.ground_m
        other_low, other_high = other.ground_m
        self.ground_m = min(low, other_low), max(high, other_high)
        for name, count in other.status.items():
            self.status[name] = self.status.get(name, 0) + count
        self.first_no_image = self.first_no_image or other.first_no_image
        for name, texts in other.examples.items():
            examples = self.examples.get(name, []) + texts
            self.examples[name] = examples[:MOST_EXAMPLES]
        for name, statistics in other.shifts.items():
            self.shifts[name] = self.shifts[name] + statistics

    def correction(self) -> CorrectionRecord:
        """The distribution of the corrections' size, in total and by camera, for the manifest."""
        over_all = {}
        for name in QUANTITIES:
            total = Distribution()
            for of_camera in self.shifts.values():
                total = total + of_camera.distributions[name]
            over_all[name] = total.summary()
        cameras = {name: of_camera.summary() for name, of_camera in self.shifts.items()}
        return CorrectionRecord(**over_all, cameras=cameras)

    def sigma_budget(self, camera: NDArray[np.int64]) -> dict[str, dict[str, SigmaRecord]]:
        """Median and 95 % quantile of each part of sigma [px, m on the ground], by camera and part.

        The parts are `SIGMA_PARTS`, and "all": the root of the sum of the squares of the known
        parts. ``camera`` (s + 1,) is `CorrectionSetup.camera_number`, the last entry for rows
        without a station (-1). Computed from the sampled rows; pixels are converted to metres by
        each row's shift, which is known in both.
        """
        rows = self.sampled_rows()
        with np.errstate(divide="ignore", invalid="ignore"):
            metres_per_px = rows.shift_ground_m / rows.shift_px
        sigma_of_all = np.sqrt(np.nansum(rows.sigma_px**2, axis=1))
        sigma_of_all[np.isnan(rows.sigma_px).all(axis=1)] = np.nan
        parts = dict(zip(SIGMA_PARTS, rows.sigma_px.T, strict=True))
        parts["all"] = sigma_of_all
        budget = {}
        for number, name in enumerate(self.shifts):
            of_camera = camera[rows.station] == number
            budget[name] = sigma_records(
                {part: sigma_px[of_camera] for part, sigma_px in parts.items()},
                metres_per_px=metres_per_px[of_camera],
                weight=rows.weight[of_camera],
            )
        return budget

    def ground_of_stations(self, count: int) -> Array:
        """(count,) median ground height [m] of each station's sampled rows; NaN without rows.

        ``count`` is the number of stations.
        """
        rows = self.sampled_rows()
        used = (rows.station >= 0) & np.isfinite(rows.h_g_m)
        heights_m = pd.Series(rows.h_g_m[used])
        medians = heights_m.groupby(rows.station[used]).median()
        of_all_stations = medians.reindex(range(count))
        return np.asarray(of_all_stations, np.float64)

    def ground_heights(self) -> GroundHeightsRecord | None:
        """Limits of all ground heights [m above sea level], median and histogram of sampled ones.

        None if no row was corrected.
        """
        low, high = self.ground_m
        if not low <= high:  # (inf, -inf): no row was corrected
            return None
        rows = self.sampled_rows()
        used = np.isfinite(rows.shift_px) & np.isfinite(rows.h_g_m)
        h_g_m = rows.h_g_m[used]
        weight = rows.weight[used]
        bin_m = (high - low) / _GROUND_BINS
        step = round_step(max(bin_m, _FINEST_GROUND_BIN_M))
        first = math.floor(low / step)
        bin_number = np.floor(h_g_m / step).astype(np.int64) - first
        weights = np.bincount(bin_number, weight)
        counts = np.round(weights).astype(np.int64)
        return GroundHeightsRecord(
            median_m=weighted_quantile(h_g_m, weight, 0.5),
            lowest_m=round(low, 2),
            highest_m=round(high, 2),
            histogram=GroundHistogram(round(first * step, 6), step, counts.tolist()),
        )

    def report_flagged(
        self, ledger: Ledger, causes: Mapping[str, str], *, explained: Collection[str] = ()
    ) -> None:
        """Add an entry to the ledger for each kind of unusable value and each status but ok.

        causes : the likely cause of each status, in words.
        explained : statuses that follow from other losses of the ledger; their entries are notes.
        """
        if self.no_distance:
            where = "observations.columns.distance_m"
            ledger.add(messages.slant_ranges_invalid(where=where, count=self.no_distance))
        if self.no_sigma:
            where = "ground.sigma_column"
            ledger.add(messages.ground_sigmas_invalid(where=where, count=self.no_sigma))
        if self.no_point:
            where = "ground.height.points"
            ledger.add(messages.points_missing(where=where, count=self.no_point, rows=self.rows))
        if self.implausible_heights:
            ledger.add(
                messages.ground_heights_invalid(
                    where="ground.height",
                    count=self.implausible_heights,
                    low=LOWEST_GROUND_M,
                    high=HIGHEST_GROUND_M,
                )
            )
        if self.no_image:
            ledger.add(
                messages.image_names_missing(
                    where="observations.columns.image",
                    count=self.no_image,
                    total=self.rows,
                    first=self.first_no_image,
                )
            )
        counts = dict(self.status)
        counts["no_station"] = counts.get("no_station", 0) - self.no_image
        for status, count in counts.items():
            if status != "ok" and count > 0:
                message = self.status_message(status, count, causes.get(status, ""))
                if status in explained:
                    message = replace(message, kind=Kind.NOTE)
                ledger.add(message)

    def status_message(self, status: str, count: int, cause: str) -> Message:
        """The message that ``count`` rows have a status other than ok.

        It names the likely ``cause``, unless this is empty, and the first rows.
        """
        examples = ", ".join(self.examples.get(status, []))
        words: dict[str, Any] = {
            "total": self.rows,
            "status": status,
            "cause": f": {cause}" if cause else "",
            "examples": f"; first {examples}" if examples else "",
        }
        if status == "several_crossings":
            return messages.several_crossings(where="ground.height", count=count, **words)
        if status == "beyond_grazing":
            return messages.observations_beyond_grazing(count=count, **words)
        if status == "far_branch":
            return messages.observations_on_far_branch(count=count, **words)
        return messages.observations_flagged(count=count, **words)


def sigma_parts(corrections: Corrections, rows: NDArray[np.intp]) -> Array:
    """(n, 4) standard deviations [px] of the ``rows`` (n,), a column for each of `SIGMA_PARTS`.

    Those of x and y are added in squares. NaN if the corrections have no standard deviations.
    """
    if corrections.sigmas is None:
        return np.full((rows.size, len(SIGMA_PARTS)), np.nan)
    columns = corrections.sigmas._asdict()
    parts = []
    for name in SIGMA_PARTS:
        sigma_x = columns[f"{name}_dx_px"][rows]
        sigma_y = columns[f"{name}_dy_px"][rows]
        parts.append(np.hypot(sigma_x, sigma_y))
    return np.stack(parts, axis=1).astype(np.float64)


def _squares(*columns: NDArray[np.float32]) -> float:
    """The sum of the squares of all numbers in the columns; NaN is left out."""
    return sum(float(np.nansum(np.square(column, dtype=np.float64))) for column in columns)


def sigma_records(
    sigmas_px: Mapping[str, Array], *, metres_per_px: Array, weight: Array
) -> dict[str, SigmaRecord]:
    """Median and 95 % quantile of each part of sigma; a part without known values is left out.

    ``sigmas_px`` has (n,) standard deviations by part; ``metres_per_px``, ``weight`` (n,).
    """
    records = {}
    for part, sigma_px in sigmas_px.items():
        if np.isfinite(sigma_px).any():
            records[part] = SigmaRecord(
                px=median_and_p95(sigma_px, weight),
                m=median_and_p95(sigma_px * metres_per_px, weight),
            )
    return records
