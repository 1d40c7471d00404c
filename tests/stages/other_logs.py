"""A mission that was read, and read again with other channels in its log."""

from dataclasses import replace

from tests.helpers import refused, with_code
from unbend import load_mission
from unbend.batch.runs import read_mission
from unbend.messages import Ledger
from unbend.stages.flight_log import flight_log


def read_folder(mission):
    """The mission as its folder has it now."""
    return read_mission(mission.save())


def message_of(prepared, code):
    """The only message with this code."""
    (message,) = with_code(prepared.ledger, code)
    return message


def opened(mission):
    """The inputs of a mission folder."""
    return read_folder(mission).inputs


def channel_of(inputs, name):
    channels = [channel for channel in inputs.log.channels if channel.name == name]
    (channel,) = channels
    return channel


def with_channels(inputs, *channels):
    """Inputs with channels more in the log, or instead of those of their names."""
    log = inputs.log
    names = {channel.name for channel in channels}
    unchanged = [channel for channel in log.channels if channel.name not in names]
    log = replace(log, channels=(*unchanged, *channels))
    return replace(inputs, log=log)


def flight_of(mission, inputs):
    """The flight by these inputs and by the mission file as it is now, and what is said of it."""
    ledger = Ledger()
    sections = load_mission(mission.save())
    return flight_log(sections, inputs, ledger), ledger


def refusal_to_read(mission, code):
    """What reading the mission is refused with."""
    with refused(code) as caught:
        read_folder(mission)
    return str(caught.value)
