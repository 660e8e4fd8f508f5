#!/usr/bin/env python3
"""Speed and accuracy of the derivatives of `deepct_py.Renderer`.

    python3 benches/derivatives.py rico55 TRUTH      a dense cloud of 43 x 43 x 43 voxels, nine views
    python3 benches/derivatives.py corrected TRUTH   the same cloud: fast images with a correction
    python3 benches/derivatives.py batch             eight scenes of 32 x 32 x 32 voxels, ten views
    python3 benches/derivatives.py differences       central differences, transposes

TRUTH is `truth_RICO_40m_80kmx80km_T_qc_30.0h_id055.nc` of HybridCT's validation. Times are those of the
wall clock and of all threads of the process (CPU), in seconds, as other programs may be running. A step is
the images and one vector-Jacobian product after a change of the extinction. The results are reported in
docs/guide/pages/derivatives.md.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Callable

import deepct_py as deepct
import numpy as np

VIEWS = Path(__file__).parent.parent / "recipes" / "misr-nine-views.toml"
STEPS = 5


def timed(what: str, work: Callable[[], object]) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    print(f"{what:42} {time.perf_counter() - wall:7.2f} s  CPU {time.process_time() - cpu:7.2f} s")


def steps(what: str, step: Callable[[float], object], scale: float) -> None:
    """The median of some steps, each of which changes the extinction by a share of `scale`."""
    random = np.random.default_rng(1)
    times = []
    for _ in range(STEPS):
        change = 1.0 + scale * random.standard_normal()
        wall, cpu = time.perf_counter(), time.process_time()
        step(change)
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    wall, cpu = np.median(times, axis=0)
    print(f"{what:42} {wall:7.2f} s  CPU {cpu:7.2f} s")


def rico_cloud(truth: Path) -> tuple[np.ndarray, dict[float, deepct.Renderer]]:
    """The extinction of the cloud, and its renderers by their accuracy."""
    import h5py

    with h5py.File(truth) as file:
        # The first level only fills the space between the surface and the cloud.
        extinction = np.nan_to_num(file["extinction"][...])[:, :, 1:].transpose(2, 1, 0)
    extinction = np.ascontiguousarray(extinction, np.float32)
    grid = deepct.Grid(extinction.shape, (0.04, 0.04, 0.04), (0.0, 0.0, 1.0))
    light = deepct.Light(sun=(45.73, 140), surface_albedo=0, phase="mie", effective_radius=10)
    views = deepct.Views.load(VIEWS, grid.center, (120, 60))
    mask = extinction > 0
    print(f"{mask.sum()} voxels of {mask.size}, up to {extinction.max():.0f} /km")
    options = {"mask": mask, "expected": extinction}
    renderers = {
        accuracy: deepct.Renderer(grid, views, light, accuracy=accuracy, **options)
        for accuracy in (0.03, 0.01)
    }
    return extinction, renderers


def corrected(truth: Path) -> None:
    extinction, renderers = rico_cloud(truth)
    fast, accurate = renderers[0.03], renderers[0.01]
    correction = accurate.images(extinction) - fast.images(extinction)
    random = np.random.default_rng(0)
    uneven = (1 + 0.2 * random.standard_normal(extinction.shape)).clip(0).astype(np.float32)
    print("differences from the accurate images: rms of bright pixels, and sum of all, relative")
    for name, factor in [("10 % less", 0.9), ("20 % in each voxel", uneven), ("30 % less", 0.7)]:
        right, quick = accurate.images(factor * extinction), fast.images(factor * extinction)
        bright = right > 0.5 * right.max(axis=(1, 2), keepdims=True)
        for kind, images in [("fast", quick), ("corrected", quick + correction)]:
            relative = (images - right)[bright] / right[bright]
            rms, total = np.sqrt((relative**2).mean()), np.abs(images - right).sum() / right.sum()
            print(f"{name:20} {kind:10} {rms:7.1%} {total:7.1%}")


def rico55(truth: Path) -> None:
    extinction, renderers = rico_cloud(truth)
    for accuracy, renderer in renderers.items():
        print(f"accuracy {accuracy}: {renderer.cells} cells, {renderer.nbytes / 1e6:.0f} MB")
        weights = np.ones(renderer.shape, np.float32)
        timed("first images", lambda: renderer.images(extinction))
        timed("first derivative", lambda: renderer.vjp(extinction, weights))
        timed("derivative in a direction", lambda: renderer.jvp(extinction, extinction))

        def step(change: float) -> None:
            images = renderer.images(change * extinction)
            renderer.vjp(change * extinction, images)

        for share in (0.05, 0.01):
            steps(f"step of {share:.0%}", step, share)


def batch() -> None:
    import torch

    import deepct_py.torch

    grid = deepct.Grid((32, 32, 32), (0.05, 0.05, 0.04), (-0.8, -0.8, 0.5))
    clouds = [deepct.generate_cloud(grid, seed=seed, width_km=0.8).extinction for seed in range(1, 9)]
    print("voxels:", *((cloud > 0).sum() for cloud in clouds))
    for accuracy in (0.03, 0.01):
        options = {"accuracy": accuracy}
        renderers = [
            deepct.Renderer(grid, "cloudct-10", mask=cloud > 0, expected=cloud, **options) for cloud in clouds
        ]
        images = deepct_py.torch.Images(renderers)
        stack = torch.from_numpy(np.stack(clouds))

        def step(change: float) -> None:
            extinction = (change * stack).requires_grad_()
            (images(extinction) ** 2).sum().backward()

        timed(f"accuracy {accuracy}: first step", lambda: step(1.0))
        for share in (0.05, 0.01):
            steps(f"step of {share:.0%}", step, share)


def differences() -> None:
    grid = deepct.Grid((8, 10, 10), (0.05, 0.05, 0.04), (-0.25, -0.25, 0.5))
    axes = np.meshgrid(grid.z, grid.y, grid.x, indexing="ij")
    distance = np.sqrt(sum(((a - a.mean()) / (a.max() - a.min())) ** 2 for a in axes))
    uneven = 0.6 + np.random.default_rng(5).random(grid.shape)
    print("largest error of central differences, over the largest derivative, and of the transpose")
    for tolerance in (1e-4, 3e-7):
        for name, peak, reach, light in [
            ("thin", 2.0, 0.5, {}),
            ("thick", 120.0, 0.5, {"phase": "mie", "effective_radius": 10}),
            ("touching the sides", 40.0, 2.0, {}),
            ("periodic", 40.0, 2.0, {"periodic": True, "surface_albedo": 0.3}),
            ("above snow", 40.0, 0.5, {"surface_albedo": 0.8, "air": True}),
        ]:
            extinction = (peak * np.clip(1 - distance / reach, 0, None) * uneven).astype(np.float32)
            views = deepct.Views.load("cloudct-10", grid.center, (12, 12))
            renderer = deepct.Renderer(
                grid, views, deepct.Light(**light), mask=extinction > 0, expected=extinction,
                accuracy=0.03, tolerance=tolerance, warm_start=False,
            )
            random = np.random.default_rng(1)
            weights = random.uniform(0.5, 1.5, renderer.shape).astype(np.float32)
            gradient = renderer.vjp(extinction, weights).astype(float)
            inside = np.argwhere(extinction > 0.1 * extinction.max())
            error = 0.0
            for voxel in inside[random.choice(len(inside), min(20, len(inside)), replace=False)]:
                direction = np.zeros(grid.shape, np.float32)
                direction[tuple(voxel)] = 0.03 * extinction.max()
                up, down = (
                    (renderer.images(extinction + sign * direction).astype(float) * weights).sum()
                    for sign in (1.0, -1.0)
                )
                found = (up - down) / (2.0 * direction.max())
                error = max(error, abs(gradient[tuple(voxel)] - found) / np.abs(gradient).max())
            x = random.standard_normal(grid.shape).astype(np.float32)
            y = random.standard_normal(renderer.shape).astype(np.float32)
            change = renderer.jvp(extinction, x).astype(float)
            back = (renderer.vjp(extinction, y).astype(float) * x).sum()
            transpose = abs((change * y).sum() - back) / np.linalg.norm(change) / np.linalg.norm(y)
            print(f"tolerance {tolerance:.0e}  {name:20} {error:.1e}  {transpose:.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    of_cloud = {"rico55": rico55, "corrected": corrected}
    others = {"batch": batch, "differences": differences}
    parser.add_argument("what", choices=[*of_cloud, *others])
    parser.add_argument("truth", type=Path, nargs="?")
    arguments = parser.parse_args()
    if arguments.what in of_cloud:
        of_cloud[arguments.what](arguments.truth or parser.error(f"{arguments.what} needs TRUTH"))
    else:
        others[arguments.what]()


if __name__ == "__main__":
    main()
