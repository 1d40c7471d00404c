"""What tie points say of a mission file: each likely mistake tried, with its estimate.

The stations are held, and the rays of tie points are intersected under each hypothesis: cameras
exchanged, another mount, another principal distance, a radial distortion, a calibration of other
signs or axes, exposures earlier or later, heights from another zero, other axes of the pixels. A
hypothesis that is 1000 times as likely as what is stated, and larger than the stated sigmas
explain, is a finding.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.image_rays import ImageRays, Orientations, straightened
from unbend.block.intersection import Intersection, intersect
from unbend.flight.mount import Mount
from unbend.flight.rotations import ANGLE_MISTAKES, CAMERA_AT_REST, UNIT_MISTAKES
from unbend.refraction.camera.camera import Camera
from unbend.units import Array, Integers

_RANKING_POINTS, _DECIDED_BY_ALL, _MOST_STEPS, _FEWEST_HEIGHTS = 200, 4, 4, 10
_SIGMAS = 4.0  # beyond which a stated sigma does not explain an error that all stations share

# Misses over sigmas, and the share of points whose rays meet, beyond which anything may be wrong.
_POOR_FIT, _FEW_MEET = 2.0, 0.7
_FEW_BAD = 0.1  # of the rays of a camera: so many are no sign of a mistake
_WORTH_A_LOOK = 0.3 * LOG_RATIO_NEEDED

# What matters to nobody: turns [rad], principal distance, height and distortion in the corners of
# the image as shares, time [s].
_SMALL = {"TIES-MOUNT": np.radians(0.3), "TIES-FOCAL": 0.01, "TIES-HEIGHT": 0.01, "TIES-TIME": 0.1,
          "TIES-CALIBRATION": 0.0015}  # fmt: skip

_KEYS = {
    "TIES-MOUNT": "mount.{}", "TIES-FOCAL": "cameras.{}", "TIES-TIME": "events",
    "TIES-HEIGHT": "ground", "TIES-PIXELS": "observations.columns", "TIES-CAMERAS": "cameras",
    "TIES-CALIBRATION": "cameras.{}",
}  # fmt: skip

_LEAST_PX = 1.0  # that a principal point moves

_WORSE_THAN_FLAT, _FLAT = 1.1, 0.002  # of the relief, and at least of the flying height
_SETTLED = 0.05  # of its sigma: an amount that changes by less is the most likely one
_MARGIN = 0.1  # of a log likelihood ratio, within which two mistakes count as equally likely
_MISTAKEN_AT = 0.3  # within which of 1 a calibration is the mistaken one, and nothing between
_LARGEST_REFINEMENT_RAD = np.radians(5.0)  # of a mistake that is still that one

_SCALES = (0.25, 0.5, 2.0 / 3.0, 0.8, 1.25, 1.5, 2.0, 4.0)
_SENSOR_WIDTHS_MM = (6.2, 13.2, 17.3, 23.5, 36.0, 43.8, 53.4)
_TIMES_S = (0.5, 1.0, 2.0, 5.0, 10.0, 18.0, 60.0, 1800.0, 3600.0, 7200.0)  # 18 leap seconds
_TURNS_DEG = ((0, 0, 90), (0, 0, -90), (0, 0, 180), (0, 90, 0), (0, -90, 0), (90, 0, 0),
              (-90, 0, 0), (0, 180, 0))  # fmt: skip


@dataclass(frozen=True, eq=False)
class StatedMission:
    """What a mission file states, as far as tie points can contradict it.

    ``rays`` gives the apparent rays by the cameras that took the images and the axes of their
    pixels (x and y ``exchanged``, y ``upward``), by name of the camera. ``mounts`` are empty where
    orientations are the cameras' own. ``shifted`` gives the orientations that many seconds later,
    in the same rows, where there is a trajectory. ``sigma_heights_m`` is what the heights of the
    ground may be off together, ``sigma_height_m`` a single one, ``heights_of`` the points whose
    given heights count, ``other_heights_m`` names for what may have to be added to stations;
    ``one_height`` is given for all points.
    """

    orientations: Orientations
    cameras: Mapping[str, Camera]
    rays: Callable[[Mapping[str, Camera], Mapping[str, str]], ImageRays]
    mounts: Mapping[str, Mount] = field(default_factory=dict)
    shifted: Callable[[float], Orientations] | None = None
    sigma_heights_m: float = 0.0
    sigma_height_m: float = 1.0
    heights_of: tuple[int, ...] = ()
    other_heights_m: Mapping[str, float] = field(default_factory=dict)
    one_height: bool = False

    def camera_from_body(self, camera: str) -> Array:
        """(3, 3) the stated mount, or that of a camera which looks down."""
        return self.mounts.get(camera, Mount()).camera_from_body


@dataclass(frozen=True, eq=False)
class _Reading:
    """One way to read a mission file: what is changed against what is stated."""

    cameras: Mapping[str, Camera]
    axes: Mapping[str, str] = field(default_factory=dict)
    turns: Mapping[str, Array] = field(default_factory=dict)  # (3, 3) by camera
    time_s: float = 0.0
    up_m: float = 0.0

    def held(self, mission: StatedMission) -> tuple[Orientations, ImageRays]:
        """The orientations and the apparent rays."""
        shifted = mission.shifted if self.time_s else None
        o = mission.orientations if shifted is None else shifted(self.time_s)
        o = replace(o, centre_m=o.centre_m + self.up_m * o.enu_from_ecef[:, 2])
        for camera, turn in self.turns.items():
            o = o.turned(Rotation.from_matrix(turn).as_rotvec(), camera)
        return o, mission.rays(self.cameras, self.axes)

    def intersected(self, mission: StatedMission, points: Integers | None = None) -> Intersection:
        """The intersection of all points by straight rays, or of some by the apparent ones."""
        o, rays = self.held(mission)
        rays = rays if points is None else rays.of_points(points)
        if rays.height_m is not None:
            given = np.where(np.isin(rays.point, mission.heights_of), rays.height_m, np.nan)
            rays = replace(rays, height_m=given, sigma_height_m=mission.sigma_height_m)
        return intersect(o, straightened(o, rays) if points is None else rays)

    def with_cameras(self, cameras: Mapping[str, Camera]) -> _Reading:
        """The same with other calibrations of some cameras."""
        return replace(self, cameras={**self.cameras, **cameras})

    def settled(self, mission: StatedMission) -> _Reading:
        """The same with every camera turned to where the rays meet best."""
        found, reading = self.intersected(mission), self
        for name in self.cameras:
            turn = Rotation.from_rotvec(found.camera_rotation(name)[0]).as_matrix()
            reading = reading.turned(name, turn)
        return reading

    def turned(self, camera: str, turn: Array) -> _Reading:
        """The same with one camera turned further."""
        return replace(self, turns={**self.turns, camera: turn @ self.turns.get(camera, np.eye(3))})


@dataclass(frozen=True)
class Finding:
    """A contradiction: code, key of the mission file, and one sentence with number and sigma."""

    code: str
    key: str
    what: str
    log_ratio: float  # natural logarithm of its likelihood over that of what is stated
    sigma_factor: float  # residuals of the rays alone over what their sigmas say, then
    also: tuple[str, ...] = ()  # the same of others that are nearly as likely


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A change by an amount: ``reading(x)``; without an amount ``step`` is 0. ``cameras`` are those
    that it changes."""

    code: str
    label: str
    cameras: tuple[str, ...]
    reading: Callable[[float], _Reading]
    x: float = 0.0
    step: float = 0.0

    @property
    def camera(self) -> str:
        """The one camera, empty where there are several."""
        return self.cameras[0] if len(self.cameras) == 1 else ""


