from collections.abc import Sequence
from typing import Any, Literal, Union

import numpy as np
from numpy.typing import NDArray

from . import Renderer

Renderers = Union[Renderer, Sequence[Renderer]]

class Scenes:
    shape: tuple[int, int, int]
    volume: tuple[int, int, int]
    def __init__(self, renderers: Renderers) -> None: ...
    def __call__(
        self, method: Literal["images", "vjp", "jvp"], *arrays: NDArray[Any]
    ) -> NDArray[np.float32]: ...
