"""The results of a run in its manifest: records that the stages write and reports read.

Numbers are rounded to their significant digits; None is unknown. ``row()`` is a record as plain
values, under the names of its fields.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from unbend.messages import MessageRecord
from unbend.units import ARCSEC

if TYPE_CHECKING:  # scipy, which commands on one ray do not need
    from unbend.refraction.effect import Effect


@dataclass(frozen=True)
class LogRecord:
    """The decoded log: messages by type, how much was damaged, and the source of its time."""

    format: str
    messages: Mapping[str, int]
    bad_bytes: int
    lost_messages: int
    boots: int
    duration_s: float
    time_base: str


@dataclass(frozen=True)
class FlownCamera:
    """A camera at its exposures.

    ``height_above_ground_m`` is [lowest, median, highest]. ``nadir_px`` is the pixel of the nadir
    for the median of the camera axis, None if it is outside the image. Pixels count from the outer
    corner of the upper left one. ``principal_point_px`` is None in runs of older versions.
    """

    exposures: int
    format_px: list[int]
    principal_distance_px: float
    height_above_ground_m: list[float] | None
    axis_nadir_angle_deg: float | None
    nadir_px: list[float] | None
    principal_point_px: list[float] | None = None


@dataclass(frozen=True)
class FlightRecord:
    """Times and places of the exposures; places as [lowest, median, highest]."""

    begin_utc: str | None
    end_utc: str | None
    latitude_deg: list[float] | None
    longitude_deg: list[float] | None
    h_msl_m: list[float] | None
    cameras: Mapping[str, FlownCamera]


@dataclass(frozen=True)
class GroundReference:
    """The reference of the ground heights, and the coordinate system of a table of points."""

    reference: str
    crs: str | None


@dataclass(frozen=True)
class UndulationRecord:
    """The source of the geoid undulations, and their lowest and highest at the stations [m]."""

    source: str
    min_m: float | None
    max_m: float | None


@dataclass(frozen=True)
class DeflectionRecord:
    """The deflection of the vertical by a geoid, as the median of the stations.

    ``applies`` is True if the attitudes refer to the vertical, as those of a log do.
    """

    geoid: str | None
    north_arcsec: float | None
    east_arcsec: float | None
    applies: bool


@dataclass(frozen=True)
class HeightsRecord:
    """The references of all heights, the undulation that relates them, and the deflection."""

    all: str
    log: list[str]
    stations: str | None
    ground: GroundReference
    take_off_h_msl_m: float | None
    undulation: UndulationRecord
    deflection: DeflectionRecord


@dataclass(frozen=True)
class SensorRecord:
    """An estimated error of a sensor, its sigma, and the sigma that is usual for such a sensor."""

    what: str
    value: float
    sigma: float
    expected_sigma: float


@dataclass(frozen=True)
class TimeWindowRecord:
    """A part of a flight with a separate estimate of the air.

    ``change`` is that of R as a share of R of the whole flight, with its ``sigma``; ``why_not`` is
    empty if the part gets a profile, else the reason.
    """

    start_utc: str | None
    end_utc: str | None
    change: float
    sigma: float
    why_not: str


@dataclass(frozen=True)
class EffectRecord:
    """R of one ray in the air of the flight and in the standard atmosphere.

    ``factor`` is the ratio of the two. Sigmas are None if they are unknown.
    """

    nadir_angle_deg: float
    h_c_m: float
    h_g_m: float
    r_c_arcsec: float
    standard_arcsec: float
    sigma_arcsec: float | None
    factor: float
    sigma_factor: float | None

    @classmethod
    def of(cls, effect: Effect) -> EffectRecord:
        """The record of an effect, with rounded numbers."""
        is_sigma_known = math.isfinite(effect.sigma_rad)
        return cls(
            nadir_angle_deg=effect.nadir_deg,
            h_c_m=round(effect.h_c_m, 1),
            h_g_m=round(effect.h_g_m, 1),
            r_c_arcsec=round(effect.r_c_rad / ARCSEC, 4),
            standard_arcsec=round(effect.standard_rad / ARCSEC, 4),
            sigma_arcsec=round(effect.sigma_rad / ARCSEC, 4) if is_sigma_known else None,
            factor=round(effect.factor, 5),
            sigma_factor=round(effect.sigma_factor, 5) if is_sigma_known else None,
        )


@dataclass(frozen=True)
class FittedSource:
    """A source of measurements that the estimate of the air was fitted to, and how well it fits."""

    source: str
    used: bool
    quantity: str
    readings: int
    rms_sigma: float
    sigma_inflation: float
    degrees_of_freedom_for_signal: float


@dataclass(frozen=True)
class OtherSource:
    """A source of the air that was used without a fit, or the reason why it was not used."""

    source: str
    used: bool
    why_not: str


@dataclass(frozen=True)
class SamplesRecord:
    """How many samples of a sensor were used, and how many were rejected for each reason."""

    sensor: str
    quantity: str
    samples: int
    used: int
    rejected: Mapping[str, int]


@dataclass(frozen=True)
class ProfileRecord:
    """The estimate of the air, its sources, and its difference from the standard atmosphere."""

    basis: str
    reason: str
    standard: str
    layers: Mapping[str, int]
    latitude_deg: float | None
    departure_at_cameras_k: float | None
    effect: list[EffectRecord]
    sources: list[FittedSource | OtherSource]
    samples: list[SamplesRecord]
    sensors: list[SensorRecord]
    profiles: int
    windows: list[TimeWindowRecord]
    sigma_departure_at_cameras_k: float | None = None


@dataclass(frozen=True)
class ObservationsRecord:
    """Numbers of rows and parts of the observations, rows by status, and causes by status."""

    rows: int
    parts: int
    status: Mapping[str, int]
    causes: Mapping[str, str]


@dataclass(frozen=True)
class DistributionRecord:
    """Quantiles of the magnitudes of some values; None if there are no values."""

    count: int
    median: float | None
    p95: float | None
    maximum: float | None


@dataclass(frozen=True)
class HistogramRecord:
    """Counts in bins of the width ``step``, the first from zero on."""

    step: float
    counts: list[int]


@dataclass(frozen=True)
class ShiftField:
    """The mean shift (dx, dy) [px] of the observations in each cell of an image.

    (x, y) [px] are the centres of the cells; a row has ``columns`` cells.
    """

    format_px: list[int]
    columns: int
    x_px: list[float]
    y_px: list[float]
    dx_px: list[float]
    dy_px: list[float]


@dataclass(frozen=True)
class CameraShifts:
    """The size of the correction in the images of a camera."""

    shift_px: DistributionRecord
    shift_ground_m: DistributionRecord
    refraction_arcsec: DistributionRecord
    window_arcsec: DistributionRecord
    histogram_px: HistogramRecord
    histogram_m: HistogramRecord
    field: ShiftField


@dataclass(frozen=True)
class CorrectionRecord:
    """The size of the correction, for all observations and for each camera."""

    shift_px: DistributionRecord
    shift_ground_m: DistributionRecord
    refraction_arcsec: DistributionRecord
    window_arcsec: DistributionRecord
    cameras: Mapping[str, CameraShifts]


@dataclass(frozen=True)
class Quantiles:
    """The median and the 95th percentile of sampled rows."""

    median: float | None
    p95: float | None


@dataclass(frozen=True)
class SigmaRecord:
    """A part of the standard deviation of a correction, in the image and on the ground."""

    px: Quantiles
    m: Quantiles


@dataclass(frozen=True)
class GroundHistogram:
    """Counts of ground heights in bins of the width ``step``, the first from ``first_m`` on."""

    first_m: float
    step: float
    counts: list[int]


@dataclass(frozen=True)
class GroundHeightsRecord:
    """The range of all ground heights [m above sea level], median and histogram of a sample."""

    median_m: float | None
    lowest_m: float
    highest_m: float
    histogram: GroundHistogram


@dataclass(frozen=True)
class AirParameter:
    """The one parameter of the leading mode of the air's covariance; ``meaning`` explains it."""

    scale_sigma: float
    variance_share: float
    profiles: int
    meaning: str


