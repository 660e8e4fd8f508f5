"""Derivatives of the images: the renderer, and its functions for PyTorch, JAX and SciPy."""

import copy
import importlib.util
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

    # Central differences in both modes.
    options = {"order": 1, "modes": ["fwd", "rev"], "eps": 1.0, "rtol": 5e-3, "atol": 1e-5}
    check_grads(of_mask, (batch[0].ravel()[inside],), **options)


def test_jax_has_forward_mode(small):
    jax = pytest.importorskip("jax")
    import deepct_py.jax

    renderer, batch = small
    images = deepct_py.jax.images(renderer)
    direction = (0.1 * batch[0]).astype(np.float32)
    expected = renderer.jvp(batch[0], direction)
    close = {"atol": 1e-5 * np.abs(expected).max()}

    def forward(extinction):
        return jax.jvp(images, (extinction,), (direction,))

    radiance, change = forward(batch[0])
    np.testing.assert_allclose(radiance, renderer.images(batch[0]), rtol=1e-5)
    np.testing.assert_allclose(change, expected, **close)
    np.testing.assert_allclose(jax.jit(forward)(batch[0])[1], expected, **close)
    mapped = jax.jit(jax.vmap(forward))(batch)[1]
    np.testing.assert_allclose(mapped[0], expected, **close)
    np.testing.assert_allclose(mapped[1], renderer.jvp(batch[1], direction), **close)
    _, along = jax.linearize(images, batch[0])
    np.testing.assert_allclose(along(direction), expected, **close)
    several = jax.vmap(along)(np.stack([direction, -2 * direction]))
    np.testing.assert_allclose(several[1], -2 * expected, **close)
    # One mode is the transpose of the other.
    cotangent = np.random.default_rng(1).standard_normal(renderer.shape).astype(np.float32)
    (back,) = jax.linear_transpose(along, direction)(cotangent)
    np.testing.assert_allclose(back, renderer.vjp(batch[0], cotangent), atol=1e-5 * np.abs(back).max())
    assert abs(dot(np.asarray(back), direction) - dot(expected, cotangent)) < 1e-5 * np.sqrt(
        dot(expected, expected) * dot(cotangent, cotangent)
    )
    # The derivative of a function of the change, and the product of Gauss and Newton.
    half = jax.grad(lambda d: 0.5 * (jax.jvp(images, (batch[0],), (d,))[1] ** 2).sum())(direction)
    np.testing.assert_allclose(half, renderer.vjp(batch[0], expected), atol=1e-4 * np.abs(half).max())
    with pytest.raises(NotImplementedError, match="second derivatives"):
        jax.hessian(lambda extinction: (images(extinction) ** 2).sum())(batch[0])
    with pytest.raises(ValueError, match="the extinction has the shape"):
        images(batch[0, 1:])


DROPLETS = deepct.Light(phase="mie", extinction="mie", wavelength=2.13, surface_albedo=0.05)


@pytest.fixture(scope="module")
def droplets():
    """A renderer of extinction and effective radius, and both."""
    extinction = blob(40.0, 0.4)
    settings = {"accuracy": 0.03, "tolerance": 3e-7, "warm_start": False}
    renderer = deepct.Renderer(
        GRID, views(), DROPLETS, mask=extinction > 0, expected=extinction, **settings
    )
    radius = (7.3 + 4.0 * np.random.default_rng(3).random(GRID.shape)).astype(np.float32)
    return renderer, extinction, radius


def test_extinction_and_radius_have_their_derivatives(droplets):
    renderer, extinction, radius = droplets
    random = np.random.default_rng(1)
    images = renderer.images(extinction, radius)
    weights = random.uniform(0.5, 1.5, renderer.shape).astype(np.float32)
    by_extinction, by_radius = renderer.vjp(extinction, weights, radius)
    assert (by_radius[extinction == 0] == 0).all() and (by_radius[extinction > 10] != 0).all()
    for _ in range(3):
        # Short, as the derivative changes at the nodes of the table of droplet optics.
        direction = 0.05 * random.uniform(0, 1, GRID.shape).astype(np.float32)
        up, down = (renderer.images(extinction, radius + sign * direction) for sign in (1, -1))
        difference = dot(up.astype(float) - down, weights) / 2
        assert abs(dot(by_radius, direction) / difference - 1) < 0.01
        direction = 0.05 * extinction * random.uniform(0, 1, GRID.shape).astype(np.float32)
        up, down = (renderer.images(extinction + sign * direction, radius) for sign in (1, -1))
        difference = (up.astype(float) - down) / 2
        assert abs(dot(by_extinction, direction) / dot(difference, weights) - 1) < 1e-3
        change = renderer.jvp(extinction, direction, radius)
        assert np.linalg.norm(change - difference) < 2e-3 * np.linalg.norm(difference)
    # The operator of SciPy, at constant radius.
    if importlib.util.find_spec("scipy"):
        import deepct_py.scipy

        operator = deepct_py.scipy.derivative(renderer, extinction, radius)
        np.testing.assert_array_equal(operator @ direction.ravel(), change.ravel())
        np.testing.assert_array_equal(operator.T @ weights.ravel(), by_extinction.ravel())
    # One radius in all voxels is that of a light.
    settings = {"accuracy": 0.03, "tolerance": 3e-7, "expected": extinction}
    prescribed = DROPLETS.replace(effective_radius=8.0)
    other = deepct.Renderer(GRID, views(), prescribed, mask=extinction > 0, **settings)
    eight = renderer.images(extinction, np.full(GRID.shape, 8.0))
    np.testing.assert_allclose(eight, other.images(extinction), rtol=0.01)
    assert not np.allclose(images, eight, rtol=0.01)
    # A cloud states its droplets.
    water = extinction / DROPLETS.extinction_per_water(radius)[0]
    cloud = deepct.Cloud(GRID, liquid_water_content=water, effective_radius=radius)
    np.testing.assert_allclose(renderer.images(cloud), images, rtol=1e-3)
    for message, wrong in [
        ("effective_radius is missing", lambda: renderer.images(extinction)),
        ("has no effect", lambda: other.images(extinction, radius)),
        ("shape", lambda: renderer.vjp(extinction, weights, radius[1:])),
        ("beyond|table", lambda: renderer.images(extinction, 0 * radius + 90)),
    ]:
        with pytest.raises(ValueError, match=message):
            wrong()


