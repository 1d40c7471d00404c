"""Which image belongs to which camera pulse: by numbers, times, rhythm and tie points."""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import Assignment, CameraEvents, ImageEvidence, assign
from unbend.block.image_rays import ImageRays, Orientations, orientations_of, straightened
from unbend.block.intersection import Intersection, intersect, point_heights
from unbend.config import Mission
from unbend.config.event_sources import EventsSection, FirstImage
from unbend.errors import InputError, MissionError
from unbend.flight.exposures import Events, refuse_repeated_images
from unbend.flight.image_names import name_series
from unbend.flight.stations import NO_TIME, Stations
from unbend.geodesy import principal_radii
from unbend.messages import Ledger, Notes, loss, note, warning
from unbend.refraction.camera.camera import Camera
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.observations import Observations
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import Array, Integers, Names

Likelihood = Callable[[Integers], float]

_DAY_S = 86_400.0
_FEW_CONTRADICTED = 0.02
_FEWEST_POINTS, _TIE_POINTS = 10, 200  # 800 rays show a shift by a factor of e^3000
_POINTS_AT_FIRST = 50
_FEWEST_MEET, _POOREST_FIT = 0.5, 5.0
_USABLE_STATIONS = 0.9
_LARGEST_HOLE = 12
_POSITION_M, _COMMON_M, _DELAY_S, _OUTLIER = 10.0, 5.0, 1.0, 25.0  # of positions in EXIF


@dataclass(frozen=True, eq=False)
class CameraImages:
    """The images of one camera, (k,): names, numbers in them, rows of their files (-1 without)."""

    name: Names
    number: Integers
    numbering: str
    file: Integers


def assigned_stations(
    mission: Mission, section: EventsSection, events: list[Events], stations: list[Stations], *,
    files: ImageTimes | None, observations: Observations, ties: TiePoints, ledger: Ledger,
) -> list[Stations]:  # fmt: skip
    """Of the ``stations`` of all events, camera by camera, those that have an image, as its."""
    if section.csv is not None:
        return stations
    if section.images is not None and files is not None:
        path = section.images.path
        absent = sorted(set(observations.images) - set(files.rows_of(observations.images)))
        if len(absent) == len(observations.images):
            raise InputError.of("IMAGES-OTHER", path, absent=absent[0], files=files.file[0])
        if absent:
            ledger.loss("IMAGES-ABSENT", where=path, count=len(absent), first=absent[0])
    result, chosen = [], []
    for exposed, of_events in zip(events, stations, strict=True):
        pattern = section.patterns[exposed.camera]
        if pattern == "{name}":
            result.append(of_events)
            chosen.append(exposed)
            continue
        images = images_of_camera(pattern, observations.images, files)
        camera = mission.interior_orientations[exposed.camera]
        spoken = {
            "tie points": tie_likelihood(ties, images, camera, of_events),
            "positions": position_likelihood(images, files, of_events),
        }
        likelihoods = {name: spoke for name, spoke in spoken.items() if spoke is not None}
        anchor = section.anchor(exposed.camera)
        named, rows = ledger.take(assigned_events(exposed, images, files, anchor, likelihoods))
        chosen.append(named)
        result.append(replace(of_events.rows(rows), image=named.image))
    refuse_repeated_images(chosen)
    return result


