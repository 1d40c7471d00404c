"""Texts of an autopilot on its position and attitude, as suspect stretches.

The patterns are for the texts of ArduPilot (also EV and ERR of its logs) and of PX4.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from unbend.flight.channels import Channel
from unbend.flight.evidence.stretches import ATTITUDE, POSITION, SECOND, Stretch

_TEXT_DELAY_NS = SECOND // 2  # from a fault to the text that reports it
_MOMENT_NS = 5 * SECOND  # how long an event without duration makes a flight suspect
_NEVER_OVER_NS = 3600 * SECOND  # after the last text of a boot, if no text ends a trouble

# Words that, after the name of a trouble, report its end.
_OVER = (
    r"\b(cleared|ended|regained|recovered|restored|resolved|acquired|healthy|normal|ok"
    r"|no longer|is over|over$|signal found|gone|passed|resumed|good|inactive|finished)\b"
)


class _Trouble(NamedTuple):
    """A trouble that lasts: patterns of the lines that begin it, and of those that end it."""

    begins: re.Pattern[str]
    ends: re.Pattern[str]


def _trouble(begins: str, ends: str) -> _Trouble:
    """A trouble by its patterns, ignoring case; in ``ends`` OVER is replaced by `_OVER`."""
    return _Trouble(
        begins=re.compile(begins, re.IGNORECASE),
        ends=re.compile(ends.replace("OVER", _OVER), re.IGNORECASE),
    )


_DCM = _trouble(r"DCM active", r"EKF\d? active")
_DEAD_RECKONING = _trouble(
    r"dead.?reckon|ERR FAILSAFE_DEADRECKON [1-9]",
    r"reckon\w*.*(OVER|\bstopped\b)|using GPS|(GPS|GNSS).*OVER|ERR FAILSAFE_DEADRECKON 0",
)
_RECEIVER = _trouble(
    r"GPS glitch|(GPS|GNSS) (signal |fix )?lost|ERR (FAILSAFE_GPS|GPS) [1-9]",
    r"glitch.*(OVER|\bstopped\b)|(GPS|GNSS).*OVER|using GPS|ERR (FAILSAFE_GPS|GPS) 0",
)
_FILTER = _trouble(
    r"EKF[ _]variance|EKF failsafe|ERR (EKFCHECK|FAILSAFE_EKFINAV) [1-9]",
    r"EKF.*OVER|EKF.*\bstopped\b(?! aiding)|ERR (EKFCHECK|FAILSAFE_EKFINAV) 0",
)
_AIDING = _trouble(
    r"stopped aiding", r"using (GPS|external nav)|(started|starting|resumed).*aiding"
)
_ESTIMATE = _trouble(
    r"(position|navigation).*(fail|invalid)", r"(position|navigation).*(OVER|\bvalid\b)"
)
_TROUBLES = (_DCM, _DEAD_RECKONING, _RECEIVER, _FILTER, _AIDING, _ESTIMATE)

# Events without duration: a switch from one filter or receiver to another, a reset.
_EVENTS = re.compile(
    r"lane switch|primary changed|EV GPS_PRIMARY_CHANGED|ERR EKF_PRIMARY [1-9]|forced reset"
    r"|emergency yaw",
    re.IGNORECASE,
)
# A check before take-off is repeated as long as it fails; no text reports when it passes.
_BEFORE_TAKE_OFF = re.compile(r"^\W*(PreArm|Arm|Preflight)\b", re.IGNORECASE)
_AWAITED = re.compile(r"\b(until|wait\w*|not|no)\b", re.IGNORECASE)  # what follows is not yet so
_OF_ATTITUDE = re.compile(r"DCM|lane|EKF.primary|forced|yaw", re.IGNORECASE)


class _Line(NamedTuple):
    """A line of an autopilot's texts, with its time [Unix ns] and the number of the power-up."""

    time_ns: int
    boot: int
    text: str


def text_evidence(channels: Sequence[Channel]) -> list[Stretch]:
    """The stretches that an autopilot's texts make suspect.

    A trouble lasts from the line that begins it to the next line that ends this trouble, in
    whichever channel that stands. An event, and a trouble that a check before take-off reports,
    make 5 s suspect. A text comes half a second late.
    """
    lines = _lines_of(channels)
    suspect: list[Stretch] = []
    for number, line in enumerate(lines):
        if _EVENTS.search(line.text):
            suspect += _stretches(line, line.time_ns)
        for trouble in _TROUBLES:
            # "GPS glitch cleared" names the trouble that it ends.
            if not trouble.begins.search(line.text) or _ends(line, trouble):
                continue
            end_ns = line.time_ns
            if not _BEFORE_TAKE_OFF.search(line.text):
                end_ns = _end_of(trouble, line.boot, lines[number:])
            suspect += _stretches(line, end_ns)
    return suspect


def _lines_of(channels: Sequence[Channel]) -> list[_Line]:
    """All lines of the texts in channels, in the order of time."""
    lines: list[_Line] = []
    for channel in channels:
        times_ns = channel.time_ns.tolist()
        boots = channel.boot.tolist()
        for row, text in enumerate(channel.labels.get("text", ())):
            for line in text.splitlines():
                lines.append(_Line(times_ns[row], boots[row], line.strip()))
    return sorted(lines)


def _ends(line: _Line, trouble: _Trouble) -> bool:
    """Whether a line reports the end of a trouble, and not that the end is awaited."""
    end = trouble.ends.search(line.text)
    if end is None:
        return False
    up_to_end = line.text[: end.end()]
    is_awaited = _AWAITED.search(up_to_end.replace("no longer", ""))  # "no longer" reports the end
    return not is_awaited


def _end_of(trouble: _Trouble, boot: int, lines: Sequence[_Line]) -> int:
    """The time [ns] of the first line of a boot that ends a trouble.

    If no line does, an hour after the last line of the boot. ``lines`` : in the order of time, from
    the one that begins the trouble.
    """
    last_ns = lines[0].time_ns
    for line in lines:
        if line.boot != boot:
            continue
        if _ends(line, trouble):
            return line.time_ns
        last_ns = line.time_ns
    return last_ns + _NEVER_OVER_NS


def _stretches(line: _Line, end_ns: int) -> list[Stretch]:
    """The stretches that a line makes suspect, up to ``end_ns`` [ns], and for 5 s at least.

    One is of the position, a second one of the attitude if the line is on the attitude.
    """
    begin_ns = line.time_ns - _TEXT_DELAY_NS
    last_ns = max(end_ns, begin_ns + _MOMENT_NS)
    reason = f'the autopilot reports "{line.text}"'
    suspect = [Stretch(begin_ns, last_ns, POSITION, reason)]
    if _OF_ATTITUDE.search(line.text):
        suspect.append(Stretch(begin_ns, last_ns, ATTITUDE, reason))
    return suspect
