//! The clouds of an experiment and their images.

use super::ExperimentSettings;
use crate::cloud::{Cloud, CumulusSettings, cumulus};
use crate::dataset::Manifest;
use crate::error::{Error, Result};
use crate::files;
use crate::image::ViewStack;
use crate::io::{self, Provenance};
use crate::rng::seed_of_part;
use crate::scene::{Formation, Observation, View, target};
use crate::sensor::{Scale, expose};
use crate::transport::{self, MonteCarloSettings, Solver};
use ndarray::{Array3, Axis};
use std::path::{Path, PathBuf};

/// The formation of clouds without images if neither the settings nor the weights name one.
const FORMATION: &str = "cloudct-10";

/// Largest angle between a view of a data set and the matching view of a formation (degrees).
const SAME_VIEW_DEG: f64 = 0.1;

/// The origin of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Origin {
    /// A cloud file.
    File(PathBuf),
    /// The cloud generator with this seed.
    Generated(u64),
    /// A sample of a data set.
    Sample(PathBuf),
}

/// A cloud with its name, number and origin.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Case {
    pub(super) name: String,
    pub(super) number: u64,
    pub(super) origin: Origin,
}

/// The clouds that the settings specify.
pub(super) fn cases(settings: &ExperimentSettings) -> Result<Vec<Case>> {
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut cases: Vec<(String, Origin)> =
        settings.clouds.iter().map(|file| (stem(file), Origin::File(file.clone()))).collect();
    cases.extend((0..settings.generated as u64).map(|number| {
        let seed = seed_of_part(settings.seed, number);
        (format!("generated-{}", number + 1), Origin::Generated(seed))
    }));
    if let Some(folder) = &settings.dataset {
        let manifest = Manifest::read(folder)?;
        let set: Vec<_> =
            manifest.samples.iter().filter(|sample| sample.split == settings.split).collect();
        if set.len() < settings.samples {
            let range = format!("at most {}, the size of the split", set.len());
            return Err(Error::out_of_range("samples", settings.samples, range));
        }
        cases.extend((0..settings.samples).map(|number| {
            let sample = set[(2 * number + 1) * set.len() / (2 * settings.samples)];
            (format!("sample-{}", stem(&sample.file)), Origin::Sample(folder.join(&sample.file)))
        }));
    }
    for (number, (name, _)) in cases.iter().enumerate() {
        if cases[..number].iter().any(|(other, _)| other == name) {
            return Err(Error::out_of_range("clouds", name, "names that differ from each other"));
        }
    }
    let numbered = cases.into_iter().zip(0..);
    Ok(numbered.map(|((name, origin), number)| Case { name, number, origin }).collect())
}

/// Reads all files of clouds: one that cannot be used would otherwise be found only after hours of
/// work on those before it.
pub(super) fn check_files(settings: &ExperimentSettings) -> Result<()> {
    for file in &settings.clouds {
        settings.light.extinction(&io::read_cloud(file)?).map_err(Error::in_file(file))?;
    }
    Ok(())
}

impl Case {
    /// Checksum of the file of the cloud; `None` for a generated one.
    pub(super) fn sha256(&self) -> Result<Option<String>> {
        match &self.origin {
            Origin::File(path) | Origin::Sample(path) => files::sha256(path).map(Some),
            Origin::Generated(_) => Ok(None),
        }
    }

    /// The cloud with its extinction, and the noisy images of the views of a formation. They are
    /// computed once and stored in `path`.
    pub(super) fn open(
        &self,
        path: &Path,
        settings: &ExperimentSettings,
        formation: Option<&str>,
    ) -> Result<(Cloud, Observation)> {
        if !path.exists() {
            let (cloud, clean) = self.make(settings, formation)?;
            let observation = through_sensor(&clean, settings, self.number)?;
            let provenance = Provenance {
                title: format!("{}: truth and noisy images", self.name),
                configuration: toml::to_string(settings).expect("plain numbers and text"),
                seed: settings.seed,
                ..Provenance::default()
            };
            io::write_sample(path, &cloud, std::slice::from_ref(&observation), &provenance)?;
        }
        Ok((io::read_cloud(path)?, io::read_observation(path)?))
    }

