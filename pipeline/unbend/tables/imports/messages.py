"""Messages of trajectories, camera events, orientations and images of other programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unbend.errors import Code, Counted, InputError, MissionError
from unbend.messages import Kind, Message, fallback, loss, message, note, warning

EVENTS_COLUMN = Code(
    "EVENTS-COLUMN",
    means="The table of events lacks a column.",
    effect="The mission is refused.",
    remedy="Name its columns under events.csv.columns.",
)


EVENTS_CSV = Code(
    "EVENTS-CSV",
    means="The table of events cannot be read as CSV.",
    effect="The mission is refused.",
    remedy="Write it as UTF-8 with a header line and commas.",
)


EVENTS_EMPTY = Code(
    "EVENTS-EMPTY",
    means="No row of the table of events has a readable time.",
    effect="The mission is refused.",
    remedy="Write times as 2026-05-01T10:20:30.123Z.",
)


def events_empty(*, where: Path | str) -> InputError:
    """No row of the table of events has a readable time."""
    return InputError(
        EVENTS_EMPTY,
        "no row has a readable time",
        where=where,
        remedy="times look like 2026-05-01T10:20:30.123Z",
    )


EVENTS_TIME = Code(
    "EVENTS-TIME",
    means=(
        "Rows of the table of events have no readable time, or an impossible one: in the future, "
        "or of a clock that was never set (1970-01-01, 1980-01-06, GPS weeks before 1990)."
    ),
    effect="They are not used. Their images have no station.",
    remedy="Correct these rows.",
)


def events_without_time(*, where: str, count: int, line: int) -> Message:
    """Rows of a table of exposures have no readable time; ``line`` is that of the first."""
    return loss(
        EVENTS_TIME,
        "{count} rows have no readable or possible time, the first in line {line}",
        one="1 row has no readable or possible time: line {line}",
        where=where,
        count=count,
        line=line,
    )


EXIF_TIME = Code(
    "EXIF-TIME",
    means="Images have no time of exposure, or not on the same clock as the others.",
    effect="These times are not used.",
    remedy="Check the images. Other evidence can still assign them.",
)


def images_without_time(*, where: str, count: int, total: int, examples: str) -> Message:
    """Images without a time of exposure, or with a time of another clock than most images."""
    return loss(
        EXIF_TIME,
        "{count} of {total} have no time of exposure on the same clock: {examples}",
        one="1 of {total} has no time of exposure on the same clock: {examples}",
        where=where,
        count=count,
        total=Counted(total, "image"),
        examples=examples,
    )


EXIF_UNREADABLE = Code(
    "EXIF-UNREADABLE",
    means="The EXIF or the XMP of some files cannot be read.",
    effect="The values that could not be read (time, position or angles) are unknown.",
    remedy="Check whether the files are damaged.",
)


def exif_unreadable(*, where: str, count: int, examples: str) -> Message:
    """Some files have damaged EXIF or XMP."""
    return loss(
        EXIF_UNREADABLE,
        "the EXIF or XMP of {count} files cannot be read: {examples}",
        one="the EXIF or XMP of 1 file cannot be read: {examples}",
        where=where,
        count=count,
        examples=examples,
    )


EXIF_WHOLE_SECONDS = Code(
    "EXIF-WHOLE-SECONDS",
    means="The clock of the camera counts whole seconds.",
    effect="A standard deviation of 0.5 s is assumed for its times.",
    remedy="Nothing.",
)


def clock_of_whole_seconds(*, where: str, count: int) -> Message:
    """The camera writes times without fractions of a second."""
    return note(
        EXIF_WHOLE_SECONDS,
        "the camera's clock counts whole seconds: a standard deviation of 0.5 s is assumed",
        where=where,
        count=count,
    )


EXIF_ZONE = Code(
    "EXIF-ZONE",
    means="The time zone of the camera's clock was computed from the GPS stamps of its images.",
    effect="Local times are converted to UTC with it.",
    remedy="Nothing.",
)


def zone_of_camera(*, where: str, count: int, hours: float) -> Message:
    """The time zone of the camera's clock was computed from the GPS stamps of its images."""
    return note(
        EXIF_ZONE,
        "the camera's clock differs by {hours:+g} h from UTC, as the GPS stamps of its images show",
        where=where,
        count=count,
        hours=hours,
    )


IMAGES_CSV = Code(
    "IMAGES-CSV",
    means="The table of images cannot be read as CSV.",
    effect="The mission is refused.",
    remedy="Write it with exiftool -csv -r FOLDER.",
)


IMAGES_DUPLICATE = Code(
    "IMAGES-DUPLICATE",
    means="An image of the observations may be one of several files in different folders.",
    effect="The mission is refused.",
    remedy=(
        "Add the folder to the image names in the observations, or give the folder of one flight."
    ),
)


def images_duplicate(*, where: Path | str, image: str, first: str, second: str) -> InputError:
    """Two files have the name of an image of the observations."""
    return InputError(
        IMAGES_DUPLICATE,
        "{image} may be {first} or {second}",
        where=where,
        image=image,
        first=first,
        second=second,
        remedy=(
            "add the folder to the image names in the observations, as in {first}, or give the "
            "folder of one flight"
        ),
    )


IMAGES_NO_GIMBAL = Code(
    "IMAGES-NO-GIMBAL",
    means="None of the images has the angles of a gimbal.",
    effect="The mission is refused.",
    remedy="Give a CSV under stations.orientation.path, without format: dji.",
)


def images_no_gimbal(*, where: Path | str, files: int) -> InputError:
    """None of the images has the angles of a gimbal."""
    return InputError(
        IMAGES_NO_GIMBAL,
        "none of {files} has GimbalRollDegree, GimbalPitchDegree, GimbalYawDegree",
        where=where,
        files=Counted(files, "image"),
        remedy="give a CSV under stations.orientation.path, without format",
    )


IMAGES_TAG = Code(
    "IMAGES-TAG",
    means="Tags of images cannot be read as numbers or angles.",
    effect=(
        "These images do not have this value. If no image has a readable value, the mission is "
        "refused."
    ),
    remedy=(
        "Write the tags as numbers: exiftool -n -csv -r FOLDER. Numbers like -89.9 or -89,9 can be "
        "read, and degrees, minutes and seconds with marks between them."
    ),
)


