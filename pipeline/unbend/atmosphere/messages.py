"""Messages of atmosphere: what each code means, and the words of what is sent."""

from unbend.errors import Code, InputError, PhysicsError
from unbend.messages import Message, fallback, note, warning

AIR_AGED = Code(
    "AIR-AGED",
    means=(
        "Some exposures were made more than half an hour before or after the air at their heights "
        "was sampled, or more than 18 km from that place."
    ),
    effect="The sigmas of the air of these exposures grow with that time and distance.",
    remedy="Climb or descend through the air more often, or add a sounding of the time and place.",
)


def air_aged(*, hours: float, height_m: float, count: int, km: float = 0.0) -> Message:
    """The air of ``count`` exposures was sampled up to ``hours`` apart and ``km`` away."""
    far = f", and up to {km:.0f} km from that place" if km > 0.0 else ""
    return note(
        AIR_AGED,
        (
            "some exposures were made {hours:.1f} h before or after the air at {height_m:.0f} m "
            f"was sampled{far}: the sigmas of the air grow with this time"
        ),
        hours=hours,
        height_m=height_m,
        count=count,
        km=km,
    )


AIR_BY_PLACE = Code(
    "AIR-BY-PLACE",
    means=(
        "The flight is longer than 30 km or two hours, and the weather model's air differs along "
        "it."
    ),
    effect=(
        "Each exposure has the profile of its place and time: the measured profile, plus the "
        "change that the model gives between the two places and times."
    ),
    remedy="Nothing.",
)


def air_by_place(*, count: int, length_km: float, hours: float, percent: float) -> Message:
    """The flight is long, and the weather model's air differs along it."""
    return note(
        AIR_BY_PLACE,
        (
            "the weather model's air changes along {length_km:.0f} km and {hours:.1f} h: "
            "{count} profiles, R by up to {percent:.2f} %"
        ),
        one=(
            "the weather model's air changes along {length_km:.0f} km and {hours:.1f} h: "
            "1 profile, R by up to {percent:.2f} %"
        ),
        count=count,
        length_km=length_km,
        hours=hours,
        percent=percent,
    )


AIR_INDEX = Code(
    "AIR-INDEX",
    means="The name of a refractive index is unknown.",
    effect="The call is refused.",
    remedy="Take ciddor or gyer.",
)


def unknown_index(*, name: str, names: str) -> PhysicsError:
    """No refractive index has this name."""
    return PhysicsError(
        AIR_INDEX,
        "no refractive index is called {name!r}",
        remedy="one of {names}",
        name=name,
        names=names,
    )


AIR_WAVELENGTH = Code(
    "AIR-WAVELENGTH",
    means="The wavelength is outside the range of the formula of the refractive index.",
    effect="The call is refused.",
    remedy="Give the wavelength in metres, as 0.55e-6.",
)


def wavelength_outside_range(*, wavelength_m: float) -> PhysicsError:
    """The wavelength is outside the range of the formula of the refractive index."""
    return PhysicsError(
        AIR_WAVELENGTH,
        "a wavelength of {wavelength_m:g} m is outside 0.23e-6 to 2.0e-6 m",
        remedy="give the wavelength of vacuum in metres, for example 0.55e-6",
        wavelength_m=wavelength_m,
    )


AIR_WINDOW = Code(
    "AIR-WINDOW",
    means="One part of the flight had too little information for a separate estimate of the air.",
    effect="The air of the whole flight is used there.",
    remedy="Nothing.",
)


def air_window(*, when: str, reason: str) -> Message:
    """A part of the flight has no usable estimate of its own."""
    return fallback(
        AIR_WINDOW,
        "the air of the whole flight is used about {when}: {reason}",
        when=when,
        reason=reason,
    )


AIR_WINDOWS = Code(
    "AIR-WINDOWS",
    means=(
        "Whether the air changed during the flight was tested by estimating it in windows of time."
    ),
    effect=(
        "If the air changed, each exposure gets the air of its time. If not, one profile is used "
        "for all exposures."
    ),
    remedy="Nothing.",
)


