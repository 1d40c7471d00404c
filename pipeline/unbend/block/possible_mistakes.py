"""Possible mistakes in a mission file, each as a hypothesis that changes what it states.

Under each hypothesis the rays of tie points are intersected with fixed stations: cameras exchanged,
another mount, another principal distance, a radial distortion, a calibration with other signs or
axes, exposures earlier or later, heights from another zero, other axes of the pixels. `diagnosis`
decides between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.calibration_mistakes import between, each_and_all, mistaken_calibrations
from unbend.block.image_rays import ImageRays, Orientations, straightened
from unbend.block.intersection import Intersection, intersect
from unbend.flight.mount import Mount
from unbend.flight.rotations import ANGLE_MISTAKES, UNIT_MISTAKES
from unbend.refraction.camera.camera import Camera
from unbend.units import Array, Integers

EXPLAINED_SIGMAS = 4.0  # a stated sigma explains no larger error that all stations share

# First steps by which an amount is varied to find the most likely one.
CALIBRATION_STEP = 0.25  # of the way from the stated calibration to the corrected one
HEIGHT_STEP_M = 1.0
FOCAL_STEP = 0.005  # of the natural logarithm of the principal distance
K1_STEP = 0.005  # of the first coefficient of radial distortion
TIME_STEP_S = 0.25

# Large mistakes that users make.
SCALES = (0.25, 0.5, 2.0 / 3.0, 0.8, 1.25, 1.5, 2.0, 4.0)  # of resized images, and of crops
SENSOR_WIDTHS_MM = (6.2, 13.2, 17.3, 23.5, 36.0, 43.8, 53.4)
SHORTEST_FOCAL = 0.2  # of the width of the image: a shorter one may be in millimetres
TIMES_S = (0.5, 1.0, 2.0, 5.0, 10.0, 18.0, 60.0, 1800.0, 3600.0, 7200.0)  # 18 leap seconds
MORE_ROLL_PITCH_YAW_DEG = (
    (0, 0, 90),
    (0, 0, -90),
    (0, 0, 180),
    (0, 90, 0),
    (0, -90, 0),
    (90, 0, 0),
    (-90, 0, 0),
    (0, 180, 0),
)  # that a mount may have more than stated


@dataclass(frozen=True, eq=False)
class StatedMission:
    """What a mission file states, as far as tie points can contradict it.

    ``rays`` computes the apparent rays from cameras, and from the axes of their pixels: "exchanged"
    (x and y) or "upward" (y), by camera; a camera without an entry has x right, y down.
    ``shifted`` computes the orientations, in the same rows, at times later by some seconds.
    """

    orientations: Orientations
    cameras: Mapping[str, Camera]
    rays: Callable[[Mapping[str, Camera], Mapping[str, str]], ImageRays]
    mounts: Mapping[str, Mount] = field(default_factory=dict)  # empty: attitudes are of cameras
    shifted: Callable[[float], Orientations] | None = None  # None without a trajectory
    sigma_heights_m: float = 0.0  # of an error that all given heights share
    sigma_height_m: float = 1.0  # of a single given height
    heights_of: tuple[int, ...] = ()  # points with a given height that counts
    other_heights_m: Mapping[str, float] = field(default_factory=dict)  # known causes: up_m by name
    one_height: bool = False  # one given height for all points

    def camera_from_body(self, camera: str) -> Array:
        """(3, 3) rotation of the stated mount; without a mount, of a camera that looks down."""
        return self.mounts.get(camera, Mount()).camera_from_body

    @property
    def without_heights(self) -> StatedMission:
        """The same mission, without given heights."""
        return replace(self, heights_of=())


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to read a mission file, with changes of what it states."""

    cameras: Mapping[str, Camera]
    axes: Mapping[str, str] = field(default_factory=dict)  # of pixels: `StatedMission.rays`
    turns: Mapping[str, Array] = field(default_factory=dict)  # (3, 3) in the camera, by camera
    time_s: float = 0.0  # exposures later by this
    up_m: float = 0.0  # stations higher by this

    def orientations(self, mission: StatedMission) -> Orientations:
        """The orientations of the mission with the changes of this reading."""
        orientations = mission.orientations
        if self.time_s and mission.shifted is not None:
            orientations = mission.shifted(self.time_s)
        up = orientations.enu_from_ecef[:, 2]
        orientations = replace(orientations, centre_m=orientations.centre_m + self.up_m * up)
        for camera, turn in self.turns.items():
            vector = Rotation.from_matrix(turn).as_rotvec()
            orientations = orientations.turned(vector, camera)
        return orientations

    def rays(self, mission: StatedMission) -> ImageRays:
        """The apparent rays of the mission with the changes of this reading."""
        return mission.rays(self.cameras, self.axes)

    def misses(self, mission: StatedMission, points: Intersection) -> Array:
        """(r, 2) misses [rad] of the apparent rays at points that another reading intersected."""
        orientations = self.orientations(mission)
        rays = self.rays(mission)
        return points.misses(orientations, rays)

    def intersected(self, mission: StatedMission, points: Integers | None = None) -> Intersection:
        """The intersection of all points by straight rays; or of some, by apparent rays.

        Apparent rays are faster. ``points`` are numbers of points, None for all.
        """
        orientations = self.orientations(mission)
        rays = self.rays(mission)
        if points is not None:
            rays = rays.of_points(points)
        if rays.height_m is not None:
            counts = np.isin(rays.point, mission.heights_of)
            height_m = np.where(counts, rays.height_m, np.nan)
            rays = replace(rays, height_m=height_m, sigma_height_m=mission.sigma_height_m)
        if points is None:
            rays = straightened(orientations, rays)
        return intersect(orientations, rays)

    def with_cameras(self, cameras: Mapping[str, Camera]) -> Reading:
        """The same reading with other calibrations of some cameras."""
        return replace(self, cameras={**self.cameras, **cameras})

    def turned(self, camera: str, turn: Array) -> Reading:
        """The same reading with one camera turned further, by a rotation (3, 3) in its frame."""
        turn_before = self.turns.get(camera, np.eye(3))
        turned = turn @ turn_before
        return replace(self, turns={**self.turns, camera: turned})

    def with_best_turns(self, mission: StatedMission) -> Reading:
        """The same reading with every camera turned to where the rays meet best."""
        intersection = self.intersected(mission)
        reading = self
        for name in self.cameras:
            vector, _ = intersection.camera_rotation(name)
            turn = Rotation.from_rotvec(vector).as_matrix()
            reading = reading.turned(name, turn)
        return reading


