//! The discrete-ordinates solver as the forward model of an inversion.

use super::{Domain, Fields, ForwardModel, Models, Radius};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::image::ViewStack;
use crate::optics::{DropletTable, Medium, Scattering, extinction_per_water};
use crate::scene::{ExtinctionModel, Observation, Scene, View};
use crate::stop::Stop;
use crate::transport::{Derivatives, OrdinatesModel, OrdinatesSettings};
use ndarray::{Array3, Zip};
use std::sync::Arc;

/// Tolerance of the solver in a few quick iterations, which end before a smaller tolerance would
/// make a difference.
pub const QUICK_TOLERANCE: f64 = 1e-2;

/// Number of rays per pixel in the quick iterations.
const QUICK_RAYS: usize = 3;
/// Smallest tolerance in all other iterations. With a tolerance of 3e-3, the iterations stop early
/// because images and derivatives are inconsistent.
const STEP_TOLERANCE: f64 = 1e-3;
/// Largest number of rays per pixel in all other iterations.
const STEP_RAYS: usize = 5;

/// Smallest extinction for which the voxels of a mask are prepared (1/km), because iterations may
/// fill empty voxels.
const LEAST_PREPARED: f32 = 20.0;
/// Smallest effective radius (um) for which the extinctions of two bands are compared; that of a
/// voxel without water may be 0.
const LEAST_RADIUS: f32 = 1e-3;

/// The discrete-ordinates solver on any grid: the iterations use a fast solver, whose images an
/// accurate solver corrects.
///
/// On the full-resolution grid and near the solution, the difference between the images of the
/// accurate and of the fast solver at the first extinction of a stage is added to all later images.
/// An iteration then costs as much as one of the fast solver, and each stage ends closer to the
/// solution of the accurate solver (defect correction: Stetter 1978).
#[derive(Debug, Clone)]
pub struct OrdinatesModels {
    /// The bands; the extinction is that of the first one.
    pub bands: Vec<Band>,
    /// Settings of the fast solver, which is used in the iterations on all grids.
    pub settings: OrdinatesSettings,
    /// Settings of the accurate solver that corrects the fast one, if any.
    pub accurate_settings: Option<OrdinatesSettings>,
    /// Ends an evaluation that is running when it is requested.
    pub stop: Stop,
}

/// The forward model of the images of one band.
#[derive(Debug, Clone)]
pub struct Band {
    /// The scene whose medium defines the scattering properties; its extinction has no effect.
    pub scene: Scene,
    /// The views of the observation.
    pub views: Vec<View>,
    /// The table that gives the extinction of droplets; `None` for an extinction efficiency of 2.
    pub extinction: Option<Arc<DropletTable>>,
}

impl Band {
    /// The band of an observation, on a grid.
    ///
    /// # Errors
    /// Returns an error if the scene illumination does not give the effective radius, or if the images
    /// do not depend on it although it is to be retrieved.
    pub fn new(observation: &Observation, grid: &Grid, radius: Radius) -> Result<Self> {
        let (light, nothing) = (&observation.light, Volume::constant(*grid, 0.0));
        let scene = match radius {
            Radius::Given => light.scene_of(nothing)?,
            _ => light.scene_of_any_droplets(nothing)?,
        };
        let extinction = match &scene.medium.scattering {
            Scattering::Droplets { table, .. }
                if light.optics.extinction == ExtinctionModel::Mie =>
            {
                Some(table.clone())
            }
            _ => None,
        };
        Ok(Self { scene, views: observation.views.clone(), extinction })
    }

    /// The extinction per liquid water content (1/km per g/m3) of droplets of an effective radius
    /// (um), and its derivative.
    fn extinction_per_water(&self, radius: f64) -> [f64; 2] {
        extinction_per_water(self.extinction.as_deref(), radius)
    }
}

impl OrdinatesModels {
    /// Creates the models of the bands of a problem on a grid, as [`OrdinatesModels::new`] does.
    ///
    /// # Errors
    /// As [`Band::new`].
    pub fn of(
        bands: &[Observation],
        grid: &Grid,
        radius: Radius,
        settings: OrdinatesSettings,
    ) -> Result<Self> {
        let bands = bands.iter().map(|band| Band::new(band, grid, radius));
        Ok(Self { bands: bands.collect::<Result<_>>()?, ..Self::of_bands(Vec::new(), settings) })
    }

