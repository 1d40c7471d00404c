"""What looks like a mistake in a mission file: rules whose findings it can accept."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unbend.atmosphere.estimate.adjusted_profile import Adjustment
from unbend.config import Mission
from unbend.errors import MissionError
from unbend.flight.stations import Stations
from unbend.flight.trajectory import Takeoff
from unbend.geodesy import wrapped
from unbend.messages import Entry, Kind, Ledger, finding
from unbend.refraction.calibration import is_fisheye
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import Effect, effects_on_r
from unbend.refraction.image import Exposures
from unbend.refraction.status_codes import MISSES_GROUND, OUTSIDE_CAMERA, STATUS_NAMES
from unbend.stages.statistics import SampledRows
from unbend.tables.geodata.elevation import ElevationModel
from unbend.units import Array, Names

Findings = Iterator[Entry]
"""What was found, was expected, and is the likely mistake; ``where`` is the key to change."""

_RADIUS_M = 6.371e6
_FAR_KM = 30.0
_LARGEST_SHARE = 0.2
_LARGEST_FACTOR = 1.5
_FEWEST_ROWS = 100
_TERRAIN_M = 50.0
_BELOW_RAD = 0.5
_HIGHEST_CAMERA_M = 0.25  # above an antenna, which has the sky above it, or an inertial sensor

_KEYS = {
    "unmatched": "image under events, observations.columns.image",
    "outside_log": "log.path; time_utc, gps_week or gps_seconds of events.csv.columns; delay_s",
}
"""Keys to look at by the status of stations."""


@dataclass(frozen=True, eq=False)
class Facts:
    """What the rules look at; ``logged_terrain_m`` (s,) is that below stations."""

    mission: Mission
    stations: Stations
    exposures: Exposures
    cameras: Mapping[str, Camera]
    rows: SampledRows
    adjustment: Adjustment
    takeoff: Takeoff | None
    logged_terrain_m: Array
    terrain: ElevationModel | None

    @cached_property
    def model_at_takeoff_m(self) -> float:
        """The height of the elevation model where the log begins; NaN where unknown."""
        if self.takeoff is None or self.terrain is None:
            return math.nan
        place = np.array([self.takeoff.lat_rad]), np.array([self.takeoff.lon_rad])
        return float(self.terrain.heights(*self.terrain.nodes(*place))[0])

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """R between the median heights of camera and ground of the rows, beside the standard's."""
        known = np.isfinite(self.camera_height_m - self.rows.h_g_m)
        if not known.any():
            return ()
        air, heights = self.adjustment, (self.camera_height_m[known], self.rows.h_g_m[known])
        h_c, h_g = (float(np.median(height)) for height in heights)
        return effects_on_r(air.profile, air.standard, air.covariance, h_c, h_g)

    @cached_property
    def camera(self) -> Names:
        """(n,) the camera of each row, empty without one."""
        return np.append(self.stations.camera, "")[self.rows.station]

    @cached_property
    def camera_height_m(self) -> Array:
        """(n,) above sea level."""
        return np.append(self.exposures.height_m, np.nan)[self.rows.station]

    @cached_property
    def nadir_angle_rad(self) -> Array:
        """(n,) of the measured ray in the camera, before the window; NaN outside the camera."""
        angle = np.full(self.rows.station.size, np.nan)
        for name, camera in self.cameras.items():
            rows = np.flatnonzero((self.camera == name) & (self.rows.station >= 0))
            u, v, _ = camera.rays(self.rows.x_px[rows], self.rows.y_px[rows])
            up = self.exposures.rotation[self.rows.station[rows], :, 2]
            cosine = -(up[:, 0] * u + up[:, 1] * v + up[:, 2]) / np.sqrt(u * u + v * v + 1.0)
            angle[rows] = np.arccos(np.clip(cosine, -1.0, 1.0))
        return angle

    def axis_deg(self, name: str) -> float:
        """The median nadir angle of a camera's axis [deg]; NaN without stations."""
        rows = (self.stations.camera == name) & self.stations.ok
        cosine = -self.exposures.rotation[rows, 2, 2]
        cosine = np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)
        return float(np.degrees(np.median(np.arccos(cosine)))) if cosine.size else math.nan

    def of_camera(self, name: str, values: Array) -> Array:
        """The finite values of the rows of one camera."""
        values = values[self.camera == name]
        return np.asarray(values[np.isfinite(values)])

    def key_of(self, name: str, number: str, report: str) -> str:
        """The key of a part of a camera, by how the mission file gives its orientation."""
        section = self.mission.cameras[name]
        if section.model is not None:
            return f"cameras.{name}, {'' if number != 'width_px' else 'width_px, '}params or file"
        return f"cameras.{name}." + (number if section.metric is None else f"metric.{report}")

    def view_deg(self, name: str) -> float:
        """The field of view over the diagonal [deg], as if without distortion."""
        camera = self.cameras[name]
        half = math.hypot(camera.width_px / camera.fx_px, camera.height_px / camera.fy_px) / 2.0
        # Equidistant behind a fisheye, whose corners often lie beyond its circle.
        return 2.0 * math.degrees(half if is_fisheye(camera) else math.atan(half))


