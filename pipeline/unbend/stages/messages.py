"""Messages of stages: the codes, and a function for each message or refusal with its text."""

from collections.abc import Sequence

from unbend.errors import Code, ConfigError, Counted, InputError, MissionError
from unbend.flight.messages import CHANNEL_MISSING
from unbend.messages import Kind, Message, fallback, finding, loss, message, note, warning
from unbend.tables.messages import MODEL_TIME

STATIONS_ATTITUDE = Code(
    "STATIONS-ATTITUDE",
    means=(
        "There is no log, and the file has no attitudes. So the viewing directions of the cameras "
        "are unknown."
    ),
    effect="The mission is refused.",
    remedy="Give a log, or a trajectory with roll, pitch and yaw.",
)


def stations_without_attitude(*, where: str) -> MissionError:
    """There is no log, and the file of positions has no attitudes."""
    return MissionError(
        STATIONS_ATTITUDE,
        (
            "there is no log, and the file has no attitudes: the viewing directions of the cameras "
            "are unknown"
        ),
        where=where,
        remedy="give a log, or a stations.trajectory with roll, pitch and yaw",
    )


def attitude_channel_missing(*, where: str, name: str, there: str) -> MissionError:
    """The mission file names a channel for a mount that the log lacks, or that has no attitudes.

    ``there`` lists the channels with attitudes.
    """
    return MissionError(
        CHANNEL_MISSING,
        "the log has no attitudes called {name!r}; it has {there}",
        where=where,
        name=name,
        there=there,
        remedy="name a channel as `unbend inspect` prints it",
    )


TRAJECTORY_REPLACES = Code(
    "TRAJECTORY-REPLACES",
    means=(
        "The values of the log that the trajectory replaces. Refused if the trajectory lacks them."
    ),
    effect="Stations are computed from it.",
    remedy="Remove the values that the file does not have from replaces.",
)


def trajectory_replaces(*, where: str, name: str, roles: str, former: str) -> Message:
    """A trajectory gives ``roles``; ``former`` is the text on what they were before."""
    return note(
        TRAJECTORY_REPLACES,
        "{name} gives {roles}, {former}",
        where=where,
        name=name,
        roles=roles,
        former=former,
    )


def trajectory_lacks_role(*, where: str, role: str, columns: str, able: str) -> MissionError:
    """A trajectory lacks the ``columns`` of a role that it is stated to replace.

    ``able`` lists the roles that it has.
    """
    return MissionError(
        TRAJECTORY_REPLACES,
        "it has no {role} ({columns}); it has {able}",
        where=where,
        role=role,
        columns=columns,
        able=able,
        remedy="leave that out of stations.trajectory.replaces",
    )


EVENTS_POSITIONS = Code(
    "EVENTS-POSITIONS",
    means="A file has the times and positions of the exposures of a camera.",
    effect="Its times are used, and its positions unless times_only is true.",
    remedy="Nothing.",
)


def events_positions(*, where: str, count: int, name: str, camera: str, places: str) -> Message:
    """A file gives the exposures of a camera; ``places`` is the text on its positions, or empty."""
    return note(
        EVENTS_POSITIONS,
        "{name} has the times of the exposures of {camera}{places}",
        where=where,
        count=count,
        name=name,
        camera=camera,
        places=places,
    )


LOG_VEHICLES = Code(
    "LOG-VEHICLES",
    means="The log has the messages of several vehicles.",
    effect=(
        "The channels are taken from the vehicle with the events in use, or with the named "
        "channels. Refused if neither shows which vehicle flew the mission."
    ),
    remedy="Name the events of one vehicle, or log.channels.position of this vehicle.",
)


def vehicles_ambiguous(*, vehicles: Sequence[str], reason: str) -> MissionError:
    """Neither events nor named channels show which vehicle flew the mission.

    ``vehicles`` are described with their channels. ``reason`` names channels of several vehicles,
    if these contradict each other; else it is empty.
    """
    contradiction = f"; {reason} of several vehicles are named" if reason else ""
    return MissionError(
        LOG_VEHICLES,
        "the log has several vehicles: {listed}{contradiction}",
        where="log",
        remedy="name the events of one of them (events.log.<camera>.channel), or its position "
        "(log.channels.position)",
        listed="; ".join(vehicles),
        contradiction=contradiction,
    )


def vehicle_chosen(*, vehicle: str, vehicles: Sequence[str], channel: str) -> Message:
    """The log has several vehicles; ``channel`` shows that ``vehicle`` flew the mission."""
    return note(
        LOG_VEHICLES,
        "of {listed}, the channels of {vehicle} are used, because {channel} is used",
        where="log",
        count=len(vehicles),
        listed=", ".join(vehicles),
        vehicle=vehicle,
        channel=channel,
    )


LOG_VEHICLES_MIXED = Code(
    "LOG-VEHICLES-MIXED",
    means="A named channel is of another vehicle than the events.",
    effect="It is used as stated. The run ends with exit code 3.",
    remedy=(
        "Name the channel of the vehicle with the events in use. Or accept the finding with the "
        "reason."
    ),
)


def role_of_another_vehicle(*, role: str, channel: str, other: str, vehicle: str) -> Message:
    """The mission file names a channel of ``other``, but ``vehicle`` flew the mission."""
    return finding(
        LOG_VEHICLES_MIXED,
        "{channel} is of {other}, the mission was flown by {vehicle}",
        where=f"log.channels.{role}",
        channel=channel,
        other=other,
        vehicle=vehicle,
    )


EVENTS_NONE = Code(
    "EVENTS-NONE",
    means="The mission names no source of exposures.",
    effect="The mission is refused.",
    remedy="Give events or stations.orientation.",
)


def no_events(*, where: str, what: str) -> MissionError:
    """The mission names no source of exposures; ``what`` is the missing section."""
    return MissionError(
        EVENTS_NONE,
        "the mission names no {what}",
        where=where,
        what=what,
        remedy="give events, or stations.orientation",
    )


EVENTS_CAMERA = Code(
    "EVENTS-CAMERA",
    means=(
        "A table of exposures or orientations names a camera that the mission file does not "
        "define. Or there are several cameras, and the camera of its rows is not stated."
    ),
    effect="The mission is refused.",
    remedy=(
        "Correct the name in the table, define the camera under cameras, or name the column of "
        "cameras."
    ),
)


