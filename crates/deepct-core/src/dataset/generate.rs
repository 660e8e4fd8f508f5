//! The making of a data set: snapshot by snapshot, cloud by cloud, resumable.

use super::{DatasetSettings, FORMAT, Light, Manifest, Sample, Source};
use crate::cloud::{self, Cloud, IsolateSettings, Isolated, Microphysics};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::io::import::{ImportSettings, import_cloud};
use crate::io::{self, Provenance};
use crate::math::DVec3;
use crate::optics::air::Air;
use crate::optics::{DropletSettings, DropletTable, Medium};
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Observation, Scene, Sun, Surface, View, view_geometry};
use crate::transport::{self, Solver};
use ndarray::Array3;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How far the making of a data set has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Generated {
    /// Samples in the folder.
    pub samples: usize,
    /// Those of them that were made now and not found.
    pub made: usize,
}

/// Make the data set of `settings` in `folder` from the simulations in `simulations`.
///
/// Samples that are in the folder already are kept: a run that was stopped goes on
/// where it was. `progress` is called after every snapshot with what is there.
///
/// # Errors
/// A folder with a data set of other settings; a simulation or a sample that cannot
/// be read or written; settings out of range.
pub fn generate(
    settings: &DatasetSettings,
    simulations: &Path,
    folder: &Path,
    progress: &(dyn Fn(Generated) + Sync),
) -> Result<Generated> {
    let workshop = Workshop::open(settings, simulations, folder)?;
    let mut manifest = workshop.empty_manifest();
    let mut generated = Generated { samples: 0, made: 0 };
    for (number, source) in settings.sources.iter().enumerate() {
        for snapshot in (source.first..=source.last).step_by(source.every) {
            for isolated in workshop.clouds(number, source, snapshot)? {
                let (sample, made) = workshop.sample(number, source, snapshot, &isolated)?;
                manifest.samples.push(sample);
                generated.samples += 1;
                generated.made += usize::from(made);
            }
            manifest.write(folder)?;
            progress(generated);
        }
    }
    Ok(generated)
}