def _subject(h: _Hypothesis) -> tuple[str, str]:
    """What two hypotheses have in common that are one: calibrations do not meet when estimated."""
    return h.code, (h.label or h.camera) if h.code == "TIES-CALIBRATION" else h.camera


def diagnosis(mission: StatedMission) -> tuple[Intersection, tuple[Finding, ...]]:
    """The intersection as stated, by the rays alone, and what contradicts the mission file.

    Nothing is tried where rays that meet exactly were not 1000 times as likely. Common errors of
    mounts, principal distances, heights and times are tried where their linear estimates gain; the
    large mistakes where rays do not meet as their sigmas say: some seconds with 2,000 points, 200
    of which rank them. The standard atmosphere's refraction is removed (`straightened`).
    """
    current = _Reading(mission.cameras)
    stated = current.intersected(replace(mission, heights_of=()))
    mission = with_usable_heights(mission, stated)
    now = current.intersected(mission) if mission.heights_of else stated
    size = stated.point.size
    some = stated.point[np.unique(np.linspace(0, size - 1, _RANKING_POINTS).astype(int))[:size]]
    findings: list[Finding] = []

    for _ in range(_MOST_STEPS):
        if now.misfit <= LOG_RATIO_NEEDED:  # nothing can be more likely by as much
            break
        poor = not now.sigma_factor < _POOR_FIT or now.used.mean() < _FEW_MEET
        large = list(large_mistakes(mission, current)) if poor else []
        large.sort(key=lambda h: -_likelihood(mission, h.reading(h.x), some))
        best = likely_calibrations(mission, current, now)
        least = 0.0 if poor or now.most_bad > _FEW_BAD else _WORTH_A_LOOK
        hypotheses = [*small_errors(mission, current, now, least), *large[:_DECIDED_BY_ALL]]
        before = _likelihood(mission, current, some) if hypotheses else 0.0
        for hypothesis in hypotheses:
            h, _ = _refined(mission, hypothesis, some)
            if _likelihood(mission, h.reading(h.x), some) < before + _WORTH_A_LOOK:
                continue
            h, sigma = _refined(mission, h, None)
            reading = h.reading(h.x)
            found = reading.intersected(mission)
            gain = found.log_likelihood - now.log_likelihood
            text = _described(mission, h, reading, found, sigma)
            if gain + min(0.0, _log_odds(h)) > LOG_RATIO_NEEDED:
                best.append((gain, h, reading, found, text))
        if not any(text for *_, text in best):
            break
        # What is more likely and matters to nobody is no finding, nor is what it explains.
        best.sort(key=lambda item: -item[0] - _log_odds(item[1]))
        gain, chosen, current, now, text = best[0]
        if not text:
            continue
        other = {_subject(h): t for g, h, _, _, t in best if t and g > (1.0 - _MARGIN) * gain}
        other.pop(_subject(chosen), None)
        key = _KEYS[chosen.code].format(chosen.camera).rstrip(".")
        key = "stations.orientation" if "mount" in key and not mission.mounts else key
        # What is estimated once more is said once.
        findings = [f for f in findings if (f.code, f.key) != (chosen.code, key)]
        also = tuple(other.values())
        factor = current.intersected(replace(mission, heights_of=())).sigma_factor
        findings.append(Finding(chosen.code, key, text, gain, factor, also))
    factor = findings[-1].sigma_factor if findings else stated.sigma_factor
    if text := scattered_heights(mission, now, factor):
        findings.append(Finding("TIES-HEIGHT", "ground", text, np.inf, factor))
    return stated, tuple(findings)


