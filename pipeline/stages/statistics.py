"""Counts of the observations and the size of their corrections, by part and in total."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.config.sections import HIGHEST_GROUND_M, LOWEST_GROUND_M
from pipeline.ledger import Ledger
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Corrections
from pipeline.refraction.statistics import DISTRIBUTIONS, Distribution, ShiftGrid, ShiftStatistics
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.tables.observations import Batch

Array = NDArray[np.float64]

_MOST_RAYS = 400


@dataclass
class Statistics:
    """Counts of observations, and how large the corrections were in each camera.

    ``rays`` : (6, m) arrays of rays that stand for the others, as `sampled_rays` returns them.
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
    rays: list[Array] = field(default_factory=list)
    cabin_share: Distribution = field(default_factory=Distribution)

    @classmethod
    def of(cls, cameras: Mapping[str, Camera]) -> Statistics:
        """Those of no observations."""
        grids = {n: ShiftGrid(c.width_px, c.height_px) for n, c in cameras.items()}
        return cls({name: ShiftStatistics(grid) for name, grid in grids.items()})

    def add(self, batch: Batch, corrections: Corrections, camera: NDArray[np.int64]) -> None:
        """Count a batch; ``camera`` (n,) numbers the cameras, -1 without one."""
        self.rows += len(batch)
        self.no_distance += batch.no_distance
        self.no_sigma += batch.no_sigma
        self.no_point += batch.no_point
        self.parts += 1
        if corrections.sigmas is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                self.cabin_share.add(corrections.sigmas.r_cc_rad / np.abs(corrections.r_c_rad))
        counts = np.bincount(corrections.status, minlength=len(STATUS_NAMES))
        for name, count in zip(STATUS_NAMES, counts.tolist(), strict=True):
            self.status[name] = self.status.get(name, 0) + int(count)
        for number, shift_statistics in enumerate(self.shifts.values()):
            rows = camera == number
            if bool(rows.all()):
                shift_statistics.add(batch.x_px, batch.y_px, corrections)
            elif bool(rows.any()):
                shift_statistics.add(batch.x_px[rows], batch.y_px[rows], corrections.rows(rows))

    def sampled_rays(self) -> Array:
        """(6, n) at most 400 of the sampled rays.

        Rows: height of camera and of target [m], nadir angle [rad], and the three arrays of
        `RayWindows`.
        """
        rays = np.concatenate([np.empty((6, 0)), *self.rays], axis=1)
        return np.asarray(rays[:, evenly_spaced(rays.shape[1], _MOST_RAYS)])

    def merge(self, other: Statistics) -> None:
        """Add the counts of another part."""
        self.rows += other.rows
        self.no_distance += other.no_distance
        self.no_sigma += other.no_sigma
        self.no_point += other.no_point
        self.implausible_heights += other.implausible_heights
        self.rays += other.rays
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

    def report_flagged(self, ledger: Ledger) -> None:
        """A ledger entry for each reason why observations were not corrected."""
        if self.no_distance:
            ledger.warning(
                "OBS-DISTANCE",
                f"{self.no_distance} slant ranges are zero, negative, infinite or no number: taken "
                "as absent",
                where="observations.columns.distance_m",
                count=self.no_distance,
            )
        if self.no_sigma:
            ledger.warning(
                "OBS-SIGMA",
                f"{self.no_sigma} standard deviations of ground heights are negative, infinite or "
                "no number: taken as unknown",
                where="ground.sigma_column",
                count=self.no_sigma,
            )
        if self.no_point:
            ledger.loss(
                "POINTS-MISSING",
                f"{self.no_point} of {self.rows} observations are of points that the table of "
                "object points has not: they are no_ground",
                where="ground.height.points",
                count=self.no_point,
            )
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
            if name == "beyond_grazing":
                ledger.loss("OBS-BEYOND-GRAZING", what + ": near branch used", count=count)
            elif name == "far_branch":
                ledger.note("OBS-FAR-BRANCH", what + ", by their slant range", count=count)
            else:
                ledger.loss("OBS-FLAGGED", what, count=count)


def evenly_spaced(count: int, most: int) -> NDArray[np.intp]:
    """At most ``most`` indices below ``count``, evenly spaced.

    >>> evenly_spaced(9, 3).tolist()
    [0, 4, 8]
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))
