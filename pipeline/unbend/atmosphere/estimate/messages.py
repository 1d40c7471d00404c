"""Messages of atmosphere/estimate: what each code means, and the words of what is sent."""

from unbend.errors import Code
from unbend.messages import Kind, Message, fallback, finding, loss, message, note, warning

AIR_ANCHOR = Code(
    "AIR-ANCHOR",
    means=(
        "The level of the profile's pressure follows the barometer outside. The entry "
        "gives its residuals and how far the pressure at sea level is from the "
        "climatology."
    ),
    effect=(
        "A note; from 5 sigma a warning, from 10 sigma a loss. From 10 sigma on, the barometer or "
        "its unit is wrong, and the air is wrong too."
    ),
    remedy="If it is a loss, check log.channels.pressure and its unit.",
)


def air_anchor(
    *,
    kind: Kind,
    where: str,
    count: int,
    sigmas: float,
    median: float,
    largest: float,
    at_sea: float,
) -> Message:
    """How well the profile's pressure fits the barometer: a note, a warning or a loss (``kind``).

    Residuals ``median``, ``largest`` and the pressure ``at_sea`` level [hPa]; ``sigmas``: distance
    of the latter from the climatology.
    """
    text = (
        "pressure anchored to {where}: residuals of {median:.2f} hPa in the median, "
        "{largest:.2f} hPa at most; {at_sea:.0f} hPa at sea level"
    )
    if kind is not Kind.NOTE:
        text += ", {sigmas:.0f} sigma from the climatology"
    if kind is Kind.LOSS:
        text += ": the barometer or its unit is wrong"
    return message(
        kind,
        AIR_ANCHOR,
        text,
        where=where,
        count=count,
        sigmas=sigmas,
        median=median,
        largest=largest,
        at_sea=at_sea,
    )


AIR_BAROMETRIC = Code(
    "AIR-BAROMETRIC",
    means=(
        "No thermometer outside could be used. Temperatures are derived from the fall of pressure "
        "with GNSS height."
    ),
    effect="Allowed substitute. The air is less certain than with a thermometer: see its sigmas.",
    remedy="Name a thermometer outside under log.channels.temperature, or add a sounding.",
)


def air_barometric(*, where: str, reason: str) -> Message:
    """Temperatures follow from the fall of pressure with height."""
    return fallback(AIR_BAROMETRIC, "{reason}", where=where, reason=reason)


AIR_CALIBRATED = Code(
    "AIR-CALIBRATED",
    means=(
        "The errors of sensors that are stated under atmosphere.sensors were subtracted from the "
        "readings."
    ),
    effect="The report lists the sensor errors that remain after this subtraction.",
    remedy="Nothing.",
)


def air_calibrated(*, where: str, count: int, biases: str) -> Message:
    """Errors of sensors that the mission file states were subtracted from the readings."""
    return note(
        AIR_CALIBRATED,
        "subtracted from the readings, as the mission file states: {biases}",
        where=where,
        count=count,
        biases=biases,
    )


AIR_CALIBRATION = Code(
    "AIR-CALIBRATION",
    means="The flight contradicts the stated calibration of a sensor by 4 sigma or more.",
    effect=(
        "The stated value was used. The air may be wrong by the difference. The run ends with exit "
        "code 3."
    ),
    remedy=(
        "Check atmosphere.sensors: the sign (reading minus air), the unit, and whether it is this "
        "sensor. Check the other sensors too."
    ),
)


def air_calibration(
    *,
    where: str,
    fault: str,
    sigmas: float,
    stated: float,
    prior: float,
    flown: float,
    sigma: float,
) -> Message:
    """The flight contradicts the stated calibration of a sensor by 4 sigma or more."""
    return finding(
        AIR_CALIBRATION,
        (
            "{fault}: {stated:.3g} ± {prior:.2g} in the mission file, {flown:.3g} ± {sigma:.2g} "
            "from the flight alone, {sigmas:.0f} sigma apart: one of the two is wrong, or another "
            "sensor is"
        ),
        where=where,
        fault=fault,
        sigmas=sigmas,
        stated=stated,
        prior=prior,
        flown=flown,
        sigma=sigma,
    )


AIR_CALIBRATION_UNUSED = Code(
    "AIR-CALIBRATION-UNUSED",
    means="A calibration is stated for an error, and no sensor in use has such an error.",
    effect="It was not used.",
    remedy="Remove it, or check which sensors were used, and why the other sensors were not used.",
)


