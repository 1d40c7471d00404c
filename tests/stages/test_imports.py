"""Trajectories and camera events from elsewhere: what becomes of the stations.

Truth is that of the simulated flight; the files are written here from it, as other programs do.
"""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow.parquet as pq
import pytest

from unbend.batch.runs import read_mission
from unbend.errors import ConfigError, MissionError
from unbend.flight.channels import Channel, Source
from unbend.messages import Ledger
from unbend.simulate.flight import UNDULATION_M, fly
from unbend.stages.flight_log import with_trajectory

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
NEAR_M = 0.15  # events are 1.6 ms off by the clock of the log, at 70 m/s
LEVER = {"nadir": [0.35, 0.1, 0.6], "oblique": [0.2, 0.28, 0.55]}


@pytest.fixture(scope="session")
def truth(flown):
    """Camera stations by image, and the flight as a function of time."""
    stations = pq.read_table(flown.truth / "stations.parquet").to_pandas().set_index("image")
    return stations, fly(2500.0, 1, 3)


def start_utc(truth) -> datetime:
    stations, flight = truth
    first = stations["time_utc"].min().to_pydatetime(False)
    return first - timedelta(seconds=float(flight.exposure_s.min()))


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


class Files:
    """Files of the true flight, as other programs write them, beside the mission."""

    def __init__(self, mission, truth):
        self.folder, (self.stations, self.flight) = mission.folder, truth
        self.start = start_utc(truth)
        self.t = np.arange(1.0, self.flight.duration_s - 1.0, 0.2)

    def tow(self, t) -> tuple[int, np.ndarray]:
        since = (self.start - GPS_EPOCH).total_seconds() + 18.0
        return int(since // 604_800), since % 604_800 + t

    def state(self, t=None):
        return self.flight.at(self.t if t is None else t)

    def pos(self, *, late_s=0.0, system="GPST", keep=None, quality=None, shift_m=0.0, up_m=0.0):
        state = self.state()
        lead = 18.0 if system == "GPST" else 0.0
        rows = []
        for k in range(self.t.size) if keep is None else np.flatnonzero(keep):
            at = self.start + timedelta(seconds=float(self.t[k]) + lead + late_s)
            lat = np.degrees(state.lat_rad[k]) + shift_m / 111_195.0
            height = state.h_msl_m[k] + UNDULATION_M + up_m
            q = 1 if quality is None else quality[k]
            rows.append(
                f"{at:%Y/%m/%d %H:%M:%S.%f} {lat:.9f} {np.degrees(state.lon_rad[k]):.9f} "
                f"{height:.4f} {q} 12 0.0110 0.0070 0.0210 0 0 0 0.0 9.9"
            )
        head = (
            "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,5:single,ns=# of satellites)\n"
            f"%  {system} latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) "
            "sdeu(m) sdun(m) age(s) ratio\n"
        )
        (self.folder / "flight.pos").write_text(head + "\n".join(rows) + "\n")
        return {"path": "flight.pos", "point": "imu"}

    def sbet(self, *, wander=0.03, yaw_deg=0.0):
        s = self.state()
        _, tow = self.tow(self.t)
        later = self.state(self.t + 0.01)
        before = self.state(self.t - 0.01)
        north = (later.lat_rad - before.lat_rad) / 0.02 * 6.375e6
        east = (later.lon_rad - before.lon_rad) / 0.02 * 6.39e6 * np.cos(s.lat_rad)
        ground = (north - 1j * east) * np.exp(-1j * wander)
        zero = np.zeros_like(tow)
        rows = np.column_stack(
            [
                tow,
                s.lat_rad,
                s.lon_rad,
                s.h_msl_m + UNDULATION_M,
                ground.real,
                ground.imag,
                zero,
                s.roll_rad,
                s.pitch_rad,
                wrapped(s.yaw_rad + wander + np.radians(yaw_deg)),
                zero + wander,
                *[zero] * 6,
            ]
        )
        (self.folder / "sbet.out").write_bytes(rows.astype("<f8").tobytes())
        return {
            "path": "sbet.out",
            "point": "imu",
            "heights": "ellipsoid",
            "time": {"system": "gpst"},
        }

    def mrk(self, camera="nadir", *, offset_mm=(0, 0, 0), drop=0):
        rows = self.stations[self.stations["camera"] == camera].sort_values("time_utc")
        lines = []
        for k, (_, row) in enumerate(rows.iterrows(), start=1):
            at = row["time_utc"].to_pydatetime(False)
            since = (at - GPS_EPOCH).total_seconds() + 18.0
            n, e, v = offset_mm
            lines.append(
                f"{k}\t{since % 604_800:.6f}\t[{int(since // 604_800)}]\t{n},N\t{e},E\t{v},V\t"
                f"{row['lat_deg']:.9f},Lat\t{row['lon_deg']:.9f},Lon\t{row['h_ellipsoid_m']:.4f},"
                "Ellh\t0.012, 0.016, 0.031\t50,Q\n"
            )
        (self.folder / f"{camera}.MRK").write_text("".join(lines[drop:]))
        return rows.index.tolist()


@pytest.fixture
def files(mission, truth):
    return Files(mission, truth)


def prepare(mission, **stations):
    mission.config["stations"] = stations
    return read_mission(mission.save())


def errors(prepared, truth) -> tuple[float, float, float]:
    """Largest errors of stations that are ok: horizontal, height [m], attitude [deg]."""
    stations = prepared.stations
    true = truth[0].loc[prepared.stations.image.tolist()]
    ok = stations.ok
    assert ok.any()
    north = (stations.lat_rad - np.radians(true["lat_deg"].to_numpy()))[ok] * 6.37e6
    east = (stations.lon_rad - np.radians(true["lon_deg"].to_numpy()))[ok] * 4.32e6
    up = (stations.h_ellipsoid_m - true["h_ellipsoid_m"].to_numpy())[ok]
    q = true[["q_w", "q_x", "q_y", "q_z"]].to_numpy()[ok]
    cosine = np.abs((q * stations.quaternion[ok]).sum(axis=1)).clip(0.0, 1.0)
    return (
        float(np.hypot(north, east).max()),
        float(np.abs(up).max()),
        float(np.degrees(2.0 * np.arccos(cosine)).max()),
    )


def entries(prepared, code):
    return [entry for entry in prepared.ledger if entry.code == code]


def test_a_trajectory_replaces_the_positions_of_the_log(mission, files, truth):
    """Of a trajectory 3 m north of the true one and 2 m above, the stations are too."""
    before = errors(prepare(mission), truth)
    prepared = prepare(mission, trajectory=files.pos(shift_m=3.0, up_m=2.0))
    place, height, attitude = errors(prepared, truth)
    assert place == pytest.approx(3.0, abs=NEAR_M)
    assert height == pytest.approx(2.0, abs=0.05)
    assert attitude == pytest.approx(before[2], abs=0.02)
    assert prepared.flight.roles["position"].name == "flight.pos"
    assert prepared.flight.air_roles["height"].name != "flight.pos"
    # The exposures are on the clock of the log, whose UTC is good to 15 ms, at 49.5 m/s.
    sigma_m = np.hypot(0.0092, 0.015 * 49.5)
    assert prepared.stations.sigma_horizontal_m[0] == pytest.approx(sigma_m, rel=0.01)
    (told,) = entries(prepared, "TRAJECTORY-REPLACES")
    assert "position of GPS" in told.what or "position of" in told.what
    (agrees,) = entries(prepared, "TRAJECTORY-AGREES")
    assert agrees.kind == "note"


def test_an_sbet_replaces_all_and_its_week_is_that_of_the_log(mission, files, truth):
    place, height, attitude = errors(prepare(mission, trajectory=files.sbet()), truth)
    assert place < NEAR_M
    assert height < 0.05
    assert attitude < 0.02


@pytest.mark.parametrize(("own", "told"), [([], "position, height"), (["height"], "position")])
def test_heights_of_the_trajectory_are_named_where_the_log_has_none(own, told):
    """Positions alone are to be replaced: heights come along only where the log has none."""
    time_ns = np.arange(10) * 10**9
    columns = {"lat_rad": np.full(10, 0.8), "lon_rad": np.full(10, 0.1), "h_msl_m": np.ones(10)}
    trajectory = Channel("flight.pos", time_ns, columns, Source("RTKLIB"))
    of_log = {role: Channel("GPS", time_ns, columns, Source("GPS")) for role in own}
    ledger = Ledger()
    roles = with_trajectory(of_log, trajectory, ("position",), ledger)
    assert roles["position"].name == "flight.pos"
    assert roles["height"].name == ("GPS" if own else "flight.pos")
    (entry,) = ledger
    assert entry.what == f"flight.pos gives {told}, which the log does not have"


def test_attitude_alone_leaves_the_positions_of_the_log(mission, files, truth):
    before = errors(prepare(mission), truth)
    prepared = prepare(mission, trajectory=files.sbet() | {"replaces": ["attitude"]})
    place, height, attitude = errors(prepared, truth)
    assert place == pytest.approx(before[0], abs=0.01)
    assert height == pytest.approx(before[1], abs=0.05)
    assert attitude < 0.02
    assert prepared.flight.roles["position"].name != "sbet.out"


def test_the_lever_arm_of_the_trajectory_adds_to_that_of_the_mount(mission, files, truth):
    """The mounts say where the cameras are from a point 2 m behind the trajectory's."""
    for camera, (forward, right, down) in LEVER.items():
        mission.config["mount"][camera]["lever_arm_m"] = [forward + 2.0, right, down]
    prepared = prepare(mission, trajectory=files.sbet() | {"lever_arm_m": [-2.0, 0.0, 0.0]})
    assert errors(prepared, truth)[0] < NEAR_M
    wrong = prepare(mission, trajectory=files.sbet() | {"lever_arm_m": [2.0, 0.0, 0.0]})
    assert errors(wrong, truth)[0] == pytest.approx(4.0, abs=NEAR_M)


def test_a_gap_of_the_trajectory_is_no_station_though_the_log_has_one(mission, files, truth):
    exposed = np.sort(files.flight.exposure_s)[1]
    keep = np.abs(files.t - exposed) > 5.0
    prepared = prepare(mission, trajectory=files.pos(keep=keep))
    status = prepared.stations.status.tolist()
    assert status.count("in_gap") == 2
    assert status.count("ok") == len(status) - 2
    assert prepared.ledger.has_losses


def test_single_fixes_make_the_sigma_of_their_stations(mission, files):
    exposed = np.sort(files.flight.exposure_s)[1]
    quality = np.where(np.abs(files.t - exposed) < 3.0, 5, 1)
    prepared = prepare(mission, trajectory=files.pos(quality=quality))
    sigma = prepared.stations.sigma_horizontal_m
    assert (sigma > 2.0).sum() == 2
    # The others have what 15 ms of the clock are at 49.5 m/s.
    assert (sigma < 0.75).sum() == sigma.size - 2
    assert entries(prepared, "TRAJECTORY-SINGLE")[0].kind == "warning"


@pytest.mark.parametrize(
    ("how", "code", "words"),
    [
        ({"late_s": 18.0}, "TRAJECTORY-TIME", "18.0"),
        ({"late_s": -18.0}, "TRAJECTORY-TIME", "early"),
        ({"late_s": 7200.0}, "TRAJECTORY-TIME", "time zone"),
        ({"late_s": 86_400.0}, "TRAJECTORY-OVERLAP", "covers"),
        ({"shift_m": 5_000.0}, "TRAJECTORY-PLACE", "4999 m"),
        ({"up_m": -UNDULATION_M}, "TRAJECTORY-HEIGHT", "msl"),
    ],
)
def test_a_trajectory_that_cannot_be_of_the_flight_is_refused(mission, files, how, code, words):
    with pytest.raises(MissionError) as caught:
        prepare(mission, trajectory=files.pos(**how))
    assert caught.value.code == code
    assert words in caught.value.what
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("how", "code", "kind"),
    [
        ({"shift_m": 10.0}, "TRAJECTORY-AGREES", "warning"),
        ({"shift_m": 50.0}, "TRAJECTORY-AGREES", "loss"),
        ({"up_m": 15.0}, "TRAJECTORY-HEIGHT-AGREES", "warning"),
        ({"late_s": 0.2}, "TRAJECTORY-AGREES", "warning"),
    ],
)
def test_what_differs_more_than_autopilots_err_is_told(mission, files, how, code, kind):
    assert entries(prepare(mission, trajectory=files.pos(**how)), code)[0].kind == kind


