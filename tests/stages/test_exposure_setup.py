"""What the rays of each exposure are told: window, cabin and lens. Truth by hand and from Gyer."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import Events
from unbend.flight.heights import HeightSystem
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations, flag_missing_aircraft_attitude
from unbend.flight.stations import Stations, join_stations
from unbend.messages import Kind, Ledger
from unbend.refraction.camera.camera import LensInAir
from unbend.refraction.printed_tables import gyer_air, printed_table
from unbend.refraction.window import Cabin, Window, refract_at_window
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.camera_air import report_lenses
from unbend.stages.exposure_setup import exposures_of, report_windows
from unbend.units import ARCSEC

SECOND = 1_000_000_000
SECONDS = np.arange(0.0, 10.0, 0.1)
US1976 = standard_atmosphere("us1976")
SCHEDULE = Cabin("standard_schedule")
BELLY = (0.0, 0.0, 1.0)
LEVEL = (0.0, 0.0, 0.0)


def channel(name: str, seconds: np.ndarray = SECONDS, **columns: object) -> Channel:
    arrays = {k: np.broadcast_to(np.asarray(v, float), seconds.shape) for k, v in columns.items()}
    return Channel(name, (seconds * SECOND).astype(np.int64), arrays, Source(name))


def turned(yaw: float, pitch: float, roll: float) -> dict[str, float]:
    """Columns of an attitude [deg]."""
    quaternion = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_quat()
    return dict(zip(("q_x", "q_y", "q_z", "q_w"), quaternion, strict=True))


def stations(
    *heights: float,
    camera: str = "nadir",
    attitude: tuple[float, float, float] = LEVEL,
    mount: Mount = Mount(),  # noqa: B008
    **more: Channel,
) -> Stations:
    """One exposure a height, the camera level and to the north unless said otherwise."""
    place = {"lat_rad": 0.8, "lon_rad": 0.1}
    roles = {
        "position": channel("POS", **place),
        "height": channel("GPS[0]", **place, h_msl_m=1000.0),
        "attitude": channel("ATT", **turned(*attitude)),
        **more,
    }
    names = np.array([f"{camera}_{i}" for i in range(len(heights))], dtype=object)
    events = Events(camera, names, np.full(len(heights), 5 * SECOND))
    made = build_stations(events, roles, mount, HeightSystem(), 1.0)
    assert made.ok.all()
    return replace(made, h_msl_m=np.array(heights))


def look(at: Stations, window: Window | None = None, lens: LensInAir | None = None, profile=US1976):
    """Exposures and ledger of the camera ``nadir``."""
    ledger = Ledger()
    windows = {} if window is None else {"nadir": window}
    lenses = {} if lens is None else {"nadir": lens}
    at = with_cabin_air(at, windows, lenses, profile, ledger)
    return exposures_of(at, profile, windows, lenses, ledger, radius_m=6_378_000.0), ledger


def codes(ledger: Ledger) -> list[str]:
    return [entry.code for entry in ledger]


# ---------------------------------------------------------------- the air in the compartment


def test_gyers_table_7():
    """To the two digits of the paper: R_cc within 0.01 arcsec, n_cc within 0.015e-6."""
    printed = printed_table("gyer1996_table7")
    at = stations(*(printed["h_c_km"] * 1e3))
    found, ledger = look(at, Window(SCHEDULE), profile=gyer_air())
    inside = found.refractivity_cabin
    outside = found.refractivity_outside
    ray = np.full((len(at), 3), [math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    r_cc = refract_at_window(ray, inside, outside, found.window_normal)[1]
    np.testing.assert_allclose(inside * 1e6, printed["n_cc_minus_1_e6"], atol=0.015)
    np.testing.assert_allclose(r_cc / ARCSEC, printed["r_cc_arcsec"], atol=0.01)
    assert codes(ledger) == ["CABIN-SCHEDULE"]


def test_the_schedule_ends_at_10_km():
    found, ledger = look(stations(9_000.0, 11_000.0, 12_000.0), Window(SCHEDULE))
    assert found.usable.all()
    (warning,) = (entry for entry in ledger if entry.kind is Kind.WARNING)
    assert (warning.code, warning.count) == ("CABIN-SCHEDULE-HIGH", 2)


def test_air_of_the_log_of_the_file_and_none():
    at = replace(
        stations(3000.0, 3000.0),
        cabin_pressure_pa=np.array([80_000.0, np.nan]),
        cabin_temperature_k=np.array([293.15, 293.15]),
    )
    logged, ledger = look(at, Window(Cabin("log")))
    constant, _ = look(at, Window(Cabin("constant", 80_000.0, 293.15)))
    # 271.8e-6 at 15 degC and 1013.25 hPa is about 277.9e-6; the ideal gas scales it.
    assert logged.refractivity_cabin[0] == pytest.approx(
        277.9e-6 * 80_000 / 101_325 * 288.15 / 293.15, rel=2e-3
    )
    assert constant.refractivity_cabin.tolist() == [logged.refractivity_cabin[0]] * 2
    assert codes(ledger) == ["CABIN-DRY"]
    # Not told by cabin_from_log, and no number all the same.
    assert logged.usable.tolist() == [True, False]
    bare, ledger = look(at)
    np.testing.assert_array_equal(bare.refractivity_cabin, bare.refractivity_outside)
    assert bare.usable.all()
    assert codes(ledger) == []


def test_a_spherical_window_bends_nothing_and_needs_no_air():
    for cabin in (None, Cabin("log"), SCHEDULE):
        found, ledger = look(stations(8000.0), Window(cabin, shape="spherical"))
        np.testing.assert_array_equal(found.refractivity_cabin, found.refractivity_outside)
        assert found.window_normal.tolist() == [[0.0, 0.0, 1.0]]
        assert found.usable.all()
        assert codes(ledger) == []


def test_each_camera_has_its_own():
    at = join_stations(
        [stations(8000.0), stations(8000.0, camera="left"), stations(8000.0, camera="free")]
    )
    tilted = (0.0, math.sin(0.2), math.cos(0.2))
    windows = {"nadir": Window(SCHEDULE), "left": Window(Cabin("constant", 9e4, 280.0), tilted)}
    lenses = {"free": LensInAir(20_000.0, 101_325.0, 288.15, 1e-4, 0.0)}
    at = with_cabin_air(at, windows, lenses, US1976, Ledger())
    found = exposures_of(at, US1976, windows, lenses, Ledger(), radius_m=None)
    excess = found.refractivity_cabin - found.refractivity_outside
    assert (np.diff([0.0, *excess[[2, 0, 1]]]) > 0).tolist() == [False, True, True]
    assert found.window_normal[1] == pytest.approx(tilted)
    assert found.window_normal[[0, 2]].tolist() == [[0.0, 0.0, 1.0]] * 2
    assert (found.principal_change_px != 0.0).tolist() == [False, False, True]


# ---------------------------------------------------------------- how the window stands


@pytest.mark.parametrize(("degrees", "shift_px"), [(5.0, 0.11), (30.0, 0.70)])
def test_a_camera_tilted_behind_the_window_in_the_belly(degrees, shift_px):
    """The principal point at f = 20000 px, 7.5 km, Gyer's schedule: 0.108 and 0.714 px.

    At 6 km they are 0.067 and 0.44, at 10 km 0.165 and 1.09.
    """
    mount = Mount(roll_rad=math.radians(degrees))
    found, _ = look(
        stations(7500.0, mount=mount), Window(SCHEDULE, BELLY, "body"), None, gyer_air()
    )
    axis = np.array([[0.0, 0.0, 1.0]])
    change, r_cc = refract_at_window(
        axis, found.refractivity_cabin, found.refractivity_outside, found.window_normal
    )
    out = (axis + change)[0]
    shift = 20_000.0 * math.hypot(out[0], out[1]) / out[2]
    # Snell with the n that Table 7 prints, that of 7.5 km between those of 7 and 8 km.
    inside = 187.84e-6
    outside = math.sqrt(133.51e-6 * 118.97e-6)
    tilt = math.radians(degrees)
    bent = math.asin(math.sin(tilt) * (1.0 + inside) / (1.0 + outside))
    assert shift == pytest.approx(20_000.0 * math.tan(bent - tilt), rel=3e-3)
    assert shift == pytest.approx(shift_px, abs=0.015)
    assert r_cc[0] > 0.0


@pytest.mark.parametrize(
    ("aircraft", "window", "in_camera"),
    [
        (LEVEL, BELLY, (0.0, 0.0, 1.0)),
        # The right wing down turns the belly to the left: west, where the level camera has -x.
        ((0.0, 0.0, 10.0), BELLY, (-math.sin(math.radians(10)), 0.0, math.cos(math.radians(10)))),
        # The nose up turns it ahead: north, up in the image, -y.
        ((0.0, 10.0, 0.0), BELLY, (0.0, -math.sin(math.radians(10)), math.cos(math.radians(10)))),
        # Yaw alone shows only where the window is not level: ahead by 45 degrees, flying east.
        (
            (90.0, 0.0, 0.0),
            (math.sqrt(0.5), 0.0, math.sqrt(0.5)),
            (math.sqrt(0.5), 0.0, math.sqrt(0.5)),
        ),
    ],
)
def test_a_stabilised_camera_moves_behind_the_window(aircraft, window, in_camera):
    own = channel("ATT[1]", **turned(*aircraft))
    at = stations(3000.0, aircraft_attitude=own)
    found, _ = look(at, Window(SCHEDULE, window, "body"))
    assert found.window_normal[0] == pytest.approx(in_camera, abs=1e-12)
    # In the frame of the camera it would stay where it is.
    fixed, _ = look(at, Window(SCHEDULE))
    assert fixed.window_normal[0].tolist() == [0.0, 0.0, 1.0]


def test_without_a_stabilised_mount_the_window_stays_before_the_camera():
    mount = Mount(roll_rad=-0.3, pitch_rad=0.1, yaw_rad=1.0)
    for attitude in (LEVEL, (75.0, 12.0, -25.0)):
        at = stations(3000.0, attitude=attitude, mount=mount)
        found, _ = look(at, Window(SCHEDULE, BELLY, "body"))
        assert found.window_normal[0] == pytest.approx(mount.camera_from_body @ BELLY, abs=1e-12)


def test_a_gap_in_the_attitude_of_the_aircraft_is_suspect():
    early = channel("ATT[1]", SECONDS[SECONDS < 3.0], **turned(0.0, 0.0, 10.0))
    at = stations(3000.0, aircraft_attitude=early)
    ledger = Ledger()
    flagged = ledger.take(flag_missing_aircraft_attitude(at, "nadir"))
    assert flagged.status.tolist() == ["suspect"]
    assert [(e.kind, e.code, e.count) for e in ledger] == [
        (Kind.LOSS, "AIRCRAFT-ATTITUDE-MISSING", 1)
    ]
    assert flag_missing_aircraft_attitude(at, "other")[0].ok.all()
    assert flag_missing_aircraft_attitude(stations(3000.0), "nadir")[0].ok.all()
    # Nobody asked, and no number all the same; a window in the camera's frame does not care.
    assert not look(at, Window(SCHEDULE, BELLY, "body"))[0].usable.any()
    assert look(at, Window(SCHEDULE))[0].usable.all()


# ---------------------------------------------------------------- the lens

LENS = LensInAir(20_000.0, 101_325.0, 288.15, px_per_pa=1e-4, px_per_k=0.01)


def test_the_lens_is_in_the_air_outside_or_in_the_cabin():
    """US 1976 at 6 km by its own table: 472.17 hPa, 249.19 K. In the cabin 701.2 hPa, 294.26 K."""
    in_the_open = 1e-4 * (47_217.6 - 101_325.0) + 0.01 * (249.187 - 288.15)
    in_the_cabin = 1e-4 * (70_120.0 - 101_325.0) + 0.01 * (294.26 - 288.15)
    for window, expected in (
        (None, in_the_open),
        (Window(SCHEDULE), in_the_cabin),
        (Window(SCHEDULE, shape="spherical"), in_the_cabin),
        (Window(None, shape="spherical"), in_the_open),
    ):
        found, ledger = look(stations(6000.0), window, LENS)
        assert found.principal_change_px[0] == pytest.approx(expected, abs=2e-4)
        # The cabin's air is in the lens behind a dome, and bends nothing there.
        bends = found.refractivity_cabin[0] != found.refractivity_outside[0]
        assert bends == (window is not None and window.shape == "plane")
        (note,) = (entry for entry in ledger if entry.code == "LENS-IN-AIR")
        assert f"{found.principal_change_px[0]:.3f} px" in note.what


def test_a_lens_behind_a_dome_in_unknown_air_is_no_number():
    at = stations(6000.0)
    found, _ = look(at, Window(Cabin("log"), shape="spherical"), LENS)
    assert not found.usable.any()
    assert look(at, Window(Cabin("log"), shape="spherical"))[0].usable.all()


def test_a_camera_beyond_the_profile_keeps_its_own_status():
    """The correction says outside_profile where the air outside is unknown, not no_station."""
    found, _ = look(stations(6000.0, 200_000.0), None, LENS)
    assert np.isnan(found.refractivity_outside).tolist() == [False, True]
    assert found.usable.all()
    assert np.isfinite(found.principal_change_px).all()


def test_an_absurd_change_is_refused():
    """A derivative per hPa given as one per Pa: a hundred times too much."""
    with pytest.raises(MissionError, match="LENS-CHANGE") as refusal:
        look(stations(1000.0, 6000.0), None, replace(LENS, px_per_pa=1e-2))
    assert "-541" in refusal.value.what
    assert "472 hPa" in refusal.value.what
    assert refusal.value.where == "cameras.nadir.principal_distance"
    # An exposure that is not used does not refuse the mission.
    unused = stations(6000.0).with_status(np.ones(1, bool), "suspect")
    look(unused, None, replace(LENS, px_per_pa=1e-2))


# ---------------------------------------------------------------- what is said of it


def test_what_stays_in_is_said_once():
    ledger = Ledger()
    windows = {
        "a": Window(SCHEDULE),
        "b": Window(SCHEDULE, in_calibration="glass"),
        "c": Window(None, shape="spherical"),
    }
    report_windows(windows, ledger)
    at = stations(3000.0)
    three = SimpleNamespace(cameras=dict.fromkeys("abc"), lenses={"b": LENS}, windows={})
    report_lenses(three, at, US1976, ledger)
    report_lenses(SimpleNamespace(cameras={"b": None}, lenses={"b": LENS}), at, US1976, ledger)
    said = {(e.where.split(".")[1], e.code): e.what for e in ledger}
    assert len(said) == len(ledger) == 4
    assert {e.kind for e in ledger} == {Kind.NOTE}
    assert "is not removed" in said["a", "WINDOW-GLASS"]
    assert "contains" in said["b", "WINDOW-GLASS"]
    assert "does not bend rays" in said["c", "WINDOW-SPHERICAL"]
    assert "of a, c is not removed" in said["<name>", "LENS-NOT-REMOVED"]
