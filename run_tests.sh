#!/usr/bin/env bash
# Run all tests of deepct: the Rust crates, the Python module, and weights_tools with PyTorch.
#
# Requires Rust, a C compiler, CMake and Python 3.9 or later on the PATH. All other dependencies
# are installed into .venv in this folder, with the versions given in requirements.txt. The
# environment variable PYTHON selects an interpreter other than python3.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

python="${PYTHON:-python3}"
target="${CARGO_TARGET_DIR:-$PWD/target}"

part() {
    printf '\n== %s (%d s so far)\n' "$1" "$SECONDS"
}

stop() {
    printf 'run_tests.sh: %s\n' "$1" >&2
    exit 2
}

require() {
    command -v "$1" >/dev/null || stop "$1 was not found: install $2"
}

require cargo "Rust from https://rustup.rs"
require cc "a C compiler such as gcc or clang"
require cmake "CMake 3.16 or later"
require "$python" "Python 3.9 or later"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 9))' ||
    stop "$("$python" --version) is too old: install Python 3.9 or later"

part "Rust: build"
cargo build --release --locked

part "Rust: tests"
cargo test --release --locked

part "Rust: examples"
for example in crates/deepct-core/examples/*.rs; do
    [ -e "$example" ] || continue
    name="$(basename "$example" .rs)"
    echo "-- $name"
    cargo run --release --locked --quiet --example "$name"
done

part "Python: environment in .venv"
[ -x .venv/bin/python ] || "$python" -m venv .venv ||
    stop "cannot create a virtual environment: install Python's venv module and delete .venv"
.venv/bin/python -m pip install --quiet --disable-pip-version-check -r requirements.txt

part "Python: build the wheel of deepct_py and install it"
wheels="$target/wheels"
rm -rf "$wheels"
.venv/bin/maturin build --release --locked --quiet --out "$wheels" \
    --manifest-path crates/deepct-py/Cargo.toml --interpreter .venv/bin/python
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
    --force-reinstall "$wheels"/deepct_py-*.whl
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
    --no-build-isolation --editable weights_tools

# The tests that compare with the command line use the `deepct` on the PATH.
export PATH="$target/release:$PATH"

part "Python: tests of deepct_py"
.venv/bin/python -m pytest crates/deepct-py/tests

part "Python: tests of weights_tools"
.venv/bin/python -m pytest weights_tools

part "User guide: build, and run its commands"
.venv/bin/python docs/guide/build.py "$target/release/deepct" --out "$target/guide"
.venv/bin/python docs/guide/run_commands.py "$target/release"

part "all tests passed"