def test_the_yaw_of_an_sbet_against_the_log(mission, files):
    prepared = prepare(mission, trajectory=files.sbet(yaw_deg=15.0))
    assert entries(prepared, "TRAJECTORY-ANGLES-AGREE")[0].kind == "warning"
    told = entries(prepared, "TRAJECTORY-ANGLES-AGREE")[0].what
    tilt, yaw = (float(number) for number in re.findall(r"([-+]?[0-9.]+) deg", told))
    assert tilt < 0.5
    assert yaw == pytest.approx(15.0, abs=1.0)


def csv_of(files, columns) -> dict:
    """A CSV of the flight with columns made by functions of its state."""
    state = files.state()
    time = [f"{files.start + timedelta(seconds=float(t)):%Y-%m-%dT%H:%M:%S.%fZ}" for t in files.t]
    values = [function(state) for function in columns.values()]
    rows = [",".join([time[k], *(f"{v[k]:.9f}" for v in values)]) for k in range(len(time))]
    (files.folder / "t.csv").write_text("\n".join([",".join(["time", *columns]), *rows]) + "\n")
    return {
        "path": "t.csv",
        "point": "imu",
        "heights": "msl",
        "time": {"system": "utc"},
        "columns": {name: name for name in ("time", *columns)},
    }


PLACE = {
    "latitude": lambda s: np.degrees(s.lat_rad),
    "longitude": lambda s: np.degrees(s.lon_rad),
    "height": lambda s: s.h_msl_m,
}