def _log_odds(h: _Hypothesis) -> float:
    """How likely a mistake is beforehand, as a natural logarithm: more if it has a name, less if
    all cameras have it alike."""
    alike = h.code in ("TIES-FOCAL", "TIES-CALIBRATION") and len(h.cameras) > 1 and not h.label
    return LOG_RATIO_NEEDED * (bool(h.label) - 2.0 * alike)


def _likelihood(mission: StatedMission, reading: _Reading, points: Integers) -> float:
    """Its logarithm by some points; of mirrored rays none."""
    found = reading.intersected(mission, points)
    return found.log_likelihood if _above_points(found) > 0.0 else -np.inf


def estimated(
    mission: StatedMission, current: _Reading, now: Intersection, hypotheses: list[_Hypothesis],
    beside: Array,
) -> list[tuple[float, float, _Hypothesis]]:  # fmt: skip
    """What each hypothesis alone, with errors ``beside``, gains at its best amount, and that."""
    before, changes = now.misses(*current.held(mission)), [np.zeros((now.bad.size, 2, 0))]
    for h in hypotheses:
        step = h.x or h.step
        change = now.misses(*h.reading(step).held(mission)) - before
        changes.append(np.nan_to_num(change / step)[:, :, None])
    gains, amounts = now.likely_amounts(np.concatenate(changes, axis=2), beside)
    return list(zip(gains.tolist(), amounts.tolist(), hypotheses, strict=True))


