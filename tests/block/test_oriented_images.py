"""Blocks of images in any frame become stations, and those read the wrong way are refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.block.oriented_images import (
    OrientedImages,
    fitted_frame,
    flag_above_horizon,
    flag_far_images,
    refuse_turned_images,
    stations_of_images,
    topocentric,
)
from unbend.errors import MissionError
from unbend.flight.heights import GeodeticOrigin, HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.rotations import (
    matrices_of,
    opk_of_quaternion,
    quaternion_of_opk,
    quaternion_of_rpy,
    quaternions_of,
    rpy_of_quaternion,
)
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef

LAT = np.radians(47.0)
LON = np.radians(8.0)
METRE = 1.0 / 6.37e6
HEIGHTS = HeightSystem(undulation_m=47.6)
LINES_DEG = (30.0, 210.0, 100.0, 280.0)  # azimuths of the flight lines


def block(drift_deg: float = 3.0, roll_deg: float = 2.0, n: int = 6) -> OrientedImages:
    """Four lines of level images whose tops point along the track, but for the drift."""
    lat = []
    lon = []
    yaw = []
    for number, azimuth in enumerate(np.radians(LINES_DEG)):
        along = 500.0 * np.arange(n)
        north = along * np.cos(azimuth) + 5000.0 * number
        east = along * np.sin(azimuth)
        lat += (LAT + north * METRE).tolist()
        lon += (LON + east * METRE / np.cos(LAT)).tolist()
        yaw += [azimuth + np.radians(drift_deg)] * n
    count = len(yaw)
    angles = np.stack([np.full(count, np.radians(roll_deg)), np.zeros(count), yaw], axis=1)
    names = np.array([f"i{k}" for k in range(count)], dtype=object)
    return OrientedImages(
        names,
        np.full(count, "nadir", object),
        np.arange(1, count + 1) * 2_000_000_000,
        np.array(lat),
        np.array(lon),
        np.full(count, 3000.0),
        True,
        quaternion_of_rpy(angles),
        False,
        {},
    )


def stations(images: OrientedImages, mount: Mount | None = None, heights=HEIGHTS):
    found = stations_of_images(images, {"nadir": mount or Mount()}, heights)
    found, notes = flag_above_horizon(found)
    refuse_turned_images(found)
    return found, notes


def changed(images: OrientedImages, matrix: np.ndarray) -> OrientedImages:
    return replace(images, quaternion=quaternions_of(matrix))


def test_heights_of_both_kinds():
    found, notes = stations(block())
    assert notes == ()
    assert set(found.status) == {"ok"}
    assert found.h_ellipsoid_m == pytest.approx(3047.6)
    found, _ = stations(replace(block(), is_msl=False))
    assert found.h_msl_m == pytest.approx(2952.4)
    found, _ = stations(block(), heights=HeightSystem())
    assert np.isnan(found.h_ellipsoid_m).all()
    found, _ = stations(replace(block(), is_msl=False), heights=HeightSystem())
    assert set(found.status) == {"height_reference_unknown"}


def test_what_is_not_known_says_so():
    images = block()
    images.lat_rad[2] = np.nan
    images.quaternion[3] = np.nan
    found, _ = stations(images)
    assert found.status[:5].tolist() == ["ok", "ok", "no_position", "no_attitude", "ok"]


def test_the_aircraft_carries_the_camera():
    """Roll, pitch and yaw of the body; the camera looks 30 deg left, 2 m behind, and lower."""
    yaw = np.array([90.0])
    body = quaternion_of_rpy(np.radians(np.stack([yaw * 0, yaw * 0, yaw], axis=1)), np.eye(3))
    images = block(n=1)
    images = OrientedImages(
        images.image[:1],
        images.camera[:1],
        images.time_ns[:1],
        np.array([LAT]),
        np.array([LON]),
        np.array([3000.0]),
        True,
        body,
        True,
        {"sigma_height_m": np.array([0.1])},
    )
    mount = Mount(roll_rad=np.radians(30.0), lever_arm_m=(-2.0, 0.0, 1.5))
    found, _ = stations(images, mount)
    optical_axis = matrices_of(found.quaternion)[0, 2]  # flying east, its left is north
    assert optical_axis == pytest.approx([0.0, 0.5, -np.sqrt(0.75)], abs=1e-12)
    east_m = (found.lon_rad[0] - LON) * np.cos(LAT) / METRE
    assert east_m == pytest.approx(-2.0, abs=0.01)
    assert found.h_msl_m[0] == pytest.approx(2998.5, abs=1e-6)
    assert found.sigma_height_m.tolist() == [0.1]
    body_rpy = np.degrees(rpy_of_quaternion(found.aircraft_quaternion, np.eye(3))[0])
    assert body_rpy == pytest.approx([0.0, 0.0, 90.0], abs=1e-9)
    # The camera's own attitude, from another table, gives the aircraft's back.
    again, _ = stations(replace(images, quaternion=found.quaternion, of_body=False), mount)
    bodies = [matrices_of(one.aircraft_quaternion) for one in (again, found)]
    assert bodies[0] == pytest.approx(bodies[1], abs=1e-12)
    assert again.quaternion.tolist() == found.quaternion.tolist()
    assert again.h_msl_m.tolist() == [3000.0]


@pytest.mark.parametrize(
    ("name", "matrix"),
    [
        ("y up, z back", lambda m: np.diag([1.0, -1.0, -1.0]) @ m),
        (
            "north, east, down for the frame",
            lambda m: m @ np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
        ),
        (
            "from the frame to a camera of photogrammetry and back",
            lambda m: (np.diag([1.0, -1.0, -1.0]) @ m).transpose(0, 2, 1),
        ),
    ],
)
def test_cameras_that_look_up_are_refused(name, matrix):
    images = block()
    with pytest.raises(MissionError, match="ORIENTATION-UP") as refusal:
        stations(changed(images, matrix(matrices_of(images.quaternion))))
    assert "24 of 24 images" in refusal.value.what
    assert "grad" in refusal.value.remedy


def test_oblique_angles_in_grads_look_above_the_horizon():
    """Omega of 50 deg is 55.6 grad; of 85 deg 94.4 grad, read as degrees it is above."""
    images = block()
    angles = np.zeros((24, 3))
    angles[:, 0] = np.radians(94.4)
    with pytest.raises(MissionError, match="ORIENTATION-UP"):
        stations(replace(images, quaternion=quaternion_of_opk(angles)))


def test_a_single_camera_that_looks_up_is_suspect():
    images = block()
    matrix = matrices_of(images.quaternion)
    matrix[4] = np.diag([1.0, -1.0, -1.0]) @ matrix[4]
    found, notes = stations(changed(images, matrix))
    assert [str(status) for status in found.status].count("suspect") == 1
    assert found.suspect_reason[4] == "looks above the horizon"
    (entry,) = notes
    assert (entry.code, entry.kind, entry.count) == ("ORIENTATION-UP", "loss", 1)


def test_images_that_turn_against_the_flight_are_refused():
    images = block()
    kappa_clockwise = opk_of_quaternion(images.quaternion) * [1.0, 1.0, -1.0]
    with pytest.raises(MissionError, match="ORIENTATION-TURNS"):
        stations(replace(images, quaternion=quaternion_of_opk(kappa_clockwise)))


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_any_quarter_turn_of_the_camera_is_as_good(quarter):
    images = block(drift_deg=3.0 + 90.0 * quarter)
    assert stations(images)[1] == ()


def test_images_that_do_not_follow_the_flight_are_no_reason():
    images = block()
    turns = np.random.default_rng(3).uniform(-3.0, 3.0, (24, 1))
    spun = Rotation.from_euler("z", turns).as_matrix() @ matrices_of(images.quaternion)
    assert stations(changed(images, spun))[1] == ()


# --- a model in an unknown frame -------------------------------------------------------------


def model(noise_m: float = 0.0, seed: int = 1):
    """A block as a model of scale 0.01, turned any way; its images, and where they really are."""
    images = block()
    known = np.stack([images.lat_rad, images.lon_rad, images.h_m], axis=1)
    earth = ecef_of_geodetic(*known.T)
    turn = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    draw = np.random.default_rng(seed)
    xyz = (earth - earth[0] + draw.normal(0.0, noise_m, earth.shape)) @ turn.T * 0.01 + [5, 6, 7]
    ecef_from_enu = enu_from_ecef(images.lat_rad, images.lon_rad).transpose(0, 2, 1)
    attitude = matrices_of(images.quaternion) @ ecef_from_enu.transpose(0, 2, 1) @ turn.T
    return images, xyz, known, quaternions_of(attitude)


def test_a_model_is_brought_to_the_earth():
    images, xyz, known, attitude = model()
    frame, (entry,) = fitted_frame(images.image, xyz, images.image[::3], known[::3])
    lat, lon, h = frame.geodetic(xyz)
    assert lat == pytest.approx(images.lat_rad, abs=1e-11)
    assert lon == pytest.approx(images.lon_rad, abs=1e-11)
    assert h == pytest.approx(3000.0, abs=1e-3)
    found = frame.local_attitude(attitude, lat, lon)
    assert found == pytest.approx(images.quaternion, abs=1e-9)
    assert frame.scale == pytest.approx(100.0, rel=1e-9)
    assert (entry.code, entry.kind, entry.count) == ("ORIENTATION-FIT", "note", 8)
    assert "scale 100" in entry.what


def test_the_vertical_is_as_good_as_its_sigma_says():
    """Over 300 draws of positions good to 2 m: error over sigma has an rms of one."""
    ratios = []
    for seed in range(300):
        images, xyz, known, _ = model(2.0, seed)
        frame, _ = fitted_frame(images.image, xyz, images.image, known)
        true = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix().T
        up = enu_from_ecef(known[:1, 0], known[:1, 1])[0, 2]
        fitted_up = frame.ecef_from_frame @ true.T @ up
        tilt = np.linalg.norm(np.cross(fitted_up, up)) / np.sqrt(2.0)  # of each level axis
        ratios.append(tilt / frame.tilt_rad)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.2


def test_three_known_positions_are_not_checked_by_anything():
    """60 m of height at one of three: residuals of centimetres, and a tilt of 0.3 degrees."""
    images, xyz, known, _ = model()
    three = [0, 17, 23]
    true = known[[0, 17, 23]]
    higher = true + np.array([[0.0, 0.0, 60.0], [0.0] * 3, [0.0] * 3])
    good, (entry,) = fitted_frame(images.image, xyz, images.image[three], true)
    assert entry.kind == "warning"
    assert "three positions cannot be checked" in entry.what
    wrong, (entry,) = fitted_frame(images.image, xyz, images.image[three], higher)
    assert entry.kind == "warning"
    up = enu_from_ecef(known[:1, 0], known[:1, 1])[0, 2]
    turned = wrong.ecef_from_frame @ good.ecef_from_frame.T @ up
    tilt = np.linalg.norm(np.cross(turned, up))
    assert tilt > np.radians(0.1)
    # The sigma is what 1 m in each height would do, not what residuals of nothing say.
    assert 1.0 / 120.0 < good.tilt_rad / tilt < 1.0 / 20.0


def test_the_sigma_of_known_positions_is_in_that_of_the_vertical():
    images, xyz, known, _ = model()
    one, _ = fitted_frame(images.image, xyz, images.image, known, sigma_m=1.0)
    five, _ = fitted_frame(images.image, xyz, images.image, known, sigma_m=5.0)
    assert five.tilt_rad == pytest.approx(5.0 * one.tilt_rad)
    default, _ = fitted_frame(images.image, xyz, images.image, known)
    assert default.tilt_rad == one.tilt_rad


def test_a_known_position_that_contradicts_the_others_is_named():
    images, xyz, known, _ = model(0.3)
    _, (entry,) = fitted_frame(images.image, xyz, images.image[::2], known[::2])
    assert entry.kind == "note"
    for row, off in ((0, 30.0), (9, -30.0)):
        wrong = known[::2].copy()
        wrong[row, 2] += off
        _, (entry,) = fitted_frame(images.image, xyz, images.image[::2], wrong)
        assert entry.kind == "loss"
        assert f"without {images.image[2 * row]} the others fit" in entry.what
        told = float(re.search(r"it is ([0-9.]+) m off", entry.what)[1])
        assert told == pytest.approx(30.0, abs=3.0)


def test_residuals_that_no_sigma_explains_are_doubtful():
    """Every other height above another datum: no single position is the wrong one."""
    images, xyz, known, _ = model()
    known[::2, 2] -= 140.0
    _, (entry,) = fitted_frame(images.image, xyz, images.image, known)
    assert entry.kind == "loss"
    assert "than a known position should have" in entry.what


@pytest.mark.parametrize("mistake", ["moved", "names"])
def test_one_wrong_position_of_three_is_a_loss(mistake):
    images, xyz, known, _ = model()
    rows = np.array([0, 5, 9])
    _, (entry,) = fitted_frame(images.image, xyz, images.image[rows], known[rows])
    assert (entry.kind, "three positions cannot" in entry.what) == ("warning", True)
    wrong = known[rows].copy()
    names = images.image[rows]
    if mistake == "moved":
        wrong[1, 0] += 60.0 / 6.37e6
    else:
        names = names[[1, 0, 2]]
    try:
        _, (entry,) = fitted_frame(images.image, xyz, names, wrong)
        outcome = str(entry.kind)
    except MissionError as refusal:
        outcome = refusal.code
    assert outcome in ("loss", "ORIENTATION-FIT", "ORIENTATION-LINE")


def test_a_line_with_metres_of_wobble_is_refused():
    """Noise across a line is no base for a vertical, however well a model fits it."""
    images, _, known, _ = model()
    wobble = np.random.default_rng(2).normal(0.0, 3.0, (6, 3))
    line = ecef_of_geodetic(*known[:6].T) + wobble
    straight = np.stack(geodetic_of_ecef(*line.T), axis=1)
    with pytest.raises(MissionError, match="ORIENTATION-LINE") as refusal:
        fitted_frame(images.image[:6], 0.01 * line, images.image[:6], straight)
    assert "with a sigma of 1 m" in refusal.value.what


def test_images_far_from_all_others_are_suspect():
    images = block()
    images.lat_rad[5] = images.lon_rad[5] = 0.0
    found, (entry,) = flag_far_images(stations(images)[0], use=False)
    assert (entry.code, entry.kind, entry.count) == ("ORIENTATION-FAR", "loss", 1)
    assert np.flatnonzero(found.status == "suspect").tolist() == [5]
    assert found.suspect_reason[5] == "far from all others"
    assert found.suspect_m[5] == pytest.approx(5.2e6, rel=0.05)
    assert flag_far_images(stations(block())[0], use=False)[1] == ()


def test_fewer_than_three_known_positions_are_refused():
    images, xyz, known, _ = model()
    with pytest.raises(MissionError, match="ORIENTATION-KNOWN") as refusal:
        fitted_frame(images.image, xyz, images.image[:2], known[:2])
    assert "no vertical, no north and no scale" in refusal.value.what
    others = np.array(["x", "y", "z", "i0"], dtype=object)
    with pytest.raises(MissionError, match="1 of 4 known positions"):
        fitted_frame(images.image, xyz, others, known[:4])


def test_known_positions_on_one_line_are_refused():
    images, xyz, known, _ = model(0.5)
    with pytest.raises(MissionError, match="ORIENTATION-LINE"):
        fitted_frame(images.image, xyz, images.image[:6], known[:6])
    images, xyz, known, _ = model()
    straight = 5.0 + np.arange(24)[:, None] * np.array([1.0, 2.0, 3.0])
    with pytest.raises(MissionError, match="ORIENTATION-LINE"):
        fitted_frame(images.image, straight, images.image[:6], known[:6])


def test_another_model_and_swapped_coordinates_are_refused():
    images, xyz, known, _ = model()
    with pytest.raises(MissionError, match="ORIENTATION-FIT"):
        fitted_frame(images.image, xyz, images.image, known[::-1])
    with pytest.raises(MissionError, match="ORIENTATION-FIT") as refusal:
        fitted_frame(images.image, xyz, images.image, known[:, [1, 0, 2]])
    assert "latitude and longitude exchanged" in refusal.value.remedy


def test_a_topocentric_frame_is_that_of_its_origin():
    frame = topocentric(GeodeticOrigin(LAT, LON, 400.0))
    lat, lon, h = frame.geodetic(np.array([[0.0, 0.0, 100.0], [0.0, 1000.0, 0.0]]))
    assert h[0] == pytest.approx(500.0, abs=1e-6)
    assert (lat[0], lon[0]) == (pytest.approx(LAT, abs=1e-12), pytest.approx(LON, abs=1e-12))
    assert lat[1] - LAT == pytest.approx(1000.0 / 6.3675e6, rel=1e-3)
    assert h[1] - 400.0 == pytest.approx(1000.0**2 / 2 / 6.37e6, abs=0.01)
