//! Data sets for training: what is in them, and how they are made and resumed.
//!
//! A data set is a folder: `manifest.json` and one file per sample under `samples/`,
//! each with the truth (`extinction`) and what a formation sees of it (`radiance`, by the
//! deterministic solver, without sensor noise: that is drawn anew each time a sample is used).
//! Every sample is one isolated cloud of a large-eddy simulation. The sets are split
//! by time, so that no cloud stands in two of them.

mod check;
mod generate;
mod variation;

pub use check::check;
pub use generate::{Generated, generate};
pub use variation::Variation;

use crate::error::{Error, Result};
use crate::image::ViewGeometry;
use crate::network::Levels;
use crate::scene::Formation;
use crate::transport::OrdinatesSettings;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The name of the format, in every manifest.
pub const FORMAT: &str = "deepct-dataset 1";

/// What a data set is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetSettings {
    /// Seed of the choice of clouds and of their droplet numbers.
    pub seed: u64,
    /// Name of the formation that looks at the clouds.
    pub formation: String,
    /// Angle between +z and the Sun (degrees).
    pub sun_zenith_deg: f64,
    /// Azimuth towards the Sun, clockwise from north (degrees).
    pub sun_azimuth_deg: f64,
    /// Wavelength (um): of the droplets' Mie scattering and of the air.
    pub wavelength: f64,
    /// Albedo of the surface, at altitude 0.
    pub surface_albedo: f64,
    /// Whether there is air.
    pub air: bool,
    /// Least and largest droplet number concentration (1/cm3), from which effective radii
    /// follow: that of each cloud is drawn from between them, evenly in its logarithm.
    pub droplets_per_cm3: [f64; 2],
    /// Share of the liquid water that is kept: 1 is all of it.
    pub water_share: f32,
    /// How the light is computed.
    pub solver: SolverSettings,
    /// Columns of a sample along x and along y.
    pub columns: usize,
    /// Side of a column (km).
    pub column_km: f64,
    /// Levels of a sample.
    pub levels: Levels,
    /// Fewest cloudy columns of a cloud that is taken.
    pub minimum_columns: usize,
    /// Least liquid water path (g/m2) that a cloud must reach to be taken.
    pub minimum_water_path: f32,
    /// Where the clouds come from.
    pub sources: Vec<Source>,
}

/// A stretch of time of one simulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// The simulation, relative to the folder of the simulations.
    pub file: PathBuf,
    /// The set that its clouds belong to.
    pub split: Split,
    /// Index of the first snapshot.
    pub first: usize,
    /// Index of the last snapshot.
    pub last: usize,
    /// Take every so many snapshots.
    pub every: usize,
    /// The most clouds taken of one snapshot, drawn at random.
    pub clouds: usize,
    /// How they are changed; as the simulation made them where this is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
    /// How its clouds scatter light.
    #[serde(default, skip_serializing_if = "Light::is_of_droplets")]
    pub light: Light,
}

/// How the clouds of a source scatter light, and in what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Light {
    /// Each voxel as its droplets do, by Mie's theory, in air if the settings have it.
    #[default]
    Droplets,
    /// All alike, by the function of Henyey and Greenstein, without air: what `deepct render`
    /// does unless it is told otherwise.
    Plain,
}

impl Light {
    fn is_of_droplets(&self) -> bool {
        *self == Self::Droplets
    }
}

/// The settings of the deterministic solver that a data set is computed with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolverSettings {
    /// See [`OrdinatesSettings::zenith_angles`].
    pub zenith_angles: usize,
    /// See [`OrdinatesSettings::tolerance`].
    pub tolerance: f64,
    /// See [`OrdinatesSettings::cell_depth`].
    pub cell_depth: f64,
    /// See [`OrdinatesSettings::most_parts`].
    pub most_parts: usize,
}

/// The set that a sample belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// What a network learns from.
    Train,
    /// What decides when to stop, and what is reported of a training.
    Validation,
    /// What nobody looks at before the end.
    Test,
}

/// One sample of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// Its file, relative to the data set's folder.
    pub file: PathBuf,
    /// The set that it belongs to.
    pub split: Split,
    /// The simulation that it is from.
    pub source: PathBuf,
    /// The index of the snapshot.
    pub snapshot: usize,
    /// Row and column of the simulation at its south-west corner; beyond the sides, it
    /// is counted into the periodic neighbours.
    pub corner: [i64; 2],
    /// SHA-256 of the file, in hexadecimal.
    pub sha256: String,
}