def cause_of_misses(facts: Facts) -> str:
    """Why rays miss the ground: how far it lies above the camera, or beyond the horizon."""
    rows = facts.rows.status == MISSES_GROUND
    above = (facts.rows.h_g_m - facts.camera_height_m)[rows]
    angle, height = facts.nadir_angle_rad[rows], -above
    causes, under = [], above < 0.0
    if bool((~under).any()):
        most = f"up to {np.max(above[~under]):.0f} m" if above[~under].size > 1 else "so far"
        causes.append(f"the ground lies {most} above the camera (ground.height, ground.reference)")
    if bool(under.any()):
        dip = np.arccos(_RADIUS_M / (_RADIUS_M + height[under]))
        beyond = np.degrees(angle[under] + dip) - 90.0
        causes.append(
            f"rays pass up to {np.nanmax(beyond):.1f} deg beyond the horizon (angles of mount, "
            "f_px of the camera)"
        )
    return "; ".join(causes)


def causes_of_statuses(facts: Facts) -> dict[str, str]:
    """A likely cause of each status that flags rows, with the keys to look at."""
    lost = Counter(facts.stations.status[~facts.stations.ok].tolist())
    lacks = {name: f"{count} {name} ({_KEYS.get(name, 'log')})" for name, count in lost.items()}
    column, of = facts.mission.ground.column, facts.mission.observations.columns
    height = f"column {column} is empty or no height there" if column else "no height is known"
    causes = {
        "no_station": f"their stations: {', '.join(lacks.values())}",
        "no_ground": f"{height} (ground.height)",
        "bad_measurement": f"{of.x_px} or {of.y_px} is empty or no number (observations.columns)",
        "outside_profile": "their rays leave the profile of the air (ground.height)",
        "beyond_grazing": "their rays graze the ground (angles of mount)",
    }
    if bool((facts.rows.status == MISSES_GROUND).any()):
        causes["misses_ground"] = cause_of_misses(facts)
    outside = facts.rows.status == OUTSIDE_CAMERA
    if bool(outside.any()):
        parts = []
        for name in np.unique(facts.camera[outside]).tolist():
            camera, rows = facts.cameras[name], outside & (facts.camera == name)
            x, y = facts.rows.x_px[rows], facts.rows.y_px[rows]
            off = (x < 0) | (y < 0) | (x > camera.width_px) | (y > camera.height_px)
            size = facts.key_of(name, "width_px", "format_mm")
            parts += [f"outside {camera.width_px} x {camera.height_px} px ({size}; "
                      "observations.columns)"] if off.any() else []  # fmt: skip
            bent = facts.key_of(name, "distortion", "distortion")
            parts += [f"beyond where the distortion of {name} can be inverted ({bent})"
                      ] if not off.all() else []  # fmt: skip
        causes["outside_camera"] = "; ".join(parts)
    return causes


def likely_reading(off_m: float, ground_m: float, takeoff_m: float) -> str:
    """What ground heights [m] likely are, that lie ``off_m`` above where they are expected."""
    above = {
        "feet": ground_m - ground_m * 0.3048,
        "km": ground_m - ground_m * 1000.0,
        "heights above the take-off (ground.reference: relative)": -takeoff_m,
        "heights above sea level, not relative ones (ground.reference)": takeoff_m,
    }
    best = min(above, key=lambda reading: abs(above[reading] - off_m))
    if ground_m == 0.0 or abs(above[best] - off_m) > 0.5 * abs(off_m):
        return "another height, datum or unit than that of ground.height"
    return best


