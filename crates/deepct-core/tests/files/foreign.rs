//! Files that refer to other files, or declare what they do not hold.

use crate::own::{grid, provenance};
use crate::{check_refusal, place};
use deepct_core::grid::Volume;
use deepct_core::io;
use hdf5::types::VarLenUnicode;
use std::path::Path;
use std::str::FromStr;

/// A volume file without the values of the extinction.
fn without_values(path: &Path) -> hdf5::File {
    io::write_volume(path, &Volume::constant(grid(), 2.0), &provenance()).unwrap();
    let file = hdf5::File::open_rw(path).unwrap();
    file.unlink("extinction").unwrap();
    file
}

fn volume(path: &Path) -> deepct_core::Result<Volume> {
    io::read_volume(path)
}

#[test]
fn a_link_to_another_file_is_not_followed() {
    let (folder, path) = place("volume.nc");
    let other = folder.path().join("other.nc");
    io::write_volume(&other, &Volume::constant(grid(), 3.0), &provenance()).unwrap();
    let file = without_values(&path);
    file.link_external("other.nc", "extinction", "extinction").unwrap();
    file.close().unwrap();
    check_refusal(volume(&path), &path, "extinction: is a link to another file");
    // In a group, which a soft link leads to.
    let file = without_values(&path);
    let group = file.create_group("group").unwrap();
    group.link_external("other.nc", "extinction", "inner").unwrap();
    file.link_soft("/group/inner", "extinction").unwrap();
    file.close().unwrap();
    check_refusal(volume(&path), &path, "group/inner: is a link to another file");
}

#[test]
fn values_in_another_file_are_not_read() {
    let (folder, path) = place("volume.nc");
    let shape = grid().shape;
    let bytes = 4 * shape.iter().product::<usize>();
    std::fs::write(folder.path().join("raw.bin"), vec![0; bytes]).unwrap();
    let file = without_values(&path);
    let builder = file.new_dataset::<f32>().external("raw.bin", 0, bytes).shape(shape);
    builder.create("extinction").unwrap();
    file.close().unwrap();
    check_refusal(volume(&path), &path, "extinction: has its values in another file");
}

/// 400 x 400 x 400 values that were never written, in a file of a few kilobytes.
#[test]
fn values_that_were_never_written_are_refused() {
    let (_folder, path) = place("volume.nc");
    let file = without_values(&path);
    let values = file.new_dataset::<f32>().chunk([8, 8, 8]).shape([400, 400, 400]);
    let units = VarLenUnicode::from_str("km-1").unwrap();
    let attribute = values.create("extinction").unwrap().new_attr::<VarLenUnicode>();
    attribute.create("units").unwrap().write_scalar(&units).unwrap();
    file.close().unwrap();
    check_refusal(volume(&path), &path, "but the file has");
}
