//! Validation of radiative transfer against published and independent results.
//!
//! A [`Suite`] is a list of cases; each case compares the result of a solver for a scene with a
//! reference value. The tolerance is three standard errors, which combine the noise of the solver
//! and the error of the reference.

mod clouds;
mod cubes;
mod droplets;
mod gradients;
mod iprt;
mod layers;
mod photon_gradients;
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

/// A list of validation cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Suite {
    /// Plane-parallel layers by the Monte Carlo solver, against discrete-ordinates results and
    /// H functions.
    Slabs,
    /// Plane-parallel layers by the discrete-ordinates solver, in thin and in thick voxels.
    Layers,
    /// Derivatives by the discrete-ordinates solver, against finite differences.
    Gradients,
    /// Isolated cubes and a sphere by the Monte Carlo solver.
    Cubes,
    /// The step cloud of the I3RC project by the Monte Carlo solver.
    Step,
    /// Droplet optics: a layer of Deirmendjian's cloud C.1, and the tables of another code if the
    /// folder of its files is given.
    Mie,
    /// A simulated cumulus by the Monte Carlo solver, against Mitsuba and SHDOM; requires their
    /// files.
    Rico,
    /// A cube cloud of the IPRT project by the Monte Carlo solver.
    Iprt,
    /// Whole clouds by the discrete-ordinates solver, against the Monte Carlo solver; includes
    /// simulated clouds if the folder of their files is given.
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

    /// The name of the suite on the command line.
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

/// Computational effort of a validation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Samples per radiance, and number of photons of fluxes if `relative_error` is `None`.
    pub samples: u32,
    /// Relative standard error of flux fractions, which determines the number of photons.
    pub relative_error: Option<f64>,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Effort {
    /// About one second for each case.
    pub const QUICK: Self = Self { samples: 200_000, relative_error: None, seed: 1 };
    /// Several minutes for each suite, with a relative noise of 1e-3 or less.
    pub const LONG: Self = Self { samples: 5_000_000, relative_error: Some(9.9e-4), seed: 1 };
}

/// One comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The suite.
    pub suite: Suite,
    /// Description of the case and of the computed quantity.
    pub case: String,
    /// Value computed by the solver.
    pub value: f64,
    /// Standard error of the value.
    pub standard_error: f64,
    /// Reference value.
    pub reference: f64,
    /// Largest accepted difference between value and reference.
    pub tolerance: f64,
    /// Whether the difference is within the tolerance.
    pub passed: bool,
    /// Wall time (s). The time of a computation is divided equally between its rows.
    pub seconds: f64,
}

/// A published or independent reference value.
#[derive(Debug, Clone, Copy)]
struct Reference {
    value: f64,
    /// Standard error, or half a unit of the last digit.
    standard_error: f64,
    /// Accepted systematic difference, as the two models do not solve exactly the same problem.
    systematic: f64,
}

impl Reference {
    /// A reference value with a standard error.
    const fn new(value: f64, standard_error: f64) -> Self {
        Self { value, standard_error, systematic: 0.0 }
    }
}

/// Compares results with references and passes the rows of a suite to a callback.
struct Report<'a> {
    suite: Suite,
    effort: Effort,
    started: Instant,
    row: &'a mut dyn FnMut(Row),
}

impl Report<'_> {
    /// Minimum number of photons for the estimate of an error.
    const FEWEST: u32 = 200_000;

    /// Compares all values of one computation. Its time is that since the previous comparison.
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

    /// The fluxes of a scene. The number of photons follows from `least`, the smallest flux
    /// fraction that is compared.
    fn fluxes(&self, scene: &Scene, least: f64) -> Result<Fluxes> {
        let needed = |error: f64| ((1.0 - least) / (least * error.powi(2))) as u64;
        let photons = match self.effort.relative_error {
            Some(error) => needed(error).max(u64::from(Self::FEWEST)),
            None => u64::from(self.effort.samples),
        };
        fluxes(scene, FluxSettings { photons, seed: self.effort.seed })
    }
}

/// Runs one suite and passes each row to `row` as soon as it is available. `reference` is the
/// folder of the reference files of some suites, and `cache` a folder in which [`Suite::Clouds`]
/// stores its Monte Carlo images.
///
/// # Errors
/// Returns an error if [`Suite::Rico`] is run without a reference folder, or if a file cannot be
/// read or written.
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
            format!("one that reads no files (built without file support; folder {reference:?})"),
        )),
    }
}

/// A scene with a medium above a black surface at its bottom and the Sun in the east.
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

/// A cube of 1 km with `[n, n, n]` voxels.
fn unit_grid(n: usize) -> Result<Grid> {
    let spacing = crate::math::DVec3::splat(1.0 / n as f64);
    Grid::new(crate::math::DVec3::ZERO, spacing, [n, n, n])
}
