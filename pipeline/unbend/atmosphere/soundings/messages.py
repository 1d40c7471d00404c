"""Messages of atmosphere/soundings: what each code means, and the words of what is sent."""

from unbend.errors import Code, InputError
from unbend.messages import Message, fallback, loss, note, warning

MODEL_AREA = Code(
    "MODEL-AREA",
    means="Places of the flight are outside the fields of the weather model.",
    effect="The mission is refused, with the distance.",
    remedy="Download an area that reaches half a degree beyond the flight on all sides.",
)


def model_area(
    *,
    where: object,
    north: float,
    east: float,
    away_km: float,
    south_node: float,
    north_node: float,
    west_node: float,
    east_node: float,
) -> InputError:
    """A place of the flight is outside the nodes of a weather model, or in a hole of them.

    All positions are in degrees: of the place, and of the outermost nodes.
    """
    return InputError(
        MODEL_AREA,
        (
            "the flight at {north:.2f}°, {east:.2f}° is {away_km:.0f} km from its nodes; the "
            "nearest nodes are at {south_node:.2f}° to {north_node:.2f}°, {west_node:.2f}° to "
            "{east_node:.2f}°"
        ),
        where=where,
        north=north,
        east=east,
        away_km=away_km,
        south_node=south_node,
        north_node=north_node,
        west_node=west_node,
        east_node=east_node,
        remedy="download an area that reaches half a degree beyond the flight on all sides",
    )


MODEL_EXTENDED = Code(
    "MODEL-EXTENDED",
    means="The lowest level of a weather model is more than 300 m above the true ground.",
    effect=(
        "The column is continued down to the ground with 6.5 K/km. Its sigma grows by 8 K per "
        "kilometre."
    ),
    remedy="Nothing; or give values measured at the ground: atmosphere.surface.",
)


def model_extended(*, where: str, depth: float, ground: float, sigma: float) -> Message:
    """The lowest level of a model is ``depth`` [m] above the ``ground``; ``sigma`` [K] is there."""
    return fallback(
        MODEL_EXTENDED,
        (
            "its lowest level is {depth:.0f} m above the ground at {ground:.0f} m: continued "
            "down to it with 6.5 K/km, at the ground ± {sigma:.1f} K"
        ),
        where=where,
        depth=depth,
        ground=ground,
        sigma=sigma,
    )


MODEL_GROUND = Code(
    "MODEL-GROUND",
    means=(
        "The mission file does not state one height of the ground, and the height of the take-off "
        "is not known. So the levels under the ground are not known."
    ),
    effect="The ground of the weather model is used, or sea level.",
    remedy=(
        "State it: as a number under ground.height with ground.reference: msl, or as "
        "ground.home_h_msl_m."
    ),
)


def model_ground(*, where: str, ground: float) -> Message:
    """The height of the ground is not known: that of the model, or sea level, is used."""
    return fallback(
        MODEL_GROUND,
        (
            "the height of the ground is not known: {ground:.0f} m is used, the height of the "
            "model's ground or of the sea"
        ),
        where=where,
        ground=ground,
    )


MODEL_GROUND_UNIT = Code(
    "MODEL-GROUND-UNIT",
    means=(
        "The ground of a weather model on model levels has no unit. Its surface pressure fits a "
        "ground in metres."
    ),
    effect="Metres are assumed.",
    remedy="State the unit in the file: ncatted.",
)


def model_ground_unit(*, where: str, count: int, highest: float) -> Message:
    """A model's ground without a unit is taken as metres, which fit its surface pressure.

    ``count`` is the number of nodes, ``highest`` the highest ground [m].
    """
    return fallback(
        MODEL_GROUND_UNIT,
        (
            "z of its ground has no unit, and as geopotential it would contradict the surface "
            "pressure: metres are assumed at {count} nodes, up to {highest:.0f} m"
        ),
        one=(
            "z of its ground has no unit, and as geopotential it would contradict the surface "
            "pressure: metres are assumed at 1 node, up to {highest:.0f} m"
        ),
        where=where,
        count=count,
        highest=highest,
    )


MODEL_LAYER = Code(
    "MODEL-LAYER",
    means=(
        "A layer of a weather model is not as thick as its temperatures imply. One of its levels "
        "is wrong, or the layer is under the ground of the model and contains extrapolated air."
    ),
    effect="It is used.",
    remedy="Compare the named levels with their neighbours. Download the file again.",
)


def model_layer(
    *, where: str, lower: float, upper: float, mean: float, implied: float, count: int
) -> Message:
    """A layer of a weather model is not as thick as its temperatures imply.

    ``lower``, ``upper`` are the pressures at its ends [hPa]; ``mean`` is its temperature and
    ``implied`` that by its thickness [K]. It is the worst of ``count`` such layers.
    """
    return warning(
        MODEL_LAYER,
        (
            "between {lower:.4g} and {upper:.4g} hPa its temperatures are {mean:.1f} K in the"
            " mean, and {implied:.1f} K by the heights of these levels (the worst of "
            "{count}): a wrong level, or extrapolated air under the model's ground"
        ),
        where=where,
        lower=lower,
        upper=upper,
        mean=mean,
        implied=implied,
        count=count,
    )


