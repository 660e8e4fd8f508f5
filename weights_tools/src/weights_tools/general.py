"""The general network, whose first layer and normalisations are derived from the geometry.

The images of any number of views are resampled onto horizontal planes. A perceptron assigns to each
view, from the directions of the camera and of the Sun, its factor in each of several *virtual
views*, which are sums of the images of all views; a second perceptron derives a scale and a shift
of the channels of each layer but the last from the directions of the Sun and of all views
(modulation, after Perez et al. 2018, "FiLM: visual reasoning with a general conditioning layer").
For a given geometry, everything but the minimum and maximum over the views is linear and can be
folded into plain convolutions (:func:`fold`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from weights_tools.model import KERNEL_SIZE
from weights_tools.planes import plane_heights
from weights_tools.views import (
    SCENE_FEATURES,
    VIEW_FEATURES,
    Views,
    scene_features,
    view_features,
)

MIXING_WIDTH = 96
"""Number of channels between the layers of the perceptron of the views."""

MODULATION_WIDTH = 64
"""Number of channels between the layers of the perceptron of the scene."""

MIXING_SCALE = 3.0
"""Sum of the factors of all views in a virtual view if the perceptron returns 1 for each."""

MOMENTUM = 0.02
"""Weight of a batch in the running statistics of the batch normalisations. The statistics of the
batches differ much, as each has another formation."""

FAR = 1e4
"""Value added to an unused place before the minimum over the views, well above all images."""


@dataclass(frozen=True)
class GeneralArchitecture:
    """Sizes of a general network."""

    virtual_views: int = 16
    """Number of virtual views."""
    planes: int = 8
    """Number of horizontal planes onto which the images are resampled."""
    extremes: bool = True
    """Whether the minimum and the maximum over the views on each plane are further inputs."""
    width: int = 96
    """Number of channels between the layers."""
    layers: int = 7
    """Number of 3x3 convolutions."""
    levels: int = 32
    """Number of levels of the extinction and of its uncertainty."""
    level_height: float = 0.8
    """Height of a level divided by the horizontal voxel size."""

    def __post_init__(self) -> None:
        for name in ("virtual_views", "planes", "width", "levels"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, not at least 1")
        if self.layers < 2:
            raise ValueError(f"layers is {self.layers}, not at least 2")
        if not 0.0 < self.level_height < float("inf"):
            raise ValueError(f"level_height is {self.level_height}, not positive")

    @property
    def channels(self) -> list[int]:
        """Numbers of channels before, between and after the layers."""
        inputs = self.planes * (self.virtual_views + (2 if self.extremes else 0))
        return [inputs, *[self.width] * (self.layers - 1), 2 * self.levels]

    @property
    def heights(self) -> Tensor:
        """Heights of the planes above the target (voxels), float64 ``[plane]``."""
        return plane_heights(self.planes, self.levels, self.level_height)


class Perceptron(nn.ModuleList):
    """Fully connected layers with the activation SiLU between them."""

    def __init__(self, channels: list[int]) -> None:
        super().__init__(nn.Linear(a, b) for a, b in zip(channels, channels[1:]))

    def forward(self, values: Tensor) -> Tensor:
        *hidden, last = self
        for layer in hidden:
            values = nn.functional.silu(layer(values))
        return last(values)


class Layer(nn.Conv2d):
    """A 3x3 convolution followed by a batch normalisation.

    It is a convolution that contains its normalisation, so that the names of the parameters are
    those of the weights file: ``weight``, ``bias``, ``batch_norm.weight``, ...
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, KERNEL_SIZE, padding=KERNEL_SIZE // 2)
        self.batch_norm = nn.BatchNorm2d(outputs, momentum=MOMENTUM)
        nn.init.xavier_normal_(self.weight)
        nn.init.zeros_(self.bias)

    def forward(self, values: Tensor) -> Tensor:
        return self.batch_norm(super().forward(values))


