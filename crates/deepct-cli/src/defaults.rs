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

#[cfg(test)]
mod tests {
    use super::*;
    use deepct_core::carve::CarveSettings;
    use deepct_core::cloud::{CumulusSettings, FieldSettings};
    use deepct_core::dataset::DatasetSettings;
    use deepct_core::experiment::ExperimentSettings;
    use deepct_core::inversion::InversionSettings;
    use deepct_core::scene::Light;

    /// The commented defaults and those of the library are the same.
    #[test]
    fn commented_defaults_are_those_of_the_library() {
        assert_eq!(toml::from_str::<Light>(LIGHT).unwrap(), Light::default());
        assert_eq!(
            toml::from_str::<ExperimentSettings>(EXPERIMENT).unwrap(),
            ExperimentSettings::default()
        );
        assert_eq!(toml::from_str::<CumulusSettings>(CUMULUS).unwrap(), CumulusSettings::default());
        assert_eq!(toml::from_str::<FieldSettings>(FIELD).unwrap(), FieldSettings::default());
        let invert: toml::Table = INVERT.parse().unwrap();
        let inversion: InversionSettings = invert["inversion"].clone().try_into().unwrap();
        assert_eq!(inversion, InversionSettings::default());
        let carve: CarveSettings = invert["carve"].clone().try_into().unwrap();
        assert_eq!(carve, CarveSettings::default());
        let dataset: DatasetSettings = toml::from_str(DATASET).unwrap();
        assert_eq!(dataset.light, Light::realistic());
    }
}