@dataclass(frozen=True)
class CabinParameter:
    """The refractivity of the air in a cabin, and its standard deviation, None if unknown."""

    n_cc: float
    sigma_n_cc: float | None


@dataclass(frozen=True)
class CameraAirRecord:
    """The wavelength of a camera, and the effects of the air in front of and in its lens.

    ``before_lens`` is outside, window or opening; ``kelvin_share`` is the deflection by air there
    that is 1 K warmer, divided by R, both at 45 degrees. ``lens_ppm`` is the change of the
    principal distance by the air in the lens; ``lens_sigma_ppm`` is known only for a typical lens.
    ``lens_height_m`` and ``lens_edge_px`` are the effects of this change on heights, and at the
    corners of the image. ``lens_removed``: whether the corrections remove it.
    """

    before_lens: str
    kelvin_share: float | None
    wavelength_m: float
    lens_removed: bool
    lens_ppm: float
    lens_sigma_ppm: float | None
    lens_height_m: float | None
    lens_edge_px: float
    calibrated_in_flight: bool


@dataclass(frozen=True)
class ControlPoint:
    """A control point: intersected minus stated position, [east, north, up] in metres.

    ``before_m`` is from measured and ``after_m`` from corrected observations.
    """

    point: str
    rays: int
    before_m: list[float | None]
    after_m: list[float | None]
    sigma_u_m: float | None


@dataclass(frozen=True)
class ControlRecord:
    """Control points before and after the correction, with root mean squares and means.

    Vectors are [east, north, up] in metres. ``rms_refraction_m`` is by how much the correction
    moves the points, ``part_explained`` the share of the mean square residual that it removes.
    """

    points: list[ControlPoint]
    used: int
    unmeasured: int
    rms_before_m: list[float]
    rms_after_m: list[float]
    rms_refraction_m: list[float]
    mean_before_m: list[float]
    mean_after_m: list[float]
    part_explained: float
    sigma_u_m: float | None


@dataclass(frozen=True)
class ResultsRecord:
    """All results of a mission that the manifest contains."""

    log: LogRecord | None
    channels: Mapping[str, str]
    stations: Mapping[str, int]
    flight: FlightRecord
    heights: HeightsRecord
    profile: ProfileRecord
    observations: ObservationsRecord
    correction: CorrectionRecord
    sigma_budget: Mapping[str, Mapping[str, SigmaRecord]]
    ground_heights: GroundHeightsRecord | None
    uncertainty: AirParameter | None
    cabin_air: Mapping[str, CabinParameter]
    cabin_sigma_share: DistributionRecord
    control: ControlRecord | None
    ledger: list[MessageRecord]
    exit_code: int
    air_at_cameras: Mapping[str, CameraAirRecord] = field(default_factory=dict)

    def row(self) -> dict[str, Any]:
        """The record as plain values."""
        return asdict(self)
