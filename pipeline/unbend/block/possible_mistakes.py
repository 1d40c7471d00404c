"""What may be wrong with a mission file: each likely mistake as a hypothesis of how to read it.

The stations are held, and the rays of tie points are intersected under each hypothesis: cameras
exchanged, another mount, another principal distance, a radial distortion, a calibration of other
signs or axes, exposures earlier or later, heights from another zero, other axes of the pixels.
`diagnosis` decides between them.
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
CALIBRATION_STEP = 0.25  # of the way from the stated calibration to the other one
HEIGHT_STEP_M = 1.0
FOCAL_STEP = 0.005  # of the natural logarithm of the principal distance
K1_STEP = 0.005  # of the first coefficient of radial distortion
TIME_STEP_S = 0.25

# Large mistakes that users make.
SCALES = (0.25, 0.5, 2.0 / 3.0, 0.8, 1.25, 1.5, 2.0, 4.0)  # of images, or of crops
SENSOR_WIDTHS_MM = (6.2, 13.2, 17.3, 23.5, 36.0, 43.8, 53.4)
SHORTEST_FOCAL = 0.2  # of the width of the image: a shorter one is that in millimetres
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

    @property
    def without_heights(self) -> StatedMission:
        """The same, of which no given height counts."""
        return replace(self, heights_of=())


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to read a mission file: what is changed against what is stated."""

    cameras: Mapping[str, Camera]
    axes: Mapping[str, str] = field(default_factory=dict)
    turns: Mapping[str, Array] = field(default_factory=dict)  # (3, 3) by camera
    time_s: float = 0.0
    up_m: float = 0.0

    def orientations(self, mission: StatedMission) -> Orientations:
        """The orientations of the mission, read this way."""
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
        """The apparent rays of the mission, read this way."""
        return mission.rays(self.cameras, self.axes)

    def misses(self, mission: StatedMission, points: Intersection) -> Array:
        """(r, 2) what the apparent rays miss points by that were intersected otherwise [rad]."""
        orientations = self.orientations(mission)
        rays = self.rays(mission)
        return points.misses(orientations, rays)

    def intersected(self, mission: StatedMission, points: Integers | None = None) -> Intersection:
        """The intersection of all points by straight rays, or of ``points`` by apparent rays."""
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
        """The same with other calibrations of some cameras."""
        return replace(self, cameras={**self.cameras, **cameras})

    def turned(self, camera: str, turn: Array) -> Reading:
        """The same with one camera turned further."""
        turn_before = self.turns.get(camera, np.eye(3))
        turned = turn @ turn_before
        return replace(self, turns={**self.turns, camera: turned})

    def settled(self, mission: StatedMission) -> Reading:
        """The same with every camera turned to where the rays meet best."""
        intersection = self.intersected(mission)
        reading = self
        for name in self.cameras:
            vector, _ = intersection.camera_rotation(name)
            turn = Rotation.from_rotvec(vector).as_matrix()
            reading = reading.turned(name, turn)
        return reading


@dataclass(frozen=True, eq=False)
class PossibleMistake:
    """A change by an amount of what is stated; ``step`` is 0 where it has no amount.

    ``reading_by`` gives the reading for an amount; ``cameras`` are those that are changed.
    """

    code: str
    label: str
    cameras: tuple[str, ...]
    reading_by: Callable[[float], Reading]
    amount: float = 0.0
    step: float = 0.0

    @property
    def reading(self) -> Reading:
        """The reading at its amount."""
        return self.reading_by(self.amount)

    @property
    def camera(self) -> str:
        """The one camera, empty where there are several."""
        return self.cameras[0] if len(self.cameras) == 1 else ""

    @property
    def subject(self) -> tuple[str, str]:
        """What two hypotheses have in common that are one.

        Calibrations do not meet when they are estimated: those of other names are others.
        """
        if self.code == "TIES-CALIBRATION":
            return self.code, self.label or self.camera
        return self.code, self.camera

    @property
    def log_odds(self) -> float:
        """How likely the mistake is beforehand, as a natural logarithm.

        More if it has a name, less if all cameras have it alike.
        """
        if self.label:
            return LOG_RATIO_NEEDED
        of_calibration = self.code in ("TIES-FOCAL", "TIES-CALIBRATION")
        if of_calibration and len(self.cameras) > 1:
            return -2.0 * LOG_RATIO_NEEDED
        return 0.0


@dataclass(frozen=True, eq=False)
class LinearEstimate:
    """The most likely amount of a hypothesis, and what the log likelihood gains by it."""

    hypothesis: PossibleMistake
    amount: float
    gain: float


