"""The sections of a mission file as models with strict types and no unknown keys."""

import difflib
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from unbend.config.atmosphere import AtmosphereSection
from unbend.config.cameras import (
    OWN_ORIENTATION,
    CameraSection,
    MountSection,
    PathText,
    Section,
    mistake,
    one_of,
    refuse,
)
from unbend.config.event_sources import EventsSection, PositionEvents
from unbend.config.station_sources import LocalOrigin, NamedColumns, StationsSection
from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M
from unbend.flight.image_names import Difference
from unbend.flight.mount import Mount
from unbend.refraction import METHODS, Camera, LensInAir, Window
from unbend.tables.imports.blocks import BLOCKS
from unbend.tables.pixels import PixelOrigin, PixelSystem


class MissionSection(Section):
    """Name of the mission, and what its log does not hold."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="name of the mission: letters, digits, dot, dash, underscore",
        examples=["survey-2026-05"],
        json_schema_extra={
            "patternErrorMessage": "letters, digits, dots, dashes and underscores, at most 100"
        },
    )
    undulation_m: float | None = Field(
        None,
        ge=-120,
        le=100,
        description=(
            "ellipsoidal height minus height above mean sea level, where the log does not carry "
            "both; by default that of the geoid"
        ),
        examples=[47.6],
        json_schema_extra={"unit": "m"},
    )
    geoid: Literal["egm96"] | PathText = Field(
        "egm96",
        description=(
            "geoid of the undulations that neither the log nor undulation_m gives: egm96 (in the "
            "package), or the path of a .gtx or a GeoTIFF of ellipsoidal minus orthometric heights "
            "[m]"
        ),
        examples=["egm96"],
    )


class CampaignSection(Section):
    """Name of a campaign, and where its page and table go."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="name of the campaign: letters, digits, dot, dash, underscore",
        examples=["season-2026"],
        json_schema_extra={
            "patternErrorMessage": "letters, digits, dots, dashes and underscores, at most 100"
        },
    )
    output: PathText = Field(
        description=(
            "folder of campaign.html and campaign.parquet, and by default of a folder for each "
            "mission"
        ),
        examples=["results"],
    )


class CampaignFile(Section):
    """A campaign file: what its missions share, and which they are."""

    campaign: CampaignSection = Field(
        description="of a campaign file: its name, and where its page and table go",
    )
    defaults: dict[str, Any] = Field(
        {},
        description=(
            "of a campaign file: sections of a mission file that stand where a mission has none of "
            "its own; values that belong together, as a camera or a mount, are taken whole. Paths "
            "are relative to the campaign file; {mission} in output.path is the mission's name; "
            "null in a mission takes a default away"
        ),
    )
    missions: list[PathText | dict[str, Any]] = Field(
        min_length=1,
        description=(
            "of a campaign file: its missions, each a mission file, a pattern of files as "
            "flights/*.yaml, or the sections themselves"
        ),
        examples=[["flights/*/mission.yaml"]],
    )


class NamedChannel(Section):
    """A channel by its name, with the unit it is really in."""

    name: str = Field(
        description="name of the channel, as `unbend inspect` prints it",
        examples=["BARO[0]"],
    )
    unit: Literal["Pa", "hPa", "kPa", "K", "degC", "fraction", "percent", "m/s"] | None = Field(
        None,
        description="unit that the channel's values are really in, where the log says another one",
        examples=["hPa"],
    )