def likely_calibrations(
    mission: StatedMission, current: _Reading, now: Intersection
) -> list[tuple[float, _Hypothesis, _Reading, Intersection, str]]:
    """Other calibrations that are likely: by how much, how read, what is then found, and the text.

    A principal point that is off turns rays nearly as a mount does: only what no mount explains,
    turned to where the rays meet best, speaks of a calibration.
    """
    turns = [now.orientations.turns_of(camera) for camera in current.cameras]
    others = list(other_calibrations(current))
    ranked = estimated(mission, current, now, others, np.concatenate(turns, axis=2))
    likely = [h for h in ranked if h[0] > LOG_RATIO_NEEDED and abs(h[1] - 1.0) < _MISTAKEN_AT]
    most, best = max((gain for gain, _, _ in likely), default=0.0), []
    for gain, x, h in likely:
        if gain > (1.0 - _MARGIN) * most:
            # Beside other mistakes it counts without the turns, if it then explains more.
            reading = h.reading(x)
            more = reading.intersected(mission).log_likelihood - now.log_likelihood
            reading = reading if more > gain else reading.settled(mission)
            found = reading.intersected(mission)
            best.append((max(gain, more), replace(h, x=x), reading, found, h.label))
    return best


def scattered_heights(mission: StatedMission, found: Intersection, factor: float) -> str:
    """Why given heights of single points are none of theirs; empty where stated sigmas explain it.

    A tenth of them is then farther from where the rays meet than 3 % of the flying height, and than
    sigmas explain, times the ``factor`` of the rays' own residuals; or they leave more of the
    points' relief than one height for all does, as those of another place do.
    """
    given = mission.rays(mission.cameras, {})
    if given.height_m is None or mission.one_height or not found.used.any():
        return ""
    height_m = given.height_m[np.unique(given.point, return_index=True)[1]]
    known = np.isfinite(off := height_m - found.geodetic[2])
    off, met_m, above = off[known], found.geodetic[2][known], _above_points(found)
    if off.size < _FEWEST_HEIGHTS:
        return ""
    shared = np.hypot(mission.sigma_heights_m, np.nanmedian(found.orientations.sigma[:, 2]))
    allowed = _SIGMAS * float(shared + np.nanmedian(found.sigma_height_m))
    allowed = max(0.03 * above, max(1.0, factor) * allowed)
    far = float(np.quantile(np.abs(off), 0.9))
    left, relief = scatter_of(off), scatter_of(met_m)
    text = f"given heights of a tenth of {off.size} points are {far:.0f} m or more from where "
    text += "their rays meet, expected "
    likely = ": no heights, holes that hold a number, or heights of other points or another place"
    if far > allowed:
        return f"{text}within {allowed:.0f} m{likely}"
    if left > max(_WORSE_THAN_FLAT * relief, _FLAT * above):
        return f"{text}nearer than one height for all, which is within {relief:.0f} m{likely}"
    return ""


def scatter_of(values: Array) -> float:
    """What a tenth of the known values is away from their median at least; infinite of few."""
    values = values[np.isfinite(values)]
    if values.size < _FEWEST_HEIGHTS:
        return np.inf
    return float(np.quantile(np.abs(values - np.median(values)), 0.9))


