//! Dimension scales, by which netCDF-4 names the dimensions of an HDF5 dataset.
//!
//! The HDF5 crate does not wrap this part of the high-level library.

#![allow(unsafe_code)]

use hdf5::Dataset;
use hdf5_sys::h5::herr_t;
use hdf5_sys::h5i::hid_t;
use std::ffi::{CString, c_char, c_uint};

unsafe extern "C" {
    fn H5DSset_scale(scale: hid_t, name: *const c_char) -> herr_t;
    fn H5DSattach_scale(dataset: hid_t, scale: hid_t, axis: c_uint) -> herr_t;
    fn H5DSis_attached(dataset: hid_t, scale: hid_t, axis: c_uint) -> herr_t;
    fn H5DSis_scale(dataset: hid_t) -> herr_t;
}

/// Make `scale` the scale of the dimension `name`. Returns whether this succeeded.
pub(super) fn set_scale(scale: &Dataset, name: &str) -> bool {
    let Ok(name) = CString::new(name) else { return false };
    // SAFETY: the identifier is open while `scale` is borrowed, the name ends in a zero byte and
    // outlives the call, and the lock excludes other threads.
    hdf5::sync::sync(|| unsafe { H5DSset_scale(scale.id(), name.as_ptr()) } >= 0)
}

/// Attach `scale` to an axis of `dataset`. Returns whether this succeeded.
pub(super) fn attach_scale(dataset: &Dataset, scale: &Dataset, axis: usize) -> bool {
    // SAFETY: both identifiers are open while the datasets are borrowed, and the lock excludes
    // other threads; the library checks the axis.
    hdf5::sync::sync(|| unsafe { H5DSattach_scale(dataset.id(), scale.id(), axis as c_uint) >= 0 })
}

/// Whether `scale` is attached to an axis of `dataset`.
pub(super) fn is_attached(dataset: &Dataset, scale: &Dataset, axis: usize) -> bool {
    // SAFETY: as for `attach_scale`.
    hdf5::sync::sync(|| unsafe { H5DSis_attached(dataset.id(), scale.id(), axis as c_uint) > 0 })
}

/// Whether `dataset` is the scale of a dimension.
pub(super) fn is_scale(dataset: &Dataset) -> bool {
    // SAFETY: the identifier is open while `dataset` is borrowed, and the lock excludes other
    // threads.
    hdf5::sync::sync(|| unsafe { H5DSis_scale(dataset.id()) > 0 })
}
