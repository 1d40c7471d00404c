"""Messages of files for other programs: refused options, and what was left out or changed."""

from pathlib import Path

from unbend.errors import Code, ConfigError, Counted, MissionError
from unbend.messages import Message, fallback, loss, note, warning

EXPORT_AIR_CHANGES = Code(
    "EXPORT-AIR-CHANGES",
    means=(
        "The air of the flight changes, so there are several profiles. A radial table is made with "
        "the middle profile."
    ),
    effect="The table is not exact for all images.",
    remedy="Export the lattice, which has the air of each image.",
)


def air_changes(*, where: str, count: int) -> Message:
    """The air changes during the flight; radial tables have one profile each."""
    return warning(
        EXPORT_AIR_CHANGES,
        (
            "the air of the flight changes over {count} profiles: each radial table is for the air "
            "of the middle one of its images; the lattice is for the air of each image"
        ),
        one=(
            "the air of the flight changes over 1 profile: each radial table is for the air of the "
            "middle one of its images; the lattice is for the air of each image"
        ),
        where=where,
        count=count,
    )


EXPORT_CALIBRATION = Code(
    "EXPORT-CALIBRATION",
    means=(
        "The camera was calibrated on images that contain refraction. The change of the "
        "calibration would count refraction twice."
    ),
    effect="The export is written. The command ends with exit code 3.",
    remedy="Use a laboratory calibration.",
)


def calibration_holds_refraction(*, where: str, name: str) -> Message:
    """A calibration was estimated on images with refraction in."""
    return loss(
        EXPORT_CALIBRATION,
        (
            "the calibration of camera {name} was estimated on images that contain refraction, and "
            "contains the refraction of its height: with the change, refraction counts twice"
        ),
        where=where,
        name=name,
    )


EXPORT_CAMERA = Code(
    "EXPORT-CAMERA",
    means="A camera of the stations has no calibration in the run.",
    effect="The export is refused.",
    remedy="Define it under cameras and run again.",
)


def camera_uncalibrated(*, where: Path | str, camera: str) -> MissionError:
    """A camera of the stations is not defined in the mission file of the run."""
    return MissionError(
        EXPORT_CAMERA,
        "camera {camera!r} has no calibration",
        where=where,
        camera=camera,
        remedy="give a calibration under cameras.{camera} and run again",
    )


EXPORT_CAMERAS = Code(
    "EXPORT-CAMERAS",
    means="The number of each camera in the files of COLMAP.",
    effect="None.",
    remedy="Nothing.",
)


def camera_numbers(*, where: str, count: int, numbers: str) -> Message:
    """The number of each camera; ``numbers`` lists them in words."""
    return note(EXPORT_CAMERAS, "camera {numbers}", where=where, count=count, numbers=numbers)


EXPORT_DISTORTION = Code(
    "EXPORT-DISTORTION",
    means=(
        "The distortion of the camera, or its different fx and fy, cannot be written for that "
        "program."
    ),
    effect="The export is refused.",
    remedy=(
        "Export --format bundler, which has no distortion. Or use a camera model that the program "
        "supports."
    ),
)


def distortion_unknown(*, where: Path | str, name: str, beyond: str, program: str) -> MissionError:
    """The program has no coefficients for the distortion; ``beyond`` names them."""
    return MissionError(
        EXPORT_DISTORTION,
        "the distortion of camera {name} (with {beyond}) cannot be written for {program}",
        where=where,
        name=name,
        beyond=beyond,
        program=program,
        remedy=(
            "export --format bundler, which has no distortion, or calibrate the "
            "camera with OpenCV's coefficients"
        ),
    )


EXPORT_ENDING = Code(
    "EXPORT-ENDING",
    means="The name of the file does not have the ending of the format.",
    effect="The export is refused.",
    remedy="Rename it as the refusal states.",
)


def ending_of_file(
    *, where: Path | str, name: str, ending: str, rename: str, others: str
) -> ConfigError:
    """A format of one file is asked for at a path without its ending.

    ``rename`` : a name that fits. ``others`` : formats with the ending of the path, "" for none.
    """
    return ConfigError(
        EXPORT_ENDING,
        "{name} is written to a file that ends in {ending}",
        where=where,
        remedy="rename it to {rename}, or choose from {others}"
        if others
        else "rename it to {rename}",
        name=name,
        ending=ending,
        rename=rename,
        others=others,
    )