class ChannelsSection(Section):
    """Which channel plays which role; names as ``unbend inspect`` prints them."""

    position: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of latitude and longitude; a name as `unbend inspect` prints it, or {name, "
            "unit} where the log's unit is wrong. By default the only one of its kind"
        ),
        examples=["GPS[0]"],
    )
    height: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the heights of the GNSS receiver, at which the air was sampled; a name as "
            "`unbend inspect` prints it, or {name, unit}. By default the best receiver"
        ),
        examples=["GPS[0]"],
    )
    attitude: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the attitude to which the cameras are mounted: the aircraft's, or that of "
            "a stabilised mount; a name as `unbend inspect` prints it"
        ),
        examples=["ATT"],
    )
    aircraft_attitude: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the attitude of the aircraft itself, where attitude is that of a "
            "stabilised mount; only needed for window.frame: body"
        ),
        examples=["ATT"],
    )
    pressure: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the static pressure outside; a name as `unbend inspect` prints it, or "
            "{name, unit} where the log's unit is wrong. By default the only one of its kind"
        ),
        examples=["BARO[0]"],
    )
    temperature: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the temperature of the air outside; a name as `unbend inspect` prints it, "
            "or {name, unit} where the log's unit is wrong. By default the only one of its kind"
        ),
        examples=["HYGR[0]"],
    )
    humidity: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the relative humidity outside; a name as `unbend inspect` prints it, or "
            "{name, unit} where the log's unit is wrong. By default the only one of its kind"
        ),
        examples=["HYGR[0]"],
    )
    airspeed: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the airspeed, by which a thermometer is heated; a name as `unbend inspect` "
            "prints it"
        ),
        examples=["ARSP[0]"],
    )
    cabin_pressure: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the pressure in the compartment of the camera; a name as `unbend inspect` "
            "prints it, or {name, unit} where the log's unit is wrong. By default the only one of "
            "its kind"
        ),
        examples=["BARO[1]"],
    )
    cabin_temperature: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the temperature in the compartment of the camera; a name as `unbend "
            "inspect` prints it, or {name, unit} where the log's unit is wrong. By default the "
            "only one of its kind"
        ),
        examples=["HYGR[1]"],
    )
    cabin_humidity: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the relative humidity in the compartment of the camera; a name as `unbend "
            "inspect` prints it, or {name, unit} where the log's unit is wrong. By default the "
            "only one of its kind"
        ),
        examples=["HYGR[1]"],
    )

    def named(self) -> dict[str, NamedChannel]:
        given = {role: getattr(self, role) for role in type(self).model_fields}
        return {
            role: NamedChannel(name=value) if isinstance(value, str) else value
            for role, value in given.items()
            if value is not None
        }


class LogSection(Section):
    """The flight log."""

    path: PathText = Field(
        description=(
            "the log, a file or a URL of object storage: MCAP (.mcap), PX4 ULog (.ulg .ulog), "
            "ArduPilot DataFlash (.bin), ArduPilot DataFlash as text (.log), MAVLink telemetry "
            "(.tlog .rlog)"
        ),
        examples=["flight.bin"],
    )
    channels: ChannelsSection = Field(
        ChannelsSection(),
        description="which channel plays which role; only what is not found without it",
    )
    max_gap_s: float = Field(
        2.0,
        gt=0,
        le=60,
        description=(
            "longest interval between two positions or attitudes that is no gap: an exposure in a "
            "longer one is in a gap (in_gap)"
        ),
        examples=[2.0],
        json_schema_extra={"unit": "s"},
    )
    local_origin: LocalOrigin | None = Field(
        None,
        description="where the origin of local positions (motion capture) lies",
    )


class ObservationColumnNames(Section):
    """What the columns of the table are called."""

    image: str = Field(
        "image",
        description="column of the names of the images",
        examples=["image"],
    )
    point: str = Field(
        "point",
        description="column of the names of the points",
        examples=["point"],
    )
    x_px: str = Field(
        "x_px",
        description="column of the measured x, in pixels to the right",
        examples=["x_px"],
    )
    y_px: str = Field(
        "y_px",
        description="column of the measured y, in pixels down",
        examples=["y_px"],
    )
    distance_m: str | None = Field(
        None,
        description=(
            "column of slant ranges to the points [m], where they are known. They tell the near "
            "from the far crossing of a ray that meets the point's height twice"
        ),
        examples=["distance_m"],
    )


