//! Validation: radiative transfer against published and independent numbers.
//!
//! A [`Suite`] is a list of cases; each case is a scene, what the solver makes of it,
//! and the number that it must be. The solver's own noise and the error of the
//! reference enter the verdict: a value may be off by three standard errors.

mod clouds;
mod cubes;
mod droplets;
mod gradients;
mod iprt;
mod layers;
#[cfg(feature = "files")]
mod rico;
mod slabs;
mod step;

pub use clouds::{CloudCase, ViewError, cases as cloud_cases};

use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::optics::{Medium, PhaseFunction};
use crate::scene::{Scene, Sun, Surface};
use crate::transport::{FluxSettings, Fluxes, Share, fluxes};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// A list of cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Suite {
    /// Plane-parallel layers: discrete ordinates, H functions.
    Slabs,
    /// The same layers by the deterministic solver, in thin and in thick cells.
    Layers,
    /// Derivatives by the deterministic solver against finite differences.
    Gradients,
    /// Isolated cubes and a sphere.
    Cubes,
    /// The step cloud of the I3RC project.
    Step,
    /// Droplets: a layer of Deirmendjian's cloud C.1, and tables of another code where the
    /// folder of its files is given.
    Mie,
    /// A simulated cumulus seen by Mitsuba and SHDOM; needs their files.
    Rico,
    /// A cube cloud of the project IPRT, by the Monte Carlo solver.
    Iprt,
    /// The deterministic solver on whole clouds, against the Monte Carlo solver; more clouds where
    /// the folder of the simulations is given.
    Clouds,
}

impl Suite {
    /// All suites.
    pub const ALL: [Self; 9] = [
        Self::Slabs,
        Self::Layers,
        Self::Gradients,
        Self::Cubes,
        Self::Step,
        Self::Mie,
        Self::Rico,
        Self::Iprt,
        Self::Clouds,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Slabs => "slabs",
            Self::Layers => "layers",
            Self::Gradients => "gradients",
            Self::Cubes => "cubes",
            Self::Step => "step",
            Self::Mie => "mie",
            Self::Rico => "rico",
            Self::Iprt => "iprt",
            Self::Clouds => "clouds",
        }
    }
}

/// How much work to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Samples of a radiance, and photons where no error is wanted of them.
    pub samples: u32,
    /// The standard error of a share of the light, over the share, that as many photons
    /// as it takes are traced for; `None` where it does not matter.
    pub relative_error: Option<f64>,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Effort {
    /// A second or so for each case.
    pub const QUICK: Self = Self { samples: 200_000, relative_error: None, seed: 1 };
    /// Some minutes for each suite: a noise of 1e-3 of the value or less.
    pub const LONG: Self = Self { samples: 5_000_000, relative_error: Some(9.9e-4), seed: 1 };
}

/// One comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The suite.
    pub suite: Suite,
    /// What was computed.
    pub case: String,
    /// The solver's answer.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// What it must be.
    pub reference: f64,
    /// How far off it may be.
    pub tolerance: f64,
    /// Whether it is within the tolerance.
    pub passed: bool,
    /// Wall time of the case; rows of one computation share it out.
    pub seconds: f64,
}

/// A published or independent number.
#[derive(Debug, Clone, Copy)]
struct Reference {
    value: f64,
    /// Its standard error, or half a unit of its last digit.
    standard_error: f64,
    /// What the two may differ by because they do not solve quite the same problem.
    systematic: f64,
}

impl Reference {
    /// A number with a standard error.
    const fn new(value: f64, standard_error: f64) -> Self {
        Self { value, standard_error, systematic: 0.0 }
    }
}

/// Where the rows of a suite go.
struct Report<'a> {
    suite: Suite,
    effort: Effort,
    started: Instant,
    row: &'a mut dyn FnMut(Row),
}

impl Report<'_> {
    /// Fewest photons from which an error is estimated.
    const FEWEST: u32 = 200_000;

    /// Compare all values of one computation, which began when the last one ended.
    fn compare(&mut self, checks: &[(String, Share, Reference)]) {
        let seconds = self.started.elapsed().as_secs_f64() / checks.len().max(1) as f64;
        for (case, share, reference) in checks {
            let noise = share.standard_error.hypot(reference.standard_error);
            let tolerance = 3.0 * noise + reference.systematic;
            (self.row)(Row {
                suite: self.suite,
                case: case.clone(),
                value: share.mean,
                standard_error: share.standard_error,
                reference: reference.value,
                tolerance,
                passed: (share.mean - reference.value).abs() <= tolerance,
                seconds,
            });
        }
        self.started = Instant::now();
    }

    /// The fluxes of a scene, of which `least` is the smallest share that is compared.
    fn fluxes(&self, scene: &Scene, least: f64) -> Result<Fluxes> {
        let needed = |error: f64| ((1.0 - least) / (least * error.powi(2))) as u64;
        let photons = match self.effort.relative_error {
            Some(error) => needed(error).max(u64::from(Self::FEWEST)),
            None => u64::from(self.effort.samples),
        };
        fluxes(scene, FluxSettings { photons, seed: self.effort.seed })
    }
}

/// Run one suite and hand out its rows as they come. `reference` is a folder with the files that
/// some suites compare with, `cache` one where [`Suite::Clouds`] keeps its Monte Carlo images.
///
/// # Errors
/// [`Suite::Rico`] without the folder of its files, or with files that cannot be used.
pub fn validate(
    suite: Suite,
    effort: Effort,
    reference: Option<&Path>,
    cache: Option<&Path>,
    row: &mut dyn FnMut(Row),
) -> Result<()> {
    let report = Report { suite, effort, started: Instant::now(), row };
    match suite {
        Suite::Slabs => slabs::run(report),
        Suite::Layers => layers::run(report),
        Suite::Gradients => gradients::run(report, reference),
        Suite::Cubes => cubes::run(report),
        Suite::Step => step::run(report),
        Suite::Mie => droplets::run(report, reference),
        Suite::Iprt => iprt::run(report),
        Suite::Clouds => clouds::run(effort, reference, cache, report.row),
        #[cfg(feature = "files")]
        Suite::Rico => rico::run(report, reference),
        #[cfg(not(feature = "files"))]
        Suite::Rico => Err(crate::error::Error::out_of_range(
            "suite",
            "rico",
            format!("one that needs no files, which {reference:?} would be: built without them"),
        )),
    }
}

/// A medium above a black surface at its bottom, with the Sun in the east.
fn scene(
    extinction: Volume,
    single_scattering_albedo: f64,
    asymmetry: f64,
    solar_cosine: f64,
) -> Result<Scene> {
    let bottom = extinction.grid.lower().z;
    let phase = PhaseFunction::henyey_greenstein(asymmetry)?;
    let medium = Medium::new(extinction, single_scattering_albedo, phase)?;
    let sun = Sun::from_degrees(solar_cosine.acos().to_degrees(), 90.0)?;
    Scene::new(medium, sun, Surface { altitude: bottom, ..Surface::BLACK })
}

/// A cube of 1 km in `[n, n, n]` voxels.
fn unit_grid(n: usize) -> Result<Grid> {
    let spacing = crate::math::DVec3::splat(1.0 / n as f64);
    Grid::new(crate::math::DVec3::ZERO, spacing, [n, n, n])
}
