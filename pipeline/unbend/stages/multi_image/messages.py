"""Messages about several images: events, orientations, tie points, object and control points."""

import math

from unbend.errors import Code, Counted, InputError, MissionError
from unbend.flight.messages import IMAGES_OTHER
from unbend.messages import Kind, Message, finding, loss, message, note, warning
from unbend.stages.messages import POINTS_MISSING
from unbend.tables.geodata.messages import POINTS_EMPTY
from unbend.tables.imports.messages import IMPORT_CONTRADICTED, ORIENTATION_FRAME


def images_of_another_flight(*, where: str, absent: str, files: str) -> InputError:
    """No image of the observations is among the image files: one of each is named."""
    return InputError(
        IMAGES_OTHER,
        (
            "none of the images of the observations is in the folder: it does not have {absent}, "
            "but it has {files}"
        ),
        where=where,
        absent=absent,
        files=files,
        remedy="check events.images.path; names may differ only in their ending",
    )


IMAGES_ABSENT = Code(
    "IMAGES-ABSENT",
    means="Images of the observations are not among the files of events.images.",
    effect="Their times are unknown.",
    remedy="Check events.images.path.",
)


def images_absent(*, where: str, count: int, first: str) -> Message:
    """Observed images that are not among the files."""
    return loss(
        IMAGES_ABSENT,
        "{count} observed images are missing, the first is {first}",
        one="1 observed image is missing: {first}",
        where=where,
        count=count,
        first=first,
    )


EVENTS_CONTRADICTED = Code(
    "EVENTS-CONTRADICTED",
    means=(
        "The numbers of the log in the names of images are contradicted by tie points, by times or "
        "positions of the images, or by the pair under events.first_image."
    ),
    effect="The mission is refused.",
    remedy=(
        "Check which camera the channel belongs to. Count the images by {n} or name them by *. "
        "Then the evidence decides."
    ),
)


def numbers_contradicted(*, where: str, found: str, of: str, evidence: str) -> MissionError:
    """Evidence contradicts the log's numbers in the names of images.

    ``found`` is the assignment by the evidence, in words; ``of`` the key of the camera's events.
    """
    return MissionError(
        EVENTS_CONTRADICTED,
        "{evidence} contradict the numbers of the log in the names of images: {found}",
        where=where,
        evidence=evidence,
        found=found,
        of=of,
        remedy=(
            "check {of}.channel (which camera?), {of}.image (which numbers?) and "
            "observations.path (of this flight?); count the images by {{n}} or name them by *; "
            "then the evidence decides"
        ),
    )


EVENTS_AMBIGUOUS = Code(
    "EVENTS-AMBIGUOUS",
    means=(
        "The assignment of images to events is not decided. Another assignment is nearly as "
        "likely, or there are more images than events, so that a part of the images may be "
        "shifted. One mistyped image name in the table can cause this."
    ),
    effect="The mission is refused.",
    remedy=(
        "Correct the image names that the refusal lists. If the numbers in the names are the "
        "numbers of the log, write {index} in events.log.<camera>.image, as IMG_{index:04d}.JPG. "
        "If not, state one pair under events.first_image.<camera>, or give the times of the images "
        "under events.images."
    ),
)


def assignment_ambiguous(
    *, where: str, strays: str, why: str, found: str, mend: str, camera: str, first: str
) -> MissionError:
    """It is not decided which image belongs to which event.

    In words: ``why``; ``found``, the best assignment; ``strays``, names that do not fit the log,
    and ``mend``, how to correct these (both empty if there are no such names).
    """
    return MissionError(
        EVENTS_AMBIGUOUS,
        "{strays}the assignment of images to events is not decided: {why}. {found}",
        where=where,
        strays=strays,
        why=why,
        found=found,
        mend=mend,
        camera=camera,
        first=first,
        remedy=(
            "{mend}state one under events.first_image.{camera}, as {{image: {first}, event: 1}}; "
            "or give the images' times under events.images"
        ),
    )


EVENTS_ASSIGNED = Code(
    "EVENTS-ASSIGNED",
    means=(
        "The assignment of images to events: its evidence, its residuals, and how likely the next "
        "best assignment is."
    ),
    effect="The stations are computed from it.",
    remedy="If points do not fit, check the residuals and the next best assignment.",
)


