"""The facts of a mission that the rules of plausibility look at."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unbend.atmosphere.estimate.adjusted_profile import Adjustment
from unbend.atmosphere.profile import Profile
from unbend.config import Mission
from unbend.flight.channels import Channel
from unbend.flight.ground_times import Takeoff
from unbend.flight.stations import Stations
from unbend.refraction.calibration import is_fisheye
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import Effect, effects_on_r
from unbend.refraction.image import Exposures
from unbend.stages.statistics import SampledRows
from unbend.tables.geodata.elevation import ElevationModel
from unbend.units import Array, Names


@dataclass(frozen=True, eq=False)
class Facts:
    """A mission, its stations, its air, and a sample of its observations.

    stations, exposures : (s,) each.
    rows : the sampled observations, (n,) each; they represent all observations.
    usual_air : the climatology of place and season.
    takeoff, terrain : the start of the log and the elevation model; None if there is none.
    logged_terrain_m : (s,) height of the terrain below each station, as the autopilot logged it.
    channels : all channels of the log; () without a log.
    height : the channel with the heights of the flight; None without a log.
    """

    mission: Mission
    stations: Stations
    exposures: Exposures
    cameras: Mapping[str, Camera]
    rows: SampledRows
    adjustment: Adjustment
    usual_air: Profile
    takeoff: Takeoff | None
    logged_terrain_m: Array
    terrain: ElevationModel | None
    channels: tuple[Channel, ...]
    height: Channel | None

    @cached_property
    def model_at_takeoff_m(self) -> float:
        """Height of the elevation model where the log begins [m above sea level]; NaN if none."""
        if self.takeoff is None or self.terrain is None:
            return math.nan
        latitude = np.array([self.takeoff.lat_rad])
        longitude = np.array([self.takeoff.lon_rad])
        row, column = self.terrain.nodes(latitude, longitude)
        return float(self.terrain.heights(row, column)[0])

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """R of a ray between the median heights of camera and ground, at some nadir angles.

        Each has R in the estimated air and in the standard atmosphere. Empty if heights are unknown
        or the ground is not below the camera.
        """
        is_known = np.isfinite(self.camera_height_m - self.rows.h_g_m)
        if not is_known.any():
            return ()
        air = self.adjustment
        h_c = float(np.median(self.camera_height_m[is_known]))
        h_g = float(np.median(self.rows.h_g_m[is_known]))
        return effects_on_r(air.profile, air.standard, air.covariance, h_c, h_g)

    @cached_property
    def usual_factor(self) -> float:
        """R in the usual air over R in the standard, for the first of `effects`; 1 if unknown."""
        if not self.effects:
            return 1.0
        effect = self.effects[0]
        usual = effects_on_r(
            self.usual_air,
            self.adjustment.standard,
            None,
            effect.h_c_m,
            effect.h_g_m,
        )
        if not usual:
            return 1.0
        return usual[0].factor

    @cached_property
    def camera(self) -> Names:
        """(n,) the name of the camera of each row; "" for a row without a station."""
        # The last element is for rows without a station, whose number is -1.
        return np.append(self.stations.camera, "")[self.rows.station]

    @cached_property
    def camera_height_m(self) -> Array:
        """(n,) height of the camera above sea level [m]; NaN for a row without a station."""
        # The last element is for rows without a station, whose number is -1.
        return np.append(self.exposures.height_m, np.nan)[self.rows.station]

    @cached_property
    def nadir_angle_rad(self) -> Array:
        """(n,) nadir angle of the measured ray of each row [rad], on the camera's side of a window.

        NaN for pixels outside the camera, and for rows without a station.
        """
        angle = np.full(self.rows.station.size, np.nan)
        for name, camera in self.cameras.items():
            rows = np.flatnonzero((self.camera == name) & (self.rows.station >= 0))
            u, v, _ = camera.rays(self.rows.x_px[rows], self.rows.y_px[rows])
            station = self.rows.station[rows]
            up = self.exposures.rotation[station, :, 2]  # the zenith in camera coordinates
            upward = up[:, 0] * u + up[:, 1] * v + up[:, 2]
            length = np.sqrt(u * u + v * v + 1.0)
            cosine = -upward / length
            angle[rows] = np.arccos(np.clip(cosine, -1.0, 1.0))
        return angle

    def axis_deg(self, name: str) -> float:
        """The median nadir angle of a camera's axis [deg]; NaN without stations."""
        is_usable = (self.stations.camera == name) & self.stations.ok
        cosine = -self.exposures.rotation[is_usable, 2, 2]
        cosine = np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)
        if cosine.size == 0:
            return math.nan
        angle_rad = np.arccos(cosine)
        return float(np.degrees(np.median(angle_rad)))

    def of_camera(self, name: str, values: Array) -> Array:
        """Of ``values`` (n,) those that are finite and in rows of the camera ``name``."""
        values = values[self.camera == name]
        return np.asarray(values[np.isfinite(values)])

    def key_of(self, name: str, *, pixel_key: str, metric_key: str) -> str:
        """The key of the mission file that states a part of camera ``name``, for messages.

        It is ``pixel_key`` where the mission file gives the interior orientation in pixels, and
        ``metric_key`` (under metric) where it does so in millimetres. A camera of a COLMAP model
        has one key for all parts.
        """
        section = self.mission.cameras[name]
        if section.model is not None and pixel_key == "width_px":
            return f"cameras.{name}, width_px, params or file"
        if section.model is not None:
            return f"cameras.{name}, params or file"
        if section.metric is not None:
            return f"cameras.{name}.metric.{metric_key}"
        return f"cameras.{name}.{pixel_key}"

    def view_deg(self, name: str) -> float:
        """The field of view of a camera over the diagonal [deg], as if without distortion."""
        camera = self.cameras[name]
        width = camera.width_px / camera.fx_px
        height = camera.height_px / camera.fy_px
        half_diagonal = math.hypot(width, height) / 2.0  # in principal distances
        if is_fisheye(camera):  # equidistant: the radius is the angle, not its tangent
            return 2.0 * math.degrees(half_diagonal)
        return 2.0 * math.degrees(math.atan(half_diagonal))
