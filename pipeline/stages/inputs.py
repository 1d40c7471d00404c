"""The inputs of a mission: the table of observations, and the flight log with its channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pipeline.batch.plan import Plan
from pipeline.flight.channels import Channel
from pipeline.flight.heights import HeightSystem, height_system, to_geodetic
from pipeline.flight.mount import gimbal_notes
from pipeline.flight.quality import plausible_samples
from pipeline.flight.roles import assign_roles
from pipeline.ingest import Log, open_log
from pipeline.ingest.fields import in_stated_unit
from pipeline.ledger import Ledger
from pipeline.tables.observations import Observations, open_observations


@dataclass(frozen=True, eq=False)
class FlightLog:
    """A log after its channels were given their roles; ``roles`` holds plausible values only.

    ``log`` is None, and there are no channels, where the stations come from elsewhere.
    """

    log: Log | None
    channels: tuple[Channel, ...]
    roles: dict[str, Channel]
    heights: HeightSystem


def read_observations(plan: Plan, ledger: Ledger) -> Observations:
    """Open the table of observations and check its columns and rows."""
    section, ground = plan.mission.observations, plan.mission.ground
    return open_observations(
        plan.input("observations").path,
        section.columns.model_dump(),
        ground.column,
        ledger,
        ground_is_msl=ground.reference == "msl",
        sigma_column=ground.sigma_column,
        direction=plan.mission.refraction.direction,
        pixels=section.pixels,
    )


def read_log(plan: Plan, ledger: Ledger) -> FlightLog:
    """Read the log, assign its channels to roles, and relate its heights to sea level."""
    mission = plan.mission
    home = mission.ground.home_h_msl_m
    if mission.log is None:
        return FlightLog(None, (), {}, HeightSystem(mission.mission.undulation_m, home))
    file = plan.input("log")
    log = open_log(file.path, file.sha256)
    channels = log.channels
    if mission.log.local_origin is not None:
        origin = mission.log.local_origin.build()
        channels = tuple(to_geodetic(channel, origin) for channel in channels)
    named = mission.log.channels.named()
    outside = ["temperature"] if mission.atmosphere.board_temperature else []
    for role in [*outside, "cabin_temperature"]:
        board = named[role].name if role in named else ""
        channels = tuple(_board_as_air(c) if c.name == board else c for c in channels)
    for role, stated in named.items():
        if stated.unit is not None:
            channels = tuple(
                in_stated_unit(c, role, stated.unit) if c.name == stated.name else c
                for c in channels
            )
    needs_cabin = any(camera.needs_cabin_from_log for camera in mission.cameras.values())
    names = {role: stated.name for role, stated in named.items()}
    roles = ledger.take(assign_roles(channels, names, needs_cabin=needs_cabin))
    plausible = {
        role: ledger.take(plausible_samples(channel, role)) for role, channel in roles.items()
    }
    mounts = {camera: mount.build() for camera, mount in mission.mount.items()}
    ledger.extend(gimbal_notes(log.messages, plausible, mounts))
    heights = ledger.take(height_system(plausible, mission.mission.undulation_m))
    if home is not None:
        heights = replace(heights, home_h_msl_m=home)
    return FlightLog(log, channels, plausible, heights)


def _board_as_air(channel: Channel) -> Channel:
    """A barometer whose circuit board's temperature is taken for that of the air."""
    board = channel.columns.get("board_temperature_k")
    if board is None or "temperature_k" in channel.columns:
        return channel
    units = dict(channel.logged_units)
    units["temperature_k"] = units.get("board_temperature_k", "")
    columns = dict(channel.columns) | {"temperature_k": board}
    return replace(channel, columns=columns, logged_units=units)
