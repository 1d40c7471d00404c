"""Two vehicles in one log, and several receivers of one vehicle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.vehicles import Vehicles
from unbend.messages import Ledger
from unbend.stages.vehicle import channels_of_one_vehicle

SECONDS = np.arange(0.0, 100.0)
TIME_NS = (SECONDS * 1e9).astype(np.int64)
EARTH_M = 6_371_000.0


def channel(name: str, *roles: str, system: int | None = None, north_m: float = 0.0) -> Channel:
    columns = {"event_index": SECONDS} if "events" in roles else {}
    if "position" in roles:
        columns = {
            "lat_rad": 0.8 + north_m / EARTH_M + 0.0 * SECONDS,
            "lon_rad": 0.1 + SECONDS / 1e6,
        }
    message = name.partition("@")[0].strip("/")
    return Channel(name, TIME_NS, columns, Source(message, None, system, 1), roles=roles)


def sent_by(system: int) -> tuple[Channel, ...]:
    of_sender = f"@{system}/1"
    return (
        channel(f"CAMERA_FEEDBACK[0]{of_sender}", "events", system=system),
        channel(f"GLOBAL_POSITION_INT{of_sender}", "position", system=system),
        channel(f"ATTITUDE{of_sender}", "attitude", system=system),
    )


SENSOR = channel("HYGROMETER_SENSOR[0]", "temperature", system=51)
TWO = (*sent_by(1), *sent_by(2), SENSOR)


def topics(namespace: str, north_m: float) -> tuple[Channel, ...]:
    return (
        channel(f"{namespace}/fix", "position", "height", north_m=north_m),
        channel(f"{namespace}/imu", "attitude"),
    )


@pytest.mark.parametrize(
    ("channels", "names"),
    [
        (sent_by(1), ()),
        (TWO, ("system 1", "system 2")),
        # one of them has no fix: its attitude is still its own
        (sent_by(1) + sent_by(2)[::2], ("system 1", "system 2")),
        # names of topics are of vehicles if these are apart, and of sensors if they are together
        (topics("/uav1", 0.0) + topics("/uav2", 60.0), ("/uav1", "/uav2")),
        (topics("/novatel", 0.0) + topics("/xsens", 1.5), ()),
        (topics("/fleet/uav1", 0.0) + topics("/fleet/uav2", 60.0), ("/fleet/uav1", "/fleet/uav2")),
        (topics("", 0.0) + topics("/base", 900.0), ("/", "/base")),
        # two receivers that both have no namespace of their own
        ((channel("/fix", "position"), channel("/gps", "position", north_m=60.0)), ()),
    ],
)
def test_which_senders_are_vehicles(channels: tuple[Channel, ...], names: tuple[str, ...]) -> None:
    assert Vehicles.of(channels).names == names


def mission(*event_channels: str) -> SimpleNamespace:
    sources = {f"cam{k}": SimpleNamespace(channel=name) for k, name in enumerate(event_channels)}
    events = SimpleNamespace(log=sources) if event_channels else None
    return SimpleNamespace(events=events, mount={})


def test_the_roles_are_of_the_vehicle_whose_events_are_used() -> None:
    ledger = Ledger()
    chosen = channels_of_one_vehicle(mission("CAMERA_FEEDBACK[0]@2/1"), TWO, {}, ledger)
    assert [c.name for c in chosen] == [*(c.name for c in sent_by(2)), SENSOR.name]
    assert [(entry.code, entry.kind) for entry in ledger] == [("LOG-VEHICLES", "note")]


def test_a_vehicle_without_a_fix_lends_its_attitude_to_no_other() -> None:
    without_fix = (sent_by(1)[0], sent_by(1)[2])
    channels = (*without_fix, *sent_by(2))
    chosen = channels_of_one_vehicle(mission("CAMERA_FEEDBACK[0]@2/1"), channels, {}, Ledger())
    assert [c.name for c in chosen] == [c.name for c in sent_by(2)]
    chosen = channels_of_one_vehicle(mission("CAMERA_FEEDBACK[0]@1/1"), channels, {}, Ledger())
    assert [c.name for c in chosen] == [c.name for c in without_fix]


def test_without_events_it_is_the_vehicle_of_the_named_channels() -> None:
    named = {"position": "GLOBAL_POSITION_INT@1/1"}
    chosen = channels_of_one_vehicle(mission(), TWO, named, Ledger())
    assert [c.name for c in chosen] == [*(c.name for c in sent_by(1)), SENSOR.name]


@pytest.mark.parametrize(
    "events", [(), ("CAMERA_FEEDBACK[0]@1/1", "CAMERA_FEEDBACK[0]@2/1")], ids=["none", "of both"]
)
def test_a_vehicle_that_nothing_names_is_refused_with_the_choices(events: tuple[str, ...]) -> None:
    with pytest.raises(MissionError) as caught:
        channels_of_one_vehicle(mission(*events), TWO, {}, Ledger())
    assert caught.value.code == "LOG-VEHICLES"
    for choice in ("system 1", "system 2", "GLOBAL_POSITION_INT@1/1", "CAMERA_FEEDBACK[0]@2/1"):
        assert choice in caught.value.what


def test_a_named_channel_of_another_vehicle_is_used_and_a_finding() -> None:
    ledger = Ledger()
    named = {"position": "GLOBAL_POSITION_INT@1/1"}
    chosen = channels_of_one_vehicle(mission("CAMERA_FEEDBACK[0]@2/1"), TWO, named, ledger)
    assert "GLOBAL_POSITION_INT@1/1" in {c.name for c in chosen}
    assert "ATTITUDE@1/1" not in {c.name for c in chosen}
    (mixed,) = [entry for entry in ledger if entry.code == "LOG-VEHICLES-MIXED"]
    assert (mixed.kind, mixed.where) == ("finding", "log.channels.position")


def test_a_log_of_one_vehicle_is_left_as_it_is() -> None:
    ledger = Ledger()
    channels = (*sent_by(1), SENSOR)
    assert channels_of_one_vehicle(mission(), channels, {}, ledger) is channels
    assert len(ledger) == 0
