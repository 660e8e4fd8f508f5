"""A deep prior: a network that has seen no other cloud explains the images of this one.

    python deep_prior.py [FOLDER]

writes a figure to FOLDER (by default the current one). It needs PyTorch. The extinction is the output of a
small convolutional network for a fixed random input (Ulyanov, Vedaldi and Lempitsky 2018). Its parameters
are fitted to the images; the network finds smooth clouds before it finds noise.
"""

import sys
from pathlib import Path

import torch
from torch import nn

import deepct_py
import deepct_py.torch

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
torch.manual_seed(1)

# Noisy images of a cloud by the Monte Carlo solver, and the voxels that may contain it.
grid = deepct_py.Grid((16, 16, 16), (0.05, 0.05, 0.04), (-0.4, -0.4, 0.5))
cloud = deepct_py.generate_cloud(grid, seed=3, width_km=0.5)
views = deepct_py.Views.load("cloudct-10", grid.center, (16, 16))
images = deepct_py.sense(deepct_py.render(cloud, views=views, samples=256), "cmv4000")
carved = deepct_py.carve(images, grid=grid)
assert images.standard_error is not None

renderer = deepct_py.Renderer(
    grid, views, images.light, mask=carved, expected=60.0, accuracy=0.03
)
seen = deepct_py.torch.Images(renderer)
measured = torch.from_numpy(images.radiance)
error = torch.hypot(torch.from_numpy(images.standard_error), 0.02 * measured)

# One channel of the input is the mask, which tells the network where the cloud is.
mask = torch.from_numpy(carved.mask).float()
noise = torch.cat([torch.randn(1, 7, *mask.shape), mask[None, None]], 1)
layers: list[nn.Module] = []
for inputs in (8, 24, 24):
    layers += [nn.Conv3d(inputs, 24, 3, padding=1), nn.GroupNorm(4, 24), nn.SiLU()]
network = nn.Sequential(*layers, nn.Conv3d(24, 1, 1), nn.Softplus())

optimiser = torch.optim.Adam(network.parameters(), lr=0.02)
for step in range(100):
    extinction = 30.0 * network(noise)[0, 0] * mask
    misfit = ((seen(extinction) - measured) / error).square().mean()
    optimiser.zero_grad()
    misfit.backward()
    optimiser.step()
    if step % 10 == 9:
        epsilon = deepct_py.score(cloud, extinction.detach()).relative_error
        print(f"step {step + 1}: misfit {misfit.item():.2f}, epsilon {epsilon:.2f}")

deepct_py.plot(
    extinction.detach().numpy(), cloud, title="Deep prior", grid=grid, out=folder / "deep_prior.png"
)
