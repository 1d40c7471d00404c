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
from unbend.flight.stations import NO_TIME
from unbend.refraction.calibration import field_of_view
from unbend.refraction.ray import rays_by
from unbend.report.summary import control_sentence, effect_lines
from unbend.stages.correction import correct_batch
from unbend.stages.correction_setup import GroundHeights
from unbend.stages.plausibility.facts import Facts
from unbend.stages.results import utc_second
from unbend.stages.story import CorrectedMission
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.observations import Batch
from unbend.units import ARCSEC, Array, evenly_spaced

_ROWS = 1000


def input_lines(checked: CheckedMission) -> list[tuple[str, str]]:
    """The inputs of a mission, each with its label."""
    stations = checked.corrected.stations
    prepared = checked.corrected.prepared
    flight, log = prepared.flight, "none: the stations come from elsewhere, and so does the air"
    channels = ", ".join(
        f"{role.replace('_', ' ')} {channel.name}" for role, channel in sorted(flight.roles.items())
    )
    cameras = Counter(stations.camera[stations.ok].tolist())
    images = len(prepared.observations.images)
    if flight.log is not None:
        log = f"{checked.plan.input('log').name}: {flight.log.format}"
    return [
        ("log", log),
        ("channels", channels or "none"),
        ("stations", ", ".join(f"{n} of {name}" for name, n in cameras.items()) or "none"),
        ("observations", f"{prepared.observations.rows:,} in {images} images"),
        *prepared.sources.lines(),
        ("results", str(checked.plan.output)),
    ]


def rehearsal_lines(checked: CheckedMission) -> list[tuple[str, str]]:
    """What a run would do, each line with its label."""
    facts, prepared = checked.corrected.facts, checked.corrected.prepared
    mission, heights = facts.mission, prepared.flight.heights
    ok, home = facts.stations.ok, facts.takeoff
    undulation = (facts.stations.h_ellipsoid_m - facts.stations.h_msl_m)[ok]
    known = undulation[np.isfinite(undulation)]
    height_role = prepared.flight.roles.get("height")
    source = "orientation" if mission.stations.orientation is not None else "no channel"
    source = source if height_role is None else height_role.name
    stated, of_undulation = heights.undulation_m, heights.source
    if stated is not None and known.size and abs(np.median(known) - stated) > 0.1:
        of_undulation = f"the log's own, not the {stated:g} m of {heights.source}"

    def spans(values: Array, digits: int) -> str:
        return _by_camera({n: _span(facts.of_camera(n, values), digits) for n in facts.cameras})

    rows = (f"{n:,} {k}" for k, n in checked.corrected.statistics.status.items() if n)
    taken = "unknown" if home is None else f"{home.h_msl_m:.0f} m"
    above, control = facts.camera_height_m - facts.rows.h_g_m, control_sentence(checked.manifest)
    return [
        ("datum", f"cameras by {source}, ground {mission.ground.reference}, all above mean sea "
         f"level; undulation {_span(undulation, 4)} m ({of_undulation})"),
        ("heights", f"ground {_span(facts.rows.h_g_m, 4)} m, take-off {taken}, cameras "
         f"{_span(facts.stations.h_msl_m[ok], 5)} m; above ground {_span(above, 4)} m"),
        ("cameras", "; ".join(camera_text(facts, name) for name in facts.cameras)),
        ("nadir angles", f"{spans(np.degrees(facts.nadir_angle_rad), 2)} deg"),
        ("time", times_text(checked.corrected)),
        ("shift", f"{spans(facts.rows.shift_px, 3)} px; "
         f"{spans(facts.rows.shift_ground_m, 3)} m on the ground"),
        ("changes by", changes_text(checked.corrected)),
        ("rows", f"{', '.join(rows)}, expected of {checked.corrected.statistics.rows:,}"),
        ("vertical", deflection_text(facts)),
        ("air", "; ".join(effect_lines(
            [effect.row() for effect in facts.effects[:1]], facts.adjustment.standard.name))
         or "no ray looks down"),
        *([("control", control)] if control else []),
    ]  # fmt: skip


def _span(values: Array, digits: int) -> str:
    """Lowest to highest of the finite values."""
    known = values[np.isfinite(values)]
    ends = (known.min(), known.max()) if known.size else ()
    texts = (f"{v:.{digits}g}" if abs(v) < 1e4 else f"{v:.0f}" for v in ends)
    return " to ".join(dict.fromkeys(texts)) or "unknown"


