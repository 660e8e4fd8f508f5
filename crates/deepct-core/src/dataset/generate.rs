//! Resumable generation of a data set.

use super::plan::{self, Plan, Planned, Share};
use super::{DatasetSettings, FORMAT, Manifest, Sample};
use crate::cloud::{Cloud, Microphysics, Piece};
use crate::error::{Error, Result};
use crate::files::sha256;
use crate::grid::Grid;
use crate::io::{self, Provenance};
use crate::optics::DropletTable;
use crate::rng::{Purpose, RngExt, stream};
use crate::scene::{Light, Observation, View, view_geometry};
use crate::transport::{self, Solver};
use rayon::prelude::*;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Result of a call of [`generate`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Generated {
    /// Number of samples of the data set or of the share.
    pub samples: usize,
    /// Number of samples that this call generated; the others existed already.
    pub made: usize,
}

/// Generate the samples of a plan in `folder` from the simulations in `simulations`: either those
/// of a share, or all samples and the manifest.
///
/// Samples that exist in the folder are not generated again, so that an interrupted run can be
/// resumed. `progress` is called for every sample that is generated.
///
/// # Errors
/// Returns an error if a simulation or a sample cannot be read or written, if a simulation is not
/// that of the plan, or if settings are out of range.
pub fn generate(
    plan: &Plan,
    simulations: &Path,
    folder: &Path,
    share: Option<Share>,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Generated> {
    let generator = Generator::open(&plan.configuration, simulations)?;
    let samples = folder.join("samples");
    std::fs::create_dir_all(&samples).map_err(Error::io(&samples))?;
    let mut manifest = generator.empty_manifest();
    let mut generated = Generated { samples: 0, made: 0 };
    for snapshot in plan.snapshots(share) {
        let missing: Vec<_> =
            snapshot.iter().filter(|planned| !is_complete(&folder.join(planned.file()))).collect();
        generator.make(&missing, folder, progress)?;
        generated.samples += snapshot.len();
        generated.made += missing.len();
        if share.is_none() {
            for planned in snapshot {
                manifest.samples.push(generator.entry(planned, folder)?);
            }
            manifest.write(folder)?;
        }
    }
    Ok(generated)
}

/// Whether a sample exists and can be read. One that another program has cut off is generated again.
fn is_complete(path: &Path) -> bool {
    path.exists() && io::read_observations(path).is_ok() && io::read_cloud(path).is_ok()
}

/// The scene illumination of a band, and its droplet optics, computed on first use.
struct BandLight {
    light: Light,
    table: OnceLock<Option<Arc<DropletTable>>>,
}

impl BandLight {
    /// The droplet optics, for any cloud: all have the same effective variance.
    fn table(&self, cloud: &Cloud) -> Result<Option<Arc<DropletTable>>> {
        if let Some(table) = self.table.get() {
            return Ok(table.clone());
        }
        let table = self.light.droplet_table(cloud)?;
        Ok(self.table.get_or_init(|| table).clone())
    }
}

/// Data that are common to all samples.
pub(super) struct Generator<'a> {
    settings: &'a DatasetSettings,
    simulations: &'a Path,
    grid: Grid,
    views: Vec<View>,
    /// The illumination of each band of each source.
    lights: Vec<Vec<BandLight>>,
}

impl<'a> Generator<'a> {
    pub(super) fn open(settings: &'a DatasetSettings, simulations: &'a Path) -> Result<Self> {
        settings.check(simulations)?;
        let of_band = |light| BandLight { light, table: OnceLock::new() };
        let of_source = |source| settings.lights(source).into_iter().map(of_band).collect();
        Ok(Self {
            settings,
            simulations,
            grid: settings.grid()?,
            views: settings.views()?,
            lights: settings.sources.iter().map(of_source).collect(),
        })
    }

    fn empty_manifest(&self) -> Manifest {
        Manifest {
            format: FORMAT.into(),
            deepct_version: env!("CARGO_PKG_VERSION").into(),
            formation: self.settings.formation.clone(),
            geometry: view_geometry(&self.settings.light.sun, &self.views),
            image_shape: [self.settings.columns; 2],
            voxel_spacing_km: self.grid.spacing.to_array(),
            levels: self.settings.levels,
            configuration: self.settings.clone(),
            samples: Vec::new(),
        }
    }

    /// Generate samples of one snapshot in parallel.
    fn make(
        &self,
        planned: &[&Planned],
        folder: &Path,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<()> {
        let Some(&&Planned { source, snapshot, .. }) = planned.first() else { return Ok(()) };
        let pieces = plan::pieces(self.settings, self.simulations, source, snapshot)?;
        let source = &self.settings.sources[source];
        let simulation = self.simulations.join(&source.file);
        planned.par_iter().try_for_each(|planned| {
            let remedy = "use the simulation with which the data set was started";
            let Some(piece) = pieces.iter().find(|piece| piece.corner == planned.corner) else {
                let problem = format!("snapshot {snapshot} has no cloud at {:?}", planned.corner);
                return Err(Error::file(&simulation, "cloud", problem, remedy));
            };
            if plan::water_sha256(piece) != planned.water_sha256 {
                let problem = format!("snapshot {snapshot} has changed since the plan was made");
                return Err(Error::file(&simulation, "lwc", problem, remedy));
            }
            let cloud = self.seed(planned, piece).map_err(Error::in_file(&simulation))?;
            self.render(planned.source, cloud, &folder.join(planned.file()))?;
            progress(1);
            Ok(())
        })
    }

    /// The manifest entry of an existing sample.
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

    /// The cloud on the grid of the samples, with varied water and a randomly drawn droplet number
    /// concentration.
    fn seed(&self, planned: &Planned, piece: &Piece) -> Result<Cloud> {
        let Planned { source, snapshot, corner: [row, col], .. } = *planned;
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

    /// Render a cloud with the scene illumination of its source in each band, and write the sample.
    fn render(&self, source: usize, cloud: Cloud, path: &Path) -> Result<()> {
        let solver = Solver::Ordinates(self.settings.solver.resolve());
        let band = |band: &BandLight| {
            let scene = band.light.scene_with(&cloud, band.table(&cloud)?)?;
            let images = transport::render(&scene, &self.views, &solver, &())?.images;
            let light = band.light.recorded(&cloud);
            let observation = Observation::new(light, self.views.clone(), images)?;
            Ok((scene.medium.extinction.values, observation))
        };
        let bands = self.lights[source].iter().map(band).collect::<Result<Vec<_>>>()?;
        let (mut extinctions, observations): (Vec<_>, Vec<_>) = bands.into_iter().unzip();
        let configuration = serde_json::to_string(self.settings).unwrap_or_default();
        let seed = self.settings.seed;
        let provenance = Provenance {
            title: "deepct dataset generate".into(),
            configuration,
            seed,
            ..Provenance::default()
        };
        let extinction = Some(extinctions.swap_remove(0));
        io::write_sample(path, &Cloud { extinction, ..cloud }, &observations, &provenance)
    }
}
