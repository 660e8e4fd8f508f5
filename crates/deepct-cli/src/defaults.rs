//! Default settings of the verbs (TOML with comments), as printed by `deepct config`.

/// Settings of `cloud generate --kind cumulus`.
pub(crate) const CUMULUS: &str = include_str!("defaults/cloud-cumulus.toml");
/// Settings of `cloud generate --kind field`.
pub(crate) const FIELD: &str = include_str!("defaults/cloud-field.toml");
/// Scene illumination, for `render` and all verbs with the option `--light`.
pub(crate) const LIGHT: &str = include_str!("defaults/light.toml");
/// Settings of `infer`.
pub(crate) const INFER: &str = include_str!("defaults/infer.toml");
/// Settings of `invert` and `hybrid`.
pub(crate) const INVERT: &str = include_str!("defaults/invert.toml");
/// Settings of `dataset`.
pub(crate) const DATASET: &str = include_str!("defaults/dataset.toml");
/// Settings of `experiment`.
pub(crate) const EXPERIMENT: &str = include_str!("defaults/experiment.toml");

/// All settings by name.
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