def tags_unreadable(*, where: str, tag: str, count: int, image: str, value: str) -> Message:
    """Some images have a tag that is neither a number nor an angle; ``image`` is the first."""
    return loss(
        IMAGES_TAG,
        "{count} images have a tag {tag} that cannot be read, the first {image}: {value!r}",
        one="1 image has a tag {tag} that cannot be read, {image}: {value!r}",
        where=where,
        count=count,
        tag=tag,
        image=image,
        value=value,
    )


def no_tag_readable(*, where: Path | str, tag: str, image: str, value: str) -> InputError:
    """In no image the tag is a number or an angle; ``image`` is the first with the tag."""
    return InputError(
        IMAGES_TAG,
        "no image has a tag {tag} that can be read; the first, {image}, has {value!r}",
        where=where,
        tag=tag,
        image=image,
        value=value,
        remedy="write the tags as numbers: exiftool -n -csv -r FOLDER",
    )


IMAGES_NONE = Code(
    "IMAGES-NONE",
    means="There are no images in the folder or table.",
    effect="The mission is refused.",
    remedy="Give a folder of images, or a table that exiftool -csv wrote.",
)


def images_none(*, where: Path | str, endings: str) -> InputError:
    """There are no images in the folder or table."""
    return InputError(
        IMAGES_NONE,
        "there are no images",
        where=where,
        endings=endings,
        remedy=(
            "path must be a folder of images ({endings}), or a table of exiftool -csv with a "
            "column SourceFile or FileName"
        ),
    )


IMPORT_ANGLES = Code(
    "IMPORT-ANGLES",
    means="The angles of the trajectory are larger than one turn. They are in another unit.",
    effect="The mission is refused.",
    remedy="State stations.trajectory.angle_unit.",
)


IMPORT_COLUMN = Code(
    "IMPORT-COLUMN",
    means="The trajectory lacks a column.",
    effect="The mission is refused.",
    remedy="Name its columns under stations.trajectory.columns.",
)


IMPORT_CONTRADICTED = Code(
    "IMPORT-CONTRADICTED",
    means="The header of the file contradicts the mission file.",
    effect="The value of the mission file is used.",
    remedy="Check which of the two is right.",
)


def header_contradicted(*, where: str, key: str, found: str, stated: str) -> Message:
    """The header of a file (``found``) and the mission file (``stated``) contradict each other."""
    return warning(
        IMPORT_CONTRADICTED,
        "{key} is {found} in its header and {stated} in the mission file, which is used",
        where=where,
        key=key,
        found=found,
        stated=stated,
    )


IMPORT_CUT = Code(
    "IMPORT-CUT",
    means="The file was cut in the middle of a row.",
    effect="The complete rows are used.",
    remedy="Copy the file again.",
)


def file_cut(*, where: str, count: int, row: int, rows: int) -> Message:
    """A file ends with ``count`` bytes of a row; a row has ``row`` bytes, ``rows`` are complete."""
    return loss(
        IMPORT_CUT,
        "the last {count} bytes are less than a row of {row}: the file was cut after {rows}",
        one="the last byte is less than a row of {row}: the file was cut after {rows}",
        where=where,
        count=count,
        row=row,
        rows=Counted(rows, "row"),
    )


IMPORT_EO_ANGLES = Code(
    "IMPORT-EO-ANGLES",
    means="The header of an EO text does not state the unit or the zone of its angles.",
    effect="Attitudes are taken from another source.",
    remedy=(
        "If the zone is missing, state events.positions.<camera>.grid. If the unit is missing, "
        "export with 'orientation in Degrees'."
    ),
)


def eo_angles_unused(*, where: str, missing: str, hint: str = "") -> Message:
    """The header of an EO text does not state the unit or the grid of its angles.

    ``hint`` is what to do, after a semicolon.
    """
    return fallback(
        IMPORT_EO_ANGLES,
        ("its header does not state {missing}: attitudes are taken from another source{hint}"),
        where=where,
        missing=missing,
        hint=hint,
    )


IMPORT_EO_HEAD = Code(
    "IMPORT-EO-HEAD",
    means=(
        "The header of an EO text states the order of its rotations, a cardinal rotation of kappa, "
        "or a shift of its coordinates."
    ),
    effect=(
        "The angles are read in that order. They are the angles of the image as it was written, "
        "including the cardinal rotation. If easting and northing are shifted against latitude and "
        "longitude, the shift is also subtracted from the heights. Other orders of rotations are "
        "refused."
    ),
    remedy="Check this with tie points, or with the settings of the program.",
)


def eo_order(*, where: str, rotations: str) -> Message:
    """The order of rotations in the header of an EO text; empty where it is assumed."""
    text = "angles in the order of its header: {rotations}"
    if not rotations:
        text = "its header states no order of rotations; omega is assumed first, then phi and kappa"
    return note(IMPORT_EO_HEAD, text, where=where, rotations=rotations)


def eo_order_unknown(*, where: Path | str, rotations: str) -> InputError:
    """The header of an EO text states an order of rotations that is not supported."""
    return InputError(
        IMPORT_EO_HEAD,
        "its rotations are {rotations}; allowed: omega about x and phi about y, either first, and "
        "kappa about z last",
        where=where,
        rotations=rotations,
        remedy="write the exterior orientation with kappa as the last rotation",
    )


def eo_cardinal_rotation(*, where: str, turn_deg: float) -> Message:
    """The header of an EO text states a cardinal rotation of kappa."""
    return warning(
        IMPORT_EO_HEAD,
        (
            "kappa has a cardinal rotation of {turn_deg:g} deg: the angles are assumed to belong "
            "to the images as they were measured; only tie points show whether these images are "
            "turned"
        ),
        where=where,
        turn_deg=turn_deg,
    )


def eo_shift_undone(*, where: str, shift: str) -> Message:
    """Easting and northing have the stated shift, latitude and longitude do not."""
    return warning(
        IMPORT_EO_HEAD,
        (
            "X, Y, Z were shifted by {shift} m, but latitude and longitude were not: the shift is "
            "subtracted from the heights"
        ),
        where=where,
        shift=shift,
    )