def events_assigned(*, where: str, count: int, description: str) -> Message:
    """How images were assigned to events."""
    return note(
        EVENTS_ASSIGNED,
        "{description}",
        where=where,
        count=count,
        description=description,
    )


EXIF_CLOCK = Code(
    "EXIF-CLOCK",
    means="The clock of the camera differs by more than a day from the clock of the log.",
    effect="The images were still assigned, by the pattern of their intervals and their order.",
    remedy="Check whether the images are of this day.",
)


def camera_clock_off(*, where: str, hours: float) -> Message:
    """The camera's clock differs by more than a day from that of the log."""
    return warning(
        EXIF_CLOCK,
        "the camera's clock is wrong by {hours:+.1f} h: are the images of this day?",
        where=where,
        hours=hours,
    )


EVENTS_UNDECIDED = Code(
    "EVENTS-UNDECIDED",
    means=(
        "For some images, one part of the evidence gives one event, and the other part another "
        "event."
    ),
    effect="They have no station.",
    remedy="Check the names and times of these images.",
)


def events_undecided(*, where: str, count: int, images: str) -> Message:
    """Images for which the evidence gives different events; ``images`` lists the first names."""
    return loss(
        EVENTS_UNDECIDED,
        ("the evidence gives different events for {count} images, which have no event: {images}"),
        one=("the evidence gives different events for 1 image, which has no event: {images}"),
        where=where,
        count=count,
        images=images,
    )


EVENTS_UNUSED = Code(
    "EVENTS-UNUSED",
    means="Events have no image.",
    effect="None.",
    remedy="Nothing, if these images were not measured or kept.",
)


def events_unused(*, where: str, count: int, events: str) -> Message:
    """Events without an image; ``events`` lists the first numbers."""
    return note(
        EVENTS_UNUSED,
        "{count} events have no image: {events}",
        one="1 event has no image: {events}",
        where=where,
        count=count,
        events=events,
    )


EVENTS_FIRST_IMAGE = Code(
    "EVENTS-FIRST-IMAGE",
    means="events.first_image names an image or an event that does not exist.",
    effect="The mission is refused.",
    remedy="Name an image of this camera with its name in the observations.",
)


def first_image_missing(
    *, where: str, image: str, event: int, events: int, first: str
) -> MissionError:
    """The image or the event under events.first_image does not exist.

    ``event`` is its number, counted from 1; ``events`` is how many there are.
    """
    return MissionError(
        EVENTS_FIRST_IMAGE,
        (
            "there is no image {image!r}, or no event {event} of {events}; the first image is "
            "{first!r}"
        ),
        where=where,
        image=image,
        event=event,
        events=events,
        first=first,
        remedy="name an image of this camera with its name in the observations or the folder",
    )


ORIENTATION_READING = Code(
    "ORIENTATION-READING",
    means=(
        "The rays of tie points intersect far better if the angles or the positions are read in "
        "another way, which the entry names."
    ),
    effect="The mission is refused.",
    remedy=(
        "State the content of the file: unit, angles or columns under stations.orientation, "
        "angle_unit or columns under stations.trajectory. Or correct the file: heights in feet "
        "are multiplied by 0.3048, because they have no key."
    ),
)


def orientation_reading(
    *, where: str, points: int, likely: str, better: float, changed: str
) -> InputError:
    """Tie points meet far better by another reading of the orientations.

    ``likely`` is the reading in words, ``better`` by how much its natural log likelihood is higher,
    ``changed`` what to change.
    """
    return InputError(
        ORIENTATION_READING,
        (
            "the rays of {points} tie points intersect far better {likely}: the log likelihood is "
            "{better:.0f} higher"
        ),
        where=where,
        points=points,
        likely=likely,
        better=better,
        changed=changed,
        remedy="change {changed}, or correct the file",
    )


ORIENTATION_OUTLIER = Code(
    "ORIENTATION-OUTLIER",
    means=(
        "Most rays of one or of few images miss the rays of the other images to the same points: "
        "the position or the attitude of the image is wrong."
    ),
    effect="The image is corrected with this orientation. The run ends with exit code 3.",
    remedy="Correct the image in the file, or remove it.",
)


