#!/usr/bin/env bash
# xarray 2026.9.0: reading and writing unsigned integers marked with `_Unsigned` changes every value
# in the upper half of the range unless the variable has a fill value.
#
# Files in the classic netCDF model store unsigned integers, such as the counts of a camera, as
# signed ones with the attribute `_Unsigned = "true"`. xarray reads them correctly. When it writes
# a variable without `_FillValue` again, it stores signed integers as in the original, but omits the
# attribute without a warning, so that the copy contains different numbers. Version 2024.6.0 kept
# the attribute; version 2024.9.0 already omitted it. Observed with netCDF4 1.7.4 and NumPy 2.3.5:
#
#   read from the original:                   [0, 100, 200, 250]
#   copy, with a fill value:                  [0, 100, 200, 250]
#   copy, without a fill value:               [0, 100, -56, -6]
#   copy, without a fill value (netCDF4):     [0, 100, -56, -6]
#   copy, encoding removed:                   [0, 100, 200, 250]
#
# Values below 128 are copied correctly, so that a test with a dark image passes. Workaround: call
# `drop_encoding()` before writing a netCDF-4 file, which stores unsigned integers.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    xarray==2026.9.0 netCDF4==1.7.4 numpy==2.3.5
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import sys
import warnings

import netCDF4
import numpy as np
import xarray as xr

warnings.simplefilter("error")
counts = [0, 100, 200, 250]
with netCDF4.Dataset("image.nc", "w", format="NETCDF3_CLASSIC") as file:
    file.createDimension("column", len(counts))
    for name, fill in [("filled", np.int8(-1)), ("plain", None)]:
        variable = file.createVariable(name, "i1", ("column",), fill_value=fill)
        variable.setncattr("_Unsigned", "true")
        variable.set_auto_maskandscale(False)
        variable[:] = np.array(counts, dtype=np.uint8).view(np.int8)


def look(label, found, expected):
    found = np.asarray(found).astype(int).tolist()
    print(f"{label + ':':41} {found}")
    if found != expected:
        sys.exit("the behaviour of xarray has changed")


wrong = [0, 100, -56, -6]
with xr.open_dataset("image.nc") as images:
    look("read from the original", images["plain"], counts)
    images.to_netcdf("copy.nc")
    images.drop_encoding().to_netcdf("dropped.nc")
with xr.open_dataset("copy.nc") as images:
    look("copy, with a fill value", images["filled"], counts)
    look("copy, without a fill value", images["plain"], wrong)
with netCDF4.Dataset("copy.nc") as file:
    look("copy, without a fill value (netCDF4)", file["plain"][:], wrong)
with xr.open_dataset("dropped.nc") as images:
    look("copy, encoding removed", images["plain"], counts)
PY