def camera_unstated(*, where: str, cameras: str) -> MissionError:
    """Nothing states which of several cameras the rows of a table belong to."""
    return MissionError(
        EVENTS_CAMERA,
        "the camera of the rows of the table is not stated; the mission file has {cameras}",
        where=where,
        cameras=cameras,
        remedy="give stations.orientation.columns.camera, or stations.orientation.camera if all "
        "rows are of one camera",
    )


def events_of_unknown_camera(*, where: str, name: str, cameras: str) -> MissionError:
    """A table names a camera that the mission file does not define."""
    return MissionError(
        EVENTS_CAMERA,
        "the table names camera {name!r}, which the mission file does not define",
        where=where,
        name=name,
        cameras=cameras,
        remedy="cameras are {cameras}",
    )


EVENTS_NAMELESS = Code(
    "EVENTS-NAMELESS",
    means="The file of exposures has no names of images.",
    effect="The mission is refused.",
    remedy="Name the images by {index} or {n}.",
)


def events_without_names(*, where: str) -> MissionError:
    """A file of exposures has no names of images."""
    return MissionError(
        EVENTS_NAMELESS,
        "the file has no names of images (the column ID of an EO text)",
        where=where,
        remedy="name the images by {{index}} or {{n}}, as in image: DJI_{{index:04d}}.JPG",
    )


EVENTS_OFFSETS = Code(
    "EVENTS-OFFSETS",
    means=(
        "lever_arm_m is from_events, but the file of events has no offsets: only .MRK files have "
        "them."
    ),
    effect="The mission is refused.",
    remedy="Give stations.trajectory.lever_arm_m in metres.",
)


def events_without_offsets(*, where: str) -> MissionError:
    """A file has no offsets from the antenna to the camera."""
    return MissionError(
        EVENTS_OFFSETS,
        "it has no offsets from the antenna to the camera: only .MRK files have them",
        where=where,
        remedy="give stations.trajectory.lever_arm_m in metres",
    )


EVENTS_ORDER = Code(
    "EVENTS-ORDER",
    means="Numbers or names in a file of exposures decrease with time.",
    effect=(
        "A refusal if images are named by the numbers ({index}). If not, a warning where most of "
        "them decrease."
    ),
    remedy="Sort the rows by time, or name the images by {n}.",
)


def numbers_fall(*, where: str, count: int) -> MissionError:
    """Images are named by numbers of events, but ``count`` numbers decrease with time."""
    return MissionError(
        EVENTS_ORDER,
        (
            "{count} of its numbers decrease with time: the images that are named by them would be "
            "in another order than their exposures"
        ),
        one=(
            "1 of its numbers decreases with time: the images that are named by them would be in "
            "another order than their exposures"
        ),
        where=where,
        count=count,
        remedy=("sort the rows by time; or name the images by {{n}}, counted in the order of time"),
    )


def most_numbers_fall(*, where: str, count: int, total: int) -> Message:
    """Most numbers or names of a file decrease with time: ``count`` of ``total`` events."""
    return warning(
        EVENTS_ORDER,
        (
            "{count} of {total} numbers or names decrease with time: images may be in another "
            "order than their exposures"
        ),
        one=(
            "1 of {total} numbers or names decreases with time: images may be in another order "
            "than their exposures"
        ),
        where=where,
        count=count,
        total=total,
    )


AIR_NOT_ADJUSTED = Code(
    "AIR-NOT-ADJUSTED",
    means=(
        "The air was stated: a standard atmosphere (atmosphere.adjust: false, or its name in "
        "Python), or a profile in Python. It was used as it is."
    ),
    effect="No measurement of the air was used.",
    remedy=(
        "Nothing, if that is meant. To use measurements, remove atmosphere.adjust: false; in "
        "Python give the section atmosphere in the place of the name or the profile."
    ),
)


def air_not_adjusted(*, standard: str) -> Message:
    """The mission file keeps a standard atmosphere as it is."""
    return note(
        AIR_NOT_ADJUSTED,
        "the standard atmosphere {standard} is used as it is, as atmosphere.adjust: false states",
        standard=standard,
    )


def air_is_given(*, air: str) -> Message:
    """A caller in Python gives the air itself: a standard atmosphere by its name, or a profile."""
    return note(
        AIR_NOT_ADJUSTED,
        "the air is {air}, as given to correct(): it is used as it is",
        air=air,
    )


TABLES_DEFAULT = Code(
    "TABLES-DEFAULT",
    means=(
        "In Python, correct() used a default for something that its arguments do not state, or "
        "chose one of several columns of the table of stations."
    ),
    effect="A note; a warning if an argument or a column that has values was not used.",
    remedy=(
        "State what is meant: the section ground with height and reference, orientation with "
        "angles, heights and columns. Leave out columns that are not meant."
    ),
)


TABLES_FRAME = Code(
    "TABLES-FRAME",
    means=(
        "In Python, the table of stations has x and y, and no latitude. Nothing states the frame "
        "of x and y."
    ),
    effect="The call is refused.",
    remedy='Add orientation={"frame": "projected", "crs": "EPSG:..."}, or the other frame.',
)


def frame_of_tables_missing(*, where: str) -> ConfigError:
    """A table of stations has x and y, and their frame is not stated."""
    return ConfigError(
        TABLES_FRAME,
        "the stations have x and y, but their frame is not stated",
        where=where,
        remedy=(
            "add orientation={{'frame': 'projected', 'crs': 'EPSG:...'}}, or another frame; or "
            "give latitude and longitude [deg]"
        ),
    )


def ground_by_default(*, where: str, height: str, reference: str) -> Message:
    """The section ``ground`` that `correct` uses, where it is not stated in full."""
    return note(
        TABLES_DEFAULT,
        (
            "ground is not stated in full, so the default completes it: "
            "ground={{'height': {height}, 'reference': '{reference}'}}"
        ),
        where=where,
        height=height,
        reference=reference,
    )


def columns_not_used(*, where: str, count: int, unused: str, used: str) -> Message:
    """A table of stations states the same in several columns, and only ``used`` are used."""
    return warning(
        TABLES_DEFAULT,
        (
            "the table states the same in several ways: {used} is used, but not {unused}. Leave "
            "out the columns that are not meant"
        ),
        where=where,
        count=count,
        unused=unused,
        used=used,
    )


def orientation_not_used(*, where: str, count: int, keys: str) -> Message:
    """``orientation`` is stated in addition to the stations of a run, which do not need it."""
    return warning(
        TABLES_DEFAULT,
        (
            "the stations are those of a run and are used as they are: {keys} of orientation is "
            "not used. Leave orientation out, or give the table without profile_id and status"
        ),
        where=where,
        count=count,
        keys=keys,
    )


