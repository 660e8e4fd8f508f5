"""The images of clouds as a function of JAX that can be differentiated.

JAX has to be installed; ``import deepct_py`` does not require it::

    import deepct_py, deepct_py.jax, jax

    renderer = deepct_py.Renderer(grid, views, light, mask=mask)
    images = deepct_py.jax.images(renderer)
    gradient = jax.jit(jax.grad(lambda extinction: ((images(extinction) - measured) ** 2).sum()))
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._scenes import Renderers, Scenes

__all__ = ["images"]


def images(renderers: Renderers) -> Callable[[jax.Array], jax.Array]:
    """The images of extinctions, as a function.

    Parameters
    ----------
    renderers : Renderer or sequence of Renderer
        The renderer; or, for scenes with different views, light or masks, one for each scene of a batch.

    Returns
    -------
    callable
        A function of extinctions (1/km) of the shape [..., z, y, x], which must not be negative, that
        returns radiances (1/sr) of the shape [..., view, row, col] in single precision. It can be compiled
        (``jax.jit``) and mapped (``jax.vmap``) and has derivatives in reverse mode (``jax.grad``,
        ``jax.vjp``). The scenes of a batch are computed at the same time, on the CPU, each by a copy of
        the renderer, which starts from its last solution: keep the order of the scenes.
    """
    scenes = Scenes(renderers)

    def called(method: Any, shape: tuple[int, ...], *arrays: jax.Array) -> jax.Array:
        def compute(*values: Any) -> np.ndarray[Any, Any]:
            return scenes(method, *(np.asarray(value, np.float32) for value in values))

        batch = arrays[0].shape[:-3]
        result = jax.ShapeDtypeStruct(batch + shape, jnp.float32)  # type: ignore[no-untyped-call]
        found: jax.Array = jax.pure_callback(compute, result, *arrays, vmap_method="broadcast_all")
        return found

    @jax.custom_vjp
    def images(extinction: jax.Array) -> jax.Array:
        extinction = jnp.asarray(extinction)
        if extinction.shape[-3:] != scenes.volume:
            raise ValueError(
                f"the extinction has the shape {extinction.shape}, but must have the shape [..., z, y, x] "
                f"with {scenes.volume} voxels"
            )
        return called("images", scenes.shape, extinction)

    def forward(extinction: jax.Array) -> tuple[jax.Array, jax.Array]:
        return images(extinction), extinction

    def backward(extinction: jax.Array, cotangent: jax.Array) -> tuple[jax.Array]:
        gradient = called("vjp", scenes.volume, extinction, cotangent)
        return (gradient.astype(extinction.dtype),)

    images.defvjp(forward, backward)
    return images
