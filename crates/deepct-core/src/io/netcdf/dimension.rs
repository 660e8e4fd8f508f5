//! Dimension scales, by which netCDF-4 names the dimensions of an HDF5 dataset.
//!
//! The HDF5 crate does not wrap this part of the high-level library.

#![allow(unsafe_code)]

use hdf5::types::VarLenArray;
use hdf5::{Attribute, Dataset, LocationToken, ObjectReference1, ReferencedObject};
use hdf5_sys::h5::herr_t;
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5t::{H5T_class_t, H5Tclose, H5Tget_class, H5Tget_nmembers, H5Tget_super};
use std::ffi::{CString, c_char, c_uint};

unsafe extern "C" {
    fn H5DSset_scale(scale: hid_t, name: *const c_char) -> herr_t;
    fn H5DSattach_scale(dataset: hid_t, scale: hid_t, axis: c_uint) -> herr_t;
    fn H5DSis_attached(dataset: hid_t, scale: hid_t, axis: c_uint) -> herr_t;
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
    if !has_lists(dataset, scale) {
        return false;
    }
    // SAFETY: as for `attach_scale`; the attributes that the library reads have the types with which
    // it reads them.
    hdf5::sync::sync(|| unsafe { H5DSis_attached(dataset.id(), scale.id(), axis as c_uint) > 0 })
}

/// Whether the attributes by which a dataset and a scale refer to each other have the types that the
/// library expects without checking them: a list of references for each axis, and records of two
/// members.
fn has_lists(dataset: &Dataset, scale: &Dataset) -> bool {
    let (Ok(list), Ok(back)) = (dataset.attr("DIMENSION_LIST"), scale.attr("REFERENCE_LIST"))
    else {
        return false;
    };
    let Ok(of_back) = back.dtype() else { return false };
    // SAFETY: the identifier of the type is open while the type is borrowed, and the lock excludes
    // other threads.
    let has_records = hdf5::sync::sync(|| unsafe {
        H5Tget_class(of_back.id()) == H5T_class_t::H5T_COMPOUND
            && H5Tget_nmembers(of_back.id()) == 2
    });
    has_records && has_references(dataset, &list)
}

/// Whether the attribute `list` of a dataset holds a list of references for each axis.
fn has_references(dataset: &Dataset, list: &Attribute) -> bool {
    let Ok(kind) = list.dtype() else { return false };
    // SAFETY: the identifier of the type is open while the type is borrowed, the super type is closed
    // after its last use, and the lock excludes other threads.
    let refers = hdf5::sync::sync(|| unsafe {
        let class = H5Tget_class(kind.id());
        let element = if class == H5T_class_t::H5T_VLEN { H5Tget_super(kind.id()) } else { -1 };
        let refers = element >= 0 && H5Tget_class(element) == H5T_class_t::H5T_REFERENCE;
        if element >= 0 {
            H5Tclose(element);
        }
        refers
    });
    refers && list.shape() == [dataset.ndim()]
}

/// The first object in the list of scales of each axis, where the library cannot tell which scale is
/// attached: the list of references of a scale is damaged if a dataset has been deleted.
pub(super) fn first_scales(dataset: &Dataset) -> Vec<Option<LocationToken>> {
    let list = dataset.attr("DIMENSION_LIST").ok().filter(|list| has_references(dataset, list));
    let lists = list.and_then(|list| list.read_raw::<VarLenArray<ObjectReference1>>().ok());
    let first =
        |list: &VarLenArray<ObjectReference1>| match dataset.dereference(list.first()?).ok()? {
            ReferencedObject::Dataset(scale) => scale.loc_info().ok().map(|info| info.token),
            _ => None,
        };
    lists.unwrap_or_default().iter().map(first).collect()
}