def images_misplaced(
    *, where: str, count: int, is_all: bool, image: str, bad_percent: float
) -> Message:
    """``count`` images do not fit the others; of the worst one most rays miss.

    ``is_all`` : False if the search ended before all were found.
    """
    return finding(
        ORIENTATION_OUTLIER,
        "{at_least}{count} images do not fit the others, the worst is {image}: {bad_percent:.0f} % "
        "of its rays miss those of other images to the same points",
        one="the image {image} does not fit the others: {bad_percent:.0f} % of its rays miss those "
        "of other images to the same points",
        where=where,
        count=count,
        at_least="" if is_all else "at least ",
        image=image,
        bad_percent=bad_percent,
    )


BLOCK_CAMERA = Code(
    "BLOCK-CAMERA",
    means="Images of the block belong to a camera that the mission file does not define.",
    effect="The mission is refused.",
    remedy="Give cameras.<name>.camera, the name or number that it has in the block.",
)


def block_camera_unknown(*, where: str, total: int, image: str, name: str) -> MissionError:
    """A camera of a block that the mission file does not define."""
    return MissionError(
        BLOCK_CAMERA,
        (
            "{total} images, the first {image}, are of camera {name!r}, which the mission file "
            "does not define"
        ),
        where=where,
        total=total,
        image=image,
        name=name,
        remedy="give cameras.<name>.camera, the name or number that it has there",
    )


def block_without_points(*, where: str) -> InputError:
    """A block has no object points."""
    return InputError(
        POINTS_EMPTY,
        "the block has no object points",
        where=where,
        remedy="give ground.height in another way",
    )


def frame_impossible(*, where: str, height_m: float) -> InputError:
    """In the stated frame the points of a block have impossible heights (median ``height_m``)."""
    return InputError(
        ORIENTATION_FRAME,
        "in that frame the points of the block are {height_m:.0f} m above sea level",
        where=where,
        height_m=height_m,
        remedy=(
            "give the frame of the program as stations.orientation.frame: a local frame is not "
            "ecef; {{enu: ...}} needs its origin; the frame of a model made only from images is "
            "unknown"
        ),
    )


def frame_unstated(*, where: str) -> MissionError:
    """Neither the mission file nor the block states the frame of its x, y and z."""
    return MissionError(
        ORIENTATION_FRAME,
        "the file does not state the frame of its x, y and z",
        where=where,
        remedy=(
            "give stations.orientation.frame: ecef; {{enu: {{lat_deg, lon_deg, h_ellipsoid_m}}}}; "
            "projected, with crs; or unknown, with known_positions"
        ),
    )


def angles_of_one_frame(*, where: str, stated: str, latitude_deg: float) -> MissionError:
    """A table exported by unbend has angles in one frame, but the stated frame is another one.

    The stated one has angles relative to the vertical of each image.
    """
    return MissionError(
        ORIENTATION_FRAME,
        (
            "its angles are relative to east, north and up at one place (origin_lat_deg "
            "{latitude_deg:.6f}), not at each image, as frame: {stated} states"
        ),
        where=where,
        stated=stated,
        latitude_deg=latitude_deg,
        remedy=(
            "give stations.orientation.frame: {{enu: {{lat_deg, lon_deg, h_ellipsoid_m}}}} with "
            "the columns origin_lat_deg, origin_lon_deg, origin_h_ellipsoid_m; or use export "
            "--format opk"
        ),
    )


GROUND_BLOCK = Code(
    "GROUND-BLOCK",
    means=(
        "Ground heights are taken from the points of the block. Image points without a point of "
        "the block get the median of their image."
    ),
    effect="As stated.",
    remedy="Nothing, if the relief is small compared with the flying height.",
)


def ground_of_block(*, where: str, count: int, low: float, high: float, apart: float) -> Message:
    """Ground heights are those of the points of a block, ``low`` to ``high`` m above sea level.

    ``apart`` is their median distance [m] from the median height in their image.
    """
    return note(
        GROUND_BLOCK,
        (
            "{count} points of the block are {low:.0f} to {high:.0f} m above sea level; image "
            "points without a point of the block get the median of their image; the median "
            "distance of the points from it is {apart:.0f} m"
        ),
        one=(
            "1 point of the block is {low:.0f} m above sea level; image points without a point of "
            "the block get the median of their image; the median distance of the points from it is "
            "{apart:.0f} m"
        ),
        where=where,
        count=count,
        low=low,
        high=high,
        apart=apart,
    )


