"""From events to stations: mounts, lever arms, heights, reasons. Expected values by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import (
    Events,
    ExposureDelay,
    choose_event_channel,
    events_of_channel,
    refuse_repeated_images,
)
from unbend.flight.heights import (
    GeodeticOrigin,
    HeightSystem,
    ground_offsets,
    height_system,
    to_geodetic,
)
from unbend.flight.mount import Mount
from unbend.flight.station_builder import ClockSigmas, build_stations
from unbend.flight.stations import append_unmatched_images, unusable_station_notes
from unbend.flight.triggers import trigger_notes
from unbend.geodesy import GeoidGrid
from unbend.messages import Ledger
from unbend.refraction.window import Cabin
from unbend.stages.cabin_air import cabin_from_log

SECOND = 1_000_000_000
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(8.0)


def channel(name: str, seconds: object, rank: int = 50, **columns: object) -> Channel:
    time_ns = (np.atleast_1d(np.asarray(seconds, float)) * SECOND).astype(np.int64)
    arrays = {k: np.broadcast_to(np.asarray(v, float), time_ns.shape) for k, v in columns.items()}
    message, _, instance = name.partition("[")
    return Channel(
        name,
        time_ns,
        arrays,
        Source(message, instance.rstrip("]") or None),
        rank=rank,
        roles=("events",) if "event_index" in arrays else (),
    )


def roles(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0, **more: Channel):
    seconds = np.arange(0.0, 10.0, 0.1)
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_quat()
    place = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE}
    return {
        "position": channel("POS", seconds, **place),
        "height": channel("GPS[0]", seconds, **place, h_msl_m=1000.0),
        "attitude": channel("ATT", seconds, q_x=q[0], q_y=q[1], q_z=q[2], q_w=q[3]),
        **more,
    }


def events(*seconds: float) -> Events:
    names = np.array([f"image_{i}" for i in range(len(seconds))], dtype=object)
    return Events("cam", names, (np.array(seconds) * SECOND).astype(np.int64))


def one_station(mount: Mount = Mount(), heights: HeightSystem = HeightSystem(), **kwargs: object):  # noqa: B008
    return build_stations(events(5.0), roles(**kwargs), mount, heights, 1.0)


def looks(station, direction: list[float]) -> np.ndarray:
    """Where a direction of the camera points, in east, north, up."""
    q = station.quaternion[0][[1, 2, 3, 0]]
    return Rotation.from_quat(q).inv().apply(direction)


FORWARD = [0, 0, 1]
RIGHT = [1, 0, 0]
UP_IN_IMAGE = [0, -1, 0]


def test_level_flight_north_looks_down_with_the_top_of_the_image_north() -> None:
    station = one_station()
    assert looks(station, FORWARD) == pytest.approx([0, 0, -1], abs=1e-12)
    assert looks(station, UP_IN_IMAGE) == pytest.approx([0, 1, 0], abs=1e-12)
    assert looks(station, RIGHT) == pytest.approx([1, 0, 0], abs=1e-12)


def test_flight_east_turns_the_image() -> None:
    assert looks(one_station(yaw=90.0), UP_IN_IMAGE) == pytest.approx([1, 0, 0], abs=1e-12)


def test_right_bank_makes_the_camera_look_left() -> None:
    """The right wing down: the belly turns to the left, which is west when flying north."""
    sine = np.sin(np.radians(10.0))
    assert looks(one_station(roll=10.0), FORWARD)[0] == pytest.approx(-sine, abs=1e-12)


def test_nose_up_makes_the_camera_look_ahead() -> None:
    sine = np.sin(np.radians(10.0))
    assert looks(one_station(pitch=10.0), FORWARD)[1] == pytest.approx(sine, abs=1e-12)


@pytest.mark.parametrize(
    ("mount", "expected"),
    [
        (Mount(roll_rad=-np.pi / 4), [np.sqrt(0.5), 0, -np.sqrt(0.5)]),  # to the right: east
        (Mount(pitch_rad=np.pi / 4), [0, np.sqrt(0.5), -np.sqrt(0.5)]),  # ahead: north
        (Mount(pitch_rad=np.pi / 4, yaw_rad=np.pi / 2), [np.sqrt(0.5), 0, -np.sqrt(0.5)]),
    ],
)
def test_mounts(mount: Mount, expected: list[float]) -> None:
    assert looks(one_station(mount), FORWARD) == pytest.approx(expected, abs=1e-12)


def test_lever_arm_moves_the_projection_centre() -> None:
    mount = Mount(lever_arm_m=(3.0, 2.0, 1.0))  # forward, right, down; flying east
    station = one_station(mount, HeightSystem(undulation_m=40.0), yaw=90.0)
    geodesic = pyproj.Geod(ellps="WGS84")
    azimuth, _, distance = geodesic.inv(
        np.degrees(LONGITUDE),
        np.degrees(LATITUDE),
        np.degrees(station.lon_rad[0]),
        np.degrees(station.lat_rad[0]),
    )
    east = distance * np.sin(np.radians(azimuth))
    north = distance * np.cos(np.radians(azimuth))
    # On the ellipsoid, 1040 m below: shorter by 1.6e-4.
    assert (east, north) == pytest.approx((3.0, -2.0), abs=1e-3)
    assert station.h_msl_m[0] == pytest.approx(999.0, abs=1e-5)
    assert station.h_ellipsoid_m[0] == pytest.approx(1039.0, abs=1e-5)


def test_unknown_ellipsoidal_height_stays_unknown() -> None:
    station = one_station(Mount(lever_arm_m=(0.0, 0.0, 1.0)))
    assert station.h_msl_m[0] == pytest.approx(999.0, abs=1e-5)
    assert np.isnan(station.h_ellipsoid_m[0])
    assert station.status[0] == "ok"


def test_ellipsoidal_height_alone_is_no_height_above_the_sea() -> None:
    seconds = np.arange(0.0, 10.0, 0.1)
    gnss = channel("/fix", seconds, lat_rad=LATITUDE, lon_rad=LONGITUDE, h_ellipsoid_m=1048.0)
    station = one_station(height=gnss)
    assert station.status[0] == "height_reference_unknown"
    known = one_station(heights=HeightSystem(undulation_m=48.0), height=gnss)
    assert (known.status[0], known.h_msl_m[0]) == ("ok", pytest.approx(1000.0))
    lat = np.degrees(LATITUDE)
    # 40 m at the parallel of the place, and 2 m more in each degree to the north.
    values = 40.0 + np.outer([-2.0, 0.0, 2.0], np.ones(360))
    grid = GeoidGrid("plane", values.astype(np.float32), lat - 1.0, -180.0, 1.0, 1.0)
    system, _ = height_system({"height": gnss}, None, grid)
    known = one_station(heights=system, height=gnss)
    assert (known.status[0], known.h_msl_m[0]) == ("ok", pytest.approx(1008.0, abs=1e-3))
    north = np.array([LATITUDE + np.radians(0.5)]), np.array([LONGITUDE])
    assert system.undulation(*north) == pytest.approx(41.0)
    # A log whose two heights are 41.5 m apart here has 42.5 m there.
    both = channel(
        "GPS", seconds, lat_rad=LATITUDE, lon_rad=LONGITUDE, h_ellipsoid_m=1041.5, h_msl_m=1000.0
    )
    system, _ = height_system({"height": both}, None, grid)
    assert system.undulation(*north) == pytest.approx(42.5)
    assert "GPS" in system.source


def test_an_undulation_that_the_log_contradicts_is_told() -> None:
    place = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE, "h_msl_m": 1000.0}
    both = channel("GPS", np.arange(5.0), **place, h_ellipsoid_m=1048.0)
    for stated, kinds in ((47.0, []), (44.0, ["warning"]), (-48.0, ["finding"])):
        _, notes = height_system({"height": both}, stated)
        assert [note.kind for note in notes if note.code == "HEIGHT-GEOID"] == kinds


def test_each_reason_has_its_name() -> None:
    early_attitude = channel("ATT", np.arange(0, 4, 0.1), q_x=0, q_y=0, q_z=0, q_w=1)
    torn = np.concatenate([np.arange(0, 3, 0.1), np.arange(7, 10, 0.1)])
    gap = channel("POS", torn, lat_rad=LATITUDE, lon_rad=LONGITUDE)
    when = events(-1.0, 2.0, 5.0, 9.95)
    with_gap = build_stations(when, roles(position=gap), Mount(), HeightSystem(), 1.0)
    assert with_gap.status.tolist() == ["outside_log", "ok", "in_gap", "outside_log"]
    late = build_stations(
        events(2.0, 5.0), roles(attitude=early_attitude), Mount(), HeightSystem(), 1
    )
    assert late.status.tolist() == ["ok", "outside_log"]
    bare = roles()
    del bare["attitude"]
    assert build_stations(when, bare, Mount(), HeightSystem(), 1.0).status[1] == "no_attitude"
    assert build_stations(when, {}, Mount(), HeightSystem(), 1.0).status[1] == "no_position"
    ledger = Ledger()
    ledger.extend(unusable_station_notes(with_gap))
    assert {e.code for e in ledger} == {"STATIONS-FLAGGED"}
    assert ledger.has_losses


def test_air_at_the_exposure() -> None:
    seconds = np.arange(0.0, 10.0, 0.5)
    rising = channel("BARO[1]", seconds, pressure_pa=80_000.0 + 100.0 * seconds)
    warm = channel("TEMP[0]", seconds, temperature_k=293.15)
    humid = channel("HYGR[1]", seconds, relative_humidity=0.5)
    station = one_station(cabin_pressure=rising, cabin_temperature=warm, cabin_humidity=humid)
    assert station.cabin_pressure_pa[0] == pytest.approx(80_500.0)
    # 2339.2 Pa is the saturation pressure at 20 degrees; moist air holds 0.3 % more.
    assert station.cabin_vapour_pressure_pa[0] == pytest.approx(0.5 * 2339.2 * 1.0034, rel=1e-3)
    assert np.isnan(station.pressure_pa[0])
    ledger = Ledger()
    logged = Cabin("log")
    assert ledger.take(cabin_from_log(station, "cam", logged)).status[0] == "ok"
    assert ledger.take(cabin_from_log(one_station(), "cam", logged)).status[0] == "suspect"
    assert [e.code for e in ledger] == ["CABIN-MISSING"]


def test_image_names_and_lost_numbers() -> None:
    shots = channel("CAM[0]", [1, 2, 3, 4], event_index=[7, 8, 10, 11])
    ledger = Ledger()
    named = ledger.take(events_of_channel(shots, "cam", "IMG_{index:03d}", ExposureDelay(0.5)))
    assert named.image.tolist() == ["IMG_007", "IMG_008", "IMG_010", "IMG_011"]
    assert named.time_ns[0] == 1_500_000_000
    (entry,) = ledger
    assert (entry.code, entry.count) == ("EVENTS-LOST", 1)
    assert "9" in entry.what


def test_many_lost_numbers_are_counted_too() -> None:
    shots = channel("CAM[0]", np.arange(100), event_index=np.arange(1, 301, 3))
    ledger = Ledger()
    ledger.take(events_of_channel(shots, "cam", "{index}", ExposureDelay(0.0)))
    assert [(e.count, e.kind) for e in ledger] == [(198, "loss")]


def test_lost_events_are_counted_beside_counted_names() -> None:
    shots = channel("CAM[0]", [1, 2, 3], event_index=[1, 2, 5])
    events, _ = events_of_channel(shots, "cam", "IMG_{n:03d}", ExposureDelay(0.0))
    assert events.lost == 2
    assert events.index is not None
    assert events.index.tolist() == [1, 2, 5]


def test_names_that_only_the_images_know_stay_empty() -> None:
    shots = channel("CAM[0]", [1, 2], event_index=[1, 2])
    events, _ = events_of_channel(shots, "cam", "left/*", ExposureDelay(0.0))
    assert events.image.tolist() == ["", ""]
    refuse_repeated_images([events])


def test_the_take_off_height_of_two_flights_is_not_guessed() -> None:
    seconds = np.arange(0.0, 100.0)
    home = np.where(seconds < 50, 500.0, 507.0)
    moved = channel("POS", seconds, h_msl_m=home + 10.0, h_home_m=10.0)
    unset = channel("POS", seconds, h_msl_m=510.0, h_home_m=np.where(seconds < 70, 510.0, 10.0))
    system, (changes,) = height_system({"position": moved}, None)
    assert system.home_h_msl_m is None
    assert (changes.code, changes.where) == ("HEIGHT-HOME", "POS")
    assert "changes between" in changes.what
    system, (steady,) = height_system({"position": unset}, None)
    assert system.home_h_msl_m == 500.0
    assert steady.code == "HEIGHT-HOME"
    assert steady.what == "take-off height 500.00 m above mean sea level"


def test_triggers_without_a_shutter_are_counted() -> None:
    shots = channel("CAM[0]", [1, 2, 3], event_index=[1, 2, 3])
    triggers = channel("TRIG[0]", [1, 2, 3, 4, 5], rank=40, event_index=[1, 2, 3, 4, 5])
    ledger = Ledger()
    ledger.extend(trigger_notes((shots, triggers), shots, {}))
    assert [e.count for e in ledger] == [2]


def fired(name: str, count: int) -> Channel:
    return channel(name, np.arange(count), event_index=np.arange(count))


LOST = "EVENTS-LOST"
AT_TRIGGER = "EVENTS-TRIGGER-TIME"


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        # a camera with a feedback pin and one without
        (
            {"CAM[0]": 3, "CAM[1]": 4, "TRIG[0]": 5},
            [(LOST, "CAM[0]", 2), (AT_TRIGGER, "CAM[1]", 4)],
        ),
        (
            {"CAM[0]": 4, "CAM[1]": 3, "TRIG[1]": 5},
            [(AT_TRIGGER, "CAM[0]", 4), (LOST, "CAM[1]", 2)],
        ),
        # each has its pin, and one lost nothing
        ({"CAM[0]": 5, "CAM[1]": 3, "TRIG[0]": 5, "TRIG[1]": 4}, [(LOST, "CAM[1]", 1)]),
        # neither has one
        ({"CAM[0]": 3, "CAM[1]": 4}, [(AT_TRIGGER, "CAM[0]", 3), (AT_TRIGGER, "CAM[1]", 4)]),
        # logs of the time of one camera: no instances at all
        ({"CAM": 3, "TRIG": 5}, [(LOST, "CAM", 2)]),
        ({"CAM": 3}, [(AT_TRIGGER, "CAM", 3)]),
        # triggers that are not told apart are those of all cameras together, and counted once
        ({"CAM[0]": 3, "CAM[1]": 4, "TRIG": 7}, []),
        ({"CAM[0]": 3, "CAM[1]": 4, "TRIG": 8}, [(LOST, "CAM[0], CAM[1]", 1)]),
    ],
)
def test_triggers_of_another_camera_do_not_count(
    rows: dict[str, int], told: list[tuple[str, str, int]]
) -> None:
    channels = tuple(fired(name, count) for name, count in rows.items())
    ledger = Ledger()
    for camera in channels:
        if camera.source.message == "CAM":
            ledger.extend(trigger_notes(channels, camera, {}))
    assert [(entry.code, entry.where, entry.count) for entry in ledger] == told


def test_repeated_names_are_refused() -> None:
    with pytest.raises(MissionError, match="EVENTS-REPEATED"):
        refuse_repeated_images([events(1.0, 2.0), events(3.0)])


def test_choice_of_the_event_channel() -> None:
    first = channel("CAM[0]", [1], rank=10, event_index=[1])
    second = channel("CAM[1]", [1], rank=10, event_index=[1])
    trigger = channel("TRIG[0]", [1], rank=40, event_index=[1])
    assert choose_event_channel((trigger, first), None) is first
    assert choose_event_channel((trigger, first, second), "CAM[1]") is second
    with pytest.raises(MissionError, match=r"CAM\[0\].*CAM\[1\]"):
        choose_event_channel((first, second), None)
    with pytest.raises(MissionError, match="EVENTS-CHANNEL"):
        choose_event_channel((first,), "CAM[3]")


def test_undulation_and_home_from_the_log() -> None:
    seconds = np.arange(0.0, 3.0)
    both = channel("GPS[0]", seconds, h_msl_m=[1, 2, 3], h_ellipsoid_m=[49, 50, np.nan])
    home = channel("POS", seconds, h_msl_m=[500.0, 510, 520], h_home_m=[0, 10, 20])
    system = height_system({"height": both, "position": home}, None)[0]
    assert (system.undulation_m, system.home_h_msl_m) == (48.0, 500.0)
    assert height_system({"height": both}, 47.0)[0].undulation_m == 47.0


def test_ground_heights_of_three_kinds() -> None:
    station = one_station(heights=HeightSystem(undulation_m=48.0))
    heights = HeightSystem(48.0, 430.0)
    assert ground_offsets("msl", station, heights).tolist() == [0.0]
    assert ground_offsets("ellipsoid", station, heights) == pytest.approx([-48.0])
    assert ground_offsets("relative", station, heights).tolist() == [430.0]
    with pytest.raises(MissionError, match="take-off"):
        ground_offsets("relative", station, HeightSystem())
    with pytest.raises(MissionError, match="undulation"):
        ground_offsets("ellipsoid", one_station(), HeightSystem())


def test_images_without_an_exposure_get_a_row() -> None:
    ledger = Ledger()
    joined = ledger.take(append_unmatched_images(one_station(), ("image_0", "stray")))
    assert joined.image.tolist() == ["image_0", "stray"]
    assert joined.status.tolist() == ["ok", "unmatched"]
    assert ledger.has_losses


def test_local_positions_get_a_place() -> None:
    pose = channel("/pose", [0.0, 1.0], east_m=[0, 100], north_m=[0, 200], up_m=[0, 10])
    placed = to_geodetic(pose, GeodeticOrigin(LATITUDE, LONGITUDE, 500.0))
    to_ecef = pyproj.Transformer.from_crs(4979, 4978)
    a, b = np.transpose(
        to_ecef.transform(
            np.degrees(placed["lat_rad"]), np.degrees(placed["lon_rad"]), placed["h_ellipsoid_m"]
        )
    )
    assert np.linalg.norm(b - a) == pytest.approx(np.sqrt(100**2 + 200**2 + 10**2), abs=1e-6)
    assert placed["h_ellipsoid_m"][0] == pytest.approx(500.0, abs=1e-6)


def shots(index: list[int], boot: list[int] | None = None) -> Channel:
    found = channel("CAM[0]", np.arange(len(index)), event_index=index)
    return replace(found, boot=np.array(boot or [0] * len(index), np.int16))


@pytest.mark.parametrize(
    ("index", "lost"),
    [
        ([65533, 65534, 65535, 0, 1, 2], 0),
        ([65533, 65535, 1, 2], 2),  # 65534 and 0
        ([65534, 0, 65535, 1], 0),  # one was told late
        ([100, 101, 40_000, 40_001], 39_898),
        ([40_000, 40_001, 0, 1], 39_998),  # begun anew: no overrun, and 2 to 39,999 never were
    ],
)
def test_an_image_number_that_runs_over(index: list[int], lost: int) -> None:
    ledger = Ledger()
    ledger.take(events_of_channel(shots(index), "cam", "{index}.jpg", ExposureDelay(0.0)))
    assert sum(entry.count for entry in ledger) == lost


def test_a_number_lost_over_the_turn_is_named_as_the_log_would() -> None:
    ledger = Ledger()
    ledger.take(
        events_of_channel(shots([65534, 65535, 2]), "cam", "{index}.jpg", ExposureDelay(0.0))
    )
    (entry,) = ledger
    assert (entry.code, entry.count) == ("EVENTS-LOST", 2)
    assert "between 65534 and 2" in entry.what
    assert "0 to 1" in entry.what


def test_numbers_begin_anew_with_each_boot() -> None:
    ledger = Ledger()
    found = shots([0, 1, 2, 7, 8, 9], [0, 0, 0, 1, 1, 1])
    ledger.take(events_of_channel(found, "cam", "{n}.jpg", ExposureDelay(0.0)))
    assert not list(ledger)
    begun_anew = shots([3, 4, 0, 1], [0, 0, 1, 1])
    assert events_of_channel(begun_anew, "cam", "{n}.jpg", ExposureDelay(0.0))[0].index is None


def test_camera_rows_without_triggers_are_the_triggers() -> None:
    camera = shots([0, 1, 2])
    trigger = channel("TRIG[0]", [0, 1, 2], event_index=[0, 1, 2])
    for channels, chosen, told in (
        ((camera,), camera, True),
        ((camera, trigger), camera, False),
        ((camera, trigger), trigger, True),
    ):
        ledger = Ledger()
        ledger.extend(trigger_notes(channels, chosen, {}))
        assert [entry.code for entry in ledger] == ["EVENTS-TRIGGER-TIME"] * told
        assert all(entry.kind == "note" and "delay_s" in entry.what for entry in ledger)


def test_two_heights_that_are_one_are_told() -> None:
    heights = 600.0 + np.arange(5.0)
    place = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE, "h_msl_m": heights}
    for apart, told in ((0.0, True), (0.001, False)):
        ledger = Ledger()
        gnss = channel("GPS", np.arange(5.0), **place, h_ellipsoid_m=heights + apart)
        ledger.take(height_system({"height": gnss}, None if apart else 48.0))
        assert ("HEIGHT-SAME" in {entry.code for entry in ledger}) is told
        assert not told or "the undulation of 48.0 m" in next(iter(ledger)).what


def test_each_sigma_is_its_own_channels() -> None:
    """Horizontal from the position, vertical from the height, the cabin's air from its sensors."""
    seconds = np.arange(0.0, 10.0, 0.1)
    place = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE}
    more = {
        "position": channel("POS", seconds, **place, sigma_h_m=0.3, sigma_v_m=0.4),
        "height": channel("GPS", seconds, **place, h_msl_m=1000.0, sigma_h_m=0.5, sigma_v_m=0.6),
        "pressure": channel("BARO[0]", seconds, pressure_pa=90_000.0),
        "temperature": channel("HYGR[0]", seconds, temperature_k=283.15),
        "humidity": channel("HYGR[0]", seconds, relative_humidity=0.5),
        "cabin_pressure": channel("BARO[1]", seconds, pressure_pa=80_000.0),
        "cabin_temperature": channel("HYGR[1]", seconds, temperature_k=293.15),
        "cabin_humidity": channel("HYGR[1]", seconds, relative_humidity=1.1),  # clipped to 1
    }
    station = build_stations(events(5.0), roles() | more, Mount(), HeightSystem(), 1.0)
    assert (station.sigma_horizontal_m[0], station.sigma_height_m[0]) == pytest.approx((0.3, 0.6))
    assert station.pressure_pa[0] == pytest.approx(90_000.0)
    assert station.cabin_pressure_pa[0] == pytest.approx(80_000.0)
    # Saturation pressure 12.28 hPa at 10 and 23.39 hPa at 20 degC, some 0.4 % more in air.
    assert station.vapour_pressure_pa[0] == pytest.approx(0.5 * 1228.0, rel=0.006)
    assert station.cabin_vapour_pressure_pa[0] == pytest.approx(2339.0, rel=0.006)


