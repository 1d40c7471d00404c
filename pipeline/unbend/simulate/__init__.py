"""A survey flight with known truth: the independent check on everything else.

Nothing here comes from `unbend.atmosphere` or `unbend.refraction`: the air, the rays and the
cameras are written again from the sources, with slow and general methods.
"""

from unbend.simulate.mission import Simulated, SimulationOptions, mission_yaml, simulate
from unbend.simulate.optics import shoot
from unbend.simulate.true_air import TrueAir, edlen_index, true_air

__all__ = [
    "Simulated",
    "SimulationOptions",
    "TrueAir",
    "edlen_index",
    "mission_yaml",
    "shoot",
    "simulate",
    "true_air",
]
