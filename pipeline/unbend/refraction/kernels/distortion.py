"""The distortion of lenses inside kernels: the functions of the camera's lens model.

Kernels call `distort` and `slopes`. The type of the parameters names the model: for each type numba
asks the functions with @overload what to compile in the place of the call.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from numba.extending import overload

from unbend.refraction.camera import model_of
from unbend.refraction.kernels.jit import jit


def distort(u: Any, v: Any, parameters: Any) -> Any:
    """Distorted image coordinates (u_d, v_d) of the ideal ones (u, v), in compiled code only."""
    raise NotImplementedError("only kernels call this")


def slopes(u: Any, v: Any, parameters: Any) -> Any:
    """Derivatives du_d/du, du_d/dv = dv_d/du and dv_d/dv of `distort`, in compiled code only."""
    raise NotImplementedError("only kernels call this")


@overload(distort)
def _distort_of_model(u, v, parameters):  # type: ignore[no-untyped-def]
    """The function that numba compiles in the place of `distort`.

    ``parameters`` is here the numba type of the lens parameters, which names the model.
    """
    distort_by_model = _compiled(model_of(parameters.instance_class).distort)
    return lambda u, v, parameters: distort_by_model(u, v, parameters)


@overload(slopes)
def _slopes_of_model(u, v, parameters):  # type: ignore[no-untyped-def]
    """The function that numba compiles in the place of `slopes`.

    ``parameters`` is here the numba type of the lens parameters, which names the model.
    """
    slopes_by_model = _compiled(model_of(parameters.instance_class).slopes)
    return lambda u, v, parameters: slopes_by_model(u, v, parameters)


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The compiled form of a lens model's function, made once for each function."""
    return jit(function)
