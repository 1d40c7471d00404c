"""What the manifest of a run says of its results: records that the stages write and others read.

Numbers are rounded to what they are worth; None is what is not known. ``row()`` is the record as
plain values, under the names of its fields.
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
    """The log that was decoded: messages by type, what was damaged, and what its time rests on."""

    format: str
    messages: Mapping[str, int]
    bad_bytes: int
    lost_messages: int
    boots: int
    duration_s: float
    time_base: str


@dataclass(frozen=True)
class FlownCamera:
    """A camera at its exposures; spreads are lowest, median and highest.

    ``nadir_px`` is the pixel of the nadir for the median axis, None where it is not in view.
    Pixels count from the corner of the upper left one. ``principal_point_px`` is None in runs of
    versions that did not write it.
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
    """When and where the exposures are; spreads are lowest, median and highest."""

    begin_utc: str | None
    end_utc: str | None
    latitude_deg: list[float] | None
    longitude_deg: list[float] | None
    h_msl_m: list[float] | None
    cameras: Mapping[str, FlownCamera]


@dataclass(frozen=True)
class GroundReference:
    """What ground heights count from, and the coordinate system of a table of points."""

    reference: str
    crs: str | None


@dataclass(frozen=True)
class UndulationRecord:
    """Where undulations come from, and their limits at the stations [m]."""

    source: str
    min_m: float | None
    max_m: float | None


@dataclass(frozen=True)
class DeflectionRecord:
    """The deflection of the vertical by a geoid, in the median of the stations."""

    geoid: str | None
    north_arcsec: float | None
    east_arcsec: float | None
    applies: bool


@dataclass(frozen=True)
class HeightsRecord:
    """What all heights count from, what relates them, and how the vertical leans there."""

    all: str
    log: list[str]
    stations: str | None
    ground: GroundReference
    take_off_h_msl_m: float | None
    undulation: UndulationRecord
    deflection: DeflectionRecord


@dataclass(frozen=True)
class SensorRecord:
    """An error of a sensor that was estimated, with its sigma and the one that is usual."""

    what: str
    value: float
    sigma: float
    expected_sigma: float


@dataclass(frozen=True)
class TimeWindowRecord:
    """A part of a flight estimated on its own: change and sigma of R against that of the flight."""

    start_utc: str | None
    end_utc: str | None
    change: float
    sigma: float
    why_not: str


@dataclass(frozen=True)
class EffectRecord:
    """R of one ray in the air of the flight, and beside that in the standard; sigma if known."""

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
        """The record of an effect."""
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
    """A source of the air that the estimate was fitted to, and how it fits."""

    source: str
    used: bool
    quantity: str
    readings: int
    rms_sigma: float
    sigma_inflation: float
    degrees_of_freedom_for_signal: float


@dataclass(frozen=True)
class OtherSource:
    """A source of the air that was used as it is, or why it was not used."""

    source: str
    used: bool
    why_not: str


@dataclass(frozen=True)
class SamplesRecord:
    """How many samples of a sensor were used; the others by the reason, in words."""

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
    """Rows and parts of the observations, rows by status, and likely causes of statuses."""

    rows: int
    parts: int
    status: Mapping[str, int]
    causes: Mapping[str, str]


@dataclass(frozen=True)
class DistributionRecord:
    """A distribution of magnitudes."""

    count: int
    median: float | None
    p95: float | None
    maximum: float | None


@dataclass(frozen=True)
class HistogramRecord:
    """Counts in bins from zero."""

    step: float
    counts: list[int]


@dataclass(frozen=True)
class ShiftField:
    """The mean shift (dx, dy) in cells of an image by their centres (x, y) [px]."""

    format_px: list[int]
    columns: int
    x_px: list[float]
    y_px: list[float]
    dx_px: list[float]
    dy_px: list[float]


@dataclass(frozen=True)
class CameraShifts:
    """How large the correction was in a camera's images."""

    shift_px: DistributionRecord
    shift_ground_m: DistributionRecord
    refraction_arcsec: DistributionRecord
    window_arcsec: DistributionRecord
    histogram_px: HistogramRecord
    histogram_m: HistogramRecord
    field: ShiftField


@dataclass(frozen=True)
class CorrectionRecord:
    """How large the correction was, over all and camera by camera."""

    shift_px: DistributionRecord
    shift_ground_m: DistributionRecord
    refraction_arcsec: DistributionRecord
    window_arcsec: DistributionRecord
    cameras: Mapping[str, CameraShifts]


@dataclass(frozen=True)
class Quantiles:
    """The median of sampled rows, and what 95 % of them do not exceed."""

    median: float | None
    p95: float | None


@dataclass(frozen=True)
class SigmaRecord:
    """A part of the standard deviation of a correction, in the image and on the ground."""

    px: Quantiles
    m: Quantiles


@dataclass(frozen=True)
class GroundHistogram:
    """Counts of ground heights in bins from the first one on."""

    first_m: float
    step: float
    counts: list[int]


@dataclass(frozen=True)
class GroundHeightsRecord:
    """Limits of all ground heights [m above sea level], median and histogram of sampled ones."""

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
    """The refractivity in a cabin, and its standard deviation."""

    n_cc: float
    sigma_n_cc: float | None


@dataclass(frozen=True)
class CameraAirRecord:
    """The light of a camera, and what the air before and in its lens does.

    ``before_lens`` is outside, window or opening; ``kelvin_share`` the part of R at 45 degrees that
    1 K there is. ``lens_ppm`` is the change of the principal distance by the air in the lens, with
    its standard deviation where it is that of a typical lens; ``lens_height_m`` and
    ``lens_edge_px`` are its size in heights, and at the corners of the image.
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
    """A control point: intersected minus given place, east, north, up [m]."""

    point: str
    rays: int
    before_m: list[float | None]
    after_m: list[float | None]
    sigma_u_m: float | None


@dataclass(frozen=True)
class ControlRecord:
    """Control points before and after the correction [m]: each one, root mean squares, means."""

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
    """All that the manifest says of the results of a mission."""

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
