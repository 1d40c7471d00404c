"""Counts of the observations and the size of their corrections, by part and in total."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.config.sections import HIGHEST_GROUND_M, LOWEST_GROUND_M
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Corrections
from pipeline.refraction.statistics import DISTRIBUTIONS, Distribution, ShiftGrid, ShiftStatistics
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.tables.observations import Batch
from pipeline.units import Array

SAMPLED_ROWS = 20_000
"""Rows that stand for all others, where what is plausible is looked at."""


class SampledRows(NamedTuple):
    """Rows that stand for all; (n,) each.

    ``station`` is -1 where an image has none; ``weight`` how many rows each stands for.
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

    @classmethod
    def of(
        cls,
        batch: Batch,
        corrections: Corrections,
        h_g: Array,
        station: NDArray[np.int64],
        most: int,
    ) -> SampledRows:
        """Rows of a batch, evenly spaced."""
        rows = evenly_spaced(len(batch), most)
        nothing = np.full(len(batch), np.nan)
        weight = np.ones(len(batch)) if batch.weight is None else batch.weight
        distance = nothing if batch.distance_m is None else batch.distance_m
        return cls(
            station[rows],
            batch.x_px[rows],
            batch.y_px[rows],
            h_g[rows],
            distance[rows],
            corrections.zeta_c_rad[rows],
            corrections.r_c_rad[rows],
            np.hypot(corrections.dx_px, corrections.dy_px)[rows],
            corrections.shift_ground_m[rows],
            corrections.status[rows],
            weight[rows] * len(batch) / rows.size,
        )


