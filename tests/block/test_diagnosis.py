"""What tie points find in a mission file, on blocks simulated with numpy alone.

Sound blocks have the seeds below UNBEND_BLOCKS (2; `make faults`: 8). With fewer than 8, one of the
cases of each mistake is drawn from UNBEND_SEED.
"""

import os
import random
import re
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from tests.block.simulated_block import simulate_block, unit
from tests.draws import SEED
from unbend.block.calibration_mistakes import OffsetAxes, with_other_axes
from unbend.block.diagnosis import diagnosis, finding_of, refined
from unbend.block.image_rays import ImageRays, straightened
from unbend.block.possible_mistakes import PossibleMistake, StatedMission
from unbend.flight.mount import Mount
from unbend.refraction.angle import one_angle
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera

BLOCKS = int(os.environ.get("UNBEND_BLOCKS", "2"))
SIZE_PX = 9000
F_PX = 1e4
SPEED_M_S = 50.0


def camera(cx_px, cy_px, **lens):
    return Camera(SIZE_PX, SIZE_PX, F_PX, F_PX, cx_px, cy_px, BrownConrady(**lens))


CAMERAS = {
    "camera0": camera(
        4540.0,
        4475.0,
        k1=-0.02,
        k2=0.01,
        p1=2e-4,
    ),
    "camera1": camera(
        4462.0,
        4521.0,
        k1=-0.04,
        k2=0.01,
        p2=1e-4,
    ),
}
BOTH = tuple(CAMERAS)
EXCHANGED = {
    "camera0": CAMERAS["camera1"],
    "camera1": CAMERAS["camera0"],
}


def drawn(*cases):
    """All cases of a mistake in `make faults`, else one."""
    if BLOCKS >= 8:
        return cases
    return random.Random(SEED).sample(cases, 1)


def measured(block, measuring_cameras):
    """The pixels that cameras measure of a block, as a `StatedMission` reads rays."""

    def rays(cameras, axes):
        """Rays by some cameras, with x and y exchanged, or y upward, where ``axes`` say so."""
        direction = np.empty(block.direction.shape)
        for name, measuring in measuring_cameras.items():
            rows = block.camera[block.image] == name
            x, y, z = block.direction[rows].T
            pixels = measuring.project(x / z, y / z)
            if axes.get(name) == "exchanged":
                pixels = pixels[::-1]
            if axes.get(name) == "upward":
                pixels = (pixels[0], SIZE_PX - pixels[1])
            u, v, _ = cameras[name].rays(*pixels)
            direction[rows] = np.column_stack([u, v, np.ones(u.size)])
        heights_m = block.point_h[block.point]
        return ImageRays(block.image, block.point, unit(direction), 1e-4, heights_m)

    return rays


def make(seed, *, calibrations=CAMERAS, **options):
    """A block of two cameras as a mission file states it."""
    usual = {
        "cameras": (0.0, 0.35),
        "points": 500,
        "each": 8,
    }
    block = simulate_block(seed, **usual | options)
    orientations = block.orientations
    line = np.arange(block.lon.size) // 8
    heading = (-1.0) ** line  # one to, one fro
    east = orientations.enu_from_ecef[:, 0]
    velocity = SPEED_M_S * heading[:, None] * east

    def shifted(seconds):
        return replace(orientations, centre_m=orientations.centre_m + seconds * velocity)

    mounts = {
        "camera0": Mount(),
        "camera1": Mount(roll_rad=-0.35),
    }
    rays = measured(block, calibrations)
    return StatedMission(orientations, dict(calibrations), rays, mounts, shifted)


def with_cameras(mission, **changed):
    return replace(mission, cameras={**mission.cameras, **changed})


def with_attitudes(mission, turn, **changed):
    """The mission with the cameras turned, and with other changes."""
    logged = mission.orientations
    attitude = turn @ logged.camera_from_ecef
    return replace(
        mission,
        orientations=replace(logged, camera_from_ecef=attitude),
        **changed,
    )


def with_f(measuring, factor):
    """The camera with another principal distance."""
    f_px = factor * F_PX
    return replace(measuring, fx_px=f_px, fy_px=f_px)


