"""What tie points find in a mission file, on blocks simulated with numpy alone.

Sound blocks have the seeds below UNBEND_BLOCKS (2; `make faults`: 8). With fewer than 8, one of the
cases of each mistake is drawn from UNBEND_SEED.
"""

from __future__ import annotations

import os
import random
import re
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from tests.draws import SEED
from unbend.block.calibration_mistakes import OffsetAxes, with_other_axes
from unbend.block.diagnosis import diagnosis, finding_of
from unbend.block.image_rays import ImageRays, Orientations, straightened
from unbend.block.possible_mistakes import StatedMission
from unbend.flight.mount import Mount
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera

BLOCKS = int(os.environ.get("UNBEND_BLOCKS", "2"))
CAMERAS = {
    "camera0": Camera(
        9000, 9000, 1e4, 1e4, 4540.0, 4475.0, BrownConrady(k1=-0.02, k2=0.01, p1=2e-4)
    ),
    "camera1": Camera(
        9000, 9000, 1e4, 1e4, 4462.0, 4521.0, BrownConrady(k1=-0.04, k2=0.01, p2=1e-4)
    ),
}


def drawn(*cases):
    """All cases of a mistake in `make faults`, else one."""
    return cases if BLOCKS >= 8 else random.Random(SEED).sample(cases, 1)