def test_the_extinction_of_water():
    """By hand in the geometric limit, and by central differences of Mie theory."""
    radius = np.array([5.2, 8.3, 12.4, 20.0], np.float32).reshape(1, 2, 2)
    value, slope = deepct.Light().extinction_per_water(radius)
    np.testing.assert_allclose(value, 1500 / radius, rtol=1e-6)
    np.testing.assert_allclose(slope, -1500 / radius**2, rtol=1e-6)
    value, slope = DROPLETS.extinction_per_water(radius)
    up, down = (DROPLETS.extinction_per_water(radius + step)[0] for step in (0.01, -0.01))
    np.testing.assert_allclose(slope, (up - down) / 0.02, rtol=5e-3)
    grid = deepct.Grid((1, 2, 2), (0.05, 0.05, 0.04))
    cloud = deepct.Cloud(grid, liquid_water_content=0 * radius + 0.3, effective_radius=radius)
    found = deepct.Renderer(grid, "cloudct-10", DROPLETS).light.extinction_per_water(cloud.effective_radius)
    np.testing.assert_allclose(found[0], value)
    for wrong in (0.0, -1.0, np.nan, 90.0):
        with pytest.raises(ValueError, match="effective radius"):
            DROPLETS.extinction_per_water(np.full((1, 1, 1), wrong))


def test_torch_differentiates_by_water_and_radius(droplets):
    torch = pytest.importorskip("torch")
    import deepct_py.torch

    renderer, extinction, radius = droplets
    images = deepct_py.torch.Images(renderer)
    per_water, slope = DROPLETS.extinction_per_water(radius)
    water = torch.from_numpy(extinction / per_water).requires_grad_()
    radii = torch.from_numpy(radius).requires_grad_()
    radiance = images(water * deepct_py.torch.extinction_per_water(DROPLETS, radii), radii)
    (radiance**2).sum().backward()
    again = renderer.images(water.detach().numpy() * per_water, radius)
    np.testing.assert_allclose(radiance.detach(), again, rtol=1e-5)
    by_extinction, by_radius = renderer.vjp(water.detach().numpy() * per_water, 2 * again, radius)
    expected = by_radius + by_extinction * water.detach().numpy() * slope
    np.testing.assert_allclose(water.grad, by_extinction * per_water, atol=1e-4 * water.grad.abs().max())
    np.testing.assert_allclose(radii.grad, expected, atol=1e-4 * np.abs(expected).max())
    point = (torch.from_numpy(extinction), torch.from_numpy(radius))
    still = torch.zeros_like(point[1])
    change = torch.func.jvp(images, point, (point[0], still))[1]
    np.testing.assert_allclose(change, renderer.jvp(extinction, extinction, radius), rtol=1e-4, atol=1e-7)
    with pytest.raises(NotImplementedError, match="reverse mode only"):
        torch.func.jvp(images, point, (point[0], point[1]))
    mapped = torch.func.vmap(lambda r: deepct_py.torch.extinction_per_water(DROPLETS, r))(point[1])
    np.testing.assert_allclose(mapped, per_water)
    turned = torch.func.jvp(lambda r: deepct_py.torch.extinction_per_water(DROPLETS, r), point[1:], point[1:])
    np.testing.assert_allclose(turned[1], slope * radius, rtol=1e-5)
    with pytest.raises(ValueError, match="the effective radius has the shape"):
        images(point[0], point[1][1:])


def test_jax_differentiates_by_water_and_radius(droplets):
    jax = pytest.importorskip("jax")
    import deepct_py.jax

    renderer, extinction, radius = droplets
    images = deepct_py.jax.images(renderer)
    per_water, slope = DROPLETS.extinction_per_water(radius)
    water = (extinction / per_water).astype(np.float32)

    def loss(water, radius):
        found = water * deepct_py.jax.extinction_per_water(DROPLETS, radius)
        return (images(found, radius) ** 2).sum()

    by_water, by_radii = jax.jit(jax.grad(loss, (0, 1)))(water, radius)
    again = renderer.images(water * per_water, radius)
    by_extinction, by_radius = renderer.vjp(water * per_water, 2 * again, radius)
    expected = by_radius + by_extinction * water * slope
    np.testing.assert_allclose(by_water, by_extinction * per_water, atol=1e-4 * np.abs(by_water).max())
    np.testing.assert_allclose(by_radii, expected, atol=1e-4 * np.abs(expected).max())
    mapped = jax.vmap(jax.grad(loss, 1))(np.stack([water, water]), np.stack([radius, radius]))
    np.testing.assert_allclose(mapped[1], by_radii, atol=1e-4 * np.abs(expected).max())
    change = jax.jvp(lambda values: images(values, radius), (extinction,), (extinction,))[1]
    np.testing.assert_allclose(change, renderer.jvp(extinction, extinction, radius), rtol=1e-4, atol=1e-7)
    with pytest.raises(Exception, match="reverse mode only"):
        jax.block_until_ready(jax.jvp(lambda values: images(extinction, values), (radius,), (radius,)))