def eo_shift_unknown(*, where: str, shift: str) -> Message:
    """A shift is stated, but a comparison does not show whether latitude and longitude have it."""
    return warning(
        IMPORT_EO_HEAD,
        (
            "X, Y, Z were shifted by {shift} m; latitude, longitude and height are read without a "
            "change"
        ),
        where=where,
        shift=shift,
    )


IMPORT_EO_GRID = Code(
    "IMPORT-EO-GRID",
    means=(
        "PROJ does not know the grid of the angles in the EO text, or it is not the grid of its "
        "positions."
    ),
    effect="The mission is refused.",
    remedy="State events.positions.<camera>.grid, as EPSG:32632.",
)


def grid_unknown(*, where: Path | str, grid: str, error: str) -> InputError:
    """PROJ does not know the grid in which omega, phi and kappa count."""
    return InputError(
        IMPORT_EO_GRID,
        "PROJ does not know the grid {grid}: {error}",
        where=where,
        remedy="state events.positions.<camera>.grid, as EPSG:32632",
        grid=grid,
        error=error,
    )


def grid_elsewhere(*, where: Path | str, grid: str, away_m: float) -> InputError:
    """Eastings and northings are of another grid than omega, phi and kappa."""
    return InputError(
        IMPORT_EO_GRID,
        (
            "its eastings and northings are {away_m:.3g} m from its latitudes and longitudes in "
            "{grid}: its angles refer to another grid"
        ),
        where=where,
        remedy="state events.positions.<camera>.grid, as EPSG:32632",
        grid=grid,
        away_m=away_m,
    )


IMPORT_FORMAT = Code(
    "IMPORT-FORMAT",
    means=(
        "The file does not have the stated format, or the format of its ending. Or it is damaged."
    ),
    effect="The mission is refused.",
    remedy="State the format, or write the file again.",
)

NAME_OR_EXPORT = "state the format of the file, or export it again"


def ending_unknown(*, where: Path | str, ending: str, known: str, formats: str) -> InputError:
    """A file has an unknown ending, and the mission file does not state its format."""
    return InputError(
        IMPORT_FORMAT,
        "its ending {ending} is unknown; known endings are {known}",
        where=where,
        remedy="give format: {formats}",
        ending=ending,
        known=known,
        formats=formats,
    )


def ending_missing(*, where: Path | str, known: str, formats: str) -> InputError:
    """A file has no ending, and the mission file does not state its format."""
    return InputError(
        IMPORT_FORMAT,
        "its ending is missing; known endings are {known}",
        where=where,
        remedy="give format: {formats}",
        known=known,
        formats=formats,
    )


def not_text(*, where: Path | str, error: str) -> InputError:
    """A file that should be text is not, or cannot be read."""
    return InputError(
        IMPORT_FORMAT,
        "it cannot be read as text: {error}",
        where=where,
        remedy=NAME_OR_EXPORT,
        error=error,
    )


def no_row_readable(*, where: Path | str) -> InputError:
    """All rows of a file were damaged."""
    return InputError(
        IMPORT_FORMAT, "none of its rows can be read", where=where, remedy=NAME_OR_EXPORT
    )


def columns_unstated(*, where: Path | str) -> InputError:
    """The mission file does not name the columns of a trajectory in CSV."""
    return InputError(
        IMPORT_FORMAT,
        "its columns have no names",
        where=where,
        remedy="name them under stations.trajectory.columns",
    )


def pos_without_titles(*, where: Path | str) -> InputError:
    """A solution of RTKLIB without the line of the header that names its columns."""
    return InputError(
        IMPORT_FORMAT,
        (
            "no line like '%  GPST  latitude(deg) longitude(deg) height(m) Q ns ...' states its "
            "columns and its time system"
        ),
        where=where,
        remedy="export it with its header, or read it as csv",
    )


def pos_without_solutions(*, where: Path | str) -> InputError:
    """A solution of RTKLIB has a header but no rows."""
    return InputError(
        IMPORT_FORMAT,
        "it has a header and no solutions",
        where=where,
        remedy="process the flight again",
    )


def pos_without_base(*, where: Path | str) -> InputError:
    """The header of RTKLIB baselines has no latitude, longitude and height of their base."""
    return InputError(
        IMPORT_FORMAT,
        (
            "its baselines start at a base, but the header does not give latitude, longitude and "
            "height of the base ('% ref pos   :')"
        ),
        where=where,
        remedy="export latitude, longitude and height",
    )


def mrk_without_lines(*, where: Path | str) -> InputError:
    """No line of the file has the format of DJI's Timestamp.MRK."""
    return InputError(
        IMPORT_FORMAT,
        (
            "no line is like '1  400373.488877  [2264]  -40,N  0,E  86,V  44.4,Lat  1.2,Lon  "
            "359.5,Ellh  0.03, 0.03, 0.05  16,Q'"
        ),
        where=where,
        remedy=NAME_OR_EXPORT,
    )


def eo_without_titles(*, where: Path | str) -> InputError:
    """A text of exterior orientations without the line that names its columns."""
    return InputError(
        IMPORT_FORMAT,
        "no line names the columns: '# EVENT  TIME (s)  EASTING ...'",
        where=where,
        remedy=NAME_OR_EXPORT,
    )


def eo_without_places(*, where: Path | str, titles: str) -> InputError:
    """Exterior orientations without latitude, longitude and height."""
    return InputError(
        IMPORT_FORMAT,
        "its columns are {titles}: positions only in a grid cannot be read",
        where=where,
        remedy="export it with latitude, longitude (LAT, LONG) and height",
        titles=titles,
    )


def eo_not_in_degrees(*, where: Path | str) -> InputError:
    """The header of an EO text does not state that latitude and longitude are in degrees."""
    return InputError(
        IMPORT_FORMAT,
        "its header does not contain 'lat, long in Deg'",
        where=where,
        remedy="export latitude and longitude in degrees",
    )


def _not_sbet(where: Path | str, why: str, **values: Any) -> InputError:
    """The refusal of a file that is not an SBET; ``why`` is a text with the names of ``values``."""
    return InputError(
        IMPORT_FORMAT,
        f"it is not an SBET: {why}",
        where=where,
        remedy=NAME_OR_EXPORT,
        **values,
    )