def ending_of_folder(*, where: Path | str, name: str, rename: str, others: str) -> ConfigError:
    """A format of several files is asked for at a path with the ending of other formats.

    ``rename`` : a name that fits. ``others`` : the formats with this ending.
    """
    return ConfigError(
        EXPORT_ENDING,
        "{name} is written to a folder",
        where=where,
        remedy="rename it to {rename}, or choose from {others}",
        name=name,
        rename=rename,
        others=others,
    )


EXPORT_FORMAT = Code(
    "EXPORT-FORMAT",
    means="No export has this name.",
    effect="The export is refused.",
    remedy="Use one that `unbend export --help` lists.",
)


def format_unknown(
    *, where: Path | str, name: str, similar: str, of_program: str, known: str
) -> ConfigError:
    """No export has this name.

    ``similar`` : names of formats like it; ``of_program`` : formats for a program of this name;
    both "" for none. ``known`` : all formats.
    """
    remedy = "one of {known}"
    if similar:
        remedy = "perhaps {similar}?"
    if of_program:
        remedy = "for {name}: {formats}"
    return ConfigError(
        EXPORT_FORMAT,
        "no format is called {name!r}",
        where=where,
        remedy=remedy,
        name=name,
        similar=similar,
        formats=of_program,
        known=known,
    )


EXPORT_FRAME = Code(
    "EXPORT-FRAME",
    means="The frame of the exported block: east, north, up at the named place.",
    effect="It contains neither earth curvature nor a map projection.",
    remedy="In the program that reads it, set a local cartesian system.",
)


def block_frame(*, where: str, lat: float, lon: float, h: float) -> Message:
    """The origin of the frame of a block: degrees, and metres above the ellipsoid."""
    return note(
        EXPORT_FRAME,
        (
            "x, y, z are metres to the east, north and up from {lat:.5f} N, {lon:.5f} E, {h:.0f} m"
            " above the ellipsoid (WGS84), one frame for the block; neither earth curvature "
            "nor a map projection is applied"
        ),
        where=where,
        lat=lat,
        lon=lon,
        h=h,
    )


EXPORT_LEFT_OUT = Code(
    "EXPORT-LEFT-OUT",
    means=(
        "Observations or images are left out of the export. They are not ok, have no station, are "
        "repeated, or have the cause in the entry."
    ),
    effect="They are not in the export. The command ends with exit code 3.",
    remedy="Check their status in the results of the run.",
)


def stations_left_out(*, where: str, count: int, lacking: str, first: str) -> Message:
    """Stations that lack what the export needs."""
    return loss(
        EXPORT_LEFT_OUT,
        "left out: {count} stations without a {lacking}, the first {first}",
        one="left out: 1 station without a {lacking}, the image {first}",
        where=where,
        count=count,
        lacking=lacking,
        first=first,
    )


def points_beyond_distortion(*, where: str, count: int) -> Message:
    """Image points cannot be undistorted, or are single because others cannot."""
    return loss(
        EXPORT_LEFT_OUT,
        (
            "{count} image points are left out: they, or the other image points of the same object "
            "point, are beyond the radius for which the distortion of the camera is known"
        ),
        one=(
            "1 image point is left out: it, or the other image point of the same object point, is "
            "beyond the radius for which the distortion of the camera is known"
        ),
        where=where,
        count=count,
    )


def points_without_place(*, where: str, count: int, total: int) -> Message:
    """Observations that have no place on the ground."""
    return loss(
        EXPORT_LEFT_OUT,
        "{count} of {total} are left out: without a correction, a usable station or a place in "
        "the coordinate system",
        one="1 of {total} is left out: without a correction, a usable station or a place in the "
        "coordinate system",
        where=where,
        count=count,
        total=Counted(total, "observation"),
    )


def images_without_lattice(*, where: str, count: int, first: str) -> Message:
    """Images without a usable station, in a lattice."""
    return loss(
        EXPORT_LEFT_OUT,
        "{count} images have no usable station, and so no lattice; the first is {first}",
        one="1 image has no usable station, and so no lattice: {first}",
        where=where,
        count=count,
        first=first,
    )


