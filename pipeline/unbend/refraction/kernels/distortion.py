"""The distortion of lenses inside kernels: the functions of the model that the camera has.

Kernels call `distort` and `slopes`. The type of the parameters names the model: numba asks the
functions with @overload what to compile for a type.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from numba.extending import overload

from unbend.refraction.camera import model_of
from unbend.refraction.kernels.jit import jit


def distort(u: Any, v: Any, parameters: Any) -> Any:
    """Distorted image coordinates of ideal ones."""
    raise NotImplementedError("only kernels call this")


def slopes(u: Any, v: Any, parameters: Any) -> Any:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`."""
    raise NotImplementedError("only kernels call this")


@overload(distort)
def _distort_of_model(u, v, parameters):  # type: ignore[no-untyped-def]
    """What numba compiles in the place of `distort` for a type of parameters."""
    of_model = _compiled(model_of(parameters.instance_class).distort)
    return lambda u, v, parameters: of_model(u, v, parameters)


@overload(slopes)
def _slopes_of_model(u, v, parameters):  # type: ignore[no-untyped-def]
    """What numba compiles in the place of `slopes` for a type of parameters."""
    of_model = _compiled(model_of(parameters.instance_class).slopes)
    return lambda u, v, parameters: of_model(u, v, parameters)


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The one compiled form of a model's function."""
    return jit(function)
