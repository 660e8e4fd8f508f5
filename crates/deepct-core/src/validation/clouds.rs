//! The discrete-ordinates solver compared with the Monte Carlo solver for whole clouds, by the
//! cloud signal and the bright pixels.
//!
//! Most pixels of an image of a small cloud show the ocean surface, so the mean radiance of a view
//! contains little information about the cloud. The cloud signal of a view is the radiance minus
//! that of the same scene without the cloud, summed over the pixels whose field of view intersects
//! the cloud. The error of bright pixels is the root mean square of the relative difference after
//! subtraction of the variance of the Monte Carlo images.

use super::{Effort, Row, Suite};
use crate::cloud::{Cloud, CumulusSettings, cumulus};
#[cfg(feature = "files")]
use crate::error::Error;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::math::{DVec3, towards};
use crate::optics::{DropletSettings, DropletTable, Medium};
use crate::scene::{
    Boundary, Formation, Light, Observation, PhaseModel, Scene, Sun, Surface, View,
};
use crate::transport::{
    BRIGHT, MonteCarloSettings, OrdinatesModel, OrdinatesSettings, Rendering, Solver, radiances,
    render,
};
use crate::traverse::walk;
use ndarray::Array3;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Accepted relative error of the cloud signal of a view.
const SIGNAL_TOLERANCE: f64 = 0.015;
/// Accepted root mean square error of bright pixels, averaged over the clouds.
const PIXEL_TOLERANCE: f64 = 0.015;
/// Accepted relative difference between the estimated and the measured error of bright pixels.
const ESTIMATE_TOLERANCE: f64 = 0.5;
/// Number of rays along each side of a pixel that test whether it intersects the cloud.
const RAYS: usize = 4;
/// View zenith angle, and view azimuth relative to the solar azimuth (degrees).
const VIEWS_DEG: [(f64, f64); 6] =
    [(0.0, 0.0), (15.0, 80.0), (30.0, 180.0), (40.0, 250.0), (50.0, 130.0), (60.0, 310.0)];
/// Angles of four additional views from exact backscatter (degrees).
const BACKSCATTER_DEG: [f64; 4] = [0.0, 1.0, 3.0, 10.0];
/// Width of the margin around the cloud on each side of an image (pixels).
const PIXELS_AROUND: f64 = 2.0;

/// A cloud with its scene illumination and views.
#[derive(Debug, Clone)]
pub struct CloudCase {
    /// Name of the case.
    pub name: String,
    /// The scene illumination.
    pub light: Light,
    /// The scene of the cloud with this illumination.
    pub scene: Scene,
    /// Six views from 0 to 60 degrees, and four at 0, 1, 3 and 10 degrees from backscatter.
    pub views: Vec<View>,
    /// Number of voxels with extinction.
    pub voxels: usize,
}

/// Errors of the image of a view relative to that of the Monte Carlo solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewError {
    /// Relative error of the cloud signal.
    pub signal: f64,
    /// Standard error of `signal` due to the noise of the reference.
    pub signal_noise: f64,
    /// Relative error of the sum of the pixels beside the cloud.
    pub beside: f64,
    /// Root mean square of the relative error of bright pixels after subtraction of the variance of
    /// the reference.
    pub pixels: f64,
    /// Root mean square of the relative noise of the reference in bright pixels.
    pub pixel_noise: f64,
}

/// Optical properties of the cloud and its surroundings.
#[derive(Debug, Clone, Copy)]
enum Scatterers {
    /// Mie scattering at a wavelength (um), with molecular atmosphere, above the ocean surface.
    Droplets(f64),
    /// Henyey-Greenstein phase function without molecular atmosphere, above a black surface.
    Greenstein,
}