def sbet_big_endian(*, where: Path | str) -> InputError:
    """The numbers are those of an SBET if they are read as big-endian."""
    return _not_sbet(where, "its numbers are big-endian, but an SBET has little-endian numbers")


def sbet_is_smrmsg(*, where: Path | str) -> InputError:
    """The file that is named as SBET is a smrmsg file of standard deviations."""
    why = (
        "it is a smrmsg file (10 doubles in each row); name it as accuracy, together with the SBET"
    )
    return _not_sbet(where, why)


def sbet_too_short(*, where: Path | str, rows: int) -> InputError:
    """The file has too few rows to recognise an SBET."""
    return _not_sbet(where, "it has {rows}", rows=Counted(rows, "row"))


def sbet_not_numbers(*, where: Path | str) -> InputError:
    """Some doubles of the file are infinite or not numbers."""
    return _not_sbet(where, "not all of its values are numbers")


def sbet_without_time(*, where: Path | str) -> InputError:
    """The first column is not seconds of the week that increase."""
    return _not_sbet(where, "its first column is not a time that increases")


def sbet_places(*, where: Path | str, latitude: float, longitude: float) -> InputError:
    """Latitudes or longitudes are too large for radians."""
    why = (
        "latitude and longitude reach {latitude:.4g} and {longitude:.4g}: they are in degrees or "
        "exchanged; radians are needed, latitude first"
    )
    return _not_sbet(where, why, latitude=latitude, longitude=longitude)


def sbet_heights(*, where: Path | str, lowest: float, highest: float) -> InputError:
    """Heights that no aircraft has."""
    why = "heights are between {lowest:.4g} and {highest:.4g} m"
    return _not_sbet(where, why, lowest=lowest, highest=highest)


def sbet_angles(*, where: Path | str, largest: str) -> InputError:
    """Angles are too large for radians; ``largest`` lists the largest of roll to wander angle."""
    why = "roll, pitch, heading and wander angle reach {largest} radians: degrees?"
    return _not_sbet(where, why, largest=largest)


def not_smrmsg(*, where: Path | str) -> InputError:
    """The file that is named as accuracy of an SBET is not one of standard deviations."""
    return InputError(
        IMPORT_FORMAT,
        "it is not a smrmsg file: rows of 10 doubles, time and sigmas",
        where=where,
        remedy="give the smrmsg file that was written together with the SBET",
    )


def smrmsg_of_other_times(
    *, where: Path | str, begin: float, end: float, sbet_begin: float, sbet_end: float
) -> InputError:
    """Standard deviations and SBET have no seconds of the week in common."""
    return InputError(
        IMPORT_FORMAT,
        (
            "its seconds of the week, {begin:.0f} to {end:.0f}, are not those of the SBET, "
            "{sbet_begin:.0f} to {sbet_end:.0f}"
        ),
        where=where,
        remedy="give the smrmsg file that was written together with the SBET",
        begin=begin,
        end=end,
        sbet_begin=sbet_begin,
        sbet_end=sbet_end,
    )


IMPORT_NO_POSITION = Code(
    "IMPORT-NO-POSITION",
    means="Images of the .MRK have no position (quality 0, or latitude and longitude 0).",
    effect="These stations have no position from this file.",
    remedy="Process the file with corrections, or give another trajectory.",
)


def images_without_position(*, where: str, count: int, total: int, first: float) -> Message:
    """Images of a .MRK have the quality 0 or the place 0, 0; ``first`` is an image number."""
    return loss(
        IMPORT_NO_POSITION,
        "{count} of {total} have no position (quality 0, or the place 0, 0), the first is number "
        "{first:.0f}",
        one="1 of {total} has no position (quality 0, or the place 0, 0): number {first:.0f}",
        where=where,
        count=count,
        total=Counted(total, "image"),
        first=first,
    )


IMPORT_RANGE = Code(
    "IMPORT-RANGE",
    means=("Coordinates are impossible: a latitude above 90, or a point far from the earth."),
    effect="The mission is refused.",
    remedy="Check which column is which, and the unit.",
)


def latitude_beyond_poles(*, where: Path | str, worst_deg: float) -> InputError:
    """A latitude beyond the poles."""
    return InputError(
        IMPORT_RANGE,
        "a latitude of {worst_deg:.2f} degrees: it is a longitude, or in another unit",
        where=where,
        worst_deg=worst_deg,
        remedy="exchange the columns of latitude and longitude, or state the unit",
    )


def not_on_earth(*, where: Path | str, radius: float) -> InputError:
    """Earth-centred coordinates are far from the ground; ``radius`` [m] is their median."""
    return InputError(
        IMPORT_RANGE,
        "x, y and z are {radius:.4g} m from the centre of the earth",
        where=where,
        radius=radius,
        remedy="name columns of earth-centred coordinates (WGS84, metres)",
    )


IMPORT_VALUES = Code(
    "IMPORT-VALUES",
    means=(
        "Single values of rows are not numbers, or are impossible: negative standard deviations, "
        "more than 1000 m/s, quaternions with another length than 1."
    ),
    effect="They are treated as unknown. The other values of their rows are used.",
    remedy="If they are needed, correct the file.",
)


IMPORT_ROWS = Code(
    "IMPORT-ROWS",
    means=(
        "Rows cannot be read, have an impossible place or time (0, 0; the future; a clock that was "
        "never set), or repeat the time of another row."
    ),
    effect="They are not used.",
    remedy="If they are needed, correct the file.",
)


def rows_unreadable(*, where: str, count: int, total: int, first: int) -> Message:
    """Rows of a file are damaged; ``first`` counts from 1."""
    return loss(
        IMPORT_ROWS,
        "{count} of {total} cannot be read and are not used, the first is row {first}",
        one="1 of {total} cannot be read and is not used: row {first}",
        where=where,
        count=count,
        total=Counted(total, "row"),
        first=first,
    )


