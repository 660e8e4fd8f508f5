"""The network of 3DeepCT (Sde-Chen et al. 2021): a chain of 3x3 convolutions.

The input channels are the views and the output channels are the altitudes. The attribute names
give the parameters the names used in the authors' checkpoints: ``net.body.{i}.body.0`` is a
convolution and ``net.body.{i}.body.1`` its batch normalisation.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from weights_tools.lift import Lift

KERNEL_SIZE = 3
"""Size of a kernel along rows and columns (pixels)."""

KINDS = (
    *(torch.float16, torch.bfloat16, torch.float32, torch.float64),
    *(torch.int32, torch.int64),
)
"""Types of the values of a state dict. Numbers of fewer bits would need further factors."""

RADII = (1.0, 25.0)
"""Smallest and largest effective radius (um): ``deepct`` limits estimates to this range, which is
that of its droplet optics."""

CHANNEL_GROWTH = 2
"""Number of channels that each layer of the paper's network adds until there are enough."""


def growing_channels(views: int, levels: int, layers: int) -> list[int]:
    """Numbers of channels before, between and after the layers, by the rule of the authors' code.

    A layer adds :data:`CHANNEL_GROWTH` channels to its input if that has fewer than
    ``levels - CHANNEL_GROWTH`` channels; otherwise its output has ``levels`` channels.
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
    """Numbers of channels before, between and after the layers, with ``width`` between them."""
    if min(views, levels, layers, width) < 1:
        raise ValueError("views, levels, layers and width must all be at least 1")
    return [views, *[width] * (layers - 1), levels]


class Block(nn.Module):
    """Convolution, batch normalisation and ReLU, which preserve the size of the image."""

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
    """A sequence of blocks."""

    def __init__(self, channels: Sequence[int]) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *(Block(inputs, outputs) for inputs, outputs in zip(channels, channels[1:]))
        )

    def forward(self, images: Tensor) -> Tensor:
        return self.body(images)


class Network(nn.Module):
    """Maps scaled images ``[batch, view, row, col]`` to scaled extinction ``[batch, z, y, x]``.

    ``channels`` are the numbers of channels before, between and after the layers. ``lift``
    resamples the images onto planes before the first layer; without it, the camera images are the
    input. The rows and columns of the images are the y and x of the volume; their numbers are
    arbitrary.
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
        """The input of the first layer for images, ``[batch, channel, y, x]``."""
        return images if self.lift is None else self.lift(images)

    def layers(self, images: Tensor, leak: float = 0.0) -> Tensor:
        """The extinction from the input of the first layer.

        The last ReLU multiplies negative values by ``leak`` instead of zero, for training only.
        """
        if leak == 0.0:
            return self.net(images)
        *hidden, last = self.net.body
        for block in hidden:
            images = block(images)
        convolution, norm, _ = last.body
        return nn.functional.leaky_relu(norm(convolution(images)), leak)

    def convolution_parameters(self) -> int:
        """Number of kernel values and biases, without those of the batch normalisation."""
        return sum(
            parameter.numel() for block in self.net.body for parameter in block.body[0].parameters()
        )


def channels_of(state: dict[str, Tensor]) -> list[int]:
    """The numbers of channels of the network to which a state dict belongs.

    Raises ``ValueError`` if a layer is missing, if there is a layer too many, or if the input
    channels of a layer are not the output channels of the preceding layer.
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
    """The network with the parameters of a state dict, in evaluation mode.

    Raises ``ValueError`` as :func:`channels_of`, for names or shapes that the network does not
    have, for values of a type other than :data:`KINDS`, and for values that are not finite.
    """
    network = Network(channels_of(state), lift)
    for name, values in state.items():
        if values.dtype not in KINDS:
            kind = str(values.dtype).removeprefix("torch.")
            raise ValueError(f"{name} is of type {kind}, not float32")
    for layer in range(len(network.net.body)):
        normalisation = f"net.body.{layer}.body.1"
        if not any(name.startswith(f"{normalisation}.") for name in state):
            raise ValueError(f"layer {layer} has no batch normalisation ({normalisation})")
    try:
        network.load_state_dict(state)
    except RuntimeError as problem:
        raise ValueError(" ".join(str(problem).split())) from None
    for name, values in state.items():
        if not torch.isfinite(values).all():
            raise ValueError(f"{name} holds a value that is not finite")
    return network.eval()
