//! Data sets for training: what is in them, and how they are made and resumed.