def values_impossible(*, where: str, column: str, count: int, row: int, first: float) -> Message:
    """Single values of a column are impossible; the first is in ``row``, from 1."""
    return loss(
        IMPORT_VALUES,
        (
            "{count} values of {column} are impossible and are treated as unknown, the first is "
            "{first:g} in row {row}"
        ),
        one="1 value of {column} is impossible and is treated as unknown: {first:g} in row {row}",
        where=where,
        count=count,
        column=column,
        row=row,
        first=first,
    )


def fields_unreadable(*, where: str, column: str, count: int, line: int, first: str) -> Message:
    """Fields of a column of a trajectory are not numbers; ``first`` is the text in ``line``."""
    return loss(
        IMPORT_VALUES,
        (
            "{count} fields of column {column} are not numbers and are treated as unknown, the "
            "first is {first!r} in line {line}"
        ),
        one=(
            "1 field of column {column} is not a number and is treated as unknown: {first!r} in "
            "line {line}"
        ),
        where=where,
        count=count,
        column=column,
        line=line,
        first=first,
    )


def rows_repeat_time(*, where: str, count: int, total: int, first: int) -> Message:
    """Rows of a file have the time of another row; ``first`` counts from 1."""
    return loss(
        IMPORT_ROWS,
        (
            "{count} of {total} repeat the time of another and are not used, the first is row "
            "{first}"
        ),
        one="1 of {total} repeats the time of another and is not used: row {first}",
        where=where,
        count=count,
        total=Counted(total, "row"),
        first=first,
    )


IMPORT_SPEED = Code(
    "IMPORT-SPEED",
    means=(
        "The speed between the positions of an SBET contradicts its velocities, or is above 700 "
        "m/s."
    ),
    effect="The mission is refused.",
    remedy="Export an SBET in radians, latitude before longitude.",
)


def sbet_speed(*, where: Path | str, usual: float, said: float) -> InputError:
    """The speed from positions (``usual``) contradicts that of the velocities (``said``) [m/s]."""
    return InputError(
        IMPORT_SPEED,
        (
            "its positions move at {usual:.3g} m/s, but its velocities are {said:.3g} m/s: "
            "latitude and longitude are not in radians, are exchanged, or the columns are different"
        ),
        where=where,
        usual=usual,
        said=said,
        remedy="export an SBET in radians, latitude before longitude",
    )


IMPORT_TIME_SYSTEM = Code(
    "IMPORT-TIME-SYSTEM",
    means="The times have a time zone, but GPS time has no time zone.",
    effect="The mission is refused.",
    remedy="Give time: {system: utc}.",
)


def gps_time_with_zone(*, where: Path | str, time: str) -> InputError:
    """A time in GPS time has the zone of UTC or another."""
    return InputError(
        IMPORT_TIME_SYSTEM,
        "{time} has a time zone, but GPS time has no time zone",
        where=where,
        time=time,
        remedy="give time: {{system: utc}}",
    )


IMPORT_UNSTATED = Code(
    "IMPORT-UNSTATED",
    means=(
        "Neither the file nor the mission file states its time system or the reference of its "
        "heights."
    ),
    effect="The mission is refused.",
    remedy="Give time: {system: gpst} or {system: utc}, and heights: ellipsoid or msl.",
)


def time_system_unstated(*, where: Path | str) -> InputError:
    """Neither the file nor the mission file states the time system."""
    return InputError(
        IMPORT_UNSTATED,
        "it does not state its time.system: GPS time is 18 s ahead of UTC since 2017",
        where=where,
        remedy="give time: {{system: gpst}} or {{system: utc}}",
    )


def heights_unstated(*, where: Path | str) -> InputError:
    """Neither the file nor the mission file states what its heights count from."""
    return InputError(
        IMPORT_UNSTATED,
        (
            "it does not state what its heights count from: heights above the ellipsoid and above "
            "the sea differ by up to 107 m"
        ),
        where=where,
        remedy="give heights: ellipsoid or msl",
    )


IMPORT_VELOCITY = Code(
    "IMPORT-VELOCITY",
    means="The velocities of the file do not fit its positions in any frame.",
    effect="They are not used.",
    remedy="If the velocities are needed, check the export.",
)


def sbet_velocity_unused(*, where: str, misfits: float) -> Message:
    """Velocities of an SBET do not fit its positions, with either sign of the wander angle."""
    return warning(
        IMPORT_VELOCITY,
        (
            "its velocities do not fit its positions in any frame ({misfits:.2f} m/s apart): they "
            "are not used"
        ),
        where=where,
        misfits=misfits,
    )


IMPORT_WANDER = Code(
    "IMPORT-WANDER",
    means=(
        "The relation of the heading of the SBET to its wander angle, tested with its velocities."
    ),
    effect="A note; a warning if the test does not decide or the sign is the opposite one.",
    remedy="If it is a warning, check the yaw of the stations.",
)


def wander_untested(*, where: str) -> Message:
    """Nothing in an SBET moves: the sign of its wander angle cannot be tested."""
    return note(
        IMPORT_WANDER,
        (
            "nothing in the file moves: platform heading minus wander angle is assumed to be the "
            "true heading"
        ),
        where=where,
    )


def wander_zero(*, where: str) -> Message:
    """The wander angle is zero: its sign does not matter."""
    return note(IMPORT_WANDER, "the wander angle is zero throughout", where=where)


def wander_sign(
    *,
    where: str,
    is_minus: bool,
    is_decided: bool,
    by_velocities: bool,
    most_deg: float,
    minus_m_s: float,
    plus_m_s: float,
) -> Message:
    """The sign of the wander angle in the true heading, by velocities or by the course.

    A warning where the test does not decide, or the sign is not POSPac's.
    """
    sign = "minus" if is_minus else "plus"
    evidence = "velocities and positions" if by_velocities else "heading and course"
    outcome = "differ" if is_decided else "do not decide; they differ"
    send = note if is_decided and is_minus else warning
    return send(
        IMPORT_WANDER,
        (
            "true heading is platform heading {sign} wander angle (up to {most_deg:.2f} deg; "
            "POSPac: minus): {evidence} {outcome} by {minus_m_s:.2f} m/s with minus, "
            "{plus_m_s:.2f} m/s with plus"
        ),
        where=where,
        sign=sign,
        evidence=evidence,
        outcome=outcome,
        most_deg=most_deg,
        minus_m_s=minus_m_s,
        plus_m_s=plus_m_s,
    )


