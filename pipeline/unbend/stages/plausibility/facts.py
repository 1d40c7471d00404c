"""What the rules of plausibility look at."""

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
    """What the rules look at: a mission, its stations, and rows that stand for all observations.

    rows : the sampled observations, (n,) each.
    usual_air : the climatology of place and season.
    takeoff, terrain : None where they are unknown.
    channels, height : those of the log, and the one of the heights; () and None without a log.
    logged_terrain_m : (s,) terrain below each station, as the autopilot logged it.
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
        """The height of the elevation model where the log begins; NaN where unknown."""
        if self.takeoff is None or self.terrain is None:
            return math.nan
        latitude = np.array([self.takeoff.lat_rad])
        longitude = np.array([self.takeoff.lon_rad])
        row, column = self.terrain.nodes(latitude, longitude)
        return float(self.terrain.heights(row, column)[0])

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Refraction between the median heights of camera and ground, beside the standard's."""
        is_known = np.isfinite(self.camera_height_m - self.rows.h_g_m)
        if not is_known.any():
            return ()
        air = self.adjustment
        h_c = float(np.median(self.camera_height_m[is_known]))
        h_g = float(np.median(self.rows.h_g_m[is_known]))
        return effects_on_r(air.profile, air.standard, air.covariance, h_c, h_g)

    @cached_property
    def usual_factor(self) -> float:
        """R in the usual air over that in the standard, between the same heights; 1 if unknown."""
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
        """(n,) the camera of each row; empty for a row without a station."""
        return np.append(self.stations.camera, "")[self.rows.station]

    @cached_property
    def camera_height_m(self) -> Array:
        """(n,) height of the camera above sea level [m]; NaN for a row without a station."""
        return np.append(self.exposures.height_m, np.nan)[self.rows.station]

    @cached_property
    def nadir_angle_rad(self) -> Array:
        """(n,) nadir angle of the measured ray of each row, inside the window.

        NaN for pixels outside the camera, and rows without a station.
        """
        angle = np.full(self.rows.station.size, np.nan)
        for name, camera in self.cameras.items():
            rows = np.flatnonzero((self.camera == name) & (self.rows.station >= 0))
            u, v, _ = camera.rays(self.rows.x_px[rows], self.rows.y_px[rows])
            station = self.rows.station[rows]
            up = self.exposures.rotation[station, :, 2]
            upward = up[:, 0] * u + up[:, 1] * v + up[:, 2]
            length = np.sqrt(u * u + v * v + 1.0)
            cosine = -upward / length
            angle[rows] = np.arccos(np.clip(cosine, -1.0, 1.0))
        return angle

    def axis_deg(self, name: str) -> float:
        """The median nadir angle of a camera's axis [deg]; NaN without stations."""
        stations = (self.stations.camera == name) & self.stations.ok
        cosine = -self.exposures.rotation[stations, 2, 2]
        cosine = np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)
        if cosine.size == 0:
            return math.nan
        angle_rad = np.arccos(cosine)
        return float(np.degrees(np.median(angle_rad)))

    def of_camera(self, name: str, values: Array) -> Array:
        """The finite ones of ``values`` (n,) in the rows of one camera."""
        values = values[self.camera == name]
        return np.asarray(values[np.isfinite(values)])

    def key_of(self, name: str, *, of_numbers: str, of_metric: str) -> str:
        """The key that states a part of a camera, for messages.

        ``of_numbers`` is the key where the mission file gives the interior orientation in numbers
        in pixels, ``of_metric`` under ``metric`` where it gives it in millimetres. A camera of
        COLMAP's models has one key for all parts.
        """
        section = self.mission.cameras[name]
        if section.model is not None and of_numbers == "width_px":
            return f"cameras.{name}, width_px, params or file"
        if section.model is not None:
            return f"cameras.{name}, params or file"
        if section.metric is not None:
            return f"cameras.{name}.metric.{of_metric}"
        return f"cameras.{name}.{of_numbers}"

    def view_deg(self, name: str) -> float:
        """The field of view over the diagonal [deg], as if without distortion."""
        camera = self.cameras[name]
        width = camera.width_px / camera.fx_px
        height = camera.height_px / camera.fy_px
        half_diagonal = math.hypot(width, height) / 2.0
        if is_fisheye(camera):  # equidistant: its corners often lie beyond its circle
            return 2.0 * math.degrees(half_diagonal)
        return 2.0 * math.degrees(math.atan(half_diagonal))
