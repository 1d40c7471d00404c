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
    """How a camera is mounted in the aircraft (body frame: x forward, y right, z down).

    With all angles zero it looks straight down, the top of the image towards the nose; yaw, pitch
    and roll then turn it about the body's axes, in that order (intrinsic z-y-x). These angles
    (boresight) are composed with the attitude of the aircraft and the angles of a gimbal, if a
    gimbal is the attitude: v_ned = R(aircraft) R(gimbal) R(mount) v_camera. For a gimbal that is
    level to the horizon, only the yaw of the aircraft is used. For a gimbal with a yaw from north,
    the attitude of the aircraft is not used.
    """

    attitude: str | None = Field(
        None,
        description=(
            "channel of the gimbal or head of this camera, if each camera has one; by default "
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
            "projection centre minus the point of the positions in the log (horizontally the point "
            "of the filter, in height the GNSS antenna), in the body frame"
        ),
        examples=[[0.2, 0.28, 0.55]],
        json_schema_extra={"unit": "m"},
    )
    sigma_tilt_deg: float | None = Field(
        None,
        ge=0,
        le=45,
        description=(
            "standard deviation of the attitude about each of the two level axes of the body, "
            "instead of the one of the log; the part from the time between samples is added to it"
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
            raise SectionError("sigma_yaw_deg also needs sigma_tilt_deg")
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
