"""What the text of a METAR or SPECI states, group by group (WMO-No. 306, FM 15; FMH-1).

A report begins with the station and the group of its day, hour and minute, ``LOWW 121150Z``. Text
before it is a heading of a bulletin or a date. The body ends at a trend or at the remarks.
"""

import math
import re
import warnings
from collections import Counter
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere import messages
from unbend.units import HECTOPASCAL

INCH_OF_MERCURY_PA = 3386.389
MOST_OF_ROUNDING_C = 1.0
"""Largest difference of whole degrees of the body from tenths of the remarks; rounding alone makes
0.5."""
MOST_BETWEEN_SETTINGS_PA = 200.0
"""Largest difference of altimeter settings in hPa and in inches: both are rounded down, by up to
1.0 and 0.3 hPa."""
FARTHEST_FROM_DATE = np.timedelta64(36, "h")  # from its noon: the day, the one before and after
LONGEST_TEXT = 2000  # characters of a report with all that archives write around it
EXCERPT = 80  # characters of a report that an error message shows

_STATION_AND_TIME = re.compile(r"(?<!\S)([A-Z][A-Z0-9]{3}) (?:COR )?(\d{6})(?=Z(?!\S))")
_STATION_AND_TIME_WITHOUT_Z = re.compile(r"(?<!\S)([A-Z][A-Z0-9]{3}) (?:COR )?(\d{6})(?!\S)")
_ANY_STAMP = re.compile(r"(?<!\S)\d{6}Z(?!\S)")
_NO_STAMP = re.compile(r"(?<!\S)\d+Z(?!\S)")
_OTHER_REPORTS = {
    "TAF": "a TAF, a forecast",
    r"\d{4}/\d{4}": "the period of a forecast",
    "AAXX": "a SYNOP",
    "BBXX": "a SYNOP of a ship",
}
"""Patterns of groups that no METAR has, and what they are."""
_YEAR_FIRST = re.compile(
    r"(?<!\d)(?P<year>(?:19|20)\d\d)(?P<parted>[-/.]?)(?P<month>\d\d)(?P=parted)(?P<day>\d\d)"
)
_DAY_FIRST = re.compile(r"(?<!\d)(?P<day>\d\d)\.(?P<month>\d\d)\.(?P<year>(?:19|20)\d\d)(?!\d)")
_YEAR = re.compile(r"(?<!\d)(?:19|20)\d\d(?!\d)")
_TREND = re.compile(r" (?:NOSIG|TEMPO|BECMG|INTER|FCST|PROB\d\d)(?!\S)")
_REMARKS = re.compile(r" RMKS?(?!\S)")
_TEMPERATURES = re.compile(r"(?<!\S)(M?\d{1,2}|//|XX|MM)/(M?\d{1,2}|//|XX|MM)?(?!\S)")
_TENTHS = re.compile(r"(?<!\S)T([01]\d{3})([01]\d{3})?(?!\S)")
_SETTING = re.compile(r"(?<!\S)(A|QNH|Q)([\dO]{4})(HPA|INS)?(?!\S)")
_MINUS_SIGN = re.compile(r"(?<=[\s/])-(?=\d{1,2}(?:/|\s|$))")


@dataclass(frozen=True)
class Metar:
    """What a report states; NaN, None or empty where it does not.

    ``altimeter_pa``: middle of the step to which the setting was rounded down [Pa]. ``in_tenths``:
    whether the temperature is that of a T group. ``stamp``: day of the month, hour and minute.
    ``date``: day that is written before the report. ``complaints``: on groups that were not
    understood.
    """

    text: str
    station: str
    temperature_c: float
    dew_point_c: float
    altimeter_pa: float
    in_tenths: bool
    stamp: tuple[int, int, int] | None
    date: np.datetime64 | None
    complaints: tuple[str, ...]


@dataclass(frozen=True)
class _Parts:
    """The parts of a text: what is before the report, its body and its remarks."""

    before: str
    body: str
    remarks: str