ORIENTATION_HEIGHT = Code(
    "ORIENTATION-HEIGHT",
    means=(
        "The heights of the cameras above the ground. Some stations may be below the ground, or "
        "more than 15 km above it."
    ),
    effect=(
        "A note; a warning if stations are below the ground or too high above it. Refused if more "
        "than a tenth are below the ground. If up to a tenth are too high, these are suspect: a "
        "loss."
    ),
    remedy=(
        "Check the column of heights, its unit, heights (msl or ellipsoid), and the same for the "
        "ground."
    ),
)


def stations_below_ground(
    *, where: str, count: int, total: int, median: float, low: float, high: float
) -> MissionError:
    """Too many stations are below the ground.

    ``median``, ``low`` and ``high`` are heights above the ground [m], of all usable stations.
    """
    return MissionError(
        ORIENTATION_HEIGHT,
        (
            "{count} of {total} stations are below the ground: the cameras are {median:.0f} m "
            "above the ground in the median, {low:.0f} to {high:.0f} m"
        ),
        one=(
            "1 of {total} stations is below the ground: the cameras are {median:.0f} m above "
            "the ground in the median, {low:.0f} to {high:.0f} m"
        ),
        where=where,
        count=count,
        total=total,
        median=median,
        low=low,
        high=high,
        remedy=(
            "check the column of heights, their unit (metres), heights (msl or ellipsoid), and the "
            "same for the ground"
        ),
    )


def stations_too_high(
    *, where: str, count: int, first: str, median: float, low: float, high: float
) -> Message:
    """A few stations far above the others.

    ``median``, ``low`` and ``high`` are heights above the ground [m], of all usable stations.
    """
    return loss(
        ORIENTATION_HEIGHT,
        (
            "{count} stations are suspect, the first {first}: the cameras are {median:.0f} m "
            "above the ground in the median, {low:.0f} to {high:.0f} m"
        ),
        one=(
            "1 station is suspect, {first}: the cameras are {median:.0f} m above the ground in "
            "the median, {low:.0f} to {high:.0f} m"
        ),
        where=where,
        count=count,
        first=first,
        median=median,
        low=low,
        high=high,
    )


def heights_above_ground(
    *, kind: Kind, where: str, count: int, median: float, low: float, high: float
) -> Message:
    """How high the stations are above the ground; a warning where some are below or far above."""
    return message(
        kind,
        ORIENTATION_HEIGHT,
        "the cameras are {median:.0f} m above the ground in the median, {low:.0f} to {high:.0f} m",
        where=where,
        count=count,
        median=median,
        low=low,
        high=high,
    )


def frame_contradicted(*, where: str, found: str, stated: str) -> Message:
    """A file and the mission file name different frames."""
    return warning(
        IMPORT_CONTRADICTED,
        "the frame is {found} in the file and {stated} in the mission file, which is used",
        where=where,
        found=found,
        stated=stated,
    )


def no_point_in_table(*, where: str, total: int, point: str, first: str) -> InputError:
    """No observed point is in the table of object points."""
    return InputError(
        POINTS_MISSING,
        (
            "none of the points of {total} observations is in the table: the observations have "
            "{point} ..., the table has {first} ..."
        ),
        where=where,
        total=total,
        point=point,
        first=first,
        remedy=(
            "write the names as in the observations, or name the column: "
            "ground.height.columns.point"
        ),
    )


POINTS_FAR = Code(
    "POINTS-FAR",
    means="The points are far from the stations.",
    effect="A loss. Refused if the points are beyond the horizon of the stations.",
    remedy="Name the columns and the crs of the table. x is east, y is north.",
)


def points_beyond_horizon(*, where: str, km: float, other: str) -> InputError:
    """Object points are beyond the horizon of the stations that see them.

    ``km`` is the median distance; ``other`` a likely cause in words, empty if unknown.
    """
    return InputError(
        POINTS_FAR,
        (
            "the object points are {km:.0f} km from the stations that see them, in the "
            "median{other}: beyond the horizon"
        ),
        where=where,
        km=km,
        other=other,
        remedy=(
            "name the columns, and state their coordinate system: ground.height.columns, "
            "ground.height.crs"
        ),
    )


def points_far(*, where: str, count: int, km: float, other: str) -> Message:
    """Object points are very far from the stations that see them.

    ``km`` is the median distance; ``other`` a likely cause in words, empty if unknown.
    """
    return loss(
        POINTS_FAR,
        "the object points are {km:.0f} km from the stations that see them, in the median{other}",
        where=where,
        count=count,
        km=km,
        other=other,
    )


