"""What is known of a mission before anything is corrected: log, channels, exposures, stations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.batch.plan import Plan
from pipeline.config import Mission
from pipeline.errors import MissionError
from pipeline.flight.channels import Channel
from pipeline.flight.events import (
    Events,
    account_for_triggers,
    choose_event_channel,
    events_of_channel,
    events_of_table,
    refuse_repeated_images,
)
from pipeline.flight.exposures import (
    build_stations,
    require_aircraft_attitude,
    require_cabin_air,
)
from pipeline.flight.gimbals import tell_of_gimbal
from pipeline.flight.heights import HeightSystem, height_system
from pipeline.flight.local_origin import locate
from pipeline.flight.quality import within_reason
from pipeline.flight.roles import assign_roles
from pipeline.flight.stations import (
    Stations,
    join_stations,
    name_the_unmatched,
    report_flagged,
)
from pipeline.ingest import Log, open_log
from pipeline.ingest.fields import in_stated_unit
from pipeline.ledger import Ledger
from pipeline.stages.adjusted_profile import AirSources
from pipeline.tables.events import EventColumns, read_events
from pipeline.tables.observations import Observations, open_observations


@dataclass(frozen=True, eq=False)
class Flight:
    """A log after its channels were given their roles."""

    log: Log
    channels: tuple[Channel, ...]
    roles: dict[str, Channel]
    heights: HeightSystem


@dataclass(frozen=True, eq=False)
class Found:
    """What is known of a mission before anything is corrected."""

    plan: Plan
    flight: Flight
    observations: Observations
    stations: Stations
    samples: AirSamples
    sources: AirSources
    ledger: Ledger

    def lines(self) -> list[tuple[str, str]]:
        """For a person."""
        roles = ", ".join(
            f"{role.replace('_', ' ')} {channel.name}"
            for role, channel in sorted(self.flight.roles.items())
        )
        cameras = Counter(self.stations.camera[self.stations.ok].tolist())
        return [
            ("log", f"{self.plan.mission.log.path}: {self.flight.log.format}"),
            ("channels", roles),
            ("stations", ", ".join(f"{n} of {name}" for name, n in cameras.items()) or "none"),
            (
                "observations",
                f"{self.observations.rows:,} in {len(self.observations.images)} images",
            ),
            *self.sources.lines(),
            ("results", str(self.plan.output)),
        ]


def open_inputs(plan: Plan, ledger: Ledger) -> Observations:
    """The table of observations, checked."""
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


def read_flight(plan: Plan, ledger: Ledger) -> Flight:
    """The log, its channels in their roles, and how its heights go together."""
    section = plan.mission.log
    file = plan.input("log")
    log = open_log(file.path, file.sha256)
    channels = log.channels
    if section.local_origin is not None:
        origin = section.local_origin.build()
        channels = tuple(locate(channel, origin) for channel in channels)
    named = section.channels.named()
    if plan.mission.atmosphere.board_temperature:
        board = named["temperature"].name
        channels = tuple(_board_as_air(c) if c.name == board else c for c in channels)
    for role, stated in named.items():
        if stated.unit is not None:
            channels = tuple(
                in_stated_unit(c, role, stated.unit) if c.name == stated.name else c
                for c in channels
            )
    wishes = {role: c.name for role, c in named.items()}
    roles = assign_roles(channels, wishes, ledger, needs_cabin=reads_cabin(plan.mission))
    sound = {role: within_reason(channel, role, ledger) for role, channel in roles.items()}
    mounts = {camera: mount.build() for camera, mount in plan.mission.mount.items()}
    tell_of_gimbal(log.messages, sound, mounts, ledger)
    heights = height_system(sound, plan.mission.mission.undulation_m, ledger)
    stated_home = plan.mission.ground.home_h_msl_m
    if stated_home is not None:
        heights = replace(heights, home_h_msl_m=stated_home)
    return Flight(log, channels, sound, heights)


def _board_as_air(channel: Channel) -> Channel:
    """A barometer whose own temperature is taken for that of the air."""
    board = channel.columns.get("board_temperature_k")
    if board is None or "temperature_k" in channel.columns:
        return channel
    units = dict(channel.logged_units)
    units["temperature_k"] = units.get("board_temperature_k", "")
    columns = dict(channel.columns) | {"temperature_k": board}
    return replace(channel, columns=columns, logged_units=units)


def reads_cabin(mission: Mission) -> bool:
    """Whether a window or a lens takes its cabin air from the log."""
    return any(camera.needs_cabin_from_log for camera in mission.cameras.values())


def find_events(plan: Plan, channels: tuple[Channel, ...], ledger: Ledger) -> list[Events]:
    """When each camera was exposed, from the log or from a table."""
    section = plan.mission.events
    if section.log is not None:
        found = []
        for camera, how in section.log.items():
            channel = choose_event_channel(channels, how.channel)
            account_for_triggers(channels, channel, ledger)
            found.append(events_of_channel(channel, camera, how.image, how.delay_s, ledger))
        return found
    csv = section.csv
    if csv is None:
        raise MissionError("EVENTS-NONE", "the mission names no events", where="events")
    table = read_events(plan.input("events").path, EventColumns(**csv.columns.model_dump()), ledger)
    only = csv.camera or next(iter(plan.mission.cameras))
    camera_of = table.camera if table.camera is not None else np.full(table.image.shape, only)
    for name in sorted(set(camera_of.tolist()) - set(plan.mission.cameras)):
        raise MissionError(
            "EVENTS-CAMERA",
            f"the table of exposures speaks of camera {name!r}",
            where=str(csv.path),
            remedy=f"cameras are {', '.join(plan.mission.cameras)}",
        )
    return [
        events_of_table(table.image, camera_of, table.time_ns, camera, csv.delay_s)
        for camera in plan.mission.cameras
    ]


def find_stations(
    plan: Plan, flight: Flight, observations: Observations, ledger: Ledger
) -> Stations:
    """One row an exposure: position, attitude and air, or the reason why not."""
    mission = plan.mission
    events = find_events(plan, flight.channels, ledger)
    refuse_repeated_images(events)
    parts = [
        build_stations(
            event,
            flight.roles,
            mission.mount[event.camera].build(),
            flight.heights,
            mission.log.max_gap_s,
        )
        for event in events
    ]
    stations = join_stations(parts)
    for name, camera in mission.cameras.items():
        if camera.needs_cabin_from_log:
            stations = require_cabin_air(stations, name, ledger)
        if camera.window is not None and camera.window.frame == "body":
            stations = require_aircraft_attitude(stations, name, ledger)
    stations = name_the_unmatched(stations, observations.images, ledger)
    report_flagged(stations, ledger)
    return stations
