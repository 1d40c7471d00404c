"""Whether the events of a camera are commands of its trigger or pulses of its shutter."""

from collections.abc import Iterator, Mapping

import numpy as np

from unbend.flight import messages
from unbend.flight.channels import Channel
from unbend.flight.exposures import ExposureDelay
from unbend.flight.interpolation import ns_to_nearest
from unbend.messages import Message, Notes
from unbend.units import Array

LONGEST_LAG_S = 1.0  # of a shutter behind its trigger; a later pulse is that of another exposure
FEWEST_PAIRS = 10  # of triggers and pulses that are needed for a median lag
_NUMBERS_PER_BOOT = 1e6  # is added to the numbers of each power-up, to make them distinct

FEEDBACK_PARAMETER = "CAM_CAP_FBACK"
"""PX4's parameter: 1 where the camera reports its exposures; 0 where each trigger counts as one."""

_SAME_TIME_NS = 1_000_000  # a capture this near to the command of a trigger has its time
_SHARE_OF_MOST = 0.5  # a larger share of the captures is most of them


def lag_from_feedback(
    channels: tuple[Channel, ...], trigger: Channel, camera: str
) -> tuple[ExposureDelay, Notes]:
    """The lag of the shutter behind the trigger, from triggers with a logged pulse of the shutter.

    A trigger and a pulse with the same number and power-up are a pair. The lag is the median of the
    pairs; its sigma is their scatter. Refuses (MissionError EVENTS-FEEDBACK) if there are fewer
    than ten pairs, or ``trigger`` is a channel of pulses itself.
    """
    lags = np.empty(0)
    if is_trigger(trigger):
        for shutter in _shutters_of(trigger, channels):
            lags = np.append(lags, _lags_of_pairs(trigger, shutter))
    if lags.size < FEWEST_PAIRS:
        raise messages.too_few_feedback_pairs(
            camera=camera, channel=trigger.name, pairs=lags.size, needed=FEWEST_PAIRS
        )
    # -1, 0 and +1 sigma of normal errors.
    low, middle, high = np.percentile(lags, [16.0, 50.0, 84.0])
    sigma_s = float(high - low) / 2.0
    message = messages.shutter_lag(
        camera=camera,
        channel=trigger.name,
        pairs=lags.size,
        lag_ms=middle * 1e3,
        scatter_ms=sigma_s * 1e3,
    )
    return ExposureDelay(float(middle), sigma_s=sigma_s), (message,)


def shutter_finding(
    channels: tuple[Channel, ...], chosen: Channel, camera: str
) -> Iterator[Message]:
    """A finding if ``chosen`` has the commands of a trigger, although its pulses are logged too."""
    if not is_trigger(chosen):
        return
    shutters = [channel for channel in _shutters_of(chosen, channels) if len(channel)]
    lags = [_lags_of_pairs(chosen, shutter) for shutter in shutters]
    lag_s = np.concatenate([np.empty(0), *lags])
    if lag_s.size:
        yield messages.shutter_not_used(
            camera=camera,
            trigger=chosen.name,
            shutters=", ".join(shutter.name for shutter in shutters),
            lag_ms=1e3 * float(np.median(lag_s)),
        )


def _lags_of_pairs(trigger: Channel, shots: Channel) -> Array:
    """(k,) seconds from a trigger to the pulse (``shots``) of the same number and power-up.

    Only lags between 0 and `LONGEST_LAG_S` count.
    """
    trigger_number = trigger["event_index"] + _NUMBERS_PER_BOOT * trigger.boot
    shot_number = shots["event_index"] + _NUMBERS_PER_BOOT * shots.boot
    _, trigger_row, shot_row = np.intersect1d(trigger_number, shot_number, return_indices=True)
    apart = (shots.time_ns[shot_row] - trigger.time_ns[trigger_row]) * 1e-9
    lags = apart[(apart > 0.0) & (apart < LONGEST_LAG_S)]
    return np.asarray(lags)


def is_trigger(channel: Channel) -> bool:
    """Whether the rows of a channel are commands of a trigger, and not pulses of a shutter."""
    kind = channel.source.kind
    if kind == "CAMERATRIGGER":
        return not _is_feedback(channel)
    return kind == "TRIG"


