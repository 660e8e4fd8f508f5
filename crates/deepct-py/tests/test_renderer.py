"""Derivatives of the images: the renderer, and its functions for PyTorch, JAX and SciPy."""

import copy
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest

import deepct_py as deepct

GRID = deepct.Grid((5, 7, 8), (0.05, 0.05, 0.04), (-0.2, -0.175, 0.5))


def blob(peak, reach):
    """A ragged cloud with its largest extinction in the middle."""
    axes = np.meshgrid(GRID.z, GRID.y, GRID.x, indexing="ij")
    extent = [0.2, 0.35, 0.4]
    distance = np.sqrt(sum(((a - a.mean()) / e) ** 2 for a, e in zip(axes, extent)))
    uneven = 0.6 + np.random.default_rng(5).random(GRID.shape)
    return (peak * np.clip(1 - distance / reach, 0, None) * uneven).astype(np.float32)


def views(size=(10, 10)):
    return deepct.Views.load("cloudct-10", GRID.center, size)[::3]


CASES = {
    "thin": (blob(2.0, 0.5), {"surface_albedo": 0.05}),
    "thick": (blob(120.0, 0.5), {"surface_albedo": 0.05, "phase": "mie", "effective_radius": 10.0}),
    "at the sides": (blob(40.0, 2.0), {"surface_albedo": 0.05}),
    "periodic": (blob(40.0, 2.0), {"surface_albedo": 0.3, "periodic": True}),
    "above snow": (blob(40.0, 0.5), {"surface_albedo": 0.8, "air": True}),
}


def made(case, **options):
    extinction, light = CASES[case]
    light = deepct.Light(**light)
    settings = {"accuracy": 0.03, "tolerance": 3e-7, "warm_start": False}
    options = {"mask": extinction > 0, "expected": extinction, **settings, **options}
    return deepct.Renderer(GRID, views(), light, **options), extinction


def dot(one, other):
    return float((one.astype(float) * other.astype(float)).sum())


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_central_differences(case):
    """In 20 voxels and 5 random directions, within a thousandth of the largest."""
    renderer, extinction = made(case)
    random = np.random.default_rng(1)
    weights = random.uniform(0.5, 1.5, renderer.shape).astype(np.float32)
    gradient = renderer.vjp(extinction, weights)
    thick = np.argwhere(extinction > 0.1 * extinction.max())
    directions = []
    for voxel in thick[random.choice(len(thick), min(20, len(thick)), replace=False)]:
        one = np.zeros(GRID.shape, np.float32)
        one[tuple(voxel)] = 0.02 * extinction.max()
        directions.append(one)
    for _ in range(5):
        directions.append(0.05 * extinction * random.uniform(-1, 1, GRID.shape).astype(np.float32))
    for direction in directions:
        up, down = (renderer.images(extinction + sign * direction).astype(float) for sign in (1, -1))
        difference = (up - down) / 2
        size = np.abs(direction).max() if np.count_nonzero(direction) == 1 else np.linalg.norm(direction)
        error = abs(dot(gradient, direction) - dot(difference, weights))
        assert error < 1e-3 * np.abs(gradient).max() * size
    # All pixels, for the last direction.
    error = np.linalg.norm(renderer.jvp(extinction, direction) - difference)
    assert error < 2e-3 * np.linalg.norm(difference)


@pytest.mark.parametrize("case", CASES)
def test_one_product_is_the_transpose_of_the_other(case):
    renderer, extinction = made(case)
    random = np.random.default_rng(2)
    for _ in range(3):
        direction = random.standard_normal(GRID.shape).astype(np.float32)
        cotangent = random.standard_normal(renderer.shape).astype(np.float32)
        change = renderer.jvp(extinction, direction)
        forward, backward = dot(change, cotangent), dot(direction, renderer.vjp(extinction, cotangent))
        assert abs(forward - backward) < 1e-5 * np.sqrt(dot(change, change) * dot(cotangent, cotangent))


def test_the_images_are_those_of_render():
    renderer, extinction = made("above snow", expected=20.0, accuracy=None, tolerance=None)
    thick = np.where(extinction > 0, 20.0 + 0.0 * extinction, 0.0)
    options = {"solver": "ordinates", "estimate_error": False}
    expected = deepct.render(thick, GRID, renderer.views, renderer.light, **options).radiance
    np.testing.assert_allclose(renderer.images(thick), expected, rtol=1e-3)