def linear_estimates(
    mission: StatedMission,
    current: Reading,
    intersection: Intersection,
    hypotheses: Sequence[PossibleMistake],
    beside: Array,
) -> list[LinearEstimate]:
    """The estimate of each hypothesis alone, with errors of stations ``beside`` it.

    ``intersection`` is that of the ``current`` reading.
    """
    misses = current.misses(mission, intersection)
    changes = [np.zeros((intersection.bad.size, 2, 0))]
    for hypothesis in hypotheses:
        step = hypothesis.amount or hypothesis.step
        change = hypothesis.reading_by(step).misses(mission, intersection) - misses
        changes.append(np.nan_to_num(change / step)[:, :, None])
    gains, amounts = intersection.likely_amounts(np.concatenate(changes, axis=2), beside)
    estimates = []
    for number, hypothesis in enumerate(hypotheses):
        amount = float(amounts[number])
        gain = float(gains[number])
        estimates.append(LinearEstimate(hypothesis, amount, gain))
    return estimates


# ---------------------------------------------------------------------- single mistakes


def turned_mount(reading: Reading, camera: str, turn: Array, label: str = "") -> PossibleMistake:
    """A mount that is turned by a matrix; it has no amount."""
    turned = reading.turned(camera, turn)
    return PossibleMistake("TIES-MOUNT", label, (camera,), lambda _: turned)


def raised_stations(reading: Reading) -> PossibleMistake:
    """All stations higher, by metres."""

    def raised(metres: float) -> Reading:
        return replace(reading, up_m=reading.up_m + metres)

    return PossibleMistake(
        "TIES-HEIGHT",
        label="",
        cameras=(),
        reading_by=raised,
        step=HEIGHT_STEP_M,
    )


def later_exposures(reading: Reading, seconds: float) -> PossibleMistake:
    """All exposures later, by seconds."""

    def later(more_seconds: float) -> Reading:
        return replace(reading, time_s=reading.time_s + more_seconds)

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
    """Other principal distances of some cameras; the amount is ln(other / stated)."""

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
    """More radial distortion of some cameras, by what is added to k1."""
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
    """The first coefficients of radial distortion, NaN in a model without it."""
    coefficients = []
    for name in names:
        lens = cameras[name].distortion._asdict()
        coefficients.append(lens.get("k1", np.nan))
    return np.array(coefficients)


def other_calibration(
    reading: Reading, corrected: Mapping[str, Camera], mistake: str
) -> PossibleMistake:
    """Calibrations without a mistake, at 1; of one that is a little off another amount is best."""

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
    """Mistaken calibrations, each without its mistake."""
    hypotheses = []
    for mistake, corrected in mistaken_calibrations(reading.cameras):
        hypotheses.append(other_calibration(reading, corrected, mistake))
    return hypotheses


def small_errors(
    mission: StatedMission, reading: Reading, intersection: Intersection, least_gain: float
) -> Iterator[PossibleMistake]:
    """Errors that all stations share, by which the log likelihood gains ``least_gain`` or more.

    ``intersection`` is that of the ``reading``.
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
    beside = np.zeros((intersection.orientations.camera.size, 6, 0))
    for estimate in linear_estimates(mission, reading, intersection, hypotheses, beside):
        if estimate.gain >= least_gain:
            yield with_linear_amount(estimate)


def with_linear_amount(estimate: LinearEstimate) -> PossibleMistake:
    """A hypothesis at its estimated amount, if what it changes is as good as linear in it."""
    hypothesis = estimate.hypothesis
    if hypothesis.code in ("TIES-HEIGHT", "TIES-CALIBRATION"):
        return replace(hypothesis, amount=estimate.amount)
    return hypothesis


def flown_cameras(reading: Reading, orientations: Orientations) -> list[str]:
    """The names of the cameras that took images with these orientations."""
    return [name for name in reading.cameras if np.any(orientations.camera == name)]


def large_mistakes(mission: StatedMission, reading: Reading) -> Iterator[PossibleMistake]:
    """Large mistakes that users make, each as far as it changes anything."""
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
    """A mount with angles of other units, signs or order, or quarter and half turns more."""
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
    """A principal distance of images of another size, or in millimetres, of one camera and all."""
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
    """Pixels of some cameras along other axes; it has no amount."""
    changed = replace(reading, axes={**reading.axes, **dict.fromkeys(cameras, axes)})
    return PossibleMistake("TIES-PIXELS", axes, cameras, lambda _: changed)


def exchanged_cameras(
    mission: StatedMission, reading: Reading, first: str, second: str
) -> PossibleMistake:
    """The images of two cameras exchanged; it has no amount."""
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