def date_before_times(*, where: str, date: str) -> Message:
    """A stated date is used instead of the times in the table of stations."""
    return warning(
        TABLES_DEFAULT,
        (
            "orientation states the date {date}, so the column time_utc is not used. Leave out the "
            "date to use the times"
        ),
        where=where,
        date=date,
    )


AIR_SOURCES_UNUSED = Code(
    "AIR-SOURCES-UNUSED",
    means=(
        "Soundings, a weather model, reports or calibrations are given, but atmosphere.adjust is "
        "false."
    ),
    effect="They are not used.",
    remedy="Remove adjust: false, or the sources.",
)


def air_sources_unused(*, where: str, soundings: int, surface: int, calibrations: int) -> Message:
    """Sources of the air are named but not used."""
    return warning(
        AIR_SOURCES_UNUSED,
        (
            "atmosphere.adjust is false: {columns} (soundings, weather model), {reports} and "
            "{calibrated} are not used"
        ),
        where=where,
        count=soundings + surface + calibrations,
        columns=Counted(soundings, "column"),
        reports=Counted(surface, "surface report"),
        calibrated=Counted(calibrations, "sensor calibration"),
    )


PLAUSIBLE_SENSORS = Code(
    "PLAUSIBLE-SENSORS",
    means=(
        "The sensor that is stated as outside is not outside, and the one that is stated as the "
        "cabin's measures what the air outside has. They seem exchanged under log.channels."
    ),
    effect=(
        "The air is estimated without the sensor stated as outside. The run ends with exit code 3."
    ),
    remedy="Exchange the two channels under log.channels, or accept the finding.",
)


def sensors_exchanged(*, where: str, quantity: str, outside: str, cabin: str) -> Message:
    """The sensors of a quantity outside and in the cabin seem exchanged."""
    return finding(
        PLAUSIBLE_SENSORS,
        (
            "log.channels.{quantity} ({outside}) and log.channels.cabin_{quantity} ({cabin}) seem "
            "exchanged: the {quantity} of {cabin} changes with height as that of the air outside, "
            "the {quantity} of {outside} does not"
        ),
        where=where,
        quantity=quantity,
        outside=outside,
        cabin=cabin,
    )


PLAUSIBLE_ZONE = Code(
    "PLAUSIBLE-ZONE",
    means=(
        "All soundings are far from the stations. With the same x and y in the neighbouring UTM "
        "zone, the stations would be near a sounding."
    ),
    effect="The stations are in the stated zone. The run ends with exit code 3.",
    remedy="Correct the coordinate system. If the zone is right, accept the finding.",
)


def neighbouring_zone(
    *,
    where: str,
    zone: str,
    neighbour: str,
    latitude_deg: float,
    longitude_deg: float,
    away_km: float,
    neighbour_deg: float,
    neighbour_km: float,
) -> Message:
    """Soundings are far from the stations, but would be near in the neighbouring UTM zone.

    ``away_km`` and ``neighbour_km`` are distances to the nearest sounding in the two zones.
    """
    return finding(
        PLAUSIBLE_ZONE,
        (
            "the stations are at latitude {latitude_deg:.2f}, longitude {longitude_deg:.2f} by UTM "
            "zone {zone}, {away_km:.0f} km from the nearest sounding; by zone {neighbour} they "
            "would be at longitude {neighbour_deg:.2f}, {neighbour_km:.0f} km from it: likely the "
            "coordinate system of another zone"
        ),
        where=where,
        zone=zone,
        neighbour=neighbour,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        away_km=away_km,
        neighbour_deg=neighbour_deg,
        neighbour_km=neighbour_km,
    )


def flight_without_time(*, where: str) -> InputError:
    """No station has both a time and a place, so the weather model cannot be evaluated."""
    return InputError(
        MODEL_TIME,
        "no station has a UTC and a place, so the weather model cannot be evaluated",
        where=where,
        remedy="give the day and hour: stations.orientation.date; a log must have UTC",
    )


FLIGHT_UNDATED = Code(
    "FLIGHT-UNDATED",
    means="Neither the log nor the mission file states the date of the flight.",
    effect=(
        "No season is assumed. The climatology has the spread of the whole year. Soundings and "
        "surface reports that have a time are refused, because their age is unknown."
    ),
    remedy="Write mission.date: 2026-05-14, or with the time in UTC, 2026-05-14T10:20.",
)


def flight_undated() -> Message:
    """No exposure has a UTC, and the mission file states no date."""
    return fallback(
        FLIGHT_UNDATED,
        "no exposure has a UTC, and no date is stated: the climatology has the spread of the whole "
        "year (mission.date)",
    )


FLIGHT_HOUR = Code(
    "FLIGHT-HOUR",
    means="The date of the flight is stated without the time of the day, and the log has no UTC.",
    effect=(
        "The daily cycle of the air is a part of its uncertainty: the sigma of the air is larger, "
        "also with a METAR of the right hour."
    ),
    remedy="Write the time too, in UTC: 2026-05-14T10:20. An hour more or less does not matter.",
)


def flight_of_unknown_hour(*, where: str, date: str) -> Message:
    """The date of a flight is known, but not its hour."""
    return note(
        FLIGHT_HOUR,
        "the hour of the flight is unknown, which makes the air less certain: write the time in "
        "UTC too, as {date}T10:20",
        where=where,
        date=date,
    )


def sources_of_undated_flight(*, where: str) -> InputError:
    """Soundings or reports are named, but the date of the flight is unknown."""
    return InputError(
        FLIGHT_UNDATED,
        (
            "the flight has neither UTC nor a stated date: the age of the soundings and surface "
            "reports is unknown"
        ),
        where=where,
        remedy=(
            "state mission.date, as 2026-05-14 or 2026-05-14T10:20; in Python the column time_utc "
            "of the stations is another way"
        ),
    )


DATE_CONTRADICTED = Code(
    "DATE-CONTRADICTED",
    means="The date that the mission file states is not the date of the exposures.",
    effect="The date of the exposures is used.",
    remedy="Correct mission.date or stations.orientation.date, or check the clock of the log.",
)


def date_contradicted(*, where: str, stated: str, flown: str) -> Message:
    """A stated date, under the key ``where``, is more than a day and a half from the exposures."""
    return warning(
        DATE_CONTRADICTED,
        "the mission file states {stated}, but the exposures are of {flown}, which is used",
        where=where,
        stated=stated,
        flown=flown,
    )