def images_without_ground(*, where: str, count: int) -> Message:
    """Images of a camera without known ground, in radial tables."""
    return loss(
        EXPORT_LEFT_OUT,
        "left out: {count} images of {where}; the ground below them is not known",
        one="left out: 1 image of {where}; the ground below it is not known",
        where=where,
        count=count,
    )


def observations_left_out(
    *, where: str, count: int, total: int, unusable: int, again: int
) -> Message:
    """Observations are not in the block.

    ``unusable`` : not ok, without point or station; ``again`` : of a point that is repeated in its
    image.
    """
    return loss(
        EXPORT_LEFT_OUT,
        (
            "{count} of {total} are left out: not ok, without a point or a usable station "
            "({unusable}), or of a point that was measured before in the image ({again})"
        ),
        one=(
            "1 of {total} is left out: not ok, without a point or a usable station "
            "({unusable}), or of a point that was measured before in the image ({again})"
        ),
        where=where,
        count=count,
        total=Counted(total, "observation"),
        unusable=unusable,
        again=again,
    )


EXPORT_MODEL = Code(
    "EXPORT-MODEL",
    means=(
        "The lens is written in a model that differs from its calibration by the stated pixels."
    ),
    effect=(
        "The program that reads it has an error of this size. The change for measured points does "
        "not have it."
    ),
    remedy="If this matters, use the calibration of the run itself.",
)


def lens_simplified(*, where: str, name: str, misfit: float) -> Message:
    """The lens of a camera is written in a simpler model."""
    return loss(
        EXPORT_MODEL,
        (
            "the lens of camera {name} is written with k1, k2, k3, p1, p2, which differ from "
            "its calibration by up to {misfit:.3f} px; the change for measured points does "
            "not"
        ),
        where=where,
        name=name,
        misfit=misfit,
    )


EXPORT_NAMES = Code(
    "EXPORT-NAMES",
    means=(
        "Names cannot be written for that program. They become equal when they are shortened, or "
        "contain a character that separates columns."
    ),
    effect="The export is refused.",
    remedy="Rename them, or choose another format.",
)


def names_too_long(
    *, where: Path | str, kind: str, first: str, other: str, short: str, longest: int
) -> MissionError:
    """Two images, cameras or points (``kind``) have the same name after it is shortened.

    ``first``, ``other`` : the two names. ``longest`` : characters of a name.
    """
    return MissionError(
        EXPORT_NAMES,
        (
            "{kind}s {first!r} and {other!r} would both get the name {short!r}: names have at most "
            "{longest} characters in that format"
        ),
        where=where,
        remedy="rename them so that the last {longest} characters differ",
        kind=kind,
        first=first,
        other=other,
        short=short,
        longest=longest,
    )


def name_with_separator(*, where: Path | str, name: str, program: str) -> MissionError:
    """A name has a space, a comma or the like."""
    return MissionError(
        EXPORT_NAMES,
        "{name!r} contains a character that separates columns in files of {program}",
        where=where,
        name=name,
        program=program,
        remedy="rename it, or choose another format",
    )


EXPORT_NO_GROUND = Code(
    "EXPORT-NO-GROUND",
    means=(
        "The height of the ground below images is not known, or a corner of an image does not show "
        "the ground."
    ),
    effect=(
        "Such images have no footprint, or a lattice without corrections. A calibration is refused "
        "if it is so for all images."
    ),
    remedy="Give --ground-height.",
)


def no_calibration(*, where: Path | str) -> MissionError:
    """No calibration can be fitted, because no usable image has a known ground height."""
    return MissionError(
        EXPORT_NO_GROUND,
        "the height of the ground is not known below any usable image",
        where=where,
        remedy="give a height of the ground: --ground-height",
    )


def lattice_without_ground(*, where: str, count: int) -> Message:
    """Images have a lattice without corrections, because their ground height is unknown."""
    return loss(
        EXPORT_NO_GROUND,
        (
            "{count} images have a lattice without corrections: the run has no ground height for "
            "them; give one with --ground-height"
        ),
        one=(
            "1 image has a lattice without corrections: the run has no ground height for it; give "
            "one with --ground-height"
        ),
        where=where,
        count=count,
    )