MODEL_LEVELS = Code(
    "MODEL-LEVELS",
    means=(
        "The levels of a weather model are too few for a profile, some are missing, or the "
        "temperature changes from one level to the next more than in any air."
    ),
    effect="The mission is refused; the levels are listed.",
    remedy="Request all levels from the ground to the highest camera; leave a wrong level out.",
)


def model_levels_jump(
    *,
    where: object,
    lower: str,
    upper: str,
    lower_k: float,
    upper_k: float,
    thick: float,
    north: float,
    east: float,
) -> InputError:
    """The temperature changes from one level to the next more than in any air.

    ``lower``, ``upper`` are names of the levels, ``thick`` is the height between them [m];
    ``north``, ``east`` are the place [degrees].
    """
    return InputError(
        MODEL_LEVELS,
        (
            "temperature changes from {lower_k:.1f} K on {lower} to {upper_k:.1f} K on {upper}, "
            "{thick:.0f} m higher, at {north:.2f}°, {east:.2f}°: this does not occur in air"
        ),
        where=where,
        lower=lower,
        upper=upper,
        lower_k=lower_k,
        upper_k=upper_k,
        thick=thick,
        north=north,
        east=east,
        remedy="one of these levels is wrong: download the file again, or leave that level out",
    )


def model_levels(*, where: object, total: int, which: str, listed: str, fewest: int) -> InputError:
    """A weather model has too few levels for a profile, or its levels do not rise.

    ``which`` describes the levels, as "above the ground"; ``listed`` are their pressures [hPa].
    """
    return InputError(
        MODEL_LEVELS,
        "{total} levels {which} ({listed} hPa): a profile needs at least {fewest}, rising",
        where=where,
        total=total,
        which=which,
        listed=listed,
        fewest=fewest,
        remedy="request all levels from the ground to the highest camera, 1000 to 100 hPa",
    )


MODEL_MISSING = Code(
    "MODEL-MISSING",
    means="Some levels of a weather model have missing values at the place of the flight.",
    effect="They are left out; the others are used.",
    remedy="Nothing, or download the file again.",
)


def model_missing(*, where: str, count: int, total: int) -> Message:
    """Some levels of a weather model have missing values at the place of the flight."""
    return fallback(
        MODEL_MISSING,
        "{count} of {total} levels have missing values there: left out",
        where=where,
        count=count,
        total=total,
    )


MODEL_PRESSURE_UNIT = Code(
    "MODEL-PRESSURE-UNIT",
    means=(
        "The pressure levels cannot be in the unit that the file states. Pa and hPa are exchanged."
    ),
    effect="They are read in the other unit.",
    remedy="Check the levels: unbend inspect.",
)


def model_pressure_unit(*, where: str, lowest: float, factor: float) -> Message:
    """The pressure levels cannot be in the stated unit; they are multiplied by ``factor``.

    ``lowest`` is the pressure of the lowest level in the stated unit.
    """
    return fallback(
        MODEL_PRESSURE_UNIT,
        "pressure levels up to {lowest:.6g} Pa in the stated unit: multiplied by {factor:g}",
        where=where,
        lowest=lowest,
        factor=factor,
    )


MODEL_UNDERGROUND = Code(
    "MODEL-UNDERGROUND",
    means="Levels of a weather model are under the ground. They contain extrapolated air.",
    effect="They are left out.",
    remedy="Nothing.",
)


def model_underground(*, where: str, count: int, bottom: float) -> Message:
    """Levels of a weather model are under the ground at the height ``bottom`` [m]: left out."""
    return note(
        MODEL_UNDERGROUND,
        "{count} levels are under the ground at {bottom:.0f} m: left out",
        one="1 level is under the ground at {bottom:.0f} m: left out",
        where=where,
        count=count,
        bottom=bottom,
    )


FETCH_MODEL_AGAIN = "download the original file again from the centre that runs the model"

MODEL_UNITS = Code(
    "MODEL-UNITS",
    means=(
        "Values of a weather model do not fit their names: impossible temperatures, impossible "
        "humidities, or heights that contradict pressure and temperature."
    ),
    effect="The mission is refused.",
    remedy="Download the original file again from the centre that runs the model.",
)


def model_without_values(*, where: str) -> InputError:
    """No temperature or no humidity of a model around the flight has a value."""
    return InputError(
        MODEL_UNITS,
        "no value of temperature and humidity around the flight",
        remedy=FETCH_MODEL_AGAIN,
        where=where,
    )