@dataclass(frozen=True, eq=False)
class PossibleMistake:
    """A hypothesis: a change, by an amount, of what the mission file states."""

    code: str
    label: str  # which mistake of its kind, in words; empty for an error without a name
    cameras: tuple[str, ...]  # that are changed; empty if it concerns all stations
    reading_by: Callable[[float], Reading]  # the reading for an amount
    amount: float = 0.0
    step: float = 0.0  # first change of the amount to find the best; 0: there is no amount

    @property
    def reading(self) -> Reading:
        """The reading at its amount."""
        return self.reading_by(self.amount)

    @property
    def camera(self) -> str:
        """The camera of a mistake of one camera; empty for several or none."""
        return self.cameras[0] if len(self.cameras) == 1 else ""

    @property
    def subject(self) -> tuple[str, str]:
        """Key for comparison: equal for hypotheses that are the same mistake.

        Estimates of calibrations stay apart: those with another label are another mistake.
        """
        if self.code == "TIES-CALIBRATION":
            return self.code, self.label or self.camera
        return self.code, self.camera

    @property
    def log_odds(self) -> float:
        """Prior log odds of the mistake.

        Higher for a mistake with a label, which users are known to make; lower for an error of the
        calibration that all cameras have alike.
        """
        if self.label:
            return LOG_RATIO_NEEDED
        of_calibration = self.code in ("TIES-FOCAL", "TIES-CALIBRATION")
        if of_calibration and len(self.cameras) > 1:
            return -2.0 * LOG_RATIO_NEEDED
        return 0.0


@dataclass(frozen=True, eq=False)
class LinearEstimate:
    """The most likely amount of a hypothesis, and the gain of the log likelihood by it."""

    hypothesis: PossibleMistake
    amount: float
    gain: float


def linear_estimates(
    mission: StatedMission,
    current: Reading,
    intersection: Intersection,
    hypotheses: Sequence[PossibleMistake],
    shared: Array,
) -> list[LinearEstimate]:
    """Linear estimates of the amounts, of each hypothesis alone.

    ``intersection`` is that of the ``current`` reading. ``shared`` (s, 6, b) are errors of stations
    that are estimated together with each (`Intersection.likely_amounts`).
    """
    misses = current.misses(mission, intersection)
    changes = [np.zeros((intersection.bad.size, 2, 0))]
    for hypothesis in hypotheses:
        step = hypothesis.amount or hypothesis.step
        change = hypothesis.reading_by(step).misses(mission, intersection) - misses
        changes.append(np.nan_to_num(change / step)[:, :, None])
    gains, amounts = intersection.likely_amounts(np.concatenate(changes, axis=2), shared)
    estimates = []
    for number, hypothesis in enumerate(hypotheses):
        amount = float(amounts[number])
        gain = float(gains[number])
        estimates.append(LinearEstimate(hypothesis, amount, gain))
    return estimates


# ---------------------------------------------------------------------- single mistakes