def air_windows(*, hours: float, count: int, sigmas: float, largest: float) -> Message:
    """The air changed: each exposure gets the air of its window of time."""
    return note(
        AIR_WINDOWS,
        (
            "the air changes: {count} windows in {hours:.1f} h, R departs from that of the "
            "whole flight by up to {largest:.2f} %, RMS {sigmas:.1f} sigma"
        ),
        one=(
            "the air changes: 1 window in {hours:.1f} h, R departs from that of the whole"
            " flight by up to {largest:.2f} %, RMS {sigmas:.1f} sigma"
        ),
        hours=hours,
        count=count,
        sigmas=sigmas,
        largest=largest,
    )


def air_windows_none(*, hours: float) -> Message:
    """One profile is kept: no window has enough information of its own."""
    return note(
        AIR_WINDOWS,
        "one profile for {hours:.1f} h: no part of it has enough information",
        hours=hours,
    )


def air_windows_one(*, hours: float, total: int, sigmas: float, largest: float) -> Message:
    """One profile is kept: R changes too little between windows.

    ``largest`` [%]; ``sigmas`` is the RMS.
    """
    return note(
        AIR_WINDOWS,
        (
            "one profile for {hours:.1f} h: over {total} windows R changes by {largest:.2f} %"
            " at most, RMS {sigmas:.1f} sigma"
        ),
        hours=hours,
        total=total,
        sigmas=sigmas,
        largest=largest,
    )


ATMOSPHERE_LATITUDE = Code(
    "ATMOSPHERE-LATITUDE",
    means="A latitude is beyond the pole.",
    effect="The call is refused.",
    remedy="Give latitudes in radians there.",
)


def latitude_beyond_pole(*, latitude_rad: float) -> PhysicsError:
    """A latitude is beyond the pole; perhaps it is in degrees."""
    return PhysicsError(
        ATMOSPHERE_LATITUDE,
        "a latitude of {latitude_rad:g} rad is beyond the pole",
        remedy="give it in radians",
        latitude_rad=latitude_rad,
    )


ATMOSPHERE_MSIS = Code(
    "ATMOSPHERE-MSIS",
    means="The climatology nrlmsis2.1 needs the package pymsis, which is not installed.",
    effect="The mission is refused.",
    remedy='pip install "unbend[msis]", or take another climatology.',
)


def msis_not_installed() -> PhysicsError:
    """NRLMSIS is asked for, and its package is not there."""
    return PhysicsError(
        ATMOSPHERE_MSIS,
        "NRLMSIS 2.1 needs the package pymsis, which is not installed",
        remedy='pip install "unbend[msis]", or take another climatology',
    )


ATMOSPHERE_NAME = Code(
    "ATMOSPHERE-NAME",
    means="No standard atmosphere or climatology has this name.",
    effect="The command is refused.",
    remedy="Take one of the names that the refusal lists.",
)


def unknown_standard(*, name: str, names: str) -> PhysicsError:
    """No standard atmosphere has this name."""
    return PhysicsError(
        ATMOSPHERE_NAME,
        "no standard atmosphere is called {name!r}",
        remedy="one of {names}",
        name=name,
        names=names,
    )


def unknown_climatology(*, name: str, names: str) -> PhysicsError:
    """No climatology has this name."""
    return PhysicsError(
        ATMOSPHERE_NAME,
        "no climatology is called {name!r}",
        remedy="one of {names}",
        name=name,
        names=names,
    )


METAR_CONTRADICTION = Code(
    "METAR-CONTRADICTION",
    means="Two groups of the METAR contradict each other.",
    effect=(
        "The mission is refused, because the program would have to guess which of them is right."
    ),
    remedy=(
        "Compare the report with its source. Look for a wrong sign, a wrong digit, or groups of "
        "two reports."
    ),
)


def metar_contradiction(*, where: object, quantity: str, body: str, other: str) -> InputError:
    """Two groups of a METAR contradict each other."""
    return InputError(
        METAR_CONTRADICTION,
        "the {quantity} is {body} in the body and {other}",
        where=where,
        quantity=quantity,
        body=body,
        other=other,
        remedy=(
            "compare the report with its source: look for a wrong sign, a wrong digit, or groups "
            "of two reports"
        ),
    )