def angles(factor=1.0, **changed):
    plain = {
        f"{n}": (lambda s, n=n: np.degrees(getattr(s, f"{n}_rad")) * factor)
        for n in ("roll", "pitch")
    }
    plain["yaw"] = lambda s: np.degrees(s.yaw_rad) % 360.0 * factor
    return PLACE | plain | changed


def test_a_csv_of_heights_above_the_sea_and_angles(mission, files, truth):
    place, height, attitude = errors(prepare(mission, trajectory=csv_of(files, angles())), truth)
    assert place < NEAR_M
    assert height < 0.05
    assert attitude < 0.02


@pytest.mark.parametrize(
    ("columns", "code", "words"),
    [
        (
            PLACE | {"latitude": PLACE["longitude"], "longitude": PLACE["latitude"]},
            "TRAJECTORY-PLACE",
            "exchanged",
        ),
        (
            PLACE | {"latitude": lambda s: s.lat_rad, "longitude": lambda s: s.lon_rad},
            "TRAJECTORY-PLACE",
            "radians",
        ),
        (PLACE | {"longitude": lambda s: -np.degrees(s.lon_rad)}, "TRAJECTORY-PLACE", "sign"),
        (angles(yaw=lambda s: np.degrees(wrapped(-s.yaw_rad))), "TRAJECTORY-ANGLES", "yaw"),
        (angles(np.pi / 180.0), "TRAJECTORY-ANGLES", "radians"),
        (
            angles(yaw=lambda s: np.degrees(wrapped(np.pi / 2 - s.yaw_rad))),
            "TRAJECTORY-ANGLES",
            "east to north",
        ),
    ],
)
def test_mistakes_about_columns_are_recognised(mission, files, columns, code, words):
    with pytest.raises(MissionError) as caught:
        prepare(mission, trajectory=csv_of(files, columns))
    assert caught.value.code == code
    assert words in caught.value.what