def footprints_missing(*, where: str, count: int) -> Message:
    """Images without a footprint."""
    return loss(
        EXPORT_NO_GROUND,
        (
            "{count} images have no footprint: no ground height is known (give one with "
            "--ground-height), or a corner of the image does not show the ground"
        ),
        one=(
            "1 image has no footprint: no ground height is known (give one with --ground-height), "
            "or a corner of the image does not show the ground"
        ),
        where=where,
        count=count,
    )


EXPORT_NO_SIGMA = Code(
    "EXPORT-NO-SIGMA",
    means="Stations have no sigma of their position.",
    effect="Their pose priors have no covariance. COLMAP uses the covariance in its options.",
    remedy="State sigmas of the stations in the mission file.",
)


def sigmas_missing(*, where: str, count: int) -> Message:
    """Stations in a database have no sigma of their position."""
    return fallback(
        EXPORT_NO_SIGMA,
        (
            "{count} stations have no sigma of their position: their pose priors have no "
            "covariance, and COLMAP uses the covariance in its options"
        ),
        one=(
            "1 station has no sigma of its position: its pose prior has no covariance, and COLMAP "
            "uses the covariance in its options"
        ),
        where=where,
        count=count,
    )


EXPORT_NO_STATIONS = Code(
    "EXPORT-NO-STATIONS",
    means="No station has the data that the export needs.",
    effect="The export is refused.",
    remedy="Check the stations of the run: position and attitude.",
)


def no_station_placed(*, where: Path | str, lacking: str) -> MissionError:
    """No station has the data that the export needs."""
    return MissionError(
        EXPORT_NO_STATIONS,
        "no station has a {lacking}",
        where=where,
        remedy="give the stations of the mission: log, stations.orientation or stations.trajectory",
        lacking=lacking,
    )


EXPORT_NO_TIES = Code(
    "EXPORT-NO-TIES",
    means=(
        "No point was measured in two images, and no database with matches was read. So nothing "
        "connects the images."
    ),
    effect="The database is written without matches.",
    remedy="Measure the points in more than one image.",
)


def no_ties(*, where: str) -> Message:
    """The images of a database are not tied to each other."""
    return loss(
        EXPORT_NO_TIES,
        (
            "nothing connects the images of the database: no point was measured in two images, and "
            "there is no database with matches that was read and is still unchanged at its place"
        ),
        where=where,
    )


EXPORT_OPTION = Code(
    "EXPORT-OPTION",
    means="An option of the export is out of range, is not one of this format, or is missing.",
    effect="The export is refused.",
    remedy="Give it as the refusal states.",
)


def option_unknown(*, where: str, name: str, options: str) -> ConfigError:
    """A format does not have this option; ``where`` is its flag."""
    return ConfigError(
        EXPORT_OPTION,
        "{name} has no option {where}",
        where=where,
        remedy="its options are {options}",
        name=name,
        options=options,
    )


def grid_not_taken(*, name: str, takers: str) -> ConfigError:
    """A format has a fixed frame, and takes no coordinate system; ``takers`` are those that do."""
    return ConfigError(
        EXPORT_OPTION,
        "{name} has a fixed frame, and --crs is not allowed",
        where="--crs",
        remedy="leave it out, or choose a format that allows it: {takers}",
        name=name,
        takers=takers,
    )


def geoid_without_grid() -> ConfigError:
    """A geoid is given without the coordinate system that needs it."""
    return ConfigError(
        EXPORT_OPTION,
        "--geoid needs the vertical part of --crs, which is not given",
        where="--geoid",
        remedy="give both, as --crs EPSG:25832+7837 --geoid FILE",
    )


def option_out_of_range(
    *, where: str, given: float, lowest: float, highest: float, meaning: str
) -> ConfigError:
    """A value of an option is beyond its limits."""
    return ConfigError(
        EXPORT_OPTION,
        "{given:g} is not from {lowest:g} to {highest:g}",
        where=where,
        remedy="{meaning}",
        given=given,
        lowest=lowest,
        highest=highest,
        meaning=meaning,
    )


