"""The summary of ``unbend check``: inputs of a mission, and what a run would do, in ten lines."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.batch.runs import CheckedMission
from unbend.config.stated_nulls import cameras_of_stated_null
from unbend.flight.stations import NO_TIME
from unbend.refraction.calibration import field_of_view
from unbend.refraction.image import Corrections
from unbend.refraction.ray import rays_by
from unbend.report.summary import control_sentence, effect_lines
from unbend.stages.correction import correct_batch
from unbend.stages.correction_setup import CorrectionSetup, GroundHeights
from unbend.stages.flight_date import stated_date
from unbend.stages.plausibility.facts import Facts
from unbend.stages.results import utc_second
from unbend.stages.story import CorrectedMission
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.manifest.results import EffectRecord
from unbend.tables.observations import Batch
from unbend.units import ARCSEC, Array, Integers, evenly_spaced

_ROWS = 1000  # of the sample, which `changes_text` corrects several times

_SAME_UNDULATION_M = 0.1
"""Up to this difference the undulation of the log counts as equal to the stated one."""

_WIDEST_DEG = 85.0  # off the axis: limits the footprint of a fisheye that sees the horizon
_SMALLEST_COSINE = 0.02  # of the angle between axis and nadir: limits the distance to the ground

# Changes that `changes_text` applies to ground, cameras and air, one at a time.
_MORE_GROUND_M = 10.0  # higher ground
_MORE_HEIGHT_M = 10.0  # higher cameras
_MORE_TILT_DEG = 0.5
_WARMER_K = 5.0

Line = tuple[str, str]
"""A label and its text."""


def input_lines(checked: CheckedMission) -> list[Line]:
    """The inputs of a mission, each with its label."""
    stations = checked.corrected.stations
    prepared = checked.corrected.prepared
    flight = prepared.flight
    log = "none: the stations and the air come from other sources"
    if flight.log is not None:
        log = f"{checked.plan.input('log').name}: {flight.log.format}"
    channels = []
    for role, channel in sorted(flight.roles.items()):
        channels.append(f"{role.replace('_', ' ')} {channel.name}")
    counts = Counter(stations.camera[stations.ok].tolist())
    cameras = [f"{number} of {name}" for name, number in counts.items()]
    images = len(prepared.observations.images)
    return [
        ("log", log),
        ("channels", ", ".join(channels) or "none"),
        ("stations", ", ".join(cameras) or "none"),
        ("observations", f"{prepared.observations.rows:,} in {images} images"),
        *prepared.sources.lines(),
        ("results", str(checked.plan.output)),
    ]


def rehearsal_lines(checked: CheckedMission) -> list[Line]:
    """The expected properties of a run, from corrections of a sample; each line with its label."""
    corrected = checked.corrected
    facts = corrected.facts
    lines = [
        ("datum", datum_text(corrected)),
        ("heights", heights_text(facts)),
        ("cameras", "; ".join(camera_text(facts, name) for name in facts.cameras)),
        ("nadir angles", f"{spans_by_camera(facts, np.degrees(facts.nadir_angle_rad), 2)} deg"),
        ("time", times_text(corrected)),
        ("shift", shift_text(facts)),
        ("changes by", changes_text(corrected)),
        ("rows", rows_text(corrected)),
        ("vertical", deflection_text(facts)),
        ("air", air_text(facts)),
    ]
    control = control_sentence(checked.manifest)
    if control:
        lines.append(("control", control))
    return lines


def datum_text(corrected: CorrectedMission) -> str:
    """The reference surfaces of the heights of cameras and ground, and the undulation of the geoid.

    The undulation [m] is the ellipsoidal height less the height above sea level of the stations.
    """
    facts = corrected.facts
    heights = corrected.prepared.flight.heights
    height_channel = corrected.prepared.flight.roles.get("height")
    height_source = "no channel"
    if height_channel is not None:
        height_source = height_channel.name
    elif facts.mission.stations.orientation is not None:
        height_source = "orientation"
    undulation = (facts.stations.h_ellipsoid_m - facts.stations.h_msl_m)[facts.stations.ok]
    known_undulation = undulation[np.isfinite(undulation)]
    undulation_source = heights.source
    stated_undulation_m = heights.undulation_m
    if stated_undulation_m is not None and known_undulation.size:
        is_stated = abs(np.median(known_undulation) - stated_undulation_m) <= _SAME_UNDULATION_M
        if not is_stated:
            undulation_source = (
                f"the log's own, not the {stated_undulation_m:g} m of {heights.source}"
            )
    reference = facts.mission.ground.reference
    return (
        f"cameras by {height_source}, ground {reference}, all above mean sea level; "
        f"undulation {_span(undulation, 4)} m ({undulation_source})"
    )


def heights_text(facts: Facts) -> str:
    """Heights of ground, take-off and cameras."""
    take_off = "unknown" if facts.takeoff is None else f"{facts.takeoff.h_msl_m:.0f} m"
    above_ground = facts.camera_height_m - facts.rows.h_g_m
    camera_heights = facts.stations.h_msl_m[facts.stations.ok]
    return (
        f"ground {_span(facts.rows.h_g_m, 4)} m, take-off {take_off}, cameras "
        f"{_span(camera_heights, 5)} m; above ground {_span(above_ground, 4)} m"
    )


def shift_text(facts: Facts) -> str:
    """How far the corrections move image points [px] and points on the ground [m], by camera."""
    pixels = spans_by_camera(facts, facts.rows.shift_px, 3)
    ground = spans_by_camera(facts, facts.rows.shift_ground_m, 3)
    return f"{pixels} px; {ground} m on the ground"


def rows_text(corrected: CorrectedMission) -> str:
    """How many rows of each status are expected."""
    statistics = corrected.statistics
    counts = [f"{number:,} {status}" for status, number in statistics.status.items() if number]
    return f"{', '.join(counts)}, expected of {statistics.rows:,}"


def air_text(facts: Facts) -> str:
    """The refraction of one ray in the flight's air, compared with the standard atmosphere."""
    effects = [EffectRecord.of(effect) for effect in facts.effects[:1]]
    lines = effect_lines(effects, facts.adjustment.standard.name)
    return "; ".join(lines) or "no ray points down"