GROUND_INTERSECTED = Code(
    "GROUND-INTERSECTED",
    means=(
        "Ground heights are computed by intersection of the rays of points in several images. The "
        "entry gives their number and their sigma."
    ),
    effect=(
        "A note; a loss if the median sigma is more than 5 % of the height above the points. "
        "Refused if no rays intersect."
    ),
    remedy="If there are too few rays, give ground.height as a number, a column or a table.",
)


def no_height_intersected(
    *, where: str, known: int, points: int, few: int, narrow: int, apart: int
) -> MissionError:
    """No point has a height by the intersection of its rays.

    ``few``, ``narrow`` and ``apart`` count the points without a height by reason (`PointHeights`).
    """
    return MissionError(
        GROUND_INTERSECTED,
        (
            "{known} of {points} have a height by the intersection of their rays; fewer than two "
            "rays: {few}, only rays within 3 deg of each other: {narrow}, rays that do not "
            "intersect: {apart}"
        ),
        where=where,
        known=known,
        points=Counted(points, "point"),
        few=few,
        narrow=narrow,
        apart=apart,
        remedy=(
            "give ground.height as a number or a column; the same point must have the same name "
            "in all images"
        ),
    )


def heights_intersected(
    *,
    kind: Kind,
    where: str,
    count: int,
    points: int,
    few: int,
    narrow: int,
    apart: int,
    percent: float,
) -> Message:
    """How many points have a height by intersection; a loss if these are too uncertain.

    ``few``, ``narrow`` and ``apart`` count the points without a height by reason (`PointHeights`);
    ``percent`` is the median sigma of a height, of the camera's height above the point.
    """
    return message(
        kind,
        GROUND_INTERSECTED,
        (
            "{count} of {points} have a height by the intersection of their rays; fewer than two "
            "rays: {few}, only rays within 3 deg of each other: {narrow}, rays that do not "
            "intersect: {apart}; sigma of a height is {percent:.2g} % of the height above it, in "
            "the median"
        ),
        one=(
            "1 of {points} has a height by the intersection of its rays; fewer than two rays: "
            "{few}, only rays within 3 deg of each other: {narrow}, rays that do not intersect: "
            "{apart}; sigma of the height is {percent:.2g} % of the height above it"
        ),
        where=where,
        count=count,
        points=Counted(points, "point"),
        few=few,
        narrow=narrow,
        apart=apart,
        percent=percent,
    )


CONTROL_MISSING = Code(
    "CONTROL-MISSING",
    means="None of the control points is measured in an image.",
    effect="The mission is refused.",
    remedy=("Write the names as in the observations, or name their column under control.columns."),
)


def control_missing(*, where: str, total: int, name: str, first: str) -> InputError:
    """None of the control points is observed."""
    return InputError(
        CONTROL_MISSING,
        (
            "none of {total} control points is measured in an image: the control points are {name} "
            "..., the points of the observations are {first} ..."
        ),
        where=where,
        total=total,
        name=name,
        first=first,
        remedy="write the names as in the observations, or name the column: control.columns.point",
    )


CONTROL_RAYS = Code(
    "CONTROL-RAYS",
    means="No control point has rays that intersect at 3 degrees or more.",
    effect="There is no comparison before and after the correction.",
    remedy="Measure control points in two or more images.",
)


def control_without_rays(*, where: str, count: int) -> Message:
    """No control point has rays that meet."""
    return loss(
        CONTROL_RAYS,
        (
            "none of {count} control points has a height and rays that intersect at 3 deg or more: "
            "there is nothing to compare"
        ),
        one=(
            "the control point has no height, or no rays that intersect at 3 deg or more: there is "
            "nothing to compare"
        ),
        where=where,
        count=count,
    )


CONTROL_READING = Code(
    "CONTROL-READING",
    means=(
        "The control points fit far better if they are read in another way: feet, another zero of "
        "heights, exchanged coordinates."
    ),
    effect="No result changes. The run ends with exit code 3.",
    remedy="Correct control.crs, control.reference or control.columns as the entry states.",
)


