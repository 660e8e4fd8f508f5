//! Space carving: which voxels the images allow to hold cloud.