def spans_by_camera(facts: Facts, values: Array, digits: int) -> str:
    """The lowest and highest of ``values`` (n,) of the sampled rows, for each camera.

    ``digits`` is the number of significant digits.
    """
    spans = {name: _span(facts.of_camera(name, values), digits) for name in facts.cameras}
    return _by_camera(spans)


def _span(values: Array, digits: int) -> str:
    """The lowest and highest finite value, as "2 to 5"; "unknown" if none is finite."""
    finite_values = values[np.isfinite(values)]
    if not finite_values.size:
        return "unknown"
    lowest = _rounded(finite_values.min(), digits)
    highest = _rounded(finite_values.max(), digits)
    return lowest if lowest == highest else f"{lowest} to {highest}"


def _rounded(value: float, digits: int) -> str:
    """A number with so many significant digits; from 10,000 on an integer, never an exponent."""
    return f"{value:.{digits}g}" if abs(value) < 1e4 else f"{value:.0f}"


def _by_camera(texts: Mapping[str, str]) -> str:
    """The texts of cameras, by their names, in one line."""
    return ", ".join(f"{name} {text}" for name, text in texts.items())


def camera_text(facts: Facts, name: str) -> str:
    """Field of view of a camera, ground sampling distance, and footprint across its axis.

    Sampling distance and footprint are computed at the distance to the ground along the axis, from
    the median height above ground.
    """
    camera = facts.cameras[name]
    above_ground = facts.of_camera(name, facts.camera_height_m - facts.rows.h_g_m)
    height_m = float(np.median(above_ground)) if above_ground.size else math.nan
    cosine = math.cos(math.radians(facts.axis_deg(name)))
    distance_m = height_m / max(cosine, _SMALLEST_COSINE)
    angles = []
    sizes = []
    for view_rad in field_of_view(camera):  # horizontal, vertical
        half_rad = min(view_rad / 2.0, math.radians(_WIDEST_DEG))
        angles.append(f"{math.degrees(view_rad):.0f}")
        sizes.append(f"{distance_m * 2.0 * math.tan(half_rad):.0f}")
    text = (
        f"{name} {' x '.join(angles)} deg, {distance_m / camera.fx_px:.2g} m a pixel, "
        f"{' x '.join(sizes)} m across the axis"
    )
    if name in cameras_of_stated_null(facts.mission):
        text += ", no window (stated)"
    return text


def times_text(corrected: CorrectedMission) -> str:
    """The first and last time of the log and of the exposures; else the stated date."""
    exposures = corrected.stations.time_ns
    times = {
        "log": corrected.prepared.track().time_ns,
        "events": exposures[exposures != NO_TIME],
    }
    parts = []
    from_boot = bool(corrected.stations.from_boot.any())
    for label, values in times.items():
        if values.size and from_boot:
            first_s = values.min() / 1e9
            last_s = values.max() / 1e9
            parts.append(f"{label} {first_s:.0f} to {last_s:.0f} s after boot")
        elif values.size:
            first = utc_second(int(values.min())).removesuffix("Z").replace("T", " ")
            _, last_clock = utc_second(int(values.max())).removesuffix("Z").split("T")
            parts.append(f"{label} {first} to {last_clock} UTC")
    date = stated_date(corrected.prepared.mission)
    if not parts and date is not None:
        return f"{date}, as the mission file states"
    return "; ".join(parts) or "unknown"