def model_temperatures(*, where: str, coldest_k: float, warmest_k: float) -> InputError:
    """The temperatures of a model do not occur in air."""
    return InputError(
        MODEL_UNITS,
        "temperatures from {coldest_k:.6g} to {warmest_k:.6g} K do not occur in air",
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        coldest_k=coldest_k,
        warmest_k=warmest_k,
    )


def model_humidities(*, where: str, kind: str, driest: float, wettest: float) -> InputError:
    """The humidities of a model are neither kg/kg nor fractions; ``kind``: specific or relative."""
    return InputError(
        MODEL_UNITS,
        (
            "{kind} humidity from {driest:.6g} up to {wettest:.6g}: neither kg/kg nor a fraction "
            "of 1"
        ),
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        kind=kind,
        driest=driest,
        wettest=wettest,
    )


def model_ground_height(*, where: str, highest_m: float) -> InputError:
    """The ground of a model is higher or lower than any ground of the earth."""
    return InputError(
        MODEL_UNITS,
        "its ground is up to {highest_m:.6g} m high",
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        highest_m=highest_m,
    )


def model_surface_pressure(*, where: str, departure: float) -> InputError:
    """Surface pressure and height of a model's ground differ, by ``departure`` in ln p."""
    return InputError(
        MODEL_UNITS,
        (
            "ln of surface pressure differs by up to {departure:.3g} from the value for the height "
            "of the ground: z or lnsp has another unit"
        ),
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        departure=departure,
    )


def model_highest_pressure(*, where: str, highest_pa: float) -> InputError:
    """The highest pressure level of a model is not near the ground, in Pa or in hPa."""
    return InputError(
        MODEL_UNITS,
        "the highest pressure level is {highest_pa:.6g} Pa, not near the ground",
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        highest_pa=highest_pa,
    )


def model_thickness(*, where: str, ratio: float) -> InputError:
    """The layers of a model are ``ratio`` times as thick as their temperatures imply."""
    return InputError(
        MODEL_UNITS,
        (
            "layers are {ratio:.4g} times as thick as pressure and temperature imply: a factor of "
            "1 means geopotential metres, 9.807 means geopotential"
        ),
        remedy=FETCH_MODEL_AGAIN,
        where=where,
        ratio=ratio,
    )


def model_units_ground(
    *, where: object, surface: float, ground: float, metres: float
) -> InputError:
    """A ground without a unit fits the true ground as metres, not as geopotential.

    Its height [m] is ``surface`` as geopotential and ``metres`` as metres; the true one ``ground``.
    """
    return InputError(
        MODEL_UNITS,
        (
            "z of its ground has no unit: as geopotential the ground is at {surface:.0f} m, in "
            "metres at {metres:.0f} m; the ground of the mission is at {ground:.0f} m"
        ),
        where=where,
        surface=surface,
        ground=ground,
        metres=metres,
        remedy="state the unit: ncatted -a units,z,c,c,'m' file.nc, or 'm**2 s**-2'",
    )


SOUNDING_CHOICE = Code(
    "SOUNDING-CHOICE",
    means="The file contains several soundings, and none is chosen.",
    effect="The mission is refused.",
    remedy="Keep only the sounding of the flight in the file, or give times.",
)


def sounding_choice_rows(*, where: object, hours: float) -> InputError:
    """The times of the rows of a table differ by more hours than an ascent takes."""
    return InputError(
        SOUNDING_CHOICE,
        (
            "its rows are up to {hours:.1f} hours apart: one ascent does not take so long, so the "
            "file contains several"
        ),
        where=where,
        hours=hours,
        remedy="keep the rows of one ascent",
    )


def sounding_choice(*, where: object, total: int) -> InputError:
    """A file has several soundings, and no time of the flight to choose one by."""
    return InputError(
        SOUNDING_CHOICE,
        "the file contains {total} soundings, and no time is given to choose one",
        where=where,
        total=total,
        remedy="keep only the sounding of the flight in the file",
    )


def sounding_choice_undated(*, where: object, total: int) -> InputError:
    """A file has several soundings, none of which has a date."""
    return InputError(
        SOUNDING_CHOICE,
        "none of the {total} soundings has a date, so none can be chosen",
        where=where,
        total=total,
        remedy="keep one sounding",
    )


def sounding_choice_begins_again(*, where: object) -> InputError:
    """The pressures of a table begin again at the ground, as of another ascent."""
    return InputError(
        SOUNDING_CHOICE,
        (
            "its pressures begin again at the ground: it contains several ascents, and no column "
            "separates them"
        ),
        where=where,
        remedy="keep the rows of one ascent, or state the time of each row (time_utc)",
    )