def ground_beside_others(facts: Facts) -> Findings:
    """The ground beside the take-off, the terrain that the autopilot logged, and a model's there.

    Within 300 m of the take-off and 20 m for each km from it, to 30 km; rows within 29 deg of the
    nadir, which see the ground near their station, within 50 m of logged terrain and its scatter.
    """
    off, column, ground = facts.takeoff, facts.mission.ground.column, facts.rows.h_g_m
    takeoff_m, ok = 0.0 if off is None else off.h_msl_m, facts.stations.ok
    key = "ground.height" + (f", column {column}" if column else "")
    found = []  # code, key, height, how much above what is expected, allowed, and where
    if off is not None and np.isfinite(ground).any() and ok.any():
        north = (facts.stations.lat_rad[ok] - off.lat_rad) * _RADIUS_M
        east = wrapped(facts.stations.lon_rad[ok] - off.lon_rad) * math.cos(off.lat_rad) * _RADIUS_M
        km = float(np.median(np.hypot(north, east))) / 1000.0
        height = float(np.nanmedian(ground))
        where = f"the take-off, {km:.0f} km away"
        if km <= _FAR_KM:
            allowed = 300.0 + 20.0 * km
            found.append(("PLAUSIBLE-GROUND", key, height, height - takeoff_m, allowed, where))
    key += "; ground.reference"
    terrain = np.append(facts.logged_terrain_m, np.nan)[facts.rows.station]
    apart = np.where(facts.nadir_angle_rad < _BELOW_RAD, ground, np.nan) - terrain
    if (known := np.isfinite(apart)).any():
        low, middle, high = np.percentile(apart[known], [16.0, 50.0, 84.0]).tolist()
        height = float(np.median(terrain[known])) + middle
        where = f"the terrain that the autopilot logged, in {known.sum()} rows"
        allowed = _TERRAIN_M + (high - low) / 2.0
        found.append(("PLAUSIBLE-TERRAIN", key, height, middle, allowed, where))
    if off is not None and off.stands and np.isfinite(model_m := facts.model_at_takeoff_m):
        where = "the take-off, by the elevation model where the log begins"
        apart_m = model_m - takeoff_m
        found.append(("PLAUSIBLE-TERRAIN", key, model_m, apart_m, _TERRAIN_M, where))
    for code, named, height, off_m, allowed, where in found:
        if abs(off_m) > allowed:
            what = (
                f"the ground lies {height:.0f} m above sea level in the median, {off_m:+.0f} m "
                f"from {where}: expected within {allowed:.0f} m; likely "
                f"{likely_reading(off_m, height, takeoff_m)}"
            )
            yield finding(code, what, where=named)


def field_of_view(facts: Facts) -> Findings:
    """A diagonal field of view between 3 and 130 deg (fisheyes 60 and 300), and square pixels."""
    for name, camera in facts.cameras.items():
        view, key = facts.view_deg(name), facts.key_of(name, "fx_px", "focal_mm")
        least, most = (60.0, 300.0) if is_fisheye(camera) else (3.0, 130.0)
        if not least <= view <= most:
            yield finding(
                "PLAUSIBLE-VIEW/angle", where=key, name=name, camera=camera, view=view,
                least=least, most=most,
            )  # fmt: skip
        if abs(camera.fx_px / camera.fy_px - 1.0) > 0.02:
            yield finding("PLAUSIBLE-VIEW/square", where=key, name=name, camera=camera)


def principal_point(facts: Facts) -> Findings:
    """The principal point within a tenth of the image from its centre."""
    for name, camera in facts.cameras.items():
        off_x = abs(camera.cx_px / camera.width_px - 0.5)
        off = max(off_x, abs(camera.cy_px / camera.height_px - 0.5))
        if off > 0.1:
            key, percent = facts.key_of(name, "cx_px", "origin"), 100.0 * off
            yield finding(
                "PLAUSIBLE-PRINCIPAL-POINT", where=key, name=name, camera=camera, percent=percent
            )


