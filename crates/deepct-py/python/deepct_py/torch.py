"""The images of clouds as a function of PyTorch that can be differentiated.

PyTorch has to be installed; ``import deepct_py`` does not require it::

    import deepct_py, deepct_py.torch

    renderer = deepct_py.Renderer(grid, views, light, mask=mask)
    images = deepct_py.torch.Images(renderer)
    loss = ((images(extinction) - measured) ** 2).sum()
    loss.backward()
"""

from typing import Any

import torch

from ._scenes import Renderers, Scenes

__all__ = ["Images"]


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
    They are computed on the CPU in single precision. The scenes of a batch are computed at the same time,
    each by a copy of the renderer, which starts from its last solution: keep the order of the scenes.

    First derivatives are available in both modes (``backward``, ``torch.func.grad``, ``torch.func.jvp``),
    and under ``torch.func.vmap``; second derivatives are not.
    """

    def __init__(self, renderers: Renderers) -> None:
        super().__init__()
        self._scenes = Scenes(renderers)

    def forward(self, extinction: torch.Tensor) -> torch.Tensor:
        """The images of the extinctions."""
        if extinction.shape[-3:] != self._scenes.volume:
            raise ValueError(
                f"the extinction has the shape {tuple(extinction.shape)}, but must have the shape "
                f"[..., z, y, x] with {self._scenes.volume} voxels"
            )
        images: torch.Tensor = _Images.apply(extinction, self._scenes)  # type: ignore[no-untyped-call]
        return images


class _Product(torch.autograd.Function):
    """What a method of the renderers gives, as an operation without derivatives."""

    @staticmethod
    def forward(scenes: Scenes, method: Any, *tensors: torch.Tensor) -> torch.Tensor:
        arrays = (tensor.detach().cpu().to(torch.float32).numpy() for tensor in tensors)
        return torch.from_numpy(scenes(method, *arrays)).to(tensors[0])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: torch.Tensor) -> Any:
        raise NotImplementedError("the images have no second derivatives")

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], scenes: Scenes, method: Any, *tensors: torch.Tensor) -> Any:
        batch = (
            tensor.expand(info.batch_size, *tensor.shape) if axis is None else tensor.movedim(axis, 0)
            for tensor, axis in zip(tensors, in_dims[2:])
        )
        return _product(scenes, method, *batch), 0


def _product(scenes: Scenes, method: Any, *tensors: torch.Tensor) -> torch.Tensor:
    product: torch.Tensor = _Product.apply(scenes, method, *tensors)  # type: ignore[no-untyped-call]
    return product


class _Images(torch.autograd.Function):
    """The images, with derivatives in both modes."""

    @staticmethod
    def forward(extinction: torch.Tensor, scenes: Scenes) -> torch.Tensor:
        return _product(scenes, "images", extinction)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        extinction, ctx.scenes = inputs
        ctx.save_for_backward(extinction)
        ctx.save_for_forward(extinction)

    @staticmethod
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, None]:
        (extinction,) = ctx.saved_tensors
        return _product(ctx.scenes, "vjp", extinction, cotangent), None

    @staticmethod
    def jvp(ctx: Any, direction: torch.Tensor, _: Any) -> torch.Tensor:
        (extinction,) = ctx.saved_tensors
        return _product(ctx.scenes, "jvp", extinction, direction)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], extinction: torch.Tensor, scenes: Scenes) -> Any:
        return _Images.apply(extinction.movedim(in_dims[0], 0), scenes), 0  # type: ignore[no-untyped-call]