IMPORT_WEEK = Code(
    "IMPORT-WEEK",
    means="Times are seconds of the week, but neither the mission file nor a log states the week.",
    effect="The mission is refused.",
    remedy="Give time: {week: NUMBER}, counted from 1980-01-06.",
)


def week_unknown(*, where: Path | str) -> InputError:
    """Times are seconds of the week, but the week is not stated."""
    return InputError(
        IMPORT_WEEK,
        "it has seconds of the week, but the week is not stated",
        where=where,
        remedy="give time: {{week: NUMBER}}, counted from 1980-01-06",
    )


# Tables of orientations

ORIENTATION_NAMES = Code(
    "ORIENTATION-NAMES",
    means=(
        "The mission file does not name some columns of the orientations. They were detected by "
        "their usual names."
    ),
    effect="They are read.",
    remedy="If one of them has other content, name the correct column.",
)


def columns_by_usual_names(*, where: str, names: Mapping[str, str]) -> Message:
    """Columns of a table of orientations were detected by usual names: quantity -> column."""
    listed = ", ".join(f"{quantity} from {name}" for quantity, name in names.items())
    return note(
        ORIENTATION_NAMES,
        "detected by their usual names: {listed}",
        where=where,
        listed=listed,
    )


ORIENTATION_COLUMN = Code(
    "ORIENTATION-COLUMN",
    means="The table of orientations lacks a column.",
    effect="The mission is refused.",
    remedy="Name its columns under stations.orientation.columns.",
)


ORIENTATION_CSV = Code(
    "ORIENTATION-CSV",
    means="The table of orientations cannot be read as CSV.",
    effect="The mission is refused.",
    remedy="Write it as UTF-8 with a header line.",
)


ORIENTATION_NUMBER = Code(
    "ORIENTATION-NUMBER",
    means="A column of the orientations contains text instead of numbers.",
    effect="The mission is refused.",
    remedy="Correct the named rows.",
)


ORIENTATION_UNIT = Code(
    "ORIENTATION-UNIT",
    means="Angles are larger than one turn. They are in another unit.",
    effect="The mission is refused.",
    remedy="State stations.orientation.unit: deg, rad or grad.",
)


ORIENTATION_FRAME = Code(
    "ORIENTATION-FRAME",
    means=(
        "The frame of x, y and z of the orientations is not stated. Or in the stated frame the "
        "points are not on the earth."
    ),
    effect="The mission is refused.",
    remedy=("Give stations.orientation.frame: ecef, {enu: ...}, projected with crs, or unknown."),
)


ORIENTATION_EMPTY = Code(
    "ORIENTATION-EMPTY",
    means="The table or block has no oriented image.",
    effect="The mission is refused.",
    remedy="Write it again.",
)


def orientations_empty(*, where: Path | str) -> InputError:
    """A table of orientations has a header and nothing else."""
    return InputError(
        ORIENTATION_EMPTY,
        "the table has no rows",
        where=where,
        remedy="write it again",
    )


ORIENTATION_POSITION = Code(
    "ORIENTATION-POSITION",
    means="Latitudes or longitudes are outside their range.",
    effect="The mission is refused.",
    remedy="Check which column is which, and the unit (degrees).",
)


def orientation_position(
    *,
    path: Path | str,
    line: int,
    count: int,
    limit: float,
    quantity: str,
    first: float,
    swapped: bool,
    key: str,
) -> InputError:
    """Latitudes or longitudes are beyond their range; ``swapped``: they may be exchanged."""
    hint = "; are latitude and longitude exchanged?" if swapped else ""
    return InputError(
        ORIENTATION_POSITION,
        "{count} values of {quantity} are beyond {limit:.0f} deg, the first is {first:g}{hint}",
        one="1 value of {quantity} is beyond {limit:.0f} deg: {first:g}{hint}",
        where=f"{path}, line {line}",
        count=count,
        remedy="name the columns under {key}; they must contain degrees, not projected coordinates",
        limit=limit,
        quantity=quantity,
        first=first,
        hint=hint,
        key=key,
    )


ORIENTATION_QUATERNION = Code(
    "ORIENTATION-QUATERNION",
    means="Quaternions do not have the length 1.",
    effect="The mission is refused.",
    remedy=(
        "Name the columns q_w, q_x, q_y, q_z (w is the cosine of half the angle), with all digits."
    ),
)


def orientation_quaternion(*, path: Path | str, line: int, count: int, length: float) -> InputError:
    """Quaternions are not of length 1; ``line`` and ``length`` are those of the worst."""
    return InputError(
        ORIENTATION_QUATERNION,
        "the length of {count} quaternions is not 1, the worst is {length:.6g}",
        one="the length of 1 quaternion is not 1: {length:.6g}",
        where=f"{path}, line {line}",
        count=count,
        remedy=(
            "name the columns q_w, q_x, q_y and q_z (w is the cosine of half the angle), "
            "and write them with all their digits"
        ),
        length=length,
    )


ORIENTATION_REPEATED = Code(
    "ORIENTATION-REPEATED",
    means="Images occur in the table of orientations more than once.",
    effect="The mission is refused.",
    remedy="Keep one row for each image.",
)


def orientation_repeated(*, where: Path | str, count: int, image: str, lines: str) -> InputError:
    """``count`` images occur in a table more than once; ``image`` is an example with its lines."""
    return InputError(
        ORIENTATION_REPEATED,
        "{count} images occur more than once, for example {image!r} in lines {lines}",
        one="1 image occurs more than once: {image!r} in lines {lines}",
        where=where,
        count=count,
        remedy="keep one row for each image",
        image=image,
        lines=lines,
    )


ORIENTATION_TIME = Code(
    "ORIENTATION-TIME",
    means=(
        "Rows of the orientations have no readable time, or an impossible one: in the future, or "
        "of a clock that was never set (1970-01-01, 1980-01-06, a GPS week before 1990)."
    ),
    effect="They get the air of the middle exposure.",
    remedy="Correct these rows.",
)


