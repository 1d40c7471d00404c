"""Other readings of the angles of a file than the stated one, tested by tie points.

Angles come from a table of orientations, from tags of images, with a trajectory, and with the
exposures of another program. In each of these files the unit, a sign, the order of the rotations or
the side of the image that is up may differ from what is stated. If the rays of tie points meet 1000
times as likely by another reading, the mission is refused; the reading is not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.image_rays import ImageRays, orientations_of, straightened
from unbend.block.intersection import Intersection, intersect
from unbend.block.oriented_images import SIGMAS_OF_BLOCK
from unbend.config import Mission
from unbend.errors import MissionError
from unbend.flight import rotations
from unbend.flight.channels import Channel
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.stages.multi_image import messages
from unbend.stages.opened_inputs import ChannelReader, OpenedInputs
from unbend.tables.imports.stated import Stated
from unbend.units import RADIANS, AngleUnit, Array

GOOD_FACTOR = 2.0  # residuals over those of an adjusted block, that another reading may have
UNSTATED = "angles or columns"  # keys to change for a mistake that has no key of its own
QUARTER_TURNS_DEG = (90.0, -90.0, 180.0)  # of the image about the axis of the camera


class AngleReading(NamedTuple):
    """Another meaning of the three angles of a file.

    words : the meaning, for a message.
    key : the key of the mission file to change if it is right.
    change : the angles (n, 3) [rad] that are right then, of those that were read as stated.
    """

    words: str
    key: str
    change: Callable[[Array], Array]


class StationsReading(NamedTuple):
    """Another reading of a file: in words, the key to change if it is right, and its stations.

    ``stations`` makes the stations; it raises MissionError if they are impossible.
    """

    words: str
    key: str
    stations: Callable[[], Stations]


def readings_of_angles(
    names: tuple[str, str, str], unit: AngleUnit, order: str | None, *, unit_key: str
) -> Iterator[AngleReading]:
    """Other units, signs and orders of three angles than those that are stated.

    names : of the angles, for messages.
    unit : the stated unit; unit_key: the key that states it.
    order : the stated order of photogrammetric angles, as omega_phi_kappa: the last angle turns the
        image about the camera's axis. None for roll, pitch and yaw.
    """
    for other_unit, size in RADIANS.items():
        if other_unit != unit:
            ratio = size / RADIANS[unit]
            words = f"if the angles are in {other_unit}"
            yield AngleReading(words, unit_key, _scaling(ratio))
    for mistake, correct in rotations.ANGLE_MISTAKES.items():
        yield AngleReading(mistake.format(*names), UNSTATED, _correction(correct))
    if order is None:
        return
    yield _other_order(order)
    for turn_deg in QUARTER_TURNS_DEG:
        words = f"with the images turned by {turn_deg:g} degrees about the axis of the camera"
        yield AngleReading(words, UNSTATED, _image_turn(np.radians(turn_deg)))


def _other_order(order: str) -> AngleReading:
    """The reading with the first two rotations in the other order than stated.

    ``order`` : omega_phi_kappa or phi_omega_kappa, as stated.
    """
    first, second, _ = order.split("_")
    other_order = f"{second}_{first}_kappa"
    words = f"if the angles are {other_order}"
    return AngleReading(words, UNSTATED, _reordering(other_order, order))


def _scaling(ratio: float) -> Callable[[Array], Array]:
    """The function that multiplies angles (n, 3) by ``ratio``."""
    return lambda angles: angles * ratio


def _image_turn(turn_rad: float) -> Callable[[Array], Array]:
    """The function that adds ``turn_rad`` to the last of the angles (n, 3)."""
    return lambda angles: np.add(angles, [0.0, 0.0, turn_rad])


def _correction(
    correct: Callable[..., tuple[Array, Array, Array]],
) -> Callable[[Array], Array]:
    """A function of three angles (n,) each, as a function of angles (n, 3)."""
    return lambda angles: np.stack(correct(*angles.T), axis=1)


def _reordering(true_order: str, stated_order: str) -> Callable[[Array], Array]:
    """The function that converts angles that turn in the true order to those in the stated order.

    Its argument (n, 3) was read in the stated order: its first two columns are those of
    ``true_order``, exchanged.
    """

    def change(angles: Array) -> Array:
        quaternion = rotations.quaternion_of_opk(angles[:, [1, 0, 2]], true_order)
        return rotations.opk_of_quaternion(quaternion, stated_order)

    return change


def intersected(stations: Stations, rays: ImageRays) -> Intersection:
    """The intersection of the rays of tie points, with the stations fixed and no ground heights."""
    orientations = orientations_of(stations, SIGMAS_OF_BLOCK)
    return intersect(orientations, straightened(orientations, replace(rays, height_m=None)))


def refuse_other_reading(
    as_stated: Intersection, readings: Iterable[StationsReading], rays: ImageRays, *, where: str
) -> None:
    """Refuse (ORIENTATION-READING) stations if rays meet far better by another reading.

    ``as_stated`` : the intersection of ``rays`` with the stations as stated. The best of the
    ``readings`` has to be 1000 times as likely, and its residuals less than twice as large as those
    of an adjusted block, and not larger than those as stated. Where they are larger, the stated
    reading is less likely only by its few bad rays, which are those of a wrong image.
    """
    if as_stated.misfit <= LOG_RATIO_NEEDED:  # nothing can be more likely by as much
        return
    likely: StationsReading | None = None
    best = as_stated
    for reading in readings:
        with suppress(MissionError):  # a reading with impossible stations is not the right one
            intersection = intersected(reading.stations(), rays)
            if intersection.log_likelihood > best.log_likelihood:
                likely = reading
                best = intersection
    better = best.log_likelihood - as_stated.log_likelihood
    is_larger = best.sigma_factor > as_stated.sigma_factor  # False if as stated no rays meet: NaN
    fits = best.sigma_factor < GOOD_FACTOR and not is_larger
    if likely is not None and better > LOG_RATIO_NEEDED and fits:
        raise messages.orientation_reading(
            where=where,
            points=int(np.unique(rays.point).size),
            likely=likely.words,
            better=float(better),
            changed=likely.key,
        )


@dataclass(frozen=True)
class AngleRoad:
    """A file of a mission that gives angles, and how to read it in another way.

    key, path : its key in the mission file, and its path.
    readings : other readings of its angles than the stated one.
    inputs_as : makes the inputs of the mission with a change of the angles of this file.
    """

    key: str
    path: str
    readings: tuple[AngleReading, ...]
    inputs_as: Callable[[Callable[[Array], Array]], OpenedInputs]


def roads_of_angles(
    mission: Mission, inputs: OpenedInputs, positions: Mapping[str, Channel]
) -> Iterator[AngleRoad]:
    """The trajectory, and the files of exposures of other programs, that give attitudes.

    ``positions`` are the channels of the files under events.positions, by camera.
    """
    trajectory = mission.stations.trajectory
    reader = inputs.trajectory
    if trajectory is not None and reader is not None and trajectory.has_angles:
        names = ("roll", "pitch", "yaw")
        unit = trajectory.angle_unit
        readings = [*readings_of_angles(names, unit, None, unit_key="angle_unit")]
        yield AngleRoad(
            "stations.trajectory",
            trajectory.path,
            tuple(readings),
            lambda change: replace(inputs, trajectory=_read_as(reader, change)),
        )
    for camera, channel in positions.items():
        source = mission.position_events[camera]
        if not channel.fits_role("attitude") or source.times_only:
            continue
        # Unit and order of these angles, and which angles they are, are stated in the file's head.
        names = ("the first angle", "the second angle", "kappa or heading")
        order = "omega_phi_kappa"
        readings = [*readings_of_angles(names, "deg", order, unit_key=UNSTATED)]
        readings.append(_other_order("phi_omega_kappa"))
        yield AngleRoad(
            f"events.positions.{camera}",
            source.path,
            tuple(readings),
            _camera_events_as(inputs, camera),
        )


def _camera_events_as(
    inputs: OpenedInputs, camera: str
) -> Callable[[Callable[[Array], Array]], OpenedInputs]:
    """The function that makes ``inputs`` with a change of the angles in one camera's exposures."""
    reader = inputs.camera_events[camera]

    def inputs_as(change: Callable[[Array], Array]) -> OpenedInputs:
        changed = {**inputs.camera_events, camera: _read_as(reader, change)}
        return replace(inputs, camera_events=changed)

    return inputs_as


def _read_as(reader: ChannelReader, change: Callable[[Array], Array]) -> ChannelReader:
    """A reader that changes the angles of its file before they are used."""

    def read(stated: Stated, ledger: Ledger) -> Channel:
        return reader(replace(stated, angles_meant=change), ledger)

    return read