def has_report(line: str) -> bool:
    """Whether a line has station and time of a METAR, and is not a forecast or a SYNOP.

    >>> has_report("METAR LSZH 141020Z 24008KT CAVOK 18/07 Q1016"), has_report("image,x,y")
    (True, False)
    """
    flat = " ".join(re.split(r"[\s=;,\"]+", line.upper()))
    is_other = any(re.search(rf"(?<!\S){word}(?!\S)", flat) for word in _OTHER_REPORTS)
    return _STATION_AND_TIME.search(flat) is not None and not is_other


def decode_metar(text: str, where: str) -> Metar:
    """What the report in a text states; ``where`` is the place of the text, for error messages.

    Raises ``InputError``: METAR-PARSE if the text is not a METAR, a forecast, or several reports;
    METAR-CONTRADICTION if its groups contradict each other.

    >>> decode_metar("EDDF 221150Z 24011KT M05/M10 Q1013", "here").temperature_c
    -5.0
    """
    if len(text) > LONGEST_TEXT:
        why = f"it has {len(text)} characters"
        raise messages.metar_parse(where=f"{where}: {text[:EXCERPT]!r}", why=why)
    written = " ".join(text.split())
    flat = " ".join(re.split(r"[\s=;]+", written.upper())).strip()
    place = f"{where}: {written[:EXCERPT]!r}"
    for word, kind in _OTHER_REPORTS.items():
        if re.search(rf"(?<!\S){word}(?!\S)", flat):
            raise messages.metar_parse(where=place, why=f"the text contains {kind}")
    _refuse_several(flat, where)
    parts = _parts_of(flat)
    complaints, station = _checked_groups(parts.body, place)
    complaints += _letters_for_zeros(parts)
    whole = _TEMPERATURES.search(_with_signs(parts.body))
    tenths = _TENTHS.search(parts.remarks)
    temperature_c = _agreed_celsius("temperature", _field(whole, 1), _field(tenths, 1), place)
    dew_point_c = _agreed_celsius("dew point", _field(whole, 2), _field(tenths, 2), place)
    altimeter_pa = _agreed_setting(parts, place)
    if math.isnan(temperature_c) and math.isnan(altimeter_pa):
        why = "neither temperature nor altimeter setting is found"
        raise messages.metar_parse(where=place, why=": ".join([why, *complaints[:1]]))
    return Metar(
        text=written,
        station=station,
        temperature_c=temperature_c,
        dew_point_c=dew_point_c,
        altimeter_pa=altimeter_pa,
        in_tenths=tenths is not None,
        stamp=_stamp_of(parts.body, place),
        date=_date_before(parts.before, place),
        complaints=complaints,
    )


def _refuse_several(flat: str, where: str) -> None:
    """Raise ``InputError`` for a text with times, temperatures or settings of several reports."""
    body = _parts_of(flat).body
    temperatures = [
        group for group in _TEMPERATURES.findall(_with_signs(body)) if _has_digit(group)
    ]
    settings = Counter(letter for letter, _, _ in _SETTING.findall(body))
    counts = [
        len(_ANY_STAMP.findall(flat)),
        len(temperatures),
        len(_TENTHS.findall(flat)),
        *settings.values(),
    ]
    total = max(counts)
    if total > 1:
        raise messages.metar_several(where=where, total=total)


def _has_digit(fields: tuple[str, ...]) -> bool:
    """Whether any field of a group has a digit, so that the group is not a placeholder."""
    return any(character.isdigit() for field in fields for character in field)


def _parts_of(flat: str) -> _Parts:
    """The parts of a text with one report, ``flat``: in capitals, with single spaces.

    >>> _parts_of("SAOS31 LOWM 121150 METAR LOWW 121150Z 06/02 Q1026 NOSIG RMK A3030")
    _Parts(before='SAOS31 LOWM 121150 METAR ', body='LOWW 121150Z 06/02 Q1026', remarks=' A3030')
    """
    head = _STATION_AND_TIME.search(flat) or _STATION_AND_TIME_WITHOUT_Z.search(flat)
    begin = 0 if head is None else head.start()
    report = flat[begin:]
    remark = _REMARKS.search(report)
    remarks = "" if remark is None else report[remark.end() :]
    before_remarks = report if remark is None else report[: remark.start()]
    return _Parts(flat[:begin], _TREND.split(before_remarks, maxsplit=1)[0], remarks)


def _with_signs(body: str) -> str:
    """A body with M for each minus of its temperatures."""
    return _MINUS_SIGN.sub("M", body)


