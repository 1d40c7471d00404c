"""Two clocks in one MCAP log: PX4's messages count from a boot, others have stamps of a computer.

The recorder is the only one that sees both. It receives a message some milliseconds after its time
(an image some tenths of a second): how much later the messages of either clock arrive shows how
far the clocks differ.
"""

import math
from collections.abc import Sequence

import numpy as np

from unbend.flight.channels import Channel
from unbend.ingest.boot_clock import BootClock
from unbend.ingest.flight_log import SecondClock
from unbend.ingest.mcap import messages
from unbend.ingest.utc_evidence import UNCHECKED_SIGMA_S
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND

# How differently long the quickest messages of two kinds are on their way to the recorder [s]:
# small messages 2 to 15 ms, images of a USB camera up to some 300 ms.
TRANSPORT_SIGMA_S = 0.1

ROLES_OF_STATIONS = {"position", "height", "attitude", "aircraft_attitude", "events"}


def second_clock_ahead_s(
    recorded_late_ns: Sequence[Sequence[int]], recorder: UtcReadings, clock: BootClock
) -> float | None:
    """How far the clock of the stamps is ahead of UTC by the vehicle's clock [s]; None if unknown.

    ``recorded_late_ns``: for each topic with stamps, by how much the recorder's time of its
    messages is later [ns], block by block. ``recorder``: the recorder's time of messages with a
    time since boot.
    """
    late_of_topics_ns = [np.median(blocks) for blocks in recorded_late_ns if blocks]
    has_utc = np.array([fit is not None for fit in clock.fits], np.bool_)
    usable = recorder.usable & has_utc[clock.line.boot_of(recorder.places)]
    if not late_of_topics_ns or not bool(usable.any()):
        return None
    utc_ns = clock.utc(recorder.places[usable], recorder.boot_ns[usable])
    late_of_vehicle_ns = np.median(recorder.utc_ns[usable] - utc_ns)
    return float(late_of_vehicle_ns - min(late_of_topics_ns)) / NANOSECONDS_PER_SECOND


def second_clock_of(stamped: Sequence[Channel], ahead_s: float | None) -> SecondClock | None:
    """The clock of the channels with stamps; None without such channels.

    ``ahead_s``: how far it is ahead of the vehicle's clock, None if unknown. Times are not
    corrected by it, because a part of it is the transport to the recorder: it counts as sigma.
    """
    if not stamped:
        return None
    sigma_s = UNCHECKED_SIGMA_S if ahead_s is None else math.hypot(ahead_s, TRANSPORT_SIGMA_S)
    return SecondClock(frozenset(channel.name for channel in stamped), sigma_s)


def report_second_clock(
    second_clock: SecondClock | None,
    channels: Sequence[Channel],
    ahead_s: float | None,
    ledger: Ledger,
) -> None:
    """Enter a second clock in the ledger, if stations may be made of channels of both clocks."""
    if second_clock is None:
        return
    for_stations = {
        channel.name for channel in channels if not ROLES_OF_STATIONS.isdisjoint(channel.roles)
    }
    of_computer = sorted(for_stations & second_clock.channels)
    if of_computer and for_stations - second_clock.channels:
        ledger.add(
            messages.two_clocks(channels=of_computer, ahead_s=ahead_s, sigma_s=second_clock.sigma_s)
        )