/// `manifest.json`: what a data set holds and how it was made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// Version of the program that made it.
    pub deepct_version: String,
    /// Formation that looked at the clouds.
    pub formation: String,
    /// Its geometry in numbers.
    pub geometry: ViewGeometry,
    /// Rows and columns of an image.
    pub image_shape: [usize; 2],
    /// Size of a voxel along x, y, z (km).
    pub voxel_spacing_km: [f64; 3],
    /// The vertical axis.
    pub levels: Levels,
    /// The settings that made it.
    pub configuration: DatasetSettings,
    /// The samples, sorted by file.
    pub samples: Vec<Sample>,
}

impl SolverSettings {
    pub(super) fn resolve(self) -> OrdinatesSettings {
        let Self { zenith_angles, tolerance, cell_depth, most_parts } = self;
        OrdinatesSettings { zenith_angles, tolerance, cell_depth, most_parts, ..Default::default() }
    }
}

impl DatasetSettings {
    /// Number of snapshots that are read.
    pub fn snapshots(&self) -> usize {
        let count = |source: &Source| (source.first..=source.last).step_by(source.every.max(1));
        self.sources.iter().map(|source| count(source).count()).sum()
    }

    /// The formation by its name.
    ///
    /// # Errors
    /// A name that is no preset.
    pub fn formation(&self) -> Result<Formation> {
        Formation::preset(&self.formation).ok_or_else(|| {
            Error::out_of_range(
                "formation",
                format!("\"{}\"", self.formation),
                format!("one of {}", Formation::PRESETS.join(", ")),
            )
        })
    }
}

