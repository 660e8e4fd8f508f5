"""Images of batches of scenes."""

import copy
import math
from collections.abc import Sequence
from typing import Union

import numpy as np

from ._deepct import Renderer, side_by_side

Renderers = Union[Renderer, Sequence[Renderer]]


class Scenes:
    """Renderers of the scenes of a batch, which compute at the same time.

    The arrays have any number of axes before those of a volume or of the images. A single renderer is
    copied for as many scenes as there are. With several renderers, the last of these axes has one element
    for each of them. The scene at a place of a batch has the same renderer in every call, which starts from
    its last solution.
    """

    def __init__(self, renderers):
        self._first = [renderers] if isinstance(renderers, Renderer) else list(renderers)
        if not self._first or not all(isinstance(each, Renderer) for each in self._first):
            raise TypeError("renderers must be a Renderer or a sequence of them")
        self._is_single = isinstance(renderers, Renderer)
        self.shape, self.volume = self._first[0].shape, self._first[0].grid.shape
        for each in self._first:
            if (each.shape, each.grid.shape) != (self.shape, self.volume):
                raise ValueError(
                    f"the renderers of a batch must have one shape of grids and images, but one has "
                    f"{each.grid.shape} and {each.shape}, another {self.volume} and {self.shape}"
                )
        self._renderers = list(self._first)

    def check(self, extinction, effective_radius=None):
        """Refuse arrays that are no volumes of the renderers."""
        for name, array in (("extinction", extinction), ("effective radius", effective_radius)):
            if array is not None and tuple(array.shape[-3:]) != self.volume:
                raise ValueError(
                    f"the {name} has the shape {tuple(array.shape)}, but must have the shape "
                    f"[..., z, y, x] with {self.volume} voxels"
                )

    def __call__(self, method, *arrays):
        """The results of a method of the renderers for each scene of the arrays, as a list.

        The arrays are the point, that is the extinction and, if the images are a function of it, the
        effective radius; and then the cotangent of ``vjp``, or the direction of each array of the point for
        ``jvp``. There is one result, and for ``vjp`` one for each array of the point.
        """
        batch = arrays[0].shape[:-3]
        if not self._is_single and batch[-1:] != (len(self._first),):
            raise ValueError(
                f"there are {len(self._first)} renderers, but the extinction has the shape "
                f"{arrays[0].shape}: its axis before the last three must have one element for each of them"
            )
        if method == "jvp" and len(arrays) == 4:
            if arrays[3].any():
                raise NotImplementedError(
                    "derivatives with respect to the effective radius exist in reverse mode only"
                )
            arrays = arrays[:3]
        count = math.prod(batch)
        while len(self._renderers) < count:
            self._renderers.append(copy.copy(self._first[len(self._renderers) % len(self._first)]))
        rows = [array.reshape((count,) + array.shape[len(batch) :]) for array in arrays]
        results = side_by_side(self._renderers[:count], method, list(zip(*rows)))
        shape = self.volume if method == "vjp" else self.shape
        return [np.array(each, np.float32).reshape(batch + shape) for each in zip(*results)]
