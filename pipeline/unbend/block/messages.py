"""Messages of block: what each code means, and the words of what is sent."""

import math

from unbend.errors import Code, Counted, MissionError
from unbend.messages import Kind, Message, finding, loss, message, note, warning

ORIENTATION_FAR = Code(
    "ORIENTATION-FAR",
    means="Images are far from the centre of all images.",
    effect=(
        "They are suspect: no corrected values, unless stations.use_suspect is true. The run ends "
        "with exit code 3."
    ),
    remedy="Check their coordinates: they may be exchanged, or of another zone.",
)


def orientation_far(
    *, where: str, count: int, total: int, first: int, limit_km: float, away_km: float
) -> Message:
    """Images are far from the centre of all images."""
    return loss(
        ORIENTATION_FAR,
        (
            "{count} of {total} images are more than {limit_km:.0f} km from the centre of all "
            "images: suspect; the first is {first}, {away_km:.0f} km away"
        ),
        where=where,
        count=count,
        total=total,
        first=first,
        limit_km=limit_km,
        away_km=away_km,
    )


ORIENTATION_FIT = Code(
    "ORIENTATION-FIT",
    means="How the model fits the known positions: residuals and the sigma of its vertical.",
    effect=(
        "A note; a warning with three positions; a loss if the positions contradict each other. "
        "Refused if the model does not fit."
    ),
    remedy="Check names and coordinates of the known positions. Give more than three.",
)


def orientation_fitted(
    *,
    kind: Kind,
    where: str,
    count: int,
    scale: float,
    fit: str,
    tilt_deg: float,
    sigma_m: float,
    contradictions: str,
) -> Message:
    """A model was fitted to known positions; a loss where they contradict it."""
    return message(
        kind,
        ORIENTATION_FIT,
        (
            "the model was fitted to {positions}: scale {scale:.6g}, {fit}; its vertical has a "
            "sigma of {tilt_deg:.2g} deg for positions with a sigma of {sigma_m:.2g} "
            "m{contradictions}"
        ),
        positions=Counted(count, "known position"),
        where=where,
        count=count,
        scale=scale,
        fit=fit,
        tilt_deg=tilt_deg,
        sigma_m=sigma_m,
        contradictions=contradictions,
    )


def orientation_fit(*, where: object, size: int, fit: str) -> MissionError:
    """A model is refused whose images are not where the known positions are."""
    return MissionError(
        ORIENTATION_FIT,
        "the model does not fit {size} known positions: {fit}",
        where=where,
        size=size,
        fit=fit,
        remedy=(
            "are latitude and longitude exchanged? do the names belong to other images? are x, y "
            "and z right-handed?"
        ),
    )


ORIENTATION_KNOWN = Code(
    "ORIENTATION-KNOWN",
    means="Fewer than three known positions are complete and belong to an image.",
    effect="The mission is refused.",
    remedy="Give known_positions of at least three images, off one line.",
)


def orientation_known(*, where: object, usable: int, known: int) -> MissionError:
    """Fewer than three known positions belong to an image."""
    return MissionError(
        ORIENTATION_KNOWN,
        (
            "{usable} of {known} known positions are complete and belong to an image of the "
            "orientation: a model in an unknown frame has no vertical, no north and no scale, and "
            "needs at least three known positions"
        ),
        where=where,
        usable=usable,
        known=known,
        remedy=(
            "give more known positions, with the names of images as in the orientation, "
            "or state the frame"
        ),
    )


ORIENTATION_LINE = Code(
    "ORIENTATION-LINE",
    means="The known positions are on one line. The model could roll about this line.",
    effect="The mission is refused.",
    remedy="Give positions of images that are not on this line.",
)


