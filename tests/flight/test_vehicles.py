"""Two vehicles in one log, and several receivers of one vehicle."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.flight.made_channels import EARTH_M, located
from tests.helpers import channel, refused, with_code
from unbend.errors import MissionError
from unbend.flight.channels import Source
from unbend.flight.vehicles import Vehicles
from unbend.messages import Ledger
from unbend.stages.vehicle import channels_of_one_vehicle

SECONDS = np.arange(0.0, 100.0)


def sent(name, *roles, system=None, north_m=0.0):
    columns = {}
    if "events" in roles:
        columns = {"event_index": SECONDS}
    if "position" in roles:
        columns = {
            "lat_rad": 0.8 + north_m / EARTH_M,
            "lon_rad": 0.1 + SECONDS / 1e6,
        }
    source = Source(name.partition("@")[0].strip("/"), None, system, 1)
    return replace(channel(name, SECONDS, *roles, **columns), source=source)


ROLES_OF_MESSAGES = {
    "CAMERA_FEEDBACK[0]": "events",
    "GLOBAL_POSITION_INT": "position",
    "ATTITUDE": "attitude",
}


def sent_by(system):
    channels = []
    for message, role in ROLES_OF_MESSAGES.items():
        channels.append(sent(f"{message}@{system}/1", role, system=system))
    return tuple(channels)


EVENTS_OF_1 = "CAMERA_FEEDBACK[0]@1/1"
EVENTS_OF_2 = "CAMERA_FEEDBACK[0]@2/1"
POSITION_OF_1 = {"position": "GLOBAL_POSITION_INT@1/1"}
SENSOR = sent("HYGROMETER_SENSOR[0]", "temperature", system=51)
FIRST = sent_by(1)
SECOND = sent_by(2)
FIRST_WITHOUT_FIX = (FIRST[0], FIRST[2])
TWO = (*FIRST, *SECOND, SENSOR)
TWO_WITH_ONE_FIX = (*FIRST_WITHOUT_FIX, *SECOND)


def topics(namespace, north_m):
    return (
        sent(f"{namespace}/fix", "position", "height", north_m=north_m),
        sent(f"{namespace}/imu", "attitude"),
    )


@pytest.mark.parametrize(
    ("channels", "names"),
    [
        (FIRST, ()),
        (TWO, ("system 1", "system 2")),
        # one of them has no fix: its attitude is still its own
        (TWO_WITH_ONE_FIX, ("system 1", "system 2")),
        # names of topics are of vehicles if these are apart, and of sensors if they are together
        (topics("/uav1", 0.0) + topics("/uav2", 10.1), ("/uav1", "/uav2")),
        (topics("/novatel", 0.0) + topics("/xsens", 9.9), ()),
        (topics("/fleet/uav1", 0.0) + topics("/fleet/uav2", 60.0), ("/fleet/uav1", "/fleet/uav2")),
        (topics("", 0.0) + topics("/base", 900.0), ("/", "/base")),
        # two receivers that both have no namespace of their own
        ((sent("/fix", "position"), sent("/gps", "position", north_m=60.0)), ()),
    ],
)
def test_which_senders_are_vehicles(channels, names):
    assert Vehicles.of(channels).names == names


def mission(*event_channels):
    sources = {f"cam{k}": SimpleNamespace(channel=name) for k, name in enumerate(event_channels)}
    events = SimpleNamespace(log=sources) if event_channels else None
    return SimpleNamespace(events=events, mount={})


@pytest.mark.parametrize(
    ("events", "channels", "named", "chosen"),
    [
        ([EVENTS_OF_2], TWO, {}, (*SECOND, SENSOR)),
        ([], TWO, POSITION_OF_1, (*FIRST, SENSOR)),
        # a vehicle without a fix lends its attitude to no other
        ([EVENTS_OF_2], TWO_WITH_ONE_FIX, {}, SECOND),
        ([EVENTS_OF_1], TWO_WITH_ONE_FIX, {}, FIRST_WITHOUT_FIX),
    ],
    ids=["of the events", "of the named channels", "the other has no fix", "without a fix"],
)
def test_the_roles_are_of_one_vehicle(events, channels, named, chosen):
    ledger = Ledger()
    of_vehicle = channels_of_one_vehicle(mission(*events), channels, named, ledger)
    assert of_vehicle == chosen
    assert [(entry.kind, entry.code) for entry in ledger] == [("note", "LOG-VEHICLES")]


@pytest.mark.parametrize(
    "events",
    [(), (EVENTS_OF_1, EVENTS_OF_2)],
    ids=["none", "of both"],
)
def test_a_vehicle_that_nothing_names_is_refused_with_the_choices(events):
    with refused("LOG-VEHICLES", MissionError) as refusal:
        channels_of_one_vehicle(mission(*events), TWO, {}, Ledger())
    for choice in ("system 1", "system 2", POSITION_OF_1["position"], EVENTS_OF_2):
        assert choice in refusal.value.what


def test_a_named_channel_of_another_vehicle_is_used_and_a_finding():
    ledger = Ledger()
    chosen = channels_of_one_vehicle(mission(EVENTS_OF_2), TWO, POSITION_OF_1, ledger)
    names = {channel.name for channel in chosen}
    assert "GLOBAL_POSITION_INT@1/1" in names
    assert "ATTITUDE@1/1" not in names
    mixed = with_code(ledger, "LOG-VEHICLES-MIXED")
    assert located(mixed) == [("finding", "LOG-VEHICLES-MIXED", "log.channels.position")]


def test_a_log_of_one_vehicle_is_left_as_it_is():
    channels = (*FIRST, SENSOR)
    ledger = Ledger()
    assert channels_of_one_vehicle(mission(), channels, {}, ledger) is channels
    assert len(ledger) == 0
