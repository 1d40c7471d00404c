"""The stations of a mission: one row for each exposure, matched to the images."""

from __future__ import annotations

import numpy as np

from pipeline.batch.plan import Plan
from pipeline.errors import MissionError
from pipeline.flight.channels import Channel
from pipeline.flight.exposures import (
    Events,
    choose_event_channel,
    events_of_channel,
    events_of_table,
    refuse_repeated_images,
    trigger_notes,
)
from pipeline.flight.station_builder import (
    build_stations,
    flag_missing_aircraft_attitude,
    with_air,
)
from pipeline.flight.stations import (
    Stations,
    append_unmatched_images,
    join_stations,
    unusable_station_notes,
)
from pipeline.ledger import Ledger
from pipeline.stages.cabin_air import cabin_from_log
from pipeline.stages.inputs import FlightLog
from pipeline.stages.oriented_stations import oriented_stations
from pipeline.tables.events import EventColumns, read_events
from pipeline.tables.observations import Observations


def exposure_events(plan: Plan, channels: tuple[Channel, ...], ledger: Ledger) -> list[Events]:
    """When each camera was exposed, from the log or from a table.

    Refuses (MissionError EVENTS-CAMERA) a table that names a camera which the mission lacks.
    """
    section = plan.mission.events
    if section is None:
        return []
    if section.log is not None:
        events = []
        for camera, source in section.log.items():
            channel = choose_event_channel(channels, source.channel)
            ledger.extend(trigger_notes(channels, channel))
            exposed = events_of_channel(channel, camera, source.image, source.delay_s)
            events.append(ledger.take(exposed))
        return events
    csv = section.csv
    if csv is None:
        raise MissionError("EVENTS-NONE", "the mission names no events", where="events")
    table = read_events(plan.input("events").path, EventColumns(**csv.columns.model_dump()), ledger)
    only = csv.camera or next(iter(plan.mission.cameras))
    camera_of = table.camera if table.camera is not None else np.full(table.image.shape, only)
    for name in sorted(set(camera_of.tolist()) - set(plan.mission.cameras)):
        raise MissionError(
            "EVENTS-CAMERA",
            f"the table of exposures names camera {name!r}, which the mission file does not define",
            where=str(csv.path),
            remedy=f"cameras are {', '.join(plan.mission.cameras)}",
        )
    return [
        events_of_table(table.image, camera_of, table.time_ns, camera, csv.delay_s)
        for camera in plan.mission.cameras
    ]


def stations_of_mission(
    plan: Plan, flight: FlightLog, observations: Observations, ledger: Ledger
) -> Stations:
    """Position, attitude and air of each exposure, or the status that says what is missing."""
    mission = plan.mission
    events = exposure_events(plan, flight.channels, ledger)
    refuse_repeated_images(events)
    exposed = [
        build_stations(
            events_of_camera,
            flight.roles,
            mission.mount[events_of_camera.camera].build(),
            flight.heights,
            mission.max_gap_s,
        )
        for events_of_camera in events
    ]
    if mission.stations.orientation is None:
        stations = join_stations(exposed)
    else:
        oriented = oriented_stations(plan, flight, exposed, ledger)
        stations = with_air(oriented, flight.roles, mission.max_gap_s)
    for name, camera in mission.cameras.items():
        cabin = None if camera.window is None else camera.window.build().cabin
        if cabin is not None and camera.needs_cabin:
            stations = ledger.take(
                cabin_from_log(stations, name, cabin, flight.channels, flight.roles)
            )
        if camera.window is not None and camera.window.frame == "body":
            stations = ledger.take(flag_missing_aircraft_attitude(stations, name))
    stations = ledger.take(append_unmatched_images(stations, observations.images))
    ledger.extend(unusable_station_notes(stations))
    return stations