def stated_date_in_doubt(*, date: str, key: str) -> str:
    """Text to append to messages on sources far in time: the stated date may be wrong."""
    return f"; or the stated date {date} ({key}) is wrong"


def stated_date_exchanged(*, date: str, key: str, exchanged: str) -> str:
    """Text to append to messages on sources far in time: they fit with day and month exchanged."""
    return (
        f"; or the stated date {date} ({key}) is wrong: with day and month exchanged, {exchanged}, "
        "it fits"
    )


MODEL_COLUMN = Code(
    "MODEL-COLUMN",
    means=(
        "The column of a weather model was taken at the place and time at which the flight was in "
        "its air."
    ),
    effect="It is a source for the air, in addition to the flight's own sensors.",
    remedy="Nothing.",
)


def model_column(
    *, where: str, count: int, low: float, high: float, north: float, east: float, hours: float
) -> Message:
    """The column of a weather model that is used."""
    return note(
        MODEL_COLUMN,
        (
            "{count} levels from {low:.0f} to {high:.0f} m, at {north:.3f}°, {east:.3f}°, "
            "{hours:.1f} h from the nearest time of the file"
        ),
        one=(
            "1 level at {low:.0f} m, at {north:.3f}°, {east:.3f}°, {hours:.1f} h from the nearest "
            "time of the file"
        ),
        where=where,
        count=count,
        low=low,
        high=high,
        north=north,
        east=east,
        hours=hours,
    )


SURFACE_CLIMATE = Code(
    "SURFACE-CLIMATE",
    means=(
        "The temperature of a weather station does not fit this place and season. It may be in "
        "Fahrenheit instead of Celsius."
    ),
    effect="The mission is refused.",
    remedy="Give temperature_c in Celsius. Check the station and the date.",
)


def surface_temperature_unlikely(
    *, where: str, celsius: float, height_m: float, sigmas: float, expected_c: float, rather: str
) -> InputError:
    """A temperature is too far from the climatology; ``rather`` is a hint in words, or empty."""
    return InputError(
        SURFACE_CLIMATE,
        (
            "{celsius:.1f} C at {height_m:.0f} m differs by {sigmas:.1f} sigma from the "
            "{expected_c:.0f} C of the climatology{rather}"
        ),
        where=where,
        celsius=celsius,
        height_m=height_m,
        sigmas=sigmas,
        expected_c=expected_c,
        rather=rather,
        remedy=(
            "temperature_c is in Celsius: convert Fahrenheit by (F - 32) / 1.8, Kelvin by K - "
            "273.15; or the station or the date is wrong; a METAR can be given as it is"
        ),
    )


SURFACE_UNPLACED = Code(
    "SURFACE-UNPLACED",
    means="The distance of the weather station from the flight is not stated.",
    effect="A distance of 100 km is assumed, which gives the report less weight.",
    remedy="Add distance_km.",
)


def surface_unplaced(*, where: str, km: float) -> Message:
    """The distance of a weather station is not stated."""
    return fallback(
        SURFACE_UNPLACED,
        "the station's distance_km is not stated: {km:.0f} km from the flight are assumed",
        where=where,
        km=km,
    )


SURFACE_LEVEL = Code(
    "SURFACE-LEVEL",
    means=(
        "The pressure of a station does not fit its height. It may have been reduced to sea level."
    ),
    effect="The mission is refused.",
    remedy="pressure_hpa is the reading of the barometer at the station. Give QNH as a metar.",
)


def surface_pressure_unlikely(
    *, where: str, hpa: float, height_m: float, sigmas: float, expected_hpa: float, rather: str
) -> InputError:
    """A pressure is too far from the climatology; ``rather`` is a hint in words, or empty."""
    return InputError(
        SURFACE_LEVEL,
        (
            "{hpa:.1f} hPa at {height_m:.0f} m differs by {sigmas:.1f} sigma from the "
            "{expected_hpa:.0f} hPa of the climatology{rather}"
        ),
        where=where,
        hpa=hpa,
        height_m=height_m,
        sigmas=sigmas,
        expected_hpa=expected_hpa,
        rather=rather,
        remedy=(
            "pressure_hpa is the reading of the barometer at h_msl_m, not reduced to sea level; "
            "give QNH as a metar, or correct h_msl_m"
        ),
    )


CABIN_BOARD = Code(
    "CABIN-BOARD",
    means=(
        "The temperature in the cabin is derived from the circuit board of a barometer: its "
        "temperature minus 10 K."
    ),
    effect="Allowed substitute, with a sigma of 6 K.",
    remedy="Name a thermometer as log.channels.cabin_temperature, or state temperature_c.",
)


def cabin_board(*, where: str, count: int, name: str, warmer: float, sigma: float) -> Message:
    """The cabin's temperature is that of a barometer's circuit board, minus ``warmer`` [K]."""
    return fallback(
        CABIN_BOARD,
        (
            "the temperature of the cabin is the temperature of the board of {name}, minus "
            "{warmer:.0f} +- {sigma:.0f} K"
        ),
        where=where,
        count=count,
        name=name,
        warmer=warmer,
        sigma=sigma,
    )


CABIN_DRY = Code(
    "CABIN-DRY",
    means="The humidity of the cabin is not known.",
    effect=(
        "Its air is treated as dry. Vapour changes its refractivity by some tenths of a percent."
    ),
    remedy="If it is known, state relative_humidity under window.cabin.",
)


def cabin_dry(*, where: str, count: int) -> Message:
    """The humidity in a cabin is unknown, so its air is treated as dry."""
    return fallback(
        CABIN_DRY,
        "no humidity in the cabin for {count} exposures: its air is treated as dry",
        one="no humidity in the cabin for 1 exposure: its air is treated as dry",
        where=where,
        count=count,
    )


CABIN_IMPLAUSIBLE = Code(
    "CABIN-IMPLAUSIBLE",
    means=(
        "The air in the cabin has less pressure than the air outside, or a temperature far from 21 "
        "degC. Or the mission file states the pressure outside for the cabin, and a barometer "
        "contradicts that."
    ),
    effect="It was used as stated. If it is a finding, the run ends with exit code 3.",
    remedy="Check the channel, its unit, and cameras.<name>.window.cabin.pressure.",
)


