"""The images of clouds as a function of PyTorch that can be differentiated.

PyTorch has to be installed; ``import deepct_py`` does not require it::

    import deepct_py, deepct_py.torch

    renderer = deepct_py.Renderer(grid, views, light, mask=mask)
    images = deepct_py.torch.Images(renderer)
    loss = ((images(extinction) - measured) ** 2).sum()
    loss.backward()
"""

from typing import Any, Optional

import torch

from . import Light
from ._scenes import Renderers, Scenes

__all__ = ["Images", "extinction_per_water"]


class Images(torch.nn.Module):
    """The images of extinctions: a module without parameters.

    Parameters
    ----------
    renderers : Renderer or sequence of Renderer
        The renderer; or, for scenes with different views, light or masks, one for each scene of a batch.

    Notes
    -----
    ``images(extinction)`` takes extinctions (1/km) of the shape [..., z, y, x], which must not be negative,
    and returns radiances (1/sr) of the shape [..., view, row, col], of the same type and on the same device.
    With renderers whose images are also a function of the effective radius (um),
    ``images(extinction, effective_radius)`` takes both. They are computed on the CPU in single precision.
    The scenes of a batch are computed at the same time, each by a copy of the renderer, which starts from
    its last solution: keep the order of the scenes.

    First derivatives are available in both modes (``backward``, ``torch.func.grad``, ``torch.func.jvp``),
    and under ``torch.func.vmap``; those with respect to the effective radius in reverse mode only. Second
    derivatives are not.
    """

    def __init__(self, renderers: Renderers) -> None:
        super().__init__()
        self._scenes = Scenes(renderers)

    def forward(
        self, extinction: torch.Tensor, effective_radius: Optional[torch.Tensor] = None
    ) -> torch.Tensor:
        """The images of the extinctions."""
        self._scenes.check(extinction, effective_radius)
        point = [extinction]
        if effective_radius is not None:
            both = torch.broadcast_tensors(extinction, effective_radius)  # type: ignore[no-untyped-call]
            point = list(both)
        images: torch.Tensor = _Images.apply(self._scenes, *point)  # type: ignore[no-untyped-call]
        return images


def extinction_per_water(light: Light, effective_radius: torch.Tensor) -> torch.Tensor:
    """The extinction per liquid water content (1/km per g/m3) for effective radii (um) of any shape.

    As ``Light.extinction_per_water``, with its first derivative. It multiplies a liquid water content to
    the extinction.
    """
    value: torch.Tensor = _PerWater.apply(light, effective_radius)[0]  # type: ignore[no-untyped-call]
    return value


def _batch(info: Any, axes: tuple[Any, ...], tensors: tuple[torch.Tensor, ...]) -> list[torch.Tensor]:
    """Tensors with the axis of ``vmap`` in front."""
    return [
        tensor.expand(info.batch_size, *tensor.shape) if axis is None else tensor.movedim(axis, 0)
        for tensor, axis in zip(tensors, axes)
    ]


class _Product(torch.autograd.Function):
    """What a method of the renderers gives, as an operation without derivatives."""

    @staticmethod
    def forward(scenes: Scenes, method: Any, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        arrays = (tensor.detach().cpu().to(torch.float32).numpy() for tensor in tensors)
        return tuple(torch.from_numpy(found).to(tensors[0]) for found in scenes(method, *arrays))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:
        raise NotImplementedError("the images have no second derivatives")

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], scenes: Scenes, method: Any, *tensors: torch.Tensor) -> Any:
        found = _product(scenes, method, *_batch(info, in_dims[2:], tensors))
        return found, (0,) * len(found)


def _product(scenes: Scenes, method: Any, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
    product: tuple[torch.Tensor, ...]
    product = _Product.apply(scenes, method, *tensors)  # type: ignore[no-untyped-call]
    return product


class _Images(torch.autograd.Function):
    """The images of a point, that is of the extinction and, in some lights, of the effective radius."""

    @staticmethod
    def forward(scenes: Scenes, *point: torch.Tensor) -> torch.Tensor:
        return _product(scenes, "images", *point)[0]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.scenes, *point = inputs
        ctx.save_for_backward(*point)
        ctx.save_for_forward(*point)

    @staticmethod
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[Any, ...]:
        return None, *_product(ctx.scenes, "vjp", *ctx.saved_tensors, cotangent)

    @staticmethod
    def jvp(ctx: Any, _: Any, *directions: Any) -> torch.Tensor:
        point = ctx.saved_tensors
        directions = tuple(torch.zeros_like(p) if d is None else d for p, d in zip(point, directions))
        return _product(ctx.scenes, "jvp", *point, *directions)[0]

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], scenes: Scenes, *point: torch.Tensor) -> Any:
        batch = _batch(info, in_dims[1:], point)
        return _Images.apply(scenes, *batch), 0  # type: ignore[no-untyped-call]


class _PerWater(torch.autograd.Function):
    """The extinction per liquid water content, and its derivative as a constant."""

    @staticmethod
    def forward(light: Light, radius: torch.Tensor) -> tuple[torch.Tensor, ...]:
        flat = radius.detach().cpu().to(torch.float32).numpy().reshape(1, 1, -1)
        both = light.extinction_per_water(flat)
        return tuple(torch.from_numpy(part).reshape(radius.shape).to(radius) for part in both)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[torch.Tensor, ...]) -> None:
        ctx.mark_non_differentiable(output[1])
        ctx.save_for_backward(output[1])
        ctx.save_for_forward(output[1])

    @staticmethod
    def backward(ctx: Any, cotangent: torch.Tensor, _: Any) -> tuple[Any, ...]:
        return None, ctx.saved_tensors[0] * cotangent

    @staticmethod
    def jvp(ctx: Any, _: Any, direction: torch.Tensor) -> tuple[Any, ...]:
        return ctx.saved_tensors[0] * direction, None

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], light: Light, radius: torch.Tensor) -> Any:
        both = _PerWater.apply(light, radius)  # type: ignore[no-untyped-call]
        return both, (in_dims[1], in_dims[1])