class ObservationsSection(Section):
    """The table of image measurements."""

    path: PathText = Field(
        description=(
            "the table, a file or a URL of object storage: CSV or Parquet, or a block in the "
            "format that format names"
        ),
        examples=["observations.csv"],
    )
    format: Literal["csv", "parquet", *BLOCKS] | None = Field(
        None,
        description=(
            "csv or parquet, where the ending does not say it; or the block of another program, "
            "with its cameras and orientations: colmap, a model's folder or a database; opensfm, a "
            "project's folder; metashape, a .psz or .xml; dbat, a script"
        ),
        examples=["csv"],
    )  # type: ignore[valid-type]
    columns: ObservationColumnNames = Field(
        ObservationColumnNames(),
        description="names of the table's columns, where they are called otherwise",
    )
    pixel_origin: PixelOrigin = Field(
        "corner",
        description=(
            "where the table counts its pixels from. corner: the centre of the upper left pixel is "
            "(0.5, 0.5), as in COLMAP; centre: it is (0, 0), as in OpenCV"
        ),
        examples=["corner"],
    )
    match_names: list[Difference] = Field(
        [],
        description=(
            "in what the images may be called otherwise than their exposures: case, extension, "
            "folder, digits (DSC1 for DSC_0001)"
        ),
        examples=[["case", "digits"]],
    )
    refraction: Literal["none", "removed_by_other"] = Field(
        "none",
        description=(
            "what was done to the observations before: none, as measured; removed_by_other: "
            "another program has removed refraction, and they are refused"
        ),
        examples=["none"],
    )

    @field_validator("refraction")
    @classmethod
    def _check_not_twice(cls, value: str) -> str:
        if value != "none":
            raise mistake("refraction-twice")
        return value

    @model_validator(mode="after")
    def _check_block(self) -> Self:
        if self.format in BLOCKS:
            named, moved = self.columns != ObservationColumnNames(), self.pixel_origin != "corner"
            refuse((named, "columns-of-block"), (moved, "pixels-of-block"), format=self.format)
        return self

    @property
    def pixels(self) -> PixelSystem:
        """The pixel system of the table, and of cameras that name none."""
        return PixelSystem(self.pixel_origin)


class GroundColumn(Section):
    """Ground heights in a column of the observations."""

    column: str = Field(
        description="column of the observations that holds the height of each point [m]",
        examples=["h_g_m"],
    )


class PointColumns(NamedColumns):
    """Columns of a table of object points: latitude and longitude [deg], or x and y of its crs."""

    point: str = Field(
        "point",
        description="column of the names of the points",
        examples=["point"],
    )
    latitude: str | None = Field(
        None,
        description="column of latitudes [deg]",
        examples=["lat_deg"],
    )
    longitude: str | None = Field(
        None,
        description="column of longitudes [deg]",
        examples=["lon_deg"],
    )
    x: str | None = Field(
        None,
        description="column of x [m], to the east",
        examples=["east"],
    )
    y: str | None = Field(
        None,
        description="column of y [m], to the north",
        examples=["north"],
    )
    height: str = Field(
        "height",
        description="column of heights [m]",
        examples=["height"],
    )

    @model_validator(mode="after")
    def _check_places(self) -> Self:
        given = self.named.keys() - {"point", "height"}
        if given not in ({"latitude", "longitude"}, {"x", "y"}):
            raise ValueError("give either latitude and longitude, or x and y")
        return self


class PointTable(Section):
    """Ground heights by the names of points, in a table of their own."""

    points: PathText = Field(
        description="the table: CSV or Parquet, one row a point",
        examples=["points.csv"],
    )
    columns: PointColumns = Field(
        description="names of the table's columns",
    )
    crs: str = Field(
        description=(
            "coordinate system of the places, as EPSG:4326 or EPSG:25832; with a vertical part, as "
            "EPSG:25832+5773, of the heights too"
        ),
        examples=["EPSG:25832"],
    )


class ControlSection(Section):
    """Control points that are measured in the images, to compare them before and after.

    Columns, crs and reference go together; without them the table has point, lat_deg, lon_deg
    (WGS 84) and h_ellipsoid_m."""

    path: PathText = Field(
        description="the table: CSV or Parquet, one row a point, named as in the observations",
        examples=["control.csv"],
    )
    columns: PointColumns = Field(
        PointColumns(latitude="lat_deg", longitude="lon_deg", height="h_ellipsoid_m"),
        description="names of the table's columns; columns, crs and reference are stated together",
    )
    crs: str = Field(
        "EPSG:4326",
        description="coordinate system of the places; with a vertical part of the heights too",
        examples=["EPSG:4326"],
    )
    reference: Literal["msl", "ellipsoid", "relative"] = Field(
        "ellipsoid",
        description="what the heights count from, as under ground",
        examples=["ellipsoid"],
    )

    @model_validator(mode="after")
    def _check_stated(self) -> Self:
        stated = {"columns", "crs", "reference"}
        if 0 < len(stated & self.model_fields_set) < len(stated):
            raise ValueError("give columns, crs and reference together")
        return self