def sounding_choice_same_time(*, where: object, total: int) -> InputError:
    """Several soundings of a file have the time that is nearest to the flight."""
    return InputError(
        SOUNDING_CHOICE,
        "{total} soundings of the file have the time that is nearest to the flight",
        where=where,
        total=total,
        remedy=(
            "keep the sounding of the nearest station, or put each sounding into a separate file"
        ),
    )


SOUNDING_CHOSEN = Code(
    "SOUNDING-CHOSEN",
    means="The file has several soundings. The sounding nearest in time is used.",
    effect="As stated.",
    remedy="Nothing.",
)


def sounding_chosen(*, where: str, count: int, hours: float) -> Message:
    """Of ``count`` soundings of a file the nearest in time is used, ``hours`` from the flight."""
    return note(
        SOUNDING_CHOSEN,
        "of {count} soundings, the one {hours:.1f} hours away is used",
        one="of 1 sounding, the one {hours:.1f} hours away is used",
        where=where,
        count=count,
        hours=hours,
    )


SOUNDING_COLUMN = Code(
    "SOUNDING-COLUMN",
    means=(
        "A column of the sounding is missing or occurs twice, or two columns give the same "
        "quantity."
    ),
    effect="The mission is refused.",
    remedy="Name columns like h_m, pressure_hpa, temperature_c, dew_point_c.",
)


def sounding_column_twice(*, where: str, column: str) -> InputError:
    """Two columns of a table have the same name."""
    return InputError(
        SOUNDING_COLUMN,
        "the column {column!r} occurs twice",
        where=where,
        remedy="keep one of them",
        column=column,
    )


def sounding_quantity_twice(*, where: str, column: str, other: str, quantity: str) -> InputError:
    """Two columns of a plain CSV give the same quantity."""
    return InputError(
        SOUNDING_COLUMN,
        "{column} and {other} both give the {quantity}",
        where=where,
        remedy="keep one of them",
        column=column,
        other=other,
        quantity=quantity,
    )


def sounding_column_wyoming(*, where: object, missing: str) -> InputError:
    """A Wyoming CSV lacks one of its columns."""
    return InputError(
        SOUNDING_COLUMN,
        "the Wyoming CSV has no column {missing!r}",
        where=where,
        missing=missing,
        remedy="fetch the file again, with all columns",
    )


def sounding_column(*, where: object, needed: str, present: str, names: str) -> InputError:
    """No column of a plain CSV gives a quantity that is ``needed``.

    ``present`` lists the columns of the file, ``names`` those that would give the quantity.
    """
    return InputError(
        SOUNDING_COLUMN,
        "no column gives the {needed} with its unit; there are {present}",
        where=where,
        needed=needed,
        present=present,
        names=names,
        remedy="name the column {names}",
    )


SOUNDING_COLUMNS_UNUSED = Code(
    "SOUNDING-COLUMNS-UNUSED",
    means="Columns of the sounding are not read.",
    effect="None.",
    remedy="Rename them if they are needed.",
)


def sounding_columns_unused(*, where: str, count: int, columns: str) -> Message:
    """Some columns of a plain CSV have unknown names and are not read."""
    return note(
        SOUNDING_COLUMNS_UNUSED,
        "columns that are not read: {columns}",
        where=where,
        count=count,
        columns=columns,
    )


SOUNDING_CUT_OFF = Code(
    "SOUNDING-CUT-OFF",
    means="Soundings have a header and no levels. The file was cut off.",
    effect="One of them may have been nearer to the flight.",
    remedy="Fetch the file again.",
)


def sounding_cut_off(*, where: str, count: int) -> Message:
    """Some soundings of a file have a header and no levels."""
    return loss(
        SOUNDING_CUT_OFF,
        (
            "{count} soundings have a header and no level: one of them may have been nearer "
            "to the flight"
        ),
        one=(
            "1 sounding has a header and no level: one of them may have been nearer to the flight"
        ),
        where=where,
        count=count,
    )


SOUNDING_DUPLICATE = Code(
    "SOUNDING-DUPLICATE",
    means="Levels repeat the pressure or the height of another.",
    effect="They are averaged.",
    remedy="Nothing.",
)


def sounding_duplicate(*, where: str, count: int) -> Message:
    """Some levels have the pressure or the height of another level: averaged."""
    return note(
        SOUNDING_DUPLICATE,
        "{count} levels repeat the pressure or the height of another: averaged",
        one="1 level repeats the pressure or the height of another: averaged",
        where=where,
        count=count,
    )


SOUNDING_EMPTY = Code(
    "SOUNDING-EMPTY",
    means="The sounding has no levels, or its table cannot be read.",
    effect="The mission is refused.",
    remedy="Fetch the file again.",
)


def sounding_without_lines(*, where: str) -> InputError:
    """The file of a sounding has no line but comments."""
    return InputError(
        SOUNDING_EMPTY, "the sounding is empty", where=where, remedy="fetch the file again"
    )


