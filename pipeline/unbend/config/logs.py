"""The sections of a mission file on the flight log and its channels."""

from typing import Literal

from pydantic import (
    Field,
)

from unbend.config.local_frames import LocalOrigin
from unbend.config.section import (
    PathText,
    Section,
)

USUAL_MAX_GAP_S = 2.0  # autopilots log attitude and position ten times a second and more


class NamedChannel(Section):
    """A channel by its name, with its true unit."""

    name: str = Field(
        description="name of the channel, as `unbend inspect` prints it",
        examples=["BARO[0]"],
    )
    unit: Literal["Pa", "hPa", "kPa", "K", "degC", "fraction", "percent", "m/s"] | None = Field(
        None,
        description="true unit of the channel's values, if the log states another unit",
        examples=["hPa"],
    )


class ChannelsSection(Section):
    """The channel of each role; names as ``unbend inspect`` prints them.

    null: no channel is used for the role. Without a key the program chooses.
    """

    position: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of latitude and longitude; a name as `unbend inspect` prints it. By default "
            "the best, of equal ones the first"
        ),
        examples=["GPS[0]"],
    )
    height: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the heights of the GNSS receiver, at which the air was sampled; a name as "
            "`unbend inspect` prints it. By default the best receiver, of equal ones the first"
        ),
        examples=["GPS[0]"],
    )
    attitude: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the attitude that the cameras are mounted to: of the aircraft, or of a "
            "stabilised mount; a name as `unbend inspect` prints it"
        ),
        examples=["ATT"],
    )
    aircraft_attitude: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the attitude of the aircraft itself, if attitude is the attitude of a "
            "stabilised mount; only needed for window.frame: body"
        ),
        examples=["ATT"],
    )
    pressure: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the static pressure outside; a name as `unbend inspect` prints it, or "
            "{name, unit} where the log's unit is wrong. By default the first barometer that is "
            "not in a closed compartment and does not end before the flight"
        ),
        examples=["BARO[0]"],
    )
    temperature: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the temperature of the air outside; a name as `unbend inspect` prints it, "
            "or {name, unit} where the log's unit is wrong. By default the only one of its kind; "
            "if the air behind a window is that of the log, only one that cannot be in the cabin"
        ),
        examples=["HYGR[0]"],
    )
    humidity: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the relative humidity outside; a name as `unbend inspect` prints it, or "
            "{name, unit} where the log's unit is wrong. By default the only one of its kind; if "
            "the air behind a window is that of the log, only one that cannot be in the cabin"
        ),
        examples=["HYGR[0]"],
    )
    airspeed: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the airspeed, which heats a thermometer; a name as `unbend inspect` prints "
            "it"
        ),
        examples=["ARSP[0]"],
    )
    cabin_pressure: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the pressure in the compartment of the camera; a name as `unbend inspect` "
            "prints it, or {name, unit} where the log's unit is wrong. By default, if the air "
            "behind a window is that of the log, the only barometer that does not follow the "
            "height"
        ),
        examples=["BARO[1]"],
    )
    cabin_temperature: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the temperature in the compartment of the camera; a name as `unbend "
            "inspect` prints it, or {name, unit} where the log's unit is wrong. By default, if the "
            "air behind a window is that of the log, the only one of its kind that cannot be "
            "outside"
        ),
        examples=["HYGR[1]"],
    )
    cabin_humidity: str | NamedChannel | None = Field(
        None,
        description=(
            "channel of the relative humidity in the compartment of the camera; a name as `unbend "
            "inspect` prints it, or {name, unit} where the log's unit is wrong. By default, if the "
            "air behind a window is that of the log, the only one of its kind that cannot be "
            "outside"
        ),
        examples=["HYGR[1]"],
    )

    def named(self) -> dict[str, NamedChannel]:
        """The named channels by role, without roles that are absent or null."""
        channels = {}
        for role in type(self).model_fields:
            value = getattr(self, role)
            if isinstance(value, str):
                value = NamedChannel(name=value)
            if value is not None:
                channels[role] = value
        return channels

    @property
    def unused_roles(self) -> tuple[str, ...]:
        """The roles that no channel may have: those that are stated as null."""
        return tuple(role for role in self.model_fields_set if getattr(self, role) is None)


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
        description="the channel of each role; only the roles that are not detected automatically",
    )
    max_gap_s: float = Field(
        USUAL_MAX_GAP_S,
        gt=0,
        le=60,
        description=(
            "longest allowed interval between two positions, heights or attitudes: an exposure in "
            "a longer interval is in a gap (in_gap)"
        ),
        examples=[2.0],
        json_schema_extra={"unit": "s"},
    )
    local_origin: LocalOrigin | None = Field(
        None,
        description="place of the origin of local positions (motion capture)",
    )