impl Scatterers {
    /// The scene illumination for a solar zenith angle (degrees), with the Sun in the north-east.
    fn light(self, sun_zenith: f64) -> Result<Light> {
        let light = match self {
            Self::Droplets(wavelength) => Light { wavelength, ..Light::realistic() },
            Self::Greenstein => Light { surface: Surface::BLACK, ..Light::default() },
        };
        Ok(Light { sun: Sun::from_degrees(sun_zenith, 45.0)?, ..light })
    }
}

/// Source of a cloud.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(not(feature = "files"), allow(dead_code))]
enum Source {
    /// The generator: seed, width and depth (km), droplet number concentration (per cm3).
    Generated(u64, f64, f64, f64),
    /// The BOMEX simulation: index of the snapshot, number of voxels and droplet number
    /// concentration (per cm3). The isolated cloud closest to this number of voxels is used.
    Bomex(usize, usize, f64),
    /// A dense cumulus of the RICO simulation.
    Rico,
}

/// All cases: name, source, solar zenith angle (degrees), optical properties. The generated clouds
/// require no file.
const CASES: [(&str, Source, f64, Scatterers); 14] = {
    use Scatterers::{Droplets, Greenstein};
    use Source::{Bomex, Generated, Rico};
    [
        ("generated 1, small", Generated(1, 0.35, 0.30, 100.0), 20.0, Droplets(0.672)),
        ("generated 2, thin", Generated(2, 0.45, 0.16, 50.0), 40.0, Droplets(0.672)),
        ("generated 3, medium", Generated(3, 0.55, 0.50, 150.0), 60.0, Greenstein),
        ("generated 4, blue", Generated(4, 0.50, 0.40, 300.0), 40.0, Droplets(0.446)),
        ("BOMEX, thin", Bomex(20, 60, 50.0), 40.0, Droplets(0.672)),
        ("BOMEX, thin, no air", Bomex(20, 60, 50.0), 30.0, Greenstein),
        ("BOMEX, small", Bomex(40, 120, 100.0), 20.0, Droplets(0.672)),
        ("BOMEX, low Sun", Bomex(60, 150, 300.0), 60.0, Droplets(0.672)),
        ("BOMEX, blue", Bomex(80, 200, 100.0), 40.0, Droplets(0.446)),
        ("BOMEX, medium", Bomex(30, 400, 200.0), 40.0, Droplets(0.672)),
        ("BOMEX, large", Bomex(50, 900, 600.0), 20.0, Droplets(0.672)),
        ("BOMEX, large, no air", Bomex(70, 700, 100.0), 60.0, Greenstein),
        ("RICO, dense", Rico, 40.0, Droplets(0.672)),
        ("RICO, dense, no air", Rico, 20.0, Greenstein),
    ]
};

/// The cases. Those of simulations are included if a `folder` with their files is given
/// (`bomex/bomex_6km_seed2.nc`, `rico55/truth_*.nc`).
///
/// # Errors
/// Returns an error if a file cannot be read.
pub fn cases(folder: Option<&Path>) -> Result<Vec<CloudCase>> {
    let mut tables = BTreeMap::new();
    let mut made = Vec::new();
    for (name, source, sun_zenith, scatterers) in CASES {
        let cloud = match (source, folder) {
            (Source::Generated(seed, width, depth, droplets), _) => {
                generated(seed, width, depth, droplets)?
            }
            #[cfg(feature = "files")]
            (Source::Bomex(time, voxels, droplets), Some(folder)) => {
                bomex(folder, time, voxels, droplets)?
            }
            #[cfg(feature = "files")]
            (Source::Rico, Some(folder)) => rico(folder)?,
            _ => continue,
        };
        let light = scatterers.light(sun_zenith)?;
        let table = match tables.get(&light.wavelength.to_bits()) {
            Some(table) => Some(Arc::clone(table)),
            None => light.droplet_table(&cloud)?,
        };
        if let Some(table) = &table {
            tables.insert(light.wavelength.to_bits(), Arc::clone(table));
        }
        let table = table.filter(|_| light.optics.phase == PhaseModel::Mie);
        made.push(CloudCase::new(name, light.clone(), light.scene_with(&cloud, table)?)?);
    }
    Ok(made)
}

