#!/usr/bin/env bash
# hdf5-metno 0.11.0 (Rust): `FileBuilder::set_access_plist` does not use the given property list. It makes
# a new one from the properties that it knows, and drops the others without an error.
#
# A property that the library has no method for, set by the function of the C library, is therefore lost:
# with file locking off in the list, the file is opened with a lock. Observed, from the property list of
# the open file:
#
#   in the list that is given: locking 0
#   in the list of the file:   locking 1
#
# Workaround: open the file by `H5Fopen` or `H5Fcreate` with the list, and take its identifier over by
# `hdf5::from_id`.
#
# Requires Rust, a C compiler and CMake.
set -euo pipefail

folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat > "$folder/Cargo.toml" <<'TOML'
[package]
name = "access-plist"
version = "0.0.0"
edition = "2021"

[dependencies]
hdf5 = { package = "hdf5-metno", version = "=0.11.0", features = ["static"] }
hdf5-sys = { package = "hdf5-metno-sys", version = "=0.10.1", features = ["static"] }
TOML
cat > "$folder/src/main.rs" <<'RUST'
use hdf5::plist::FileAccess;
use hdf5_sys::h5p::{H5Pget_file_locking, H5Pset_file_locking};

fn locking(list: &FileAccess) -> u8 {
    let (mut locking, mut ignored) = (0_u8, 0_u8);
    unsafe { H5Pget_file_locking(list.id(), (&mut locking as *mut u8).cast(), (&mut ignored as *mut u8).cast()) };
    locking
}

fn main() {
    let path = std::env::args().nth(1).unwrap();
    hdf5::File::create(&path).unwrap().close().unwrap();
    let list = FileAccess::build().libver_v18().finish().unwrap();
    unsafe { H5Pset_file_locking(list.id(), 0, 1) };
    let file = hdf5::File::with_options().set_access_plist(&list).unwrap().open_rw(&path).unwrap();
    let (given, used) = (locking(&list), locking(&file.access_plist().unwrap()));
    println!("in the list that is given: locking {given}\nin the list of the file:   locking {used}");
    assert_eq!((given, used), (0, 1), "the behaviour of hdf5-metno has changed");
}
RUST
cargo run --quiet --manifest-path "$folder/Cargo.toml" -- "$folder/file.h5"