METAR_DEW_POINT = Code(
    "METAR-DEW-POINT",
    means="The dew point of the METAR is above its temperature, which is impossible.",
    effect=(
        "If it is above it by 1 degree or less, by rounding, the air is assumed to be saturated. "
        "If it is above it by more, the mission is refused."
    ),
    remedy=(
        "Check the report for a wrong digit, and whether temperature and dew point are exchanged: "
        "the temperature comes first."
    ),
)


def metar_dew_point(*, where: str, count: int, dew_c: float, celsius: float) -> Message:
    """The dew point of the METAR is above its temperature."""
    return warning(
        METAR_DEW_POINT,
        (
            "the dew point {dew_c:.1f} C is above the temperature {celsius:.1f} C: the air is "
            "assumed to be saturated"
        ),
        where=where,
        count=count,
        dew_c=dew_c,
        celsius=celsius,
    )


def metar_dew_point_impossible(
    *, where: str, dew_c: float, celsius: float, exchanged: str
) -> InputError:
    """The dew point of the METAR is above its temperature by more than rounding makes."""
    return InputError(
        METAR_DEW_POINT,
        (
            "the dew point {dew_c:.1f} C is above the temperature {celsius:.1f} C, which is "
            "impossible: perhaps the two are exchanged"
        ),
        where=where,
        dew_c=dew_c,
        celsius=celsius,
        exchanged=exchanged,
        remedy=(
            "write the temperature first, then the dew point: {exchanged} if they are exchanged; "
            "or correct the wrong digit or sign"
        ),
    )


METAR_GROUPS = Code(
    "METAR-GROUPS",
    means="Groups of the METAR were not understood, or have the letter O where a zero belongs.",
    effect="The former are not used. The latter are used with a zero.",
    remedy="Nothing, unless temperature or pressure is among them: then check the report.",
)


def metar_groups(*, where: str, count: int, groups: str) -> Message:
    """Groups of a METAR that were not understood, or were read with a zero for the letter O."""
    return note(METAR_GROUPS, "{groups}", where=where, count=count, groups=groups)


METAR_MISSING = Code(
    "METAR-MISSING",
    means="A quantity of the METAR cannot be read.",
    effect="It is not used.",
    remedy="Check the report.",
)


def metar_missing(
    *, where: str, count: int, quantities: str, report: str, dew_point_alone: bool
) -> Message:
    """Quantities of a METAR are missing or cannot be read.

    ``dew_point_alone``: whether there is a dew point without a temperature.
    """
    text = "no {quantities} can be read in {report!r}"
    if dew_point_alone:
        text += "; without the temperature, the dew point gives no humidity"
    return fallback(
        METAR_MISSING, text, where=where, count=count, quantities=quantities, report=report
    )


METAR_PARSE = Code(
    "METAR-PARSE",
    means=(
        "The text is not a METAR, contains several reports, or has neither a temperature nor an "
        "altimeter setting."
    ),
    effect="The mission is refused.",
    remedy=(
        "Give one report, as the station sent it. Several reports are several entries of "
        "atmosphere.surface."
    ),
)


def metar_parse(*, where: object, why: str) -> InputError:
    """A text cannot be read as a METAR; ``why`` says what is wrong."""
    return InputError(
        METAR_PARSE,
        "{why}",
        where=where,
        why=why,
        remedy="give it as the station sent it: METAR EDDF 221150Z 24011KT 9999 SCT040 12/08 Q1013",
    )


def metar_several(*, where: object, total: int) -> InputError:
    """A text contains several reports."""
    return InputError(
        METAR_PARSE,
        "the text contains {total} reports: which of them is meant?",
        where=where,
        total=total,
        remedy="give one report for each entry of atmosphere.surface",
    )


METAR_RANGE = Code(
    "METAR-RANGE",
    means="A value of the METAR does not occur at the ground.",
    effect="The mission is refused.",
    remedy="Check whether a digit is missing.",
)


def metar_range(*, where: object, quantity: str, number: float, unit: str) -> InputError:
    """A value of the METAR does not occur at the ground."""
    return InputError(
        METAR_RANGE,
        "the {quantity} is {number:.6g} {unit}, which does not occur at the ground",
        where=where,
        quantity=quantity,
        number=number,
        unit=unit,
        remedy="check whether a digit is missing",
    )


PROFILE_RANGE = Code(
    "PROFILE-RANGE",
    means="Heights are outside the profile.",
    effect="The call is refused.",
    remedy="Ask for heights inside it.",
)