def cabin_implausible(
    *, where: str, count: int, name: str, oddity: str, hpa: float, celsius: float
) -> Message:
    """The pressure or temperature in a cabin is not plausible; ``oddity`` names which."""
    return warning(
        CABIN_IMPLAUSIBLE,
        (
            "the cabin of {name} has {oddity}: {hpa:.0f} hPa and {celsius:.0f} degC at the first "
            "of {count} exposures; is it another sensor, or another unit?"
        ),
        one=(
            "the cabin of {name} has {oddity}: {hpa:.0f} hPa and {celsius:.0f} degC at 1 "
            "exposure; is it another sensor, or another unit?"
        ),
        where=where,
        count=count,
        name=name,
        oddity=oddity,
        hpa=hpa,
        celsius=celsius,
    )


def cabin_pressurised(*, where: str, count: int, camera: str, name: str, hpa: float) -> Message:
    """A barometer reads ``hpa`` more than outside, but the cabin is stated as unsealed."""
    return finding(
        CABIN_IMPLAUSIBLE,
        (
            "the mission file states the pressure of the air outside for the cabin of {camera}, "
            "but {name} measures {hpa:.0f} hPa more at the exposures: if this barometer is in the "
            "cabin, give pressure: log"
        ),
        where=where,
        count=count,
        camera=camera,
        name=name,
        hpa=hpa,
    )


CABIN_MISSING = Code(
    "CABIN-MISSING",
    means="Exposures of a camera behind a window have no cabin pressure.",
    effect="These stations are suspect, without corrected values. The run ends with exit code 3.",
    remedy=(
        "Name log.channels.cabin_pressure, or state the pressure under cameras.<name>.window.cabin."
    ),
)

CABIN_SCHEDULE = Code(
    "CABIN-SCHEDULE",
    means=(
        "The air of the cabin was not measured. It follows Gyer's usual schedule: the pressure "
        "outside up to 3 km, then 701.2 hPa."
    ),
    effect="R_cc is computed from it, with dry air of 21.1 degC.",
    remedy="Nothing. For a better result, log or state the pressure of the cabin.",
)


def cabin_schedule(*, where: str) -> Message:
    """The air in the cabin follows Gyer's schedule, because it was not measured."""
    return note(
        CABIN_SCHEDULE,
        (
            "the cabin's air was not measured and follows Gyer's schedule: the pressure outside up "
            "to 3 km pressure altitude, then 701.2 hPa; dry, 21.1 degC"
        ),
        where=where,
    )


CABIN_SCHEDULE_HIGH = Code(
    "CABIN-SCHEDULE-HIGH",
    means="Exposures are above 10 km, where the schedule of the cabin's pressure ends.",
    effect="701.2 hPa are used there too.",
    remedy="State the pressure under cameras.<name>.window.cabin.",
)


def cabin_schedule_high(*, where: str, count: int) -> Message:
    """Exposures are above the height where the schedule of the cabin's pressure ends."""
    return warning(
        CABIN_SCHEDULE_HIGH,
        (
            "{count} exposures are above 10 km, where the schedule of the cabin's pressure ends; "
            "701.2 hPa are used there too"
        ),
        one=(
            "1 exposure is above 10 km, where the schedule of the cabin's pressure ends; 701.2 hPa "
            "are used there too"
        ),
        where=where,
        count=count,
    )


CABIN_TEMPERATURE = Code(
    "CABIN-TEMPERATURE",
    means="Exposures have no temperature in the cabin.",
    effect=(
        "21 degC are assumed, with a sigma of 5 K (10 K if the cabin is not pressurised). It is a "
        "loss if temperature_c is log."
    ),
    remedy="Name log.channels.cabin_temperature, or state temperature_c.",
)

CALIBRATION_IN_FLIGHT = Code(
    "CALIBRATION-IN-FLIGHT",
    means=(
        "The camera was calibrated in flight on images that contain refraction. Its principal "
        "distance and k1 already contain the nadir refraction of that height."
    ),
    effect="In nadir images, the correction removes it twice.",
    remedy="Use a laboratory calibration, or calibrate on corrected observations.",
)


def calibration_in_flight(*, where: str, name: str) -> Message:
    """A camera was calibrated in flight on uncorrected images."""
    return warning(
        CALIBRATION_IN_FLIGHT,
        (
            "camera {name} was calibrated in flight on uncorrected images: its principal distance "
            "and k1 already contain the nadir refraction of that height, and this correction "
            "removes it twice"
        ),
        where=where,
        name=name,
    )


WAVELENGTH_FORMULA = Code(
    "WAVELENGTH-FORMULA",
    means=(
        "A wavelength is stated for a camera, but the formula of the refractive index is for one "
        "fixed wavelength."
    ),
    effect="The mission is refused.",
    remedy="Use the index ciddor, or leave cameras.<name>.wavelength_m out.",
)


def wavelength_of_formula(*, where: str, index: str) -> MissionError:
    """A wavelength is stated, but the formula of the index is for one fixed wavelength."""
    return MissionError(
        WAVELENGTH_FORMULA,
        "the air has the index {index!r}, which is for one fixed wavelength",
        where=where,
        index=index,
        remedy="give air with the index ciddor, or leave the wavelength out",
    )


CAMERA_LIGHT = Code(
    "CAMERA-LIGHT",
    means="The wavelengths of cameras for which a wavelength is stated.",
    effect=(
        "Their refraction is computed for this wavelength. Everything else is computed for "
        "atmosphere.wavelength_m."
    ),
    remedy="Nothing.",
)


def camera_light(*, where: str, count: int, lights: str, common_um: float) -> Message:
    """Cameras have their own wavelengths; ``lights`` lists them, others have ``common_um``."""
    return note(
        CAMERA_LIGHT,
        ("R of {lights}; profile.parquet and all other values of the air are for {common_um:g} um"),
        where=where,
        count=count,
        lights=lights,
        common_um=common_um,
    )


LENS_CHANGE = Code(
    "LENS-CHANGE",
    means=(
        "The air in the lens would change the principal distance by more than 1 %. This is "
        "impossible."
    ),
    effect="The mission is refused.",
    remedy="Check the unit of dc_dp_px_per_hpa and dc_dt_px_per_k: pixels, not millimetres.",
)


def lens_change_absurd(
    *, where: str, name: str, change: float, principal_distance_px: float, hpa: float
) -> MissionError:
    """The air in a lens would change the principal distance [px] by more than is possible."""
    return MissionError(
        LENS_CHANGE,
        (
            "the air in the lens would change the principal distance of {name} by {change:.1f} px "
            "of {principal_distance_px:.1f} at {hpa:.0f} hPa; air cannot have an effect of more "
            "than 1 %"
        ),
        where=where,
        name=name,
        change=change,
        principal_distance_px=principal_distance_px,
        hpa=hpa,
        remedy=(
            "check the reference and the units: px per hPa and px per K, millimetres divided by "
            "the pixel pitch"
        ),
    )