    /// Creates models of one band that are corrected by a solver with the given settings. The fast
    /// solver uses about half of the ordinates and fewer rays, and does not subdivide voxels.
    pub fn new(scene: Scene, views: Vec<View>, settings: OrdinatesSettings) -> Self {
        Self::of_bands(vec![Band { scene, views, extinction: None }], settings)
    }

    fn of_bands(bands: Vec<Band>, settings: OrdinatesSettings) -> Self {
        let steps = OrdinatesSettings {
            zenith_angles: (settings.zenith_angles / 8 * 4).max(4),
            most_parts: 1,
            rays_per_pixel: settings.rays_per_pixel.min(STEP_RAYS),
            tolerance: settings.tolerance.max(STEP_TOLERANCE),
            ..settings
        };
        let accurate_settings = Some(settings);
        Self { bands, settings: steps, accurate_settings, stop: Stop::default() }
    }

    /// Returns the models with [`QUICK_TOLERANCE`] and fewer rays in the fast solver; the accurate
    /// solver does not change.
    pub fn quick(self) -> Self {
        let settings = OrdinatesSettings {
            tolerance: QUICK_TOLERANCE,
            rays_per_pixel: QUICK_RAYS,
            ..self.settings
        };
        Self { settings, ..self }
    }

    /// The model of a band for a domain.
    fn band(
        &self,
        band: &Band,
        (pixels, offsets): (&Array3<bool>, &[[f64; 2]]),
        domain: &Domain,
    ) -> Result<OneBand> {
        let Domain { mask, expected, near, .. } = *domain;
        let fine = mask.grid.shape == band.scene.medium.extinction.grid.shape;
        let mut scene = band.scene.clone();
        scene.medium.scattering = scattering(&scene.medium, &mask.grid, expected);
        scene.medium.extinction = Volume {
            grid: mask.grid,
            values: Zip::from(&mask.values)
                .and(&expected.extinction.values)
                .map_collect(|inside, value| if *inside { value.max(LEAST_PREPARED) } else { 0.0 }),
        };
        let views = band.views.iter().zip(offsets);
        let views = views.map(|(view, offset)| view.framed(*offset, [view.rows, view.cols]));
        let views = views.collect::<Result<Vec<_>>>()?;
        let make = |settings: &OrdinatesSettings| {
            let mut model = OrdinatesModel::new(&scene, &views, Some(mask), settings)?;
            model.look_at(pixels)?;
            model.stop_by(self.stop.clone());
            Ok::<_, Error>(model)
        };
        let given = match &scene.medium.scattering {
            Scattering::Droplets { effective_radius, .. } => Some(effective_radius.clone()),
            _ => None,
        };
        let accurate = self.accurate_settings.as_ref().filter(|_| fine && near);
        let accurate = accurate.map(make).transpose()?;
        let ratio = Ratio::none(mask.grid.shape);
        Ok(OneBand { cheap: make(&self.settings)?, accurate, defect: None, given, ratio })
    }
}

impl Models for OrdinatesModels {
    fn are_corrected(&self) -> bool {
        self.accurate_settings.is_some()
    }

    fn model(&mut self, domain: &Domain) -> Result<Box<dyn ForwardModel + '_>> {
        let seen = domain.pixels.iter().zip(domain.offsets.iter().map(Vec::as_slice));
        let models = self.bands.iter().zip(seen).map(|(band, seen)| self.band(band, seen, domain));
        Ok(Box::new(Joint {
            bands: &self.bands,
            models: models.collect::<Result<_>>()?,
            last: None,
        }))
    }
}

