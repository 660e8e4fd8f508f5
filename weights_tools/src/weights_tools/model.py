"""The network of 3DeepCT (Sde-Chen et al. 2021): a chain of 3x3 convolutions.

Views come in as channels and altitudes go out as channels. The attribute names give
the parameters the names that the authors' checkpoints use:
``net.body.{i}.body.0`` is a convolution and ``net.body.{i}.body.1`` its batch norm.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from weights_tools.lift import Lift

KERNEL_SIZE = 3
"""Pixels of a kernel along rows and along columns."""

CHANNEL_GROWTH = 2
"""Channels that the paper's network gains with every layer until it has enough."""


def growing_channels(views: int, levels: int, layers: int) -> list[int]:
    """Channels before, between and after the layers, by the rule of the authors' code.

    Every layer adds :data:`CHANNEL_GROWTH` channels while that stays below
    ``levels - CHANNEL_GROWTH``; from then on all have ``levels``.
    """
    if min(views, levels, layers) < 1:
        raise ValueError(
            f"views {views}, levels {levels} and layers {layers} must all be at least 1"
        )
    channels = [views]
    width = views
    for _ in range(layers - 1):
        width = width + CHANNEL_GROWTH if width < levels - CHANNEL_GROWTH else levels
        channels.append(width)
    return [*channels, levels]


def constant_channels(views: int, levels: int, layers: int, width: int) -> list[int]:
    """Channels before, between and after the layers, ``width`` between them all."""
    if min(views, levels, layers, width) < 1:
        raise ValueError("views, levels, layers and width must all be at least 1")
    return [views, *[width] * (layers - 1), levels]


class Block(nn.Module):
    """Convolution, batch norm, ReLU; the size of the image stays."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(inputs, outputs, KERNEL_SIZE, padding=KERNEL_SIZE // 2),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
        )
        nn.init.xavier_normal_(self.body[0].weight)
        nn.init.zeros_(self.body[0].bias)

    def forward(self, images: Tensor) -> Tensor:
        return self.body(images)


class Chain(nn.Module):
    """Blocks one after another."""

    def __init__(self, channels: Sequence[int]) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *(Block(inputs, outputs) for inputs, outputs in zip(channels, channels[1:]))
        )

    def forward(self, images: Tensor) -> Tensor:
        return self.body(images)


class Network(nn.Module):
    """Scaled images ``[batch, view, row, col]`` to scaled extinction ``[batch, z, y, x]``.

    ``channels`` are those before, between and after the layers. ``lift`` lays the images on
    planes before the first one; without it they enter as they are. The rows and columns of
    the images are the y and x of the volume; any size will do.
    """

    def __init__(self, channels: Sequence[int], lift: Lift | None = None) -> None:
        super().__init__()
        if len(channels) < 2 or min(channels) < 1:
            raise ValueError(f"channels {list(channels)} must be two or more positive numbers")
        if lift is not None and lift.channels != channels[0]:
            problem = f"has {channels[0]} input channels, the images on planes are {lift.channels}"
            raise ValueError(problem)
        self.channels = list(channels)
        self.lift = lift
        self.net = Chain(channels)

    def forward(self, images: Tensor) -> Tensor:
        return self.layers(self.lifted(images))

    def lifted(self, images: Tensor) -> Tensor:
        """What the first layer sees of images, ``[batch, channel, y, x]``."""
        return images if self.lift is None else self.lift(images)

    def layers(self, images: Tensor, leak: float = 0.0) -> Tensor:
        """From what the first layer sees to extinction.

        The last ReLU lets ``leak`` times a negative value through: only for training.
        """
        if leak == 0.0:
            return self.net(images)
        *hidden, last = self.net.body
        for block in hidden:
            images = block(images)
        convolution, norm, _ = last.body
        return nn.functional.leaky_relu(norm(convolution(images)), leak)

    def convolution_parameters(self) -> int:
        """Number of kernel values and biases, without the batch norms."""
        return sum(
            parameter.numel() for block in self.net.body for parameter in block.body[0].parameters()
        )


def channels_of(state: dict[str, Tensor]) -> list[int]:
    """The channels of the network that a state dict is for.

    Raises ``ValueError`` where a layer is missing, one too many, or does not take what
    the one before it gives.
    """
    prefix, suffix = "net.body.", ".body.0.weight"
    layers = sum(name.startswith(prefix) and name.endswith(suffix) for name in state)
    if layers == 0:
        raise ValueError(f"has no parameter named {prefix}0{suffix}")
    channels: list[int] = []
    for layer in range(layers):
        name = f"{prefix}{layer}{suffix}"
        if name not in state:
            raise ValueError(f"has {layers} layers but no {name}")
        shape = tuple(state[name].shape)
        if len(shape) != 4 or shape[2:] != (KERNEL_SIZE, KERNEL_SIZE):
            raise ValueError(f"{name} has shape {shape}, not [out, in, 3, 3]")
        if channels and shape[1] != channels[-1]:
            raise ValueError(
                f"{name} takes {shape[1]} channels, the layer before gives {channels[-1]}"
            )
        channels = [*(channels or [shape[1]]), shape[0]]
    return channels


def network_from_state(state: dict[str, Tensor], lift: Lift | None = None) -> Network:
    """The network with the parameters of a state dict, ready for inference.

    Raises ``ValueError`` as :func:`channels_of`, and for a name or shape that the
    network does not have.
    """
    network = Network(channels_of(state), lift)
    try:
        network.load_state_dict(state)
    except RuntimeError as problem:
        raise ValueError(" ".join(str(problem).split())) from None
    for name, values in state.items():
        if not torch.isfinite(values).all():
            raise ValueError(f"{name} holds a value that is not finite")
    return network.eval()