def deflection_text(facts: Facts) -> str:
    """The median deflection of the vertical, and the shift on the ground if it is not removed.

    Directions that were levelled by gravity are turned by it.
    """
    ok = facts.stations.ok
    lat_rad = facts.stations.lat_rad[ok]
    lon_rad = facts.stations.lon_rad[ok]
    above_ground = facts.camera_height_m - facts.rows.h_g_m
    above_ground = above_ground[np.isfinite(above_ground)]
    if not lat_rad.size or not above_ground.size:
        return "unknown"
    north, east = package_geoid().deflection(lat_rad, lon_rad)
    deflection_rad = float(np.median(np.hypot(north, east)))
    shift_m = deflection_rad * float(np.median(above_ground))
    return (
        f"deflected by {deflection_rad / ARCSEC:.1f} arcsec (EGM96), "
        f"{shift_m:.2f} m on the ground: not removed unless the trajectory did"
    )


def changes_text(corrected: CorrectedMission) -> str:
    """How much corrections change with ground, height, tilt and air: median of each camera [px]."""
    facts = corrected.facts
    corrected_rows = np.flatnonzero(np.isfinite(facts.rows.shift_px))
    rows = corrected_rows[evenly_spaced(corrected_rows.size, _ROWS)]
    if not rows.size:
        return "unknown: no row is corrected"
    # Standard deviations are not needed here.
    setup = replace(corrected.setup, uncertainties=(None,) * len(corrected.setup.rays))
    h_g = facts.rows.h_g_m[rows]
    before = corrections_of(facts, rows, h_g, setup)
    changed = {
        f"{_MORE_GROUND_M:g} m of ground": corrections_of(facts, rows, h_g + _MORE_GROUND_M, setup)
    }
    for label, changed_setup in changed_setups(corrected, setup).items():
        changed[label] = corrections_of(facts, rows, h_g, changed_setup)
    camera = facts.camera[rows]
    texts = []
    for label, after in changed.items():
        moved_px = np.hypot(after.dx_px - before.dx_px, after.dy_px - before.dy_px)
        medians = {}
        for name in np.unique(camera):
            medians[name] = _median_text(moved_px[camera == name])
        texts.append(f"{label} {_by_camera(medians)} px")
    return "; ".join(texts)


def _median_text(moved_px: Array) -> str:
    """The median of the finite shifts among (n,) [px]; "unknown" if none is finite."""
    finite_px = moved_px[np.isfinite(moved_px)]
    if not finite_px.size:
        return "unknown"
    return f"{np.median(finite_px):.2g}"


def changed_setups(
    corrected: CorrectedMission, setup: CorrectionSetup
) -> dict[str, CorrectionSetup]:
    """Three variants of a setup by label: higher cameras, tilted cameras, warmer air."""
    exposures = setup.exposures
    higher = replace(exposures, height_m=exposures.height_m + _MORE_HEIGHT_M)
    about_x = Rotation.from_rotvec([math.radians(_MORE_TILT_DEG), 0.0, 0.0]).as_matrix()
    tilted = replace(exposures, rotation=about_x @ exposures.rotation)  # about each camera's x
    method = corrected.facts.mission.refraction.method
    warm_rays = []
    for profile in corrected.lit_air.profiles:
        warm_rays.append(rays_by(warmer(profile, _WARMER_K), method))
    return {
        f"{_MORE_HEIGHT_M:g} m of height": replace(setup, exposures=higher),
        f"{_MORE_TILT_DEG:g} deg of tilt": replace(setup, exposures=tilted),
        f"{_WARMER_K:g} K": replace(setup, rays=tuple(warm_rays)),
    }


def corrections_of(facts: Facts, rows: Integers, h_g: Array, setup: CorrectionSetup) -> Corrections:
    """Correct rows of the sample with other ground heights.

    ``rows`` (n,) are indices into the sample, ``h_g`` (n,) [m above sea level] are their heights.
    """
    x_px = facts.rows.x_px[rows]
    y_px = facts.rows.y_px[rows]
    names = pa.nulls(rows.size, pa.string())  # corrections do not depend on names
    batch = Batch(
        image=names,
        point=names,
        x_px=x_px,
        y_px=y_px,
        x_given_px=x_px,
        y_given_px=y_px,
        ground=None,
        users={},
        distance_m=facts.rows.distance_m[rows],
    )
    unknown_sigma_m = np.full(rows.size, np.nan)
    ground = GroundHeights(h_g, unknown_sigma_m)
    return correct_batch(batch, facts.rows.station[rows], ground, setup)


def warmer(profile: Profile, by_k: float) -> Profile:
    """The profile with the temperature ``by_k`` [K] higher at every height.

    The pressure at the bottom stays, that above follows from it.
    """
    layers = profile.layers
    # `layers` has the vapour at the lower edges; here it is needed at the top of the last one, too.
    top_vapour = layers.vapour[-1] + layers.vapour_slope[-1] * (layers.edge[-1] - layers.edge[-2])
    warmed = stack_layers(
        layers.edge,
        layers.edge_temperature + by_k,
        np.append(layers.vapour, top_vapour),
        layers.source,
        anchor=(float(layers.edge[0]), float(layers.pressure[0])),
        constant=profile.constant,
    )
    return replace(profile, layers=warmed)