def sounding_no_table(*, where: str, error: str) -> InputError:
    """The text of a sounding cannot be read as a table; ``error`` is the reason."""
    return InputError(
        SOUNDING_EMPTY,
        "the sounding cannot be read as a table: {error}",
        where=where,
        error=error,
        remedy=(
            "write a first line with the names of the columns, and the same number of fields in "
            "every row"
        ),
    )


def sounding_empty(*, where: object) -> InputError:
    """The sounding has no levels."""
    return InputError(
        SOUNDING_EMPTY,
        "the file contains no levels",
        where=where,
        remedy="fetch it again",
    )


SOUNDING_FORMAT = Code(
    "SOUNDING-FORMAT",
    means="The file is not a sounding of the format that is stated or detected.",
    effect="The mission is refused.",
    remedy="Leave format out, or state the format of the file.",
)


def sounding_format_igra(*, where: object) -> InputError:
    """A file is stated to be of IGRA, and no line begins with # as headers do."""
    return InputError(
        SOUNDING_FORMAT,
        "is not an IGRA file: none of its lines begins with #, as the header of a sounding does",
        where=where,
        remedy="leave format out, or state the format of the file",
    )


def sounding_format_name(*, where: object, name: str, names: str) -> InputError:
    """A format of soundings with the stated name does not exist."""
    return InputError(
        SOUNDING_FORMAT,
        "no format of soundings is called {name!r}",
        where=where,
        name=name,
        names=names,
        remedy="one of auto, {names}",
    )


def sounding_format_header(*, where: object, header: str) -> InputError:
    """A line of an IGRA file begins with #, and is not the header of a sounding."""
    return InputError(
        SOUNDING_FORMAT,
        "{header!r} is not the header of an IGRA sounding",
        where=where,
        header=header,
        remedy="fetch the station's file again",
    )


def sounding_format(*, where: object, begins: str) -> InputError:
    """The format is not stated, and none recognises the file; ``begins`` is its first line."""
    return InputError(
        SOUNDING_FORMAT,
        "is not a sounding in a known format: it begins with {begins!r}",
        where=where,
        begins=begins,
        remedy=(
            "give IGRA v2, a University of Wyoming list or CSV, or a CSV with column names like "
            "h_m, pressure_hpa, temperature_c, dew_point_c"
        ),
    )


SOUNDING_HEIGHT = Code(
    "SOUNDING-HEIGHT",
    means="No level of the sounding has a height.",
    effect="The mission is refused.",
    remedy="Name the column of heights h_m, or give station_h_msl_m.",
)


def sounding_height(*, where: object, total: int) -> InputError:
    """No level of the sounding has a height."""
    return InputError(
        SOUNDING_HEIGHT,
        "none of the {total} levels has a height",
        where=where,
        total=total,
        remedy=(
            "name the column of heights above the sea h_m, or give the height of the station above "
            "the sea as station_h_msl_m"
        ),
    )


SOUNDING_HEIGHTS = Code(
    "SOUNDING-HEIGHTS",
    means="Levels have no height. It is computed from pressure and temperature.",
    effect="Allowed substitute.",
    remedy="Nothing.",
)


def sounding_heights(*, where: str, count: int) -> Message:
    """Some levels have no height: it is computed."""
    return fallback(
        SOUNDING_HEIGHTS,
        "{count} levels have no height: it is computed from pressure and temperature",
        one="1 level has no height: it is computed from pressure and temperature",
        where=where,
        count=count,
    )


SOUNDING_HUMIDITY_NEGATIVE = Code(
    "SOUNDING-HUMIDITY-NEGATIVE",
    means="Levels have a humidity below zero.",
    effect="It is treated as unknown there.",
    remedy="Nothing.",
)


def sounding_humidity_negative(*, where: str, count: int) -> Message:
    """Some levels have a humidity below zero: treated as unknown."""
    return warning(
        SOUNDING_HUMIDITY_NEGATIVE,
        "{count} levels have a humidity below zero: treated as unknown",
        one="1 level has a humidity below zero: treated as unknown",
        where=where,
        count=count,
    )


SOUNDING_HUMIDITY_OVER = Code(
    "SOUNDING-HUMIDITY-OVER",
    means="Levels have more than 100 % humidity.",
    effect="They are treated as saturated.",
    remedy="Nothing.",
)


def sounding_humidity_over(*, where: str, count: int, percent: float) -> Message:
    """Some levels have more than 100 % humidity, at most ``percent``: treated as saturated."""
    return warning(
        SOUNDING_HUMIDITY_OVER,
        (
            "{count} levels have a dew point above the temperature or more than 100 % "
            "humidity, at most {percent:.0f} %: treated as saturated"
        ),
        one=(
            "1 level has a dew point above the temperature or more than 100 % humidity, "
            "at most {percent:.0f} %: treated as saturated"
        ),
        where=where,
        count=count,
        percent=percent,
    )


