//! `deepct formats`: the supported file formats.

use crate::outcome::Outcome;

/// List the file formats that can be read and written
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

const FORMATS: &str = "\
Read and written (HDF5 files that are valid netCDF-4, with CF attributes)
  cloud    lwc (g m-3), reff (um), veff and/or extinction (km-1) on (z, y, x)
  volume   extinction (km-1), and uncertainty (km-1) and reff (um) if known, on (z, y, x)
  mask     mask, 1 inside and 0 outside, on (z, y, x)
  images   radiance (sr-1) on (view, row, col) in any order, and on wavelength if there are
           several bands, NaN where missing; sun_zenith_deg,
           sun_azimuth_deg (degree), wavelength (um); for each view target (km) and either
           camera_position (km) and pixel_tangent (perspective cameras), or view_zenith_deg,
           view_azimuth_deg (degree) and pixel_km (orthographic ones), or, on (view, row, col,
           component), pixel_position (km) and pixel_direction; the rest is derived, see
           `images check`

Read by `cloud import`
  simulation   netCDF (classic or netCDF-4) or HDF5: liquid water on (time, z, y, x) in any
               order, as mass per volume or as a mixing ratio with the density of air, or
               droplet spectra of WRF's bin microphysics (ff1i01, ff1i02, ...), or extinction;
               variables may be packed, big-endian or chunked, levels may be stretched;
               values are converted from their units, and --units states missing ones;
               --axes states the axes of files without names of them (MATLAB 7.3);
               data sets of AT3D (density, reff) also without units
  pySHDOM      text: a comment; nx ny nz; dx dy z0 z1 ...; rows i j k lwc reff [veff]
  AT3D         text: a comment; nx,ny,nz; dx,dy; z0,z1,...; names of columns, among
               them x,y,z (or i,j,k), lwc, reff and veff; rows
  SHDOM        text: the title `2 parameter LWC file`; nx ny nz; dx dy; nz altitudes of
               levels, or nz+1 of their faces; as many temperatures; rows i j k lwc reff
               with indices from 1; property files (extinction only, tabulated,
               standard) for their extinction
  MYSTIC       text (libRadtran): nx ny nz flag; dx dy and nz+1 altitudes of faces; rows with
               indices from 1: i j k extinction asymmetry albedo (flag 1), i j k extinction
               reff (flag 2), or i j k lwc reff (flag 3)

Arrays, read by `cloud import`, `convert` and `regrid`; --variable, --units, --axes, --spacing and
--base of `cloud import` state what they lack; files of `convert` need none of them
  name   read                                       written  limits
  .npy   NumPy, all versions                        no       real numbers
  .npz   NumPy, stored or compressed                yes      real numbers
  .mat   MATLAB 5 to 7 with structures and cells    yes      no sparse or complex arrays
  .pkl   pickles, protocols 2 to 5                  no       NumPy arrays, numbers, texts, lists
                                                             and dictionaries; nothing is executed
  .vol   Mitsuba, version 3, 32-bit floats          yes      extinction; one channel
  .vti   VTK image data, raw, not compressed        yes      values of cells; one piece

Read by other verbs
  grid      TOML: origin_km, spacing_km (x, y, z), shape (nz, ny, nx); or any field above
  weights   safetensors with metadata; see `weights inspect`
  settings  TOML; see `config VERB`

Written by `convert`, by the ending of the name
  .vti      fields: VTK image data for ParaView, one value per cell, lengths in km
  .vol      extinction (km-1): grid volume of Mitsuba 3; bounding box in km
            (use_grid_bbox = true)
  .npz      fields or images: NumPy arrays with the names of the variables above, [z, y, x]
            and [view, row, col], and the grid (origin_km, spacing_km: x, y, z)
  .mat      the same arrays for MATLAB, Octave and SciPy (version 5)
  .tif      images: 16-bit grey levels, one page per view, north up; the description of a
            page has the radiance of a grey level
  .png      images: the same, one file per view
  .exr      images: OpenEXR, 32-bit floats, one layer per view, north up (also render --exr)

Written by `plot`, `render --png` and `images check --png`
  .png      figures as pixels
  .svg      figures as lines and text, with colour maps as pixels
  .pdf      the same
";

pub(crate) fn run(_args: &Args) -> deepct_core::Result<Outcome> {
    crate::print::raw(FORMATS);
    Ok(Outcome::Success)
}