class GeneralNetwork(nn.Module):
    """Maps images on planes and their geometry to scaled extinction and scaled uncertainty."""

    def __init__(self, architecture: GeneralArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.frozen = False
        """Whether the batch normalisations use and keep their running statistics in training."""
        channels = architecture.channels
        self.layers = nn.ModuleList(Layer(a, b) for a, b in zip(channels, channels[1:]))
        hidden = [MIXING_WIDTH, MIXING_WIDTH]
        self.mixing = Perceptron([VIEW_FEATURES, *hidden, architecture.virtual_views])
        factors = 2 * architecture.width * (architecture.layers - 1)
        self.modulation = Perceptron([SCENE_FEATURES, MODULATION_WIDTH, factors])
        # The layers start without modulation, and small answers make the first steps stable.
        nn.init.zeros_(self.modulation[-1].weight)
        nn.init.zeros_(self.modulation[-1].bias)
        nn.init.constant_(self.layers[-1].batch_norm.weight, 0.1)

    def train(self, mode: bool = True) -> GeneralNetwork:
        """Set the training mode, in which frozen normalisations remain as they are."""
        super().train(mode)
        if self.frozen:
            for layer in self.layers:
                layer.batch_norm.eval()
        return self

    def forward(self, planes: Tensor, views: Views, leak: float | Tensor = 0.0) -> Tensor:
        """The scaled extinction followed by its expected absolute error, ``[n, 2 levels, y, x]``.

        ``planes`` ``[n, v, plane, y, x]`` are the scaled images on planes; those of unused places
        are finite and arbitrary. The last ReLU multiplies negative values by ``leak`` instead of
        zero, for training only.
        """
        scene = scene_features(views)
        values = self._mixed(planes, views, scene)
        factors = self.modulation_factors(scene)[..., None, None]
        values = values.contiguous(memory_format=torch.channels_last)
        *hidden, last = self.layers
        for index, layer in enumerate(hidden):
            scale, shift = factors[:, index].to(values.dtype).unbind(1)
            values = torch.relu(layer(values) * (1.0 + scale) + shift)
        # Not leaky_relu, whose slope cannot be a tensor, which a captured graph needs.
        values = last(values)
        return torch.maximum(values, values * leak)

    def mixing_factors(self, views: Views, scene: Tensor) -> Tensor:
        """The factor of each view in each virtual view, ``[n, virtual view, v]``."""
        share = MIXING_SCALE * views.present / views.count[:, None]
        return (self.mixing(view_features(views, scene)) * share[..., None]).transpose(1, 2)

    def modulation_factors(self, scene: Tensor) -> Tensor:
        """Additions to the scale 1 and to the shift 0 of each channel of each layer but the last,
        ``[n, layer, (scale, shift), channel]``."""
        return self.modulation(scene).reshape(len(scene), len(self.layers) - 1, 2, -1)

    def _mixed(self, planes: Tensor, views: Views, scene: Tensor) -> Tensor:
        """The input of the first layer, ``[n, channel, y, x]``."""
        scenes, count = planes.shape[:2]
        factors = self.mixing_factors(views, scene).to(planes.dtype)
        mixed = torch.bmm(factors, planes.reshape(scenes, count, -1))
        mixed = mixed.reshape(scenes, -1, *planes.shape[-2:])
        if not self.architecture.extremes:
            return mixed
        absent = (FAR * (1.0 - views.present)).to(planes.dtype)[..., None, None, None]
        lowest, highest = (planes + absent).amin(1), (planes - absent).amax(1)
        return torch.cat([mixed, lowest.to(mixed.dtype), highest.to(mixed.dtype)], 1)


def fold(network: GeneralNetwork, views: Views) -> dict[str, Tensor]:
    """Plain convolutions that give the output of the network for one geometry.

    ``views`` are those of one scene. Everything is computed in float64. Returns
    ``layers.{i}.weight`` ``[out, in, 3, 3]`` and ``layers.{i}.bias`` ``[out]``. Each layer is
    followed by a ReLU. The input channel ``plane * views + view`` of the first layer is the scaled
    image of a view on a plane; with ``extremes``, the minima over the views on each plane and then
    the maxima follow (:func:`folded_input`).
    """
    if len(views.sun) != 1:
        raise ValueError(f"fold needs the views of one scene, not of {len(views.sun)}")
    sizes = network.architecture
    views = views.to(torch.float64)
    with torch.no_grad():
        scene = scene_features(views)
        features = view_features(views, scene)
        share = MIXING_SCALE * views.present / views.count[:, None]
        mixing = (_float64(network.mixing, features) * share[..., None])[0]
        modulation = _float64(network.modulation, scene).reshape(sizes.layers - 1, 2, -1)
        result: dict[str, Tensor] = {}
        for index, layer in enumerate(network.layers):
            weight, norm = layer.weight.double(), layer.batch_norm
            if index == 0:
                weight = _first_kernels(weight, mixing, sizes)
            scale = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
            shift = (layer.bias.double() - norm.running_mean.double()) * scale
            shift = shift + norm.bias.double()
            if index < len(modulation):
                scale = scale * (1.0 + modulation[index, 0])
                shift = shift * (1.0 + modulation[index, 0]) + modulation[index, 1]
            result[f"layers.{index}.weight"] = weight * scale[:, None, None, None]
            result[f"layers.{index}.bias"] = shift
    return result


def _float64(perceptron: Perceptron, values: Tensor) -> Tensor:
    *hidden, last = perceptron
    for layer in hidden:
        linear = nn.functional.linear(values, layer.weight.double(), layer.bias.double())
        values = nn.functional.silu(linear)
    return nn.functional.linear(values, last.weight.double(), last.bias.double())


def _first_kernels(weight: Tensor, mixing: Tensor, sizes: GeneralArchitecture) -> Tensor:
    """The kernels of the first layer for images on planes: ``W[o, plane, view] =
    sum_j W[o, j, plane] a[view, j]``; those of the extremes are unchanged."""
    virtual = sizes.virtual_views * sizes.planes
    kernels = weight[:, :virtual].unflatten(1, (sizes.virtual_views, sizes.planes))
    by_view = torch.einsum("ojpab,vj->opvab", kernels, mixing).flatten(1, 2)
    return torch.cat([by_view, weight[:, virtual:]], 1)


def folded_input(planes: Tensor, extremes: bool) -> Tensor:
    """The input of folded layers, ``[n, channel, y, x]``, for scaled images on planes
    ``[n, v, plane, y, x]`` without unused places."""
    by_plane = planes.transpose(1, 2).flatten(1, 2)
    if not extremes:
        return by_plane
    return torch.cat([by_plane, planes.amin(1), planes.amax(1)], 1)


def run_folded(layers: dict[str, Tensor], inputs: Tensor) -> Tensor:
    """The output ``[n, 2 levels, y, x]`` of folded layers for their input."""
    for index in range(len(layers) // 2):
        weight, bias = (layers[f"layers.{index}.{part}"] for part in ("weight", "bias"))
        inputs = nn.functional.conv2d(inputs, weight, bias, padding=KERNEL_SIZE // 2).relu()
    return inputs


def with_extremes(network: GeneralNetwork) -> GeneralNetwork:
    """A network that also sees the minimum and maximum over the views, and returns the same output
    until it is trained further, as the kernels of these inputs are zero."""
    sizes = network.architecture
    if sizes.extremes:
        return network
    values: dict[str, Any] = {**vars(sizes), "extremes": True}
    result = GeneralNetwork(GeneralArchitecture(**values))
    state = network.state_dict()
    first = state["layers.0.weight"]
    zero = first.new_zeros(first.shape[0], 2 * sizes.planes, KERNEL_SIZE, KERNEL_SIZE)
    result.load_state_dict({**state, "layers.0.weight": torch.cat([first, zero], 1)})
    return result.train(network.training)