def orientation_line(*, where: object, size: int, sigma: float, tilt: float) -> MissionError:
    """The known positions lie on a line; ``tilt`` [deg] is infinite if they do so exactly."""
    text = "{size} known positions are on one line: the model can roll about it"
    if math.isfinite(tilt):
        text = (
            "{size} known positions are nearly on one line: with a sigma of {sigma:.3g} m, the "
            "model can roll about this line by {tilt:.2g} deg (one sigma)"
        )
    return MissionError(
        ORIENTATION_LINE,
        text,
        where=where,
        size=size,
        sigma=sigma,
        tilt=tilt,
        remedy="give known positions on both sides of that line",
    )


ORIENTATION_TURNS = Code(
    "ORIENTATION-TURNS",
    means=("The images turn against the flight. Yaw or the quaternion has the opposite sense."),
    effect="The mission is refused.",
    remedy="Yaw counts clockwise from north, kappa counter-clockwise; choose the other sense.",
)


def orientation_turns(*, where: object) -> MissionError:
    """The images turn against the flight."""
    return MissionError(
        ORIENTATION_TURNS,
        "the images turn against the flight: they turn left when the track turns right",
        where=where,
        remedy=(
            "yaw counts clockwise from north, kappa counter-clockwise; a quaternion may be the "
            "inverse of the needed one: choose the other sense of stations.orientation.angles"
        ),
    )


ORIENTATION_UP = Code(
    "ORIENTATION-UP",
    means="Cameras look above the horizon.",
    effect=(
        "They are suspect, without corrected values (exit code 3). Refused if more than a tenth of "
        "the cameras do so."
    ),
    remedy="Check the unit, the names of the angles, the frame, and the mount.",
)


def cameras_look_up(*, where: str, count: int, total: int, first: str) -> MissionError:
    """More than few cameras look above the horizon."""
    return MissionError(
        ORIENTATION_UP,
        "the camera looks above the horizon in {count} of {images}; the first is {first}",
        where=where,
        count=count,
        images=Counted(total, "image"),
        first=first,
        remedy=(
            "check unit (grad?), angles, columns (omega, phi, kappa; roll, pitch, yaw; q_w to q_z) "
            "and frame there, and the axes of the camera: x right, y down, z forward for a "
            "quaternion; a camera with roll, pitch and yaw of 0 looks straight down, unless mount "
            "states something else"
        ),
    )


def some_cameras_look_up(*, where: str, count: int, total: int, first: str) -> Message:
    """Few cameras look above the horizon."""
    return loss(
        ORIENTATION_UP,
        "the camera looks above the horizon in {count} of {images}: suspect; the first is {first}",
        where=where,
        count=count,
        images=Counted(total, "image"),
        first=first,
    )


FRAME_PLACES = Code(
    "FRAME-PLACES",
    means=(
        "The same files, or the log, have positions of the images. The stated frame of the block "
        "gives other positions: turned, tilted, or in another unit, scale or datum."
    ),
    effect="The stations are in the stated frame. The run ends with exit code 3.",
    remedy=(
        "Correct stations.orientation.frame, or give frame: unknown with known_positions. If the "
        "known positions are wrong, accept the finding."
    ),
)


def frame_contradicts_places(
    *, where: str, count: int, source: str, contradictions: str, extent: float, residual: float
) -> Message:
    """Known positions of images contradict the frame of a block."""
    return finding(
        FRAME_PLACES,
        (
            "{source} of {count} images, {extent:.0f} m across, contradict the frame of the block: "
            "{contradictions} (residuals {residual:.1f} m)"
        ),
        one="{source} of 1 image contradict the frame of the block: {contradictions}",
        where=where,
        count=count,
        source=source,
        contradictions=contradictions,
        extent=extent,
        residual=residual,
    )


FRAME_CONFIRMED = Code(
    "FRAME-CONFIRMED",
    means=(
        "Known positions of the images agree with the frame of the block in all properties that "
        "they can test."
    ),
    effect="None.",
    remedy="Nothing.",
)


