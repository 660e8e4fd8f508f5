"""The general network as a differentiable function of the images of one formation.

Together with ``deepct_py.torch.Images``, images lead to an extinction and this to images again:

    estimator = Estimator(load_general("general.safetensors"), views, light)
    renderer = deepct_py.Renderer(estimator.grid, views, light, mask=mask)
    again = deepct_py.torch.Images(renderer)(estimator(images) * mask)

Gradients flow through all of it, to the images and to the parameters of the network. A mask that is
carved from the images is constant: carving compares images with thresholds.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from weights_tools.general_file import GeneralWeights
from weights_tools.planes import on_planes
from weights_tools.surface import above_surface
from weights_tools.views import Views, views_of

FINE_PIXEL = 0.67
"""Smallest size of a pixel (voxels). ``deepct`` averages smaller pixels over a voxel."""


class Estimator(nn.Module):
    """Maps images ``[n, view, row, col]`` (1/sr) to extinction ``[n, z, y, x]`` (1/km) on
    :attr:`grid`, which is that of ``deepct_py.Network.grid``.

    ``views`` and ``light`` are those of ``deepct_py``. Raises ``ValueError`` for views whose lines
    of sight are given one by one, that do not point at one target, or that have small pixels.
    """

    def __init__(self, weights: GeneralWeights, views: Any, light: Any) -> None:
        import deepct_py

        super().__init__()
        self.network, self.description = weights.network, weights.description
        sizes = self.network.architecture
        # Rounded as by ``deepct``.
        voxel = float(f"{min(view.pixel_km for view in views):.6g}")
        target = views[0].target
        rows, cols = views[0].size
        if any(math.dist(view.target, target) > 1e-6 * voxel for view in views):
            raise ValueError("the views point at different targets")
        if any(view.points is not None for view in views):
            raise ValueError("views of separate lines of sight have no camera")
        height = sizes.level_height * voxel
        extent = (cols * voxel, rows * voxel, sizes.levels * height)
        lowest = [middle - 0.5 * length for middle, length in zip(target, extent)]
        if lowest[2] < 0.0:
            raise ValueError(f"a target at {target[2]} km is too low for {sizes.levels} levels")
        self.grid = deepct_py.Grid((sizes.levels, rows, cols), (voxel, voxel, height), lowest)
        self.views = _views(views, light, voxel)
        self._factor = self.description.output_scale * self.description.voxel_km / voxel

    def forward(self, images: Tensor) -> Tensor:
        """The extinction."""
        return self.of_planes(self.planes(images))[0]

    def planes(self, images: Tensor, chosen: Tensor | None = None) -> Tensor:
        """The input of :meth:`of_planes` from the images of the views with the numbers ``chosen``;
        by default all. It does not depend on the parameters of the network."""
        views = self._of(images, chosen)
        if self.description.surface_albedo is not None:
            images = above_surface(images, views, self.description.surface_albedo)
        scaled = images * self.description.input_scale
        return on_planes(scaled, views, self.network.architecture.heights)

    def of_planes(self, planes: Tensor, chosen: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The extinction and its expected error (1/km) from the planes of the chosen views."""
        extinction, error = self.network(planes, self._of(planes, chosen)).chunk(2, 1)
        return self._factor * extinction, self._factor * error

    def _of(self, images: Tensor, chosen: Tensor | None) -> Views:
        """The chosen views, for each scene of a batch."""
        views = self.views.to(images)
        if chosen is not None:
            views = views.select(chosen[None])
        return Views(*(each.expand(len(images), *each.shape[1:]) for each in vars(views).values()))


def _views(views: Any, light: Any, voxel: float) -> Views:
    zenith, azimuth = light.sun
    distances = [
        None if view.position is None else math.dist(view.position, view.target) for view in views
    ]
    pixels = [view.pixel_km for view in views]
    if min(pixels) < FINE_PIXEL * voxel:
        raise ValueError(f"pixels of {min(pixels)} km are too small for voxels of {voxel} km")
    geometry = {
        "sun_zenith_deg": zenith,
        "sun_azimuth_deg": azimuth,
        "view_zenith_deg": [view.zenith_deg for view in views],
        "view_azimuth_deg": [view.azimuth_deg for view in views],
        "pixel_km": pixels,
        "camera_distance_km": distances,
    }
    found = views_of(geometry, voxel)
    return found.to(torch.float32)