class GroundModel(Section):
    """A digital elevation model that the rays are followed to."""

    dem: PathText | list[PathText] = Field(
        description=(
            "raster of heights, or tiles of one: what GDAL reads, as GeoTIFF; a path or several"
        ),
        examples=["dem.tif"],
    )
    crs: str | None = Field(
        None,
        description="coordinate system of the raster, where the file has none",
        examples=["EPSG:25832"],
    )

    @property
    def paths(self) -> tuple[str, ...]:
        return (self.dem,) if isinstance(self.dem, str) else tuple(self.dem)


def _kind_of_height(value: Any) -> str:
    """Which of the sources of heights a value is meant for, so that one has its messages alone."""
    if isinstance(value, str | Section):
        return "name" if isinstance(value, str) else type(value).__name__
    if isinstance(value, dict):
        kinds = {"points": "PointTable", "dem": "GroundModel"}
        return next((kind for key, kind in kinds.items() if key in value), "GroundColumn")
    return "number"


_ABOVE_THE_SEA = ("from_distance", "intersected", "block")

GroundHeight = Annotated[
    Annotated[float, Tag("number")]
    | Annotated[GroundColumn, Tag("GroundColumn")]
    | Annotated[PointTable, Tag("PointTable")]
    | Annotated[GroundModel, Tag("GroundModel")]
    | Annotated[Literal["from_distance", "intersected", "block"], Tag("name")],
    Discriminator(_kind_of_height),
]


class GroundSection(Section):
    """Heights of the observed points. There is no default."""

    height: GroundHeight = Field(
        description=(
            "heights of the points: metres, or {column: NAME}; {points: PATH, columns, crs}: a "
            "table of object points; {dem: PATH}: where the rays meet an elevation model; "
            "from_distance: where the slant range ends; intersected: where the rays of the point "
            "meet, with the stations as they are; block: of the points of stations.orientation, "
            "and their median in the image for others"
        ),
        examples=[412.5],
        json_schema_extra={"unit": "m"},
    )
    reference: Literal["msl", "ellipsoid", "relative"] = Field(
        description=(
            "what the heights count from: msl, mean sea level; ellipsoid; relative, the take-off "
            "point"
        ),
        examples=["msl"],
    )
    home_h_msl_m: float | None = Field(
        None,
        ge=LOWEST_GROUND_M,
        le=HIGHEST_GROUND_M,
        description="height of the take-off point, where the log does not hold it",
        examples=[405.0],
        json_schema_extra={"unit": "m"},
    )
    sigma_m: float | None = Field(
        None,
        ge=0,
        le=10_000,
        description="standard deviation of the heights of all points",
        examples=[2.0],
        json_schema_extra={"unit": "m"},
    )
    sigma_column: str | None = Field(
        None,
        description="column of the observations with the standard deviation of each height [m]",
        examples=["sigma_h_m"],
    )

    @property
    def constant_m(self) -> float | None:
        return self.height if isinstance(self.height, float) else None

    @property
    def column(self) -> str | None:
        return self.height.column if isinstance(self.height, GroundColumn) else None

    @property
    def points(self) -> PointTable | None:
        return self.height if isinstance(self.height, PointTable) else None

    @property
    def model(self) -> GroundModel | None:
        return self.height if isinstance(self.height, GroundModel) else None

    @property
    def reference_of_values(self) -> Literal["msl", "ellipsoid", "relative"]:
        """What the heights of the observations count from: others are reduced to msl."""
        reduced = self.points is not None or self.model is not None
        return "msl" if reduced else self.reference

    @property
    def from_distance(self) -> bool:
        return self.height == "from_distance"

    @model_validator(mode="before")
    @classmethod
    def _default_reference(cls, values: Any) -> Any:
        """Heights that follow from the camera's own are above mean sea level."""
        if not isinstance(values, dict):
            return values
        if values.get("height") == "intersected" and "reference" in values:
            raise mistake("intersected-reference")
        if values.get("height") in _ABOVE_THE_SEA:
            return {"reference": "msl"} | values
        return values

    @field_validator("height")
    @classmethod
    def _check_height_range(cls, value: GroundHeight) -> GroundHeight:
        if isinstance(value, float) and not LOWEST_GROUND_M <= value <= HIGHEST_GROUND_M:
            raise ValueError("is no ground height in metres (-600 to 10000)")
        return value

    @model_validator(mode="after")
    def _check_combinations(self) -> Self:
        sigmas = (self.sigma_m is not None) + (self.sigma_column is not None)
        home, of_camera = self.home_h_msl_m is not None, isinstance(self.height, str)
        refuse(
            (sigmas > 1, "give either sigma_m or sigma_column"),
            (of_camera and (self.reference != "msl" or home), "reference-of-camera"),
            (self.model and (self.reference == "relative" or home), "reference-of-dem"),
            (self.height == "intersected" and sigmas, "intersected-sigma"),
            height=self.height,
        )
        return self