def _by_camera(texts: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {text}" for name, text in texts.items())


def camera_text(facts: Facts, name: str) -> str:
    """Field of view, ground sampling distance and footprint at the median height, straight down."""
    camera = facts.cameras[name]
    above = facts.of_camera(name, facts.camera_height_m - facts.rows.h_g_m)
    height = float(np.median(above)) if above.size else math.nan
    far = height / max(math.cos(math.radians(facts.axis_deg(name))), 0.02)
    views = field_of_view(camera)
    # Of a fisheye that sees the horizon, the ground up to 85 degrees off the axis.
    wide, high = (2.0 * math.tan(min(view / 2.0, math.radians(85.0))) for view in views)
    return (
        f"{name} {' x '.join(f'{math.degrees(view):.0f}' for view in views)} deg, "
        f"{far / camera.fx_px:.2g} m a pixel, {far * wide:.0f} x {far * high:.0f} m across the axis"
    )


def times_text(corrected: CorrectedMission) -> str:
    """When the log begins and ends, and when the events do."""
    time, events = corrected.prepared.track()[0], corrected.stations.time_ns
    events = events[events != NO_TIME]
    parts = []
    for label, values in (("log", time), ("events", events)):
        if values.size:
            first, last = (utc_second(int(t))[:-1] for t in (values.min(), values.max()))
            parts.append(f"{label} {first.replace('T', ' ')} to {last[11:]} UTC")
    return "; ".join(parts) or "unknown"


def deflection_text(facts: Facts) -> str:
    """What the deflection of the vertical does to directions that were levelled by gravity."""
    ok = facts.stations.ok
    lat, lon = facts.stations.lat_rad[ok], facts.stations.lon_rad[ok]
    above = (facts.camera_height_m - facts.rows.h_g_m)[np.isfinite(facts.rows.h_g_m)]
    if not lat.size or not above.size:
        return "unknown"
    deflection = float(np.median(np.hypot(*package_geoid().deflection(lat, lon))))
    metres = deflection * float(np.nanmedian(above))
    return (
        f"deflected by {deflection / ARCSEC:.1f} arcsec (EGM96), {metres:.2f} m on the ground: not "
        "removed unless the trajectory did"
    )


def changes_text(corrected: CorrectedMission) -> str:
    """How far the correction moves, in the median of each camera [px], with what it is made of."""
    facts, setup = corrected.facts, corrected.setup
    rows = np.flatnonzero(np.isfinite(facts.rows.shift_px))
    rows = rows[evenly_spaced(rows.size, _ROWS)]
    if not rows.size:
        return "unknown: no row is corrected"
    station, h_g, distance, x, y = (
        getattr(facts.rows, name)[rows]
        for name in ("station", "h_g_m", "distance_m", "x_px", "y_px")
    )
    exposures, setup = setup.exposures, replace(setup, uncertainties=(None,) * len(setup.rays))
    names, method = pa.nulls(rows.size, pa.string()), facts.mission.refraction.method
    batch = Batch(names, names, x, y, x, y, None, {}, distance_m=distance)
    warm = tuple(rays_by(warmer(profile, 5.0), method) for profile in corrected.air.series.profiles)
    turn = Rotation.from_rotvec([math.radians(0.5), 0.0, 0.0]).as_matrix()
    tilted = replace(exposures, rotation=turn @ exposures.rotation)
    higher = replace(exposures, height_m=exposures.height_m + 10.0)
    unknown = np.full(rows.size, np.nan)
    before = correct_batch(batch, station, GroundHeights(h_g, unknown), setup)
    camera, texts = facts.camera[rows], []
    for label, changed, ground in (
        ("10 m of ground", setup, h_g + 10.0),
        ("10 m of height", replace(setup, exposures=higher), h_g),
        ("0.5 deg of tilt", replace(setup, exposures=tilted), h_g),
        ("5 K", replace(setup, rays=warm), h_g),
    ):
        after = correct_batch(batch, station, GroundHeights(ground, unknown), changed)
        moved = np.hypot(after.dx_px - before.dx_px, after.dy_px - before.dy_px)
        medians = {n: f"{np.nanmedian(moved[camera == n]):.2g}" for n in np.unique(camera)}
        texts.append(f"{label} {_by_camera(medians)} px")
    return "; ".join(texts)


def warmer(profile: Profile, by_k: float) -> Profile:
    """The air warmer by the same at every height, with the pressure at its bottom."""
    layers = profile.layers
    top = layers.vapour[-1] + layers.vapour_slope[-1] * (layers.edge[-1] - layers.edge[-2])
    warmed = stack_layers(
        layers.edge, layers.edge_temperature + by_k, np.append(layers.vapour, top), layers.source,
        anchor=(float(layers.edge[0]), float(layers.pressure[0])), constant=profile.constant,
    )  # fmt: skip
    return replace(profile, layers=warmed)