def distortion(facts: Facts) -> Findings:
    """At the corners between 1e-6 and a third of the radius, and tangential less than radial."""
    for name, camera in facts.cameras.items():
        values = {k: v for k, v in camera.distortion._asdict().items() if v}
        view = facts.view_deg(name)
        if not values or view > 130.0 or is_fisheye(camera):
            continue
        u = np.array([0.5, 0.5, -0.5, -0.5]) * camera.width_px / camera.fx_px
        v = np.array([0.5, -0.5, 0.5, -0.5]) * camera.height_px / camera.fy_px
        u_d, v_d = camera.distort(u, v)
        share = float(np.max(np.hypot(u_d - u, v_d - v) / np.hypot(u, v)))
        if share != 0.0 and not 1e-6 <= share <= (0.3 if view < 90.0 else 1.0):
            key = facts.key_of(name, "distortion", "distortion")
            yield finding("PLAUSIBLE-DISTORTION/corners", where=key, name=name, share=share)
        tangential = max(abs(values.get(k, 0.0)) for k in ("p1", "p2"))
        if tangential > 1e-3 and tangential > 3.0 * abs(values.get("k3", 0.0)):
            key = facts.key_of(name, "distortion.k3", "distortion")
            yield finding("PLAUSIBLE-DISTORTION/order", where=key, name=name, most=tangential)


def extent_of_observations(facts: Facts) -> Findings:
    """Observations that fill the image, and hardly any outside it."""
    for name, camera in facts.cameras.items():
        rows = (facts.camera == name) & np.isfinite(facts.rows.x_px + facts.rows.y_px)
        x, y = facts.rows.x_px[rows], facts.rows.y_px[rows]
        if x.size == 0:
            continue
        width, height = camera.width_px, camera.height_px
        outside = float(np.mean((x < 0) | (x > width) | (y < 0) | (y > height)))
        expected, mistake = "none outside", "millimetres, or images of another size"
        if x.max() <= height and y.max() <= width:
            mistake = "width and height, or x and y, exchanged"
        if x.min() < -0.2 * width and y.min() < -0.2 * height:
            mistake = "counted from the centre of the image, not from its upper left corner"
        if outside <= 0.01:
            expected, mistake = "to fill it", "measured in reduced images"
            if x.size < _FEWEST_ROWS or max(x.max() / width, y.max() / height) >= 0.7:
                continue
        yield finding(
            "PLAUSIBLE-EXTENT", where=f"cameras.{name}.width_px", name=name, camera=camera,
            x=f"{x.min():.6g} to {x.max():.6g}", y=f"{y.min():.6g} to {y.max():.6g}",
            outside=100.0 * outside, expected=expected, mistake=mistake,
        )  # fmt: skip


def direction_of_cameras(facts: Facts) -> Findings:
    """Cameras that look down, and those whose name says where they look."""
    for name in facts.cameras:
        axis, half, expected = facts.axis_deg(name), facts.view_deg(name) / 2.0, ""
        if axis > 90.0 - min(half, 10.0):
            expected = "down: likely 0 for a camera that looks down, not -90"
        elif axis > 30.0 and any(word in name.lower() for word in ("nadir", "down", "vertical")):
            expected = f"within 30 deg of the nadir by the name of {name}"
        elif axis < 10.0 and "oblique" in name.lower():
            expected = f"more than 10 deg off by the name of {name}: likely radians, or exchanged"
        if expected:
            key = facts.mission.attitude_key(name)
            yield finding("PLAUSIBLE-DIRECTION", where=key, name=name, axis=axis, expected=expected)


def stated_numbers(facts: Facts) -> Findings:
    """Angles, lever arms, delays and sigmas of the ground of a usual size and sign."""
    mission = facts.mission
    for name, mount in mission.mount.items():
        for key in ("roll_deg", "pitch_deg", "yaw_deg"):
            value = getattr(mount, key)
            degrees = math.degrees(value)
            steps = degrees / 15.0
            if value and abs(value) <= math.tau and abs(steps - round(steps)) < 2e-3:
                where = f"mount.{name}.{key}"
                yield finding(
                    "PLAUSIBLE-ANGLE", where=where, name=name, angle=key, value=value, deg=degrees
                )
        key, length = f"mount.{name}.lever_arm_m", math.hypot(*mount.lever_arm_m)
        if length > 10.0:
            yield finding("PLAUSIBLE-LEVER-ARM/long", where=key, name=name, length=length)
        up = -mount.lever_arm_m[2]
        if up > _HIGHEST_CAMERA_M and mission.mounts[name].camera_from_body[2, 2] > 0.5:
            most = _HIGHEST_CAMERA_M
            yield finding("PLAUSIBLE-LEVER-ARM/above", where=key, name=name, up=up, most=most)
    if (sigma := mission.ground.sigma_m or 0.0) > 50.0:
        yield finding("PLAUSIBLE-SIGMA", where="ground.sigma_m", sigma=sigma)
    for name, source in ((mission.events and mission.events.log) or {}).items():
        if isinstance(source.delay_s, float) and abs(source.delay_s) > 1.0:
            key = f"events.log.{name}.delay_s"
            yield finding("PLAUSIBLE-DELAY", where=key, name=name, delay=source.delay_s)


