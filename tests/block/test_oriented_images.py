"""Blocks of images in any frame become stations, and those read the wrong way are refused."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import counted, image_names
from tests.helpers import NED_FROM_ENU, refused
from unbend.block.oriented_images import (
    CartesianFrame,
    OrientedImages,
    fitted_frame,
    flag_above_horizon,
    flag_far_images,
    refuse_turned_images,
    stations_of_images,
)
from unbend.errors import MissionError
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.rotations import (
    matrices_of,
    opk_of_quaternion,
    quaternion_of_opk,
    quaternion_of_rpy,
    quaternions_of,
)
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef
from unbend.messages import Message

LAT = np.radians(47.0)
LON = np.radians(8.0)
EARTH_M = 6.37e6
PARALLEL_M = EARTH_M * np.cos(LAT)
UNDULATION_M = 47.6
LINES_DEG = (30.0, 210.0, 100.0, 280.0)  # azimuths of the flight lines
EACH = 6
COUNT = EACH * len(LINES_DEG)


def block(drift_deg=3.0):
    """Four lines of level images whose tops point along the track, but for the drift."""
    azimuth = np.repeat(np.radians(LINES_DEG), EACH)
    line, place = np.divmod(np.arange(COUNT), EACH)
    along_m = 500.0 * place
    north_m = along_m * np.cos(azimuth) + 5000.0 * line
    east_m = along_m * np.sin(azimuth)
    angles = np.zeros((COUNT, 3))
    angles[:, 0] = np.radians(2.0)
    angles[:, 2] = azimuth + np.radians(drift_deg)
    return OrientedImages(
        image=image_names(*(f"i{number}" for number in range(COUNT))),
        camera=np.full(COUNT, "nadir", object),
        time_ns=np.arange(1, COUNT + 1) * 2_000_000_000,
        lat_rad=LAT + north_m / EARTH_M,
        lon_rad=LON + east_m / PARALLEL_M,
        h_m=np.full(COUNT, 3000.0),
        is_msl=True,
        quaternion=quaternion_of_rpy(angles),
        of_body=False,
        sigmas={},
    )


AT_REST = Mount()


def stations(images, mount=AT_REST, undulation_m=UNDULATION_M):
    made = stations_of_images(images, {"nadir": mount}, HeightSystem(undulation_m))
    made, notes = flag_above_horizon(made)
    refuse_turned_images(made)
    return made, notes


NAN = float("nan")


@pytest.mark.parametrize(
    ("is_msl", "undulation_m", "status", "h_msl_m", "h_ellipsoid_m"),
    [
        (True, UNDULATION_M, "ok", 3000.0, 3047.6),
        (False, UNDULATION_M, "ok", 2952.4, 3000.0),
        (True, None, "ok", 3000.0, NAN),
        (False, None, "height_reference_unknown", NAN, 3000.0),
    ],
)
def test_heights_of_both_kinds(is_msl, undulation_m, status, h_msl_m, h_ellipsoid_m):
    images = replace(block(), is_msl=is_msl)
    made, notes = stations(images, undulation_m=undulation_m)
    assert notes == ()
    assert set(made.status) == {status}
    assert made.h_msl_m == pytest.approx(h_msl_m, nan_ok=True)
    assert made.h_ellipsoid_m == pytest.approx(h_ellipsoid_m, nan_ok=True)


def test_what_is_not_known_says_so():
    images = block()
    images.lat_rad[2] = NAN
    images.quaternion[3] = NAN
    made, _ = stations(images)
    assert made.status[2] == "no_position"
    assert made.status[3] == "no_attitude"
    assert np.count_nonzero(made.status == "ok") == COUNT - 2


SIN_15 = np.sin(np.radians(15.0))
COS_15 = np.cos(np.radians(15.0))
TO_THE_RIGHT = np.array([-0.5, -np.sqrt(0.75), 0.0])  # level, of a flight to 120 degrees
UPWARD = np.array([0.0, 0.0, 1.0])
# Axes of an aircraft that flies so, its right wing 15 degrees down.
FORWARD = np.array([np.sqrt(0.75), -0.5, 0.0])
RIGHT = COS_15 * TO_THE_RIGHT - SIN_15 * UPWARD
DOWN = -SIN_15 * TO_THE_RIGHT - COS_15 * UPWARD


def test_the_aircraft_carries_the_camera():
    """It banks by 15 deg; the camera looks 30 deg farther left, 2 m behind, right and lower."""
    body_from_enu = np.tile([FORWARD, RIGHT, DOWN], (COUNT, 1, 1))
    body = Rotation.from_matrix(body_from_enu)
    images = replace(
        block(),
        quaternion=body.as_quat(scalar_first=True),
        of_body=True,
        sigmas={"sigma_height_m": np.full(COUNT, 0.1)},
    )
    mount = Mount(
        roll_rad=np.radians(30.0),
        lever_arm_m=(-2.0, 1.0, 1.5),
    )

    of_body = stations_of_images(images, {"nadir": mount}, HeightSystem())
    # The camera's own attitude, from another table, gives the aircraft's back.
    of_cameras = replace(
        images,
        quaternion=of_body.quaternion,
        of_body=False,
    )
    of_camera = stations_of_images(of_cameras, {"nadir": mount}, HeightSystem())

    optical_axes = matrices_of(of_body.quaternion)[:, 2]
    to_the_left = -np.sqrt(0.5) * (TO_THE_RIGHT + UPWARD)
    to_the_left_each_time = np.tile(to_the_left, (COUNT, 1))
    assert optical_axes == pytest.approx(to_the_left_each_time, abs=1e-12)
    east_m, north_m, up_m = -2.0 * FORWARD + 1.0 * RIGHT + 1.5 * DOWN
    moved_east_m = (of_body.lon_rad - images.lon_rad) * PARALLEL_M
    moved_north_m = (of_body.lat_rad - images.lat_rad) * EARTH_M
    assert moved_east_m == pytest.approx(east_m, abs=0.02)
    assert moved_north_m == pytest.approx(north_m, abs=0.01)
    assert of_body.h_msl_m == pytest.approx(3000.0 + up_m, abs=1e-6)
    assert (of_body.sigma_height_m == 0.1).all()
    for made in (of_body, of_camera):
        axes = matrices_of(made.aircraft_quaternion)
        assert axes == pytest.approx(body_from_enu, abs=1e-12)
    assert of_camera.quaternion.tolist() == of_body.quaternion.tolist()
    assert (of_camera.h_msl_m == 3000.0).all()


Y_UP_Z_BACK = np.diag([1.0, -1.0, -1.0])
MATRICES = matrices_of(block().quaternion)
IN_GRADS = np.zeros((COUNT, 3))
IN_GRADS[:, 0] = np.radians(94.4)  # omega of 85 deg


def with_attitudes(quaternion):
    return replace(block(), quaternion=quaternion)


@pytest.mark.parametrize(
    "quaternion",
    [
        quaternions_of(Y_UP_Z_BACK @ MATRICES),
        quaternions_of(MATRICES @ NED_FROM_ENU),
        quaternions_of((Y_UP_Z_BACK @ MATRICES).transpose(0, 2, 1)),
        quaternion_of_opk(IN_GRADS),
    ],
    ids=[
        "y up, z back",
        "north, east, down for the frame",
        "from the frame to a camera of photogrammetry and back",
        "oblique angles in grads",
    ],
)
def test_cameras_that_look_up_are_refused(quaternion):
    with refused("ORIENTATION-UP", MissionError, what="24 of 24 images", remedy="grad"):
        stations(with_attitudes(quaternion))


def test_a_single_camera_that_looks_up_is_suspect():
    matrices = MATRICES.copy()
    matrices[4] = Y_UP_Z_BACK @ matrices[4]
    made, notes = stations(with_attitudes(quaternions_of(matrices)))
    assert np.flatnonzero(made.status == "suspect").tolist() == [4]
    assert made.suspect_reason[4] == "looks above the horizon"
    assert counted(notes) == [("loss", "ORIENTATION-UP", 1)]


def test_images_that_turn_against_the_flight_are_refused():
    opk = opk_of_quaternion(block().quaternion)
    kappa_clockwise = opk * [1.0, 1.0, -1.0]
    with refused("ORIENTATION-TURNS", MissionError):
        stations(with_attitudes(quaternion_of_opk(kappa_clockwise)))


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_any_quarter_turn_of_the_camera_is_as_good(quarter):
    _, notes = stations(block(drift_deg=3.0 + 90.0 * quarter))
    assert notes == ()


def test_images_that_do_not_follow_the_flight_are_no_reason():
    turns = np.random.default_rng(3).uniform(-3.0, 3.0, (COUNT, 1))
    spun = Rotation.from_euler("z", turns).as_matrix() @ MATRICES
    _, notes = stations(with_attitudes(quaternions_of(spun)))
    assert notes == ()


def test_images_far_from_all_others_are_suspect():
    images = block()
    images.lat_rad[5] = 0.0
    images.lon_rad[5] = 0.0
    oriented, _ = stations(images)
    made, notes = flag_far_images(oriented, use=False)
    assert counted(notes) == [("loss", "ORIENTATION-FAR", 1)]
    assert np.flatnonzero(made.status == "suspect").tolist() == [5]
    assert made.suspect_reason[5] == "far from all others"
    assert made.suspect_m[5] == pytest.approx(5.2e6, rel=0.05)
    in_place, _ = stations(block())
    assert flag_far_images(in_place, use=False) == (in_place, ())


FRAME_FROM_EARTH = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
SCALE = 100.0
IMAGES = block()
NAMES = IMAGES.image
PLACES = np.column_stack(
    [
        IMAGES.lat_rad,
        IMAGES.lon_rad,
        IMAGES.h_m,
    ]
)
EARTH = ecef_of_geodetic(*PLACES.T)
ENU = enu_from_ecef(IMAGES.lat_rad, IMAGES.lon_rad)
UP = ENU[0, 2]  # at the first image


def model(noise_m=0.0, seed=1):
    """Places of the images in a model of another scale, turned any way."""
    noise = np.random.default_rng(seed).normal(0.0, noise_m, EARTH.shape)
    turned = (EARTH - EARTH[0] + noise) @ FRAME_FROM_EARTH.T
    return turned / SCALE + [5.0, 6.0, 7.0]


MODEL = model()


@dataclass(frozen=True)
class Fit:
    """A frame that was fitted, and what is said of it."""

    frame: CartesianFrame
    note: Message


ALL = slice(None)
EVERY_OTHER = slice(None, None, 2)


def fit(rows=ALL, xyz=MODEL, places=PLACES, names=NAMES, **options):
    """The frame of a model by the known positions of some of its images."""
    frame, (note,) = fitted_frame(
        NAMES,
        xyz,
        names[rows],
        places[rows],
        **options,
    )
    return Fit(frame, note)


def raised(row, metres):
    """The known positions, of which some are higher."""
    higher = PLACES.copy()
    higher[row, 2] += metres
    return higher


def tilt(frame, reference):
    """By what a frame turns the vertical from that of another."""
    up = frame.ecef_from_frame @ reference.T @ UP
    return np.linalg.norm(np.cross(up, UP))


def test_a_model_is_brought_to_the_earth():
    fitted = fit(slice(None, None, 3))
    lat, lon, h = fitted.frame.geodetic(MODEL)
    assert lat == pytest.approx(IMAGES.lat_rad, abs=1e-11)
    assert lon == pytest.approx(IMAGES.lon_rad, abs=1e-11)
    assert h == pytest.approx(3000.0, abs=1e-3)
    of_model = quaternions_of(MATRICES @ ENU @ FRAME_FROM_EARTH.T)
    local = fitted.frame.local_attitude(of_model, lat, lon)
    assert local == pytest.approx(IMAGES.quaternion, abs=1e-9)
    assert fitted.frame.scale == pytest.approx(SCALE, rel=1e-9)
    assert counted([fitted.note]) == [("note", "ORIENTATION-FIT", 8)]
    assert "scale 100" in fitted.note.what


def test_the_vertical_is_as_good_as_its_sigma_says():
    """Over draws of positions good to 2 m: error over sigma of a level axis has an rms of one."""
    ratios = []
    for seed in range(60):
        frame = fit(xyz=model(2.0, seed)).frame
        about_an_axis = tilt(frame, FRAME_FROM_EARTH.T) / np.sqrt(2.0)
        ratios.append(about_an_axis / frame.tilt_rad)
    square = np.mean(np.square(ratios))
    assert 0.6 < np.sqrt(square) < 1.2


def test_three_known_positions_are_not_checked_by_anything():
    """60 m of height at one of three: residuals of centimetres, and a tilt of 0.3 degrees.

    The sigma is what 1 m in each height would do, not what residuals of nothing say.
    """
    right = fit([0, 17, 23])
    wrong = fit([0, 17, 23], places=raised(0, 60.0))
    for fitted in (right, wrong):
        assert fitted.note.kind == "warning"
        assert "three positions cannot be checked" in fitted.note.what
    apart = tilt(wrong.frame, right.frame.ecef_from_frame)
    assert apart > np.radians(0.1)
    assert 1.0 / 120.0 < right.frame.tilt_rad / apart < 1.0 / 20.0


def test_the_sigma_of_known_positions_is_in_that_of_the_vertical():
    of_one_metre = fit(sigma_m=1.0).frame.tilt_rad
    assert fit(sigma_m=5.0).frame.tilt_rad == pytest.approx(5.0 * of_one_metre)
    assert fit().frame.tilt_rad == of_one_metre


@pytest.mark.parametrize(
    ("row", "off_m"),
    [
        (0, 30.0),
        (18, -30.0),
    ],
)
def test_a_known_position_that_contradicts_the_others_is_named(row, off_m):
    noisy = model(0.3)
    assert fit(EVERY_OTHER, noisy).note.kind == "note"
    note = fit(EVERY_OTHER, noisy, raised(row, off_m)).note
    assert note.kind == "loss"
    assert f"without i{row} the others fit" in note.what
    match = re.search(r"it is ([0-9.]+) m off", note.what)
    assert float(match[1]) == pytest.approx(30.0, abs=3.0)


def test_residuals_that_no_sigma_explains_are_doubtful():
    """Every other height above another datum: no single position is the wrong one."""
    note = fit(places=raised(EVERY_OTHER, -140.0)).note
    assert note.kind == "loss"
    assert "than a known position should have" in note.what


def refused_fit(code, *arguments, **options):
    """The refusal of known positions that fit no frame."""
    with refused(code, MissionError) as refusal:
        fit(*arguments, **options)
    return refusal.value


def test_one_wrong_position_of_three_is_refused():
    """The second is moved by 60 m, or has the name of the first."""
    assert fit([0, 5, 9]).note.kind == "warning"
    moved = PLACES.copy()
    moved[5, 0] += 60.0 / EARTH_M
    refused_fit("ORIENTATION-LINE", [0, 5, 9], places=moved)
    exchanged = NAMES.copy()
    exchanged[[0, 5]] = NAMES[[5, 0]]
    refused_fit("ORIENTATION-FIT", [0, 5, 9], names=exchanged)


WOBBLE = EARTH + np.random.default_rng(2).normal(0.0, 3.0, EARTH.shape)


@pytest.mark.parametrize(
    ("xyz", "places", "says"),
    [
        (model(0.5), PLACES, "nearly on one line: with a sigma of 1 m"),
        (
            5.0 + np.outer(np.arange(COUNT), [1.0, 2.0, 3.0]),
            PLACES,
            "on one line: the model can roll about it",
        ),
        # Noise across a line is no base for a vertical, however well a model fits it.
        (
            WOBBLE / SCALE,
            np.stack(geodetic_of_ecef(*WOBBLE.T), axis=1),
            "nearly on one line: with a sigma of 1 m",
        ),
    ],
    ids=["known positions of one line", "images on one line", "metres of wobble"],
)
def test_positions_on_one_line_are_refused(xyz, places, says):
    refusal = refused_fit(
        "ORIENTATION-LINE",
        slice(EACH),
        xyz,
        places,
    )
    assert says in refusal.what


@pytest.mark.parametrize(
    ("rows", "names", "says"),
    [
        (slice(2), NAMES, "no vertical, no north and no scale"),
        (slice(4), image_names("x", "y", "z", "i0"), "1 of 4 known positions"),
    ],
)
def test_fewer_than_three_known_positions_are_refused(rows, names, says):
    assert says in refused_fit("ORIENTATION-KNOWN", rows, names=names).what


def test_another_model_and_swapped_coordinates_are_refused():
    refused_fit("ORIENTATION-FIT", places=PLACES[::-1])
    refusal = refused_fit("ORIENTATION-FIT", places=PLACES[:, [1, 0, 2]])
    assert "latitude and longitude exchanged" in refusal.remedy