def turned(mission, *rotation_rad):
    """The mission with the first camera turned."""
    orientations = mission.orientations.turned(np.array(rotation_rad), "camera0")
    return replace(mission, orientations=orientations)


def findings_of(mission):
    _, findings = diagnosis(mission)
    return findings


def first_finding(mission, code, key, most=4):
    """The most likely mistake, which must be this one, of at most so many."""
    findings = findings_of(mission)
    assert 1 <= len(findings) <= most
    assert findings[0].code == code
    assert findings[0].key == key
    return findings[0]


def only_finding(mission, code, key):
    return first_finding(mission, code, key, most=1)


def estimate_in(finding, pattern):
    return float(re.search(pattern, finding.what)[1])


@pytest.mark.parametrize("seed", range(BLOCKS))
def test_a_true_mission_file_raises_nothing(seed):
    points, findings = diagnosis(make(seed))
    assert findings == ()
    assert 0.7 < points.sigma_factor < 1.3


def test_sigmas_explain_a_common_error_as_large_as_they_are():
    """0.23 deg, where 0.17 are stated; not 1.7 deg."""
    mission = make(20)
    assert findings_of(turned(mission, 0.004, 0.0, 0.0)) == ()
    finding = only_finding(turned(mission, 0.03, 0.0, 0.0), "TIES-MOUNT", "mount.camera0")
    assert "turned by 1.7" in finding.what


def test_a_mount_with_the_other_sign_is_named_with_its_angle():
    mission = make(21)
    other = Mount(roll_rad=0.35)
    turn = other.camera_from_body @ mission.camera_from_body("camera1").T
    is_of_camera = mission.orientations.camera[:, None, None] == "camera1"
    wrong = with_attitudes(
        mission,
        np.where(is_of_camera, turn, np.eye(3)),
        mounts={**mission.mounts, "camera1": other},
    )
    finding = only_finding(wrong, "TIES-MOUNT", "mount.camera1")
    assert "other sign of roll" in finding.what
    assert re.search(r"is roll_deg -20\.[01]", finding.what)


@pytest.mark.parametrize("factor", drawn(0.004, 0.97, 2.0))
def test_a_wrong_principal_distance_is_estimated(factor):
    wrong = with_cameras(make(22), camera0=with_f(CAMERAS["camera0"], factor))
    finding = first_finding(wrong, "TIES-FOCAL", "cameras.camera0")
    assert estimate_in(finding, r" is about ([\d.]+) px") == pytest.approx(F_PX, rel=0.005)
    assert ("millimetres" in finding.what) == (factor < 0.1)


@pytest.mark.parametrize("best", [-0.0488, 0.12])
@pytest.mark.parametrize("points", [None, np.arange(3)])
def test_the_search_for_an_amount_does_not_stop_short_of_it(best, points):
    """A likelihood that is steep far from its top shows there a sigma that is far too small."""

    def reading_by(amount):
        away = abs(amount - best)
        intersection = SimpleNamespace(log_likelihood=-2e5 * away**1.5)
        return SimpleNamespace(intersected=lambda mission, points: intersection)

    start = 0.0
    if points is None:
        start = best + 0.002
    hypothesis = PossibleMistake(
        code="TIES-FOCAL",
        label="",
        cameras=("nadir",),
        reading_by=reading_by,
        amount=start,
        step=0.005,
    )
    found, sigma = refined(None, hypothesis, points)
    assert found.amount == pytest.approx(best, abs=1e-3)
    assert 0.0 < sigma < 0.005


@pytest.mark.parametrize("name", BOTH)
@pytest.mark.parametrize("factor", drawn(0.95, 1.05, 1.1))
def test_a_principal_distance_of_one_camera_accuses_no_other(name, factor):
    """Farther off than a first step reaches, and nearer than the large mistakes begin."""
    wrong = with_cameras(make(22), **{name: with_f(CAMERAS[name], factor)})
    finding = only_finding(wrong, "TIES-FOCAL", f"cameras.{name}")
    assert f"the principal distance of {name} is about " in finding.what
    assert finding.what.endswith(f"0 px, not {factor * F_PX:g}")
    assert estimate_in(finding, r" is about ([\d.]+) px") == pytest.approx(F_PX, rel=0.002)


