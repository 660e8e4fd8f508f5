//! Input and output: HDF5/netCDF-4, safetensors, OpenEXR and foreign cloud formats.
//!
//! Clouds, volumes, masks and images are stored as HDF5 files that are also valid netCDF-4 with
//! CF attributes, so that xarray, `ncdump` and Panoply open them with named dimensions and
//! coordinates. Every file records its provenance ([`Provenance`]). Files are written under a
//! temporary name and then renamed, so that an aborted run leaves no incomplete file. If a file
//! cannot be used, the error message names the file, the field and the remedy.

#[cfg(feature = "files")]
mod arrays;
#[cfg(feature = "files")]
mod checkpoint;
#[cfg(feature = "files")]
pub mod export;
#[cfg(feature = "files")]
mod exr;
#[cfg(feature = "files")]
pub mod import;
#[cfg(feature = "files")]
mod netcdf;
#[cfg(feature = "files")]
mod origin;
#[cfg(feature = "files")]
mod plausible;
#[cfg(feature = "files")]
mod units;
mod weights;

#[cfg(feature = "files")]
pub use self::checkpoint::{inversion_identity, read_checkpoint, write_checkpoint};
#[cfg(feature = "files")]
pub use self::exr::write_exr;
#[cfg(feature = "files")]
pub use netcdf::{
    Content, Drawing, EstimateFile, Field, ImagesFile, Lineage, MAX_VALUES, Provenance,
    ReferenceDroplets, ReferenceView, Time, allow_external_files, configuration, endless_reading,
    incomplete, read_cloud, read_content, read_derived_observation, read_drawing, read_estimate,
    read_extinction, read_grid, read_implausible_cloud, read_light, read_lineage, read_mask,
    read_observation, read_observations, read_reference_droplets, read_reference_extinction,
    read_reference_view, read_volume, write_cloud, write_estimate, write_mask, write_observation,
    write_reconstruction, write_sample, write_volume,
};
#[cfg(feature = "files")]
pub use origin::is_replaceable;
#[cfg(feature = "files")]
pub use units::unit_factor;
#[cfg(feature = "files")]
pub use weights::write_weights;
pub use weights::{
    GENERAL_WEIGHTS, MAX_WEIGHTS_BYTES, built_in_contents, built_in_weights, load_trained_weights,
    load_weights, parse_trained_weights, parse_weights, read_trained_weights, read_weights,
};