def test_only_the_mask_counts():
    renderer, extinction = made("at the sides", mask=CASES["thick"][0] > 0)
    inside = np.where(renderer.mask, extinction, 0)
    np.testing.assert_allclose(renderer.images(extinction), renderer.images(inside), rtol=1e-5)
    gradient = renderer.vjp(extinction, np.ones(renderer.shape))
    assert (gradient[~renderer.mask] == 0).all() and (gradient[renderer.mask] != 0).all()


def test_results_do_not_depend_on_what_was_asked_before():
    for warm in (False, True):
        renderer, extinction = made("thick", warm_start=warm)
        cotangent = np.ones(renderer.shape, np.float32)
        first = renderer.vjp(extinction, cotangent)
        renderer.images(0.5 * extinction)
        for _ in range(2):
            again = renderer.vjp(extinction, cotangent)
            np.testing.assert_allclose(again, first, atol=1e-4 * np.abs(first).max() * warm)


def test_a_renderer_is_copied_and_pickled():
    renderer, extinction = made("thin")
    images = renderer.images(extinction)
    for other in (copy.copy(renderer), pickle.loads(pickle.dumps(renderer))):
        assert other == renderer and other.cells == renderer.cells and other.nbytes > 0
        assert np.array_equal(other.images(extinction), images)