/// SHA-256 of a file, in hexadecimal.
pub(super) fn sha256(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    Ok(Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// What stays the same from sample to sample.
struct Workshop<'a> {
    settings: &'a DatasetSettings,
    simulations: &'a Path,
    folder: &'a Path,
    sun: Sun,
    surface: Surface,
    air: Option<Air>,
    droplets: Arc<DropletTable>,
    grid: Grid,
    views: Vec<View>,
}

impl<'a> Workshop<'a> {
    fn open(
        settings: &'a DatasetSettings,
        simulations: &'a Path,
        folder: &'a Path,
    ) -> Result<Self> {
        let [least, most] = settings.droplets_per_cm3;
        if !(least > 0.0 && least <= most && most.is_finite()) {
            let found = format!("[{least}, {most}]");
            return Err(Error::out_of_range("droplets_per_cm3", found, "positive, least first"));
        }
        if !(settings.water_share > 0.0 && settings.water_share.is_finite()) {
            return Err(Error::out_of_range("water_share", settings.water_share, "positive"));
        }
        if let Some(source) = settings.sources.iter().find(|source| source.every == 0) {
            let name = source.file.display();
            return Err(Error::out_of_range("every", format!("0 for {name}"), "at least 1"));
        }
        for variation in settings.sources.iter().filter_map(|source| source.variation) {
            variation.check()?;
        }
        if Manifest::path(folder).exists() && Manifest::read(folder)?.configuration != *settings {
            return Err(Error::file(
                Manifest::path(folder),
                "configuration",
                "differs from the one asked for",
                "choose another folder, or the settings that the data set was begun with",
            ));
        }
        for source in &settings.sources {
            let path = simulations.join(&source.file);
            std::fs::File::open(&path).map_err(Error::io(path))?;
        }
        let columns = settings.columns;
        let levels = settings.levels;
        // The horizontal place of a cloud does not matter: every sample stands at 0.
        let grid = Grid::new(
            DVec3::new(0.0, 0.0, levels.bottom_km),
            DVec3::new(settings.column_km, settings.column_km, levels.spacing_km),
            [levels.count, columns, columns],
        )?;
        let workshop = Self {
            settings,
            simulations,
            folder,
            sun: Sun::from_degrees(settings.sun_zenith_deg, settings.sun_azimuth_deg)?,
            surface: Surface::lambertian(settings.surface_albedo),
            air: if settings.air { Some(Air::new(settings.wavelength)?) } else { None },
            droplets: Arc::new(DropletTable::of(&DropletSettings::water(settings.wavelength))?),
            grid,
            views: settings.formation()?.views(grid.center(), [columns, columns])?,
        };
        // Nothing is left behind by settings that cannot work.
        let samples = folder.join("samples");
        std::fs::create_dir_all(&samples).map_err(Error::io(&samples))?;
        Ok(workshop)
    }

    fn empty_manifest(&self) -> Manifest {
        Manifest {
            format: FORMAT.into(),
            deepct_version: env!("CARGO_PKG_VERSION").into(),
            formation: self.settings.formation.clone(),
            geometry: view_geometry(&self.sun, &self.views),
            image_shape: [self.settings.columns; 2],
            voxel_spacing_km: self.grid.spacing.to_array(),
            levels: self.settings.levels,
            configuration: self.settings.clone(),
            samples: Vec::new(),
        }
    }

    /// The whole field of one snapshot, on the samples' levels.
    fn field(&self, source: &Source, snapshot: usize) -> Result<Cloud> {
        let settings = ImportSettings {
            time: snapshot,
            droplets_per_cm3: Some(self.settings.droplets_per_cm3[0]),
            spacing: Some(self.grid.spacing),
            base: Some(self.settings.levels.bottom_km),
            levels: Some(self.settings.levels.count),
            ..ImportSettings::default()
        };
        import_cloud(self.simulations.join(&source.file), &settings)
    }

    /// The clouds of one snapshot that are taken, in the order of their places.
    fn clouds(&self, number: usize, source: &Source, snapshot: usize) -> Result<Vec<Isolated>> {
        let field = self.field(source, snapshot)?;
        let settings = IsolateSettings {
            side: self.settings.columns,
            columns: self.settings.minimum_columns,
            water_path: self.settings.minimum_water_path,
            ..IsolateSettings::default()
        };
        let mut clouds = cloud::isolate(&field, &settings)?;
        let indices = [number as u64, snapshot as u64];
        let mut rng = stream(self.settings.seed, Purpose::Dataset, &indices);
        while clouds.len() > source.clouds {
            clouds.remove(rng.random_range(0..clouds.len()));
        }
        Ok(clouds)
    }

    /// The sample of one cloud, and whether it had to be made.
    fn sample(
        &self,
        number: usize,
        source: &Source,
        snapshot: usize,
        isolated: &Isolated,
    ) -> Result<(Sample, bool)> {
        let [row, col] = isolated.corner;
        let file = PathBuf::from(format!("samples/{number}-{snapshot:03}-{row}-{col}.nc"));
        let path = self.folder.join(&file);
        let missing = !path.exists();
        if missing {
            let key = [number as u64, snapshot as u64, row as u64, col as u64];
            let mut rng = stream(self.settings.seed, Purpose::Dataset, &key);
            let [least, most] = self.settings.droplets_per_cm3;
            let droplets_per_cm3 = least * (most / least).powf(rng.random::<f64>());
            let cloud = self.seed_droplets(&isolated.cloud, droplets_per_cm3, |water| {
                let Some(variation) = source.variation else { return water };
                variation.draw(&water, self.grid.spacing, &mut rng)
            });
            let cloud = cloud.map_err(Error::in_file(&self.simulations.join(&source.file)))?;
            self.make(&cloud, source.light, &path)?;
        }
        let sample = Sample {
            sha256: sha256(&path)?,
            file,
            split: source.split,
            source: source.file.clone(),
            snapshot,
            corner: isolated.corner,
        };
        Ok((sample, missing))
    }

    /// The cloud on the grid of the samples, its water changed and in so many droplets.
    fn seed_droplets(
        &self,
        cloud: &Cloud,
        droplets_per_cm3: f64,
        vary: impl FnOnce(Array3<f32>) -> Array3<f32>,
    ) -> Result<Cloud> {
        let Some(droplets) = &cloud.microphysics else {
            return Err(Error::out_of_range("liquid water content", "missing", "in a cloud"));
        };
        let water = vary(&droplets.liquid_water_content * self.settings.water_share);
        let droplets = Microphysics::from_droplet_number(water, droplets_per_cm3)?;
        Cloud::from_microphysics(self.grid, droplets)
    }

    /// Render one cloud and write the sample.
    fn make(&self, cloud: &Cloud, light: Light, path: &Path) -> Result<()> {
        let (medium, air) = match light {
            Light::Droplets => (Medium::from_droplets(cloud, self.droplets.clone())?, self.air),
            Light::Plain => (Medium::from_cloud(cloud)?, None),
        };
        let truth = medium.extinction.clone();
        let scene = Scene { air, ..Scene::new(medium, self.sun, self.surface)? };
        let solver = Solver::Ordinates(self.settings.solver.resolve());
        let images = transport::render(&scene, &self.views, &solver, &())?.images;
        let mut observation = Observation::new(self.sun, self.views.clone(), images)?;
        observation.wavelength = self.settings.wavelength;
        let configuration = serde_json::to_string(self.settings).unwrap_or_default();
        let seed = self.settings.seed;
        let provenance =
            Provenance { title: "deepct dataset generate".into(), configuration, seed };
        io::write_sample(path, &truth, &observation, &provenance)
    }
}