def with_usable_heights(mission: StatedMission, found: Intersection) -> StatedMission:
    """Given heights that are not wild beside the others, and the scatter of all about the rays."""
    rays = mission.rays(mission.cameras, {})
    if rays.height_m is None:
        return mission
    first = np.unique(rays.point, return_index=True)[1]
    off = rays.height_m[first] - found.geodetic[2]
    if np.isfinite(off).sum() < _FEWEST_HEIGHTS:
        return mission
    middle = np.nanmedian(off)
    spread = max(mission.sigma_height_m, 1.4826 * float(np.nanmedian(np.abs(off - middle))))
    usable = np.abs(off - middle) <= 6.0 * np.hypot(spread, found.sigma_height_m)
    return replace(mission, sigma_height_m=spread, heights_of=tuple(found.point[usable].tolist()))


def _above_points(found: Intersection) -> float:
    """Median height of the stations above the points [m]; mirrored rays meet above them."""
    o = found.orientations
    if not found.used.any():
        return np.inf
    line = o.centre_m - found.position_m[found.used].mean(axis=0)
    return float(np.nanmedian(np.sum(line * o.enu_from_ecef[:, 2], axis=1)))


def small_errors(
    mission: StatedMission, now: _Reading, found: Intersection, least: float
) -> Iterator[_Hypothesis]:
    """Errors that all stations share, by which the log likelihood gains ``least`` or more."""
    o = found.orientations
    names = [name for name in now.cameras if np.any(o.camera == name)]
    for name in names:
        vector, covariance = found.camera_rotation(name)
        if found.gain_of(vector @ np.linalg.pinv(covariance, hermitian=True) @ vector) >= least:
            turn = Rotation.from_rotvec(vector).as_matrix()
            yield _Hypothesis("TIES-MOUNT", "", (name,), _at_once(now.turned(name, turn)))
    up = _Hypothesis("TIES-HEIGHT", "", (), lambda x: replace(now, up_m=now.up_m + x), 0.0, 1.0)
    groups = _each_and_all(names)
    others = [up, *(_scaled(now, group, 1.0, "") for group in groups)]
    with_k1 = (group for group in groups if np.isfinite(_k1(now.cameras, group)).all())
    others += [_distorted(now, group) for group in with_k1]
    others += [_later(now, 0.0)] if mission.shifted is not None else []
    for gain, x, h in estimated(mission, now, found, others, np.zeros((o.camera.size, 6, 0))):
        if gain >= least:
            yield replace(h, x=x) if h is up or h.code == "TIES-CALIBRATION" else h


def other_calibrations(now: _Reading) -> Iterator[_Hypothesis]:
    """Calibrations without a mistake, at 1; of one that is a little off another amount is best."""
    for what, other in mistaken_calibrations(now.cameras):

        def reading(x: float, other: Mapping[str, Camera] = other) -> _Reading:
            mixed = {name: between(now.cameras[name], c, x) for name, c in other.items()}
            return now.with_cameras(mixed)

        yield _Hypothesis("TIES-CALIBRATION", what, tuple(other), reading, 1.0, 0.25)


def mistaken_calibrations(cameras: Mapping[str, Camera]) -> Iterator[tuple[str, dict[str, Camera]]]:
    """What is wrong with calibrations, and the right ones of each camera alone, all or two."""
    groups = _each_and_all(cameras)
    for group, axes in product(groups, list(product((False, True), (1, -1), (1, -1)))[1:]):
        other = {n: with_other_axes(cameras[n], *axes) for n in group}
        moved = ((c.cx_px - cameras[n].cx_px, c.cy_px - cameras[n].cy_px) for n, c in other.items())
        if min(max(abs(x), abs(y)) for x, y in moved) > _LEAST_PX:
            places = (f"{c.cx_px:.1f}, {c.cy_px:.1f} px in {n}" for n, c in other.items())
            what = f"the principal point is at {' and '.join(places)}"
            yield f"{what}: what is stated counts along other axes", other
    for group in groups:
        of = {n: cameras[n].distortion for n in group}
        other = {n: replace(cameras[n], distortion=lens._replace(**{
            key: -value for key, value in lens._asdict().items() if value and key[0] in "kpq"
        })) for n, lens in of.items()}  # fmt: skip
        if all(other[n] != cameras[n] for n in group):
            what = f"the coefficients of distortion of {' and '.join(group)}"
            yield f"{what} have the other sign: those of corrections, or the reverse", other
    for a, b in combinations(cameras, 2):
        of_a, of_b = cameras[a], cameras[b]
        a_of_b = replace(of_b, width_px=of_a.width_px, height_px=of_a.height_px)
        b_of_a = replace(of_a, width_px=of_b.width_px, height_px=of_b.height_px)
        if a_of_b != of_a and type(of_a.distortion) is type(of_b.distortion):
            yield f"the calibrations of {a} and {b} are each other's", {a: a_of_b, b: b_of_a}