/// A generated cumulus with the voxel size of the simulations.
fn generated(seed: u64, width: f64, depth: f64, droplets: f64) -> Result<Cloud> {
    let settings = CumulusSettings {
        width_km: Some(width),
        depth_km: Some(depth),
        droplets_per_cm3: droplets,
        ..CumulusSettings::default()
    };
    cumulus(&settings, seed)
}

#[cfg(feature = "files")]
fn bomex(folder: &Path, time: usize, voxels: usize, droplets: f64) -> Result<Cloud> {
    use crate::cloud::{IsolateSettings, isolate};
    use crate::io::import::{ImportSettings, import_cloud};
    let path = folder.join("bomex").join("bomex_6km_seed2.nc");
    let settings =
        ImportSettings { time, droplets_per_cm3: Some(droplets), ..ImportSettings::default() };
    let (field, _) = import_cloud(&path, &settings)?;
    let isolate_settings =
        IsolateSettings { side: 40, columns: 6, water_path: 5.0, ..IsolateSettings::default() };
    let count = |cloud: &Cloud| {
        let water = cloud.microphysics.as_ref().map(|droplets| &droplets.liquid_water_content);
        water.map_or(0, |water| water.iter().filter(|water| **water > 0.0).count())
    };
    let pieces = isolate(&field, &isolate_settings)?;
    let nearest = pieces.into_iter().min_by_key(|piece| count(&piece.cloud).abs_diff(voxels));
    nearest.map(|piece| piece.cloud).ok_or_else(|| {
        Error::out_of_range("isolated clouds of the simulation", 0, "at least 1 at each time")
    })
}

/// The cumulus of the validation of HybridCT, with an effective radius of 10 um.
#[cfg(feature = "files")]
fn rico(folder: &Path) -> Result<Cloud> {
    let name = "truth_RICO_40m_80kmx80km_T_qc_30.0h_id055.nc";
    let volume = crate::io::read_reference_extinction(&folder.join("rico55").join(name))?;
    let mut cloud = Cloud::from_extinction(volume)?;
    cloud.microphysics = Some(crate::cloud::Microphysics::of_one_size(cloud.grid.shape, 10.0));
    Ok(cloud)
}

impl CloudCase {
    /// A case with the standard views of its cloud.
    fn new(name: &str, light: Light, scene: Scene) -> Result<Self> {
        let sun = scene.sun;
        let voxels = scene.medium.extinction.values.iter().filter(|value| **value > 0.0).count();
        let general = VIEWS_DEG.map(|(zenith, azimuth)| {
            towards(f64::to_radians(zenith), sun.azimuth + f64::to_radians(azimuth))
        });
        // These views differ from the direction of the Sun in both azimuth and zenith angle.
        let side = DVec3::Z.cross(sun.towards()).normalize();
        let near = BACKSCATTER_DEG.map(|angle| {
            let angle = f64::to_radians(angle);
            let up = sun.towards().cross(side);
            let away = (0.6 * side + 0.8 * up).normalize();
            angle.cos() * sun.towards() + angle.sin() * away
        });
        let directions: Vec<DVec3> = general.into_iter().chain(near).collect();
        let views = views_of(&scene.medium.extinction, &directions)?;
        Ok(Self { name: name.to_owned(), light, scene, views, voxels })
    }

