#!/usr/bin/env bash
# safetensors 0.8.0, NumPy module: the elements of arrays that are not in C order are permuted
# without an error.
#
# The header contains the shape of the array, but the data are written in the order of the memory.
# The elements of a transposed or Fortran-ordered array are therefore permuted after reading.
# Version 0.7.0 copied such arrays to C order first. Observed with NumPy 2.3.5 on x86-64 Linux:
#
#   0.7.0: [[0, 3], [1, 4], [2, 5]] came back as [[0, 3], [1, 4], [2, 5]]
#   0.8.0: [[0, 3], [1, 4], [2, 5]] came back as [[0, 1], [2, 3], [4, 5]]
#
# Shape, sum, minimum and maximum are correct, so that checks based on them pass. Workaround: apply
# `numpy.ascontiguousarray` before saving.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"

look() {
    "$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        "safetensors==$1" numpy==2.3.5
    "$folder/venv/bin/python" - "$1" "$2" <<'PY'
import sys

import numpy as np
from safetensors.numpy import load, save

version, scrambled = sys.argv[1], sys.argv[2] == "scrambled"
saved = np.arange(6, dtype=np.float32).reshape(2, 3).T
found = load(save({"x": saved}))["x"]
print(f"{version}: {saved.astype(int).tolist()} came back as {found.astype(int).tolist()}")
assert found.shape == (3, 2) and found.sum() == saved.sum()
if scrambled == bool((found == saved).all()):
    sys.exit(f"the behaviour of safetensors {version} has changed")
contiguous = load(save({"x": np.ascontiguousarray(saved)}))["x"]
assert (contiguous == saved).all()
PY
}

look 0.7.0 right
look 0.8.0 scrambled