def calibration_unused(*, where: str, count: int, faults: str) -> Message:
    """Calibrations are stated for errors that no sensor in use has."""
    return note(
        AIR_CALIBRATION_UNUSED,
        "no sensor in use has a {faults}",
        where=where,
        count=count,
        faults=faults,
    )


AIR_CONTRADICTED = Code(
    "AIR-CONTRADICTED",
    means=(
        "A surface report, or the lowest pressure of a sounding or model column, differs by 5 "
        "sigma or more from the other sources."
    ),
    effect=(
        "Robust weights give more influence to the other sources. One of these may be the flight's "
        "own sensor. The run ends with exit code 3."
    ),
    remedy=(
        "Check its height, unit and time. Check the barometer, its calibration and the heights of "
        "the log. Leave out the source that is wrong."
    ),
)


def air_contradicted(*, where: str, count: int, quantity: str, rms: float) -> Message:
    """The few readings of an external source differ by 5 sigma or more from other sources."""
    return finding(
        AIR_CONTRADICTED,
        (
            "{where} ({quantity}) differs by {rms:.1f} sigma from the other sources, and robust "
            "weights reduce its influence: it is wrong, or the flight's own sensor or heights are "
            "wrong"
        ),
        where=where,
        count=count,
        quantity=quantity,
        rms=rms,
    )


AIR_HUMIDITY_EXPECTED = Code(
    "AIR-HUMIDITY-EXPECTED",
    means="No humidity was measured outside.",
    effect=(
        "The humidity begins at that of the climatology, and other readings adjust it. Its effect "
        "on R is small, and the sigmas include it."
    ),
    remedy="Name a hygrometer under log.channels.humidity, or add a sounding.",
)


def air_humidity_expected() -> Message:
    """No humidity was measured outside."""
    return fallback(
        AIR_HUMIDITY_EXPECTED,
        "no humidity measured outside: the estimate begins at that of the climatology",
    )


AIR_HYGROMETER = Code(
    "AIR-HYGROMETER",
    means=(
        "A hygrometer reads a humidity that does not occur: a dew point above 35 C, or 4 sigma "
        "above the climatology; cloud over 1 km of air that cools too fast; or, below 3 km, never "
        "more than 1.1 %. The sensor is probably stuck, wet, or next to a warm board."
    ),
    effect=(
        "It is not used. The estimate begins at the humidity of the climatology. The run ends with "
        "exit code 3."
    ),
    remedy="Check the sensor and its unit (log.channels.humidity).",
)


def hygrometer_not_used(*, name: str, reason: str) -> Message:
    """A hygrometer reads more humid or drier air than is possible."""
    return loss(AIR_HYGROMETER, "{where} is not used: {reason}", where=name, reason=reason)


def hygrometer_too_dry(*, percent: float) -> str:
    """Why a hygrometer is not used: it reads dry air throughout."""
    return (
        f"its highest reading is {percent:.1f} % relative humidity: air near the ground is never "
        "so dry; the sensor is dead, or its fractions are read as per cent"
    )


def hygrometer_too_wet(*, percent: float, height_m: float, dew_c: float, limit_c: float) -> str:
    """Why a hygrometer is not used: no air has such a dew point."""
    return (
        f"{percent:.0f} % relative humidity at {height_m:.0f} m is a dew point of {dew_c:.1f} C; "
        f"dew points there do not exceed {limit_c:.1f} C"
    )


def hygrometer_in_no_cloud(
    *, percent: float, low_m: float, high_m: float, lapse: float, adiabat: float
) -> str:
    """Why a hygrometer is not used: saturated air would overturn; lapse rates in K/km."""
    return (
        f"{percent:.0f} % and more from {low_m:.0f} to {high_m:.0f} m, although temperature falls "
        f"by {lapse:.1f} K/km: saturated air is unstable from {adiabat:.1f} K/km on"
    )


AIR_IMPLAUSIBLE = Code(
    "AIR-IMPLAUSIBLE",
    means=(
        "The air that was estimated from a source is not physical, is too far from the "
        "climatology, or predicts readings that were left out worse than the climatology does."
    ),
    effect=(
        "That estimate is not used. The next best sources are used, or the climatology. The run "
        "ends with exit code 3."
    ),
    remedy="Check the unit and the place of the named sensor. The entry gives the reason.",
)