class RefractionSection(Section):
    """How rays are traced."""

    direction: Literal["remove", "apply"] = Field(
        "remove",
        description=(
            "remove: from measured observations to the straight chord; apply: from ideal "
            "observations to what a camera in this air would measure, for planning"
        ),
        examples=["remove"],
    )
    method: Annotated[str, one_of(lambda: METHODS)] = Field(
        "spherical",
        description=(
            "how the ray is computed: spherical, or a published method for comparison; `unbend "
            "angle --help` lists them"
        ),
        examples=["spherical"],
    )
    radius_m: float | None = Field(
        None,
        ge=6.2e6,
        le=6.5e6,
        description="radius of the earth; by default the ellipsoid's in the azimuth of the ray",
        examples=[6371000.0],
        json_schema_extra={"unit": "m"},
    )


class OutputSection(Section):
    """Where the results go."""

    path: PathText = Field(
        description="folder of this mission's results, or a URL of object storage",
        examples=["results/survey-2026-05"],
    )
    batch_rows: int = Field(
        250_000,
        ge=1_000,
        le=2_000_000,
        description="rows of observations that are held in memory at a time",
        examples=[250000],
        json_schema_extra={"unit": "1"},
    )


class AcceptedFinding(Section):
    """A finding that no longer makes a run end with code 3; the ledger keeps it, with the reason.

    Losses (rows flagged, data lost or damaged) cannot be accepted."""

    code: str = Field(
        pattern="^[A-Z0-9]+(-[A-Z0-9]+)+$",
        description="code of the finding, as the ledger prints it",
        examples=["PLAUSIBLE-GROUND"],
        json_schema_extra={"patternErrorMessage": "a code in capitals, as PLAUSIBLE-GROUND"},
    )
    reason: str = Field(
        min_length=3,
        description="why it is right all the same; it stands in the report",
        examples=["flown from a pass 1200 m above the valley"],
    )