SOUNDING_HUMIDITY_RANGE = Code(
    "SOUNDING-HUMIDITY-RANGE",
    means="Levels have an impossible dew point.",
    effect="It is treated as unknown there.",
    remedy="Check the unit of the dew point.",
)


def sounding_humidity_range(*, where: str, count: int, first: float) -> Message:
    """Some levels have an impossible dew point, the ``first`` in K: treated as unknown."""
    return warning(
        SOUNDING_HUMIDITY_RANGE,
        (
            "{count} levels have an impossible dew point, the first {first:.1f} K: treated as "
            "unknown"
        ),
        one="1 level has an impossible dew point of {first:.1f} K: treated as unknown",
        where=where,
        count=count,
        first=first,
    )


SOUNDING_INCONSISTENT = Code(
    "SOUNDING-INCONSISTENT",
    means="The layers of the sounding are not as thick as their pressures and temperatures imply.",
    effect="The mission is refused.",
    remedy="Look for heights in feet, temperatures in Fahrenheit, or exchanged columns.",
)


def sounding_inconsistent(*, where: object, ratio: float) -> InputError:
    """The layers are ``ratio`` times as thick as their pressures and temperatures imply."""
    return InputError(
        SOUNDING_INCONSISTENT,
        "the layers are {ratio:.3f} times as thick as their pressures and temperatures imply",
        where=where,
        ratio=ratio,
        remedy=(
            "look for heights in feet (3.28 times), temperatures in Fahrenheit, exchanged columns, "
            "or a wrong file in atmosphere.soundings.path"
        ),
    )


SOUNDING_INDEX_RISES = Code(
    "SOUNDING-INDEX-RISES",
    means=(
        "The refractive index grows with height by more than it does over hot ground (4 %, or 0.6 "
        "% from 300 m above it). Light bends away from the ground."
    ),
    effect="The levels are kept.",
    remedy="Compare temperatures and dew points with the levels around them.",
)


def sounding_index_rises(*, where: str, percent: float, low_m: float, high_m: float) -> Message:
    """The refractive index grows with height in a layer, more than over hot ground."""
    return warning(
        SOUNDING_INDEX_RISES,
        (
            "from {low_m:.0f} to {high_m:.0f} m the refractive index grows by {percent:.1f} %: "
            "light bends away from the ground there, more than over hot ground: kept"
        ),
        where=where,
        percent=percent,
        low_m=low_m,
        high_m=high_m,
    )


SOUNDING_LATITUDE = Code(
    "SOUNDING-LATITUDE",
    means="Neither the sounding nor the flight has a latitude.",
    effect=(
        "Its heights are computed for a latitude of 45 degrees. At 10 km they are wrong by 27 m at "
        "most."
    ),
    remedy="Add latitude_deg.",
)


def sounding_latitude(*, where: str) -> Message:
    """The latitude of the sounding is not known."""
    return fallback(
        SOUNDING_LATITUDE,
        (
            "the latitude of the sounding is not known: its heights are computed for 45 degrees, "
            "which is at most 27 m wrong at 10 km"
        ),
        where=where,
    )


SOUNDING_LEVELS = Code(
    "SOUNDING-LEVELS",
    means="Too few levels have pressure and temperature and are in order.",
    effect="The mission is refused.",
    remedy="Give another sounding, or the lowest level as a surface report.",
)


def sounding_levels(*, where: object, count: int, fewest: int) -> InputError:
    """Too few levels have pressure and temperature and are in order."""
    return InputError(
        SOUNDING_LEVELS,
        "{count} levels have a pressure and a temperature and are in order; {fewest} are needed",
        one="1 level has a pressure and a temperature and is in order; {fewest} are needed",
        where=where,
        count=count,
        fewest=fewest,
        remedy="give another sounding, or the lowest level as a surface report",
    )


SOUNDING_MISSING = Code(
    "SOUNDING-MISSING",
    means="Levels have no pressure or no temperature.",
    effect="They are not used.",
    remedy="Nothing.",
)


def sounding_missing(*, where: str, count: int, total: int) -> Message:
    """Some levels have no pressure or no temperature: not used."""
    return note(
        SOUNDING_MISSING,
        "{count} of {total} levels have no pressure or no temperature, and are not used",
        where=where,
        count=count,
        total=total,
    )


SOUNDING_ORDER = Code(
    "SOUNDING-ORDER",
    means="Levels are lower than a level with a higher pressure.",
    effect="They are not used.",
    remedy="Nothing, if they are few.",
)


