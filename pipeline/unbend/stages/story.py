"""What happens to a mission between its log and its results, in order: each step calls a stage."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.air_samples import AirSamples
from unbend.config import Mission
from unbend.flight.heights import heights_at, logged_terrain, undulation_notes
from unbend.flight.outside_air import outside_air_samples
from unbend.flight.stations import Stations, append_unmatched_images, flag_height_misfits
from unbend.flight.trajectory import takeoff_of
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir
from unbend.stages import plausibility
from unbend.stages.adjusted_profile import AirSources, adjusted_profiles, read_air_sources
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exposure_setup import correction_setup
from unbend.stages.ground_heights import elevation_of_mission, with_terrain
from unbend.stages.inputs import FlightLog, flight_log
from unbend.stages.multi_image import point_heights
from unbend.stages.multi_image.control import compare_control
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.outputs import manifest_of
from unbend.stages.stations import stations_of_mission
from unbend.stages.statistics import Statistics
from unbend.stages.uncertainty import TYPICAL_ROWS, report_unknown_sigmas, with_uncertainties
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.observations import Observations
from unbend.units import Array


@dataclass(frozen=True, eq=False)
class PreparedMission:
    """A mission before its observations are corrected: its inputs, stations and air."""

    mission: Mission
    inputs: OpenedInputs
    flight: FlightLog
    stations: Stations
    terrain: ElevationModel | None
    samples: AirSamples
    sources: AirSources
    air: FlightAir
    ledger: Ledger

    @property
    def observations(self) -> Observations:
        """The table of observations, with the heights of object points where these have them."""
        return self.inputs.observations

    def track(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """(n,) time [Unix ns], latitude, longitude [rad], height above sea level [m] as logged."""
        track, height = self.flight.track, self.flight.roles.get("height")
        if track is None or height is None:
            none = np.empty(0)
            return np.empty(0, np.int64), none, none, none
        gap_s = self.mission.max_gap_s
        return *track, heights_at(height, track[0], self.flight.heights, gap_s)[0]


@dataclass(frozen=True, eq=False)
class CorrectedMission:
    """A mission after its observations were corrected."""

    prepared: PreparedMission
    stations: Stations
    air: FlightAir
    setup: CorrectionSetup
    statistics: Statistics
    facts: plausibility.Facts
    manifest: dict[str, Any]


def prepare_mission(
    mission: Mission, inputs: OpenedInputs, ledger: Ledger, stations: Stations | None = None
) -> PreparedMission:
    """Give the log's channels their roles, build the stations (or take them), estimate the air."""
    flight = flight_log(mission, inputs, ledger)
    observations = point_heights.with_object_points(mission, inputs, flight, ledger)
    inputs = replace(inputs, observations=observations)
    terrain = elevation_of_mission(inputs, flight.heights, ledger)
    if stations is None:
        stations = stations_of_mission(mission, inputs, flight, terrain, ledger=ledger)
    else:
        stations = ledger.take(append_unmatched_images(stations, observations.images))
    point_heights.check_object_points(observations, stations, ledger)
    ledger.extend(undulation_notes(flight.heights, stations, package_geoid()))
    samples = ledger.take(
        outside_air_samples(flight.air_roles, flight.heights, mission.max_gap_s, flight.own_suspect)
    )
    sources = read_air_sources(mission, inputs, flight, stations, samples, ledger=ledger)
    air = adjusted_profiles(mission, stations, samples, sources, ledger)
    if air.adjustment.is_measured:
        use_suspect = mission.stations.use_suspect
        stations = ledger.take(flag_height_misfits(stations, air.series, use_suspect=use_suspect))
    ledger.extend(flight.log.ledger if flight.log is not None else ())
    return PreparedMission(
        mission, inputs, flight, stations, terrain, samples, sources, air, ledger
    )


def correct_mission(
    prepared: PreparedMission, correct: Callable[[CorrectionSetup], Statistics]
) -> CorrectedMission:
    """Correct the observations of a mission, or a sample of them, and say what became of them."""
    mission, air, ledger = prepared.mission, prepared.air, prepared.ledger
    stations = with_cabin_air(
        prepared.stations, mission.windows, mission.lenses, air.series, ledger
    )
    report_unknown_sigmas(mission, stations, air.series, ledger)
    setup = correction_setup(mission, stations, air.series, prepared.flight.heights, ledger)
    setup = with_terrain(setup, prepared.terrain, stations, mission.ground.sigma_m, ledger)
    setup = point_heights.with_intersected_heights(
        mission, prepared.observations, setup, stations, ledger
    )
    batch = next(prepared.observations.batches(TYPICAL_ROWS))
    setup = with_uncertainties(setup, mission, stations, air.series, batch)
    control = compare_control(
        mission, prepared.inputs, setup, stations, prepared.flight.heights,
        ledger=ledger,
    )  # fmt: skip
    statistics = correct(setup)
    facts = plausibility.Facts(
        mission, stations, setup.exposures, setup.cameras, statistics.sampled_rows(),
        air.adjustment, takeoff_of(prepared.track(), prepared.flight.heights.home_h_msl_m),
        logged_terrain(prepared.flight.channels, stations.time_ns), prepared.terrain,
    )  # fmt: skip
    causes = plausibility.causes_of_statuses(facts)
    statistics.report_flagged(ledger, causes)
    plausibility.report_findings(facts, ledger)
    air = replace(air, effects=facts.effects)
    manifest = manifest_of(
        mission, prepared.flight, stations, air, statistics=statistics, setup=setup,
        causes=causes, ledger=ledger,
    ) | {"control": None if control is None else control.manifest()}  # fmt: skip
    return CorrectedMission(prepared, stations, air, setup, statistics, facts, manifest)