def air_implausible(*, sources: str, reason: str, sensor: str) -> Message:
    """Air that was estimated from some sources is not plausible; ``sensor`` is the main one."""
    return loss(
        AIR_IMPLAUSIBLE,
        "the air estimated from {sources} is not used: {reason}",
        where=sensor,
        sources=sources,
        reason=reason,
    )


def not_temperatures_of_air(*, lowest_k: float, highest_k: float) -> str:
    """Why air is not plausible: its temperatures are not those of air."""
    return f"temperatures of {lowest_k:.0f} to {highest_k:.0f} K are not those of air"


def far_from_climatology(*, kelvin: float, height_m: float, sigmas: float) -> str:
    """Why air is not plausible: it is far from the climatology of place and season."""
    return f"{kelvin:.0f} K at {height_m:.0f} m is {sigmas:.1f} sigma from the climatology"


def air_overturns(*, lapse: float, height_m: float) -> str:
    """Why air is not plausible: it would overturn. ``lapse``: its fall of temperature [K/km]."""
    return (
        f"temperature falls by {lapse:.1f} K/km above {height_m:.0f} m: air is unstable from 9.8 "
        "K/km on"
    )


def no_information(*, percent: float) -> str:
    """Why a barometer's air is not used: ``percent`` of the sigma of R remain."""
    return f"it has no information on temperature: {percent:.0f} % of the sigma of R remain"


def held_out_readings_differ(
    *, sensor: str, unit: str, name: str, by_estimate: float, by_background: float
) -> str:
    """Why air is not plausible: it predicts readings worse than its background (``name``) does."""
    return (
        f"readings of {sensor} that were not used in the estimate differ by {by_estimate:.2f} "
        f"{unit} from the estimate and by {by_background:.2f} {unit} from {name}"
    )


AIR_ISOTHERMAL = Code(
    "AIR-ISOTHERMAL",
    means=(
        "A thermometer is probably not, or only partly, in the air outside. Its temperatures "
        "change less with height than the air does, or they change with time, as in a bay or a "
        "cabin. The range of heights is too small for the barometer to decide."
    ),
    effect="Both cases are possible, so the sigma of the air is larger.",
    remedy="Name the thermometer outside, or this one as log.channels.cabin_temperature.",
)


def air_isothermal(*, where: str, extent: float, percent: float) -> Message:
    """A thermometer whose readings over a height are probably those of a bay or a cabin."""
    return warning(
        AIR_ISOTHERMAL,
        (
            "{where} is only partly in the air outside, or indoors, with a probability of "
            "{percent:.0f} % (from its temperatures over {extent:.0f} m of height): the sigma of "
            "the air covers both cases"
        ),
        where=where,
        extent=extent,
        percent=percent,
    )


AIR_MISFIT = Code(
    "AIR-MISFIT",
    means="The residuals of a source are larger than its errors explain.",
    effect="Its sigma is inflated if it has five readings or more. The estimate is kept.",
    remedy="Compare the source with the others in the report. Leave it out if it is wrong.",
)


def air_misfit(*, where: str, count: int, quantity: str, rms: float, inflation: float) -> Message:
    """The residuals of a source are larger than its errors explain."""
    return warning(
        AIR_MISFIT,
        (
            "residuals of {where} ({quantity}) are {rms:.1f} times larger than its errors explain: "
            "sigma inflation factor {inflation:.0f}"
        ),
        where=where,
        count=count,
        quantity=quantity,
        rms=rms,
        inflation=inflation,
    )


AIR_NO_BAROMETER = Code(
    "AIR-NO-BAROMETER",
    means="No log gives a usable static pressure of the air outside.",
    effect=(
        "The level of the pressure is taken from soundings and weather stations, or without any "
        "from the climatology. The entry names them."
    ),
    remedy=(
        "Name a barometer under log.channels.pressure. Without one, a report of a weather station "
        "near the flight is the best."
    ),
)


def air_no_barometer(*, source: str) -> Message:
    """The log has no usable static pressure outside."""
    return fallback(
        AIR_NO_BAROMETER,
        "no static pressure outside: the level of the pressure is taken from {source}",
        source=source,
    )


AIR_NOT_OUTSIDE = Code(
    "AIR-NOT-OUTSIDE",
    means="The pressure of a barometer does not follow GNSS height as the air outside does.",
    effect="It is not used for the air outside.",
    remedy=(
        "Name another barometer under log.channels.pressure, or this one as "
        "log.channels.cabin_pressure."
    ),
)


