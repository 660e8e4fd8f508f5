//! Dimension scales, by which netCDF-4 names the dimensions of an HDF5 dataset.
//!
//! The HDF5 crate does not wrap this part of the high-level library.

#![allow(unsafe_code)]

use hdf5::types::VarLenArray;
use hdf5::{Attribute, Dataset, LocationToken, ObjectReference1, ReferencedObject};
use hdf5_sys::h5::herr_t;
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5t::{H5T_class_t, H5Tclose, H5Tget_class, H5Tget_super};
use std::ffi::{CString, c_char, c_uint};

unsafe extern "C" {
    fn H5DSset_scale(scale: hid_t, name: *const c_char) -> herr_t;
    fn H5DSattach_scale(dataset: hid_t, scale: hid_t, axis: c_uint) -> herr_t;
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

/// The scales that are attached to each axis of `dataset`.
///
/// Only the list of the dataset is read. `H5DSis_attached` also requires that of the scale, and fails
/// if one of the variables in it has been deleted.
pub(super) fn attached_scales(dataset: &Dataset) -> Vec<Vec<LocationToken>> {
    let list = dataset.attr("DIMENSION_LIST").ok();
    let list = list.filter(|list| has_references(list) && list.shape() == [dataset.ndim()]);
    let lists = list.and_then(|list| list.read_raw::<VarLenArray<ObjectReference1>>().ok());
    let token = |reference: &ObjectReference1| match dataset.dereference(reference).ok()? {
        ReferencedObject::Dataset(scale) => scale.loc_info().ok().map(|info| info.token),
        _ => None,
    };
    let lists = lists.unwrap_or_default();
    lists.iter().map(|references| references.iter().filter_map(token).collect()).collect()
}

/// Whether the values of an attribute are lists of references, as the library does not check.
fn has_references(list: &Attribute) -> bool {
    let Ok(kind) = list.dtype() else { return false };
    // SAFETY: the identifier of the type is open while it is borrowed, the super type is closed after
    // its last use, and the lock excludes other threads.
    hdf5::sync::sync(|| unsafe {
        let class = H5Tget_class(kind.id());
        let element = if class == H5T_class_t::H5T_VLEN { H5Tget_super(kind.id()) } else { -1 };
        let refers = element >= 0 && H5Tget_class(element) == H5T_class_t::H5T_REFERENCE;
        if element >= 0 {
            H5Tclose(element);
        }
        refers
    })
}
