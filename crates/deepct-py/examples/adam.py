"""A cloud from its images by an optimiser of PyTorch.

    python adam.py [FOLDER]

writes a figure to FOLDER (by default the current one). It needs PyTorch. `deepct_py.invert` does the same
with a method made for it; here the misfit, the unknowns and the optimiser are yours.
"""

import sys
from pathlib import Path

import torch

import deepct_py
import deepct_py.torch

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# Noisy images of a cloud by the Monte Carlo solver, and the voxels that may contain it.
grid = deepct_py.Grid((16, 16, 16), (0.05, 0.05, 0.04), (-0.4, -0.4, 0.5))
cloud = deepct_py.generate_cloud(grid, seed=3, width_km=0.5)
views = deepct_py.Views.load("cloudct-10", grid.center, (16, 16))
images = deepct_py.sense(deepct_py.render(cloud, views=views, samples=256), "cmv4000")
carved = deepct_py.carve(images, grid=grid)
assert images.standard_error is not None

# The renderer is exact to about a hundredth, which counts as an error of the images as well.
renderer = deepct_py.Renderer(
    grid, views, images.light, mask=carved, expected=60.0, accuracy=0.03
)
seen = deepct_py.torch.Images(renderer)
measured = torch.from_numpy(images.radiance)
error = torch.hypot(torch.from_numpy(images.standard_error), 0.02 * measured)

# The logarithm of the extinction in each voxel of the mask. Neighbours differ by about 20 per km.
mask = torch.from_numpy(carved.mask)
unknown = torch.full((int(mask.sum()),), 1.0, requires_grad=True)
optimiser = torch.optim.Adam([unknown], lr=0.2)
for step in range(60):
    extinction = torch.zeros(mask.shape).masked_scatter(mask, unknown.exp())
    misfit = ((seen(extinction) - measured) / error).square().mean()
    steps = [extinction.diff(dim=axis).square().sum() for axis in range(3)]
    optimiser.zero_grad()
    (misfit + sum(steps) / 20.0**2 / measured.numel()).backward()
    optimiser.step()
    if step % 10 == 9:
        epsilon = deepct_py.score(cloud, extinction.detach()).relative_error
        print(f"step {step + 1}: misfit {misfit.item():.2f}, epsilon {epsilon:.2f}")

deepct_py.plot(extinction.detach().numpy(), cloud, title="Adam", grid=grid, out=folder / "adam.png")