LENS_IN_AIR = Code(
    "LENS-IN-AIR",
    means="The air in the lens changes the principal distance. The entry gives the amount.",
    effect="The correction contains it.",
    remedy="Nothing.",
)


def lens_in_air(
    *, where: str, count: int, name: str, low: float, high: float, principal_distance_px: float
) -> Message:
    """The air in a lens changes its principal distance by ``low`` to ``high`` [px]."""
    return note(
        LENS_IN_AIR,
        (
            "the air in the lens changes the principal distance of {name} by {low:.3f} to "
            "{high:.3f} px of {principal_distance_px:.1f}"
        ),
        where=where,
        count=count,
        name=name,
        low=low,
        high=high,
        principal_distance_px=principal_distance_px,
    )


LENS_TYPICAL = Code(
    "LENS-TYPICAL",
    means=(
        "The air of the calibration is stated, but not the effect of the air on the lens. A "
        "typical lens is assumed. Its principal distance changes by 2.0 +- 0.5 of the change of n."
    ),
    effect=(
        "The correction contains this change. A quarter of it may be wrong, and sigma_cabin_* "
        "contain this."
    ),
    remedy="If the lens was measured, state dc_dp_px_per_hpa and dc_dt_px_per_k.",
)


def lens_typical(*, where: str, name: str, rate: float, sigma: float) -> Message:
    """A lens without measured derivatives is corrected as a typical one.

    ``rate`` +- ``sigma`` is its change of the principal distance per change of n.
    """
    return fallback(
        LENS_TYPICAL,
        (
            "the lens of {name} is treated as a typical lens: its principal distance changes by "
            "{rate:g} +- {sigma:g} of the change of n since the calibration"
        ),
        where=where,
        name=name,
        rate=rate,
        sigma=sigma,
    )


LENS_NOT_REMOVED = Code(
    "LENS-NOT-REMOVED",
    means=(
        "The effect of the air in the lens on the principal distance is not removed, because the "
        "air of the calibration is not stated: 130 to 310 ppm at 6 km on a 153 mm lens, about in "
        "proportion to the height."
    ),
    effect="It stays in the coordinates. Heights are wrong by this part of the flying height.",
    remedy=(
        "State the air of the calibration: cameras.<name>.principal_distance: {reference: "
        "{pressure_hpa: 1013.25, temperature_c: 20}}. If it is unknown, ask the laboratory, or "
        "state the pressure of the standard atmosphere at its height, and 20 degC: that is within "
        "about 10 ppm. For a calibration in flight, it is the air in the lens during its flight."
    ),
)


def lens_not_removed(*, where: str, count: int, names: str) -> Message:
    """The effect of the air in lenses is not removed, and its size is unknown."""
    return note(
        LENS_NOT_REMOVED,
        "the effect of the air in the lens on the principal distance of {names} is not removed",
        where=where,
        count=count,
        names=names,
    )


def lens_left_in(
    *, where: str, count: int, names: str, ppm: float, sigma_ppm: float, corner_px: float
) -> Message:
    """The effect of the air in lenses is not removed; its size is that in a typical lens."""
    return note(
        LENS_NOT_REMOVED,
        (
            "the effect of the air in the lens on the principal distance of {names} is not "
            "removed: about {ppm:.0f} +- {sigma_ppm:.0f} ppm, compared with a calibration at "
            "20 degC and 1013 hPa, which is {corner_px:.2f} px in the corner of an image"
        ),
        where=where,
        count=count,
        names=names,
        ppm=ppm,
        sigma_ppm=sigma_ppm,
        corner_px=corner_px,
    )


OPENING_AIR = Code(
    "OPENING-AIR",
    means="The air in front of the lens, in an opening, differs from the air outside, as stated.",
    effect="It bends the rays as behind a plane window. The correction contains this effect.",
    remedy="Nothing.",
)


def opening_air(*, where: str, name: str, warmer: float, sigma: float, excess: float) -> Message:
    """The air in an opening before a camera differs from that outside, as stated.

    It is ``warmer`` +- ``sigma`` [K], and its pressure is ``excess`` [hPa] higher.
    """
    return note(
        OPENING_AIR,
        (
            "the air in front of {name} differs by {warmer:+g} +- {sigma:g} K and {excess:+g} hPa "
            "from the air outside"
        ),
        where=where,
        name=name,
        warmer=warmer,
        sigma=sigma,
        excess=excess,
    )


WINDOW_SPHERICAL = Code(
    "WINDOW-SPHERICAL",
    means="The window is a sphere around the projection centre.",
    effect="It does not bend rays.",
    remedy="Nothing.",
)


def window_spherical(*, where: str, name: str) -> Message:
    """A spherical window does not bend rays."""
    return note(
        WINDOW_SPHERICAL,
        "the window of {name} is a sphere around the projection centre: it does not bend rays",
        where=where,
        name=name,
    )


WINDOW_MOUNT = Code(
    "WINDOW-MOUNT",
    means=(
        "A window is fixed to the aircraft (frame: body), and the angles of the stations are those "
        "of the camera. Nothing states the attitude of the aircraft."
    ),
    effect=(
        "The direction of the window relative to the camera follows from mount.<camera>, as if the "
        "camera was fixed to the aircraft. With the default mount and normal, this is the same as "
        "frame: camera. If the camera is stabilised, the error is the named shift for each degree."
    ),
    remedy=(
        "If the camera is fixed to the aircraft, check mount.<camera>, or state the normal with "
        "frame: camera. If it is stabilised, give the flight log, name "
        "log.channels.aircraft_attitude, and give the times of the images."
    ),
)


def window_by_mount(*, where: str, count: int, name: str, section: str, px: float) -> Message:
    """A window is fixed to the aircraft, but the aircraft's attitude is not stated.

    ``px`` is the shift of all points if the camera is turned by one degree in the aircraft.
    """
    return warning(
        WINDOW_MOUNT,
        (
            "the direction of the {section} of {name} follows from mount.{name}, as if the camera "
            "was fixed to the aircraft: nothing states the attitude of the aircraft. If the camera "
            "is stabilised, each degree of its tilt in the aircraft shifts all points by {px:.2g} "
            "px more or less"
        ),
        where=where,
        count=count,
        name=name,
        section=section,
        px=px,
    )