@pytest.mark.parametrize(
    ("offset_s", "direction"), drawn((-1.5, "earlier"), (18.0, "later"), (3600.0, "later"))
)
def test_exposures_at_other_times_are_found_by_how_much(offset_s, direction):
    mission = make(23)

    def shifted(seconds):
        return mission.shifted(seconds - offset_s)

    wrong = replace(mission, orientations=shifted(0.0), shifted=shifted)
    finding = first_finding(wrong, "TIES-TIME", "events")
    says = rf"exposures are ([\d.]+) s \+- \S+ {direction} than"
    assert estimate_in(finding, says) == pytest.approx(abs(offset_s), abs=0.1)
    assert ("GPS time" in finding.what) == (offset_s == 18.0)


@pytest.mark.parametrize(
    ("low_m", "words", "is_beyond"),
    [
        (47.0, r"4[67]\..* too low .*as if this", False),
        (400.0, "too low .*by more than a datum explains$", True),
    ],
)
def test_heights_from_another_zero_are_found_and_named_or_beyond_a_datum(low_m, words, is_beyond):
    mission = make(24)
    right = mission.orientations
    up = right.enu_from_ecef[:, 2]
    wrong = replace(
        mission,
        orientations=replace(right, centre_m=right.centre_m - low_m * up),
        shifted=None,
        other_heights_m={"this": 46.8, "that": 120.0},
    )
    finding = first_finding(wrong, "TIES-HEIGHT", "ground")
    assert re.search(words, finding.what)
    assert finding.beyond_datums is is_beyond


@pytest.mark.parametrize("axes", drawn("exchanged", "upward"))
def test_other_axes_of_pixels(axes):
    """The table of one camera has them the other way: reading them so gives the true ones."""
    mission = make(25)

    def rays(cameras, read):
        is_right = read.get("camera1") == axes
        camera1 = "" if is_right else axes
        return mission.rays(cameras, {**read, "camera1": camera1})

    wrong = replace(mission, rays=rays)
    key = "observations" if axes == "upward" else "observations.columns"
    finding = first_finding(wrong, "TIES-PIXELS", key)
    assert "of camera1" in finding.what
    assert finding.label == axes


@pytest.mark.parametrize("axes", drawn("exchanged", "upward"))
def test_other_axes_of_the_pixels_of_all_cameras_are_one_finding(axes):
    mission = make(25)

    def rays(cameras, read):
        wrong_axes = {name: "" if read.get(name) == axes else axes for name in BOTH}
        return mission.rays(cameras, wrong_axes)

    finding = only_finding(
        replace(mission, rays=rays),
        "TIES-PIXELS",
        "observations" if axes == "upward" else "observations.columns",
    )
    assert finding.cameras == BOTH
    assert "of camera0 and camera1" in finding.what


def test_exchanged_cameras():
    mission = make(26)
    second_from_first = Mount(roll_rad=-0.35).camera_from_body @ Mount().camera_from_body.T
    is_first = mission.orientations.camera[:, None, None] == "camera0"
    exchanged = with_attitudes(
        mission,
        np.where(is_first, second_from_first, second_from_first.T),
        mounts={
            "camera0": Mount(roll_rad=-0.35),
            "camera1": Mount(),
        },
        cameras=EXCHANGED,
    )
    assert first_finding(exchanged, "TIES-CAMERAS", "cameras").log_ratio > 100.0


@pytest.mark.parametrize(
    ("axes", "cx_px", "cy_px"),
    [
        ((False, 1, 1), 60.0, 30.0),
        ((False, -1, 1), 40.0, 30.0),
        ((False, 1, -1), 60.0, 50.0),
        ((True, 1, 1), 40.0, 50.0),
        ((True, -1, 1), 60.0, 50.0),
        ((True, 1, -1), 40.0, 30.0),
    ],
)
def test_a_principal_point_along_other_axes(axes, cx_px, cy_px):
    """10 px right of the centre of 100 x 80 px, and 10 px above it."""
    other = with_other_axes(Camera(100, 80, 50.0, 50.0, 60.0, 30.0), OffsetAxes(*axes))
    assert (other.cx_px, other.cy_px) == (cx_px, cy_px)


def mirrored(right):
    return replace(right, cx_px=SIZE_PX - right.cx_px)