def _is_feedback(channel: Channel) -> bool:
    """Whether the rows of PX4's camera_trigger are pulses of the shutter, by their flag."""
    return "feedback" in channel.columns and bool((channel["feedback"] > 0.0).all())


def trigger_notes(
    channels: tuple[Channel, ...], chosen: Channel, parameters: Mapping[str, float]
) -> Iterator[Message]:
    """Report if the events of a camera are triggers, and triggers without a pulse of the shutter.

    ``chosen``: the event channel of the camera. ``parameters``: those of the log.

    * ArduPilot logs TRIG at the trigger and CAM at the pulse of a camera with a feedback pin;
      without such a pin only CAM, at the trigger. The rows of an instance belong to one camera.
    * PX4 logs camera_capture at the pulse or, depending on the parameter CAM_CAP_FBACK, at the
      trigger; each row of camera_trigger has a flag that tells which.
    """
    kind = chosen.source.kind
    triggers = [
        channel
        for channel in channels
        if is_trigger(channel) and _are_of_one_system(channel, chosen)
    ]
    if kind == "CAMERACAPTURE":
        yield from _capture_notes(chosen, triggers, parameters)
    elif is_trigger(chosen) or (kind == "CAM" and not triggers):  # CAM without a feedback pin
        yield messages.trigger_times(channel=chosen.name, events=len(chosen))
    yield from _lost_pulses(channels, chosen, triggers)


def _lost_pulses(
    channels: tuple[Channel, ...], chosen: Channel, triggers: list[Channel]
) -> Iterator[Message]:
    """Report each trigger of the camera with more commands than logged pulses."""
    for trigger in triggers:
        shutters = _shutters_of(trigger, channels)
        if chosen not in shutters:
            continue
        events = sum(len(channel) for channel in shutters)
        if len(trigger) > events:
            yield messages.triggers_without_pulse(
                shutters=", ".join(channel.name for channel in shutters),
                trigger=trigger.name,
                sent=len(trigger),
                events=events,
            )


def _capture_notes(
    captures: Channel, triggers: list[Channel], parameters: Mapping[str, float]
) -> Iterator[Message]:
    """Report if captures of PX4 have the times of trigger commands, or may have them.

    They have these times if the parameter is 0, or if most of them have the time of a command. They
    may have them if neither the parameter nor commands are logged.
    """
    feedback = parameters.get(FEEDBACK_PARAMETER)
    commands = [trigger for trigger in triggers if "feedback" in trigger.columns]
    are_commands = any(_most_have_times_of(captures, trigger) for trigger in commands)
    if feedback == 0.0 or are_commands:
        yield messages.trigger_times(channel=captures.name, events=len(captures))
    elif feedback is None and not commands:
        yield messages.perhaps_trigger_times(
            channel=captures.name, events=len(captures), parameter=FEEDBACK_PARAMETER
        )


def _most_have_times_of(captures: Channel, trigger: Channel) -> bool:
    """Whether most captures have the time of a command of a trigger, to 1 ms."""
    if len(captures) == 0 or len(trigger) == 0:
        return False
    is_same = ns_to_nearest(captures.time_ns, trigger.time_ns) < _SAME_TIME_NS
    return bool(np.mean(is_same) > _SHARE_OF_MOST)


def _shutters_of(trigger: Channel, channels: tuple[Channel, ...]) -> list[Channel]:
    """The channels with pulses of a shutter that may be of the camera of a trigger."""
    shutters = []
    for channel in channels:
        if trigger.source.kind == "TRIG":
            is_shutter = channel.source.kind == "CAM"
        else:
            is_shutter = channel.source.kind == "CAMERATRIGGER" and _is_feedback(channel)
        if is_shutter and _are_of_one_system(trigger, channel):
            shutters.append(channel)
    return shutters


def _are_of_one_system(trigger: Channel, shots: Channel) -> bool:
    """Whether ``trigger`` and ``shots`` may be of one camera.

    Both must be messages of ArduPilot, or neither. A trigger without instance may be of any camera;
    else both must have the same instance.
    """
    is_of_ardupilot = trigger.source.kind == "TRIG"
    shots_are_of_ardupilot = shots.source.kind in ("CAM", "TRIG")
    if is_of_ardupilot != shots_are_of_ardupilot:
        return False
    return trigger.source.instance in (None, shots.source.instance)
