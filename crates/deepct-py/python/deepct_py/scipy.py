"""The derivative of the images of a cloud as a linear operator of SciPy.

SciPy has to be installed; ``import deepct_py`` does not require it.
"""

from typing import Any, Optional

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator  # type: ignore[import-untyped]

from . import Renderer

__all__ = ["derivative"]


def derivative(
    renderer: Renderer, extinction: ArrayLike, effective_radius: Optional[ArrayLike] = None
) -> Any:
    """The derivative of the images with respect to the extinction, without its matrix.

    Parameters
    ----------
    renderer : Renderer
        The renderer, which the operator uses: a call of it for another extinction makes the next
        product solve for this one again.
    extinction : array [z, y, x]
        Extinction (1/km) at which the derivative is taken.
    effective_radius : array [z, y, x], optional
        Effective radius (um), which is constant, for a renderer whose images are a function of it.

    Returns
    -------
    scipy.sparse.linalg.LinearOperator
        Operator of shape (pixels, voxels), in the order of ``images.ravel()`` and
        ``extinction.ravel()``. It is computed in single precision and returns double precision, in which
        the solvers of SciPy work. A product costs one solution of the solver, as does
        one of its transpose.

    Examples
    --------
    >>> import deepct_py.scipy
    >>> cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
    >>> renderer = deepct_py.Renderer(cloud.grid, "cloudct-10", mask=cloud.extinction > 0)
    >>> operator = deepct_py.scipy.derivative(renderer, cloud.extinction)
    >>> operator.shape
    (10240, 20480)
    """
    point = np.array(extinction, np.float32)
    radius = None if effective_radius is None else np.array(effective_radius, np.float32)

    def product(direction: NDArray[Any]) -> NDArray[np.float64]:
        images = renderer.jvp(point, direction.reshape(renderer.grid.shape), radius)
        return images.ravel().astype(np.float64)

    def transposed(cotangent: NDArray[Any]) -> NDArray[np.float64]:
        weights = cotangent.reshape(renderer.shape)
        if radius is None:
            gradient = renderer.vjp(point, weights)
        else:
            gradient, _ = renderer.vjp(point, weights, radius)
        return gradient.ravel().astype(np.float64)

    shape = (int(np.prod(renderer.shape)), int(np.prod(renderer.grid.shape)))
    return LinearOperator(shape, matvec=product, rmatvec=transposed, dtype=np.float64)