def reference_height_outside_profile(*, height_m: float, where: str) -> PhysicsError:
    """A reference height of pressure is outside the profile; ``where`` describes the profile."""
    return PhysicsError(
        PROFILE_RANGE,
        "a reference height of {height_m:g} m is outside the profile",
        where=where,
        remedy="refer pressure to a height inside it",
        height_m=height_m,
    )


def heights_outside_profile(*, lowest_m: float, highest_m: float, where: str) -> PhysicsError:
    """Heights are outside the profile; ``where`` describes the profile."""
    return PhysicsError(
        PROFILE_RANGE,
        "heights of {lowest_m:.0f} to {highest_m:.0f} m are outside the profile",
        where=where,
        remedy="ask for heights inside it",
        lowest_m=lowest_m,
        highest_m=highest_m,
    )


SURFACE_EMPTY = Code(
    "SURFACE-EMPTY",
    means="A surface report has neither temperature nor pressure.",
    effect="The mission is refused.",
    remedy="Give temperature_c, pressure_hpa or a metar.",
)


def surface_empty(*, where: object) -> InputError:
    """A surface report has neither temperature nor pressure."""
    return InputError(
        SURFACE_EMPTY,
        "a surface report needs a temperature or a pressure",
        where=where,
        remedy="give temperature_c, pressure_hpa or a metar",
    )


SURFACE_HEIGHT = Code(
    "SURFACE-HEIGHT",
    means="The height of a weather station is not on the ground.",
    effect="The mission is refused.",
    remedy="Give its elevation in metres, -500 to 6000.",
)


def surface_height(*, where: object, height_m: float) -> InputError:
    """The height of a weather station is not on the ground."""
    return InputError(
        SURFACE_HEIGHT,
        "a station {height_m:g} m above the sea is not on the ground",
        where=where,
        height_m=height_m,
        remedy="give its elevation in metres, -500 to 6000",
    )


SURFACE_HUMIDITY = Code(
    "SURFACE-HUMIDITY",
    means="A relative humidity is not between 0 and 1.",
    effect="The mission is refused.",
    remedy="Give a fraction: 55 % is 0.55.",
)


def surface_humidity(*, where: object, humidity: float) -> InputError:
    """A relative humidity is not between 0 and 1."""
    return InputError(
        SURFACE_HUMIDITY,
        "a relative humidity of {humidity:g} is not between 0 and 1",
        where=where,
        humidity=humidity,
        remedy="give a fraction: 55 % is 0.55",
    )


SURFACE_PRESSURE = Code(
    "SURFACE-PRESSURE",
    means="The pressure is impossible at that height.",
    effect="The mission is refused.",
    remedy=(
        "pressure_hpa is the reading of the barometer at that height, in hPa, not reduced to sea "
        "level."
    ),
)


def surface_pressure(
    *, where: object, hpa: float, height_m: float, ratio: float, usual_hpa: float
) -> InputError:
    """The pressure is impossible at its height; ``ratio``: to the usual pressure there."""
    return InputError(
        SURFACE_PRESSURE,
        "{hpa:.2f} hPa at {height_m:.0f} m is {ratio:.3f} times the usual {usual_hpa:.0f} hPa",
        where=where,
        hpa=hpa,
        height_m=height_m,
        ratio=ratio,
        usual_hpa=usual_hpa,
        remedy=(
            "pressure_hpa is the reading of the barometer at that height, in hPa, not reduced to "
            "sea level"
        ),
    )


SURFACE_TEMPERATURE = Code(
    "SURFACE-TEMPERATURE",
    means="The temperature does not occur at the ground.",
    effect="The mission is refused.",
    remedy="Give temperature_c in Celsius.",
)


def surface_temperature(*, where: object, kelvin: float, celsius: float) -> InputError:
    """The temperature does not occur at the ground."""
    return InputError(
        SURFACE_TEMPERATURE,
        "{kelvin:.2f} K ({celsius:.2f} C) is not a temperature of air at the ground",
        where=where,
        kelvin=kelvin,
        celsius=celsius,
        remedy=(
            "temperature_c is in Celsius: convert Fahrenheit by (F - 32) / 1.8, Kelvin by"
            " K - 273.15"
        ),
    )