@dataclass(frozen=True, eq=False)
class TieLikelihood:
    """Log likelihood of assignments (k,) of events to images by ``rays``, some of ``every`` one."""

    of_events: Orientations
    rays: ImageRays
    every: ImageRays

    def intersected(self, event: Integers) -> Intersection:
        orientations = self.of_events.assigned(event)
        return intersect(orientations, straightened(orientations, self.rays))

    def __call__(self, event: Integers) -> float:
        return self.intersected(event).log_likelihood if self.rays.point.size else 0.0

    def share_met(self, events: Integers) -> Array:
        """(c,) share of some points whose rays meet under assignments (c, k); more than jointly."""
        points = np.unique(self.rays.point)
        some = points[np.unique(np.linspace(0, points.size - 1, _POINTS_AT_FIRST).astype(int))]
        rays, m = self.rays.of_points(some), self.of_events.camera.size
        shape = events.shape[0], rays.image.size
        point = np.searchsorted(some, rays.point) + some.size * np.arange(shape[0])[:, None]
        stacked = ImageRays(
            events[:, rays.image].ravel() % (m + 1),
            point.ravel(),
            np.broadcast_to(rays.direction, (*shape, 3)).reshape(-1, 3),
            np.broadcast_to(rays.sigma_rad, shape).ravel(),
        )
        found = point_heights(self.of_events.assigned(np.append(np.arange(m), -1)), stacked)
        return np.asarray(np.isfinite(found.h_m).reshape(shape[0], -1).mean(axis=1))

    def across(self, images: Integers) -> TieLikelihood:
        """That by the points which some of the images show, and others too."""
        inside = np.isin(self.every.image, images)
        both = np.intersect1d(self.every.point[inside], self.every.point[~inside])
        return replace(self, rays=self.every.of_points(both))

    def contradicted(self, event: Integers) -> Integers:
        """The images, by their rows, half of whose rays meet those of no others."""
        of, every = self.of_events.assigned(event), self.every
        found = intersect(of, straightened(of, every))
        lost = found.bad | ~found.used[np.searchsorted(found.point, every.point)]
        seen, off = (np.bincount(every.image[k], minlength=event.size) for k in (slice(None), lost))
        return np.flatnonzero((off >= 0.5 * np.maximum(seen, 4)) & np.isfinite(of.centre_m[:, 0]))

    def fits(self, event: Integers) -> bool:
        """Whether rays meet at all under the best assignment: else something else is wrong."""
        found = self.intersected(event)
        return bool(found.used.mean() >= _FEWEST_MEET and found.sigma_factor < _POOREST_FIT)


def tie_likelihood(
    ties: TiePoints, images: CameraImages, camera: Camera, stations: Stations
) -> TieLikelihood | None:
    """Likelihood by the tie points of one camera; None where these or usable events are few."""
    of_camera = np.full(images.name.shape, "camera", object)
    rays = tie_rays(ties, images.name, of_camera, {"camera": camera})
    points = np.unique(rays.point)
    usable = stations.ok.sum() >= max(2.0, _USABLE_STATIONS * len(stations))
    if points.size < _FEWEST_POINTS or not usable:
        return None
    some = points[np.unique(np.linspace(0, points.size - 1, _TIE_POINTS).astype(int))]
    rays = replace(rays, height_m=None)
    return TieLikelihood(orientations_of(stations), rays.of_points(some), rays)


def position_likelihood(
    images: CameraImages, files: ImageTimes | None, stations: Stations
) -> Likelihood | None:
    """Log likelihood of assignments by the positions in the images; None where few have one.

    The positions err by 10 m each, at most five times that, and together by 5 m and a delay of
    1 s: a receiver's last fix. Along one line they decide nothing; along lines to and fro they do.
    """
    if files is None or len(stations) < 3:
        return None
    position = np.append(files.position, [[np.nan] * 3], axis=0)[images.file]
    has = np.isfinite(position[:, 0])
    if has.sum() < max(3.0, 0.5 * has.size) or stations.ok.sum() < _USABLE_STATIONS * len(stations):
        return None
    lat, lon = np.median(stations.lat_rad[stations.ok]), np.median(stations.lon_rad[stations.ok])
    meridian, vertical = principal_radii(np.array([lat]))
    metres = np.array([meridian[0], vertical[0] * np.cos(lat)])
    flown = (np.stack([stations.lat_rad, stations.lon_rad], axis=1) - [lat, lon]) * metres
    seconds = np.maximum.accumulate((stations.time_ns - stations.time_ns[0]) * 1e-9)
    with np.errstate(invalid="ignore", divide="ignore"):  # pulses that repeat
        velocity = np.nan_to_num(np.gradient(flown, seconds, axis=0), posinf=0.0, neginf=0.0)
    written = (position[:, :2] - [lat, lon]) * metres

    def log_likelihood(event: Integers) -> float:
        rows = np.flatnonzero(has & (event >= 0))
        rows = rows[np.isfinite(flown[event[rows], 0])]
        off = (written[rows] - flown[event[rows]]).ravel() / _POSITION_M
        common = np.tile(np.eye(3)[1:], (rows.size, 1)) * _COMMON_M / _POSITION_M
        common[:, 0] = velocity[event[rows]].ravel() * _DELAY_S / _POSITION_M
        shared, limit = np.zeros(3), 4.0 * _OUTLIER
        for _ in range(4):
            left = np.square(off - common @ shared).reshape(-1, 2).sum(axis=1)
            near, limit = np.repeat(left < limit, 2), _OUTLIER
            design = common[near]
            shared = np.linalg.solve(design.T @ design + np.eye(3), design.T @ off[near])
        left = np.square(off - common @ shared).reshape(-1, 2).sum(axis=1)
        without = int(has.sum()) - rows.size
        cost = np.minimum(left, _OUTLIER).sum() + np.square(shared).sum() + without * _OUTLIER
        return -0.5 * float(cost)

    return log_likelihood