def test_grads_that_do_not_pass_the_circle_are_recognised_by_the_log(mission, files):
    """As a file of a flight to the south has them: all below 360."""
    section = csv_of(files, angles(1.0 / 0.9))
    text = (files.folder / "t.csv").read_text().splitlines()
    below = [line for line in text if line.startswith("time") or float(line.split(",")[-1]) < 360]
    (files.folder / "t.csv").write_text("\n".join(below) + "\n")
    with pytest.raises(MissionError, match="grads") as caught:
        prepare(mission, trajectory=section)
    assert caught.value.code == "TRAJECTORY-ANGLES"
    prepare(mission, trajectory=csv_of(files, angles(1.0 / 0.9)) | {"angle_unit": "grad"})


def test_what_a_file_lacks_cannot_be_replaced(mission, files):
    with pytest.raises(MissionError) as caught:
        prepare(mission, trajectory=files.pos() | {"replaces": ["attitude"]})
    assert caught.value.code == "TRAJECTORY-REPLACES"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"point": "camera"}, "one camera"),
        ({"point": "imu", "lever_arm_m": "from_events"}, "antenna"),
        ({"point": "antenna", "lever_arm_m": "from_events"}, "events.positions"),
        ({"replaces": ["position"], "lever_arm_m": [1.0, 0.0, 0.0]}, "both position and height"),
        ({"columns": {"latitude": "lat"}}, "latitude, longitude, height"),
        ({"angle_order": "ZYZ"}, "angle_order"),
    ],
)
def test_sections_that_contradict_themselves_are_refused(mission, files, changed, words):
    with pytest.raises(ConfigError) as caught:
        prepare(mission, trajectory=files.pos() | changed)
    assert words in str(caught.value)


