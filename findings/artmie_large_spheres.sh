#!/usr/bin/env bash
# ARTmie 0.1.3: the extinction of spheres with size parameters from about 67 to 151 is up to about
# 50 % too large.
#
# For smaller and larger spheres, it agrees with miepython 3.3.0 to about 1e-4. In red light, these
# size parameters correspond to droplets with radii of 7 to 16 um, which cause most of the
# scattering of a water cloud. Single-scattering albedo and asymmetry parameter appear plausible,
# and an average over sizes conceals the error. Observed extinction efficiencies for the refractive
# index 1.331 + 2e-8 i:
#
#   size parameter   10: ARTmie 2.1902, miepython 2.1902
#   size parameter   66: ARTmie 2.1241, miepython 2.1241
#   size parameter   80: ARTmie 3.0134, miepython 2.0534
#   size parameter  100: ARTmie 2.7593, miepython 2.0957
#   size parameter  120: ARTmie 2.4302, miepython 2.1169
#   size parameter  200: ARTmie 2.0315, miepython 2.0315
#
# Workaround: use another Mie code, such as miepython.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    ARTmie==0.1.3 miepython==3.3.0 numpy==2.3.5 scipy==1.17.1
"$folder/venv/bin/python" - <<'PY'
import math
import sys

import ARTmie
import miepython

WAVELENGTH_NM = 672.0
for size, wrong in [(10, 0.0), (66, 0.0), (80, 0.47), (100, 0.32), (120, 0.15), (200, 0.0)]:
    diameter = size * WAVELENGTH_NM / math.pi
    found = ARTmie.MieQ(1.331 + 2e-8j, diameter, WAVELENGTH_NM)[0]
    right = miepython.efficiencies_mx(1.331 - 2e-8j, float(size))[0]
    print(f"size parameter {size:4}: ARTmie {found:.4f}, miepython {right:.4f}")
    if abs(found / right - 1.0 - wrong) > 0.01:
        sys.exit("the behaviour of ARTmie has changed")
PY