def pixel_size_unknown(*, where: Path | str, name: str) -> ConfigError:
    """A format in millimetres needs the size of the pixels, which is unknown."""
    return ConfigError(
        EXPORT_OPTION,
        "the size of the pixels of camera {name} is unknown, or they are not square",
        where=where,
        name=name,
        remedy="give the size of a pixel of this camera in micrometres: --pixel-um SIZE",
    )


EXPORT_POINT_HEIGHT = Code(
    "EXPORT-POINT-HEIGHT",
    means="The rays of points do not intersect, or at too small an angle (two rays: 3 degrees).",
    effect="These points are where their rays reach the ground height of the run.",
    remedy="Nothing. The adjustment moves them.",
)


def points_on_ground(*, where: str, count: int) -> Message:
    """Object points were placed on the ground, because their rays do not intersect."""
    return fallback(
        EXPORT_POINT_HEIGHT,
        (
            "the rays of {count} points do not intersect, or at too small an angle (3 degrees for "
            "two rays): these points are where the rays reach the ground height that the run used "
            "for them"
        ),
        one=(
            "the rays of 1 point do not intersect, or at too small an angle (3 degrees for two "
            "rays): the point is where they reach the ground height that the run used for it"
        ),
        where=where,
        count=count,
    )


EXPORT_POINTS = Code(
    "EXPORT-POINTS",
    means=("The exported corrected image coordinates: the number of points and of images."),
    effect="None.",
    remedy="Nothing.",
)


def points_written(*, where: str, count: int, points: int, images: int) -> Message:
    """How many observations, points and images a block has."""
    return note(
        EXPORT_POINTS,
        ("x_corrected_px, y_corrected_px of {observations:,} of {points:,} in {images:,}"),
        where=where,
        count=count,
        observations=Counted(count, "observation"),
        points=Counted(points, "point"),
        images=Counted(images, "image"),
    )


EXPORT_RESIDUAL = Code(
    "EXPORT-RESIDUAL",
    means=(
        "The fitted calibration leaves a part of the refraction. A calibration cannot contain this "
        "part."
    ),
    effect="Above 10 % it is a loss. Above 50 % it is refused, if it is more than 0.02 px.",
    remedy=(
        "Export corrected points, which contain no refraction: --format bundler for Metashape, "
        "colmap or colmap-database for COLMAP, opensfm for OpenSfM and ODM, bingo for BINGO and "
        "Inpho. A program that applies corrections itself takes --format lattice or lattice-csv."
    ),
)


_LEFT_BY_CALIBRATION = (
    "calibration {name} leaves {percent:.0f} % of the refraction, {left_px:.3f} of "
    "{effect_px:.3f} px, {left_m:.3f} of {effect_m:.3f} m"
)


def calibration_leaves(
    *,
    where: str,
    count: int,
    name: str,
    percent: float,
    residual: tuple[float, float],
    effect: tuple[float, float],
) -> Message:
    """A calibration that contains most of the refraction, but not all.

    ``residual``, ``effect`` : what it does not contain, and the refraction, in pixels and metres.
    """
    return loss(
        EXPORT_RESIDUAL,
        _LEFT_BY_CALIBRATION,
        where=where,
        count=count,
        name=name,
        percent=percent,
        left_px=residual[0],
        effect_px=effect[0],
        left_m=residual[1],
        effect_m=effect[1],
    )


def calibration_impossible(
    *,
    where: str,
    name: str,
    percent: float,
    residual: tuple[float, float],
    effect: tuple[float, float],
) -> MissionError:
    """No calibration contains most of the refraction; values as of `calibration_leaves`."""
    return MissionError(
        EXPORT_RESIDUAL,
        _LEFT_BY_CALIBRATION + ": no calibration can replace the correction of these images",
        where=where,
        remedy=(
            "export corrected points (--format bundler, colmap, opensfm or bingo) or the lattice; "
            "if the tilt of a camera changes from image to image, no calibration can contain the "
            "refraction"
        ),
        name=name,
        percent=percent,
        left_px=residual[0],
        effect_px=effect[0],
        left_m=residual[1],
        effect_m=effect[1],
    )


EXPORT_ROUNDED = Code(
    "EXPORT-ROUNDED",
    means=(
        "A COLMAP database stores 32-bit numbers. So coordinates are rounded by the stated part of "
        "a pixel."
    ),
    effect="As stated.",
    remedy="Export --format colmap, which is not rounded.",
)


