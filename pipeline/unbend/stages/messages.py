"""Messages of stages: what each code means, and the words of what is sent."""

from collections.abc import Sequence

from unbend.errors import Code, Counted, InputError, MissionError
from unbend.flight.messages import CHANNEL_MISSING
from unbend.messages import Kind, Message, fallback, finding, loss, message, note, warning
from unbend.tables.messages import MODEL_TIME

STATIONS_ATTITUDE = Code(
    "STATIONS-ATTITUDE",
    means=("There is no log, and the file has no attitudes: nothing says where the cameras look."),
    effect="The mission is refused.",
    remedy="Give log, or a trajectory with roll, pitch and yaw.",
)


def stations_without_attitude(*, where: str) -> MissionError:
    """There is no log, and the file of positions has no attitudes."""
    return MissionError(
        STATIONS_ATTITUDE,
        "there is no log, and the file has no attitudes: nothing says where the cameras look",
        where=where,
        remedy="give log, or a stations.trajectory with roll, pitch and yaw",
    )


def attitude_channel_missing(*, where: str, name: str, there: str) -> MissionError:
    """The log has no attitudes of the name that a mount gives."""
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
    means="What the trajectory replaces of the log; refused where it lacks that.",
    effect="Stations follow from it.",
    remedy="Leave out of replaces what the file does not have.",
)


def trajectory_replaces(*, where: str, name: str, roles: str, former: str) -> Message:
    """What a trajectory replaces."""
    return note(
        TRAJECTORY_REPLACES,
        "{name} gives {roles}, {former}",
        where=where,
        name=name,
        roles=roles,
        former=former,
    )


def trajectory_lacks_role(*, where: str, role: str, columns: str, able: str) -> MissionError:
    """A trajectory lacks what it is to replace."""
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
    means="A file says when a camera was exposed, and where it was then.",
    effect="Its times, and its positions unless times_only, are used.",
    remedy="Nothing.",
)


def events_positions(*, where: str, count: int, name: str, camera: str, places: str) -> Message:
    """A file gives the exposures of a camera."""
    return note(
        EVENTS_POSITIONS,
        "{name} says when {camera} was exposed{places}",
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
        "Roles are taken from the vehicle whose events are used, or whose channels are named; "
        "refused where neither says which vehicle flew the mission."
    ),
    remedy="Name the events of one vehicle, or its log.channels.position.",
)


def vehicles_ambiguous(*, vehicles: Sequence[str], reason: str) -> MissionError:
    """Neither events nor named channels say which vehicle flew the mission."""
    contradiction = f"; {reason} are named of several" if reason else ""
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
    """Of several vehicles of a log one flew the mission."""
    return note(
        LOG_VEHICLES,
        "of {listed} the roles are those of {vehicle}, as {channel} is used",
        where="log",
        count=len(vehicles),
        listed=", ".join(vehicles),
        vehicle=vehicle,
        channel=channel,
    )


LOG_VEHICLES_MIXED = Code(
    "LOG-VEHICLES-MIXED",
    means="A channel that is named is of another vehicle than the events.",
    effect="It is used as stated; the run ends with 3.",
    remedy="Name the channel of the vehicle whose events are used; or accept it with the reason.",
)


def role_of_another_vehicle(*, role: str, channel: str, other: str, vehicle: str) -> Message:
    """The mission file names a channel of another vehicle."""
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
    """A part of the mission file that its model requires is not there."""
    return MissionError(
        EVENTS_NONE,
        "the mission names no {what}",
        where=where,
        what=what,
        remedy="give events, or stations.orientation",
    )


EVENTS_CAMERA = Code(
    "EVENTS-CAMERA",
    means="The table of events names a camera that the mission file does not define.",
    effect="The mission is refused.",
    remedy="Mend the name in the table, or define it under cameras.",
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
        "lever_arm_m is from_events, and the file of events has no offsets: only .MRK files have."
    ),
    effect="The mission is refused.",
    remedy="Give stations.trajectory.lever_arm_m in metres.",
)


def events_without_offsets(*, where: str) -> MissionError:
    """A file has no offsets from the antenna to the camera."""
    return MissionError(
        EVENTS_OFFSETS,
        "it has no offsets from the antenna to the camera: only .MRK files have",
        where=where,
        remedy="give stations.trajectory.lever_arm_m in metres",
    )