def turned_mount(reading: Reading, camera: str, turn: Array, label: str = "") -> PossibleMistake:
    """The hypothesis that a mount is turned, by a rotation (3, 3) in the camera; no amount."""
    turned = reading.turned(camera, turn)
    return PossibleMistake("TIES-MOUNT", label, (camera,), lambda _: turned)


def raised_stations(reading: Reading) -> PossibleMistake:
    """The hypothesis that all stations are higher; the amount is in metres."""

    def raised(up_m: float) -> Reading:
        return replace(reading, up_m=reading.up_m + up_m)

    return PossibleMistake(
        "TIES-HEIGHT",
        label="",
        cameras=(),
        reading_by=raised,
        step=HEIGHT_STEP_M,
    )


def later_exposures(reading: Reading, seconds: float) -> PossibleMistake:
    """The hypothesis that all exposures are later; the amount is in seconds."""

    def later(later_s: float) -> Reading:
        return replace(reading, time_s=reading.time_s + later_s)

    return PossibleMistake(
        "TIES-TIME",
        label="",
        cameras=(),
        reading_by=later,
        amount=seconds,
        step=TIME_STEP_S,
    )


def scaled_focal(
    reading: Reading, cameras: tuple[str, ...], factor: float, label: str = ""
) -> PossibleMistake:
    """The hypothesis of other principal distances of some cameras, at first by ``factor``.

    The amount is ln(other / stated).
    """

    def scaled(log_scale: float) -> Reading:
        scale = np.exp(log_scale)
        scaled_cameras = {}
        for name in cameras:
            camera = reading.cameras[name]
            scaled_cameras[name] = replace(
                camera,
                fx_px=camera.fx_px * scale,
                fy_px=camera.fy_px * scale,
            )
        return reading.with_cameras(scaled_cameras)

    return PossibleMistake(
        "TIES-FOCAL",
        label=label,
        cameras=cameras,
        reading_by=scaled,
        amount=float(np.log(factor)),
        step=FOCAL_STEP,
    )


def radial_distortion(reading: Reading, cameras: tuple[str, ...]) -> PossibleMistake:
    """The hypothesis of another radial distortion of some cameras; the amount is added to k1."""
    k1_of_cameras = first_coefficients(reading.cameras, cameras).tolist()

    def distorted(added: float) -> Reading:
        changed = {}
        for name, k1 in zip(cameras, k1_of_cameras, strict=True):
            camera = reading.cameras[name]
            lens = camera.distortion._replace(k1=k1 + added)
            changed[name] = replace(camera, distortion=lens)
        return reading.with_cameras(changed)

    return PossibleMistake(
        "TIES-CALIBRATION",
        label="",
        cameras=cameras,
        reading_by=distorted,
        step=K1_STEP,
    )


def first_coefficients(cameras: Mapping[str, Camera], names: Iterable[str]) -> Array:
    """(n,) coefficients k1 of radial distortion of the named cameras, NaN in a model without."""
    coefficients = []
    for name in names:
        lens = cameras[name].distortion._asdict()
        coefficients.append(lens.get("k1", np.nan))
    return np.array(coefficients)


def other_calibration(
    reading: Reading, corrected: Mapping[str, Camera], mistake: str
) -> PossibleMistake:
    """The hypothesis of corrected calibrations; the amount is 0 for the stated, 1 for these."""

    def partly(share: float) -> Reading:
        mixed = {}
        for name, camera in corrected.items():
            mixed[name] = between(reading.cameras[name], camera, share)
        return reading.with_cameras(mixed)

    return PossibleMistake(
        "TIES-CALIBRATION",
        label=mistake,
        cameras=tuple(corrected),
        reading_by=partly,
        amount=1.0,
        step=CALIBRATION_STEP,
    )


# ---------------------------------------------------------------------- all mistakes of a kind


def other_calibrations(reading: Reading) -> list[PossibleMistake]:
    """The hypotheses of all `mistaken_calibrations`."""
    hypotheses = []
    for mistake, corrected in mistaken_calibrations(reading.cameras):
        hypotheses.append(other_calibration(reading, corrected, mistake))
    return hypotheses


def small_errors(
    mission: StatedMission, reading: Reading, intersection: Intersection, least_gain: float
) -> Iterator[PossibleMistake]:
    """Hypotheses of small errors with a linear estimate that gains ``least_gain`` or more.

    They are turned mounts, higher stations, other principal distances, radial distortions and later
    exposures. The gain is that of the log likelihood; ``intersection`` is that of ``reading``.
    """
    names = flown_cameras(reading, intersection.orientations)
    for name in names:
        vector, covariance = intersection.camera_rotation(name)
        chi_square = vector @ np.linalg.pinv(covariance, hermitian=True) @ vector
        if intersection.gain_of(chi_square) >= least_gain:
            turn = Rotation.from_rotvec(vector).as_matrix()
            yield turned_mount(reading, name, turn)

    groups = each_and_all(names)
    hypotheses = [raised_stations(reading)]
    hypotheses += [scaled_focal(reading, group, 1.0) for group in groups]
    for group in groups:
        if np.isfinite(first_coefficients(reading.cameras, group)).all():
            hypotheses.append(radial_distortion(reading, group))
    if mission.shifted is not None:
        hypotheses.append(later_exposures(reading, 0.0))
    no_shared = np.zeros((intersection.orientations.camera.size, 6, 0))
    for estimate in linear_estimates(mission, reading, intersection, hypotheses, no_shared):
        if estimate.gain >= least_gain:
            yield with_linear_amount(estimate)