WINDOW_GLASS = Code(
    "WINDOW-GLASS",
    means=(
        "The entry states whether the calibration contains the displacement of rays by the window "
        "glass: 7 mm for 20 mm of glass at 45 degrees."
    ),
    effect="If the displacement is not in the calibration, it stays in the coordinates.",
    remedy="If the camera was calibrated through the window, state in_calibration: glass.",
)


def window_glass_calibrated(*, where: str, name: str) -> Message:
    """The calibration contains the displacement by the glass."""
    return note(
        WINDOW_GLASS,
        "the calibration of {name} contains the displacement of rays by the window glass",
        where=where,
        name=name,
    )


def window_glass_not_removed(*, where: str, name: str) -> Message:
    """The displacement by the glass is not removed."""
    return note(
        WINDOW_GLASS,
        (
            "the displacement of rays by the window glass of {name} is not removed: 7 mm for 20 "
            "mm of glass at 45 degrees"
        ),
        where=where,
        name=name,
    )


DEM_OUTSIDE = Code(
    "DEM-OUTSIDE",
    means="Stations are outside the elevation model.",
    effect="A refusal if all stations are outside. If not, a loss.",
    remedy="Check ground.height.dem and its crs.",
)


def no_station_on_model(
    *,
    where: str,
    count: int,
    rows: int,
    columns: int,
    north: float,
    east: float,
    row: float,
    column: float,
) -> MissionError:
    """All stations are outside the elevation model.

    ``row`` and ``column`` are those that the first station would have, at latitude ``north`` and
    longitude ``east`` [deg]; ``rows`` and ``columns`` are the size of the model.
    """
    return MissionError(
        DEM_OUTSIDE,
        (
            "{count} of {count} stations are outside the elevation model, which has {rows} rows "
            "and {columns} columns: the first, at {north:.4f}, {east:.4f}, would be in row "
            "{row:.0f}, column {column:.0f}"
        ),
        one=(
            "the only station is outside the elevation model, which has {rows} rows and "
            "{columns} columns: at {north:.4f}, {east:.4f}, it would be in row {row:.0f}, column "
            "{column:.0f}"
        ),
        where=where,
        count=count,
        rows=rows,
        columns=columns,
        north=north,
        east=east,
        row=row,
        column=column,
        remedy=(
            "check ground.height.dem, and ground.height.crs if the file has no coordinate system"
        ),
    )


def stations_off_model(*, where: str, count: int, total: int) -> Message:
    """Some stations are outside the elevation model."""
    return loss(
        DEM_OUTSIDE,
        "{count} of {total} stations are outside the elevation model",
        one="1 of {total} stations is outside the elevation model",
        where=where,
        count=count,
        total=total,
    )


SIGMA_UNKNOWN = Code(
    "SIGMA-UNKNOWN",
    means="Standard deviations of some causes are not known.",
    effect="The sigma columns do not contain their effect on the corrections.",
    remedy=(
        "State them under the keys that the entry names. Attitudes and heights of a log: "
        "sigma_tilt_deg and sigma_yaw_deg of the section mount. Those of a table: sigma_tilt_deg, "
        "sigma_yaw_deg and sigma_height_m of the section stations.orientation, or columns of the "
        "table. Ground: ground.sigma_m or ground.sigma_column. In Python the table of stations may "
        "have the columns sigma_tilt_deg, sigma_yaw_deg and sigma_height_m."
    ),
)


def sigmas_unknown(*, where: str, count: int, missing: str) -> Message:
    """Some standard deviations are unknown, so the sigma columns do not contain their effect."""
    return note(
        SIGMA_UNKNOWN,
        (
            "no standard deviations are known of {missing}: their effect on the corrections is "
            "not in the sigma columns"
        ),
        where=where,
        count=count,
        missing=missing,
    )


OBS_DISTANCE = Code(
    "OBS-DISTANCE",
    means="Slant ranges are zero, negative, infinite or not a number.",
    effect="They are treated as missing.",
    remedy="If they are needed, correct the column.",
)


def slant_ranges_invalid(*, where: str, count: int) -> Message:
    """Slant ranges are invalid and treated as missing."""
    return warning(
        OBS_DISTANCE,
        (
            "slant ranges that are zero, negative, infinite or not a number: {count}, treated as "
            "missing"
        ),
        where=where,
        count=count,
    )


OBS_SIGMA = Code(
    "OBS-SIGMA",
    means="Standard deviations of ground heights are negative, infinite or not a number.",
    effect="They are treated as unknown.",
    remedy="Correct the column.",
)


def ground_sigmas_invalid(*, where: str, count: int) -> Message:
    """Standard deviations of ground heights are invalid and treated as unknown."""
    return warning(
        OBS_SIGMA,
        (
            "{count} standard deviations of ground heights are negative, infinite or not a number: "
            "treated as unknown"
        ),
        one=(
            "1 standard deviation of a ground height is negative, infinite or not a number: "
            "treated as unknown"
        ),
        where=where,
        count=count,
    )


OBS_GROUND_RANGE = Code(
    "OBS-GROUND-RANGE",
    means="Heights of points are below -600 or above 10000 m.",
    effect="They are treated as unknown. These rows have the status no_ground.",
    remedy="Check the unit and the column of ground.height.",
)


def ground_heights_invalid(*, where: str, count: int, low: float, high: float) -> Message:
    """Heights of points are below or above all land (``low``, ``high`` [m])."""
    return loss(
        OBS_GROUND_RANGE,
        (
            "heights of points below {low:.0f} or above {high:.0f} m, where there is no ground: "
            "{count}, treated as unknown; their status is no_ground"
        ),
        where=where,
        count=count,
        low=low,
        high=high,
    )


POINTS_MISSING = Code(
    "POINTS-MISSING",
    means="Observations are of points that are not in the table.",
    effect="These rows have the status no_ground. Refused if no point is in the table.",
    remedy="Write the names as in the observations, or name their column.",
)


def points_missing(*, where: str, count: int, rows: int) -> Message:
    """Observations are of points that the table of object points lacks."""
    return loss(
        POINTS_MISSING,
        (
            "{count} of {rows} observations are of points that are not in the table of object "
            "points: their status is no_ground"
        ),
        one=(
            "1 of {rows} observations is of a point that is not in the table of object points: "
            "its status is no_ground"
        ),
        where=where,
        count=count,
        rows=rows,
    )