def orientations_without_time(*, where: str, count: int, line: int) -> Message:
    """Rows without a readable time, in a table that has a column of times."""
    return loss(
        ORIENTATION_TIME,
        (
            "{count} rows have no readable or possible time, the first in line {line}: the air of "
            "the middle exposure is used for them"
        ),
        one=(
            "1 row has no readable or possible time, line {line}: the air of the middle exposure "
            "is used for it"
        ),
        where=where,
        count=count,
        line=line,
    )


TRAJECTORY_AGREES = Code(
    "TRAJECTORY-AGREES",
    means="The distance of the imported positions from the positions of the log.",
    effect=(
        "A note; above 5 m a warning, above 20 m a loss (for a time offset: 0.15 s and 0.75 s)."
    ),
    remedy="Check the time, the datum and the point of the trajectory.",
)


def trajectory_agrees(
    *,
    kind: Kind,
    where: str,
    count: int,
    log: str,
    median_m: float,
    most_m: float,
    shift_s: float,
    shifted_m: float,
) -> Message:
    """The distance of imported positions from the log's: median, 95 %, and with a shift in time."""
    return message(
        kind,
        TRAJECTORY_AGREES,
        (
            "{median_m:.2f} m from {log} of the log in the median, 95 % within {most_m:.2f} m; a "
            "time offset of {shift_s:+.3f} s leaves {shifted_m:.2f} m"
        ),
        where=where,
        count=count,
        log=log,
        median_m=median_m,
        most_m=most_m,
        shift_s=shift_s,
        shifted_m=shifted_m,
    )


TRAJECTORY_ANGLES_AGREE = Code(
    "TRAJECTORY-ANGLES-AGREE",
    means="The difference of the imported attitudes from those of the log.",
    effect="A note; above 3 deg in tilt or 10 in yaw a warning, above 20 or 30 a loss.",
    remedy="Mount angles are relative to the body axes of the imported file.",
)


def trajectory_angles_agree(
    *, kind: Kind, where: str, count: int, tilt_deg: float, yaw_deg: float
) -> Message:
    """The median differences of imported attitudes from the log's, in tilt and yaw."""
    return message(
        kind,
        TRAJECTORY_ANGLES_AGREE,
        (
            "{tilt_deg:.2f} deg from the attitude of the log in tilt and {yaw_deg:+.2f} deg in "
            "yaw, in the median: mount angles are relative to the body axes of this file"
        ),
        where=where,
        count=count,
        tilt_deg=tilt_deg,
        yaw_deg=yaw_deg,
    )


TRAJECTORY_HEIGHT_AGREES = Code(
    "TRAJECTORY-HEIGHT-AGREES",
    means="The difference of the imported heights from those of the log.",
    effect="A note; above 10 m a warning, above 30 m a loss.",
    remedy="Check the datum of the heights.",
)


def trajectory_height_agrees(
    *, kind: Kind, where: str, count: int, log: str, apart_m: float, spread_m: float
) -> Message:
    """The median difference of imported heights from the log's, and the scatter (95 %) about it."""
    return message(
        kind,
        TRAJECTORY_HEIGHT_AGREES,
        (
            "{apart_m:+.2f} m from the height of {log} of the log in the median, within "
            "{spread_m:.2f} m of that in 95 %"
        ),
        where=where,
        count=count,
        log=log,
        apart_m=apart_m,
        spread_m=spread_m,
    )


TRAJECTORY_ALONE = Code(
    "TRAJECTORY-ALONE",
    means="The log has no positions to compare the trajectory with.",
    effect="Its time, place and height are not checked.",
    remedy="Check them by hand.",
)


def trajectory_alone(*, where: str) -> Message:
    """The log has no positions to compare the trajectory with."""
    return warning(
        TRAJECTORY_ALONE,
        ("the log has no positions to compare it with: time, place and height are not checked"),
        where=where,
    )


TRAJECTORY_ANGLES = Code(
    "TRAJECTORY-ANGLES",
    means="The imported attitude fits the log far better with another unit, sense or order.",
    effect="The mission is refused.",
    remedy="State angle_unit and angle_order, and which column is which.",
)


def trajectory_angles_columns(
    *, where: str, size_deg: float, mistake: str, left_deg: float
) -> MissionError:
    """The imported attitude fits the log if one ``mistake`` about its columns is corrected.

    ``size_deg`` is the difference from the log as read, ``left_deg`` after the correction.
    """
    return MissionError(
        TRAJECTORY_ANGLES,
        (
            "its attitude is up to {size_deg:.1f} deg from that of the log (90 %), {mistake} up "
            "to {left_deg:.1f} deg"
        ),
        where=where,
        remedy=(
            "state angle_unit and angle_order, and which column is which; roll is right "
            "wing down, pitch nose up, yaw clockwise from north"
        ),
        size_deg=size_deg,
        mistake=mistake,
        left_deg=left_deg,
    )


def trajectory_angles(*, where: str, size_deg: float, order: str, left_deg: float) -> MissionError:
    """The imported attitude fits the log if its rotations are in another ``order``.

    ``size_deg`` is the difference from the log as read, ``left_deg`` in that order.
    """
    return MissionError(
        TRAJECTORY_ANGLES,
        (
            "its attitude is up to {size_deg:.1f} deg from that of the log (90 %), in the order "
            "{order} up to {left_deg:.1f} deg"
        ),
        where=where,
        remedy="state angle_order: {order}",
        size_deg=size_deg,
        order=order,
        left_deg=left_deg,
    )


TRAJECTORY_ANGLES_ALONE = Code(
    "TRAJECTORY-ANGLES-ALONE",
    means="The log has no attitude to compare the imported one with.",
    effect="It is not checked.",
    remedy="Check it by hand.",
)


def trajectory_angles_alone(*, where: str) -> Message:
    """The log has no attitude to compare the imported one with."""
    return note(
        TRAJECTORY_ANGLES_ALONE,
        "the log has no attitude at the times of this file to compare its attitudes with",
        where=where,
    )


TRAJECTORY_HEIGHT = Code(
    "TRAJECTORY-HEIGHT",
    means="The imported heights fit the log far better if they are above the other surface.",
    effect="The mission is refused.",
    remedy=(
        "Give heights: msl or ellipsoid, as the refusal states, or correct mission.undulation_m."
    ),
)