def with_linear_amount(estimate: LinearEstimate) -> PossibleMistake:
    """The hypothesis at its estimated amount, if the rays change linearly with the amount.

    Others start from their first amount.
    """
    hypothesis = estimate.hypothesis
    if hypothesis.code in ("TIES-HEIGHT", "TIES-CALIBRATION"):
        return replace(hypothesis, amount=estimate.amount)
    return hypothesis


def flown_cameras(reading: Reading, orientations: Orientations) -> list[str]:
    """The names of the cameras that took images with these orientations."""
    return [name for name in reading.cameras if np.any(orientations.camera == name)]


def large_mistakes(mission: StatedMission, reading: Reading) -> Iterator[PossibleMistake]:
    """Hypotheses of the large mistakes that users make."""
    for name in reading.cameras:
        yield from mistaken_mounts(mission, reading, name)
        yield from mistaken_focals(reading, name)
    for group in each_and_all(flown_cameras(reading, mission.orientations)):
        for axes in ("exchanged", "upward"):
            yield other_pixel_axes(reading, group, axes)
    for first, second in combinations(reading.cameras, 2):
        yield exchanged_cameras(mission, reading, first, second)
    if mission.shifted is not None:
        for seconds in TIMES_S:
            yield later_exposures(reading, seconds)
            yield later_exposures(reading, -seconds)


def mistaken_mounts(
    mission: StatedMission, reading: Reading, camera: str
) -> Iterator[PossibleMistake]:
    """Mounts with angles in other units, signs or order, and with quarter or half turns more."""
    mount = mission.mounts.get(camera, Mount())
    angles = np.array([mount.roll_rad, mount.pitch_rad, mount.yaw_rad])
    other_angles = {}
    for label, change in (UNIT_MISTAKES | ANGLE_MISTAKES).items():
        other_angles[label] = np.array(change(*angles))
    for more_deg in MORE_ROLL_PITCH_YAW_DEG:
        label = f"with {more_deg} deg more of roll, pitch and yaw"
        other_angles[label] = angles + np.radians(more_deg)
    body_from_camera = mission.camera_from_body(camera).T
    for label, mistaken in other_angles.items():
        if not np.allclose(mistaken, angles):
            turn = Mount(*mistaken.tolist()).camera_from_body @ body_from_camera
            yield turned_mount(reading, camera, turn, label)


def mistaken_focals(reading: Reading, name: str) -> Iterator[PossibleMistake]:
    """Principal distances of another image size or in millimetres, of one camera and of all."""
    camera = reading.cameras[name]
    groups: list[tuple[str, ...]] = [(name,)]
    if len(reading.cameras) > 1:
        groups.append(tuple(reading.cameras))
    for group in groups:
        for factor in SCALES:
            yield scaled_focal(reading, group, factor)
        if camera.fx_px < SHORTEST_FOCAL * camera.width_px:
            for width_mm in SENSOR_WIDTHS_MM:
                px_per_mm = camera.width_px / width_mm
                yield scaled_focal(reading, group, px_per_mm, "in millimetres, not pixels")


def other_pixel_axes(reading: Reading, cameras: tuple[str, ...], axes: str) -> PossibleMistake:
    """The hypothesis of other pixel axes ("exchanged" or "upward") of some cameras; no amount."""
    changed = replace(reading, axes={**reading.axes, **dict.fromkeys(cameras, axes)})
    return PossibleMistake("TIES-PIXELS", axes, cameras, lambda _: changed)


def exchanged_cameras(
    mission: StatedMission, reading: Reading, first: str, second: str
) -> PossibleMistake:
    """The hypothesis that the images of two cameras are exchanged; no amount."""
    cameras = {
        first: reading.cameras[second],
        second: reading.cameras[first],
    }
    turn = mission.camera_from_body(second) @ mission.camera_from_body(first).T
    changed = reading.with_cameras(cameras)
    changed = changed.turned(first, turn)
    changed = changed.turned(second, turn.T)
    return PossibleMistake(
        "TIES-CAMERAS",
        label=f"{first} and {second}",
        cameras=(first, second),
        reading_by=lambda _: changed,
    )