EVENTS_ORDER = Code(
    "EVENTS-ORDER",
    means="The numbers of a file of exposures fall as time goes on.",
    effect="A refusal where images are named by them, else a warning.",
    remedy="Put the rows in the order of their time, or name the images by {n}.",
)


def numbers_fall(*, where: str, count: int) -> MissionError:
    """Images named by numbers that fall as time goes on."""
    return MissionError(
        EVENTS_ORDER,
        (
            "{count} of its numbers fall as time goes on: the images that are named by them would "
            "be in another order than their exposures"
        ),
        one=(
            "1 of its numbers falls as time goes on: the images that are named by them would be "
            "in another order than their exposures"
        ),
        where=where,
        count=count,
        remedy=(
            "put the rows in the order of their time; or name the images by {{n}}, counted in the "
            "order of time"
        ),
    )


def most_numbers_fall(*, where: str, count: int, total: int) -> Message:
    """Most numbers or names fall as time goes on."""
    return warning(
        EVENTS_ORDER,
        (
            "{count} of {total} numbers or names fall as time goes on: images may be in the other "
            "order than their exposures"
        ),
        one=(
            "1 of {total} numbers or names falls as time goes on: images may be in the other "
            "order than their exposures"
        ),
        where=where,
        count=count,
        total=total,
    )


AIR_NOT_ADJUSTED = Code(
    "AIR-NOT-ADJUSTED",
    means="atmosphere.adjust is false: the standard atmosphere was kept as it is.",
    effect="No measurement of the air was used.",
    remedy="Remove adjust: false to use what was measured.",
)


def air_not_adjusted() -> Message:
    """The standard atmosphere is kept as it is."""
    return note(
        AIR_NOT_ADJUSTED,
        "atmosphere.adjust is false: the standard atmosphere is kept",
    )


AIR_SOURCES_UNUSED = Code(
    "AIR-SOURCES-UNUSED",
    means="Soundings, reports or calibrations are given, but atmosphere.adjust is false.",
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


def flight_without_time(*, where: str) -> InputError:
    """No station has a time and a place to take a weather model at."""
    return InputError(
        MODEL_TIME,
        "no station has a UTC and a place to take the weather model at",
        where=where,
        remedy="give the day and hour: stations.orientation.date; a log has to have UTC",
    )


FLIGHT_UNDATED = Code(
    "FLIGHT-UNDATED",
    means="Neither the log nor the mission file says when the flight was.",
    effect="No season is assumed: the climatology has the spread of the whole year.",
    remedy="State mission.date.",
)


def flight_undated() -> Message:
    """No exposure has a UTC, and the mission file states no date."""
    return fallback(
        FLIGHT_UNDATED,
        "no exposure has a UTC, and no date is stated: the climatology has the spread of the whole "
        "year (mission.date)",
    )


def sources_of_undated_flight(*, where: str) -> InputError:
    """Soundings or reports are named, and the day of the flight is not known."""
    return InputError(
        FLIGHT_UNDATED,
        "the flight has neither UTC nor a stated date: how old the soundings and surface reports "
        "are is unknown",
        where=where,
        remedy="state mission.date, as 2026-05-14 or 2026-05-14T10:20",
    )


DATE_CONTRADICTED = Code(
    "DATE-CONTRADICTED",
    means="The date that the mission file states is not that of the exposures.",
    effect="The exposures count.",
    remedy="Correct mission.date or stations.orientation.date, or check the clock of the log.",
)


def date_contradicted(*, stated: str, flown: str) -> Message:
    """A stated date is more than a day and a half from the exposures."""
    return warning(
        DATE_CONTRADICTED,
        "the mission file states {stated}, and the exposures are of {flown}, which counts",
        where="mission.date",
        stated=stated,
        flown=flown,
    )


MODEL_COLUMN = Code(
    "MODEL-COLUMN",
    means=(
        "The column of a weather model was taken at the place and time where the flight met its "
        "air."
    ),
    effect="It is a source of the air, beside the flight's own sensors.",
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
        "The temperature of a weather station is not one of this place and season, as of "
        "Fahrenheit taken for Celsius."
    ),
    effect="The mission is refused.",
    remedy="Give temperature_c in Celsius; check station and date.",
)