def with_other_axes(camera: Camera, exchanged: bool, along_x: int, along_y: int) -> Camera:
    """The principal point with its offset from the centre along other axes."""
    half = 0.5 * camera.width_px, 0.5 * camera.height_px
    x, y = camera.cx_px - half[0], camera.cy_px - half[1]
    x, y = (y, x) if exchanged else (x, y)
    return replace(camera, cx_px=half[0] + along_x * x, cy_px=half[1] + along_y * y)


def between(camera: Camera, other: Camera, x: float) -> Camera:
    """A calibration that is 0 of the way to another, or 1, or anywhere on or beyond it."""
    names = ("fx_px", "fy_px", "cx_px", "cy_px")
    mixed = {n: (1.0 - x) * getattr(camera, n) + x * getattr(other, n) for n in names}
    lens = (p + x * (q - p) for p, q in zip(camera.distortion, other.distortion, strict=True))
    return replace(camera, **mixed, distortion=type(camera.distortion)(*lens))


def _each_and_all(names: Collection[str]) -> list[tuple[str, ...]]:
    """Each camera alone, and all together where there are several."""
    return list(dict.fromkeys([*((name,) for name in names), tuple(names)]))


def _at_once(reading: _Reading) -> Callable[[float], _Reading]:
    return lambda _: reading


def _scaled(now: _Reading, names: tuple[str, ...], factor: float, label: str) -> _Hypothesis:
    def reading(x: float) -> _Reading:
        scale = np.exp(x)
        return now.with_cameras({
            name: replace(c := now.cameras[name], fx_px=c.fx_px * scale, fy_px=c.fy_px * scale)
            for name in names
        })  # fmt: skip

    return _Hypothesis("TIES-FOCAL", label, names, reading, float(np.log(factor)), 0.005)


def _k1(cameras: Mapping[str, Camera], names: Iterable[str]) -> Array:
    """The first coefficients of radial distortion, NaN in a model without it."""
    return np.array([cameras[name].distortion._asdict().get("k1", np.nan) for name in names])


def _distorted(now: _Reading, names: tuple[str, ...]) -> _Hypothesis:
    def reading(x: float) -> _Reading:
        return now.with_cameras({
            name: replace(c := now.cameras[name], distortion=c.distortion._replace(k1=k1 + x))
            for name, k1 in zip(names, _k1(now.cameras, names).tolist(), strict=True)
        })  # fmt: skip

    return _Hypothesis("TIES-CALIBRATION", "", names, reading, 0.0, 0.005)


def _later(now: _Reading, seconds: float) -> _Hypothesis:
    return _Hypothesis(
        "TIES-TIME", "", (), lambda x: replace(now, time_s=now.time_s + x), seconds, 0.25
    )