def pixels_rounded(*, where: str, rounding: float) -> Message:
    """A database has fewer digits than the run; ``rounding`` is the largest error [px]."""
    return warning(
        EXPORT_ROUNDED,
        (
            "keypoints of a database are 32-bit numbers: coordinates are rounded by up to "
            "{rounding:.4f} px; the model (--format colmap) is not rounded"
        ),
        where=where,
        rounding=rounding,
    )


EXPORT_SINGLE = Code(
    "EXPORT-SINGLE",
    means="Points were measured in only one image.",
    effect=(
        "Their image points have no object point, or the format has no place for them. A bundle "
        "adjustment does not use them. A note; a warning if they are more than half of the image "
        "points."
    ),
    remedy=(
        "Give each point the same name in all images that show it: observations.columns.point "
        "names the column. If the points are really in one image only, measure them in more images."
    ),
)

_MOST_ARE_LOST = (
    "{percent:.0f} % of the {total}. Give each point the same name in all images that show it; "
    "observations.columns.point names the column"
)

MOST_SINGLE = 0.5  # share of the image points; more single ones are a warning


def single_points(*, where: str, count: int, total: int) -> Message:
    """Points were measured in one image only; the model has ``total`` image points."""
    if count > MOST_SINGLE * total:
        return warning(
            EXPORT_SINGLE,
            (
                "{count} points were measured in only one image. A bundle adjustment does not use "
                + _MOST_ARE_LOST
            ),
            where=where,
            count=count,
            total=Counted(total, "image point"),
            percent=100.0 * count / total,
        )
    return note(
        EXPORT_SINGLE,
        "{count} points were measured in only one image: their image points have no object point",
        one="1 point was measured in only one image: its image point has no object point",
        where=where,
        count=count,
    )


def single_points_not_written(*, where: str, count: int, total: int) -> Message:
    """Points of one image only, which are not written; the block has ``total`` image points."""
    if count > MOST_SINGLE * total:
        return warning(
            EXPORT_SINGLE,
            (
                "{count} image points are not written, because each is the only one of its object "
                "point. A bundle adjustment does not get " + _MOST_ARE_LOST
            ),
            where=where,
            count=count,
            total=Counted(total, "image point"),
            percent=100.0 * count / total,
        )
    return note(
        EXPORT_SINGLE,
        "{count} image points are not written: each is the only one of its object point",
        one="1 image point is not written: it is the only one of its object point",
        where=where,
        count=count,
    )


EXPORT_WINDOW = Code(
    "EXPORT-WINDOW",
    means="The camera looks through a window. A radial table is only for the air outside.",
    effect="The table does not contain R_cc.",
    remedy="Export the lattice, which contains both.",
)


def window_not_held(*, where: str, name: str) -> Message:
    """Radial tables of a camera behind a window."""
    return warning(
        EXPORT_WINDOW,
        (
            "camera {name} looks through a window: the radial tables contain only the refraction "
            "of the air outside; the lattice contains both"
        ),
        where=where,
        name=name,
    )


EXPORT_RIGS = Code(
    "EXPORT-RIGS",
    means=(
        "The rigs of several cameras, and their frames, of the database that was read. A rig is "
        "kept if its reference camera, and at least one other, is one camera of the mission."
    ),
    effect="A note; a warning if a rig is not kept. Then each of its cameras is a separate rig.",
    remedy="Define one camera of the mission for each camera of the rig.",
)


def rigs_kept(*, where: str, count: int, frames: int) -> Message:
    """Rigs of several cameras were copied with their frames."""
    return note(
        EXPORT_RIGS,
        "{count} rigs of several cameras are kept, with {frames}",
        one="1 rig of several cameras is kept, with {frames}",
        where=where,
        count=count,
        frames=Counted(frames, "frame"),
    )


def rigs_lost(*, where: str, count: int) -> Message:
    """Rigs of several cameras are not kept."""
    return warning(
        EXPORT_RIGS,
        (
            "{count} rigs of several cameras are not kept: not every camera of the rig is one "
            "camera of the mission with stations"
        ),
        one=(
            "1 rig of several cameras is not kept: not every camera of the rig is one camera of "
            "the mission with stations"
        ),
        where=where,
        count=count,
    )