OBS_NO_IMAGE = Code(
    "OBS-NO-IMAGE",
    means="The name of the image is missing in rows of the observations.",
    effect=(
        "These rows have the status no_station, and no corrected values. The run ends with exit "
        "code 3."
    ),
    remedy="Fill the column of images (observations.columns.image), or leave these rows out.",
)


def image_names_missing(*, where: str, count: int, total: int, first: str) -> Message:
    """Rows have an empty cell in the column of images."""
    return loss(
        OBS_NO_IMAGE,
        (
            "{count} of {total} observations have no name of an image, the first is row {first}, "
            "counted from 0: their status is no_station; fill the column, or leave the rows out"
        ),
        one=(
            "1 of {total} observations has no name of an image, row {first}, counted from 0: its "
            "status is no_station; fill the column, or leave the row out"
        ),
        where=where,
        count=count,
        total=total,
        first=first,
    )


OBS_FLAGGED = Code(
    "OBS-FLAGGED",
    means=(
        "Observations have a status other than ok. The entry gives the status and the likely cause."
    ),
    effect="Their corrected values are null. The run ends with exit code 3.",
    remedy="Correct the cause that the entry names.",
)


def observations_flagged(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Observations are not corrected; ``cause`` and ``examples`` are texts to append, or empty."""
    return loss(
        OBS_FLAGGED,
        "{count} of {total} observations are {status}{cause}{examples}",
        one="1 of {total} observations is {status}{cause}{examples}",
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


OBS_BEYOND_GRAZING = Code(
    "OBS-BEYOND-GRAZING",
    means="Rays cross the height of their point twice. The near crossing was used.",
    effect="Corrected, with status beyond_grazing. The run ends with exit code 3.",
    remedy=(
        "Give slant ranges (observations.columns.distance_m). They decide between the two "
        "crossings."
    ),
)


def observations_beyond_grazing(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Rays cross the height of their point twice, and the near crossing was used.

    ``cause`` and ``examples`` are texts to append, or empty.
    """
    return loss(
        OBS_BEYOND_GRAZING,
        "{count} of {total} observations are {status}{cause}{examples}; near branch used",
        one="1 of {total} observations is {status}{cause}{examples}; near branch used",
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


OBS_FAR_BRANCH = Code(
    "OBS-FAR-BRANCH",
    means="Rays reach their point at the far crossing, because of its slant range.",
    effect="Corrected, with status far_branch.",
    remedy="Nothing.",
)


def observations_on_far_branch(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Rays reach their point at the far crossing, by its slant range.

    ``cause`` and ``examples`` are texts to append, or empty.
    """
    return note(
        OBS_FAR_BRANCH,
        (
            "{count} of {total} observations are {status}{cause}{examples}, because of their slant "
            "range"
        ),
        one="1 of {total} observations is {status}{cause}{examples}, because of its slant range",
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


OBS_SEVERAL_CROSSINGS = Code(
    "OBS-SEVERAL-CROSSINGS",
    means=(
        "Rays would leave the ground again behind a ridge. The first place where they meet the "
        "ground was used."
    ),
    effect="Corrected, with status several_crossings.",
    remedy="Check points behind ridges. An error in the heights of the model can change them.",
)


def several_crossings(
    *, where: str, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Rays meet the elevation model several times, and the first place was used.

    ``cause`` and ``examples`` are texts to append, or empty.
    """
    return warning(
        OBS_SEVERAL_CROSSINGS,
        (
            "{count} of {total} observations are {status}{cause}{examples}: behind a ridge they "
            "would leave the ground again; the first place where they meet the ground was used; an "
            "error in the heights of the model can change it"
        ),
        one=(
            "1 of {total} observations is {status}{cause}{examples}: behind a ridge it would leave "
            "the ground again; the first place where it meets the ground was used; an error in the "
            "heights of the model can change it"
        ),
        where=where,
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


def cabin_pressure_missing(*, where: str, count: int, reason: str) -> Message:
    """The log lacks the cabin pressure at some exposures; ``reason`` completes the sentence."""
    return loss(
        CABIN_MISSING,
        "{count} exposures have {reason}",
        one="1 exposure has {reason}",
        where=where,
        count=count,
        reason=reason,
    )


def cabin_temperature_assumed(*, kind: Kind, where: str, count: int, able: str) -> Message:
    """Exposures have no cabin temperature, so it is assumed.

    ``able`` is the text on channels that could give it. ``kind`` is a loss if the mission file
    states that the temperature is logged, else a fallback.
    """
    return message(
        kind,
        CABIN_TEMPERATURE,
        (
            "{count} exposures have no cabin temperature: 21 degC are assumed, +- 5 K if the cabin "
            "is pressurised, +- 10 K if it is not; {able}"
        ),
        one=(
            "1 exposure has no cabin temperature: 21 degC are assumed, +- 5 K if the cabin is "
            "pressurised, +- 10 K if it is not; {able}"
        ),
        where=where,
        count=count,
        able=able,
    )


OBS_UNIT = Code(
    "OBS-UNIT",
    means=(
        "The coordinates of the observations are not in the unit that the mission file states. "
        "Pixels are measured from a corner of the image and are not negative. Millimetres are "
        "within the format of the camera."
    ),
    effect="The mission is refused.",
    remedy=(
        "State observations.unit: mm or um, with the metric report of the camera. The report gives "
        "the origin and the axes of the coordinates. Or name the columns that have pixels."
    ),
)


def coordinates_without_pixels(
    *, where: str, percent: float, largest: float, likely: str
) -> InputError:
    """Too many coordinates are negative for pixels; ``likely`` is their likely unit."""
    return InputError(
        OBS_UNIT,
        (
            "x and y are negative in {percent:.0f} % of the observations or more, and "
            "{largest:.6g} at most: these are not pixels from a corner of the image, but perhaps "
            "{likely} from its centre"
        ),
        where=where,
        percent=percent,
        largest=largest,
        likely=likely,
        remedy=(
            "state observations.unit: {likely}, with cameras.<name>.metric; or name the columns of "
            "pixels under observations.columns"
        ),
    )


def coordinates_beyond_frame(*, where: str, unit: str, percent: float) -> InputError:
    """Too many coordinates, read in the stated unit, are outside the image."""
    return InputError(
        OBS_UNIT,
        "read in {unit}, {percent:.0f} % of the observations are outside the image",
        where=where,
        unit=unit,
        percent=percent,
        remedy=(
            "check observations.unit, and pixel_um, origin and axes under cameras.<name>.metric"
        ),
    )
