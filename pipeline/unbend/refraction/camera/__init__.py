"""Cameras: pixels to rays and back. One module for each distortion model.

A model is a module with ``Parameters`` (a named tuple of numbers), ``MODELS`` (names of camera
models in mission files), ``distort``, ``slopes`` and ``largest_radius`` like those of
`brown_conrady`, and a line in `DISTORTION_MODELS`. ``distort`` and ``slopes`` take numpy columns
and are also compiled: arithmetic and `math` only. The type of a camera's parameters names its
model, so that each kernel is compiled for each model in use.
"""

from types import ModuleType

from unbend.refraction.camera import brown_conrady, general_frame, opencv_fisheye

DISTORTION_MODELS: dict[str, ModuleType] = {
    "brown_conrady": brown_conrady,
    "general_frame": general_frame,
    "opencv_fisheye": opencv_fisheye,
}
"""Distortion models by name."""


def model_of(parameters: type) -> ModuleType:
    """The module of the model whose parameters have a type.

    >>> model_of(brown_conrady.BrownConrady).__name__.rpartition(".")[2]
    'brown_conrady'
    """
    return next(m for m in DISTORTION_MODELS.values() if m.Parameters is parameters)
