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
from unbend.ingest.channel_builder import SENT
from unbend.ingest.flight_log import SecondClock
from unbend.ingest.mcap import messages
from unbend.ingest.mcap.topic_samples import TopicSamples
from unbend.ingest.utc_evidence import UNCHECKED_SIGMA_S
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND

# How differently long the quickest messages of two kinds are on their way to the recorder [s]:
# small messages 2 to 15 ms, images of a USB camera up to some 300 ms.
TRANSPORT_SIGMA_S = 0.1

ROLES_OF_STATIONS = {"position", "height", "attitude", "aircraft_attitude", "events"}


def second_clock_of(
    series: Sequence[TopicSamples], recorder: UtcReadings | None, clock: BootClock
) -> SecondClock | None:
    """The second clock of a log: that of the topics which have no time since boot.

    None if all times are of one clock: without such a topic, or without any message that has a time
    since boot (``recorder`` is then None; else it is the recorder's time of such messages). The
    times are not corrected by the difference of the clocks, because a part of it is the transport
    to the recorder: it counts as sigma.
    """
    if recorder is None:
        return None
    of_computer = [samples for samples in series if not samples.counts_from_boot()]
    if not of_computer:
        return None
    names = {samples.name for samples in of_computer}
    names |= {f"{name}{SENT}" for name in names}  # `split_by_feedback` may add this to any of them
    ahead_s = _ahead_s(of_computer, recorder, clock)
    is_unknown = math.isnan(ahead_s)
    sigma_s = UNCHECKED_SIGMA_S if is_unknown else math.hypot(ahead_s, TRANSPORT_SIGMA_S)
    return SecondClock(channels=frozenset(names), ahead_s=ahead_s, sigma_s=sigma_s)


def _ahead_s(of_computer: Sequence[TopicSamples], recorder: UtcReadings, clock: BootClock) -> float:
    """By how much the computer's clock seems ahead of UTC by the vehicle's clock [s], or NaN.

    The delay of a message is the recorder's time minus its own: its transport, less what its clock
    is ahead. So the vehicle's delay minus the computer's is what the computer's clock is ahead. The
    vehicle's is the median of its messages. The computer's is the least of its topics, each by the
    median over the quickest message of each block.
    """
    delays_ns = []
    for samples in of_computer:
        if samples.least_delays_ns:
            delays_ns.append(np.median(samples.least_delays_ns))
    has_utc = np.array([fit is not None for fit in clock.fits], np.bool_)
    is_in_utc = has_utc[clock.line.boot_of(recorder.places)]  # other times are not converted
    usable = recorder.usable & is_in_utc
    if not delays_ns or not usable.any():
        return math.nan
    utc_ns = clock.utc(recorder.places[usable], recorder.boot_ns[usable])
    delay_of_vehicle_ns = np.median(recorder.utc_ns[usable] - utc_ns)
    return float(delay_of_vehicle_ns - min(delays_ns)) / NANOSECONDS_PER_SECOND


def report_second_clock(
    second_clock: SecondClock, channels: Sequence[Channel], ledger: Ledger
) -> None:
    """Enter a second clock in the ledger, if stations may be made of channels of both clocks."""
    for_stations = {
        channel.name for channel in channels if not ROLES_OF_STATIONS.isdisjoint(channel.roles)
    }
    of_computer = sorted(for_stations & second_clock.channels)
    of_vehicle = for_stations - second_clock.channels
    if of_computer and of_vehicle:
        ledger.add(
            messages.two_clocks(
                channels=of_computer,
                ahead_s=second_clock.ahead_s,
                sigma_s=second_clock.sigma_s,
            )
        )
