"""What the angles of a file could mean instead of what is stated, decided by tie points.

Angles come in as a table of orientations, as tags of images, with a trajectory, and with the
exposures of another program. On each of these roads the unit, a sign, the order of the rotations
or the side of the image that is up may be another one. A reading by which the rays of tie points
meet 1000 times as likely is a refusal, never a repair.
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
UNSTATED = "angles or columns"  # what to change, where no single key says it
QUARTER_TURNS_DEG = (90.0, -90.0, 180.0)  # of the image about the axis of the camera


class AngleReading(NamedTuple):
    """What three angles could mean: in words, the key to change then, and the angles as stated."""

    words: str
    key: str
    change: Callable[[Array], Array]


class StationsReading(NamedTuple):
    """A reading of a file with the stations by it, which may be refused (MissionError)."""

    words: str
    key: str
    stations: Callable[[], Stations]


def readings_of_angles(
    names: tuple[str, str, str], unit: AngleUnit, order: str | None
) -> Iterator[AngleReading]:
    """Other units, signs and orders of three angles (n, 3) [rad] that were read in a ``unit``.

    ``order`` is that of photogrammetric angles, whose last one turns the image about the camera's
    axis; None for roll, pitch and yaw.
    """
    for other, size in RADIANS.items():
        if other != unit:
            ratio = size / RADIANS[unit]
            yield AngleReading(f"if the angles are in {other}", "unit", _scaled(ratio))
    for mistake, undone in rotations.ANGLE_MISTAKES.items():
        yield AngleReading(mistake.format(*names), UNSTATED, _mistaken(undone))
    if order is None:
        return
    yield _other_order(order)
    for turn_deg in QUARTER_TURNS_DEG:
        words = f"with the images turned by {turn_deg:g} degrees about the axis of the camera"
        yield AngleReading(words, UNSTATED, _turned(np.radians(turn_deg)))


def _other_order(order: str) -> AngleReading:
    """The reading by which angles turn in the other order than that of their names."""
    first, second, _ = order.split("_")
    meant = f"{second}_{first}_kappa"
    return AngleReading(f"if the angles are {meant}", UNSTATED, _in_order(meant, order))


def _scaled(ratio: float) -> Callable[[Array], Array]:
    return lambda angles: angles * ratio


def _turned(turn_rad: float) -> Callable[[Array], Array]:
    return lambda angles: np.add(angles, [0.0, 0.0, turn_rad])


def _mistaken(undone: Callable[..., tuple[Array, Array, Array]]) -> Callable[[Array], Array]:
    return lambda angles: np.stack(undone(*angles.T), axis=1)


def _in_order(meant: str, stated: str) -> Callable[[Array], Array]:
    """Angles that turn in the order ``meant``, in the order ``stated`` of their names."""

    def change(angles: Array) -> Array:
        quaternion = rotations.quaternion_of_opk(angles[:, [1, 0, 2]], meant)
        return rotations.opk_of_quaternion(quaternion, stated)

    return change


def intersected(stations: Stations, rays: ImageRays) -> Intersection:
    """The tie points at which rays meet, with the stations held."""
    orientations = orientations_of(stations, SIGMAS_OF_BLOCK)
    return intersect(orientations, straightened(orientations, replace(rays, height_m=None)))


def refuse_other_reading(
    stations: Stations, readings: Iterable[StationsReading], rays: ImageRays, *, where: str
) -> None:
    """Refuse (ORIENTATION-READING) stations, where rays meet far better in another reading.

    The best of the ``readings`` has to be 1000 times as likely as what is stated, and its residuals
    at most twice those that an adjusted block has.
    """
    as_stated = intersected(stations, rays)
    if as_stated.misfit <= LOG_RATIO_NEEDED:  # nothing can be more likely by as much
        return
    likely: StationsReading | None = None
    best = as_stated
    for reading in readings:
        with suppress(MissionError):  # a reading that is refused is not meant
            intersection = intersected(reading.stations(), rays)
            if intersection.log_likelihood > best.log_likelihood:
                likely = reading
                best = intersection
    better = best.log_likelihood - as_stated.log_likelihood
    if likely is not None and better > LOG_RATIO_NEEDED and best.sigma_factor < GOOD_FACTOR:
        raise messages.orientation_reading(
            where=where,
            points=int(np.unique(rays.point).size),
            likely=likely.words,
            better=float(better),
            changed=likely.key,
        )


@dataclass(frozen=True)
class AngleRoad:
    """A file of a mission from which angles come: its key, its name, and how it is read anew.

    inputs_as : the inputs of the mission, which read this file by a change of its angles.
    """

    key: str
    path: str
    readings: tuple[AngleReading, ...]
    inputs_as: Callable[[Callable[[Array], Array]], OpenedInputs]


def roads_of_angles(
    mission: Mission, inputs: OpenedInputs, positions: Mapping[str, Channel]
) -> Iterator[AngleRoad]:
    """The trajectory and the exposures of other programs that attitudes are taken from."""
    trajectory = mission.stations.trajectory
    reader = inputs.trajectory
    if trajectory is not None and reader is not None and trajectory.has_angles:
        names = ("roll", "pitch", "yaw")
        yield AngleRoad(
            "stations.trajectory",
            trajectory.path,
            tuple(readings_of_angles(names, trajectory.angle_unit, None)),
            lambda change: replace(inputs, trajectory=_read_as(reader, change)),
        )
    for camera, channel in positions.items():
        source = mission.position_events[camera]
        if not channel.fits_role("attitude") or source.times_only:
            continue
        # The order of these angles, and which angles they are, is stated in the head of the file.
        names = ("the first angle", "the second angle", "kappa or heading")
        readings = [*readings_of_angles(names, "deg", "omega_phi_kappa")]
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
    reader = inputs.camera_events[camera]

    def inputs_as(change: Callable[[Array], Array]) -> OpenedInputs:
        changed = {**inputs.camera_events, camera: _read_as(reader, change)}
        return replace(inputs, camera_events=changed)

    return inputs_as


def _read_as(reader: ChannelReader, change: Callable[[Array], Array]) -> ChannelReader:
    """The reader of a file whose angles are changed before they are used."""

    def read(stated: Stated, ledger: Ledger) -> Channel:
        return reader(replace(stated, angles_meant=change), ledger)

    return read