class Mission(Section):
    """A mission file as understood."""

    mission: MissionSection = Field(
        description="name of the mission, and what its log does not hold",
    )
    log: LogSection | None = Field(
        None,
        description=(
            "the flight log. May be left out where stations.orientation, or stations.trajectory "
            "with attitudes and events with times, give the stations"
        ),
    )
    observations: ObservationsSection = Field(
        description="the table of image measurements",
    )
    cameras: dict[str, CameraSection] = Field(
        min_length=1,
        description="interior orientation of each camera, by a name of choice",
    )
    mount: dict[str, MountSection] = Field(
        {},
        description=(
            "how each camera sits in the aircraft, by the camera's name; with stations.orientation "
            "only where one is not at rest"
        ),
    )
    events: EventsSection | None = Field(
        None,
        description=(
            "when the images were exposed: log, csv or positions. May be left out with "
            "stations.orientation"
        ),
    )
    stations: StationsSection = Field(
        StationsSection(),
        description=(
            "stations that come from elsewhere than the log, and which stations may be used"
        ),
    )
    ground: GroundSection = Field(
        description="heights of the observed points. There is no default",
    )
    atmosphere: AtmosphereSection = Field(
        AtmosphereSection(),
        description="the air: what it is estimated from, and what it is shown beside",
    )
    refraction: RefractionSection = Field(
        RefractionSection(),
        description="how rays are traced",
    )
    control: ControlSection | None = Field(
        None,
        description=(
            "a path, or {path, columns, crs, reference}: control points, which stand in the report "
            "before and after; they change no result"
        ),
        examples=["control.csv"],
    )
    output: OutputSection = Field(
        description="where the results go",
    )
    accept: list[AcceptedFinding] = Field(
        [],
        description=(
            "findings that are right all the same: each with its code and the reason. Losses "
            "cannot be accepted"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _mounts_at_rest(cls, values: Any) -> Any:
        """With stations from elsewhere, a camera without a mount is at rest in the aircraft."""
        if not isinstance(values, dict):
            return values
        cameras, stations, mount = (values.get(key, {}) for key in ("cameras", "stations", "mount"))
        sections = isinstance(cameras, dict) and isinstance(mount, dict)
        if sections and isinstance(stations, dict) and stations.get("orientation") is not None:
            return values | {"mount": {name: {} for name in cameras} | mount}
        return values

    @model_validator(mode="before")
    @classmethod
    def _from_block(cls, values: Any) -> Any:
        """Cameras and orientations that are not given are those of the block of observations.

        The last of these validators runs first."""
        observations = values.get("observations") if isinstance(values, dict) else None
        if not isinstance(observations, dict) or observations.get("format") not in BLOCKS:
            return values
        path, program = observations.get("path"), observations["format"]
        cameras, stations = values.get("cameras"), values.get("stations") or {}
        if isinstance(cameras, dict):
            own = {n: c for n, c in cameras.items()
                   if not isinstance(c, dict) or c.keys() & OWN_ORIENTATION}  # fmt: skip
            block = {n: {"file": path, "format": program} | ({"camera": n} if cameras.keys() - {n}
                     else {}) for n in cameras.keys() - own.keys()}  # fmt: skip
            cameras = {n: block[n] | c if n in block else c for n, c in cameras.items()}
            values = values | {"cameras": cameras}
        elsewhere = any(values.get(key) for key in ("log", "events"))
        if isinstance(stations, dict):
            elsewhere = elsewhere or bool(stations.get("trajectory"))
            given = stations.get("orientation", None if elsewhere else {})
            if isinstance(given, dict) and "path" not in given:
                given = {"path": path, "format": program} | given
                values = values | {"stations": stations | {"orientation": given}}
        return values

    @field_validator("control", mode="before")
    @classmethod
    def _path_of_control(cls, value: Any) -> Any:
        return {"path": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check_station_source(self) -> Self:
        orientation, trajectory = self.stations.orientation, self.stations.trajectory
        of_log = self.events is not None and self.events.log is not None
        if self.log is None and orientation is None and not (self.position_events or trajectory):
            raise mistake("log-missing")
        if self.log is None and trajectory is not None and trajectory.replaces is not None:
            placed = any(not source.times_only for source in self.position_events.values())
            needed = {"attitude"} if placed else {"position", "height", "attitude"}
            if needed - set(trajectory.replaces):
                raise mistake("replaces-no-log")
        for name in ("events", "mount") if orientation is None else ():
            if not getattr(self, name):
                raise ValueError(f"{name} is missing, and there is no stations.orientation")
        if self.log is None and of_log:
            raise ValueError("events.log takes the exposures from a log, and there is no log")
        for name, mount in self.mount.items() if self.log is None else ():
            if mount.attitude is not None:
                raise ValueError(f"mount.{name}.attitude names a channel, and there is no log")
        for name, camera in self.cameras.items() if self.log is None else ():
            if camera.needs_cabin_from_log:
                raise mistake("cabin-no-log", name=name)
        blocks = {self.observations.format, orientation and orientation.format} & {*BLOCKS}
        if not blocks and any(c.camera is not None and not c.file for c in self.cameras.values()):
            raise ValueError("cameras.<name>.camera goes with file, or with a block")
        if orientation is None:
            return self
        if orientation.known_positions == "log" and (self.log is None or self.events is None):
            raise ValueError("known_positions: log needs log and events")
        named = orientation.camera
        says = orientation.columns.camera is not None or orientation.of_block
        if named is None and not says and len(self.cameras) > 1:
            raise mistake("orientation-camera")
        if named is not None and named not in self.cameras:
            raise ValueError(f"stations.orientation names camera {named!r}, which is not there")
        timed = orientation.has_clock or orientation.date is not None or self.events is not None
        if self.atmosphere.adjust and not timed:
            raise mistake("orientation-time")
        return self

    @cached_property
    def interior_orientations(self) -> dict[str, Camera]:
        """By camera, in COLMAP's pixels; of those of files once these are read (`with_file`)."""
        origin = self.observations.pixel_origin
        return {
            name: camera.interior_orientation_by(origin) for name, camera in self.cameras.items()
        }

    @cached_property
    def windows(self) -> dict[str, Window]:
        """The window of each camera that has one."""
        sections = {name: camera.window for name, camera in self.cameras.items()}
        return {name: section.window for name, section in sections.items() if section is not None}

    @cached_property
    def lenses(self) -> dict[str, LensInAir]:
        """How the lens follows the air, of the cameras of which the mission file says it."""
        lenses = {name: camera.lens for name, camera in self.cameras.items()}
        return {name: lens for name, lens in lenses.items() if lens is not None}

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """How each camera sits in the aircraft."""
        return {name: section.mount for name, section in self.mount.items()}

    @property
    def position_events(self) -> dict[str, PositionEvents]:
        """Files of exposures with their positions, by camera."""
        return (self.events.positions if self.events is not None else None) or {}

    def attitude_key(self, camera: str) -> str:
        """Where the angles of a camera are stated: its mount, or orientations that are its own."""
        oriented = self.stations.orientation
        own = oriented is not None and oriented.angles != "roll_pitch_yaw"
        return "stations.orientation" if own else f"mount.{camera}"

    @property
    def max_gap_s(self) -> float:
        """The longest interval of a log that is no gap [s]."""
        return LogSection(path="-").max_gap_s if self.log is None else self.log.max_gap_s

    @model_validator(mode="after")
    def _check_window_directions(self) -> Self:
        for name, camera in self.cameras.items():
            window = camera.window
            # A stabilised camera turns behind the window: only the log knows how.
            moves = self.log is not None and self.log.channels.aircraft_attitude is not None
            if window is None or window.frame == "camera" or moves or name not in self.mount:
                continue
            if self.mount[name].attitude is not None:
                continue
            x, y, z = self.mounts[name].camera_from_body @ np.array(window.normal)
            if z <= 0.0:
                raise mistake("window-away", name=name, x=x, y=y, z=z)
        return self

    @model_validator(mode="after")
    def _check_named_inputs(self) -> Self:
        board, ground = self.atmosphere.board_temperature, self.ground
        boarded = self.log is not None and self.log.channels.temperature is not None
        oriented, trajectory = self.stations.orientation, self.stations.trajectory
        alone = oriented and oriented.of_block and oriented.known_positions != "log"
        events, moves = self.position_events, trajectory and trajectory.moves_stations
        placed = any(not source.times_only for source in events.values())
        of_events = trajectory and trajectory.lever_arm_m == "from_events"
        of_one = trajectory and trajectory.point == "camera"
        refuse(
            (board and not boarded, "board-channel"),
            (ground.height == "block" and not alone, "block-points"),
            (self.control is not None and self.refraction.direction == "apply", "control-applied"),
            (ground.from_distance and not self.observations.columns.distance_m, "distance-column"),
            (oriented is not None and (trajectory or events), "orientation-positions"),
            (moves and of_one and len(self.cameras) > 1, "one-camera"),
            (moves and placed, "positions-twice"),
            (moves and of_events and not events, "lever-from-events"),
            blocks=", ".join(BLOCKS), cameras=", ".join(self.cameras),
        )  # fmt: skip
        return self

    @model_validator(mode="after")
    def _check_camera_names(self) -> Self:
        known = set(self.cameras)
        used = {"mount": set(self.mount)}
        if self.events is not None and self.events.log is not None:
            used["events.log"] = set(self.events.log)
        if self.position_events:
            used["events.positions"] = set(self.position_events)
        if self.events is not None and self.events.csv is not None:
            camera = self.events.csv.camera
            if camera is None and self.events.csv.columns.camera is None and len(known) > 1:
                raise ValueError("events.csv must state which camera: camera or columns.camera")
            used["events.csv.camera"] = {camera} if camera else set()
        for where, names in used.items():
            for name in sorted(names - known):
                near = difflib.get_close_matches(name, known, 1, 0.0)
                raise ValueError(f"{where} names camera {name!r}; perhaps {near[0]!r}?")
        for where, names in used.items():
            for name in sorted(known - names) if where != "events.csv.camera" else ():
                raise ValueError(f"camera {name!r} has no entry under {where}")
        return self