impl Manifest {
    /// The manifest of a data set's folder.
    ///
    /// # Errors
    /// A manifest that is missing, unreadable or of another format.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = Self::path(folder);
        let text = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
        let remedy = "make the data set again with `deepct dataset generate`";
        let manifest: Self = serde_json::from_str(&text)
            .map_err(|problem| Error::file(&path, "manifest", problem.to_string(), remedy))?;
        if manifest.format != FORMAT {
            let problem = format!("\"{}\" is not \"{FORMAT}\"", manifest.format);
            return Err(Error::file(&path, "format", problem, remedy));
        }
        Ok(manifest)
    }

    /// Where the manifest of a data set's folder is.
    pub fn path(folder: &Path) -> PathBuf {
        folder.join("manifest.json")
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let path = Self::path(folder);
        let text = serde_json::to_string_pretty(self).map_err(|problem| {
            Error::file(&path, "manifest", problem.to_string(), "report this as a bug")
        })?;
        crate::io::write_text(&path, &text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Cloud, Microphysics};
    use crate::grid::Grid;
    use crate::io::{self, Provenance};
    use crate::math::DVec3;
    use ndarray::Array3;

    /// A simulation of one snapshot with two boxes of cloud, one of them across the
    /// periodic side, and settings that take both.
    fn simulation(folder: &Path) -> DatasetSettings {
        let spacing = DVec3::new(0.05, 0.05, 0.04);
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.48), spacing, [6, 24, 24]).unwrap();
        let box_of_cloud = |k: usize, j: usize, i: usize| {
            let across = (i + 2) % 24 < 4 && (3..7).contains(&j);
            let inside = (8..14).contains(&i) && (14..19).contains(&j);
            (across || inside) && (1..4).contains(&k)
        };
        let water =
            Array3::from_shape_fn(
                grid.shape,
                |(k, j, i)| {
                    if box_of_cloud(k, j, i) { 0.5 } else { 0.0 }
                },
            );
        let droplets = Microphysics::from_droplet_number(water, 100.0).unwrap();
        let field = Cloud::from_microphysics(grid, droplets).unwrap();
        let provenance = Provenance { title: "a test".into(), configuration: "".into(), seed: 0 };
        io::write_cloud(folder.join("field.nc"), &field, &provenance).unwrap();
        DatasetSettings {
            seed: 5,
            formation: "cloudct-10".into(),
            sun_zenith_deg: 30.0,
            sun_azimuth_deg: 45.0,
            wavelength: 0.672,
            surface_albedo: 0.05,
            air: true,
            droplets_per_cm3: [100.0, 100.0],
            water_share: 1.0,
            solver: SolverSettings {
                zenith_angles: 4,
                tolerance: 1e-2,
                cell_depth: 10.0,
                most_parts: 1,
            },
            columns: 12,
            column_km: 0.05,
            levels: Levels { bottom_km: 0.48, count: 6, spacing_km: 0.04 },
            minimum_columns: 10,
            minimum_water_path: 20.0,
            sources: vec![Source {
                file: "field.nc".into(),
                split: Split::Train,
                first: 0,
                last: 0,
                every: 1,
                clouds: 9,
                variation: None,
                light: Light::Droplets,
            }],
        }
    }

    #[test]
    fn a_data_set_is_made_once_checked_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let settings = simulation(folder.path());
        let out = folder.path().join("set");
        let run = |settings| generate(settings, folder.path(), &out, &|_| ());
        assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 2 });
        let manifest = check(&out, &|_| ()).unwrap();

        // 16 columns by 3 levels of 0.5 g/m3 in the one cloud, 30 by 3 in the other.
        let extinction = |sample: &Sample| {
            let volume = io::read_volume(out.join(&sample.file)).unwrap();
            volume.values.iter().map(|value| f64::from(*value)).sum::<f64>()
        };
        let radius = f64::from(crate::cloud::effective_radius(0.5, 100.0));
        for (sample, voxels) in manifest.samples.iter().zip([48.0, 90.0]) {
            // Twice the cross-section, and what waves bend around the edge (Nussenzveig and
            // Wiscombe 1980).
            let edge = 0.9962 * (2.0 * std::f64::consts::PI * radius / 0.672).powf(-2.0 / 3.0);
            let expected = voxels * 1500.0 * 0.5 / radius * (1.0 + edge);
            assert!((extinction(sample) / expected - 1.0).abs() < 5e-3);
        }

        // Again: nothing is made; one lost: it comes back as it was.
        assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 0 });
        std::fs::remove_file(out.join(&manifest.samples[1].file)).unwrap();
        assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 1 });
        assert_eq!(check(&out, &|_| ()).unwrap(), manifest);
    }

    /// What is darker without air and has the geometric extinction is the plain light.
    #[test]
    fn clouds_are_seen_in_the_light_of_their_source() {
        let folder = tempfile::tempdir().unwrap();
        let mut settings = simulation(folder.path());
        let plain = Source { light: Light::Plain, ..settings.sources[0].clone() };
        settings.sources.push(plain);
        let out = folder.path().join("set");
        generate(&settings, folder.path(), &out, &|_| ()).unwrap();
        let samples = Manifest::read(&out).unwrap().samples;
        assert_eq!(samples.len(), 4);
        let radius = crate::cloud::effective_radius(0.5, 100.0);
        let [air, none] = [0, 2].map(|number| {
            let path = out.join(&samples[number].file);
            let largest =
                io::read_volume(&path).unwrap().values.iter().copied().fold(0.0, f32::max);
            (largest, io::read_observation(&path).unwrap().images.values[[5, 0, 0]])
        });
        assert!((none.0 / (1500.0 * 0.5 / radius) - 1.0).abs() < 1e-4 && air.0 > 1.02 * none.0);
        // Straight down beside the cloud, an ocean of albedo 0.05 under the Sun at 30 degrees.
        let ocean = 0.05 * 30.0_f32.to_radians().cos() / std::f32::consts::PI;
        assert!((none.1 / ocean - 1.0).abs() < 0.05 && air.1 > 1.2 * none.1, "{air:?} {none:?}");
    }

    #[test]
    fn a_changed_sample_and_other_settings_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let settings = simulation(folder.path());
        let out = folder.path().join("set");
        generate(&settings, folder.path(), &out, &|_| ()).unwrap();

        let other = DatasetSettings { surface_albedo: 0.1, ..settings.clone() };
        let problem = generate(&other, folder.path(), &out, &|_| ()).unwrap_err().to_string();
        assert!(problem.contains("manifest.json: configuration"), "{problem}");
        let never = Source { every: 0, ..settings.sources[0].clone() };
        let never = DatasetSettings { sources: vec![never], ..settings };
        assert!(generate(&never, folder.path(), &out, &|_| ()).is_err());

        let sample = out.join(&Manifest::read(&out).unwrap().samples[0].file);
        let mut bytes = std::fs::read(&sample).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        std::fs::write(&sample, bytes).unwrap();
        let problem = check(&out, &|_| ()).unwrap_err().to_string();
        assert!(problem.contains("checksum"), "{problem}");
    }
}
