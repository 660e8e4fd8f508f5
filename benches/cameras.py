#!/usr/bin/env python3
"""Cameras that look up or stand inside the scene: discrete ordinates against Monte Carlo.

    python3 benches/cameras.py views     # means of views below, beside and in a cloud
    python3 benches/cameras.py aureole   # pixels by their angle from the Sun
    python3 benches/cameras.py iprt      # the cube cloud of IPRT (phase B, C2) by both solvers

`aureole` splits the view into pixels further than the 12 degrees from the Sun that discrete ordinates
accept. Needs numpy and deepct_py.
"""

from __future__ import annotations

import argparse

import numpy as np

import deepct_py
from deepct_py import Grid, Light, View

CASES = [
    (1, 20, 140, 0, 0.003275), (2, 20, 140, 60, 0.004203), (3, 20, 140, 120, 0.006524),
    (4, 20, 140, 180, 0.008527), (5, 40, 0, 0, 0.049392), (6, 40, 40, 0, 0.052328),
    (7, 40, 40, 60, 0.049915), (8, 40, 40, 120, 0.049162), (9, 40, 40, 180, 0.049208),
]
"""Number, solar zenith, view zenith and relative azimuth (degrees) of IPRT's cases, mean intensity."""

SUN = (40.0, 75.0)


def ball() -> tuple[np.ndarray, Grid]:
    k, j, i = np.indices((10, 12, 12))
    inside = ((k - 5) / 2.2) ** 2 + ((j - 5.5) / 2.5) ** 2 + ((i - 5.5) / 2.5) ** 2 < 1
    grid = Grid((10, 12, 12), (0.05, 0.05, 0.05), (0.0, 0.0, 0.5))
    return np.where(inside, 25.0, 0.0).astype(np.float32), grid


def both(extinction, grid, view, light, samples=20_000, **arguments):
    """The images of both solvers and the standard error of the first."""
    paths = deepct_py.render(
        extinction, grid, [view], light, samples=samples, **arguments)
    ordinates = deepct_py.render(
        extinction, grid, [view], light, solver="ordinates", accuracy=0.003, **arguments)
    images = [np.asarray(r.radiance[0], np.float64) for r in (paths, ordinates)]
    return *images, np.asarray(paths.standard_error[0], np.float64)


def views() -> None:
    extinction, grid = ball()
    center = grid.center
    cameras = {
        "below, looking up": View.perspective((0.58, 0.3, 0.1), center, 0.04, (16, 16)),
        "beside, looking down": View.perspective((0.02, 0.3, 0.98), center, 0.06, (16, 16)),
        "in the cloud, looking up": View.perspective((0.3, 0.3, 0.74), (0.1, 0.1, 0.9), 0.04, (16, 16)),
        "parallel, looking up": View.orthographic(
            140, 75, (center[0], center[1], 0.2), 0.1, (12, 12), looks_up=True),
    }
    print("air  sides     view                       Monte Carlo  ordinates - Monte Carlo (%)  noise (%)")
    for air, periodic in ((False, False), (True, False), (True, True)):
        light = Light(sun_zenith_deg=SUN[0], sun_azimuth_deg=SUN[1], surface_albedo=0.2, air=air,
                      periodic=periodic, wavelength=0.55)
        for name, view in cameras.items():
            paths, ordinates, error = both(extinction, grid, view, light)
            off = 100 * (ordinates.mean() / paths.mean() - 1)
            noise = 100 * np.sqrt((error**2).sum()) / paths.size / paths.mean()
            sides = "periodic" if periodic else "open"
            print(f"{'yes' if air else 'no':3}  {sides:8}  {name:25}  {paths.mean():11.5f}"
                  f"  {off:27.2f}  {noise:9.2f}")


def aureole() -> None:
    extinction, grid = ball()
    zenith, azimuth = np.radians(SUN)
    sun = np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])
    radii = np.full(extinction.shape, 10.0, np.float32)
    print("phase  angle from the Sun  pixels  ordinates - Monte Carlo (%)")
    for phase in ("hg", "mie"):
        light = Light(sun_zenith_deg=SUN[0], sun_azimuth_deg=SUN[1], surface_albedo=0.1, phase=phase)
        arguments = {"effective_radius": radii} if phase == "mie" else {}
        camera = np.array([0.3, 0.3, 0.7])
        # Beside the Sun: the nearest pixel is 12 degrees from it.
        look = sun + 0.75 * np.cross(sun, [0.0, 0.0, 1.0])
        view = View.perspective(tuple(camera), tuple(camera + 0.2 * look), 0.02, (16, 16))
        angles = np.array([[np.degrees(np.arccos(np.dot(view.ray(r + 0.5, c + 0.5)[1], sun)))
                            for c in range(16)] for r in range(16)])
        paths, ordinates, _ = both(extinction, grid, view, light, **arguments)
        for low, high in ((12, 15), (15, 20), (20, 30), (30, 45)):
            chosen = (angles >= low) & (angles < high)
            if chosen.any():
                off = 100 * (ordinates[chosen].mean() / paths[chosen].mean() - 1)
                print(f"{phase:5}  {low:2} to {high:2} degrees     {chosen.sum():6}  {off:27.2f}")


def iprt() -> None:
    grid = Grid((5, 7, 7), (1.0, 1.0, 1.0))
    extinction = np.zeros(grid.shape, np.float32)
    extinction[2, 3, 3] = 10.0
    radii = np.full(grid.shape, 10.0, np.float32)
    print("case  published  Monte Carlo (%)  noise (%)  ordinates (%)")
    for number, sun, zenith, azimuth, expected in CASES:
        up = zenith > 90
        view = View.orthographic(zenith, 90 + azimuth, (3.5, 3.5, 0.0 if up else 5.0), 1.0, (7, 7),
                                 looks_up=up)
        light = Light(sun_zenith_deg=sun, sun_azimuth_deg=90.0, surface_albedo=0.2, periodic=True,
                      wavelength=0.8, phase="mie")
        paths, ordinates, error = both(extinction, grid, view, light, 1_000_000, effective_radius=radii)
        noise = np.sqrt((error**2).sum()) / paths.size
        print(f"{number:4}  {expected:9.6f}  {100 * (paths.mean() / expected - 1):15.2f}"
              f"  {100 * noise / expected:9.2f}  {100 * (ordinates.mean() / expected - 1):13.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["views", "aureole", "iprt"])
    {"views": views, "aureole": aureole, "iprt": iprt}[parser.parse_args().what]()
