#!/usr/bin/env bash
# VirtualiZarr 2.5.1: variables without dimensions become NaN in the JSON files of references that
# `to_kerchunk` writes.
#
# The reference to the only chunk of such a variable has the key "name/" instead of "name/0". Readers
# look for the latter, do not find it and return the fill value, without an error. Images of deepct
# lose the direction of the Sun and the wavelength in this way. Version 2.8.0 (Python 3.12 and later)
# does the same. Observed with xarray 2026.9.0, kerchunk 0.2.10, Zarr 3.1.6 and netCDF4 1.7.4:
#
#   the file itself:         sun_zenith_deg 30.0, radiance [0.1, 0.2, 0.3]
#   references (JSON):       sun_zenith_deg nan, radiance [0.1, 0.2, 0.3]
#   references of kerchunk:  sun_zenith_deg 30.0, radiance [0.1, 0.2, 0.3]
#
# Workaround: let kerchunk itself make the references, or write scalars along a dimension of length 1.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    virtualizarr==2.5.1 kerchunk==0.2.10 xarray==2026.9.0 zarr==3.1.6 netCDF4==1.7.4 h5py==3.16.0 \
    obstore==0.12.1 obspec_utils==0.9.0
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import math
import sys
import warnings
from pathlib import Path

import netCDF4
import xarray as xr
from kerchunk.hdf import SingleHdf5ToZarr
from obspec_utils.registry import ObjectStoreRegistry
from obstore.store import LocalStore
from virtualizarr import open_virtual_dataset
from virtualizarr.parsers import HDFParser

warnings.simplefilter("ignore")
path = Path("images.nc").resolve()
with netCDF4.Dataset(path, "w") as file:
    file.createVariable("sun_zenith_deg", "f8", ())[...] = 30.0
    file.createDimension("view", 3)
    file.createVariable("radiance", "f8", ("view",))[:] = [0.1, 0.2, 0.3]


def look(label, images):
    sun, radiance = float(images.sun_zenith_deg), images.radiance.values.tolist()
    print(f"{label + ':':24} sun_zenith_deg {sun}, radiance {radiance}")
    assert radiance == [0.1, 0.2, 0.3]
    return sun


with xr.open_dataset(path) as images:
    assert look("the file itself", images) == 30.0
registry = ObjectStoreRegistry({"file://": LocalStore()})
with open_virtual_dataset(path.as_uri(), registry=registry, parser=HDFParser()) as images:
    images.vz.to_kerchunk("images.json", format="json")
with xr.open_dataset("images.json", engine="kerchunk") as images:
    lost = look("references (JSON)", images)
options = {"storage_options": {"fo": SingleHdf5ToZarr(str(path)).translate()}, "consolidated": False}
with xr.open_dataset("reference://", engine="zarr", backend_kwargs=options) as images:
    assert look("references of kerchunk", images) == 30.0
if not math.isnan(lost):
    sys.exit("the behaviour of VirtualiZarr has changed")
PY