/// The scattering properties of a medium on a grid of blocks of its voxels: those of the expected
/// effective radius or, if this is given by the medium, of its means.
fn scattering(medium: &Medium, grid: &Grid, expected: &Fields) -> Scattering {
    let Scattering::Droplets { effective_radius, table } = &medium.scattering else {
        return medium.scattering.clone();
    };
    let effective_radius = match &expected.effective_radius {
        Some(radius) => radius.values.clone(),
        None => {
            let block = (grid.spacing.x / medium.extinction.grid.spacing.x).round() as usize;
            let mut sums = Array3::<f32>::zeros(grid.shape);
            let mut counts = Array3::<f32>::zeros(grid.shape);
            for ((k, j, i), &radius) in effective_radius.indexed_iter() {
                if radius > 0.0 {
                    sums[[k / block, j / block, i / block]] += radius;
                    counts[[k / block, j / block, i / block]] += 1.0;
                }
            }
            sums.zip_mut_with(&counts, |sum, count| *sum /= count.max(1.0));
            sums
        }
    };
    Scattering::Droplets { effective_radius, table: table.clone() }
}

/// The models of all bands.
struct Joint<'a> {
    bands: &'a [Band],
    models: Vec<OneBand>,
    /// The fields of the last images.
    last: Option<Fields>,
}

/// A fast model of one band, corrected by its defect at the first fields.
struct OneBand {
    cheap: OrdinatesModel,
    /// `None` after its first use, and if there is no correction.
    accurate: Option<OrdinatesModel>,
    defect: Option<ViewStack>,
    /// Effective radius of the scene (um); `None` if the scattering does not depend on it.
    given: Option<Array3<f32>>,
    ratio: Ratio,
}

/// The extinction of each voxel in a band relative to that in the first one, and its derivative with
/// respect to the effective radius (1/um).
struct Ratio {
    value: Array3<f32>,
    slope: Array3<f32>,
}

impl Ratio {
    /// The same extinction in both bands.
    fn none(shape: [usize; 3]) -> Self {
        Self { value: Array3::ones(shape), slope: Array3::zeros(shape) }
    }

    fn new(band: &Band, first: &Band, radii: &Array3<f32>) -> Self {
        let at = |radius: f32| {
            let radius = f64::from(radius.max(LEAST_RADIUS));
            let [own, own_slope] = band.extinction_per_water(radius);
            let [other, other_slope] = first.extinction_per_water(radius);
            (own / other, (own_slope * other - own * other_slope) / (other * other))
        };
        Self { value: radii.mapv(|r| at(r).0 as f32), slope: radii.mapv(|r| at(r).1 as f32) }
    }
}

impl OneBand {
    fn images(&mut self, fields: &Fields) -> Result<ViewStack> {
        let extinction = Volume {
            values: &fields.extinction.values * &self.ratio.value,
            ..fields.extinction.clone()
        };
        let radius = fields.effective_radius.as_ref();
        let of = |model: &mut OrdinatesModel| match radius {
            Some(radius) => model.images_of_droplets(&extinction, radius),
            None => model.images(&extinction),
        };
        let mut images = of(&mut self.cheap)?;
        if let Some(mut accurate) = self.accurate.take() {
            let right = of(&mut accurate)?;
            self.defect = Some(ViewStack::new(right.values - &images.values)?);
        }
        if let Some(defect) = &self.defect {
            images.values += &defect.values;
        }
        Ok(images)
    }
}

