//! The commented default settings of the verbs (TOML), as `deepct config` prints them.

/// Of `cloud generate cumulus`.
pub(crate) const CUMULUS: &str = include_str!("defaults/cloud-cumulus.toml");
/// Of `cloud generate field`.
pub(crate) const FIELD: &str = include_str!("defaults/cloud-field.toml");
/// Of `render`, and of every verb that takes `--light`.
pub(crate) const LIGHT: &str = include_str!("defaults/light.toml");
/// Of `infer`.
pub(crate) const INFER: &str = include_str!("defaults/infer.toml");
/// Of `invert` and `hybrid`.
pub(crate) const INVERT: &str = include_str!("defaults/invert.toml");
/// Of `dataset`.
pub(crate) const DATASET: &str = include_str!("defaults/dataset.toml");
/// Of `experiment`.
pub(crate) const EXPERIMENT: &str = include_str!("defaults/experiment.toml");

/// All of them by name.
pub(crate) const ALL: [(&str, &str); 8] = [
    ("cloud-cumulus", CUMULUS),
    ("cloud-field", FIELD),
    ("light", LIGHT),
    ("render", LIGHT),
    ("infer", INFER),
    ("invert", INVERT),
    ("dataset", DATASET),
    ("experiment", EXPERIMENT),
];
