#!/usr/bin/env bash
# Run fuzz targets: run.sh SECONDS [TARGET...], by default all of them one after the other.
#
# Requires nightly Rust and cargo-fuzz (`cargo install cargo-fuzz`). A target ends at its first
# finding, with a file in artifacts/ that `cargo +nightly fuzz run TARGET FILE` repeats. The corpus
# starts with files of the repository and grows in corpus/.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

# HDF5 keeps some memory until the process ends, which is not a leak of deepct.
export ASAN_OPTIONS=detect_leaks=0

seconds="${1:?"run.sh SECONDS [TARGET...]"}"
shift
[ "$#" -gt 0 ] || set -- arrays weights weights_header checkpoint settings plans text_cloud classic fields \
    simulation round_trip

seeds() {
    mkdir -p "corpus/$1"
    case "$1" in
    weights) cp ../crates/deepct-core/tests/parity/*.safetensors "corpus/$1" ;;
    weights_header)
        for file in ../crates/deepct-core/tests/parity/*.safetensors; do
            python3 -c "
import struct, sys
bytes = open(sys.argv[1], 'rb').read()
length, = struct.unpack('<Q', bytes[:8])
open(sys.argv[2], 'wb').write(bytes[8 : 8 + length])
" "$file" "corpus/$1/$(basename "$file")"
        done
        ;;
    settings)
        cp ../crates/deepct-cli/src/defaults/*.toml "corpus/$1"
        for file in ../recipes/*.toml; do cp "$file" "corpus/$1/recipe-$(basename "$file")"; done
        ;;
    esac
    cp -r "seeds/$1/." "corpus/$1" 2>/dev/null || true
}

cargo +nightly fuzz build
host="$(rustc +nightly -vV | sed -n 's/^host: //p')"
for target in "$@"; do
    seeds "$target"
    mkdir -p "artifacts/$target"
    "target/$host/release/$target" "corpus/$target" -artifact_prefix="artifacts/$target/" \
        -max_total_time="$seconds" -max_len=100000 -timeout=30 -rss_limit_mb=4096 \
        -print_final_stats=1 -verbosity=1
done
