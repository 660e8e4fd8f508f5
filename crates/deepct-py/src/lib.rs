//! The Python module of deepct.