def surface_temperature_unlikely(
    *, where: str, celsius: float, height_m: float, sigmas: float, expected_c: float, rather: str
) -> InputError:
    """A temperature that the climatology rules out."""
    return InputError(
        SURFACE_CLIMATE,
        (
            "{celsius:.1f} C at {height_m:.0f} m is {sigmas:.1f} sigma from the {expected_c:.0f} "
            "C of the climatology{rather}"
        ),
        where=where,
        celsius=celsius,
        height_m=height_m,
        sigmas=sigmas,
        expected_c=expected_c,
        rather=rather,
        remedy=(
            "temperature_c is in Celsius: convert Fahrenheit by (F - 32) / 1.8, Kelvin by K - "
            "273.15; or the station or the date is another; a METAR is taken as it is"
        ),
    )


SURFACE_LEVEL = Code(
    "SURFACE-LEVEL",
    means=(
        "The pressure of a station does not belong to its height: it may have been reduced to sea "
        "level."
    ),
    effect="The mission is refused.",
    remedy="pressure_hpa is what the barometer shows there; give QNH as a metar.",
)


def surface_pressure_unlikely(
    *, where: str, hpa: float, height_m: float, sigmas: float, expected_hpa: float, rather: str
) -> InputError:
    """A pressure that the climatology rules out."""
    return InputError(
        SURFACE_LEVEL,
        (
            "{hpa:.1f} hPa at {height_m:.0f} m is {sigmas:.1f} sigma from the {expected_hpa:.0f} "
            "hPa of the climatology{rather}"
        ),
        where=where,
        hpa=hpa,
        height_m=height_m,
        sigmas=sigmas,
        expected_hpa=expected_hpa,
        rather=rather,
        remedy=(
            "pressure_hpa is what the barometer shows at h_msl_m, not reduced to sea level; give "
            "QNH as a metar, or correct h_msl_m"
        ),
    )


CABIN_BOARD = Code(
    "CABIN-BOARD",
    means="The temperature in the cabin is that of a barometer's circuit board, less 10 K.",
    effect="Allowed substitute, with a sigma of 6 K.",
    remedy="Name a thermometer as log.channels.cabin_temperature, or state temperature_c.",
)


def cabin_board(*, where: str, count: int, name: str, warmer: float, sigma: float) -> Message:
    """The board of a barometer stands for the air in the cabin."""
    return fallback(
        CABIN_BOARD,
        (
            "the temperature of the cabin is that of the board of {name}, less {warmer:.0f} +- "
            "{sigma:.0f} K"
        ),
        where=where,
        count=count,
        name=name,
        warmer=warmer,
        sigma=sigma,
    )


CABIN_DRY = Code(
    "CABIN-DRY",
    means="The cabin has no humidity.",
    effect="Its air is taken as dry; vapour changes its refractivity by up to 0.4 %.",
    remedy="State relative_humidity under window.cabin, if it is known.",
)


def cabin_dry(*, where: str, count: int) -> Message:
    """The air of a cabin is taken as dry."""
    return fallback(
        CABIN_DRY,
        "no humidity in the cabin for {count} exposures: its air is taken as dry",
        one="no humidity in the cabin for 1 exposure: its air is taken as dry",
        where=where,
        count=count,
    )


CABIN_IMPLAUSIBLE = Code(
    "CABIN-IMPLAUSIBLE",
    means=(
        "The air in the cabin is outside what people and electronics fly in; or the mission file "
        "gives it the pressure outside, and a barometer contradicts that."
    ),
    effect="It was used as stated; as a finding the run ends with 3.",
    remedy="Check the channel, its unit, and cameras.<name>.window.cabin.pressure.",
)


def cabin_implausible(
    *, where: str, count: int, name: str, oddity: str, hpa: float, celsius: float
) -> Message:
    """Pressure or temperature are those of no cabin."""
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
    """A cabin said to be open has much more pressure than the air outside."""
    return finding(
        CABIN_IMPLAUSIBLE,
        (
            "the cabin of {camera} is said to have the pressure of the air outside, but {name} "
            "has {hpa:.0f} hPa more than that at the exposures: if it is in the cabin, give "
            "pressure: log"
        ),
        where=where,
        count=count,
        camera=camera,
        name=name,
        hpa=hpa,
    )


CABIN_MISSING = Code(
    "CABIN-MISSING",
    means="Exposures of a camera behind a plane window have no cabin pressure.",
    effect="These stations are suspect: the window cannot be corrected.",
    remedy=(
        "Name log.channels.cabin_pressure, or state the pressure under cameras.<name>.window.cabin."
    ),
)

