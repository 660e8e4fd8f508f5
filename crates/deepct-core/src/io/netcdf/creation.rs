//! What makes an HDF5 file one that the netCDF library and older programs can use and edit: links in
//! the order of their creation, and text attributes of fixed length.
//!
//! The HDF5 crate wraps neither.

#![allow(unsafe_code)]

use hdf5::plist::file_create::AttrCreationOrder;
use hdf5::plist::{FileAccess, FileCreate};
use hdf5::{File, Location, Result, h5check};
use hdf5_sys::h5a::{H5Aclose, H5Acreate2, H5Awrite};
use hdf5_sys::h5f::{H5F_ACC_TRUNC, H5Fcreate};
use hdf5_sys::h5i::hid_t;
use hdf5_sys::h5p::{
    H5P_CRT_ORDER_INDEXED, H5P_CRT_ORDER_TRACKED, H5P_DEFAULT, H5Pset_file_locking,
    H5Pset_link_creation_order,
};
use hdf5_sys::h5s::{H5S_class_t, H5Sclose, H5Screate};
use hdf5_sys::h5t::{
    H5T_C_S1, H5T_cset_t, H5T_str_t, H5Tclose, H5Tcopy, H5Tset_cset, H5Tset_size, H5Tset_strpad,
};
use std::ffi::CString;
use std::path::Path;

/// The order in which attributes are created is recorded, as the netCDF library does.
pub(super) fn attribute_order() -> AttrCreationOrder {
    AttrCreationOrder::TRACKED | AttrCreationOrder::INDEXED
}

/// Creates an empty file at `path`, or replaces a file there, and opens it for writing. Its root
/// group records the order in which variables are created: the netCDF library opens files without
/// this order for reading only.
///
/// # Errors
/// Returns an error if the file cannot be created.
pub(super) fn create(path: &Path) -> Result<File> {
    let mut creation = FileCreate::build();
    // Without time stamps, repeated runs write identical bytes.
    creation.obj_track_times(false).attr_creation_order(attribute_order());
    let creation = creation.finish()?;
    let access = FileAccess::build().libver_v18().finish()?;
    let name = CString::new(path.as_os_str().as_encoded_bytes())
        .map_err(|_| hdf5::Error::from("the path contains a zero byte"))?;
    let order = H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED;
    // SAFETY: the lists are open while they are borrowed, the name ends in a zero byte and outlives
    // the calls, the file owns its identifier, and the lock excludes other threads.
    hdf5::sync::sync(|| unsafe {
        h5check(H5Pset_link_creation_order(creation.id(), order))?;
        // A lock would outlive the closed file where another thread is starting a program, until that
        // program begins. Nobody else writes to this file, which has a temporary name.
        h5check(H5Pset_file_locking(access.id(), 0, 1))?;
        let file = H5Fcreate(name.as_ptr(), H5F_ACC_TRUNC, creation.id(), access.id());
        hdf5::from_id(h5check(file)?)
    })
}

/// Adds a text attribute of fixed length. Texts of variable length are refused or dropped by Ferret,
/// the Fortran interface of netCDF, Octave and `nccopy -k classic`.
///
/// # Errors
/// Returns an error if the attribute exists or cannot be written.
pub(super) fn write_text(on: &Location, name: &str, text: &str) -> Result<()> {
    let name = CString::new(name).expect("names have no zero bytes");
    // HDF5 has no text of length 0; a zero byte is what the netCDF library reads as an empty one.
    let bytes = if text.is_empty() { b"\0" } else { text.as_bytes() };
    // SAFETY: every identifier is checked before its use and closed after the last one, `bytes` has
    // the size of the type and outlives the call, and the lock excludes other threads.
    hdf5::sync::sync(|| unsafe {
        let kind = Open(h5check(H5Tcopy(*H5T_C_S1))?, H5Tclose);
        h5check(H5Tset_size(kind.0, bytes.len()))?;
        h5check(H5Tset_strpad(kind.0, H5T_str_t::H5T_STR_NULLTERM))?;
        h5check(H5Tset_cset(kind.0, H5T_cset_t::H5T_CSET_UTF8))?;
        let space = Open(h5check(H5Screate(H5S_class_t::H5S_SCALAR))?, H5Sclose);
        let attribute =
            H5Acreate2(on.id(), name.as_ptr(), kind.0, space.0, H5P_DEFAULT, H5P_DEFAULT);
        let attribute = Open(h5check(attribute)?, H5Aclose);
        h5check(H5Awrite(attribute.0, kind.0, bytes.as_ptr().cast())).map(|_| ())
    })
}

/// An open identifier and the function that closes it.
struct Open(hid_t, unsafe extern "C" fn(hid_t) -> hdf5_sys::h5::herr_t);

impl Drop for Open {
    fn drop(&mut self) {
        // SAFETY: the identifier is open, is closed once, and is dropped under the lock.
        unsafe { (self.1)(self.0) };
    }
}
