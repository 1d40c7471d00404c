"""A mission that was read, and read again with other channels in its log."""

from __future__ import annotations

from dataclasses import replace

from tests.helpers import refused
from unbend import load_mission
from unbend.batch.runs import read_mission
from unbend.flight.channels import Channel
from unbend.messages import Ledger
from unbend.stages.flight_log import FlightLog, flight_log
from unbend.stages.opened_inputs import OpenedInputs


def opened(mission) -> OpenedInputs:
    """The inputs of a mission folder."""
    return read_mission(mission.save()).inputs


def channel_of(inputs: OpenedInputs, name: str) -> Channel:
    (channel,) = [channel for channel in inputs.log.channels if channel.name == name]
    return channel


def with_channels(inputs: OpenedInputs, *channels: Channel) -> OpenedInputs:
    """Inputs with channels more in the log, or instead of those of their names."""
    names = {channel.name for channel in channels}
    kept = [channel for channel in inputs.log.channels if channel.name not in names]
    return replace(inputs, log=replace(inputs.log, channels=(*kept, *channels)))


def flight_of(mission, inputs: OpenedInputs) -> tuple[FlightLog, Ledger]:
    """The flight by these inputs and by the mission file as it is now, and what is said of it."""
    ledger = Ledger()
    return flight_log(load_mission(mission.save()), inputs, ledger), ledger


def refusal_to_read(mission, code: str) -> str:
    """What reading the mission is refused with."""
    with refused(code) as caught:
        read_mission(mission.save())
    return str(caught.value)
