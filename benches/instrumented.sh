#!/usr/bin/env bash
# Memory safety and line coverage (docs/notes/reliability.md): instrumented.sh FOLDER [miri|tests]
#
# - miri: Miri interprets the tests of the portable kernel of the convolution, and of the threads that
#   share its output.
# - tests: the tests of the core and of the command line run with AddressSanitizer, which includes the
#   kernels of this processor and the calls of HDF5, and their line coverage is counted. Further
#   arguments select the tests, as those of `cargo test`; by default all of the core and the command line.
#
# Requires nightly Rust with the components miri, rust-src and llvm-tools. FOLDER receives the builds.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export CARGO_TARGET_DIR="${1:?"instrumented.sh FOLDER [miri|tests]"}"
part="${2:-all}"
host="$(rustc +nightly -vV | sed -n 's/^host: //p')"

if [ "$part" != tests ]; then
    # Rayon's queues break the older of Miri's two models of pointers, and its threads never end.
    MIRIFLAGS="-Zmiri-tree-borrows -Zmiri-permissive-provenance -Zmiri-ignore-leaks" \
        cargo +nightly miri test --locked -p deepct-core --no-default-features --lib -- \
        conv::kernels conv::shape every_algorithm_on
fi

if [ "$part" != miri ]; then
    # HDF5 keeps some memory until the process ends, which is not a leak of deepct.
    export ASAN_OPTIONS=detect_leaks=0
    export LLVM_PROFILE_FILE="$CARGO_TARGET_DIR/profiles/%p-%m.profraw"
    export RUSTFLAGS="-Zsanitizer=address -Cinstrument-coverage"
    rm -rf "$CARGO_TARGET_DIR/profiles"
    shift $(($# < 2 ? $# : 2))
    [ "$#" -gt 0 ] || set -- -p deepct-core -p deepct-cli
    cargo +nightly test --release --locked --no-fail-fast --target "$host" "$@"
    tools="$(rustc +nightly --print sysroot)/lib/rustlib/$host/bin"
    "$tools/llvm-profdata" merge --sparse "$CARGO_TARGET_DIR"/profiles/*.profraw \
        -o "$CARGO_TARGET_DIR/merged.profdata"
    objects="$(find "$CARGO_TARGET_DIR/$host/release" -maxdepth 2 -type f -executable -name '*-*' \
        ! -name '*.*' -path '*/deps/*' -printf '--object %p ')"
    # shellcheck disable=SC2086
    "$tools/llvm-cov" report $objects --object "$CARGO_TARGET_DIR/$host/release/deepct" \
        --instr-profile "$CARGO_TARGET_DIR/merged.profdata" \
        --ignore-filename-regex '/(registry|rustc|tests|rust-src|library)/' \
        > "$CARGO_TARGET_DIR/coverage.txt"
    tail -1 "$CARGO_TARGET_DIR/coverage.txt"
fi
