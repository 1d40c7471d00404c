"""Light through the air: the ray, the window, the camera and the image."""

from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera, LensInAir
from unbend.refraction.forward import apply_refraction
from unbend.refraction.image import Corrections, Exposures, correct_observations
from unbend.refraction.ray import METHODS, bend, refraction_angle
from unbend.refraction.ray_table import RayTable, ray_table
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.refraction.target_heights import height_at_distance
from unbend.refraction.uncertainty.budget import (
    StationSigmas,
    WindowRays,
    leading_mode,
    uncertainty_of,
)
from unbend.refraction.uncertainty.sensitivity import (
    RayWeights,
    Sensitivity,
    ray_weights,
    sensitivity,
)
from unbend.refraction.uncertainty.sigmas import AirMode, Sigmas, Uncertainty
from unbend.refraction.window import Cabin, Window

__all__ = ["METHODS", "STATUS_NAMES", "RayTable", "bend", "height_at_distance", "ray_table"]
__all__ += ["RayWeights", "Sensitivity", "ray_weights", "refraction_angle", "sensitivity"]
__all__ += ["BrownConrady", "Cabin", "Camera", "Corrections", "Exposures", "LensInAir", "Window"]
__all__ += ["apply_refraction", "correct_observations"]
__all__ += ["AirMode", "Sigmas", "StationSigmas", "Uncertainty", "WindowRays"]
__all__ += ["leading_mode", "uncertainty_of"]
