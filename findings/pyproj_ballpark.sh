#!/usr/bin/env bash
# pyproj 3.7.2: heights above the ellipsoid are returned unchanged as heights above the geoid if the
# grid of the geoid is not installed.
#
# Satellite positions and many image products refer to the WGS 84 ellipsoid, clouds and terrain to the
# geoid; the two differ by -107 to +85 m. The wheels of pyproj do not contain the grids of geoids. The
# transformation then falls back to a "ballpark" one, which leaves the height as it is, without an
# error or a warning, also with `only_best=True`. Observed in the Indian Ocean south of Sri Lanka,
# where EGM96 lies 107 m below the ellipsoid, so that 1000 m above the ellipsoid are 1107 m above EGM96:
#
#   default:               1000.0 m
#   only_best=True:        1000.0 m
#   allow_ballpark=False:  ProjError
#
# For a camera at a zenith angle of 70.5 degrees, 100 m of altitude move a cloud by 280 m in its image.
# Workaround: pass `allow_ballpark=False`, and install the grid of the geoid.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check pyproj==3.7.2
PROJ_NETWORK=OFF PROJ_USER_WRITABLE_DIRECTORY="$folder" "$folder/venv/bin/python" - <<'PY'
import sys
import warnings

from pyproj import Transformer
from pyproj.exceptions import ProjError

warnings.simplefilter("error")
ELLIPSOID, EGM96 = "EPSG:4979", "EPSG:9707"


def height(**options):
    transformer = Transformer.from_crs(ELLIPSOID, EGM96, always_xy=True, **options)
    return transformer.transform(78.77, 4.71, 1000.0)[2]


for name, options in [("default", {}), ("only_best=True", {"only_best": True})]:
    found = height(**options)
    print(f"{name + ':':22} {found:.1f} m")
    if found != 1000.0:
        sys.exit("the behaviour of pyproj has changed, or a grid of EGM96 is installed")
try:
    height(allow_ballpark=False)
except ProjError:
    print("allow_ballpark=False:  ProjError")
else:
    sys.exit("the behaviour of pyproj has changed, or a grid of EGM96 is installed")
PY