def images_of_camera(
    pattern: str, observed: tuple[str, ...], files: ImageTimes | None
) -> CameraImages:
    """Images of the observations, and files without any, that a pattern describes, in their order.

    Where it has no number, the digits that differ most are the camera's count.
    """
    text, fields = "", []
    for literal, field, _, _ in string.Formatter().parse(pattern):
        text += ".*".join(re.escape(part) for part in literal.split("*"))
        if field is not None:
            text += r"\d+" if field in fields else rf"(?P<{field}>\d+)"
            fields.append(field)
    whole = re.compile(text)
    stem = re.compile(re.sub(r"\\\.\w+$", "", text) + r"(\.\w+)?", re.IGNORECASE)
    paths: list[str] = [] if files is None else files.file.tolist()
    row_of = {} if files is None else files.rows_of(observed)
    found: list[tuple[str, int, dict[str, str]]] = []
    for image in observed:
        row = row_of.get(image, -1)
        match = whole.fullmatch(image) or (stem.fullmatch(paths[row]) if row >= 0 else None)
        if match is not None:
            found.append((image, row, match.groupdict()))
    for row in sorted(set(range(len(paths))) - set(row_of.values())):
        match = stem.fullmatch(paths[row]) or stem.fullmatch(paths[row].rpartition("/")[2])
        if match is not None:
            values = {key: int(value) for key, value in match.groupdict().items()}
            named = "*" not in pattern and len(set(fields)) == 1
            name = pattern.format(**values) if named else paths[row]
            found.append((name, row, match.groupdict()))
    found.sort(key=lambda item: [t.zfill(20) for t in re.split(r"(\d+)", item[0])])
    names = np.array([image for image, _, _ in found], object)
    file = np.array([row for _, row, _ in found], np.int64)
    for field, numbering in (("index", "index"), ("n", "counted")):
        if field in fields:
            number = np.array([int(values[field]) for _, _, values in found], np.int64)
            return CameraImages(names, number, numbering, file)
    count = np.arange(names.size, dtype=np.int64)
    groups = [re.findall(r"\d{1,15}", image) for image in names]
    if len({len(group) for group in groups}) == 1 and groups[0]:
        digits = np.array(groups).astype(np.int64).T[::-1]
        most = digits[np.argmax([np.unique(column).size for column in digits])]
        count = most if bool((np.diff(most) > 0).all()) else count
    return CameraImages(names, count, "sequence", file)


