"""Light through the air: the ray, the window, the camera and the image."""

from pipeline.refraction.camera.brown_conrady import BrownConrady
from pipeline.refraction.camera.camera import Camera, LensInAir
from pipeline.refraction.forward import apply_refraction
from pipeline.refraction.image import Corrections, Exposures, correct_observations
from pipeline.refraction.ray import METHODS, bend, refraction_angle
from pipeline.refraction.ray_table import RayTable, ray_table
from pipeline.refraction.status_codes import STATUS_NAMES
from pipeline.refraction.target_heights import height_at_distance
from pipeline.refraction.uncertainty.budget import (
    StationSigmas,
    WindowRays,
    leading_mode,
    uncertainty_of,
)
from pipeline.refraction.uncertainty.sensitivity import (
    RayWeights,
    Sensitivity,
    ray_weights,
    sensitivity,
)
from pipeline.refraction.uncertainty.sigmas import AirMode, Sigmas, Uncertainty
from pipeline.refraction.window import Cabin, Window

__all__ = ["METHODS", "STATUS_NAMES", "RayTable", "bend", "height_at_distance", "ray_table"]
__all__ += ["RayWeights", "Sensitivity", "ray_weights", "refraction_angle", "sensitivity"]
__all__ += ["BrownConrady", "Cabin", "Camera", "Corrections", "Exposures", "LensInAir", "Window"]
__all__ += ["apply_refraction", "correct_observations"]
__all__ += ["AirMode", "Sigmas", "StationSigmas", "Uncertainty", "WindowRays"]
__all__ += ["leading_mode", "uncertainty_of"]