def test_inputs_are_hashed_and_stand_in_the_manifest(mission, files, plain_report):
    mission.config["stations"] = {"trajectory": files.pos()}
    ended = mission.run()
    assert ended.code == 0, ended.text
    manifest = json.loads((mission.output / "manifest.json").read_text())
    assert {item["role"] for item in manifest["inputs"]} >= {"trajectory"}
    assert manifest["channels"]["position"] == "flight.pos"
    before = manifest["fingerprint"]
    files.pos(up_m=0.5)
    assert mission.run().code == 0
    assert json.loads((mission.output / "manifest.json").read_text())["fingerprint"] != before


# Camera events with positions


def with_events(mission, files, **changed):
    for camera in ("nadir", "oblique"):
        files.mrk(camera)
    mission.config["events"] = {
        "positions": {
            camera: {"path": f"{camera}.MRK", "image": f"{camera}_{{index:05d}}"} | changed
            for camera in ("nadir", "oblique")
        }
    }


def named_like(prepared, truth):
    """Truth of the stations of the nadir camera, in the order of time."""
    stations = prepared.stations
    rows = np.flatnonzero((stations.camera == "nadir") & stations.ok)
    true = truth[0][truth[0]["camera"] == "nadir"].sort_values("time_utc")
    return stations, rows, true


def offsets(prepared, truth) -> np.ndarray:
    """North, east, up [m] of the stations of the nadir camera from the truth."""
    stations, rows, true = named_like(prepared, truth)
    return np.stack(
        [
            (stations.lat_rad[rows] - np.radians(true["lat_deg"].to_numpy())) * 6.37e6,
            (stations.lon_rad[rows] - np.radians(true["lon_deg"].to_numpy())) * 4.32e6,
            stations.h_ellipsoid_m[rows] - true["h_ellipsoid_m"].to_numpy(),
        ],
        axis=1,
    )