def large_mistakes(mission: StatedMission, now: _Reading) -> Iterator[_Hypothesis]:
    """Large mistakes that users make, each as far as it changes anything."""
    for name, camera in now.cameras.items():
        mount, own = mission.mounts.get(name, Mount()), mission.camera_from_body(name)
        angles = np.array([mount.roll_rad, mount.pitch_rad, mount.yaw_rad])
        changes = UNIT_MISTAKES | ANGLE_MISTAKES
        others = {label: np.array(change(*angles)) for label, change in changes.items()}
        for more in _TURNS_DEG:
            others[f"with {more} deg more of roll, pitch and yaw"] = angles + np.radians(more)
        for label, other in others.items():
            if not np.allclose(other, angles):
                turned = Mount(*other.tolist()).camera_from_body @ own.T
                yield _Hypothesis("TIES-MOUNT", label, (name,), _at_once(now.turned(name, turned)))
        groups = [(name,), tuple(now.cameras)] if len(now.cameras) > 1 else [(name,)]
        for group in groups:
            for factor in _SCALES:
                yield _scaled(now, group, factor, "")
            for width in _SENSOR_WIDTHS_MM if camera.fx_px < 0.2 * camera.width_px else ():
                yield _scaled(now, group, camera.width_px / width, "in millimetres, not pixels")
        for axes in ("exchanged", "upward"):
            reading = replace(now, axes={**now.axes, name: axes})
            yield _Hypothesis("TIES-PIXELS", axes, (name,), _at_once(reading))
    for a, b in combinations(now.cameras, 2):
        swapped = now.with_cameras({a: now.cameras[b], b: now.cameras[a]})
        turn = mission.camera_from_body(b) @ mission.camera_from_body(a).T
        reading = swapped.turned(a, turn).turned(b, turn.T)
        yield _Hypothesis("TIES-CAMERAS", f"{a} and {b}", (a, b), _at_once(reading))
    for seconds in _TIMES_S if mission.shifted is not None else ():
        yield _later(now, seconds)
        yield _later(now, -seconds)


def _refined(
    mission: StatedMission, h: _Hypothesis, points: Integers | None
) -> tuple[_Hypothesis, float]:
    """A hypothesis at its most likely amount by some points or all, with the sigma of that."""
    if h.code == "TIES-MOUNT":
        reading = h.reading(0.0)
        for _ in range(3):
            turn, _ = reading.intersected(mission, points).camera_rotation(h.camera)
            reading = reading.turned(h.camera, Rotation.from_rotvec(turn).as_matrix())
        moved = Rotation.from_matrix(
            reading.turns[h.camera] @ h.reading(0.0).turns[h.camera].T
        ).magnitude()
        label = h.label if moved < _LARGEST_REFINEMENT_RAD else ""
        return replace(h, reading=_at_once(reading), label=label), 0.0
    x, step, sigma = h.x, h.step, float("inf")
    for _ in range((4 if points is not None else 1) if step else 0):
        tried = (h.reading(at).intersected(mission, points) for at in (x - step, x, x + step))
        low, middle, high = (found.log_likelihood for found in tried)
        curve = low - 2.0 * middle + high
        if curve < 0.0:
            sigma = step / float(np.sqrt(-curve))
            change = float(np.clip(0.5 * step * (low - high) / curve, -3.0 * step, 3.0 * step))
            x, step = x + change, min(max(sigma, 0.1 * step), step)
            if abs(change) < _SETTLED * sigma:
                break
        else:
            x += 3.0 * step * float(np.sign(high - low))
    return replace(h, x=x, step=step), sigma