def air_not_outside(*, where: str, what_is_odd: str, extent: float) -> Message:
    """The pressure of a barometer does not follow GNSS height as the air outside does."""
    return loss(
        AIR_NOT_OUTSIDE,
        (
            "the pressure of {where} {what_is_odd} over {extent:.0f} m of GNSS height: it is not "
            "the pressure of the air outside, and is not used"
        ),
        where=where,
        what_is_odd=what_is_odd,
        extent=extent,
    )


AIR_OUTLIERS = Code(
    "AIR-OUTLIERS",
    means="Single readings are far from their neighbours in height and time.",
    effect="They are not used.",
    remedy="Nothing, if they are few.",
)


def air_outliers(*, where: str, count: int, total: int) -> Message:
    """Single readings are far from their neighbours in height and time."""
    return note(
        AIR_OUTLIERS,
        (
            "{count} of {total} readings are far from their neighbours in height and time and"
            " are not used"
        ),
        where=where,
        count=count,
        total=total,
    )


AIR_SENSORS = Code(
    "AIR-SENSORS",
    means=(
        "The flight determined errors of its sensors, such as bias or lag. The entry "
        "gives each with its sigma."
    ),
    effect=(
        "These errors were removed in the estimate. A warning if an error without a stated "
        "calibration is larger than two expected sigmas and one sigma of the estimate (for a "
        "static pressure: 1 % of its change, and three sigmas). Then this sensor is wrong, or the "
        "source that shows the error."
    ),
    remedy=(
        "Nothing for a note. For a warning, calibrate the sensor. Check the static port and its "
        "tubes for leaks, and check the heights."
    ),
)


def air_sensors(*, count: int, faults: str) -> Message:
    """Errors of sensors that the flight determined."""
    return note(AIR_SENSORS, "{faults}", count=count, faults=faults)


def air_sensors_large(*, count: int, faults: str) -> Message:
    """The flight determined an error that is larger than that of a working sensor."""
    return warning(
        AIR_SENSORS,
        "{faults}: larger than that of a working sensor, or another source is wrong",
        count=count,
        faults=faults,
    )


AIR_STANDARD = Code(
    "AIR-STANDARD",
    means=(
        "No measurement of the air could be used. The climatology or the standard atmosphere was "
        "kept."
    ),
    effect=(
        "Allowed substitute. The standard atmosphere left 0.3 to 21 % of the shift in nine real "
        "soundings, at 3 to 9 km: see the sigma of this air."
    ),
    remedy=(
        "Add a barometer and a thermometer outside, a sounding or a surface report. The entry "
        "gives the reason why each source was not used."
    ),
)


def air_standard(*, reason: str) -> Message:
    """No measurement of the air could be used."""
    return fallback(AIR_STANDARD, "{reason}", reason=reason)


AIR_STUCK = Code(
    "AIR-STUCK",
    means="A sensor gave exactly the same value over hundreds of metres of height: it is stuck.",
    effect="These readings are not used.",
    remedy="Check the sensor and its wiring.",
)


def air_stuck(*, where: str, count: int, value: float, extent: float, total: int) -> Message:
    """A sensor gave exactly the same value over hundreds of metres of height."""
    return loss(
        AIR_STUCK,
        (
            "{count} of {total} readings of {where} are exactly {value:.6g} over {extent:.0f}"
            " m of height: the sensor is stuck, and they are not used"
        ),
        where=where,
        count=count,
        value=value,
        extent=extent,
        total=total,
    )


AIR_THERMOMETER = Code(
    "AIR-THERMOMETER",
    means=(
        "A thermometer differs from the temperature that barometer and GNSS height imply, by 8 K "
        "in the mean or by 3.5 K in its change with height (more if the comparison is uncertain). "
        "Or no physical air fits both. Or it is in a bay with a probability of 99 %."
    ),
    effect="It is not used; the run ends with exit code 3.",
    remedy="Name the thermometer outside under log.channels.temperature, or check its unit.",
)


def thermometer_not_used(*, name: str, reason: str) -> Message:
    """A thermometer contradicts barometer and heights."""
    return loss(AIR_THERMOMETER, "{where} is not used: {reason}", where=name, reason=reason)