def frame_confirmed(
    *, where: str, count: int, source: str, tested: str, residual: float
) -> Message:
    """Known positions of images agree with the frame of a block."""
    return note(
        FRAME_CONFIRMED,
        "{source} of {count} images confirm the frame of the block: {tested}; residuals "
        "{residual:.1f} m",
        one="{source} of 1 image confirms the place of the block: {tested}",
        where=where,
        count=count,
        source=source,
        tested=tested,
        residual=residual,
    )


FRAME_UNVERIFIED = Code(
    "FRAME-UNVERIFIED",
    means=(
        "No known positions confirm the frame of the block. The entry lists what nothing in this "
        "mission tests. Tie points with ground heights test its heights and a tilt of some degrees."
    ),
    effect=(
        "None. If one of the listed properties is wrong, no check reports it. A wrong scale, unit "
        "or tilt makes every correction wrong. A wrong place changes the climatology, the "
        "distance of the soundings and the undulation. A turn about the vertical changes "
        "positions and azimuths, but hardly the corrections."
    ),
    remedy=(
        "Compare place, extent and heights with the flight. For positions of four images or more "
        "(GNSS of the exposures, logged by the receiver or the camera), write "
        "stations.orientation.known_positions: {path: positions.csv}, a table of the columns "
        "image, latitude, longitude and height. The section events.images with positions in EXIF, "
        "the section control, and a database with pose priors confirm the frame too. Without "
        "any of these, export --format kml after the run: a map shows a wrong zone and a turn."
    ),
)


_WAYS_TO_CONFIRM = (
    "To confirm the frame, write stations.orientation.known_positions: {{path: positions.csv}}, or "
    "give events.images with positions in EXIF, or control. Without these, see the block in a map: "
    "export --format kml"
)

SMALL_BLOCK_M = 10.0  # of a smaller one decimals are shown: it is a model without scale


def untested_in_words(*, is_map: bool, has_tested_heights: bool) -> str:
    """What nothing tests of a frame without known positions.

    ``is_map`` : its positions are in a map projection. ``has_tested_heights`` : tie points show the
    heights above a given ground.

    >>> untested_in_words(is_map=True, has_tested_heights=True)
    'zone, datum and offsets of the map, a turn about the vertical, a tilt of a degree'
    """
    properties = ["zone, datum and offsets of the map" if is_map else "the place"]
    properties.append("a turn about the vertical")
    properties.append("a tilt of a degree" if has_tested_heights else "a tilt")
    if not has_tested_heights:
        properties += ["the scale", "the unit"]
    elif not is_map:
        properties.append("a scale about the height of the ground")
    return ", ".join(properties)


def frame_unverified(
    *,
    where: str,
    count: int,
    untested: str,
    extent: float,
    heights: tuple[float, float],
    latitude_deg: float,
    longitude_deg: float,
    system: str,
) -> Message:
    """Nothing confirms the frame of a block; ``system`` names its coordinate system, if it has one.

    ``untested`` lists what no check would notice. ``heights`` are the lowest and the highest of its
    images [m above sea level], the latitude and longitude those of their middle.
    """
    place = "at latitude {latitude_deg:.2f}, longitude {longitude_deg:.2f}"
    if system:
        place += " by {system}"
    return warning(
        FRAME_UNVERIFIED,
        (
            "no known positions confirm the frame of the block: no file has positions of four "
            "images or more. Not tested: {untested}. The {count} images are within {extent} m, "
            f"{{low:.0f}} to {{high:.0f}} m above sea level, {place}; compare this with the "
            "flight. " + _WAYS_TO_CONFIRM
        ),
        one=(
            "no known positions confirm the frame of the block of 1 image: no file has positions. "
            "Not tested: {untested}. The image is {high:.0f} m above sea level, "
            + place
            + "; compare this with the flight. "
            + _WAYS_TO_CONFIRM
        ),
        where=where,
        count=count,
        untested=untested,
        extent=f"{extent:,.0f}" if extent >= SMALL_BLOCK_M else f"{extent:.2g}",
        low=heights[0],
        high=heights[1],
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        system=system,
    )
