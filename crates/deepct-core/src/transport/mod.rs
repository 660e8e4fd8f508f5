//! Radiative transfer: from a scene to its images.