def sounding_order(*, where: str, count: int, height_m: float, hpa: float) -> Message:
    """Some levels are lower than a level with a higher pressure: not used.

    ``height_m``, ``hpa`` are those of the first.
    """
    return warning(
        SOUNDING_ORDER,
        (
            "{count} levels are lower than a level with a higher pressure, the first at "
            "{height_m:.0f} m and {hpa:.1f} hPa: not used"
        ),
        one=(
            "1 level is lower than a level with a higher pressure, the first at {height_m:.0f} m "
            "and {hpa:.1f} hPa: not used"
        ),
        where=where,
        count=count,
        height_m=height_m,
        hpa=hpa,
    )


SOUNDING_RANGE = Code(
    "SOUNDING-RANGE",
    means="Levels have impossible values.",
    effect="They are not used.",
    remedy="Check units, or fetch the file again.",
)


def sounding_range(*, where: str, count: int, hpa: float, kelvin: float) -> Message:
    """Some levels have an impossible pressure or temperature (``hpa``, ``kelvin`` of the first)."""
    return loss(
        SOUNDING_RANGE,
        "{count} levels have impossible values, the first {hpa:.1f} hPa and {kelvin:.1f} K",
        one="1 level has impossible values, the first {hpa:.1f} hPa and {kelvin:.1f} K",
        where=where,
        count=count,
        hpa=hpa,
        kelvin=kelvin,
    )


SOUNDING_SUPERADIABATIC = Code(
    "SOUNDING-SUPERADIABATIC",
    means=(
        "The air cools with height far more than rising dry air: by 12 K near the ground, or by 2 "
        "K above it. Of 479 public ascents one has such values."
    ),
    effect="The levels are kept.",
    remedy=(
        "Compare the temperatures with the levels around them. Look for a typing error or a wet "
        "sensor."
    ),
)


def sounding_superadiabatic(*, where: str, excess_k: float, low_m: float, high_m: float) -> Message:
    """The air cools in a layer by ``excess_k`` more than rising dry air."""
    return warning(
        SOUNDING_SUPERADIABATIC,
        (
            "from {low_m:.0f} to {high_m:.0f} m the air cools by {excess_k:.1f} K more than rising "
            "dry air, which radiosondes do not measure: kept"
        ),
        where=where,
        excess_k=excess_k,
        low_m=low_m,
        high_m=high_m,
    )


SOUNDING_TIME = Code(
    "SOUNDING-TIME",
    means="The sounding states a time that cannot be read, or two times that differ.",
    effect="The mission is refused, because the age of the sounding would be a guess.",
    remedy="Write it as 2026-05-14T10:20:00Z, or correct the wrong one.",
)


def sounding_time(*, where: str, time: str) -> InputError:
    """The time that a sounding states cannot be read."""
    return InputError(
        SOUNDING_TIME,
        "its time {time!r} is not written like 2026-05-14T10:20:00Z",
        where=where,
        remedy="write the time of the sounding, in UTC, as 2026-05-14T10:20:00Z",
        time=time,
    )


def sounding_time_column(*, where: str, column: str, time: str) -> InputError:
    """A table states its time in a column of another name."""
    return InputError(
        SOUNDING_TIME,
        "column {column} states {time!r}, and there is no time_utc",
        where=where,
        remedy="state the time of the sounding, in UTC, as 2026-05-14T10:20:00Z in a column "
        "time_utc, or remove the column",
        column=column,
        time=time[:40],
    )


def sounding_two_times(*, where: str, hours: float) -> InputError:
    """The heading of an ascent and its time of observation contradict each other."""
    return InputError(
        SOUNDING_TIME,
        "its heading and its time of observation differ by {hours:.0f} hours",
        where=where,
        remedy="fetch the page again, or correct the wrong one",
        hours=hours,
    )


SOUNDING_PLACE = Code(
    "SOUNDING-PLACE",
    means="The sounding states a place that cannot be read.",
    effect="The mission is refused, because the distance of the sounding would be a guess.",
    remedy="Write latitude_deg from -90 to 90 and longitude_deg from -180 to 360, with points.",
)


def sounding_place(*, where: str, latitude: str, longitude: str) -> InputError:
    """The latitude or the longitude that a sounding states cannot be read, or is impossible."""
    return InputError(
        SOUNDING_PLACE,
        "its place ({latitude!r}, {longitude!r}) is not a latitude and a longitude in degrees",
        where=where,
        remedy="write latitude_deg from -90 to 90 and longitude_deg from -180 to 360, with points "
        "for decimals",
        latitude=latitude.strip()[:40],
        longitude=longitude.strip()[:40],
    )


SOUNDING_TRUNCATED = Code(
    "SOUNDING-TRUNCATED",
    means="The header states more levels than the file has.",
    effect="The levels of the file are used.",
    remedy="Fetch the file again.",
)


def sounding_truncated(*, where: str, count: int) -> Message:
    """The header of a sounding states ``count`` levels more than the file has."""
    return loss(
        SOUNDING_TRUNCATED,
        "the header states {count} levels more than there are",
        one="the header states 1 level more than there are",
        where=where,
        count=count,
    )