def thermometer_not_as_predicted(*, reads: str, departure_k: float, limit_k: float) -> str:
    """Why a thermometer is not used: an estimate without it predicts other temperatures."""
    return (
        f"it {reads} {departure_k:+.1f} K against the temperature that pressure and GNSS height "
        f"imply, limit {limit_k:.1f} K (log.channels.temperature)"
    )


def thermometer_in_a_bay(*, percent: float) -> str:
    """Why a thermometer is not outside: it is in a bay with a probability of ``percent``."""
    return (
        f"it is only partly in the air outside, or indoors, with a probability of {percent:.1f} % "
        "(log.channels.temperature)"
    )


def thermometer_contradicts_barometer(
    *, minutes: float, barometer: str, kelvin: float, limit_k: float
) -> str:
    """Why a thermometer is not used: within a short time no air has its readings."""
    return (
        f"its readings within {minutes:.0f} minutes, together with {barometer} against GNSS "
        f"height, fit physical air only with errors of {kelvin:.1f} K, limit {limit_k:.1f} K"
    )


def barometer_fits_other_temperatures(*, barometer: str, inflation: float, limit: float) -> str:
    """Why a thermometer is not used: the barometer fits plausible air of its own."""
    return (
        f"{barometer} against GNSS height fits plausible air, but with these temperatures only "
        f"with a sigma inflation factor of {inflation:.0f}, limit {limit:.0f}"
    )


AIR_UNSETTLED = Code(
    "AIR-UNSETTLED",
    means="The estimate of the air had not converged when it was stopped.",
    effect="It is used, although its last step was still large.",
    remedy="Report the log to the authors, and compare the profile with a sounding.",
)


def air_unsettled() -> Message:
    """The estimate of the air had not converged when it was stopped."""
    return warning(
        AIR_UNSETTLED,
        "the estimate did not converge: its last step was still large",
    )


METAR_FAR_IN_TIME = Code(
    "METAR-FAR-IN-TIME",
    means="The METAR is more than three hours away from the flight.",
    effect="It has less weight for this reason.",
    remedy="Give a report of the time of the flight.",
)


def metar_far_in_time(*, where: str, hours: float, doubt: str) -> Message:
    """The METAR is hours away from the flight; ``doubt``: words that the date may be wrong."""
    return warning(
        METAR_FAR_IN_TIME,
        "the report is {hours:.1f} hours away from the flight{doubt}",
        where=where,
        hours=hours,
        doubt=doubt,
    )


SOUNDING_FAR_AWAY = Code(
    "SOUNDING-FAR-AWAY",
    means="The sounding is more than 200 km from the flight.",
    effect="It has less weight for this reason. Too far away it is not used: AIR-SOURCE-FAR.",
    remedy="Give a nearer one, if there is one.",
)


def sounding_far_away(*, where: str, km: float, consequence: str) -> Message:
    """The sounding is far from the flight.

    ``consequence`` is a clause: what the distance does to its temperatures.
    """
    return warning(
        SOUNDING_FAR_AWAY,
        "the sounding is {km:.0f} km from the flight: {consequence}",
        where=where,
        km=km,
        consequence=consequence,
    )


SOUNDING_FAR_IN_TIME = Code(
    "SOUNDING-FAR-IN-TIME",
    means="A sounding is more than six hours away from the flight.",
    effect="It has less weight for this reason.",
    remedy="Give one of the time of the flight.",
)


def sounding_far_in_time(*, where: str, hours: float, doubt: str) -> Message:
    """A sounding is many hours from the flight; ``doubt``: words that the date may be wrong."""
    return warning(
        SOUNDING_FAR_IN_TIME,
        "the sounding is {hours:.0f} hours away from the flight{doubt}",
        where=where,
        hours=hours,
        doubt=doubt,
    )


SOUNDING_UNDATED = Code(
    "SOUNDING-UNDATED",
    means="The sounding has no time.",
    effect="It is assumed to be some hours from the flight, and has less weight.",
    remedy="Add time_utc, and mission.date if the log of the flight has no date.",
)


def sounding_undated(*, where: str, hours: float) -> Message:
    """The sounding has no time."""
    return fallback(
        SOUNDING_UNDATED,
        "the sounding has no time: it is assumed to be {hours:.0f} hours from the flight",
        where=where,
        hours=hours,
    )


