//! The sensor: from radiance to electrons to counts and back.