SOUNDING_UNITS = Code(
    "SOUNDING-UNITS",
    means=(
        "Values of the sounding look like another unit than the name of their column states, or "
        "temperature and dew point are exchanged."
    ),
    effect="The mission is refused.",
    remedy="State the unit in the column's name, or exchange the two columns.",
)


def sounding_too_wet(
    *, where: str, column: str, quantity: str, percent: float, limit_percent: float
) -> InputError:
    """``percent`` of the levels are above ``limit_percent`` relative humidity: another unit."""
    return InputError(
        SOUNDING_UNITS,
        _with_column(
            (
                "{quantity}: {percent:.0f} % of the levels have more than {limit_percent:.0f} % "
                "humidity: dew-point depressions instead of dew points, or another unit"
            ),
            column,
        ),
        where=where,
        remedy=(
            "state the unit in the column's name: dew_point_c (temperature less depression), "
            "relative_humidity_percent"
        ),
        column=column,
        quantity=quantity,
        percent=percent,
        limit_percent=limit_percent,
    )


def sounding_dew_points_exchanged(*, where: str, column: str, percent: float) -> InputError:
    """Dew points are above the temperatures in ``percent`` of the levels: exchanged."""
    return InputError(
        SOUNDING_UNITS,
        _with_column(
            (
                "the dew point is above the temperature in {percent:.0f} % of the levels, which is "
                "impossible: temperature and dew point seem exchanged"
            ),
            column,
        ),
        where=where,
        remedy="exchange temperature and dew point: the names of the columns, or their values",
        column=column,
        percent=percent,
    )


def sounding_pressure_unit(
    *, where: str, column: str, highest_pa: float, likely: str
) -> InputError:
    """The highest pressure of a sounding does not occur near the ground; ``likely``: the reason."""
    return InputError(
        SOUNDING_UNITS,
        _with_column("pressure: the highest pressure is {highest_pa:.6g} Pa: {likely}", column),
        remedy="state the unit in the column's name: pressure_pa or pressure_hpa",
        where=where,
        column=column,
        highest_pa=highest_pa,
        likely=likely,
    )


def sounding_temperature_unit(
    *, where: str, column: str, warmest_k: float, likely: str
) -> InputError:
    """The temperature of the warmest level is impossible; ``likely``: the reason."""
    return InputError(
        SOUNDING_UNITS,
        _with_column("temperature: the warmest level has {warmest_k:.6g} K: {likely}", column),
        remedy=(
            "state the unit in the column's name: temperature_k or temperature_c, and convert "
            "Fahrenheit"
        ),
        where=where,
        column=column,
        warmest_k=warmest_k,
        likely=likely,
    )


def sounding_dew_point_unit(*, where: str, column: str, highest_k: float) -> InputError:
    """The highest dew point of a sounding is impossible."""
    return InputError(
        SOUNDING_UNITS,
        _with_column("dew point: the highest dew point is {highest_k:.6g} K", column),
        remedy="state the unit in the column's name: dew_point_c or dew_point_k",
        where=where,
        column=column,
        highest_k=highest_k,
    )


def sounding_humidity_unit(*, where: str, column: str, highest: float) -> InputError:
    """The highest relative humidity of a sounding is impossible as a fraction of 1."""
    return InputError(
        SOUNDING_UNITS,
        _with_column(
            "relative humidity: the highest is {highest:.4g} as a fraction of one", column
        ),
        remedy=(
            "state the unit in the column's name: relative_humidity (0 to 1) or "
            "relative_humidity_percent"
        ),
        where=where,
        column=column,
        highest=highest,
    )


def sounding_vapour_unit(*, where: str, column: str, highest_pa: float) -> InputError:
    """The highest vapour pressure of a sounding is impossible."""
    return InputError(
        SOUNDING_UNITS,
        _with_column("vapour pressure: the highest is {highest_pa:.6g} Pa", column),
        remedy="state the unit in the column's name: vapour_pressure_pa or vapour_pressure_hpa",
        where=where,
        column=column,
        highest_pa=highest_pa,
    )


def _with_column(text: str, column: str) -> str:
    """The text with a place for the name of the column, unless ``column`` is empty."""
    return f"{text} (column {{column}})" if column else text


SOUNDING_UNSORTED = Code(
    "SOUNDING-UNSORTED",
    means="Pressure rises from one level to the next.",
    effect="The levels are put in order.",
    remedy="Nothing.",
)


def sounding_unsorted(*, where: str, count: int) -> Message:
    """Pressure rises ``count`` times from one level to the next: the levels are sorted."""
    return warning(
        SOUNDING_UNSORTED,
        "pressure rises {count} times from one level to the next: the levels are put in order",
        one="pressure rises 1 time from one level to the next: the levels are put in order",
        where=where,
        count=count,
    )