CABIN_SCHEDULE = Code(
    "CABIN-SCHEDULE",
    means=(
        "The cabin's air is Gyer's usual schedule, not measured: as outside to 3 km, then 701.2 "
        "hPa."
    ),
    effect="R_cc follows from it; dry air of 21.1 degC.",
    remedy="Nothing; log or state the cabin's pressure for better.",
)


def cabin_schedule(*, where: str) -> Message:
    """The cabin's air is that of a schedule."""
    return note(
        CABIN_SCHEDULE,
        (
            "the cabin's air is Gyer's schedule, dry and not measured: as outside to 3 km "
            "pressure altitude, then 701.2 hPa; 21.1 degC"
        ),
        where=where,
    )


CABIN_SCHEDULE_HIGH = Code(
    "CABIN-SCHEDULE-HIGH",
    means="Exposures lie above 10 km, where the schedule of the cabin's pressure ends.",
    effect="701.2 hPa are taken there too.",
    remedy="State the pressure under cameras.<name>.window.cabin.",
)


def cabin_schedule_high(*, where: str, count: int) -> Message:
    """Exposures above the schedule of the cabin's pressure."""
    return warning(
        CABIN_SCHEDULE_HIGH,
        (
            "{count} exposures lie above 10 km, where the schedule of the cabin's pressure ends; "
            "701.2 hPa are taken there too"
        ),
        one=(
            "1 exposure lies above 10 km, where the schedule of the cabin's pressure ends; 701.2 "
            "hPa are taken there too"
        ),
        where=where,
        count=count,
    )


CABIN_TEMPERATURE = Code(
    "CABIN-TEMPERATURE",
    means="Exposures have no temperature in the cabin.",
    effect=(
        "21 degC are taken, with a sigma of 5 K (10 K where the cabin is not pressurised). A loss "
        "where temperature_c is log."
    ),
    remedy="Name log.channels.cabin_temperature, or state temperature_c.",
)

CALIBRATION_IN_FLIGHT = Code(
    "CALIBRATION-IN-FLIGHT",
    means=(
        "The camera was calibrated in flight on images with refraction in. Its principal distance "
        "and k1 already contain the nadir refraction of that height."
    ),
    effect="The correction counts it twice in nadir images.",
    remedy="Use a laboratory calibration, or calibrate on corrected observations.",
)


def calibration_in_flight(*, where: str, name: str) -> Message:
    """A camera was calibrated in flight on uncorrected images."""
    return warning(
        CALIBRATION_IN_FLIGHT,
        (
            "camera {name} was calibrated in flight on uncorrected images: its principal distance "
            "and k1 already contain the nadir refraction of that height, and this correction "
            "counts it twice"
        ),
        where=where,
        name=name,
    )


LENS_CHANGE = Code(
    "LENS-CHANGE",
    means=(
        "The air in the lens would change the principal distance by more than 1 %, which no air "
        "does."
    ),
    effect="The mission is refused.",
    remedy="Check the unit of dc_dp_px_per_hpa and dc_dt_px_per_k: pixels, not millimetres.",
)