def control_reading(*, where: str, count: int, stated: float, off: float, likely: str) -> Message:
    """Control points fit far better by another reading of their table.

    ``stated`` and ``off`` are the median distances [m] from where rays intersect, as the table is
    stated and by the ``likely`` reading.
    """
    return finding(
        CONTROL_READING,
        (
            "the rays of {count} control points intersect {stated:.4g} m from them, in the median, "
            "but {off:.2g} m with {likely}: change control.crs, control.reference or "
            "control.columns"
        ),
        one=(
            "the rays of 1 control point intersect {stated:.4g} m from it, but {off:.2g} m with "
            "{likely}: change control.crs, control.reference or control.columns"
        ),
        where=where,
        count=count,
        stated=stated,
        off=off,
        likely=likely,
    )


CONTROL_FAR = Code(
    "CONTROL-FAR",
    means=(
        "The rays of control points intersect far from the points. No other reading of the "
        "coordinates fits."
    ),
    effect="No result changes. The run ends with exit code 3.",
    remedy="Check names, control.crs and control.reference, and the stations.",
)


def control_far(*, where: str, count: int, stated: float, sigma: float) -> Message:
    """Control points are far from where their rays meet: ``stated`` m in the median.

    ``sigma`` is the part that the sigmas of the stations explain [m].
    """
    return finding(
        CONTROL_FAR,
        (
            "the rays of {count} control points intersect {stated:.4g} m from them, in the median "
            "(sigmas of the stations explain {sigma:.2g} m): wrong names of points, another system "
            "(control.crs, control.reference), or wrong stations"
        ),
        one=(
            "the rays of 1 control point intersect {stated:.4g} m from it (sigmas of the stations "
            "explain {sigma:.2g} m): a wrong name of the point, another system (control.crs, "
            "control.reference), or wrong stations"
        ),
        where=where,
        count=count,
        stated=stated,
        sigma=sigma,
    )


CONTROL_OUTLIER = Code(
    "CONTROL-OUTLIER",
    means="The residuals of single control points are far larger than those of the others.",
    effect="No result changes. The run ends with exit code 3.",
    remedy="Check the name, the measurement and the survey of these points.",
)


def control_outlier(
    *, where: str, count: int, total: int, most: float, median: float, names: str
) -> Message:
    """Single control points have far larger residuals than the others.

    ``most`` and ``median`` are residuals [m]; ``names`` lists the first of these points.
    """
    return finding(
        CONTROL_OUTLIER,
        (
            "{count} of {total} control points have residuals of up to {most:.2g} m, the others "
            "{median:.2g} m: {names}; the name, the measurement or the survey of a point is wrong"
        ),
        one=(
            "1 of {total} control points has a residual of {most:.2g} m, the others {median:.2g} "
            "m: {names}; the name, the measurement or the survey of a point is wrong"
        ),
        where=where,
        count=count,
        total=total,
        most=most,
        median=median,
        names=names,
    )


CONTROL_NOISE = Code(
    "CONTROL-NOISE",
    means=(
        "The scatter of the control points, or the uncertainty of the stations, is larger than the "
        "effect of refraction."
    ),
    effect="None. The comparison before and after the correction shows little.",
    remedy="To see the effect, use more control points or better stations.",
)


def control_noise(*, where: str, count: int, of: str, noise: float, effect: float) -> Message:
    """Control points are too noisy to show the effect of the correction.

    ``of`` is the source of the ``noise`` [m], in words; ``effect`` is that of the correction [m].
    """
    return warning(
        CONTROL_NOISE,
        (
            "{of} by {noise:.3g} m, and the corrections move them by {effect:.3g} m: no single "
            "point shows the effect of the correction"
        ),
        where=where,
        count=count,
        of=of,
        noise=noise,
        effect=effect,
    )


CONTROL_WORSE = Code(
    "CONTROL-WORSE",
    means="With the correction, the rays are farther from the control points.",
    effect="The correction is kept. The run ends with exit code 3.",
    remedy=(
        "Check whether the calibration, the stations or the control points were adjusted to images "
        "that contain refraction, or whether refraction was removed before."
    ),
)


def control_worse(*, where: str, count: int, was: float, now: float) -> Message:
    """Control points have larger residuals (rms [m]) after the correction than before."""
    return finding(
        CONTROL_WORSE,
        (
            "{count} control points have residuals of {was:.3g} m before and {now:.3g} m after the "
            "correction (RMS): their heights, the stations or the calibration were adjusted to "
            "images that contain refraction, or it was removed before (observations.refraction, "
            "cameras.<name>.calibration)"
        ),
        one=(
            "1 control point has a residual of {was:.3g} m before and {now:.3g} m after the "
            "correction: its height, the stations or the calibration were adjusted to images that "
            "contain refraction, or it was removed before (observations.refraction, "
            "cameras.<name>.calibration)"
        ),
        where=where,
        count=count,
        was=was,
        now=now,
    )