def _described(
    mission: StatedMission, h: _Hypothesis, reading: _Reading, found: Intersection, sigma: float
) -> str:
    """What a hypothesis estimates, in one sentence; empty where stated sigmas explain it."""
    o = found.orientations
    above = _above_points(found)
    heights_m = float(np.hypot(mission.sigma_heights_m, np.nanmedian(o.sigma[:, 2])))
    least = _SMALL.get(h.code, 0.0)
    if h.code == "TIES-MOUNT":
        return _turn_of(mission, h, reading, found)
    names, of = h.cameras, f"of {' and '.join(h.cameras)} is"
    if h.code == "TIES-FOCAL":
        sizes = ([c[name].fx_px for name in names] for c in (mission.cameras, reading.cameras))
        stated, size = map(np.array, sizes)
        explained = max(least, _SIGMAS * float(np.hypot(sigma, heights_m / above)))
        text = f"the principal distance {of} {_listed(size, '.0f')} px +- {size[0] * sigma:.2g}, "
        text += f"not {_listed(stated, 'g')}" + (f": it is {h.label}" if h.label else "")
        return text if np.abs(np.log(size / stated)).max() > explained else ""
    if h.code == "TIES-CALIBRATION":
        stated, k1 = (_k1(cameras, names) for cameras in (mission.cameras, reading.cameras))
        every = (mission.cameras[name] for name in names)
        corner = 0.5 * max(np.hypot(c.width_px / c.fx_px, c.height_px / c.fy_px) for c in every)
        explained = max(least / corner**2, _SIGMAS * sigma)
        text = f"the radial distortion k1 {of} {_listed(k1, '.4f')} +- {sigma:.2g}, not "
        return text + _listed(stated, "g") if np.abs(k1 - stated).max() > explained else ""
    if h.code == "TIES-HEIGHT":
        x, spread = reading.up_m, _SIGMAS * float(np.hypot(sigma, heights_m))
        text = f"the stations lie {abs(x):.1f} m +- {sigma:.2g} too {'low' if x > 0 else 'high'} "
        text += "above the given heights of the ground"
        near = {name: abs(y - x) for name, y in mission.other_heights_m.items()}
        likely = min(near, key=lambda name: near[name], default="")
        if likely and near[likely] < max(0.05 * abs(x), spread):
            text += f", as if {likely}"
        return text if abs(x) > max(least * above, spread) else ""
    if h.code == "TIES-TIME" and mission.shifted is not None:
        moved = mission.shifted(0.5).centre_m - mission.shifted(-0.5).centre_m
        speed = max(float(np.nanmedian(np.linalg.norm(moved, axis=1))), 0.1)
        x, explained = reading.time_s, float(np.nanmedian(o.sigma[:, 0])) / speed
        text = f"the exposures are {abs(x):.2f} s +- {sigma:.2g} {'later' if x > 0 else 'earlier'}"
        text += " than stated" + (", as GPS time and UTC are apart" if 17 < abs(x) < 19 else "")
        return text if abs(x) > max(least, _SIGMAS * float(np.hypot(sigma, explained))) else ""
    if h.code == "TIES-PIXELS":
        axes = "x and y are exchanged" if h.label == "exchanged" else "y counts upward"
        return f"in the pixels of {h.camera} {axes}"
    return f"the images of {h.label} are each other's"


def _listed(values: Array, form: str) -> str:
    return " and ".join(format(value, form) for value in values)


def _turn_of(mission: StatedMission, h: _Hypothesis, reading: _Reading, found: Intersection) -> str:
    """As `_described`, of a mount."""
    o, turn = found.orientations, reading.turns[h.camera]
    own = (o.camera == h.camera) & np.isfinite(o.centre_m[:, 0])
    axes = o.camera_from_ecef[own] @ np.swapaxes(o.enu_from_ecef[own], 1, 2)
    spread = axes * o.sigma[own, None, 3:]
    estimated = max(1.0, found.sigma_factor) ** 2 * found.camera_rotation(h.camera)[1]
    explained = np.mean(spread @ np.swapaxes(spread, 1, 2), axis=0) + estimated
    vector = Rotation.from_matrix(turn).as_rotvec()
    size = float(np.linalg.norm(vector))
    if size < _SMALL[h.code] or vector @ np.linalg.solve(explained, vector) < _SIGMAS**2:
        return ""
    body = (CAMERA_AT_REST.T @ turn @ mission.camera_from_body(h.camera)).T
    yaw, pitch, roll = Rotation.from_matrix(body).as_euler("ZYX", degrees=True)
    sigma = float(np.degrees(np.sqrt(np.diag(estimated).max())))
    text = f"{h.camera} is turned by {np.degrees(size):.2f} deg +- {sigma:.2g} against that stated"
    if mission.mounts:
        text += f": its mount is roll_deg {roll:.2f}, pitch_deg {pitch:.2f}, yaw_deg {yaw:.2f}"
    return text + (f", as {h.label.format('roll', 'pitch', 'yaw')}" if h.label else "")