def assigned_events(
    exposed: Events, images: CameraImages, files: ImageTimes | None, anchor: FirstImage | None,
    likelihoods: Mapping[str, Likelihood],
) -> tuple[tuple[Events, Integers], Notes]:  # fmt: skip
    """The events that have an image, under its name, and their rows among all events.

    The log's own numbers in names decide unless contradicted (EVENTS-CONTRADICTED); else likelihood
    does, and refuses (EVENTS-AMBIGUOUS) where the runner-up is not 1000 times less likely.
    """
    where = f"events.log.{exposed.camera}"
    every = np.arange(exposed.time_ns.size, dtype=np.int64)
    has_names = bool((exposed.image != "").all())
    if images.name.size == 0 or every.size == 0:
        kept = every[: every.size * has_names]
        return (Events(exposed.camera, exposed.image[kept], exposed.time_ns[kept]), kept), ()
    beyond = images.number.max() > every.size
    if images.numbering == "index" and (
        exposed.counts == "always" or (exposed.counts == "maybe" and beyond)
    ):
        images, has_names = replace(images, numbering="counted"), False
    by_index = images.numbering == "index" and exposed.index is not None
    if images.numbering == "index" and not by_index:
        if has_names:  # the numbers begin anew, but their names do not repeat
            return (exposed, every), ()
        images = replace(images, numbering="sequence")
    keys, wanted = exposed.image.tolist(), images.name.tolist()
    if by_index and exposed.index is not None and not has_names:
        keys, wanted = exposed.index.tolist(), images.number.tolist()
    row_of = {key: row for row, key in enumerate(keys) if key != ""}
    event_by_name = np.array([row_of.get(key, -1) for key in wanted], np.int64)
    evidence, ties = evidence_of_images(exposed, images, files), likelihoods.get("tie points")
    assignment = assign(
        CameraEvents((exposed.time_ns - exposed.time_ns[0]) / 1e9, exposed.index),
        evidence,
        first_image=anchor_rows(anchor, images, exposed),
        tie_points=(lambda of: sum(f(of) for f in likelihoods.values())) if likelihoods else None,
        share_met=ties.share_met if isinstance(ties, TieLikelihood) else None,
    )
    if isinstance(ties, TieLikelihood) and not ties.fits(assignment.event):
        # No assignment lets the rays meet: mounts, cameras or times are wrong, not the events.
        rest = {name: f for name, f in likelihoods.items() if f is not ties}
        return assigned_events(exposed, images, files, anchor, rest)
    names = " and ".join(likelihoods)
    by = tuple(n.replace("tie points", names) for n in assignment.evidence)
    assignment = replace(assignment, evidence=by)
    description, event = describe_assignment(assignment, images, exposed), assignment.event
    undecided = assignment.ambiguous
    if by_index:
        undecided = (event >= 0) & (event != event_by_name)
        if float(undecided.mean()) > _FEW_CONTRADICTED:
            raise MissionError.of("EVENTS-CONTRADICTED", where, of=where, found=description)
        event = np.where(undecided, -1, event_by_name)
    why = "" if by_index else assignment.reason
    if not why and (exposed.counts == "maybe" or not by_index):
        hole = hole_between(assignment, images, exposed, likelihoods)
        why = f"a part of the images, not all, may be shifted, because {hole}" if hole else ""
    if why:
        strays, mend = beside_the_log(images, exposed)
        raise MissionError.of(
            "EVENTS-AMBIGUOUS", where, strays=strays, mend=mend, found=description, why=why,
            camera=exposed.camera, first=images.name[0],
        )  # fmt: skip
    entries = [note("EVENTS-ASSIGNED", description, where=where, count=int((event >= 0).sum()))]
    if evidence.time_s is not None and abs(assignment.offset_s) > _DAY_S:
        hours = assignment.offset_s / 3600
        entries.append(warning("EXIF-CLOCK", where="events.images", hours=hours))
    if count := int(undecided.sum()):
        listed = ", ".join(images.name[undecided][:3])
        entries.append(loss("EVENTS-UNDECIDED", where=where, count=count, images=listed))
    if has_names and np.array_equal(event, event_by_name):
        return (exposed, every), tuple(entries)
    has_event = np.flatnonzero(event >= 0)
    has_event = has_event[np.argsort(event[has_event], kind="stable")]
    rows = event[has_event]
    unused = np.setdiff1d(every, rows)
    if count := unused.size:
        numbers = unused + 1 if exposed.index is None else exposed.index[unused]
        listed = ", ".join(map(str, numbers[:8])) + " ..." * (count > 8)
        entries.append(note("EVENTS-UNUSED", where=where, count=count, events=listed))
    chosen = Events(exposed.camera, images.name[has_event], exposed.time_ns[rows])
    return (chosen, rows), tuple(entries)


def hole_between(
    assignment: Assignment, images: CameraImages, exposed: Events, likelihoods: Mapping[str,
    Likelihood],
) -> str:  # fmt: skip
    """Why a part of the images is shifted against the events in their order; empty if none is."""
    count, m, event = images.name.size, exposed.time_ns.size, assignment.event
    last = int(images.number.max()) if images.numbering == "counted" else count
    if "times" in assignment.evidence:
        return ""
    lost = last > m or (exposed.lost > 0 and not likelihoods)
    if lost and "first_image" not in assignment.evidence:
        if images.numbering == "counted":
            return f"{m} events for images counted up to {last}: some were lost"
        return f"{m} events for {count} images, and nothing shows where the log lacks one"
    if not likelihoods:
        return ""
    whole = images.number + int(np.median((event - images.number)[event >= 0]))
    order, apart = np.argsort(images.number, kind="stable"), max(2, abs(m - count))
    sizes = {*range(1, min(apart, _LARGEST_HOLE) + 1), apart}
    ties, cuts = likelihoods.get("tie points"), np.linspace(1, count - 1, 20).astype(int)
    if isinstance(ties, TieLikelihood):  # beside images that do not fit the others
        rank = np.flatnonzero(np.isin(order, ties.contradicted(event)))
        cuts = np.concatenate([rank, rank + 1])
        cuts = cuts[np.unique(np.linspace(0, cuts.size - 1, 20).astype(int))] if cuts.size else cuts
    for k in np.unique(cuts[(cuts > 0) & (cuts < count)]).tolist():
        of_all = likelihoods.values()
        near = [f.across(order[:k]) if isinstance(f, TieLikelihood) else f for f in of_all]
        enough = sum(f(event) for f in near) + LOG_RATIO_NEEDED
        shifts = [sign * size for size in sizes for sign in (-1, 1)]
        for rows, shift in product((order[:k], order[k:]), shifts):
            parted, moved = event.copy(), whole[rows] + shift
            inside = (moved >= 0) & (moved < m)
            parted[rows] = np.where(inside, moved, -1)
            if 2 * inside.sum() >= rows.size and sum(f(parted) for f in near) > enough:
                return f"one is missing near {images.name[order[k]]}"
    return ""


