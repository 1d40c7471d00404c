"""A mission that was read, prepared again with other channels in its log."""

from __future__ import annotations

from dataclasses import replace

from unbend import load_mission
from unbend.batch.runs import read_mission
from unbend.flight.channels import Channel
from unbend.messages import Ledger
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.story import PreparedMission, prepare_mission


def opened(mission) -> OpenedInputs:
    """The inputs of a mission folder."""
    return read_mission(mission.save()).inputs


def channel_of(inputs: OpenedInputs, name: str) -> Channel:
    (channel,) = [channel for channel in inputs.log.channels if channel.name == name]
    return channel


def prepared_with(mission, inputs: OpenedInputs, *channels: Channel) -> PreparedMission:
    """The mission as its file is now, with channels more, or instead of those of their names."""
    names = {channel.name for channel in channels}
    kept = [channel for channel in inputs.log.channels if channel.name not in names]
    log = replace(inputs.log, channels=(*kept, *channels))
    return prepare_mission(load_mission(mission.save()), replace(inputs, log=log), Ledger())