    /// The unbiased images of the Monte Carlo solver with a prescribed relative noise. They are
    /// read from the folder `cache` if it contains a file for the same case, noise and seed, and
    /// are otherwise computed and stored there.
    ///
    /// # Errors
    /// Returns the errors of the solver, and an error if the cache cannot be read or written.
    pub fn reference(&self, noise: f64, seed: u64, cache: Option<&Path>) -> Result<Observation> {
        #[cfg(feature = "files")]
        if let Some(folder) = cache {
            let path = self.cache_path(folder, noise, seed);
            if path.exists() {
                let observation = crate::io::read_observation(&path)?;
                if observation.views == self.views && observation.light == self.light {
                    return Ok(observation);
                }
            }
            let observation = self.sample(noise, seed)?;
            let provenance = crate::io::Provenance {
                title: format!("Monte Carlo images of {}", self.name),
                configuration: format!("noise {noise}"),
                seed,
                ..crate::io::Provenance::default()
            };
            crate::io::write_observation(&path, &observation, &provenance)?;
            return Ok(observation);
        }
        let _ = cache;
        self.sample(noise, seed)
    }

    #[cfg(feature = "files")]
    fn cache_path(&self, folder: &Path, noise: f64, seed: u64) -> std::path::PathBuf {
        let name: String =
            self.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        folder.join(format!("{name}-{noise}-{seed}.nc"))
    }

    fn sample(&self, noise: f64, seed: u64) -> Result<Observation> {
        let settings = MonteCarloSettings {
            samples_per_pixel: 1 << 20,
            noise: Some(noise),
            seed,
            similarity_after: None,
        };
        let Rendering { images, standard_error, .. } =
            render(&self.scene, &self.views, &Solver::MonteCarlo(settings), &())?;
        let mut observation = Observation::new(self.light.clone(), self.views.clone(), images)?;
        observation.standard_error = standard_error;
        Ok(observation)
    }

    /// The images of the discrete-ordinates solver.
    ///
    /// # Errors
    /// Returns the errors of the solver.
    pub fn images(&self, settings: &OrdinatesSettings) -> Result<ViewStack> {
        let mut model = OrdinatesModel::new(&self.scene, &self.views, None, settings)?;
        model.images(&self.scene.medium.extinction)
    }

    /// The errors of images relative to the reference, for each view.
    ///
    /// # Errors
    /// Returns the errors of the solver, which computes the images of the cloud-free scene.
    pub fn errors(&self, images: &ViewStack, reference: &Observation) -> Result<Vec<ViewError>> {
        let clear = self.clear()?;
        let truth = &reference.images;
        let noise = reference.standard_error.as_ref().expect("the Monte Carlo solver gives one");
        let [count, rows, cols] = truth.shape();
        let of_view = |number: usize| {
            let view = &self.views[number];
            let brightest = truth.image(number).fold(0.0_f32, |most, value| most.max(*value));
            let (mut signal, mut difference, mut variance) = (0.0, 0.0, 0.0);
            let (mut beside, mut beside_difference) = (0.0, 0.0);
            let (mut squares, mut noises, mut bright) = (0.0, 0.0, 0.0);
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let at = [number, row, col];
                let [found, expected, error, clear] =
                    [&images.values, &truth.values, &noise.values, &clear.values]
                        .map(|values| f64::from(values[at]));
                if self.meets_cloud(view, [row, col]) {
                    signal += expected - clear;
                    difference += found - expected;
                    variance += error * error;
                } else {
                    beside += expected;
                    beside_difference += found - expected;
                }
                if expected >= BRIGHT * f64::from(brightest) {
                    squares += (found / expected - 1.0).powi(2);
                    noises += (error / expected).powi(2);
                    bright += 1.0;
                }
            }
            ViewError {
                signal: difference / signal,
                signal_noise: variance.sqrt() / signal,
                beside: beside_difference / beside,
                pixels: ((squares - noises).max(0.0) / bright).sqrt(),
                pixel_noise: (noises / bright).sqrt(),
            }
        };
        Ok((0..count).map(of_view).collect())
    }

    /// The images of the scene without the cloud.
    fn clear(&self) -> Result<ViewStack> {
        let grid = self.scene.medium.extinction.grid;
        let mut scene = self.scene.clone();
        scene.medium.extinction = Volume::constant(grid, 0.0);
        let settings = OrdinatesSettings::default();
        let mut model = OrdinatesModel::new(&scene, &self.views, None, &settings)?;
        model.images(&scene.medium.extinction)
    }

    fn meets_cloud(&self, view: &View, [row, col]: [usize; 2]) -> bool {
        let Volume { grid, values } = &self.scene.medium.extinction;
        (0..RAYS * RAYS).any(|number| {
            let place = |n: usize| (n as f64 + 0.5) / RAYS as f64;
            let ray =
                view.ray(row as f64 + place(number / RAYS), col as f64 + place(number % RAYS));
            walk(grid, &ray).any(|step| values[step.voxel] > 0.0)
        })
    }
}

