//! The making of a data set: snapshot by snapshot, cloud by cloud, resumable.

use super::plan::{self, Plan, Planned, Share};
use super::{DatasetSettings, FORMAT, Light, Manifest, Sample};
use crate::cloud::{Cloud, Microphysics, Piece};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::io::{self, Provenance};
use crate::math::DVec3;
use crate::optics::air::Air;
use crate::optics::{DropletTable, Medium};
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Observation, Scene, Sun, Surface, View, view_geometry};
use crate::transport::{self, Solver};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;

/// What of a data set is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Generated {
    /// Samples in the folder, of all or of the share.
    pub samples: usize,
    /// Those of them that were made now and not found.
    pub made: usize,
}

/// Make the samples of a plan in `folder`, from the simulations in `simulations`: those of a
/// share, or all, and then the manifest.
///
/// Samples that are in the folder already are kept: a run that was stopped goes on
/// where it was. `progress` is called for every sample that is made.
///
/// # Errors
/// A simulation or a sample that cannot be read or written; a simulation that is not the
/// one of the plan; settings out of range.
pub fn generate(
    plan: &Plan,
    simulations: &Path,
    folder: &Path,
    share: Option<Share>,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Generated> {
    let workshop = Workshop::open(&plan.configuration, simulations)?;
    let samples = folder.join("samples");
    std::fs::create_dir_all(&samples).map_err(Error::io(&samples))?;
    let droplets = match plan.missing(folder, share) {
        0 => None,
        _ => Some(Arc::new(DropletTable::water(plan.configuration.wavelength)?)),
    };
    let mut manifest = workshop.empty_manifest();
    let mut generated = Generated { samples: 0, made: 0 };
    for snapshot in plan.snapshots(share) {
        let exists = |planned: &Planned| folder.join(planned.file()).exists();
        let missing: Vec<_> = snapshot.iter().filter(|planned| !exists(planned)).collect();
        if let Some(droplets) = &droplets {
            workshop.make(&missing, droplets, folder, progress)?;
        }
        generated.samples += snapshot.len();
        generated.made += missing.len();
        if share.is_none() {
            for planned in snapshot {
                manifest.samples.push(workshop.entry(planned, folder)?);
            }
            manifest.write(folder)?;
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
pub(super) struct Workshop<'a> {
    settings: &'a DatasetSettings,
    simulations: &'a Path,
    sun: Sun,
    surface: Surface,
    air: Option<Air>,
    grid: Grid,
    views: Vec<View>,
}

impl<'a> Workshop<'a> {
    pub(super) fn open(settings: &'a DatasetSettings, simulations: &'a Path) -> Result<Self> {
        settings.check()?;
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
        Ok(Self {
            settings,
            simulations,
            sun: Sun::from_degrees(settings.sun_zenith_deg, settings.sun_azimuth_deg)?,
            surface: Surface::lambertian(settings.surface_albedo),
            air: if settings.air { Some(Air::new(settings.wavelength)?) } else { None },
            grid,
            views: settings.formation()?.views(grid.center(), [columns, columns])?,
        })
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

    /// Make samples of one snapshot, several at a time.
    fn make(
        &self,
        planned: &[&Planned],
        droplets: &Arc<DropletTable>,
        folder: &Path,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<()> {
        let Some(&&Planned { source, snapshot, .. }) = planned.first() else { return Ok(()) };
        let pieces = plan::pieces(self.settings, self.simulations, source, snapshot)?;
        let source = &self.settings.sources[source];
        let simulation = self.simulations.join(&source.file);
        planned.par_iter().try_for_each(|planned| {
            let Some(piece) = pieces.iter().find(|piece| piece.corner == planned.corner) else {
                let problem = format!("snapshot {snapshot} has no cloud at {:?}", planned.corner);
                let remedy = "take the simulation that the data set was begun with";
                return Err(Error::file(&simulation, "cloud", problem, remedy));
            };
            let cloud = self.seed(planned, piece).map_err(Error::in_file(&simulation))?;
            let scene = self.scene(&cloud, source.light, droplets)?;
            self.render(cloud, &scene, &folder.join(planned.file()))?;
            progress(1);
            Ok(())
        })
    }

    /// A sample that is there, as the manifest names it.
    fn entry(&self, planned: &Planned, folder: &Path) -> Result<Sample> {
        let source = &self.settings.sources[planned.source];
        let file = planned.file();
        Ok(Sample {
            sha256: sha256(&folder.join(&file))?,
            file,
            split: source.split,
            source: source.file.clone(),
            snapshot: planned.snapshot,
            corner: planned.corner,
        })
    }

    /// The cloud on the grid of the samples, its water changed and in droplets of a number
    /// of its own.
    fn seed(&self, planned: &Planned, piece: &Piece) -> Result<Cloud> {
        let Planned { source, snapshot, corner: [row, col] } = *planned;
        let key = [source as u64, snapshot as u64, row as u64, col as u64];
        let mut rng = stream(self.settings.seed, Purpose::Dataset, &key);
        let [least, most] = self.settings.droplets_per_cm3;
        let droplets_per_cm3 = least * (most / least).powf(rng.random::<f64>());
        let Some(droplets) = &piece.cloud.microphysics else {
            return Err(Error::out_of_range("liquid water content", "missing", "in a cloud"));
        };
        let mut water = &droplets.liquid_water_content * self.settings.water_share;
        if let Some(variation) = self.settings.sources[source].variation {
            water = variation.draw(&water, self.grid.spacing, &mut rng);
        }
        let droplets = Microphysics::from_droplet_number(water, droplets_per_cm3)?;
        Cloud::from_microphysics(self.grid, droplets)
    }

    /// The cloud of a sample as light goes through it, in air where there is any.
    fn scene(&self, cloud: &Cloud, light: Light, droplets: &Arc<DropletTable>) -> Result<Scene> {
        let (medium, air) = match light {
            Light::Droplets => (Medium::from_droplets(cloud, Arc::clone(droplets))?, self.air),
            Light::Plain => (Medium::from_cloud(cloud)?, None),
        };
        Ok(Scene { air, ..Scene::new(medium, self.sun, self.surface)? })
    }

    /// Render the scene of a cloud and write the sample.
    fn render(&self, cloud: Cloud, scene: &Scene, path: &Path) -> Result<()> {
        let solver = Solver::Ordinates(self.settings.solver.resolve());
        let images = transport::render(scene, &self.views, &solver, &())?.images;
        let mut observation = Observation::new(self.sun, self.views.clone(), images)?;
        observation.wavelength = self.settings.wavelength;
        let configuration = serde_json::to_string(self.settings).unwrap_or_default();
        let seed = self.settings.seed;
        let provenance =
            Provenance { title: "deepct dataset generate".into(), configuration, seed };
        let extinction = Some(scene.medium.extinction.values.clone());
        io::write_sample(path, &Cloud { extinction, ..cloud }, &observation, &provenance)
    }
}