TIES_HEIGHT = Code(
    "TIES-HEIGHT",
    means="Tie points show that the stations, or the points, are at other heights than stated.",
    effect="R changes with the height. The run ends with exit code 3.",
    remedy=(
        "Check ground.height, ground.reference and the heights of the stations. If the rays still "
        "do not intersect well, and no datum explains the amount, check whether log.path and "
        "observations.path are of the same flight."
    ),
)

TIES_TIME = Code(
    "TIES-TIME",
    means="Tie points show that the exposures were earlier or later than stated.",
    effect="Stations are wrong along the track. The run ends with exit code 3.",
    remedy=("Check delay_s, the time system (GPS time is 18 s ahead of UTC) and the time zone."),
)

TIES_FOCAL = Code(
    "TIES-FOCAL",
    means="Tie points show that a principal distance differs from the stated one.",
    effect="The correction scales with it. The run ends with exit code 3.",
    remedy="Check cameras.<name>: f in pixels, of these images.",
)

TIES_CALIBRATION = Code(
    "TIES-CALIBRATION",
    means=(
        "Tie points show that a principal point or distortion has another sign or other axes than "
        "stated, or belongs to another camera."
    ),
    effect="Rays leave the camera in wrong directions. The run ends with exit code 3.",
    remedy=(
        "Check cameras.<name>: cx_px and cy_px are measured from the upper left corner, x to the "
        "right, y down; coefficients are of the distortion, not of the correction. Check whether "
        "the certificate belongs to this camera."
    ),
)

TIES_PIXELS = Code(
    "TIES-PIXELS",
    means="Tie points show that x and y are exchanged, or that y is measured upward.",
    effect="The corrections have a wrong direction. The run ends with exit code 3.",
    remedy=(
        "If x and y are exchanged, exchange them under observations.columns. If y is measured "
        "upward, replace y by the height of the image less y in the table of observations: no "
        "column turns an axis."
    ),
)

TIES_CAMERAS = Code(
    "TIES-CAMERAS",
    means="Tie points show that the images of two cameras are exchanged.",
    effect="The corrections are computed with the wrong cameras. The run ends with exit code 3.",
    remedy="Exchange them under cameras, mount or events.",
)

TIES_MOUNT = Code(
    "TIES-MOUNT",
    means=(
        "Tie points show that the angles of a mount differ from the stated ones. The entry gives "
        "the angles that fit."
    ),
    effect="Nadir angles are wrong by the difference. The run ends with exit code 3.",
    remedy="Check mount.<camera>: degrees, signs, order.",
)

TIES_RESIDUALS = Code(
    "TIES-RESIDUALS",
    means=(
        "The distance between the rays of tie points before adjustment. For this check alone the "
        "refraction of us1976 is removed, that of windows is not. As a finding: the rays intersect "
        "only in part or poorly, and no single mistake explains it."
    ),
    effect=(
        "As a note: none. As a finding: stations or cameras are probably wrong, and the run ends "
        "with exit code 3."
    ),
    remedy=("Nothing for a note. For a finding, check the most likely explanations in its list."),
)

ORIENTATION_TIES = Code(
    "ORIENTATION-TIES",
    means=(
        "How far the rays of tie points miss each other with the orientations of the table. A few "
        "pixels are usual with those of GNSS and inertial sensors, less than one with an adjusted "
        "block. It is a finding if the rays do not intersect, however the table is read."
    ),
    effect=(
        "A note has none. After a finding the run ends with exit code 3: the corrections use wrong "
        "stations or cameras."
    ),
    remedy="Check whether orientations, images and cameras belong to the same block.",
)


ORIENTATION_UNCHECKED = Code(
    "ORIENTATION-UNCHECKED",
    means=(
        "Fewer than ten points are measured in two images or more. So nothing checks a table of "
        "orientations, the heights, and the cameras."
    ),
    effect=(
        "Wrong angles, heights of stations or ground, principal distances, and axes of the pixels "
        "would give wrong corrections without a message."
    ),
    remedy=(
        "Give a point the same name in all images that show it; or compare a few points on the "
        "ground (export --format points)."
    ),
)