@dataclass
class Statistics:
    """Counts of observations, and how large the corrections were in each camera.

    ``air_variance`` : of all corrections by the air, and ``by_mode`` the squares of their
    derivatives by the parameter of the leading mode [px2].
    ``sampled`` : rows of each part, of which `SAMPLED_ROWS` stand for all.
    ``cabin_share`` : sigma of R_cc by the air in the cabin as a share of R_c.
    """

    shifts: dict[str, ShiftStatistics]
    rows: int = 0
    parts: int = 0
    status: dict[str, int] = field(default_factory=dict)
    no_distance: int = 0
    no_sigma: int = 0
    no_point: int = 0
    implausible_heights: int = 0
    air_variance: float = 0.0
    by_mode: float = 0.0
    sampled: list[SampledRows] = field(default_factory=list)
    cabin_share: Distribution = field(default_factory=Distribution)

    @classmethod
    def of(cls, cameras: Mapping[str, Camera]) -> Statistics:
        """Those of no observations."""
        grids = {n: ShiftGrid(c.width_px, c.height_px) for n, c in cameras.items()}
        return cls({name: ShiftStatistics(grid) for name, grid in grids.items()})

    def add(self, batch: Batch, corrections: Corrections, camera: NDArray[np.int64]) -> None:
        """Count a batch; ``camera`` (n,) numbers the cameras, -1 without one."""
        rows = len(batch) if batch.weight is None else round(batch.weight.sum())
        self.rows += rows
        self.no_distance += round(batch.no_distance * rows / len(batch))
        self.no_sigma += round(batch.no_sigma * rows / len(batch))
        self.no_point += round(batch.no_point * rows / len(batch))
        self.parts += 1
        if corrections.sigmas is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                self.cabin_share.add(corrections.sigmas.r_cc_rad / np.abs(corrections.r_c_rad))
            columns = corrections.sigmas.columns()
            self.air_variance += _squares(columns["air_dx_px"], columns["air_dy_px"])
            self.by_mode += _squares(columns["dx_ds_px"], columns["dy_ds_px"])
        counts = np.bincount(corrections.status, batch.weight, minlength=len(STATUS_NAMES))
        for name, count in zip(STATUS_NAMES, counts.tolist(), strict=True):
            self.status[name] = self.status.get(name, 0) + round(count)
        for number, shift_statistics in enumerate(self.shifts.values()):
            rows = camera == number
            if bool(rows.all()):
                shift_statistics.add(batch.x_px, batch.y_px, corrections)
            elif bool(rows.any()):
                shift_statistics.add(batch.x_px[rows], batch.y_px[rows], corrections.rows(rows))

    def sampled_rows(self) -> SampledRows:
        """The rows that stand for all."""
        return SampledRows(*map(np.concatenate, zip(*self.sampled, strict=True)))

    def merge(self, other: Statistics) -> None:
        """Add the counts of another part."""
        self.rows += other.rows
        self.no_distance += other.no_distance
        self.no_sigma += other.no_sigma
        self.no_point += other.no_point
        self.implausible_heights += other.implausible_heights
        self.air_variance += other.air_variance
        self.by_mode += other.by_mode
        self.sampled += other.sampled
        self.cabin_share += other.cabin_share
        self.parts += other.parts
        for name, count in other.status.items():
            self.status[name] = self.status.get(name, 0) + count
        for name, shift_statistics in other.shifts.items():
            self.shifts[name].merge(shift_statistics)

    def correction(self) -> dict[str, Any]:
        """How large the correction was, over all and camera by camera, for the manifest."""
        together = {
            name: sum(
                (e.distributions()[name] for e in self.shifts.values()), Distribution()
            ).summary()
            for name in DISTRIBUTIONS
        }
        return together | {"cameras": {n: e.summary() for n, e in self.shifts.items()}}

    def report_flagged(self, ledger: Ledger, causes: Mapping[str, str]) -> None:
        """A ledger entry for each reason why observations were not corrected.

        ``causes`` by status: what likely led to it.
        """
        if self.no_distance:
            ledger.warning(
                "OBS-DISTANCE",
                f"{self.no_distance} slant ranges are zero, negative, infinite or no number: taken "
                "as absent",
                where="observations.columns.distance_m",
                count=self.no_distance,
            )
        if self.no_sigma:
            text = (
                f"{self.no_sigma} standard deviations of ground heights are negative, infinite or "
                "no number: taken as unknown"
            )
            ledger.warning("OBS-SIGMA", text, where="ground.sigma_column", count=self.no_sigma)
        if self.no_point:
            text = (
                f"{self.no_point} of {self.rows} observations are of points that the table of "
                "object points has not: they are no_ground"
            )
            ledger.loss("POINTS-MISSING", text, where="ground.height.points", count=self.no_point)
        if self.implausible_heights:
            ledger.loss(
                "OBS-GROUND-RANGE",
                f"{self.implausible_heights} heights of points are below {LOWEST_GROUND_M:.0f} or "
                f"above {HIGHEST_GROUND_M:.0f} m, where no ground is: taken as unknown, their "
                "points are no_ground",
                where="ground.height",
                count=self.implausible_heights,
            )
        for name, count in self.status.items():
            what = f"{count} of {self.rows} observations are {name}"
            if name == "ok" or count == 0:
                continue
            what += f": {causes[name]}" if causes.get(name) else ""
            if name == "beyond_grazing":
                ledger.loss("OBS-BEYOND-GRAZING", what + "; near branch used", count=count)
            elif name == "several_crossings":
                what += ": behind a ridge they would leave the ground again; the first place where "
                what += "they meet it was used, which an error of the model's heights may change"
                ledger.warning("OBS-SEVERAL-CROSSINGS", what, where="ground.height", count=count)
            elif name == "far_branch":
                ledger.note("OBS-FAR-BRANCH", what + ", by their slant range", count=count)
            else:
                ledger.loss("OBS-FLAGGED", what, count=count)


def _squares(*columns: NDArray[np.float32]) -> float:
    """The sum of the squares of numbers, those that are none left out."""
    return sum(float(np.nansum(np.square(column, dtype=np.float64))) for column in columns)


def evenly_spaced(count: int, most: int) -> NDArray[np.intp]:
    """At most ``most`` indices below ``count``, evenly spaced.

    >>> evenly_spaced(9, 3).tolist()
    [0, 4, 8]
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))
