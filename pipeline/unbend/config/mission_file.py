"""A mission file as a model with strict types and no unknown keys."""

from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, field_validator, model_validator

from unbend.atmosphere.refractive_index import INDEX_OF_ONE_LIGHT
from unbend.config.atmosphere import AtmosphereSection
from unbend.config.blocks import with_block
from unbend.config.camera_names import (
    cameras_by_section,
    check_camera_names,
    check_table_of_exposures,
)
from unbend.config.cameras import CameraSection
from unbend.config.event_sources import EventsSection, PositionEvents
from unbend.config.ground import ControlSection, GroundSection
from unbend.config.image_frames import image_frame_of
from unbend.config.logs import USUAL_MAX_GAP_S, LogSection
from unbend.config.mission_section import MissionSection
from unbend.config.mounts import MountSection
from unbend.config.observation_table import ObservationsSection
from unbend.config.section import (
    FolderOfResults,
    Section,
    SectionError,
    is_block,
    one_of,
)
from unbend.config.station_sources import StationsSection
from unbend.flight.mount import Mount
from unbend.refraction import METHODS, Camera, Window
from unbend.refraction.lens_air import AnyLens
from unbend.tables.imports.blocks import BLOCKS


class RefractionSection(Section):
    """How rays are traced."""

    direction: Literal["remove", "apply"] = Field(
        "remove",
        description=(
            "remove: from measured observations to the straight chord; apply: from ideal "
            "observations to the coordinates that a camera in this air would measure, for planning"
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

    path: FolderOfResults = Field(
        description="folder of this mission's results, or a URL of object storage",
        examples=["results/survey-2026-05"],
    )
    batch_rows: int = Field(
        250_000,
        ge=1_000,
        le=2_000_000,
        description="largest number of rows that are corrected together, and written as one file",
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
        description=(
            "why the inputs are right although they contradict the check, in three characters or "
            "more; the report contains this reason"
        ),
        examples=["flown from a pass 1200 m above the valley"],
    )


class Mission(Section):
    """A mission file as it was understood; its relative paths are relative to ``_folder``."""

    _folder: Path = PrivateAttr(default=Path())  # of the file, once it is read from one

    mission: MissionSection = Field(
        description="name of the mission, and facts that its log does not contain",
    )
    log: LogSection | None = Field(
        None,
        description=(
            "the flight log. May be left out if stations.orientation, events.positions with "
            "attitudes, or stations.trajectory with attitudes and events with times, give stations"
        ),
    )
    observations: ObservationsSection = Field(
        description="the table of image measurements",
    )
    cameras: dict[str, CameraSection] = Field(
        min_length=1,
        description="interior orientation of each camera; the names of the cameras are free",
    )
    mount: dict[str, MountSection] = Field(
        {},
        description=(
            "how each camera is mounted in the aircraft, by the camera's name; with "
            "stations.orientation only if a camera is not in its default position"
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
        description=("stations that do not come from the log, and which stations may be used"),
    )
    ground: GroundSection = Field(
        description="heights of the observed points. There is no default",
    )
    atmosphere: AtmosphereSection = Field(
        AtmosphereSection(),
        description=(
            "the air: the sources of its estimate, and the standard atmosphere that it is compared "
            "with"
        ),
    )
    refraction: RefractionSection = Field(
        RefractionSection(),
        description="how rays are traced",
    )
    control: ControlSection | None = Field(
        None,
        description=(
            "a path, or {path, columns, crs, reference}: control points; the report compares them "
            "before and after the correction; they change no corrected point"
        ),
        examples=["control.csv"],
    )
    output: OutputSection = Field(
        description="where the results go",
    )
    accept: list[AcceptedFinding] = Field(
        [],
        description=(
            "findings that are not mistakes in this mission: each with its code and the reason. "
            "Losses cannot be accepted"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _mounts_at_rest(cls, values: object) -> object:
        """With ``stations.orientation``, a camera without a mount gets the default mount."""
        if not isinstance(values, dict):
            return values
        cameras = values.get("cameras", {})
        mount = values.get("mount", {})
        stations = values.get("stations", {})
        if not all(isinstance(section, dict) for section in (cameras, mount, stations)):
            return values
        if stations.get("orientation") is None:
            return values
        at_rest: dict[str, Any] = {name: {} for name in cameras}
        return values | {"mount": at_rest | mount}

    @model_validator(mode="before")
    @classmethod
    def _from_block(cls, values: object) -> object:
        """Cameras and orientations that are not stated are those of the block of observations.

        Pydantic runs the last validator of mode "before" first: that is this one.
        """
        return with_block(values) if isinstance(values, dict) else values

    @field_validator("control", mode="before")
    @classmethod
    def _path_of_control(cls, value: object) -> object:
        return {"path": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check_sources_of_stations(self) -> Self:
        """The position and the attitude of each image are given.

        * Without a log, they come from an orientation, a trajectory, or exposures with positions. A
          trajectory then gives all that the exposures lack; ``replaces`` may not leave that out.
        * Without an orientation, events have the times, and a mount turns the attitude of the
          aircraft into that of the camera.
        """
        orientation = self.stations.orientation
        trajectory = self.stations.trajectory
        if self.log is None and not (orientation or trajectory or self.position_events):
            raise SectionError(
                "log is missing: the flight log, unless stations.orientation, stations.trajectory "
                "or events.positions gives position and attitude"
            )
        if self.log is None and trajectory is not None and trajectory.replaces is not None:
            needed = {"position", "height", "attitude"}
            if self._has_placed_events:
                needed = {"attitude"}  # position and height are those of the exposures
            if not needed <= set(trajectory.replaces):
                raise SectionError(
                    "there is no log, so all values of the trajectory are used: remove the key "
                    "stations.trajectory.replaces",
                    at=("stations", "trajectory", "replaces"),
                )
        if orientation is None and self.events is None:
            raise SectionError("events is missing, and there is no stations.orientation")
        if orientation is None and not self.mount:
            raise SectionError("mount is missing, and there is no stations.orientation")
        return self

    @model_validator(mode="after")
    def _check_without_log(self) -> Self:
        """Without a log, no key takes anything from it."""
        if self.log is not None:
            return self
        if self.events is not None and self.events.log is not None:
            raise SectionError(
                "events.log takes the exposures from a log, and there is no log",
                at=("events", "log"),
            )
        for name, mount in self.mount.items():
            if mount.attitude is not None:
                raise SectionError(
                    f"mount.{name}.attitude names a channel, and there is no log",
                    at=("mount", name, "attitude"),
                )
        for name, camera in self.cameras.items():
            if camera.needs_cabin_from_log:
                raise SectionError(
                    f"cameras.{name}.window.cabin takes the cabin's air from a log, and there is "
                    "no log",
                    at=("cameras", name, "window", "cabin"),
                )
        return self

    @model_validator(mode="after")
    def _check_cameras_of_files(self) -> Self:
        orientation = self.stations.orientation
        of_block = is_block(self.observations.format) or (orientation and orientation.of_block)
        for name, camera in self.cameras.items():
            if camera.camera is not None and not camera.file and not of_block:
                raise SectionError(
                    f"cameras.{name}.camera needs file, or a block",
                    at=("cameras", name, "camera"),
                )
        return self

    @model_validator(mode="after")
    def _check_orientation(self) -> Self:
        """A camera or a log that ``stations.orientation`` names is in the mission file."""
        orientation = self.stations.orientation
        if orientation is None:
            return self
        if orientation.known_positions == "log" and (self.log is None or self.events is None):
            raise SectionError(
                "stations.orientation.known_positions: log needs log and events",
                at=("stations", "orientation", "known_positions"),
            )
        camera = orientation.camera
        if camera is not None and camera not in self.cameras:
            raise SectionError(
                f"stations.orientation names camera {camera!r}, which is not under cameras",
                at=("stations", "orientation", "camera"),
            )
        return self

    @cached_property
    def interior_orientations(self) -> dict[str, Camera]:
        """The interior orientation of each camera, in COLMAP's pixels.

        That of a camera file is known once the file has been read (`CameraSection.with_file`).
        """
        origin = self.observations.pixel_origin
        return {
            name: camera.interior_orientation_by(origin) for name, camera in self.cameras.items()
        }

    @cached_property
    def windows(self) -> dict[str, Window]:
        """The window, or the opening (a window without glass), of each camera that has one."""
        windows = {}
        for name, camera in self.cameras.items():
            pane = camera.pane
            if pane is not None:
                windows[name] = pane
        return windows

    @cached_property
    def lenses(self) -> dict[str, AnyLens]:
        """How the principal distance changes with the air, for cameras that state it."""
        lenses = {}
        for name, camera in self.cameras.items():
            if camera.lens is not None:
                lenses[name] = camera.lens
        return lenses

    @cached_property
    def wavelengths_m(self) -> dict[str, float]:
        """The wavelength in vacuum [m] of each camera that states its own."""
        wavelengths = {}
        for name, camera in self.cameras.items():
            if camera.wavelength_m is not None:
                wavelengths[name] = camera.wavelength_m
        return wavelengths

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """How each camera is mounted in the aircraft."""
        return {name: section.mount for name, section in self.mount.items()}

    @property
    def position_events(self) -> dict[str, PositionEvents]:
        """Files of exposures with their positions, by camera."""
        if self.events is None or self.events.positions is None:
            return {}
        return self.events.positions

    @property
    def _has_placed_events(self) -> bool:
        """Whether a file of exposures gives positions, and not only times."""
        return any(not source.times_only for source in self.position_events.values())

    def attitude_key(self, camera: str) -> str:
        """The key that states the angles of a camera, for messages.

        It is not the mount if ``stations.orientation`` has the angles of the camera itself.
        """
        orientation = self.stations.orientation
        if orientation is not None and orientation.angles != "roll_pitch_yaw":
            return "stations.orientation"
        return f"mount.{camera}"

    @property
    def max_gap_s(self) -> float:
        """The longest interval [s] between samples of the log that does not count as a gap."""
        return USUAL_MAX_GAP_S if self.log is None else self.log.max_gap_s

    @model_validator(mode="after")
    def _check_window_directions(self) -> Self:
        """The normal of a window points forward in the camera that looks through it.

        Checked for cameras that are fixed in the aircraft, with a window in the aircraft's frame.
        """
        if self.log is not None and self.log.channels.aircraft_attitude is not None:
            return self  # a stabilised camera turns behind the window: only the log knows how
        for name, window in self.windows.items():
            if window.frame == "camera" or name not in self.mount:
                continue
            has_gimbal = self.mount[name].attitude is not None
            if has_gimbal:  # the camera turns behind the window
                continue
            x, y, z = self.mounts[name].camera_from_body @ np.array(window.normal)
            if z <= 0.0:
                raise SectionError(
                    f"the {window.section} of camera {name!r} has a normal away from the viewing "
                    f"direction: with this mount it is [{x:.3f}, {y:.3f}, {z:.3f}] in the camera "
                    "frame, where forward is positive",
                    at=("cameras", name, window.section, "normal"),
                )
        return self

    @model_validator(mode="after")
    def _check_board_temperature(self) -> Self:
        """``atmosphere.board_temperature`` needs the channel of the board in ``log.channels``."""
        names_channel = self.log is not None and self.log.channels.temperature is not None
        if self.atmosphere.board_temperature and not names_channel:
            raise SectionError(
                "atmosphere.board_temperature needs log.channels.temperature, the channel of the "
                "board, as BARO[0]",
                at=("atmosphere", "board_temperature"),
            )
        return self

    @model_validator(mode="after")
    def _check_wavelengths(self) -> Self:
        """A camera has a wavelength of its own only with a formula that knows wavelengths."""
        if self.wavelengths_m and self.atmosphere.index in INDEX_OF_ONE_LIGHT:
            name = next(iter(self.wavelengths_m))
            raise SectionError(
                f"cameras.{name}.wavelength_m has no effect with atmosphere.index: "
                f"{self.atmosphere.index}, which is only for 0.589 um: use ciddor",
                at=("cameras", name, "wavelength_m"),
            )
        return self

    @model_validator(mode="after")
    def _check_heights_of_block(self) -> Self:
        """``ground.height: block`` needs a block in ``stations.orientation`` that has points.

        The points are placed before the stations are built, so the frame of the block must be known
        without the positions of a log.
        """
        orientation = self.stations.orientation
        has_placed_points = (
            orientation is not None
            and orientation.of_block
            and orientation.known_positions != "log"
        )
        if self.ground.height == "block" and not has_placed_points:
            raise SectionError(
                "ground.height: block takes the points of stations.orientation: give it a format "
                f"of {', '.join(BLOCKS)}, and a frame that does not need the log",
                at=("ground", "height"),
            )
        return self

    @model_validator(mode="after")
    def _check_control(self) -> Self:
        """Control points need ``refraction.direction: remove``."""
        if self.control is not None and self.refraction.direction == "apply":
            raise SectionError(
                "control compares before and after the removal of refraction: leave it out with "
                "refraction.direction: apply",
                at=("control",),
            )
        return self

    @model_validator(mode="after")
    def _check_slant_ranges(self) -> Self:
        """``ground.height: from_distance`` needs the name of the column of slant ranges."""
        if self.ground.from_distance and not self.observations.columns.distance_m:
            raise SectionError(
                "ground.height: from_distance needs observations.columns.distance_m, the name of "
                "the column of slant ranges",
                at=("ground", "height"),
            )
        return self

    @model_validator(mode="after")
    def _check_positions_once(self) -> Self:
        """Positions come from one source, and this source fits the cameras and events."""
        trajectory = self.stations.trajectory
        position_events = self.position_events
        if self.stations.orientation is not None and (trajectory is not None or position_events):
            raise SectionError(
                "stations.orientation has position and attitude of every image: leave "
                "stations.trajectory and events.positions out",
                at=("stations", "orientation"),
            )
        if trajectory is None or not trajectory.moves_stations:
            return self
        if trajectory.point == "camera" and len(self.cameras) > 1:
            raise SectionError(
                "stations.trajectory.point: camera is possible for one camera, not for "
                f"{', '.join(self.cameras)}",
                at=("stations", "trajectory", "point"),
            )
        if self._has_placed_events:
            raise SectionError(
                "stations.trajectory and events.positions both give positions; "
                "events.positions.<camera>.times_only: true leaves them to the trajectory",
                at=("events", "positions"),
            )
        if trajectory.lever_arm_m == "from_events" and not position_events:
            raise SectionError(
                "stations.trajectory.lever_arm_m: from_events needs events.positions",
                at=("stations", "trajectory", "lever_arm_m"),
            )
        return self

    @model_validator(mode="after")
    def _check_camera_names(self) -> Self:
        """All sections name the same cameras; these have one frame if observations are in mm."""
        image_frame_of(self.observations, self.cameras)  # refuses cameras of several frames
        check_table_of_exposures(self.cameras, self.events)
        check_camera_names(self.cameras, cameras_by_section(self.mount, self.events))
        return self