def exchanged_axes(right):
    return replace(
        right,
        cx_px=right.cy_px,
        cy_px=right.cx_px,
    )


def with_lens(right, coefficients):
    return replace(right, distortion=BrownConrady(*coefficients))


def other_sign(right):
    return with_lens(right, np.negative(right.distortion).tolist())


def key_of(names):
    return "cameras" if len(names) > 1 else f"cameras.{names[0]}"


@pytest.mark.parametrize(
    ("read", "names"),
    drawn(*product((mirrored, exchanged_axes, other_sign), (("camera1",), BOTH))),
)
def test_calibrations_of_other_signs_or_axes(read, names):
    misread = {name: read(CAMERAS[name]) for name in names}
    wrong = with_cameras(make(29), **misread)
    finding = first_finding(wrong, "TIES-CALIBRATION", key_of(names))
    if read is other_sign:
        assert "have the opposite sign" in finding.what
        return
    assert "have the opposite sign" not in finding.what
    for name in names:
        right = CAMERAS[name]
        assert f"{right.cx_px}, {right.cy_px} px in {name}" in finding.what


def test_calibrations_that_are_each_others():
    wrong = with_cameras(make(30), **EXCHANGED)
    finding = first_finding(wrong, "TIES-CALIBRATION", "cameras")
    assert finding.what == "the calibrations of camera0 and camera1 are exchanged"


def with_k1(k1):
    cameras = {}
    for name, right in CAMERAS.items():
        cameras[name] = with_lens(right, [k1])
    return cameras


@pytest.mark.parametrize(
    ("lenses", "names"),
    drawn(*product((CAMERAS, with_k1(0.06), with_k1(-0.4)), (("camera1",), BOTH))),
)
def test_a_distortion_that_is_not_stated(lenses, names):
    """It is no other principal distance, height or principal point; k2 of the lens goes into k1."""
    unstated = {name: with_lens(lenses[name], []) for name in names}

    findings = findings_of(with_cameras(make(3, calibrations=lenses), **unstated))

    estimates = {}
    for finding in findings:
        assert finding.code == "TIES-CALIBRATION"
        words = re.fullmatch(r"the radial distortion k1 of (.*) is (.*) \+- .*", finding.what)
        of_cameras = words[1].split(" and ")
        assert finding.key == key_of(of_cameras)
        for name, k1 in zip(of_cameras, words[2].split(" and "), strict=True):
            estimates[name] = float(k1)
    true_k1 = {name: lenses[name].distortion.k1 for name in names}
    assert estimates == pytest.approx(true_k1, rel=0.3)
    assert findings[-1].sigma_factor < 1.6


def test_a_principal_distance_that_is_wrong_in_all_cameras():
    longer = {name: with_f(right, 1.03) for name, right in CAMERAS.items()}
    longer["without an image"] = CAMERAS["camera0"]
    wrong = with_cameras(make(3), **longer)
    finding = only_finding(wrong, "TIES-FOCAL", "cameras")
    estimates = re.search(r"of camera0 and camera1 is about (\d+) and (\d+) px", finding.what)
    f_px = [float(estimate) for estimate in estimates.groups()]
    assert f_px == pytest.approx([F_PX] * 2, rel=2e-3)
    assert finding.what.endswith("not 10300 and 10300")