def lens_change_absurd(
    *, where: str, name: str, change: float, principal_distance_px: float, hpa: float
) -> MissionError:
    """A change of the principal distance that no air makes."""
    return MissionError(
        LENS_CHANGE,
        (
            "the air in the lens would change the principal distance of {name} by {change:.1f} px "
            "of {principal_distance_px:.1f} at {hpa:.0f} hPa; more than 1 % is no effect of air"
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
    means="By how much the air in the lens changes the principal distance.",
    effect="It is removed.",
    remedy="Nothing.",
)


def lens_in_air(
    *, where: str, count: int, name: str, low: float, high: float, principal_distance_px: float
) -> Message:
    """How much the air in a lens changes its principal distance."""
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


LENS_NOT_REMOVED = Code(
    "LENS-NOT-REMOVED",
    means=(
        "The effect of the air in the lens on the principal distance is not removed: 130 to 310 "
        "ppm at 6 km on a 153 mm lens, about in proportion to the height."
    ),
    effect="It stays in the coordinates.",
    remedy="State cameras.<name>.principal_distance if the lens was measured.",
)


def lens_not_removed(*, where: str, count: int, names: str) -> Message:
    """Cameras whose principal distance is not corrected for the air in the lens."""
    return note(
        LENS_NOT_REMOVED,
        (
            "the effect of the air in the lens on the principal distance of {names} is not "
            "removed: 130 to 310 ppm at 6 km (Meier), about in proportion to the height"
        ),
        where=where,
        count=count,
        names=names,
    )


WINDOW_SPHERICAL = Code(
    "WINDOW-SPHERICAL",
    means="The window is a sphere about the projection centre.",
    effect="It bends nothing.",
    remedy="Nothing.",
)


def window_spherical(*, where: str, name: str) -> Message:
    """A window that bends nothing."""
    return note(
        WINDOW_SPHERICAL,
        "the window of {name} is a sphere about the projection centre: it bends nothing",
        where=where,
        name=name,
    )


WINDOW_GLASS = Code(
    "WINDOW-GLASS",
    means=(
        "Whether the calibration contains the displacement of rays by the window glass: 7 mm for "
        "20 mm of glass at 45 degrees."
    ),
    effect="What is not in the calibration stays in the coordinates.",
    remedy="State in_calibration: glass, if the camera was calibrated through the window.",
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
    means="Stations lie outside the elevation model.",
    effect="A refusal where all do, else a loss.",
    remedy="Check ground.height.dem, and its crs.",
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
    """No station lies on the elevation model."""
    return MissionError(
        DEM_OUTSIDE,
        (
            "{count} of {count} stations lie outside the elevation model, which has {rows} rows "
            "and {columns} columns: the first, at {north:.4f}, {east:.4f}, would be in row "
            "{row:.0f}, column {column:.0f}"
        ),
        one=(
            "the only station lies outside the elevation model, which has {rows} rows and "
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
        remedy="check ground.height.dem, and ground.height.crs where the file has none",
    )


def stations_off_model(*, where: str, count: int, total: int) -> Message:
    """Some stations lie outside the elevation model."""
    return loss(
        DEM_OUTSIDE,
        "{count} of {total} stations lie outside the elevation model",
        one="1 of {total} stations lies outside the elevation model",
        where=where,
        count=count,
        total=total,
    )


SIGMA_UNKNOWN = Code(
    "SIGMA-UNKNOWN",
    means="Standard deviations of some causes are not known.",
    effect="What they do to the corrections is not in the sigma columns.",
    remedy="State them in the mission file.",
)


def sigmas_unknown(*, where: str, count: int, missing: str) -> Message:
    """Standard deviations that are missing from the sigma columns."""
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
    means="Slant ranges are zero, negative, infinite or no number.",
    effect="They are taken as absent.",
    remedy="Mend the column, if they matter.",
)


def slant_ranges_invalid(*, where: str, count: int) -> Message:
    """Slant ranges that are none."""
    return warning(
        OBS_DISTANCE,
        "slant ranges that are zero, negative, infinite or no number: {count}, taken as absent",
        where=where,
        count=count,
    )


OBS_SIGMA = Code(
    "OBS-SIGMA",
    means="Standard deviations of ground heights are negative, infinite or no number.",
    effect="They are taken as unknown.",
    remedy="Mend the column.",
)


def ground_sigmas_invalid(*, where: str, count: int) -> Message:
    """Standard deviations of ground heights that are none."""
    return warning(
        OBS_SIGMA,
        (
            "{count} standard deviations of ground heights are negative, infinite or no number: "
            "taken as unknown"
        ),
        one=(
            "1 standard deviation of a ground height is negative, infinite or no number: taken as "
            "unknown"
        ),
        where=where,
        count=count,
    )


OBS_GROUND_RANGE = Code(
    "OBS-GROUND-RANGE",
    means="Heights of points are below -600 or above 10000 m.",
    effect="They are taken as unknown; these rows are no_ground.",
    remedy="Check the unit and the column of ground.height.",
)


def ground_heights_invalid(*, where: str, count: int, low: float, high: float) -> Message:
    """Heights of points that no ground has."""
    return loss(
        OBS_GROUND_RANGE,
        (
            "heights of points below {low:.0f} or above {high:.0f} m, where no ground is: "
            "{count}, taken as unknown, their points are no_ground"
        ),
        where=where,
        count=count,
        low=low,
        high=high,
    )


POINTS_MISSING = Code(
    "POINTS-MISSING",
    means="Observations are of points that the table does not have.",
    effect="These rows are no_ground; refused where none is there.",
    remedy="Write the names as in the observations, or name their column.",
)


def points_missing(*, where: str, count: int, rows: int) -> Message:
    """Observations of points that the table of object points has not."""
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


OBS_FLAGGED = Code(
    "OBS-FLAGGED",
    means=("Observations have a status other than ok; the entry names it, and the likely cause."),
    effect="Their corrected values are null; the run ends with 3.",
    remedy="Follow the cause that the entry names.",
)


def observations_flagged(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Observations that are not corrected."""
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
    means="Rays pass the height of their point twice, and the near crossing was used.",
    effect="Corrected, with status beyond_grazing; the run ends with 3.",
    remedy="Give slant ranges (observations.columns.distance_m) to decide.",
)


def observations_beyond_grazing(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Observations that graze the ground."""
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
    means="Rays meet their point at the far crossing, by its slant range.",
    effect="Corrected, with status far_branch.",
    remedy="Nothing.",
)


def observations_on_far_branch(
    *, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Observations on the far branch by their slant range."""
    return note(
        OBS_FAR_BRANCH,
        "{count} of {total} observations are {status}{cause}{examples}, by their slant range",
        one="1 of {total} observations is {status}{cause}{examples}, by their slant range",
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


OBS_SEVERAL_CROSSINGS = Code(
    "OBS-SEVERAL-CROSSINGS",
    means=(
        "Rays would leave the ground again behind a ridge; the first place where they meet it was "
        "used."
    ),
    effect="Corrected, with status several_crossings.",
    remedy="Check points behind ridges; an error of the model's heights may change them.",
)


def several_crossings(
    *, where: str, count: int, total: int, status: str, cause: str, examples: str
) -> Message:
    """Rays that meet the elevation model several times."""
    return warning(
        OBS_SEVERAL_CROSSINGS,
        (
            "{count} of {total} observations are {status}{cause}{examples}: behind a ridge they "
            "would leave the ground again; the first place where they meet it was used, which an "
            "error of the model's heights may change"
        ),
        one=(
            "1 of {total} observations is {status}{cause}{examples}: behind a ridge it would "
            "leave the ground again; the first place where it meets it was used, which an error "
            "of the model's heights may change"
        ),
        where=where,
        count=count,
        total=total,
        status=status,
        cause=cause,
        examples=examples,
    )


def cabin_pressure_missing(*, where: str, count: int, reason: str) -> Message:
    """The pressure of a cabin is to come from the log, which has none; ``reason`` says so."""
    return loss(
        CABIN_MISSING,
        "{count} exposures have {reason}",
        one="1 exposure has {reason}",
        where=where,
        count=count,
        reason=reason,
    )


def cabin_temperature_assumed(*, kind: Kind, where: str, count: int, able: str) -> Message:
    """No thermometer is in the cabin; a loss where the mission file says that one is logged."""
    return message(
        kind,
        CABIN_TEMPERATURE,
        (
            "{count} exposures have no cabin temperature: 21 degC are taken, +- 5 K where the "
            "cabin is pressurised, +- 10 K where it is not; {able}"
        ),
        one=(
            "1 exposure has no cabin temperature: 21 degC are taken, +- 5 K where the cabin is "
            "pressurised, +- 10 K where it is not; {able}"
        ),
        where=where,
        count=count,
        able=able,
    )


OBS_UNIT = Code(
    "OBS-UNIT",
    means=(
        "The coordinates of the observations are not in the unit that the mission file states: "
        "pixels count from a corner of the image and are not negative, millimetres lie within the "
        "format of the camera."
    ),
    effect="The mission is refused.",
    remedy=(
        "State observations.unit: mm or um, with the metric report of the camera, which says where "
        "they count from and along which axes; or name the columns that have pixels."
    ),
)


def coordinates_without_pixels(
    *, where: str, percent: float, largest: float, likely: str
) -> InputError:
    """Coordinates that are negative as often as not are no pixels."""
    return InputError(
        OBS_UNIT,
        (
            "x and y are negative in {percent:.0f} % of the observations or more, and {largest:.6g}"
            " at most: these are not pixels from a corner of the image, but perhaps {likely} from "
            "its middle"
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
    """Coordinates in a stated unit lie outside the image."""
    return InputError(
        OBS_UNIT,
        "taken for {unit}, {percent:.0f} % of the observations lie outside the image",
        where=where,
        unit=unit,
        percent=percent,
        remedy=(
            "check observations.unit, and pixel_um, origin and axes under cameras.<name>.metric"
        ),
    )
