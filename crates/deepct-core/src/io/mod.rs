//! Files: HDF5/netCDF-4, safetensors, and the formats of others.