def test_positions_of_an_mrk_are_those_of_the_camera(mission, files, truth):
    with_events(mission, files)
    prepared = prepare(mission)
    assert np.abs(offsets(prepared, truth)).max() < 0.002
    told = [entry.what for entry in entries(prepared, "EVENTS-POSITIONS")]
    assert (
        "nadir.MRK has the times of the exposures of nadir, and the positions of the camera" in told
    )
    assert prepared.stations.image[prepared.stations.ok][0] == "nadir_00001"


def test_events_of_rtklib_are_of_the_antenna_from_which_the_mount_counts(mission, files, truth):
    files.t = np.sort(files.flight.exposure_s)
    files.pos()
    mission.config["events"] = {
        "positions": {
            camera: {"path": "flight.pos", "image": f"{camera}_{{index:05d}}"} for camera in LEVER
        }
    }
    place, height, _ = errors(prepare(mission), truth)
    assert place < 0.01
    assert height < 0.01


def test_an_antenna_is_moved_to_the_camera_by_the_offsets_of_the_mrk(mission, files, truth):
    with_events(mission, files, point="antenna")
    files.mrk("nadir", offset_mm=(1500, -700, 300))
    moved = offsets(prepare(mission), truth)
    assert moved == pytest.approx(np.tile([1.5, -0.7, -0.3], (moved.shape[0], 1)), abs=0.01)


def test_ppk_of_the_antenna_with_times_and_offsets_of_the_mrk(mission, files, truth):
    """The trajectory is that of the mounts' point: the offsets replace their lever arm."""
    with_events(mission, files, times_only=True)
    files.mrk("nadir", offset_mm=(1500, -700, 300))
    plain = files.pos() | {"point": "antenna"}
    moved = offsets(prepare(mission, trajectory=plain | {"lever_arm_m": "from_events"}), truth)
    rest = offsets(prepare(mission, trajectory=plain), truth)
    assert np.abs(rest).max() < NEAR_M
    lever = np.abs(moved - [1.5, -0.7, -0.3])
    assert lever.max() < 0.9  # the lever arm of the mount is 0.7 m long, and not added
    assert lever.max() > 0.3


def test_positions_twice_are_refused_and_offsets_must_be_there(mission, files):
    with_events(mission, files)
    with pytest.raises(ConfigError, match="times_only"):
        prepare(mission, trajectory=files.pos())
    files.pos()
    mission.config["events"]["positions"] = {
        camera: {"path": "flight.pos", "image": f"{camera}_{{n}}.tif", "times_only": True}
        for camera in ("nadir", "oblique")
    }
    section = files.pos() | {"point": "antenna", "lever_arm_m": "from_events"}
    with pytest.raises(MissionError) as caught:
        prepare(mission, trajectory=section)
    assert caught.value.code == "EVENTS-OFFSETS"


def test_images_by_name_need_a_file_with_names(mission, files):
    with_events(mission, files, image="{name}")
    with pytest.raises(MissionError) as caught:
        prepare(mission)
    assert caught.value.code == "EVENTS-NAMELESS"


def with_a_lost_number(mission, files, pattern):
    """The second of three images of the nadir camera is not in its file."""
    with_events(mission, files)
    sources = mission.config["events"]["positions"]
    for camera in sources:
        sources[camera]["image"] = f"{camera}_{{index:05d}}"
    sources["nadir"]["image"] = pattern
    lines = (files.folder / "nadir.MRK").read_text().splitlines(keepends=True)
    (files.folder / "nadir.MRK").write_text("".join(lines[:1] + lines[2:]))
    return prepare(mission)


def test_lost_numbers_of_an_mrk_never_shift_images(mission, files, truth):
    prepared = with_a_lost_number(mission, files, "nadir_{index:05d}")
    assert entries(prepared, "EVENTS-LOST")[0].kind == "loss"
    assert entries(prepared, "IMAGES-UNMATCHED")[0].count == 1
    assert errors(prepared, truth)[0] < 0.002
    assert "nadir_00002" not in prepared.stations.image[prepared.stations.ok]


