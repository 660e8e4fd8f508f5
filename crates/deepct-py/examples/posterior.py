"""How well is a cloud known? Samples of the posterior by Langevin steps with momentum.

    python posterior.py [FOLDER]

writes a figure to FOLDER (by default the current one). It needs PyTorch and matplotlib. A sample starts from
the one before with a random momentum and follows the gradient of the logarithm of the posterior for several
steps, in coordinates in which the covariance that the derivatives of the images give is the unit matrix; a
Metropolis test accepts it (Hamiltonian Monte Carlo, Neal 2011; with a single step, these are Langevin steps,
of which several times as many are needed). The spread of the samples is compared with the error of their mean.
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import torch

import deepct_py
import deepct_py.torch

matplotlib.use("agg")
from matplotlib import pyplot  # noqa: E402

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
random = torch.Generator().manual_seed(1)

# Images of five views with an error of 2 %, by the same solver, so that the posterior is exact.
grid = deepct_py.Grid((16, 16, 16), (0.05, 0.05, 0.04), (-0.4, -0.4, 0.5))
cloud = deepct_py.generate_cloud(grid, seed=3, width_km=0.4)
mask = torch.from_numpy(cloud.extinction > 0.0)
views = deepct_py.Views.load("cloudct-10", grid.center, (16, 16))[::2]
# At the tolerance that belongs to this accuracy, images would be wrong by as much as half of their error.
renderer = deepct_py.Renderer(
    grid, views, mask=mask.numpy(), expected=cloud, accuracy=0.03, tolerance=1e-4
)
seen = deepct_py.torch.Images(renderer)
truth = torch.from_numpy(cloud.extinction)
error = 0.02 * seen(truth)
measured = seen(truth) + error * torch.randn(error.shape, generator=random)

# The prior: the logarithm of the extinction in a voxel is normally distributed.
MEAN, WIDTH = 3.3, 0.6


def energy_and_slope(unknown: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Minus the logarithm of the posterior, and its gradient."""
    point = unknown.clone().requires_grad_()
    extinction = torch.zeros(mask.shape).masked_scatter(mask, point.exp())
    misfit = ((seen(extinction) - measured) / error).square().sum()
    energy = 0.5 * misfit + 0.5 * ((point - MEAN) / WIDTH).square().sum()
    (gradient,) = torch.autograd.grad(energy, point)
    return energy.detach(), gradient


def covariance(unknown: torch.Tensor) -> torch.Tensor:
    """Covariance of the posterior if the images were linear, from one derivative for each voxel."""
    point = np.zeros(mask.shape, np.float32)
    point[mask] = unknown.exp()
    columns = []
    for voxel in np.argwhere(mask.numpy()):
        direction = np.zeros(mask.shape, np.float32)
        direction[tuple(voxel)] = point[tuple(voxel)]
        columns.append(torch.from_numpy(renderer.jvp(point, direction)) / error)
    jacobian = torch.stack(columns).flatten(1)
    inverse: torch.Tensor = torch.linalg.inv(jacobian @ jacobian.T + torch.eye(len(columns)) / WIDTH**2)
    return inverse


# The most likely cloud first, by a few Gauss-Newton steps.
unknown = torch.full((int(mask.sum()),), MEAN)
for _ in range(4):
    scale = covariance(unknown)
    unknown = unknown - (scale @ energy_and_slope(unknown)[1]).clamp(-1.0, 1.0)

# Then samples around it, each of which is accepted with the probability that keeps the posterior.
SAMPLES, STEPS, SIZE = 40, 8, 0.18
factor = torch.linalg.cholesky(scale)
energy, gradient = energy_and_slope(unknown)
samples, accepted = [], 0
for _ in range(SAMPLES):
    momentum = torch.randn(unknown.shape, generator=random)
    before = energy + 0.5 * momentum.square().sum()
    other, other_energy, other_gradient = unknown, energy, gradient
    for _ in range(STEPS):
        momentum = momentum - 0.5 * SIZE * factor.T @ other_gradient
        other = other + SIZE * factor @ momentum
        other_energy, other_gradient = energy_and_slope(other)
        momentum = momentum - 0.5 * SIZE * factor.T @ other_gradient
    after = other_energy + 0.5 * momentum.square().sum()
    if torch.rand((), generator=random).log() < before - after:
        unknown, energy, gradient = other, other_energy, other_gradient
        accepted += 1
    samples.append(unknown.exp())

# The first ones still depend on the start.
drawn = torch.stack(samples[SAMPLES // 8 :])
mean, spread = drawn.mean(0), drawn.std(0)
missed = (mean - truth[mask]).abs()
inside = (missed < 2.0 * spread).float().mean().item()
print(f"{accepted} of {SAMPLES} samples were accepted")
print(f"epsilon of the mean {(missed.sum() / truth.sum()).item():.3f}")
print(f"error {missed.square().mean().sqrt().item():.1f}, spread {spread.square().mean().sqrt().item():.1f} /km")
print(f"{inside:.0%} of the voxels are within twice the spread")

pyplot.figure(figsize=(5, 4), layout="constrained")
pyplot.scatter(spread, missed, s=8)
end = 1.05 * max(spread.max().item(), missed.max().item())
pyplot.plot([0, end], [0, end], "k-", [0, end / 2], [0, end], "k--", linewidth=0.7)
pyplot.xlabel("spread of the samples (1/km)")
pyplot.ylabel("error of their mean (1/km)")
pyplot.savefig(folder / "posterior.png", dpi=120)