def test_threads_share_a_renderer():
    renderer, extinction = made("thin", tolerance=1e-4)
    expected = {share: copy.copy(renderer).images(share * extinction) for share in (0.5, 1.0)}
    wrong = []

    def use(share):
        for _ in range(5):
            if not np.allclose(renderer.images(share * extinction), expected[share], rtol=1e-3):
                wrong.append(share)

    threads = [threading.Thread(target=use, args=(share,)) for share in (0.5, 1.0) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_wrong_arguments_are_refused():
    renderer, extinction = made("thin")
    one = np.ones(renderer.shape)
    missing = np.where(one > 0, np.nan, one)
    for message, wrong in [
        ("extinction is -2", lambda: renderer.images(extinction - 2.0)),
        ("shape", lambda: renderer.images(extinction[1:])),
        ("shape .view, row, col. of the cotangent", lambda: renderer.vjp(extinction, one[1:])),
        ("cotangent.*0 for pixels that are left out", lambda: renderer.vjp(extinction, missing)),
        ("direction", lambda: renderer.jvp(extinction, np.full(GRID.shape, np.inf))),
        ("shape", lambda: renderer.jvp(extinction, extinction[1:])),
        ("accuracy", lambda: made("thin", accuracy=1.0)),
        ("tolerance", lambda: made("thin", tolerance=0.0)),
        ("mask has no voxels", lambda: made("thin", mask=extinction < 0)),
        ("expected", lambda: made("thin", expected=-1.0)),
    ]:
        with pytest.raises(ValueError, match=message):
            wrong()
    thick = deepct.Renderer(GRID, views(), expected=1.0, mask=extinction > 0, accuracy=0.05)
    with pytest.warns(UserWarning, match="voxels are too thick"):
        thick.images(np.full(GRID.shape, 500.0))


def test_monte_carlo_differences():
    """Sums over the cloud, against differences of images of the same photon paths."""
    extinction, light = blob(25.0, 0.5), deepct.Light(surface_albedo=0.05)
    extinction = np.where(extinction > 3.0, extinction, 0).astype(np.float32)
    cameras = views((8, 8))
    renderer = deepct.Renderer(GRID, cameras, light, mask=extinction > 0, expected=extinction)
    change = renderer.jvp(extinction, extinction).sum()
    up, down = (
        deepct.render(scale * extinction, GRID, cameras, light, samples=40_000, seed=3).radiance
        for scale in (1.1, 0.9)
    )
    difference = (up - down).sum() / 0.2
    assert abs(change / difference - 1) < 0.05, (change, difference)


def test_the_derivative_as_a_linear_operator():
    linalg = pytest.importorskip("scipy.sparse.linalg")
    import deepct_py.scipy

    renderer, extinction = made("thin", tolerance=1e-4)
    operator = deepct_py.scipy.derivative(renderer, extinction)
    assert operator.shape == (np.prod(renderer.shape), np.prod(GRID.shape))
    direction = (0.1 * extinction).ravel()
    np.testing.assert_array_equal(
        operator @ direction, renderer.jvp(extinction, direction.reshape(GRID.shape)).ravel()
    )
    # A change of the extinction follows from that of the images.
    found = linalg.lsmr(operator, operator @ direction, maxiter=12)[0]
    residual = np.linalg.norm(operator @ found - operator @ direction)
    assert residual < 0.03 * np.linalg.norm(operator @ direction)


def test_optional_libraries_are_not_imported():
    """`deepct_py` needs none of them, and the module of one not another."""
    for module, forbidden in [
        ("deepct_py", "torch jax scipy"),
        ("deepct_py.torch", "jax"),
        ("deepct_py.jax", "torch"),
        ("deepct_py.scipy", "torch jax"),
    ]:
        pytest.importorskip(module.split(".")[-1])
        script = (
            "import sys\n"
            f"for name in {forbidden!r}.split():\n"
            "    sys.modules[name] = None\n"
            f"import {module}\n"
        )
        subprocess.run([sys.executable, "-c", script], check=True)


@pytest.fixture
def small():
    """A renderer and a batch of two extinctions, of few voxels."""
    renderer, extinction = made("at the sides", mask=blob(1.0, 0.25) > 0)
    extinction = np.where(renderer.mask, extinction, 0)
    return renderer, np.stack([extinction, 0.5 * extinction])


def test_torch_has_derivatives_in_both_modes(small):
    torch = pytest.importorskip("torch")
    import deepct_py.torch

    renderer, batch = small
    images = deepct_py.torch.Images(renderer)
    where = torch.from_numpy(renderer.mask)

    def of_mask(values):
        return images(torch.zeros(GRID.shape, dtype=values.dtype).masked_scatter(where, values))

    # Radiances are in single precision, so that steps are large.
    values = torch.from_numpy(batch[0][renderer.mask]).double().requires_grad_()
    assert torch.autograd.gradcheck(
        of_mask, values, eps=1.0, rtol=1e-3, atol=1e-6, check_forward_ad=True
    )


def test_torch_computes_batches(small):
    torch = pytest.importorskip("torch")
    import deepct_py.torch

    renderer, batch = small
    images = deepct_py.torch.Images(renderer)
    extinction = torch.from_numpy(batch).requires_grad_()
    radiance = images(extinction)
    assert radiance.shape == (2, *renderer.shape) and radiance.dtype == torch.float32
    (radiance**2).sum().backward()
    mapped = torch.func.vmap(torch.func.grad(lambda one: (images(one) ** 2).sum()))(extinction.detach())
    for number, one in enumerate(batch):
        expected = renderer.images(one)
        np.testing.assert_allclose(radiance[number].detach(), expected, rtol=1e-4)
        gradient = renderer.vjp(one, 2 * expected)
        close = {"atol": 1e-4 * np.abs(gradient).max()}
        np.testing.assert_allclose(extinction.grad[number], gradient, **close)
        np.testing.assert_allclose(mapped[number], gradient, **close)
    other = deepct.Renderer(GRID, views(), deepct.Light(sun=(60, 200)), mask=renderer.mask, tolerance=1e-6)
    both = deepct_py.torch.Images([renderer, other])(extinction.detach())
    np.testing.assert_allclose(both[1], other.images(batch[1]), rtol=1e-4)
    for wrong in (extinction[0, 1:], extinction[0, None]):
        with pytest.raises(ValueError, match="the extinction|the shape"):
            (images if wrong.ndim == 3 else deepct_py.torch.Images([renderer, other]))(wrong)
    with pytest.raises(NotImplementedError, match="second derivatives"):
        (gradient,) = torch.autograd.grad((images(extinction[0]) ** 2).sum(), extinction, create_graph=True)
        gradient.sum().backward()


def test_jax_compiles_and_maps(small):
    jax = pytest.importorskip("jax")
    import deepct_py.jax
    from jax.test_util import check_grads

    renderer, batch = small
    images = deepct_py.jax.images(renderer)

    def loss(extinction):
        return (images(extinction) ** 2).sum()

    direct = jax.grad(loss)(batch[0])
    expected = renderer.vjp(batch[0], 2 * renderer.images(batch[0]))
    close = {"atol": 1e-4 * np.abs(expected).max()}
    np.testing.assert_allclose(direct, expected, **close)
    np.testing.assert_allclose(jax.jit(jax.grad(loss))(batch[0]), expected, **close)
    mapped = jax.jit(jax.vmap(jax.value_and_grad(loss)))(batch)
    np.testing.assert_allclose(mapped[1][0], expected, **close)
    np.testing.assert_allclose(mapped[0][1], (renderer.images(batch[1]) ** 2).sum(), rtol=1e-4)
    np.testing.assert_allclose(images(batch)[1], renderer.images(batch[1]), rtol=1e-4)
    inside = np.flatnonzero(renderer.mask)

    def of_mask(values):
        return images(jax.numpy.zeros(renderer.mask.size).at[inside].set(values).reshape(GRID.shape))

    check_grads(of_mask, (batch[0].ravel()[inside],), order=1, modes=["rev"], eps=1.0, rtol=5e-3, atol=1e-5)