def trajectory_height(
    *, where: Path | str, apart: float, own: str, same: str, by_other: float, other: str
) -> MissionError:
    """The imported heights fit the log only if they count from the ``other`` surface.

    ``apart`` and ``by_other`` [m] are their differences from the log's heights, ``own``, above the
    surface ``same`` and above the ``other`` one.
    """
    return MissionError(
        TRAJECTORY_HEIGHT,
        (
            "its heights are {apart:+.1f} m from those of {own} as heights above {same}, and "
            "{by_other:+.1f} m as heights above {other}"
        ),
        where=where,
        apart=apart,
        own=own,
        same=same,
        by_other=by_other,
        other=other,
        remedy="give heights: {other}, or correct mission.undulation_m",
    )


TRAJECTORY_HEIGHT_ALONE = Code(
    "TRAJECTORY-HEIGHT-ALONE",
    means="The log has no height above the same surface to compare with.",
    effect="The heights are not checked.",
    remedy="Check them by hand.",
)


def trajectory_height_alone(*, where: str) -> Message:
    """The log has no height above the same surface to compare with."""
    return note(
        TRAJECTORY_HEIGHT_ALONE,
        "the log has no height above the same surface to compare it with",
        where=where,
    )


TRAJECTORY_OVERLAP = Code(
    "TRAJECTORY-OVERLAP",
    means="The trajectory and the log do not overlap in time.",
    effect="The mission is refused.",
    remedy="Name the file of this flight, or state the week and the time system.",
)


def trajectory_overlap(*, where: Path | str, own: str, log: str) -> MissionError:
    """The trajectory (time ``own``) and the log (time ``log``) do not overlap."""
    return MissionError(
        TRAJECTORY_OVERLAP,
        "it covers {own}, the log {log}",
        where=where,
        own=own,
        log=log,
        remedy="name the file of this flight, or state the week or the system of its times",
    )


TRAJECTORY_PLACE = Code(
    "TRAJECTORY-PLACE",
    means="The trajectory is at another place than the log.",
    effect="The mission is refused.",
    remedy="Name the file of this flight; state position_unit, and which column is which.",
)


def trajectory_place(*, where: str, away: str, log: str, hints: str) -> MissionError:
    """The trajectory is far from the log; ``hints`` are mistakes that would explain it."""
    return MissionError(
        TRAJECTORY_PLACE,
        "it is {away} from {log} of the log in the median{hints}",
        where=where,
        remedy="name the file of this flight; state position_unit, and which column is which",
        away=away,
        log=log,
        hints=hints,
    )


TRAJECTORY_QUALITY = Code(
    "TRAJECTORY-QUALITY",
    means="The quality classes of the solutions of the trajectory.",
    effect="None. Single-point fixes are reported separately (TRAJECTORY-SINGLE).",
    remedy="Nothing.",
)


def solution_qualities(*, where: str, count: int, shares: str) -> Message:
    """The shares of fixed, float and other solutions in a file."""
    return note(TRAJECTORY_QUALITY, "solutions: {shares}", where=where, count=count, shares=shares)


TRAJECTORY_SINGLE = Code(
    "TRAJECTORY-SINGLE",
    means="Solutions are single-point fixes, with errors of metres, not centimetres.",
    effect="Their sigma remains metres.",
    remedy="Process the trajectory with corrections.",
)


def single_point_images(*, where: str, count: int, total: int) -> Message:
    """Images of a .MRK have single-point positions, without corrections."""
    return warning(
        TRAJECTORY_SINGLE,
        (
            "{count} of {total} have a single-point position (quality 16), with errors of metres, "
            "not centimetres"
        ),
        one=(
            "1 of {total} has a single-point position (quality 16), with errors of metres, not "
            "centimetres"
        ),
        where=where,
        count=count,
        total=Counted(total, "image"),
    )


def single_point_solutions(
    *, where: str, count: int, total: int, sigma_h_m: float, sigma_v_m: float
) -> Message:
    """Solutions of RTKLIB are single-point fixes; their sigmas are at least these values."""
    return warning(
        TRAJECTORY_SINGLE,
        (
            "{count} of {total} are single-point fixes (Q 5): their sigma is at "
            "least {sigma_h_m} m, {sigma_v_m} m in height"
        ),
        one=(
            "1 of {total} is a single-point fix (Q 5): its sigma is at least {sigma_h_m} m, "
            "{sigma_v_m} m in height"
        ),
        where=where,
        count=count,
        total=Counted(total, "solution"),
        sigma_h_m=sigma_h_m,
        sigma_v_m=sigma_v_m,
    )


_LEAST_LEAP_S = 14.5  # leap seconds were 15 in 2009 and are 18
_MOST_LEAP_S = 18.5
_LEAST_ZONE_S = 1700.0  # a zone is half an hour or more

TRAJECTORY_TIME = Code(
    "TRAJECTORY-TIME",
    means=(
        "The imported times fit the log far better with a shift. For example, GPS time was read as "
        "UTC, or a time zone is missing."
    ),
    effect="The mission is refused.",
    remedy="State the time system of the file: time: {system: gpst} or {system: utc}.",
)


def trajectory_time(
    *, where: str, shift_s: float, log: str, best_m: float, now_m: float
) -> MissionError:
    """The imported times fit the log only if ``shift_s`` is added to them.

    ``best_m`` and ``now_m`` are the median distances from the log with and without the shift.
    """
    hint = ""
    if _LEAST_LEAP_S < abs(shift_s) < _MOST_LEAP_S:
        hint = "; GPS time is 18 s ahead of UTC since 2017"
    elif abs(shift_s) > _LEAST_ZONE_S:
        hint = "; a time zone"
    return MissionError(
        TRAJECTORY_TIME,
        (
            "its times are {shift_s:.2f} s {sense}: with this shift it fits {log} of the log "
            "within {best_m:.1f} m, without it within {now_m:.0f} m{hint}"
        ),
        where=where,
        remedy=(
            "state the time system of the file under stations.trajectory or events.positions: "
            "time: {{system: gpst}} or {{system: utc}}; correct other offsets in the file"
        ),
        shift_s=abs(shift_s),
        sense="late" if shift_s < 0 else "early",
        log=log,
        best_m=best_m,
        now_m=now_m,
        hint=hint,
    )
