from collections.abc import Sequence
from typing import Any, Literal, Optional, Union

import numpy as np
from numpy.typing import NDArray

from . import Renderer

Renderers = Union[Renderer, Sequence[Renderer]]

class Scenes:
    shape: tuple[int, int, int]
    volume: tuple[int, int, int]
    def __init__(self, renderers: Renderers) -> None: ...
    def check(self, extinction: Any, effective_radius: Optional[Any] = None) -> None: ...
    def __call__(
        self, method: Literal["images", "vjp", "jvp"], *arrays: NDArray[Any]
    ) -> list[NDArray[np.float32]]: ...