/// Cameras on an orbit at 600 km that view the centre of the cloud from the given directions. The
/// pixel size at nadir is the voxel size, and the images cover the cloud in all views.
fn views_of(extinction: &Volume, directions: &[DVec3]) -> Result<Vec<View>> {
    let grid = &extinction.grid;
    let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for ((k, j, i), _) in extinction.values.indexed_iter().filter(|(_, value)| **value > 0.0) {
        let center = grid.voxel_center([k, j, i]);
        lower = lower.min(center - 0.5 * grid.spacing);
        upper = upper.max(center + 0.5 * grid.spacing);
    }
    let target = 0.5 * (lower + upper);
    let formation = Formation::cloudct_10();
    let view = |direction: &DVec3, size: [usize; 2]| {
        let distance = formation.distance(direction.z.acos());
        View::perspective(target + distance * direction, target, grid.spacing.x / 600.0, size)
    };
    let mut reach = [0.0_f64; 2];
    for direction in directions {
        let seen = view(direction, [2, 2])?;
        for corner in 0..8 {
            let side = |axis: usize| if corner >> axis & 1 == 0 { lower } else { upper }[axis];
            let point = DVec3::new(side(0), side(1), side(2));
            if let Some((row, col)) = seen.project(point) {
                reach = [reach[0].max((row - 1.0).abs()), reach[1].max((col - 1.0).abs())];
            }
        }
    }
    let size = reach.map(|reach| 2 * (reach + PIXELS_AROUND).ceil() as usize);
    directions.iter().map(|direction| view(direction, size)).collect()
}

/// Optical depths of the layers for the test of the glory.
const GLORY_DEPTHS: [f32; 3] = [1.0, 10.0, 40.0];
/// Accepted relative error of the radiance of a layer near backscatter.
const GLORY_TOLERANCE: f64 = 0.015;

/// Compares layers of droplets of 10 um in directions around exact backscatter, where scattering
/// within the forward peak broadens the glory.
fn glory(effort: Effort, row: &mut dyn FnMut(Row)) -> Result<()> {
    let table = Arc::new(DropletTable::mie(&DropletSettings::water(0.672), &[10.0])?);
    let sun = Sun::from_degrees(30.0, 45.0)?;
    let grid = Grid::new(DVec3::ZERO, DVec3::new(1.0, 1.0, 0.1), [4, 1, 1])?;
    for depth in GLORY_DEPTHS {
        let extinction = Volume::constant(grid, depth / 0.4);
        let radii = Array3::from_elem(grid.shape, 10.0);
        let medium = Medium::of_droplets(extinction.clone(), radii, Arc::clone(&table))?;
        let scene = Scene::new(medium, sun, Surface::BLACK)?.with_boundary(Boundary::Periodic);
        let side = DVec3::Z.cross(sun.towards()).normalize();
        for angle in BACKSCATTER_DEG {
            let started = Instant::now();
            let towards =
                f64::to_radians(angle).cos() * sun.towards() + f64::to_radians(angle).sin() * side;
            let target = DVec3::new(0.5, 0.5, 0.4);
            let view = View::orthographic(towards, target, 1e-3, [1, 1])?;
            let mut model = OrdinatesModel::new(
                &scene,
                std::slice::from_ref(&view),
                None,
                &OrdinatesSettings::default(),
            )?;
            let found = f64::from(model.images(&extinction)?.values[[0, 0, 0]]);
            let seconds = started.elapsed().as_secs_f64();
            let settings = MonteCarloSettings {
                samples_per_pixel: effort.samples / 2,
                seed: effort.seed,
                ..Default::default()
            };
            // The samples of one ray are computed sequentially; several rays use all threads.
            let rays = vec![view.ray(0.5, 0.5); RAYS * RAYS];
            let expected = radiances(&scene, &rays, &settings)?;
            let count = expected.len() as f64;
            let mean = expected.iter().map(|one| one.mean).sum::<f64>() / count;
            let variance: f64 = expected.iter().map(|one| one.standard_error.powi(2)).sum();
            let error = variance.sqrt() / count / mean;
            let tolerance = GLORY_TOLERANCE + 3.0 * error;
            row(Row {
                suite: Suite::Clouds,
                case: format!("layer of droplets, tau {depth}: {angle} degrees from backscatter"),
                value: found / mean,
                standard_error: error,
                reference: 1.0,
                tolerance,
                passed: (found / mean - 1.0).abs() <= tolerance,
                seconds,
            });
        }
    }
    Ok(())
}

