"""What the rays of each exposure are told: window, cabin and lens. Truth by hand and from Gyer."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import refused, with_code
from tests.stages.level_cameras import (
    LEVEL,
    SECONDS,
    US1976,
    WARM_HATCH,
    attitude_channel,
    look,
    stations,
)
from unbend.flight.mount import Mount
from unbend.flight.station_builder import flag_missing_aircraft_attitude
from unbend.flight.stations import join_stations
from unbend.messages import Kind, Ledger
from unbend.refraction.camera.camera import LensInAir
from unbend.refraction.printed_tables import gyer_air, printed_table
from unbend.refraction.window import Cabin, Window, refract_at_window
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.camera_air import report_lenses
from unbend.stages.exposure_setup import exposures_of, report_windows
from unbend.units import ARCSEC

SCHEDULE = Cabin("standard_schedule")
FORWARD = [0.0, 0.0, 1.0]
"""Along the optical axis, or through the belly of the aircraft."""

FLAT = Window(SCHEDULE)
IN_THE_BELLY = Window(SCHEDULE, FORWARD, "body")
DOME = Window(SCHEDULE, shape="spherical")
DOME_OF_LOG = replace(DOME, cabin=Cabin("log"))
BARE_DOME = replace(DOME, cabin=None)
LENS = LensInAir(20_000.0, 101_325.0, 288.15, px_per_pa=1e-4, px_per_k=0.01)
COS_45 = math.sqrt(0.5)
OBLIQUE = (COS_45, 0.0, COS_45)


# ---------------------------------------------------------------- the air in the compartment


def test_gyers_table_7():
    """To the two digits of the paper: R_cc within 0.01 arcsec, n_cc within 0.015e-6."""
    printed = printed_table("gyer1996_table7")
    heights_m = printed["h_c_km"] * 1e3
    exposed = stations(*heights_m)
    exposures, ledger = look(exposed, FLAT, profile=gyer_air())

    rays = np.array([OBLIQUE] * len(exposed))
    _, r_cc = at_window(rays, exposures)

    inside_e6 = exposures.refractivity_cabin * 1e6
    assert_allclose(inside_e6, printed["n_cc_minus_1_e6"], rtol=0, atol=0.015)
    assert_allclose(r_cc / ARCSEC, printed["r_cc_arcsec"], rtol=0, atol=0.01)
    assert code_of(ledger) == "CABIN-SCHEDULE"


def code_of(ledger):
    (message,) = ledger
    return message.code


def at_window(rays, exposures):
    return refract_at_window(
        rays,
        exposures.refractivity_cabin,
        exposures.refractivity_outside,
        exposures.window_normal,
    )


def test_the_schedule_ends_at_10_km():
    exposed = stations(10_000.0, 10_001.0, 12_000.0)
    exposures, ledger = look(exposed, FLAT)
    assert exposures.usable.all()
    (warning,) = with_code(ledger, "CABIN-SCHEDULE-HIGH")
    assert warning.kind is Kind.WARNING
    assert warning.count == 2


def test_air_of_the_log_of_the_file_and_none():
    exposed = stations(
        3000.0,
        3000.0,
        cabin_pressure_pa=[80_000.0, np.nan],
        cabin_temperature_k=293.15,
    )
    by_log, ledger = look(exposed, Window(Cabin("log")))
    cabin = Cabin("constant", 80_000.0, 293.15)
    constant, _ = look(exposed, Window(cabin))

    # 271.8e-6 at 15 degC and 1013.25 hPa is about 277.9e-6; the ideal gas scales it.
    expected = 277.9e-6 * 80_000 / 101_325 * 288.15 / 293.15
    logged, _ = by_log.refractivity_cabin
    assert logged == pytest.approx(expected, rel=2e-3)
    assert code_of(ledger) == "CABIN-DRY"
    # Not told by with_logged_cabin, and no number all the same.
    assert by_log.usable.tolist() == [True, False]
    assert constant.refractivity_cabin.tolist() == [logged, logged]


@pytest.mark.parametrize(
    "window",
    [None, BARE_DOME, DOME_OF_LOG, DOME],
    ids=["no window", "bare dome", "dome of the log", "dome of the schedule"],
)
def test_a_spherical_window_bends_nothing_and_needs_no_air(window):
    exposures, ledger = look(stations(8000.0), window)
    assert_array_equal(exposures.refractivity_cabin, exposures.refractivity_outside)
    assert exposures.window_normal.tolist() == [FORWARD]
    assert exposures.usable.all()
    assert not list(ledger)


def test_each_camera_has_its_own():
    cameras = ("nadir", "left", "free")
    exposed = join_stations([stations(8000.0, camera=camera) for camera in cameras])
    tilted = (0.0, math.sin(0.2), math.cos(0.2))
    windows = {
        "nadir": FLAT,
        "left": Window(Cabin("constant", 9e4, 280.0), tilted),
    }
    lenses = {"free": LENS}

    with_air = with_cabin_air(exposed, windows, lenses, US1976, Ledger())
    exposures = exposures_of(with_air, US1976, windows, lenses, Ledger(), radius_m=None)

    nadir, left, free = exposures.refractivity_cabin - exposures.refractivity_outside
    assert left > nadir > free == 0.0
    normals = exposures.window_normal.tolist()
    assert normals == [FORWARD, pytest.approx(tilted), FORWARD]
    nadir, left, free = exposures.principal_change_px
    assert nadir == left == 0.0 != free


# ---------------------------------------------------------------- how the window stands


def normal_of(exposed, window):
    exposures, _ = look(exposed, window)
    (normal,) = exposures.window_normal
    return normal


@pytest.mark.parametrize(
    ("degrees", "shift_px"),
    [(5.0, 0.11), (30.0, 0.70)],
)
def test_a_camera_tilted_behind_the_window_in_the_belly(degrees, shift_px):
    """The principal point at f = 20000 px, 7.5 km, Gyer's schedule: 0.108 and 0.714 px.

    At 6 km they are 0.067 and 0.44, at 10 km 0.165 and 1.09.
    """
    tilt = math.radians(degrees)
    exposed = stations(7500.0, mount=Mount(roll_rad=tilt))
    exposures, _ = look(exposed, IN_THE_BELLY, profile=gyer_air())
    axis = np.array([FORWARD])
    change, r_cc = at_window(axis, exposures)
    ((x, y, z),) = axis + change
    shift = 20_000.0 * math.hypot(x, y) / z

    # Snell with the n that Table 7 prints, that of 7.5 km between those of 7 and 8 km.
    inside = 187.84e-6
    outside = math.sqrt(133.51e-6 * 118.97e-6)
    behind = math.asin(math.sin(tilt) * (1.0 + inside) / (1.0 + outside))
    by_snell = 20_000.0 * math.tan(behind - tilt)
    assert shift == pytest.approx(by_snell, rel=3e-3)
    assert shift == pytest.approx(shift_px, abs=0.015)
    assert r_cc[0] > 0.0


SIN_10 = math.sin(math.radians(10.0))
COS_10 = math.cos(math.radians(10.0))


@pytest.mark.parametrize(
    ("aircraft", "window", "in_camera"),
    [
        (LEVEL, FORWARD, FORWARD),
        # The right wing down turns the belly to the left: west, where the level camera has -x.
        ((0.0, 0.0, 10.0), FORWARD, (-SIN_10, 0.0, COS_10)),
        # The nose up turns it ahead: north, up in the image, -y.
        ((0.0, 10.0, 0.0), FORWARD, (0.0, -SIN_10, COS_10)),
        # Yaw alone shows only where the window is not level: ahead by 45 degrees, flying east.
        ((90.0, 0.0, 0.0), OBLIQUE, OBLIQUE),
    ],
    ids=["level", "right wing down", "nose up", "flying east"],
)
def test_a_stabilised_camera_moves_behind_the_window(aircraft, window, in_camera):
    attitude = attitude_channel(*aircraft, name="ATT[1]")
    exposed = stations(3000.0, aircraft=attitude)
    normal = normal_of(exposed, Window(SCHEDULE, window, "body"))
    assert normal == pytest.approx(in_camera, abs=1e-12)
    # In the frame of the camera it would stay where it is.
    assert normal_of(exposed, FLAT).tolist() == FORWARD


def test_without_a_stabilised_mount_the_window_stays_before_the_camera():
    mount = Mount(roll_rad=-0.3, pitch_rad=0.1, yaw_rad=1.0)
    exposed = stations(3000.0, attitude=(75.0, 12.0, -25.0), mount=mount)
    normal = normal_of(exposed, IN_THE_BELLY)
    assert normal == pytest.approx(mount.camera_from_body @ FORWARD, abs=1e-12)


def test_a_gap_in_the_attitude_of_the_aircraft_is_suspect():
    early_s = SECONDS[SECONDS < 3.0]
    early = attitude_channel(0.0, 0.0, 10.0, name="ATT[1]", seconds=early_s)
    exposed = stations(3000.0, aircraft=early)

    flagged, (loss,) = flag_missing_aircraft_attitude(exposed, "nadir")
    no_aircraft, _ = flag_missing_aircraft_attitude(stations(3000.0), "nadir")

    assert flagged.status.tolist() == ["suspect"]
    assert loss.code == "AIRCRAFT-ATTITUDE-MISSING"
    assert no_aircraft.ok.all()
    # Nobody asked, and no number all the same; a window in the camera's frame does not care.
    of_body, _ = look(exposed, IN_THE_BELLY)
    of_camera, _ = look(exposed, FLAT)
    assert not of_body.usable.any()
    assert of_camera.usable.all()


# ---------------------------------------------------------------- the lens

IN_THE_OPEN = 1e-4 * (47_217.6 - 101_325.0) + 0.01 * (249.187 - 288.15)
IN_THE_CABIN = 1e-4 * (70_120.0 - 101_325.0) + 0.01 * (294.26 - 288.15)


@pytest.mark.parametrize(
    ("window", "expected", "bends"),
    [
        (None, IN_THE_OPEN, False),
        (FLAT, IN_THE_CABIN, True),
        # The cabin's air is in the lens behind a dome, and bends nothing there.
        (DOME, IN_THE_CABIN, False),
        (BARE_DOME, IN_THE_OPEN, False),
        (Window(WARM_HATCH), IN_THE_OPEN + 0.1, True),
    ],
    ids=["no window", "window", "dome", "bare dome", "an opening, 10 K warmer"],
)
def test_the_lens_is_in_the_air_outside_or_in_the_cabin(window, expected, bends):
    """US 1976 at 6 km by its own table: 472.17 hPa, 249.19 K. In the cabin 701.2 hPa, 294.26 K."""
    exposures, ledger = look(stations(6000.0), window, LENS)
    (change_px,) = exposures.principal_change_px
    assert change_px == pytest.approx(expected, abs=2e-4)
    (difference,) = exposures.refractivity_cabin - exposures.refractivity_outside
    assert (difference != 0.0) == bends
    (note,) = with_code(ledger, "LENS-IN-AIR")
    assert f"{change_px:.3f} px" in note.what


def test_a_lens_behind_a_dome_in_unknown_air_is_no_number():
    exposures, _ = look(stations(6000.0), DOME_OF_LOG, LENS)
    assert not exposures.usable.any()


def test_a_camera_beyond_the_profile_keeps_its_own_status():
    """The correction says outside_profile where the air outside is unknown, not no_station."""
    exposures, _ = look(stations(6000.0, 200_000.0), None, LENS)
    is_beyond = np.isnan(exposures.refractivity_outside)
    assert is_beyond.tolist() == [False, True]
    assert exposures.usable.all()
    assert np.isfinite(exposures.principal_change_px).all()


def test_an_absurd_change_is_refused():
    """A derivative per hPa given as one per Pa: a hundred times too much."""
    per_hpa = replace(LENS, px_per_pa=1e-2)
    with refused("LENS-CHANGE") as caught:
        look(stations(1000.0, 6000.0), None, per_hpa)
    refusal = caught.value
    assert "-541" in refusal.what
    assert "472 hPa" in refusal.what
    assert refusal.where == "cameras.nadir.principal_distance"
    # An exposure that is not used does not refuse the mission.
    unused = stations(6000.0).with_status(np.ones(1, bool), "suspect")
    look(unused, None, per_hpa)


# ---------------------------------------------------------------- what is said of it


def test_glass_in_the_calibration_is_no_loss():
    ledger = Ledger()
    glass = Window(SCHEDULE, in_calibration="glass")
    report_windows({"a": glass}, ledger)
    (note,) = with_code(ledger, "WINDOW-GLASS")
    assert note.kind is Kind.NOTE
    assert "contains" in note.what


@pytest.mark.parametrize(
    ("cameras", "names"),
    [("abc", ["a, c"]), ("b", [])],
)
def test_lenses_that_are_not_removed_are_named_once(cameras, names):
    ledger = Ledger()
    mission = SimpleNamespace(
        cameras=dict.fromkeys(cameras),
        lenses={"b": LENS},
        windows={},
    )
    report_lenses(mission, stations(3000.0), US1976, ledger)
    assert len(ledger) == len(names)
    for note, named in zip(ledger, names, strict=True):
        assert note.code == "LENS-NOT-REMOVED"
        assert f"of {named} is not removed" in note.what
