#!/usr/bin/env bash
# sasktran2 2026.10.1: the radiance of a uniform cloud depends on the number of levels, with the
# single-scattering source "Exact" and above all with "SuccessiveOrders".
#
# One layer is sufficient for such a cloud in DISORT and with the source "DiscreteOrdinates". The
# other two are inaccurate where the optical thickness between two levels is not small, even if all
# properties are the same at all levels, and there is no warning. Observed for a cloud with optical
# thickness 10, a solar zenith angle of 60 degrees, a viewing zenith angle of 30 degrees and a black
# surface:
#
#   A: "Exact", single scattering, plane-parallel, divided by the closed formula
#   B: "DiscreteOrdinates" for all orders, plane-parallel, divided by its value for 401 levels
#   C: "SuccessiveOrders", spherical, divided by the same value
#
#   levels 2, optical thickness between them 10.0: A 1.366, B 1.000, C 110.04
#   levels 6, optical thickness between them 2.0: A 1.255, B 1.000, C 2.14
#   levels 11, optical thickness between them 1.0: A 1.109, B 1.000, C 1.37
#   levels 51, optical thickness between them 0.2: A 1.006, B 1.000, C 1.02
#
# In the first row, C is 90 times the radiance of a white surface. The second row corresponds to
# levels 40 m apart in a cloud with an extinction of 50 /km. Workaround: use "DiscreteOrdinates" for
# single and multiple scattering, or choose levels with an optical thickness well below 0.2 between
# them.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    sasktran2==2026.10.1 numpy==2.3.5 scipy==1.17.1 xarray==2026.9.0
"$folder/venv/bin/python" - <<'PY'
import math
import sys

import numpy as np
import sasktran2 as sk

THICKNESS, ALBEDO, ASYMMETRY = 10.0, 0.999, 0.5
MU_SUN, MU_VIEW = math.cos(math.radians(60)), math.cos(math.radians(30))


def radiance(levels, single, multiple, geometry):
    config = sk.Config()
    config.num_streams = 16
    config.num_singlescatter_moments = 64
    config.single_scatter_source = single
    config.multiple_scatter_source = multiple
    model = sk.Geometry1D(
        MU_SUN,
        0.0,
        6371000.0,
        np.linspace(0.0, 1000.0, levels),
        sk.InterpolationMethod.LinearInterpolation,
        geometry,
    )
    viewing = sk.ViewingGeometry()
    viewing.add_ray(sk.GroundViewingSolar(MU_SUN, 0.0, MU_VIEW, 200000.0))
    atmosphere = sk.Atmosphere(
        model, config, wavelengths_nm=np.array([670.0]), calculate_derivatives=False
    )
    atmosphere.storage.total_extinction[:] = THICKNESS / 1000.0
    atmosphere.storage.ssa[:] = ALBEDO
    order = np.arange(64)
    atmosphere.leg_coeff.a1[:] = ((2 * order + 1) * ASYMMETRY**order)[:, None, None]
    atmosphere.surface.albedo[:] = 0.0
    result = sk.Engine(config, model, viewing).calculate_radiance(atmosphere)
    return float(result["radiance"].values.squeeze())


cosine = -MU_SUN * MU_VIEW + math.sqrt((1 - MU_SUN**2) * (1 - MU_VIEW**2))
phase = (1 - ASYMMETRY**2) / (1 + ASYMMETRY**2 - 2 * ASYMMETRY * cosine) ** 1.5
loss = 1 - math.exp(-THICKNESS * (1 / MU_SUN + 1 / MU_VIEW))
once = ALBEDO * phase / (4 * math.pi) * MU_SUN / (MU_SUN + MU_VIEW) * loss

single, multiple = sk.SingleScatterSource, sk.MultipleScatterSource
flat, sphere = sk.GeometryType.PlaneParallel, sk.GeometryType.Spherical
ordinates = (single.DiscreteOrdinates, multiple.DiscreteOrdinates, flat)
every = radiance(401, *ordinates)
for levels, expected in [
    (2, (1.366, 1.0, 110.0)),
    (6, (1.255, 1.0, 2.144)),
    (11, (1.109, 1.0, 1.370)),
    (51, (1.006, 1.0, 1.022)),
]:
    found = (
        radiance(levels, single.Exact, multiple.NoSource, flat) / once,
        radiance(levels, *ordinates) / every,
        radiance(levels, single.Exact, multiple.SuccessiveOrders, sphere) / every,
    )
    step = THICKNESS / (levels - 1)
    print(f"levels {levels}, optical thickness between them {step:.1f}:", end=" ")
    print("A {:.3f}, B {:.3f}, C {:.2f}".format(*found))
    if not np.allclose(found, expected, rtol=0.005, atol=0.0):
        sys.exit("the behaviour of sasktran2 has changed")
PY