@pytest.mark.parametrize(
    ("clocks", "horizontal_m", "height_m"),
    [
        (ClockSigmas(0.0, 0.0, 0.0), 0.3, 0.6),
        # At 40 m/s 0.1 s are 4 m along the track: half of the variance counts on either level axis.
        (ClockSigmas(0.1, 0.0, 0.0), float(np.hypot(0.3, 4.0 / np.sqrt(2.0))), 0.6),
        # At a climb of 3 m/s 0.2 s are 0.6 m.
        (ClockSigmas(0.0, 0.2, 0.0), 0.3, float(np.hypot(0.6, 0.6))),
    ],
    ids=["one clock", "another clock of the positions", "another clock of the heights"],
)
def test_an_uncertain_clock_moves_the_stations_along_the_flight(
    clocks: ClockSigmas, horizontal_m: float, height_m: float
) -> None:
    seconds = np.arange(0.0, 10.0, 0.1)
    meridian_m = 6_367_000.0  # radius of curvature at 47 degrees, to 0.1 %
    place = {"lat_rad": LATITUDE + 40.0 * seconds / meridian_m, "lon_rad": LONGITUDE}
    climbing_m = 1000.0 + 3.0 * seconds
    flown = roles() | {
        "position": channel("POS", seconds, **place, sigma_h_m=0.3, sigma_v_m=0.4),
        "height": channel(
            "GPS", seconds, **place, h_msl_m=climbing_m, sigma_h_m=0.5, sigma_v_m=0.6
        ),
    }
    station = build_stations(events(5.0), flown, Mount(), HeightSystem(), 1.0, clocks=clocks)
    assert station.sigma_horizontal_m[0] == pytest.approx(horizontal_m, rel=0.01)
    assert station.sigma_height_m[0] == pytest.approx(height_m, rel=0.01)