def _checked_groups(body: str, place: str) -> tuple[tuple[str, ...], str]:
    """Complaints on groups that the package ``metar`` does not know, and the station that it reads.

    ``place``: of the report, for error messages. Raises ``InputError`` where it cannot be parsed.
    """
    from metar.Metar import Metar as LibraryReport
    from metar.Metar import ParserError

    # strict=False: the package warns of a group that it cannot decode and continues, so that a
    # strange runway group does not lose the temperature after it.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            # With month and year the package does not guess them; January has all 31 days.
            usual_body = _SETTING.sub(_usual_setting, _with_signs(body))
            report = LibraryReport(usual_body, month=1, year=2000, strict=False)
        except (ParserError, ValueError, TypeError, ArithmeticError, LookupError) as error:
            why = f"the report does not parse: {error}"
            raise messages.metar_parse(where=place, why=why) from None
    if report.station_id is None:
        raise messages.metar_parse(where=place, why="no station is found")
    complaints = tuple(" ".join(str(warning.message).split()) for warning in caught)
    return complaints, str(report.station_id)


def _usual_setting(setting: re.Match[str]) -> str:
    """An altimeter setting as a METAR has it: QNH1016HPA is Q1016, QNH2992INS is A2992."""
    letter, digits, unit = setting.groups()
    if unit is None:
        return f"{letter[0]}{digits}"
    return f"A{digits}" if unit == "INS" else f"Q{digits}"


def _celsius(field: str | None) -> float:
    """Degrees Celsius from a field of whole degrees with M for minus; NaN if not reported.

    >>> _celsius("M05"), _celsius("//")
    (-5.0, nan)
    """
    if not field or not field[-1].isdigit():
        return math.nan
    return float(field.replace("M", "-"))


def whole_degrees(celsius: float) -> str:
    """Whole degrees in the notation of a METAR.

    >>> whole_degrees(17.2), whole_degrees(-5.0), whole_degrees(-0.3)
    ('17', 'M05', 'M00')
    """
    sign = "M" if celsius < 0.0 else ""
    return f"{sign}{round(abs(celsius)):02d}"


def _from_tenths(field: str | None) -> float:
    """Degrees Celsius from a field of a sign (1 for minus) and tenths; NaN without a field.

    >>> _from_tenths("1017"), _from_tenths("0128")
    (-1.7, 12.8)
    """
    if field is None:
        return math.nan
    tenths = int(field[1:])
    return (-tenths if field[0] == "1" else tenths) / 10.0


def _field(match: re.Match[str] | None, number: int) -> str | None:
    """Group ``number`` of a match; None without a match, or if it did not take part in it."""
    return None if match is None else match[number]


def _agreed_celsius(quantity: str, degrees: str | None, tenths: str | None, place: str) -> float:
    """Degrees Celsius of the T group in the remarks, else those of the body; NaN without both.

    ``degrees``, ``tenths``: the fields of body and T group. Raises ``InputError`` if they differ.
    """
    whole = _celsius(degrees)
    finer = _from_tenths(tenths)
    if math.isnan(finer):
        return whole
    if abs(finer - whole) > MOST_OF_ROUNDING_C:
        raise messages.metar_contradiction(
            where=place,
            quantity=quantity,
            body=f"{whole:.0f} C",
            other=f"{finer:.1f} C in the T group of the remarks",
        )
    return finer


def _agreed_setting(parts: _Parts, place: str) -> float:
    """The first altimeter setting [Pa], NaN without one; ``InputError`` if another one differs."""
    settings_pa = [_setting_pa(*group) for group in _settings_of(parts)]
    for other_pa in settings_pa[1:]:
        if abs(other_pa - settings_pa[0]) > MOST_BETWEEN_SETTINGS_PA:
            raise messages.metar_contradiction(
                where=place,
                quantity="altimeter setting",
                body=f"{settings_pa[0] / HECTOPASCAL:.0f} hPa",
                other=f"{other_pa / HECTOPASCAL:.0f} hPa in another group",
            )
    return settings_pa[0] if settings_pa else math.nan


def _settings_of(parts: _Parts) -> list[tuple[str, str, str]]:
    """Letter, digits and unit of each altimeter setting."""
    return [*_SETTING.findall(parts.body), *_SETTING.findall(parts.remarks)]