impl ForwardModel for Joint<'_> {
    fn images(&mut self, fields: &Fields) -> Result<Vec<ViewStack>> {
        let images = self.models.iter_mut().zip(self.bands).map(|(model, band)| {
            let radii = fields.effective_radius.as_ref().map(|radius| &radius.values);
            model.ratio = match radii.or(model.given.as_ref()) {
                Some(radii) => Ratio::new(band, &self.bands[0], radii),
                None => Ratio::none(fields.extinction.grid.shape),
            };
            model.images(fields)
        });
        let images = images.collect();
        self.last = Some(fields.clone());
        images
    }

    fn derivatives(&mut self, weights: &[ViewStack]) -> Result<Derivatives> {
        let Some(Fields { extinction, .. }) = &self.last else {
            return Err(Error::out_of_range("images", "missing", "computed before derivatives"));
        };
        let zero = Volume::constant(extinction.grid, 0.0);
        let mut sum = Derivatives { extinction: zero.clone(), effective_radius: zero };
        for (model, weights) in self.models.iter_mut().zip(weights) {
            let found = model.cheap.derivatives(weights)?;
            let Ratio { value, slope } = &model.ratio;
            sum.extinction.values += &(&found.extinction.values * value);
            let by_extinction = &found.extinction.values * &extinction.values * slope;
            sum.effective_radius.values += &(found.effective_radius.values + by_extinction);
        }
        Ok(sum)
    }

    fn forget(&mut self) {
        self.models.iter_mut().for_each(|model| model.cheap.forget());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Mask;
    use crate::math::{DVec3, towards};
    use crate::scene::{Light, PhaseModel};

    /// The derivatives of the images of two bands, of different sizes, by central differences in
    /// the extinction of the first one and in the effective radius.
    #[test]
    fn two_bands_have_their_derivatives() {
        let grid = Grid::new(DVec3::new(0.0, 0.0, 0.6), DVec3::splat(0.1), [3, 3, 4]).unwrap();
        let observe = |wavelength: f64, zenith: f64, side: usize| {
            let mut light = Light { wavelength, ..Light::default() };
            light.optics.phase = PhaseModel::Mie;
            light.optics.extinction = ExtinctionModel::Mie;
            let view = View::orthographic(towards(zenith, 1.0), grid.center(), 0.1, [side, side]);
            let images = ViewStack::new(Array3::zeros((1, side, side))).unwrap();
            Observation::new(light, vec![view.unwrap()], images).unwrap()
        };
        let bands = [observe(0.672, 0.2, 6), observe(2.13, 0.7, 8)];
        let solver = OrdinatesSettings { zenith_angles: 4, tolerance: 1e-6, ..Default::default() };
        let mut models = OrdinatesModels::of(&bands, &grid, Radius::Field, solver).unwrap();
        models.settings.tolerance = 1e-6;
        let mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
        let pixels = [6, 8].map(|side| Array3::from_elem((1, side, side), true));
        let volume = |least: f32, step: f32| {
            let value = |(k, j, i)| least + step * ((3 * k + 2 * j + i) % 5) as f32;
            Volume::new(grid, Array3::from_shape_fn(grid.shape, value)).unwrap()
        };
        let fields =
            Fields { extinction: volume(5.0, 4.0), effective_radius: Some(volume(9.6, 0.11)) };
        let offsets = [vec![[0.0, 0.0]], vec![[0.2, -0.3]]];
        let (near, mask, pixels, offsets) = (false, &mask, &pixels[..], &offsets[..]);
        let domain = Domain { mask, expected: &fields, near, pixels, offsets };
        let mut model = models.model(&domain).unwrap();
        let weight = |((v, row, col), _): ((usize, usize, usize), &f32)| {
            ((v * 31 + row * 7 + col * 3) % 11) as f32 / 5.0 - 0.7
        };
        let images = model.images(&fields).unwrap();
        let weights: Vec<ViewStack> = images
            .iter()
            .map(|images| {
                let values = images.values.indexed_iter().map(weight).collect();
                let shape = images.values.raw_dim();
                ViewStack::new(Array3::from_shape_vec(shape, values).unwrap()).unwrap()
            })
            .collect();
        let found = model.derivatives(&weights).unwrap();
        let mut sum = |fields: &Fields| -> f64 {
            model.forget();
            let images = model.images(fields).unwrap();
            let pairs =
                images.iter().zip(&weights).flat_map(|(a, b)| a.values.iter().zip(&b.values));
            pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let direction = volume(-0.05, 0.03).values;
        for of_radius in [false, true] {
            let step = if of_radius { 1.0 } else { 5.0 };
            let mut moved = |sign: f32| {
                let mut fields = fields.clone();
                let change = sign * step * &direction;
                match (of_radius, &mut fields.effective_radius) {
                    (true, Some(radius)) => radius.values += &change,
                    _ => fields.extinction.values += &change,
                }
                sum(&fields)
            };
            let difference = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
            let slopes = if of_radius { &found.effective_radius } else { &found.extinction };
            let derivative: f64 = (&slopes.values * &direction).iter().map(|v| f64::from(*v)).sum();
            let ratio = derivative / difference;
            assert!((ratio - 1.0).abs() < 0.01, "{of_radius}: {derivative} {difference}");
        }
    }
}