@pytest.fixture(scope="module")
def make(simulated_block):
    """A block of two cameras as a mission file states it, from its seed."""

    def made(seed: int, *, speed: float = 50.0, calibrations=CAMERAS, **options) -> StatedMission:
        options = {"cameras": (0.0, 0.35), "points": 500, "each": 8} | options
        block = simulated_block.simulate_block(np.random.default_rng(seed), **options)
        frames = simulated_block.axes(block.lat, block.lon)
        centre = simulated_block.ecef(block.lat, block.lon, block.h)
        orientations = Orientations(
            block.camera, centre, block.camera_from_enu @ frames, frames, block.sigma
        )
        d = block.direction
        own = {name: block.camera[block.image] == name for name in calibrations}
        x, y = np.empty((2, len(d)))
        for name, rows in own.items():
            x[rows], y[rows] = calibrations[name].project(*(d[rows, :2] / d[rows, 2:]).T)

        def rays(cameras, axes) -> ImageRays:
            direction = np.empty(d.shape)
            for name, rows in own.items():
                u, v = (y, x) if axes.get(name) == "exchanged" else (x, y)
                v = 9000.0 - v if axes.get(name) == "upward" else v
                u, v, _ = cameras[name].rays(u[rows], v[rows])
                direction[rows] = np.stack([u, v, np.ones(u.size)], axis=1)
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            return ImageRays(block.image, block.point, direction, 1e-4, block.point_h[block.point])

        heading = 1.0 - 2.0 * (np.arange(block.lon.size) // 8 % 2)  # one line to, one fro

        def shifted(seconds: float) -> Orientations:
            step = (speed * seconds * heading)[:, None] * frames[:, 0]
            return replace(orientations, centre_m=centre + step)

        mounts = {"camera0": Mount(), "camera1": Mount(roll_rad=-0.35)}
        return StatedMission(orientations, dict(calibrations), rays, mounts, shifted)

    return made


def found(mission: StatedMission) -> list[str]:
    return [finding.code for finding in diagnosis(mission)[1]]


@pytest.mark.parametrize("seed", range(BLOCKS))
def test_a_true_mission_file_raises_nothing(make, seed):
    stated, findings = diagnosis(make(seed))
    assert findings == ()
    assert 0.7 < stated.sigma_factor < 1.3


def test_sigmas_explain_a_common_error_as_large_as_they_are(make):
    mission = make(20)
    turned = mission.orientations.turned(np.array([0.004, 0.0, 0.0]), "camera0")
    assert found(replace(mission, orientations=turned)) == []  # 0.23 deg, where 0.17 are stated
    turned = mission.orientations.turned(np.array([0.03, 0.0, 0.0]), "camera0")
    (finding,) = diagnosis(replace(mission, orientations=turned))[1]
    assert (finding.code, finding.key) == ("TIES-MOUNT", "mount.camera0")
    assert "turned by 1.7" in finding.what


def test_a_mount_with_the_other_sign_is_named_with_its_angle(make):
    mission = make(21)
    wrong = Mount(roll_rad=0.35).camera_from_body @ mission.camera_from_body("camera1").T
    o = mission.orientations
    own = mission.orientations.camera == "camera1"
    turned = np.where(own[:, None, None], wrong @ o.camera_from_ecef, o.camera_from_ecef)
    mounts = {**mission.mounts, "camera1": Mount(roll_rad=0.35)}
    mission = replace(mission, orientations=replace(o, camera_from_ecef=turned), mounts=mounts)
    (finding,) = diagnosis(mission)[1]
    assert (finding.code, finding.key) == ("TIES-MOUNT", "mount.camera1")
    assert "other sign of roll" in finding.what
    assert "is roll_deg -20.0" in finding.what or "is roll_deg -20.1" in finding.what


@pytest.mark.parametrize("factor", drawn(0.004, 0.97, 2.0))
def test_a_wrong_principal_distance_is_estimated(make, factor):
    mission = make(22)
    camera = mission.cameras["camera0"]
    wrong = replace(camera, fx_px=factor * 1e4, fy_px=factor * 1e4)
    finding = diagnosis(replace(mission, cameras={**mission.cameras, "camera0": wrong}))[1][0]
    assert (finding.code, finding.key) == ("TIES-FOCAL", "cameras.camera0")
    size = float(finding.what.split(" is ")[1].split(" px")[0])
    assert size == pytest.approx(1e4, rel=0.005)
    assert ("millimetres" in finding.what) == (factor < 0.1)


@pytest.mark.parametrize("offset_s", drawn(-1.5, 18.0, 3600.0))
def test_exposures_at_other_times_are_found_by_how_much(make, offset_s):
    mission = make(23)
    shifted = mission.shifted
    wrong = replace(
        mission, orientations=shifted(-offset_s), shifted=lambda s: shifted(s - offset_s)
    )
    finding = diagnosis(wrong)[1][0]
    assert finding.code == "TIES-TIME"
    assert f"{abs(offset_s):.0f}" in finding.what or "1.5" in finding.what
    assert ("later" if offset_s > 0 else "earlier") in finding.what
    assert ("GPS time" in finding.what) == (offset_s == 18.0)


def test_heights_from_another_zero_are_found_and_named(make):
    mission = make(24)
    o = mission.orientations
    low = replace(o, centre_m=o.centre_m - 47.0 * o.enu_from_ecef[:, 2])
    others = {"this": 46.8, "that": 120.0}
    mission = replace(mission, orientations=low, shifted=None, other_heights_m=others)
    finding = diagnosis(mission)[1][0]
    assert (finding.code, finding.key) == ("TIES-HEIGHT", "ground")
    assert "47." in finding.what or "46." in finding.what
    assert "too low" in finding.what
    assert "as if this" in finding.what


@pytest.mark.parametrize("axes", drawn("exchanged", "upward"))
def test_other_axes_of_pixels(make, axes):
    mission = make(25)
    rays = mission.rays
    inverse = {"camera1": axes}

    def wrong(cameras, read) -> ImageRays:
        """The table has them the other way: reading them so gives the true ones."""
        if read.get("camera1") == axes:
            return rays(cameras, {k: v for k, v in read.items() if k != "camera1"})
        return rays(cameras, {**read, **inverse})

    finding = diagnosis(replace(mission, rays=wrong))[1][0]
    assert finding.code == "TIES-PIXELS"
    assert "camera1" in finding.what


def test_exchanged_cameras(make):
    mission = make(26)
    o = mission.orientations
    ab = mission.camera_from_body("camera1") @ mission.camera_from_body("camera0").T
    own = (o.camera == "camera0")[:, None, None]
    turned = np.where(own, ab @ o.camera_from_ecef, ab.T @ o.camera_from_ecef)
    a, b = mission.mounts.values()
    exchanged = replace(
        mission,
        orientations=replace(o, camera_from_ecef=turned),
        mounts={"camera0": b, "camera1": a},
        cameras={"camera0": CAMERAS["camera1"], "camera1": CAMERAS["camera0"]},
    )
    finding = diagnosis(exchanged)[1][0]
    assert finding.code == "TIES-CAMERAS"
    assert finding.log_ratio > 100.0


def mirrored(camera: Camera) -> Camera:
    return replace(camera, cx_px=9000.0 - camera.cx_px)


def exchanged_axes(camera: Camera) -> Camera:
    return replace(camera, cx_px=camera.cy_px, cy_px=camera.cx_px)


@pytest.mark.parametrize(
    ("axes", "cx", "cy"),
    [((False, 1, 1), 60.0, 30.0), ((False, -1, 1), 40.0, 30.0), ((False, 1, -1), 60.0, 50.0),
     ((True, 1, 1), 40.0, 50.0), ((True, -1, 1), 60.0, 50.0), ((True, 1, -1), 40.0, 30.0)],
)  # fmt: skip
def test_a_principal_point_along_other_axes(axes, cx, cy):
    """10 px right of the centre of 100 x 80 px, and 10 px above it."""
    camera = Camera(100, 80, 50.0, 50.0, 60.0, 30.0)
    other = with_other_axes(camera, OffsetAxes(*axes))
    assert (other.cx_px, other.cy_px) == (cx, cy)


def other_sign(camera: Camera) -> Camera:
    lens = BrownConrady(*(-np.array(camera.distortion)).tolist())
    return replace(camera, distortion=lens)


@pytest.mark.parametrize(
    ("read", "names"),
    drawn(*product((mirrored, exchanged_axes, other_sign), (("camera1",), tuple(CAMERAS)))),
)
def test_calibrations_of_other_signs_or_axes(make, read, names):
    mission = make(29)
    finding = diagnosis(replace(mission, cameras=CAMERAS | {n: read(CAMERAS[n]) for n in names}))[
        1
    ][0]
    key = "cameras" if len(names) == 2 else "cameras.camera1"
    assert (finding.code, finding.key) == ("TIES-CALIBRATION", key)
    assert ("have the opposite sign" in finding.what) == (read is other_sign)
    if read is not other_sign:
        for name in names:
            assert f"{CAMERAS[name].cx_px}, {CAMERAS[name].cy_px} px in {name}" in finding.what


def test_calibrations_that_are_each_others(make):
    a, b = CAMERAS
    cameras = {a: CAMERAS[b], b: CAMERAS[a]}
    finding = diagnosis(replace(make(30), cameras=cameras))[1][0]
    assert (finding.code, finding.key) == ("TIES-CALIBRATION", "cameras")
    assert finding.what == "the calibrations of camera0 and camera1 are exchanged"


BARREL, WIDE = (
    {name: replace(c, distortion=BrownConrady(k1=k1)) for name, c in CAMERAS.items()}
    for k1 in (0.06, -0.4)
)


@pytest.mark.parametrize(
    ("lenses", "names"), drawn(*product((CAMERAS, BARREL, WIDE), (("camera1",), tuple(CAMERAS))))
)
def test_a_distortion_that_is_not_stated(make, lenses, names):
    """It is no other principal distance, height or principal point; k2 of the lens goes into k1."""
    unstated = {n: replace(lenses[n], distortion=BrownConrady()) for n in names}
    mission = make(3, calibrations=lenses)
    findings = diagnosis(replace(mission, cameras=lenses | unstated))[1]
    assert {finding.code for finding in findings} == {"TIES-CALIBRATION"}
    estimated = {}
    for finding in findings:
        words = re.fullmatch(r"the radial distortion k1 of (.*) is (.*) \+- .*", finding.what)
        estimated |= dict(zip(*(part.split(" and ") for part in words.groups()), strict=True))
        assert finding.key == "cameras" + (f".{words[1]}" if " " not in words[1] else "")
    expected = {name: lenses[name].distortion.k1 for name in names}
    assert {n: float(k1) for n, k1 in estimated.items()} == pytest.approx(expected, rel=0.3)
    assert findings[-1].sigma_factor < 1.6


def test_a_principal_distance_that_is_wrong_in_all_cameras(make):
    wrong = {n: replace(c, fx_px=1.03 * c.fx_px, fy_px=1.03 * c.fy_px) for n, c in CAMERAS.items()}
    wrong["without an image"] = CAMERAS["camera0"]
    (finding,) = diagnosis(replace(make(3), cameras=wrong))[1]
    assert (finding.code, finding.key) == ("TIES-FOCAL", "cameras")
    sizes = re.search(r"of camera0 and camera1 is (\d+) and (\d+) px", finding.what).groups()
    assert [float(size) for size in sizes] == pytest.approx([1e4, 1e4], rel=2e-3)
    assert finding.what.endswith("not 10300 and 10300")


@pytest.mark.parametrize("seed", range(BLOCKS // 2))
def test_calibrations_that_drifted_are_not_taken_for_mistaken_ones(make, seed):
    """The principal point by a fifth of its offset, the distortion by up to 5 %."""
    rng = np.random.default_rng(seed)
    drifted = {
        name: replace(
            c,
            cx_px=c.cx_px + rng.normal(0.0, 8.0),
            cy_px=c.cy_px + rng.normal(0.0, 8.0),
            distortion=BrownConrady(*(p * rng.uniform(0.95, 1.05) for p in c.distortion)),
        )
        for name, c in CAMERAS.items()
    }
    assert "TIES-CALIBRATION" not in found(replace(make(31 + seed), cameras=drifted))


NEAR_THE_MIDDLE = {"camera0": replace(CAMERAS["camera0"], cx_px=4512.4, cy_px=4491.7)}
ONE_CAMERA = {"cameras": (0.0,), "calibrations": NEAR_THE_MIDDLE, "points": 800, "each": 15}


@pytest.mark.parametrize("turned_deg", [0.17, 0.0])
def test_a_principal_point_six_pixels_off_is_no_turn_of_the_mount(make, turned_deg):
    """12.4, -8.3 px read as 8.3, -12.4, beside a mount that is off by its sigma, or is not."""
    mission = make(41, lines=4, base=600.0, height=3000.0, **ONE_CAMERA)
    turn = np.radians(turned_deg) * np.array([0.6, 0.7, 0.4])
    mission = replace(mission, orientations=mission.orientations.turned(turn, "camera0"))
    right = mission.cameras["camera0"]
    wrong = {"camera0": replace(right, cx_px=4508.3, cy_px=4487.6)}
    (finding,) = diagnosis(replace(mission, cameras=wrong))[1]
    assert finding.code == "TIES-CALIBRATION"
    assert "4512.4, 4491.7 px in camera0" in finding.what


@pytest.mark.parametrize(
    ("turned_px", "tilt"),
    [((33.0, -40.0), 5e-3), ((33.0, 40.0), 5e-3), ((40.0, 0.0), 5e-3), ((24.8, -16.6), 1e-4)],
)
def test_a_turned_mount_is_no_other_calibration(make, turned_px, tilt):
    """Turned by 30 to 52 px, within its sigma or not: beside it a principal point moves by 25."""
    sigma = (1.0, 1.0, 2.0, tilt, tilt, 2.0 * tilt)
    mission = make(42, lines=4, base=600.0, height=3000.0, sigma=sigma, **ONE_CAMERA)
    x, y = np.array(turned_px) / 1e4
    turned = mission.orientations.turned(np.array([y, x, 0.0]), "camera0")
    assert found(replace(mission, orientations=turned)) == []


def test_refraction_is_removed_from_apparent_rays(make):
    """By the angle that `unbend angle` prints, within the relief and the heights of the cameras."""
    from unbend.refraction.angle import one_angle

    mission = make(27, errors=False, pixel_rad=1e-9)
    o = mission.orientations
    rays = replace(mission.rays(mission.cameras, {}), height_m=None)
    straight = straightened(o, rays)
    down = np.einsum("rij,rj->ri", o.camera_from_ecef[rays.image], -o.enu_from_ecef[rays.image, 2])
    before, after = (np.arccos(np.sum(down * r.direction, axis=1)) for r in (rays, straight))
    several = (np.bincount(rays.point)[rays.point] > 2) & np.isfinite(before)
    assert (before > after)[several].all()
    row = int(np.argmax(np.where(several, before, 0.0)))
    expected = one_angle("us1976", 1000.0, 30.0, float(np.degrees(before[row])))["r_c_rad"]
    assert before[row] - after[row] == pytest.approx(expected, rel=0.1)


def test_what_tie_points_hardly_tell_apart_is_named_together(make):
    """Along one line, straight down, f that is 3 % too long is all but stations 30 m too low."""
    mission = make(28, cameras=(0.0,), lines=1)
    camera = mission.cameras["camera0"]
    wrong = replace(camera, fx_px=1.03e4, fy_px=1.03e4)
    (finding,) = diagnosis(replace(mission, cameras={**mission.cameras, "camera0": wrong}))[1]
    both = sorted((finding.what, *finding.also))
    assert len(both) == 2
    assert both[0].startswith("the principal distance of camera0 is 100")
    assert "too low above the given heights of the ground" in both[1]


def test_a_camera_may_be_called_like_a_mount(make):
    """Where orientations are stated and no mounts, a focal length still belongs to its camera."""
    mission = replace(make(3), mounts={})
    hypothesis = SimpleNamespace(code="TIES-FOCAL", camera="wing-mount", subject=("", ""))
    reading = SimpleNamespace(intersected=lambda _: SimpleNamespace(sigma_factor=1.0))
    best = SimpleNamespace(hypothesis=hypothesis, reading=reading, gain=50.0, text="it is so")
    assert finding_of(mission, [best]).key == "cameras.wing-mount"