def _letters_for_zeros(parts: _Parts) -> tuple[str, ...]:
    """Complaints on altimeter settings that were typed with the letter O for a zero.

    >>> _letters_for_zeros(_Parts("", "LOWW 121150Z 06/02 Q1O26", ""))
    ('Q1O26 is read as Q1026',)
    """
    complaints = []
    for letter, digits, unit in _settings_of(parts):
        if "O" in digits:
            corrected = digits.replace("O", "0")
            complaints.append(f"{letter}{digits}{unit} is read as {letter}{corrected}{unit}")
    return tuple(complaints)


def _setting_pa(letter: str, digits: str, unit: str) -> float:
    """An altimeter setting [Pa], plus half of the step to which it was rounded down.

    ``letter``: A for hundredths of an inch of mercury, Q or QNH for hPa; ``unit``: HPA, INS or
    empty.

    >>> _setting_pa("Q", "1013", ""), round(_setting_pa("A", "2992", ""))
    (101350.0, 101338)
    """
    number = int(digits.replace("O", "0"))
    if letter == "A" or unit == "INS":
        return (0.01 * number + 0.005) * INCH_OF_MERCURY_PA
    return (number + 0.5) * HECTOPASCAL


def _stamp_of(body: str, place: str) -> tuple[int, int, int] | None:
    """Day, hour and minute of a report, None without them.

    Raises ``InputError`` for a group like a time that is not a day, hour and minute.
    """
    head = _STATION_AND_TIME.search(body) or _STATION_AND_TIME_WITHOUT_Z.search(body)
    if head is None:
        other = _NO_STAMP.search(body)
        if other is None:
            return None
        raise messages.metar_parse(where=place, why=f"{other[0]} is not a day, hour and minute")
    digits = head[2]
    day = int(digits[:2])
    hour = int(digits[2:4])
    minute = int(digits[4:])
    if not (1 <= day <= 31 and hour < 24 and minute < 60):
        raise messages.metar_parse(where=place, why=f"{digits}Z is not a day, hour and minute")
    return day, hour, minute


def _date_before(before: str, place: str) -> np.datetime64 | None:
    """The date that archives and servers write before a report; None without a year.

    Raises ``InputError`` for a year without a valid month and day.

    >>> _date_before("2015/03/12 11:50 ", "here")
    np.datetime64('2015-03-12')
    """
    date = _YEAR_FIRST.search(before) or _DAY_FIRST.search(before)
    if date is None and _YEAR.search(before) is None:
        return None
    try:
        if date is not None:
            return np.datetime64(f"{date['year']}-{date['month']}-{date['day']}", "D")
    except ValueError:  # the thirteenth month
        pass
    why = f"{before.strip()!r} before the report is not a date like 2026-05-14"
    raise messages.metar_parse(where=place, why=why)


def time_of_metar(report: Metar, flight_ns: int | None, where: str) -> int | None:
    """The time of a report [Unix ns]; None if it has no stamp, or neither date nor flight time.

    A report has only the day of the month. The month is the one that brings it nearest to the date
    before the report, from which it may be a day away (else METAR-CONTRADICTION); without a date,
    nearest to the flight at ``flight_ns`` [Unix ns].
    """
    if report.stamp is None:
        return None
    near = report.date
    if near is None:
        if flight_ns is None:
            return None
        near = np.datetime64(int(flight_ns), "ns")
    day, hour, minute = report.stamp
    times = []
    for days_away in range(-31, 32):
        date = near.astype("datetime64[D]") + np.timedelta64(days_away, "D")
        if int((date - date.astype("datetime64[M]")).astype(np.int64)) + 1 == day:
            times.append(date + np.timedelta64(60 * hour + minute, "m"))
    middle = near if report.date is None else near + np.timedelta64(12, "h")
    time = min(times, key=lambda candidate: abs(candidate - middle))
    if report.date is not None and abs(time - middle) > FARTHEST_FROM_DATE:
        raise messages.metar_contradiction(
            where=f"{where}: {report.text[:EXCERPT]!r}",
            quantity="day",
            body=str(day),
            other=f"{report.date} before the report",
        )
    return int(time.astype("datetime64[ns]").astype(np.int64))