def beside_the_log(images: CameraImages, exposed: Events) -> tuple[str, str]:
    """Few names that do not fit, where the others may be the log's numbers, and what to do."""
    series, index = name_series(images.name)[0], exposed.index
    far = () if index is None else series.strays(index.tolist())
    if index is None or not far or len(series.numbers) != images.name.size:
        return "", ""
    return (
        f"{images.name.size} images, {index.size} events: {series.listed(far)} does not fit, the "
        f"other names may be the log's numbers {index.min()} to {index.max()}; ",
        f"write events.log.{exposed.camera}.image: {series.pattern('index')} if these are the "
        "log's numbers, or correct the name in the observations; or ",
    )


def anchor_rows(
    anchor: FirstImage | None, images: CameraImages, exposed: Events
) -> tuple[int, int] | None:
    """Rows of the image and the event that the mission file says belong together."""
    if anchor is None:
        return None
    row, events = np.flatnonzero(images.name == anchor.image), exposed.time_ns.size
    if row.size == 0 or anchor.event > events:
        raise MissionError.of(
            "EVENTS-FIRST-IMAGE", f"events.first_image.{exposed.camera}", image=anchor.image,
            event=anchor.event, events=events, first=images.name[0],
        )  # fmt: skip
    return int(row[0]), anchor.event - 1


def evidence_of_images(
    exposed: Events, images: CameraImages, files: ImageTimes | None
) -> ImageEvidence:
    """Numbers of the images, and their times from the first event on where files have them."""
    total = -1 if exposed.lost else None  # where pulses were lost, equal counts mean nothing
    count, numbering = images.name.size, images.numbering
    evidence = ImageEvidence(count, number=images.number, numbering=numbering, total=total)
    if files is None:
        return evidence
    time_ns = np.append(files.time_ns, NO_TIME)[images.file]
    timed, begin = time_ns != NO_TIME, exposed.time_ns[0]
    if not bool(timed.any()):
        return evidence
    return replace(
        evidence,
        time_s=np.where(timed, (np.where(timed, time_ns, begin) - begin) / 1e9, np.nan),
        sigma_s=np.append(files.sigma_s, np.nan)[images.file],
        clock_sigma_s=files.clock_sigma_s,
    )


def describe_assignment(assignment: Assignment, images: CameraImages, exposed: Events) -> str:
    """An assignment with its residuals and its runner-up, in one sentence or two."""
    assigned = int((assignment.event >= 0).sum())
    text = f"{assigned} of {images.name.size} images and {exposed.time_ns.size} events"
    if assigned:
        i = int(np.argmax(assignment.event >= 0))
        event = assignment.event[i]
        number = event + 1 if exposed.index is None else exposed.index[event]
        text += f", {images.name[i]} of event {number}"
    text += f", by {', '.join(assignment.evidence)}"
    residual = assignment.residual_s[np.isfinite(assignment.residual_s)]
    if residual.size:
        rms, most = np.sqrt(np.mean(residual**2)), np.abs(residual).max()
        text += f"; times fit to {rms:.3f} s rms, {most:.3f} s at most, "
        text += f"after {assignment.offset_s:+.3f} s and {1e6 * assignment.drift:+.1f} ppm"
    if assignment.runner_up.size:
        decades = assignment.log_ratio / np.log(10)
        text += f"; the next best assignment ({assignment.shift:+d} events) is "
        text += f"10^{decades:.0f} times less likely"
    return text