/// Computes the rows of the suite: the glory of layers, the cloud signal of each view, and the
/// errors of the bright pixels averaged over all clouds.
pub(super) fn run(
    effort: Effort,
    folder: Option<&Path>,
    cache: Option<&Path>,
    row: &mut dyn FnMut(Row),
) -> Result<()> {
    glory(effort, row)?;
    let noise = if effort.relative_error.is_some() { 0.005 } else { 0.02 };
    let mut all = Vec::new();
    for case in cases(folder)? {
        let reference = case.reference(noise, effort.seed, cache)?;
        let started = Instant::now();
        let settings = OrdinatesSettings { estimate_error: true, ..OrdinatesSettings::default() };
        let rendering = render(&case.scene, &case.views, &Solver::Ordinates(settings), &())?;
        let (images, estimated) = (rendering.images, rendering.estimated_error);
        let seconds = started.elapsed().as_secs_f64();
        let errors = case.errors(&images, &reference)?;
        for (number, error) in errors.iter().enumerate() {
            let tolerance = SIGNAL_TOLERANCE + 3.0 * error.signal_noise;
            row(Row {
                suite: Suite::Clouds,
                case: format!("{}: cloud signal, view {number}", case.name),
                value: 1.0 + error.signal,
                standard_error: error.signal_noise,
                reference: 1.0,
                tolerance,
                passed: error.signal.abs() <= tolerance,
                seconds: seconds / errors.len() as f64,
            });
        }
        let mean = |value: fn(&ViewError) -> f64| {
            errors.iter().map(value).sum::<f64>() / errors.len() as f64
        };
        all.push((mean(|error| error.pixels), estimated.unwrap_or_default()));
    }
    let count = all.len() as f64;
    let pixels = all.iter().map(|(measured, _)| measured).sum::<f64>() / count;
    let estimated = all.iter().map(|(_, estimated)| estimated).sum::<f64>() / count;
    row(Row {
        suite: Suite::Clouds,
        case: "estimated error of bright pixels over the measured one, mean over clouds".into(),
        value: estimated / pixels,
        standard_error: 0.0,
        reference: 1.0,
        tolerance: ESTIMATE_TOLERANCE,
        passed: (estimated / pixels - 1.0).abs() <= ESTIMATE_TOLERANCE,
        seconds: 0.0,
    });
    row(Row {
        suite: Suite::Clouds,
        case: "bright pixels, root mean square, mean over clouds".into(),
        value: pixels,
        standard_error: 0.0,
        reference: 0.0,
        tolerance: PIXEL_TOLERANCE,
        passed: pixels <= PIXEL_TOLERANCE,
        seconds: 0.0,
    });
    Ok(())
}