SOUNDING_UNPLACED = Code(
    "SOUNDING-UNPLACED",
    means="The sounding has no position.",
    effect="It is assumed to be 100 km from the flight, or as far as the latitudes show.",
    remedy="Add latitude_deg and longitude_deg.",
)


def sounding_unplaced(*, where: str, km: float) -> Message:
    """The sounding has no position."""
    return fallback(
        SOUNDING_UNPLACED,
        "the sounding has no position: it is assumed to be {km:.0f} km from the flight",
        where=where,
        km=km,
    )


SURFACE_FAR_IN_TIME = Code(
    "SURFACE-FAR-IN-TIME",
    means="The report is more than three hours away from the flight.",
    effect="It has less weight for this reason.",
    remedy="Give a report of the time of the flight.",
)


def surface_far_in_time(*, where: str, hours: float, doubt: str) -> Message:
    """The report is hours away from the flight; ``doubt``: words that the date may be wrong."""
    return warning(
        SURFACE_FAR_IN_TIME,
        "the report is {hours:.1f} hours away from the flight{doubt}",
        where=where,
        hours=hours,
        doubt=doubt,
    )


SURFACE_UNDATED = Code(
    "SURFACE-UNDATED",
    means="The report has no time.",
    effect="It is assumed to be some hours from the flight, and has less weight.",
    remedy="Add time_utc, and mission.date if the log of the flight has no date.",
)


def surface_undated(*, where: str, hours: float) -> Message:
    """The report has no time."""
    return fallback(
        SURFACE_UNDATED,
        "the report has no time: it is assumed to be {hours:.0f} hours from the flight",
        where=where,
        hours=hours,
    )


AIR_SOURCE_FAR = Code(
    "AIR-SOURCE-FAR",
    means=(
        "A sounding or weather report is too old or too far away to have information on this "
        "flight's air."
    ),
    effect="It is not used. The run ends with exit code 3.",
    remedy=(
        "Give a report or sounding of the same day and region. If the mission file states the date "
        "of the flight, check it too."
    ),
)


def too_far_from_flight(*, away: str) -> str:
    """Why a source is not used: it is so many hours or kilometres ``away``."""
    return f"it is {away} from the flight: the climatology is as accurate"


def source_far(*, name: str, reason: str, doubt: str) -> Message:
    """A sounding or report has no information on the air of this flight.

    ``doubt``: words that the stated date of the flight may be wrong, or empty.
    """
    return loss(
        AIR_SOURCE_FAR,
        "{where} is not used: {reason}{doubt}",
        where=name,
        reason=reason,
        doubt=doubt,
    )


AIR_SOURCE_REFUSED = Code(
    "AIR-SOURCE-REFUSED",
    means=(
        "A sounding, model column or report contradicts the climatology (lowest pressure or "
        "temperatures by 4 sigma), the flight's own sensors (by 4.5 sigma and 2 K), or the "
        "other sources."
    ),
    effect="It is not used; the run ends with exit code 3.",
    remedy=(
        "Check its units, heights above sea level, time and place; and the sensors of the flight."
    ),
)


def source_refused(*, name: str, reason: str) -> Message:
    """A sounding, model column or report that contradicts others."""
    return loss(AIR_SOURCE_REFUSED, "{where} is not used: {reason}", where=name, reason=reason)


def level_far_from_climatology(
    *, hpa: float, height_m: float, sigmas: float, expected_hpa: float
) -> str:
    """Why a column is refused: its lowest pressure is far from the climatology."""
    return (
        f"{hpa:.1f} hPa at {height_m:.0f} m is {sigmas:.1f} sigma from the {expected_hpa:.1f} hPa "
        "of the climatology: its heights may be above the ground, or in feet"
    )


def column_far_from_climatology(*, kelvin: float, sigmas: float) -> str:
    """Why a column is refused: its temperatures are far from the climatology."""
    return (
        f"its temperatures are {kelvin:+.1f} K from the climatology of place and season, "
        f"{sigmas:.1f} sigma, in the mean of the lowest 3 km"
    )


def column_contradicts_flight(*, kelvin: float, sigmas: float, extent_m: float) -> str:
    """Why a column is refused: the flight's own sensors contradict its temperatures."""
    return (
        f"its temperatures are {kelvin:+.1f} K from those of the flight's own sensors, "
        f"{sigmas:.1f} sigma, in the mean of {extent_m:.0f} m of height: one of both is wrong"
    )