@pytest.mark.parametrize("seed", range(BLOCKS // 2))
def test_calibrations_that_drifted_are_not_taken_for_mistaken_ones(seed):
    """The principal point by a fifth of its offset, the distortion by up to 5 %."""
    rng = np.random.default_rng(seed)
    drifted = {}
    for name, right in CAMERAS.items():
        x_px, y_px = rng.normal(0.0, 8.0, 2)
        lens = right.distortion * rng.uniform(0.95, 1.05, len(right.distortion))
        moved = replace(
            right,
            cx_px=right.cx_px + x_px,
            cy_px=right.cy_px + y_px,
        )
        drifted[name] = with_lens(moved, lens.tolist())
    findings = findings_of(with_cameras(make(31 + seed), **drifted))
    assert "TIES-CALIBRATION" not in {finding.code for finding in findings}


NEAR_THE_MIDDLE = replace(CAMERAS["camera0"], cx_px=4512.4, cy_px=4491.7)
ONE_CAMERA = {
    "cameras": (0.0,),
    "calibrations": {"camera0": NEAR_THE_MIDDLE},
    "points": 800,
    "lines": 4,
    "each": 15,
    "base": 600.0,
    "height": 3000.0,
}


@pytest.mark.parametrize("turned_deg", [0.17, 0.0])
def test_a_principal_point_six_pixels_off_is_no_turn_of_the_mount(turned_deg):
    """12.4, -8.3 px read as 8.3, -12.4, beside a mount that is off by its sigma, or is not."""
    turn = np.radians(turned_deg) * np.array([0.6, 0.7, 0.4])
    mission = turned(make(41, **ONE_CAMERA), *turn)
    read = replace(NEAR_THE_MIDDLE, cx_px=4508.3, cy_px=4487.6)
    wrong = with_cameras(mission, camera0=read)
    finding = only_finding(wrong, "TIES-CALIBRATION", "cameras.camera0")
    assert "4512.4, 4491.7 px in camera0" in finding.what


@pytest.mark.parametrize(
    ("x_px", "y_px", "sigma_tilt"),
    [
        (33.0, -40.0, 5e-3),
        (33.0, 40.0, 5e-3),
        (40.0, 0.0, 5e-3),
        (24.8, -16.6, 1e-4),
    ],
)
def test_a_turned_mount_is_no_other_calibration(x_px, y_px, sigma_tilt):
    """Turned by 30 to 52 px, within its sigma or not: beside it a principal point moves by 25."""
    sigma = (1.0, 1.0, 2.0, sigma_tilt, sigma_tilt, 2.0 * sigma_tilt)
    mission = make(42, sigma=sigma, **ONE_CAMERA)
    wrong = turned(mission, y_px / F_PX, x_px / F_PX, 0.0)
    assert findings_of(wrong) == ()


def test_refraction_is_removed_from_apparent_rays():
    """By the angle that `unbend angle` prints, within the relief and the heights of the cameras."""
    mission = make(27, errors=False, pixel_rad=1e-9)
    logged = mission.orientations
    rays = replace(mission.rays(mission.cameras, {}), height_m=None)
    up = np.einsum("sij,sj->si", logged.camera_from_ecef, logged.enu_from_ecef[:, 2])

    def nadir_angle(seen):
        return np.arccos(-np.sum(up[seen.image] * seen.direction, axis=1))

    before = nadir_angle(rays)
    after = nadir_angle(straightened(logged, rays))
    is_of_several = (np.bincount(rays.point)[rays.point] > 2) & np.isfinite(before)
    assert (before > after)[is_of_several].all()
    row = np.argmax(np.where(is_of_several, before, 0.0))
    angle = one_angle("us1976", 1000.0, 30.0, float(np.degrees(before[row])))
    assert before[row] - after[row] == pytest.approx(angle["r_c_rad"], rel=0.1)


def test_what_tie_points_hardly_tell_apart_is_named_together():
    """Along one line, straight down, f that is 3 % too long is all but stations 30 m too low."""
    mission = make(28, cameras=(0.0,), lines=1)
    wrong = with_cameras(mission, camera0=with_f(CAMERAS["camera0"], 1.03))
    (finding,) = findings_of(wrong)
    of_camera, of_height = sorted((finding.what, *finding.also))
    assert of_camera.startswith("the principal distance of camera0 is about 100")
    assert "too low above the given heights of the ground" in of_height


def test_a_camera_may_be_called_like_a_mount():
    """Where orientations are stated and no mounts, a focal length still belongs to its camera."""
    mission = replace(make(3), mounts={})
    mistake = SimpleNamespace(
        code="TIES-FOCAL",
        label="",
        camera="wing-mount",
        cameras=("wing-mount",),
        subject=("", ""),
    )
    reading = SimpleNamespace(intersected=lambda _: SimpleNamespace(sigma_factor=1.0))
    best = SimpleNamespace(
        hypothesis=mistake,
        reading=reading,
        gain=50.0,
        text="it is so",
        beyond_datums=False,
    )
    assert finding_of(mission, [best]).key == "cameras.wing-mount"
