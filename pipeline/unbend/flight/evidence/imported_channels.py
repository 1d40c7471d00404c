"""Suspect stretches of imported channels (made by other programs), by comparison with the log."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence.contradictions import FEWEST_SAMPLES, steps_and_poor_accuracy
from unbend.flight.evidence.source_differences import source_difference
from unbend.flight.evidence.sources import (
    SourcePath,
    sigma_column,
    source_path,
    velocity_at,
    with_places,
)
from unbend.flight.evidence.stretches import (
    HEIGHT,
    POSITION,
    Stretch,
    in_any_stretch,
    joined_stretches,
    runs,
    stretch_of_run,
)

# Beyond a constant offset, a smaller difference from the log may be the autopilot's own error [m].
LEAST_M = {POSITION: 5.0, HEIGHT: 10.0}

_SLOWEST_HZ = 1.0  # steps are not looked for in a slower channel
_EXPLAINED_SIGMAS = 3.0  # of the imported channel: they explain a smaller difference


def contradictions_of_import(
    imported: Channel,
    quantities: Sequence[str],
    roles: Mapping[str, Channel],
    suspect_in_log: Sequence[Stretch],
) -> tuple[Stretch, ...]:
    """Stretches in which an imported channel steps, or departs from the log, in its quantities.

    ``quantities`` : position, height or both. ``roles`` : those that the log fills; its values do
    not count in the stretches ``suspect_in_log``. Steps are searched in channels of 1 Hz and
    faster. A step or departure of less than three of the sigmas that the channel itself reports
    does not count.
    """
    suspect: list[Stretch] = []
    for quantity in (POSITION, HEIGHT):
        if quantity not in quantities:
            continue
        placed = with_places(imported, quantity)
        if len(placed) <= FEWEST_SAMPLES:
            continue
        log_suspects = [stretch for stretch in suspect_in_log if stretch.quantity == quantity]
        stretches = _contradictions_in(quantity, placed, roles, log_suspects)
        for stretch in joined_stretches(stretches):
            if not _explained_by_sigma(stretch, placed, quantity):
                suspect.append(stretch)
    return tuple(suspect)


def _contradictions_in(
    quantity: str,
    imported: Channel,
    roles: Mapping[str, Channel],
    suspect_in_log: Sequence[Stretch],
) -> list[Stretch]:
    """Stretches in which an imported position or height steps, or departs from the log."""
    with_velocity = [imported]
    for role in (POSITION, HEIGHT):
        if role in roles:
            with_velocity.append(roles[role])
    path = source_path(_without_sigmas(imported), quantity, with_velocity)
    stretches: list[Stretch] = []
    if imported.rate_hz >= _SLOWEST_HZ:
        stretches += steps_and_poor_accuracy(path, quantity)
    if quantity in roles:
        log = with_places(roles[quantity], quantity)
        if len(log) > FEWEST_SAMPLES:
            stretches += _departures_from_log(path, log, quantity, with_velocity, suspect_in_log)
    return stretches


def _explained_by_sigma(stretch: Stretch, imported: Channel, quantity: str) -> bool:
    """Whether a stretch is off by less than three of the sigmas that the channel reports in it.

    The largest sigma in the stretch counts; an unknown one counts as 0.
    """
    sigma_m = np.nan_to_num(imported.get(sigma_column(quantity)))
    largest_m = float(sigma_m[stretch.covers(imported.time_ns)].max(initial=0.0))
    return stretch.off_m < _EXPLAINED_SIGMAS * largest_m


def _without_sigmas(channel: Channel) -> Channel:
    """The channel without its columns of sigmas, so that all its samples count as accurate."""
    columns = {}
    for name, values in channel.columns.items():
        if not name.startswith("sigma_"):
            columns[name] = values
    return replace(channel, columns=columns)


def _departures_from_log(
    imported: SourcePath,
    log: Channel,
    quantity: str,
    with_velocity: Sequence[Channel],
    suspect_in_log: Sequence[Stretch],
) -> list[Stretch]:
    """Stretches in which an imported path departs from the log by more than an autopilot's error.

    Its steps are not taken out, so that they count as departures. Departures do not count in the
    stretches ``suspect_in_log``. A stretch begins and ends where half of the limit is exceeded.
    """
    channel = imported.channel
    with_steps = replace(
        imported,
        stepped_m=np.zeros_like(imported.stepped_m),
        good=np.ones(len(channel), np.bool_),
        part=channel.boot.astype(np.intp),
    )
    velocity = np.zeros_like(imported.stepped_m)  # heights are not searched for a lag
    if quantity == POSITION:
        velocity = velocity_at(with_velocity, quantity, channel.time_ns)
    difference = source_difference(log, with_steps, quantity, velocity)
    is_suspect = in_any_stretch(suspect_in_log, channel.time_ns)
    off_m = np.where(is_suspect, 0.0, np.nan_to_num(difference.off_m))
    limit_m = np.maximum(difference.limit_m, LEAST_M[quantity])
    stretches: list[Stretch] = []
    for run in runs(channel.time_ns, off_m > 0.5 * limit_m, off_m > limit_m):
        farthest_m = float(off_m[run.rows].max())
        reason = f"{channel.name} and {log.name} are {farthest_m:.0f} m apart"
        stretches.append(stretch_of_run(channel.time_ns, run, quantity, reason, farthest_m))
    return stretches