def test_counted_images_are_not_shifted_by_a_lost_number(mission, files):
    with pytest.raises(MissionError) as caught:
        with_a_lost_number(mission, files, "nadir_{n:05d}")
    assert caught.value.code == "EVENTS-AMBIGUOUS"
    assert "some events were lost" in caught.value.what


@pytest.mark.parametrize("kind", ["pos", "mrk"])
def test_rows_counted_anew_after_a_loss_are_no_numbers_of_images(mission, files, kind):
    """The second of three exposures of the nadir camera has no row, and nothing shows where."""
    with_events(mission, files)
    sources = mission.config["events"]["positions"]
    for camera in sources:
        sources[camera]["image"] = f"{camera}_{{index:05d}}"
    lines = (files.folder / "nadir.MRK").read_text().splitlines(keepends=True)
    kept = [*lines[:1], *lines[2:]]
    anew = [f"{k}\t" + line.split("\t", 1)[1] for k, line in enumerate(kept, start=1)]
    (files.folder / "nadir.MRK").write_text("".join(anew))
    if kind == "pos":
        times = np.array([float(line.split("\t")[1]) for line in kept])
        files.t = times - files.tow(0.0)[1]
        files.pos()
        sources["nadir"] |= {"path": "flight.pos"}
    with pytest.raises(MissionError) as caught:
        prepare(mission)
    assert caught.value.code == "EVENTS-AMBIGUOUS"
    assert "some events were lost" in caught.value.what


def test_rows_against_the_order_of_time_are_refused_or_told(mission, files):
    with_events(mission, files)
    sources = mission.config["events"]["positions"]
    for camera in sources:
        sources[camera]["image"] = f"{camera}_{{index:05d}}"
    lines = (files.folder / "nadir.MRK").read_text().splitlines(keepends=True)
    numbers = [line.split("\t", 1)[0] for line in lines][::-1]
    turned = [f"{n}\t" + line.split("\t", 1)[1] for n, line in zip(numbers, lines, strict=True)]
    (files.folder / "nadir.MRK").write_text("".join(turned))
    with pytest.raises(MissionError) as caught:
        prepare(mission)
    assert caught.value.code == "EVENTS-ORDER"
    sources["nadir"]["image"] = "nadir_{n:05d}"
    assert entries(prepare(mission), "EVENTS-ORDER")[0].kind == "warning"


def test_a_stretch_of_a_trajectory_that_is_off_makes_its_stations_suspect(mission, files):
    exposed = np.sort(files.flight.exposure_s)[1]
    section = files.pos()
    lines = (files.folder / "flight.pos").read_text().splitlines()
    head = lines[:2]
    rows = [line.split(" ") for line in lines[2:]]
    for k in np.flatnonzero(np.abs(files.t - exposed) < 4.0):
        rows[k][2] = f"{float(rows[k][2]) + 40.0 / 111_195.0:.9f}"
    text = [*head, *(" ".join(row) for row in rows)]
    (files.folder / "flight.pos").write_text("\n".join(text) + "\n")
    prepared = prepare(mission, trajectory=section)
    suspect = prepared.stations.status == "suspect"
    assert suspect.sum() == 2
    assert prepared.stations.suspect_m[suspect] == pytest.approx(40.0, abs=2.0)
    assert entries(prepared, "STATIONS-SUSPECT")[0].kind == "loss"


@pytest.mark.parametrize("order", ["XYZ", "YXZ"])
def test_another_order_of_the_angles_is_recognised(mission, files, order):
    """The file has rotations about z, y and x in this order."""
    section = csv_of(files, angles())
    with pytest.raises(MissionError) as caught:
        prepare(mission, trajectory=section | {"angle_order": order})
    assert caught.value.code == "TRAJECTORY-ANGLES"
    assert caught.value.remedy == "state angle_order: ZYX"
