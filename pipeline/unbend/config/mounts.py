"""The section of a mission file on how a camera sits in the aircraft."""

from functools import cached_property
from typing import Self

from pydantic import (
    Field,
    model_validator,
)

from unbend.config.section import (
    LeverArm,
    Section,
    SectionError,
)
from unbend.flight.mount import Mount
from unbend.units import DEGREE

MOST_TURN_DEG = 720.0  # two turns: an angle may be the sum of several; more is a typing mistake


class MountSection(Section):
    """How a camera sits in the aircraft (body frame: x forward, y right, z down).

    With all angles zero it looks straight down, the top of the image towards the nose; yaw, pitch
    and roll then turn it about the body's axes, in that order (intrinsic z-y-x). Composed are the
    attitude of the aircraft, the angles of a gimbal that plays the attitude, and these (boresight):
    v_ned = R(aircraft) R(gimbal) R(mount) v_camera, where a gimbal that is level to the horizon
    takes of the aircraft its yaw alone, and one whose yaw counts from north takes nothing."""

    attitude: str | None = Field(
        None,
        description=(
            "channel of the camera's own gimbal or head, where each camera has one; by default "
            "log.channels.attitude"
        ),
        examples=["MNT[0]"],
    )
    roll_deg: float = Field(
        0.0,
        ge=-MOST_TURN_DEG,
        le=MOST_TURN_DEG,
        description=(
            "turn about the body's forward axis: positive lowers the right wing, and a camera that "
            "looked down looks to the left; -45 looks to the right"
        ),
        examples=[-45.0],
        json_schema_extra={"unit": "deg"},
    )
    pitch_deg: float = Field(
        0.0,
        ge=-MOST_TURN_DEG,
        le=MOST_TURN_DEG,
        description=(
            "turn about the body's right axis: positive raises the nose, and a camera that looked "
            "down looks forward"
        ),
        examples=[0.0],
        json_schema_extra={"unit": "deg"},
    )
    yaw_deg: float = Field(
        0.0,
        ge=-MOST_TURN_DEG,
        le=MOST_TURN_DEG,
        description="turn about the body's vertical axis, clockwise seen from above",
        examples=[0.0],
        json_schema_extra={"unit": "deg"},
    )
    lever_arm_m: LeverArm = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description=(
            "projection centre minus the point whose position the log gives (horizontally the "
            "filter's, in height the GNSS antenna's), in the body frame"
        ),
        examples=[[0.2, 0.28, 0.55]],
        json_schema_extra={"unit": "m"},
    )
    sigma_tilt_deg: float | None = Field(
        None,
        ge=0,
        le=45,
        description=(
            "standard deviation of the attitude about each of the body's two level axes, in place "
            "of what the log gives; what the time between samples adds is added to it"
        ),
        examples=[0.1],
        json_schema_extra={"unit": "deg"},
    )
    sigma_yaw_deg: float | None = Field(
        None,
        ge=0,
        le=180,
        description=(
            "standard deviation of the attitude about the body's vertical axis; by default "
            "sigma_tilt_deg"
        ),
        examples=[0.4],
        json_schema_extra={"unit": "deg"},
    )

    @model_validator(mode="after")
    def _check_sigmas(self) -> Self:
        if self.sigma_yaw_deg is not None and self.sigma_tilt_deg is None:
            raise SectionError("sigma_yaw_deg needs sigma_tilt_deg beside it")
        return self

    @cached_property
    def mount(self) -> Mount:
        """The mount, in radians."""
        forward, right, down = self.lever_arm_m
        sigma_yaw_deg = self.sigma_yaw_deg  # by default that of the tilt
        if sigma_yaw_deg is None:
            sigma_yaw_deg = self.sigma_tilt_deg
        return Mount(
            roll_rad=self.roll_deg * DEGREE,
            pitch_rad=self.pitch_deg * DEGREE,
            yaw_rad=self.yaw_deg * DEGREE,
            lever_arm_m=(forward, right, down),
            sigma_tilt_rad=_in_radians(self.sigma_tilt_deg),
            sigma_yaw_rad=_in_radians(sigma_yaw_deg),
        )


def _in_radians(angle_deg: float | None) -> float | None:
    """An angle in radians; None without one."""
    return None if angle_deg is None else angle_deg * DEGREE