def orientation_unchecked(*, where: str, count: int, needed: int) -> Message:
    """Too few tie points to check orientations."""
    return warning(
        ORIENTATION_UNCHECKED,
        (
            "{count} points are measured in two images or more, {needed} are needed. Nothing "
            "checks the angles, the heights of stations and ground, the principal distance, and "
            "the axes of the pixels"
        ),
        one=(
            "1 point is measured in two images or more, {needed} are needed. Nothing checks the "
            "angles, the heights of stations and ground, the principal distance, and the axes of "
            "the pixels"
        ),
        where=where,
        count=count,
        needed=needed,
    )


ORIENTATION_RADIANS = Code(
    "ORIENTATION-RADIANS",
    means=(
        "The headings of a table of orientations follow the flight lines if its angles are "
        "radians, and not in the stated unit."
    ),
    effect="The correction is kept. The run ends with exit code 3.",
    remedy="State stations.orientation.unit: rad.",
)


def orientation_in_radians(*, where: str, camera: str, unit: str) -> Message:
    """The angles of a camera are likely radians, because its headings follow the flight then."""
    return finding(
        ORIENTATION_RADIANS,
        (
            "the headings of {camera} follow the flight lines if the angles are radians, not in "
            "the stated unit {unit}: likely radians ({where})"
        ),
        where=where,
        camera=camera,
        unit=unit,
    )


CERTAIN_DECADES = 6.0
"""An explanation 10^6 times as likely as its rival is practically certain. A larger factor would
show the model of errors rather than the flight."""

CONTRADICTIONS = {
    code.name: code
    for code in (
        TIES_MOUNT,
        TIES_HEIGHT,
        TIES_TIME,
        TIES_FOCAL,
        TIES_CALIBRATION,
        TIES_PIXELS,
        TIES_CAMERAS,
    )
}
"""Codes by their names, for the findings of `block.diagnosis`."""


def ties_contradict(
    *,
    code: str,
    where: str,
    count: int,
    mistake: str,
    decades: float,
    change: str,
    residual: float | None,
) -> Message:
    """Tie points contradict a part of the mission file.

    code : the name of one of `CONTRADICTIONS`.
    mistake, change : what is wrong, and what to change, in words.
    decades : log10 of how much likelier the mistake is than what is stated; infinite if the
        likelihoods are not compared.
    residual : remaining residuals over their sigmas; None if they are small.
    """
    text = "{mistake}: by {points}"
    if CERTAIN_DECADES < decades < math.inf:
        text += " this is practically certain"
    elif decades != math.inf:
        text += " this is 10^{decades:.0f} times as likely as what is stated"
    text += "; change {change}"
    if residual is not None:
        text += (
            "; the remaining residuals of the rays are {residual:.1f} times larger than the sigmas "
            "of the stations explain: the sigmas are too small, or there is another mistake, in "
            "addition to this one or instead of it"
        )
    return finding(
        CONTRADICTIONS[code],
        text,
        where=where,
        count=count,
        mistake=mistake,
        points=Counted(count, "tie point"),
        decades=decades,
        change=change,
        residual=residual if residual is not None else 0.0,
    )


def ties_miss(*, oriented: bool, where: str, count: int, misses: str) -> Message:
    """How far the rays of tie points miss each other, in words (``misses``).

    ``oriented`` : the stations are those of a table of orientations.
    """
    code = ORIENTATION_TIES if oriented else TIES_RESIDUALS
    return note(code, "{misses}", where=where, count=count, misses=misses)


def ties_do_not_meet(
    *, oriented: bool, where: str, count: int, misses: str, nearest: str
) -> Message:
    """Rays of tie points do not meet, and no mistake explains it.

    misses : how far the rays miss each other, in words.
    nearest : mistakes that explain a part of that, in words; empty without any.
    oriented : the stations are those of a table of orientations.
    """
    text = (
        "{misses}: the orientations are wrong (rows of other images or cameras, another "
        "convention, log.path of another flight), or a name of a point is used for different points"
    )
    if nearest:
        text += (
            "; the best explanation, although the rays still do not intersect with it: {nearest}"
        )
    code = ORIENTATION_TIES if oriented else TIES_RESIDUALS
    return finding(code, text, where=where, count=count, misses=misses, nearest=nearest)
