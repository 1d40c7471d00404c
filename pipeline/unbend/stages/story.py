"""What happens to a mission between its log and its results, in order: each step calls a stage."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.config import Mission
from unbend.flight.ground_times import LoggedPath, takeoff_of
from unbend.flight.heights import heights_at, logged_terrain, undulation_notes
from unbend.flight.outside_air import outside_air_samples
from unbend.flight.stations import Stations, append_unmatched_images, flag_height_misfits
from unbend.messages import Ledger
from unbend.refraction.effect import FlightAir
from unbend.stages.air_of_mission import adjusted_profiles
from unbend.stages.air_sources import AirSources, read_air_sources
from unbend.stages.cabin_air import with_cabin_air
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.exchanged_sensors import exchanged_sensors
from unbend.stages.exposure_setup import correction_setup
from unbend.stages.flight_log import FlightLog, flight_log
from unbend.stages.ground_heights import elevation_of_mission, with_terrain
from unbend.stages.multi_image.control import compare_control
from unbend.stages.multi_image.point_heights import (
    check_object_points,
    with_intersected_heights,
    with_object_points,
)
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.plausibility.causes import causes_of_statuses, statuses_explained
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.findings import (
    cameras_of_exchanged_sides,
    findings_causing_statuses,
    report_findings,
    settle_findings,
)
from unbend.stages.results import results_of_mission
from unbend.stages.stations import stations_of_mission
from unbend.stages.statistics import Statistics
from unbend.stages.uncertainty import TYPICAL_ROWS, report_unknown_sigmas, with_uncertainties
from unbend.stages.wavelengths import air_by_camera
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.observations import Observations


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
        """The table of observations, with the heights of object points where a table gives them."""
        return self.inputs.observations

    def track(self) -> LoggedPath:
        """Times, places and heights above sea level of the aircraft, as logged.

        All arrays are empty if the log has no positions or no heights.
        """
        track = self.flight.track
        height = self.flight.roles.get("height")
        if track is None or height is None:
            no_values = np.empty(0)
            return LoggedPath(np.empty(0, np.int64), no_values, no_values, no_values)
        gap_s = self.mission.max_gap_s
        h_msl_m, _ = heights_at(height, track.time_ns, self.flight.heights, gap_s)
        return LoggedPath(*track, h_msl_m)


@dataclass(frozen=True, eq=False)
class CorrectedMission:
    """A mission after its observations were corrected.

    stations : those of ``prepared``, with the air in the cabins.
    air : that of ``prepared``, with its effects on R.
    lit_air : each profile of ``air`` once for each wavelength of the cameras that it is used for;
        the profile numbers of ``setup`` count these.
    """

    prepared: PreparedMission
    stations: Stations
    air: FlightAir
    lit_air: ProfileSeries
    setup: CorrectionSetup
    statistics: Statistics
    facts: Facts
    results: ResultsRecord


def prepare_mission(
    mission: Mission, inputs: OpenedInputs, ledger: Ledger, stations: Stations | None = None
) -> PreparedMission:
    """Give the log's channels their roles, build the stations, estimate the air.

    ``stations`` are used, if given, instead of those that would be built.
    """
    # The log, and the heights of observed points that do not depend on stations.
    flight = flight_log(mission, inputs, ledger)
    observations = with_object_points(mission, inputs, flight, ledger)
    inputs = replace(inputs, observations=observations)
    terrain = elevation_of_mission(inputs, flight.heights, ledger)

    # The stations: position and attitude at each exposure.
    if stations is None:
        stations = stations_of_mission(mission, inputs, flight, terrain, ledger)
    else:
        images = observations.images
        stations = ledger.take(append_unmatched_images(stations, images, where="stations"))
    check_object_points(observations, stations, ledger)
    ledger.extend(undulation_notes(flight.heights, stations, package_geoid()))

    # The air along the flight.
    samples = ledger.take(
        outside_air_samples(
            flight.air_roles,
            flight.heights,
            mission.max_gap_s,
            flight.logged_suspect,
            flight.ground,
        )
    )
    sources = read_air_sources(
        mission, inputs, flight=flight, stations=stations, samples=samples, ledger=ledger
    )
    air = adjusted_profiles(mission, stations, samples, sources, ledger)
    ledger.extend(exchanged_sensors(mission, flight, stations, sources, ledger))
    if air.adjustment.is_measured:
        errors = air.adjustment.barometer_errors
        use_suspect = mission.stations.use_suspect
        stations = ledger.take(
            flag_height_misfits(stations, air.series, errors, use_suspect=use_suspect)
        )
    if flight.log is not None:
        ledger.extend(flight.log.ledger)
    return PreparedMission(
        mission=mission,
        inputs=inputs,
        flight=flight,
        stations=stations,
        terrain=terrain,
        samples=samples,
        sources=sources,
        air=air,
        ledger=ledger,
    )


def correct_mission(
    prepared: PreparedMission, correct: Callable[[CorrectionSetup], Statistics]
) -> CorrectedMission:
    """Correct the observations of a mission, or a sample of them, and record the results.

    ``correct`` gets the setup, corrects its observations and returns their statistics. The ledger
    of ``prepared`` gets the messages.
    """
    mission = prepared.mission
    heights = prepared.flight.heights
    air = prepared.air
    ledger = prepared.ledger

    # What rays pass: the air, the cabin, the window, down to the ground.
    lit_air = air_by_camera(air.series, prepared.stations.camera, mission.wavelengths_m)
    stations = with_cabin_air(prepared.stations, mission.windows, mission.lenses, lit_air, ledger)
    report_unknown_sigmas(mission, stations, lit_air, ledger)
    setup = correction_setup(mission, stations, lit_air, heights, ledger)
    setup = with_terrain(setup, prepared.terrain, stations, mission.ground.sigma_m, ledger)
    setup = with_intersected_heights(mission, prepared.observations, setup, stations, ledger)
    batch = next(prepared.observations.batches(TYPICAL_ROWS))
    setup = with_uncertainties(
        setup,
        mission,
        stations,
        lit_air,
        batch,
        flight_profile_number=air.series.profile_number,
    )

    # The correction, and the user's own control before and after it.
    control = compare_control(
        mission,
        prepared.inputs,
        setup=setup,
        stations=stations,
        heights=heights,
        ledger=ledger,
    )
    statistics = correct(setup)

    # Findings, likely causes of uncorrected rows, and the record for the manifest.
    facts = facts_of(prepared, stations, setup, statistics)
    report_findings(facts, ledger)
    causing_findings = findings_causing_statuses(facts, ledger)
    causes = causes_of_statuses(facts, causing_findings)
    explained = statuses_explained(facts, ledger, causing_findings)
    statistics.report_flagged(ledger, causes, explained=explained)
    settle_findings(mission.accept, causing_findings, cameras_of_exchanged_sides(facts), ledger)
    air = replace(air, effects=facts.effects)
    results = results_of_mission(
        mission,
        prepared.flight,
        stations,
        air,
        statistics=statistics,
        setup=setup,
        causes=causes,
        control=None if control is None else control.record(),
        lit_air=lit_air,
        ledger=ledger,
    )
    return CorrectedMission(
        prepared=prepared,
        stations=stations,
        air=air,
        lit_air=lit_air,
        setup=setup,
        statistics=statistics,
        facts=facts,
        results=results,
    )


def facts_of(
    prepared: PreparedMission, stations: Stations, setup: CorrectionSetup, statistics: Statistics
) -> Facts:
    """What the plausibility rules check, collected from a mission and its corrected rows."""
    flight = prepared.flight
    return Facts(
        mission=prepared.mission,
        stations=stations,
        exposures=setup.exposures,
        cameras=setup.cameras,
        rows=statistics.sampled_rows(),
        adjustment=prepared.air.adjustment,
        usual_air=prepared.sources.background.profile,
        takeoff=takeoff_of(prepared.track(), flight.heights.home_h_msl_m, flight.ground),
        logged_terrain_m=logged_terrain(flight.channels, stations.time_ns),
        terrain=prepared.terrain,
        channels=flight.channels,
        height=flight.logged_roles.get("height"),
    )