def windows(facts: Facts) -> Findings:
    """Windows where a cabin is logged, and square within 35 deg to the camera they belong to."""
    mission = facts.mission
    named = None if mission.log is None else mission.log.channels.cabin_pressure
    if named is not None and not mission.windows:
        yield finding(
            "PLAUSIBLE-WINDOW/none", where=f"cameras.{next(iter(mission.cameras))}.window"
        )
    for name, window in mission.windows.items():
        if window.frame != "camera":
            continue
        tilt = math.degrees(math.acos(window.normal[2]))
        if tilt > 35.0:
            key = f"cameras.{name}.window.frame"
            yield finding("PLAUSIBLE-WINDOW/leans", where=key, name=name, tilt=tilt)


def slant_ranges(facts: Facts) -> Findings:
    """Slant ranges that fit the heights of camera and ground."""
    straight = (facts.camera_height_m - facts.rows.h_g_m) / np.cos(facts.nadir_angle_rad)
    ratio = facts.rows.distance_m / straight
    ratio = ratio[np.isfinite(ratio) & (facts.nadir_angle_rad < 1.4)]
    if ratio.size and not 0.7 < np.median(ratio) < 1.4:
        key = "observations.columns.distance_m"
        yield finding("PLAUSIBLE-DISTANCE", where=key, ratio=np.median(ratio))


def flagged_rows(facts: Facts) -> Findings:
    """No more than a fifth of the rows flagged for one cause."""
    for name, cause in causes_of_statuses(facts).items():
        flagged = facts.rows.status == STATUS_NAMES.index(name)
        share = float(np.sum(facts.rows.weight[flagged]) / np.sum(facts.rows.weight))
        if share > _LARGEST_SHARE:
            yield finding(
                "PLAUSIBLE-FLAGGED", where="observations", percent=100.0 * share, name=name,
                most=100.0 * _LARGEST_SHARE, cause=cause,
            )  # fmt: skip


def air_of_flight(facts: Facts) -> Findings:
    """R within a factor of 1.5 of that in US 1976 between the same heights."""
    for effect in facts.effects[:1]:
        if not 1.0 / _LARGEST_FACTOR < effect.factor < _LARGEST_FACTOR:
            yield finding("PLAUSIBLE-AIR", where="atmosphere", effect=effect)


def measured_observations(facts: Facts) -> Findings:
    """Refraction is applied to observations for plans, not to those of a flight with a log."""
    mission = facts.mission
    if mission.refraction.direction == "apply" and mission.stations.orientation is None:
        yield finding("PLAUSIBLE-APPLY", where="refraction.direction")


RULES: tuple[Callable[[Facts], Findings], ...] = (
    ground_beside_others, field_of_view, principal_point, distortion, extent_of_observations,
    direction_of_cameras, stated_numbers, windows, slant_ranges, flagged_rows, air_of_flight,
    measured_observations,
)  # fmt: skip


def report_findings(facts: Facts, ledger: Ledger) -> None:
    """Findings of all rules, and warnings of those that the mission file accepts.

    A warning (DEM-UNVERIFIED) where nothing could contradict its elevation model. Losses cannot be
    accepted: refuses (MissionError ACCEPT-LOSS) the code of one.
    """
    mission, off = facts.mission, facts.takeoff
    ledger.extend(each for rule in RULES for each in rule(facts))
    verified = off is not None and off.stands and math.isfinite(facts.model_at_takeoff_m)
    verified |= bool(np.isfinite(facts.logged_terrain_m).any())
    verified |= any(entry.code in ("TIES-RESIDUALS", "ORIENTATION-TIES") for entry in ledger)
    if mission.ground.model is not None and not verified:
        ledger.warning("DEM-UNVERIFIED", where="ground.height.dem")
    losses = {entry.code for entry in ledger if entry.kind is Kind.LOSS}
    for accepted in mission.accept:
        if accepted.code in losses:
            raise MissionError.of("ACCEPT-LOSS", "accept", accepted_code=accepted.code)
    for code in ledger.accept({accepted.code: accepted.reason for accepted in mission.accept}):
        ledger.warning("ACCEPT-UNUSED", f"nothing is found that {code} accepts", where="accept")
