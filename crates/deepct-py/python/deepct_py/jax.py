"""The images of clouds as a function of JAX that can be differentiated.

JAX has to be installed; ``import deepct_py`` does not require it::

    import deepct_py, deepct_py.jax, jax

    renderer = deepct_py.Renderer(grid, views, light, mask=mask)
    images = deepct_py.jax.images(renderer)
    gradient = jax.jit(jax.grad(lambda extinction: ((images(extinction) - measured) ** 2).sum()))
"""

from collections.abc import Callable
from typing import Any, Optional

import jax
import jax.custom_batching
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from . import Light
from ._scenes import Renderers, Scenes

__all__ = ["extinction_per_water", "images"]


def images(renderers: Renderers) -> Callable[..., jax.Array]:
    """The images of extinctions, as a function.

    Parameters
    ----------
    renderers : Renderer or sequence of Renderer
        The renderer; or, for scenes with different views, light or masks, one for each scene of a batch.

    Returns
    -------
    callable
        A function of extinctions (1/km) of the shape [..., z, y, x], which must not be negative, that
        returns radiances (1/sr) of the shape [..., view, row, col] in single precision. With renderers
        whose images are also a function of the effective radius (um), this is the second argument. It can
        be compiled (``jax.jit``) and mapped (``jax.vmap``) and has first derivatives in reverse mode
        (``jax.grad``, ``jax.vjp``) and in forward mode (``jax.jvp``, ``jax.linearize``); those with respect
        to the effective radius in reverse mode only. The scenes of a batch are computed at the same time,
        on the CPU, each by a copy of the renderer, which starts from its last solution: keep the order of
        the scenes.
    """
    scenes = Scenes(renderers)

    def images(extinction: jax.Array, effective_radius: Optional[jax.Array] = None) -> jax.Array:
        point = [jnp.asarray(extinction, jnp.float32)]
        if effective_radius is not None:
            point = jnp.broadcast_arrays(point[0], jnp.asarray(effective_radius, jnp.float32))
        scenes.check(*point)
        found: jax.Array = _of_renderers.bind(*point, scenes=scenes, method="images")[0]
        return found

    return images


def extinction_per_water(light: Light, effective_radius: jax.Array) -> jax.Array:
    """The extinction per liquid water content (1/km per g/m3) for effective radii (um) of any shape.

    As ``Light.extinction_per_water``, with its first derivative. It multiplies a liquid water content to
    the extinction.
    """

    def computed(radius: Any) -> list[np.ndarray[Any, Any]]:
        values = np.asarray(radius, np.float32)
        return [part.reshape(values.shape) for part in light.extinction_per_water(values.reshape(1, 1, -1))]

    @jax.custom_batching.custom_vmap
    def both(radius: jax.Array) -> Any:
        result = jax.ShapeDtypeStruct(radius.shape, jnp.float32)  # type: ignore[no-untyped-call]
        return jax.pure_callback(computed, [result, result], radius)

    @both.def_vmap
    def mapped(size: int, is_mapped: list[bool], radius: jax.Array) -> Any:
        return both(radius), [True, True]

    @jax.custom_jvp
    def value(radius: jax.Array) -> jax.Array:
        found: jax.Array = both(radius)[0]
        return found

    @value.defjvp
    def change(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
        found, slope = both(*primals)
        return found, slope * tangents[0]

    return value(jnp.asarray(effective_radius, jnp.float32))


# What a method of renderers gives, as `Scenes` describes it. The tangent of the images is the method "jvp", and
# "vjp" is its transpose: JAX derives all modes from these two. A primitive, because the functions of JAX with
# derivatives of one's own have those of one mode, or (`linear_call`) cannot be mapped.
_of_renderers: Any = Primitive("deepct")
_of_renderers.multiple_results = True


_instantiated: Any = ad.instantiate_zeros


def _linear(count: int, method: str) -> int:
    """Number of the last arguments of a method in which it is linear, of `count` arguments."""
    return {"images": 0, "jvp": count // 2, "vjp": 1}[method]


def _shapes(*arrays: Any, scenes: Scenes, method: str) -> list[ShapedArray]:
    batch = arrays[0].shape[:-3]
    if method == "vjp":
        return [ShapedArray(batch + scenes.volume, jnp.float32)] * (len(arrays) - 1)
    return [ShapedArray(batch + scenes.shape, jnp.float32)]


def _called(*arrays: jax.Array, scenes: Scenes, method: Any) -> Any:
    def compute(*values: Any) -> list[np.ndarray[Any, Any]]:
        return scenes(method, *(np.asarray(value, np.float32) for value in values))

    shapes = _shapes(*arrays, scenes=scenes, method=method)
    results = [jax.ShapeDtypeStruct(each.shape, each.dtype) for each in shapes]  # type: ignore[no-untyped-call]
    return jax.pure_callback(compute, results, *arrays)


def _changes(primals: Any, tangents: Any, *, scenes: Scenes, method: str) -> Any:
    found = _of_renderers.bind(*primals, scenes=scenes, method=method)
    constants = len(primals) - _linear(len(primals), method)
    if method == "images":
        constants, method = 0, "jvp"
        point = primals
    elif not all(type(each) is ad.Zero for each in tangents[:constants]):
        raise NotImplementedError("the images have no second derivatives")
    else:
        point = primals[:constants]
    moved = (_instantiated(each) for each in tangents[constants:])
    return found, _of_renderers.bind(*point, *moved, scenes=scenes, method=method)


def _transposed(cotangents: Any, *arrays: Any, scenes: Scenes, method: str) -> Any:
    linear = _linear(len(arrays), method)
    point = arrays[: len(arrays) - linear]
    given = (_instantiated(each) for each in cotangents)
    other = {"jvp": "vjp", "vjp": "jvp"}[method]
    return [None] * len(point) + list(_of_renderers.bind(*point, *given, scenes=scenes, method=other))


def _mapped(arrays: Any, axes: Any, *, scenes: Scenes, method: str) -> Any:
    size = next(array.shape[axis] for array, axis in zip(arrays, axes) if axis is not None)
    batch = (
        jnp.broadcast_to(array, (size, *array.shape)) if axis is None else jnp.moveaxis(array, axis, 0)
        for array, axis in zip(arrays, axes)
    )
    found = _of_renderers.bind(*batch, scenes=scenes, method=method)
    return found, [0] * len(found)


_of_renderers.def_abstract_eval(_shapes)
_of_renderers.def_impl(_called)
mlir.register_lowering(_of_renderers, mlir.lower_fun(_called, multiple_results=True))
ad.primitive_jvps[_of_renderers] = _changes
ad.primitive_transposes[_of_renderers] = _transposed
batching.primitive_batchers[_of_renderers] = _mapped