    fn make(
        &self,
        settings: &ExperimentSettings,
        formation: Option<&str>,
    ) -> Result<(Cloud, Observation)> {
        let cloud = match &self.origin {
            Origin::Sample(path) => {
                let mut observation = io::read_observation(path)?;
                if let Some(name) = formation {
                    observation =
                        select_views(&observation, &preset(name)?).map_err(Error::in_file(path))?;
                }
                return Ok((io::read_cloud(path)?, observation));
            }
            Origin::File(path) => io::read_cloud(path)?,
            Origin::Generated(seed) => cumulus(&CumulusSettings::default(), *seed)?,
        };
        let scene = settings.light.scene(&cloud)?;
        let truth = scene.medium.extinction.clone();
        let formation = preset(formation.unwrap_or(FORMATION))?;
        let [_, rows, cols] = truth.grid.shape;
        let views = formation.views(truth.grid.center(), [rows, cols])?;
        let solver = Solver::MonteCarlo(MonteCarloSettings {
            samples_per_pixel: settings.samples_per_pixel,
            similarity_after: settings.similarity_after,
            seed: seed_of_part(settings.seed, self.number),
            noise: None,
        });
        let rendering = transport::render(&scene, &views, &solver, &())?;
        let light = settings.light.recorded(&cloud);
        let mut observation = Observation::new(light, views, rendering.images)?;
        observation.standard_error = rendering.standard_error;
        Ok((Cloud { extinction: Some(truth.values), ..cloud }, observation))
    }
}

/// Apply the sensor model of the settings to the images.
fn through_sensor(
    clean: &Observation,
    settings: &ExperimentSettings,
    number: u64,
) -> Result<Observation> {
    let Some(sensor) = settings.sensor()? else { return Ok(clean.clone()) };
    let seed = seed_of_part(settings.seed, number);
    Ok(expose(clean, &sensor, Scale::BrightestAtFullWell, seed)?.observation)
}

fn preset(formation: &str) -> Result<Formation> {
    Formation::preset(formation)
        .ok_or_else(|| Error::out_of_range("formation", formation, "the name of a built-in one"))
}

/// Select the views of an observation that are those of a formation, in the order of the formation.
fn select_views(observation: &Observation, formation: &Formation) -> Result<Observation> {
    let (target, [_, rows, cols]) = (target(&observation.views)?, observation.images.shape());
    let chosen: Vec<usize> = formation
        .views(target, [rows, cols])?
        .iter()
        .enumerate()
        .map(|(number, wanted)| {
            let near = |view: &View| {
                view.towards().angle_between(wanted.towards()).to_degrees() < SAME_VIEW_DEG
            };
            observation.views.iter().position(near).ok_or_else(|| {
                Error::mismatch(
                    "views of the data set",
                    format!("one in the direction of view {number} of the formation"),
                    "none",
                    "use a data set that has all views of the formation",
                )
            })
        })
        .collect::<Result<_>>()?;
    let select = |images: &Array3<f32>| images.select(Axis(0), &chosen);
    let mut selected = Observation::new(
        observation.light.clone(),
        chosen.iter().map(|view| observation.views[*view].clone()).collect(),
        ViewStack::with_missing(select(&observation.images.values))?,
    )?;
    selected.assumed.clone_from(&observation.assumed);
    let errors = observation.standard_error.as_ref();
    selected.saturated = observation.saturated.as_ref().map(|marks| marks.select(Axis(0), &chosen));
    selected.standard_error =
        errors.map(|errors| ViewStack::of_errors(select(&errors.values))).transpose()?;
    Ok(selected)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Sun;

    #[test]
    fn ten_of_the_32_views_are_those_of_the_paper() {
        let target = crate::math::DVec3::new(0.1, 0.2, 1.0);
        let views = Formation::pearls_32().views(target, [2, 2]).unwrap();
        let images = Array3::from_shape_fn((32, 2, 2), |(view, _, _)| view as f32);
        let observation =
            Observation::new(Sun::default(), views, ViewStack::new(images).unwrap()).unwrap();
        let selected = select_views(&observation, &Formation::cloudct_10()).unwrap();
        let expected = Formation::cloudct_10().views(target, [2, 2]).unwrap();
        assert_eq!(selected.views.len(), 10);
        for ((view, expected), image) in
            selected.views.iter().zip(&expected).zip(selected.images.values.outer_iter())
        {
            assert!(view.towards().angle_between(expected.towards()).to_degrees() < 0.01);
            let number = image[[0, 0]] as usize;
            assert_eq!(*view, observation.views[number]);
        }
        let less = Observation::new(
            Sun::default(),
            observation.views[..16].to_vec(),
            ViewStack::new(Array3::zeros((16, 2, 2))).unwrap(),
        );
        assert!(select_views(&less.unwrap(), &Formation::cloudct_10()).is_err());
    }

    #[test]
    fn clouds_have_names_of_their_own() {
        let settings = ExperimentSettings {
            clouds: vec!["a/one.nc".into(), "b/two.nc".into()],
            generated: 2,
            seed: 5,
            ..Default::default()
        };
        let names: Vec<_> = cases(&settings).unwrap().into_iter().map(|case| case.name).collect();
        assert_eq!(names, ["one", "two", "generated-1", "generated-2"]);
        let clouds = vec!["a/one.nc".into(), "b/one.nc".into()];
        assert!(cases(&ExperimentSettings { clouds, ..settings }).is_err());
    }
}
