//! General weights: one network for any formation and any Sun.
//!
//! The part that a view contributes to the first layer is linear in its image, with factors that
//! depend on where the camera and the Sun are. General weights hold perceptrons that turn the
//! geometry into these factors, and into a scale and a shift of every channel of the other layers.
//! For one geometry, all of it folds into ordinary [`Weights`], which cost nothing more at
//! inference ([`GeneralWeights::fold`]).
//!
//! Radiative transfer does not change if all lengths are multiplied, and all extinctions divided,
//! by one factor. The network therefore works in units of its voxels, and the same weights serve
//! for voxels of 15 to 150 m; only air and surface, which have their own lengths, differ slightly.
//!
//! `docs/notes/learning.md` describes the training.

mod features;
mod metadata;
mod perceptron;

pub use metadata::{GeneralArchitecture, GeneralLevels, GeneralMetadata, Ranges};
pub use perceptron::{Linear, Perceptron};

use super::{
    Architecture, BATCH_NORM_EPSILON, BatchNorm, FORMAT_VERSION, ImageLayout, LayerWeights, Levels,
    Planes, Weights, WeightsMetadata,
};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::image::ImagingGeometry;
use crate::math::DVec3;
use features::{Features, SCENE_FEATURES, VIEW_FEATURES};
use ndarray::{Array1, Array4};
use rayon::prelude::*;

/// A view's factors are 3 over the number of views times the output of the mixing perceptron, so
/// that the input of the first layer does not depend on how many views there are.
const MIXING_SCALE: f64 = 3.0;

/// Number of values of a kernel.
const TAPS: usize = 9;

/// The name in the metadata of the weights that are folded for a geometry.
const FOLDED: &str = "general";

/// Weights for any formation and any Sun.
#[derive(Debug, Clone, PartialEq)]
pub struct GeneralWeights {
    /// The metadata of the weights.
    pub metadata: GeneralMetadata,
    /// From the features of a view to its factor in each virtual view.
    mixing: Perceptron,
    /// From the features of the scene to a scale and a shift of every channel of every layer but
    /// the last: `[layer][scale, shift][channel]`.
    modulation: Perceptron,
    /// The convolutions with their batch norms, from first to last.
    layers: Vec<(LayerWeights, BatchNorm)>,
}

/// Returns an error if a camera is not above the grid.
fn check_cameras(geometry: &ImagingGeometry, grid: &Grid) -> Result<()> {
    let [.., target] = geometry.target_km;
    let cameras = geometry.views.camera_distance_km.iter().zip(&geometry.views.view_zenith_deg);
    for (view, (distance, zenith)) in cameras.enumerate() {
        let Some(distance) = distance else { continue };
        let (altitude, top) = (target + distance * zenith.to_radians().cos(), grid.upper().z);
        if altitude <= top {
            let value = format!("{altitude:.3} km (view {view})");
            let range = format!("above the grid, which ends at {top:.3} km");
            return Err(Error::out_of_range("altitude of a camera", value, range));
        }
    }
    Ok(())
}

/// The factor and the shift of a channel: those of the batch norm, followed by a multiplication by
/// one plus the first modulation and the addition of the second.
fn affine(norm: &BatchNorm, channel: usize, [scale, shift]: [f64; 2]) -> [f64; 2] {
    let deviation = (f64::from(norm.running_var[channel]) + BATCH_NORM_EPSILON).sqrt();
    let normal = f64::from(norm.weight[channel]) / deviation;
    let offset = f64::from(norm.bias[channel]) - f64::from(norm.running_mean[channel]) * normal;
    [normal * (1.0 + scale), offset * (1.0 + scale) + shift]
}

impl GeneralWeights {
    /// Creates general weights and checks that all parts are consistent.
    ///
    /// # Errors
    /// The errors of [`GeneralMetadata::check`]; a shape that differs from the architecture.
    pub fn new(
        metadata: GeneralMetadata,
        mixing: Perceptron,
        modulation: Perceptron,
        layers: Vec<(LayerWeights, BatchNorm)>,
    ) -> Result<Self> {
        metadata.check()?;
        let architecture = &metadata.architecture;
        let shapes = metadata.layer_channels();
        let modulated = 2 * architecture.width * (architecture.layers - 1);
        for (what, expected, found) in [
            ("number of layers", shapes.len(), layers.len()),
            ("inputs of the mixing perceptron", VIEW_FEATURES, mixing.inputs()),
            ("outputs of the mixing perceptron", architecture.virtual_views, mixing.outputs()),
            ("inputs of the modulation perceptron", SCENE_FEATURES, modulation.inputs()),
            ("outputs of the modulation perceptron", modulated, modulation.outputs()),
        ] {
            if expected != found {
                return Err(Error::mismatch(what, expected, found, "export the weights again"));
            }
        }
        for (index, ((layer, _), (input, output))) in layers.iter().zip(shapes).enumerate() {
            if layer.weight.shape() != [output, input, 3, 3] {
                let expected = format!("{:?}", [output, input, 3, 3]);
                let found = format!("{:?}", layer.weight.shape());
                let what = format!("shape of layers.{index}.weight");
                return Err(Error::mismatch(what, expected, found, "export the weights again"));
            }
        }
        Ok(Self { metadata, mixing, modulation, layers })
    }

    /// Number of parameters, with those of the batch norms.
    pub fn parameters(&self) -> usize {
        let layer = |(layer, norm): &(LayerWeights, BatchNorm)| {
            layer.weight.len() + layer.bias.len() + 4 * norm.weight.len()
        };
        let layers: usize = self.layers.iter().map(layer).sum();
        layers + self.mixing.parameters() + self.modulation.parameters()
    }

    /// The grid with voxels of `voxel_km` (horizontally) on which the folded network estimates,
    /// with the given centre (km) and `[rows, cols]`.
    ///
    /// # Errors
    /// As [`Grid::of_any_size`].
    pub fn grid(&self, voxel_km: f64, center: DVec3, [rows, cols]: [usize; 2]) -> Result<Grid> {
        let GeneralLevels { count, height } = self.metadata.levels;
        let spacing = DVec3::new(voxel_km, voxel_km, height * voxel_km);
        let extent = spacing * DVec3::new(cols as f64, rows as f64, count as f64);
        Grid::of_any_size(center - 0.5 * extent, spacing, [count, rows, cols])
    }

    /// The ordinary weights for images of a geometry, on voxels and levels as those of `grid`. All
    /// products are computed in f64 and rounded once. The views may have any order.
    ///
    /// # Errors
    /// A geometry or a voxel size outside the range of the training, unless `force`; a grid that
    /// does not have the levels of the metadata; directions at or below the horizon.
    pub fn fold(&self, geometry: &ImagingGeometry, grid: &Grid, force: bool) -> Result<Weights> {
        let voxel_km = grid.spacing.x;
        self.metadata.check_levels(grid)?;
        if !force {
            self.metadata.check_range(geometry, voxel_km)?;
        }
        check_cameras(geometry, grid)?;
        let features = Features::new(&geometry.views, voxel_km)?;
        let views = features.views.len();
        let factors: Vec<Vec<f64>> = features
            .views
            .iter()
            .map(|view| {
                let mixed = self.mixing.apply(view);
                mixed.iter().map(|factor| MIXING_SCALE / views as f64 * factor).collect()
            })
            .collect();
        let modulation = self.modulation.apply(&features.scene);
        let width = self.metadata.architecture.width;
        let layers = self.layers.iter().enumerate().map(|(index, (layer, norm))| {
            // The last layer has no modulation.
            let part = modulation.get(2 * width * index..2 * width * (index + 1));
            let affine: Vec<[f64; 2]> = (0..layer.bias.len())
                .map(|channel| {
                    let modulated = part.map_or([0.0, 0.0], |p| [p[channel], p[width + channel]]);
                    affine(norm, channel, modulated)
                })
                .collect();
            let bias = Array1::from_shape_fn(layer.bias.len(), |channel| {
                let [factor, shift] = affine[channel];
                (f64::from(layer.bias[channel]) * factor + shift) as f32
            });
            let weight = match index {
                0 => self.fold_views(&layer.weight, &factors, &affine),
                _ => {
                    let mut weight = layer.weight.clone();
                    for (mut kernels, [factor, _]) in weight.outer_iter_mut().zip(&affine) {
                        kernels.mapv_inplace(|value| (f64::from(value) * factor) as f32);
                    }
                    weight
                }
            };
            LayerWeights { weight, bias }
        });
        let layers = layers.collect();
        Weights::new(self.folded_metadata(geometry, grid, views), layers)
    }

    /// The kernels of the first layer by plane and view, and by plane for the extremes, multiplied
    /// by the factor of each channel. `factors` are those of each view in the virtual views.
    fn fold_views(
        &self,
        weight: &Array4<f32>,
        factors: &[Vec<f64>],
        affine: &[[f64; 2]],
    ) -> Array4<f32> {
        let GeneralArchitecture { virtual_views, planes, extremes, .. } =
            self.metadata.architecture;
        let views = factors.len();
        let inputs = planes * (views + 2 * usize::from(extremes));
        let weight = weight.as_standard_layout();
        let kernels = weight.as_slice().expect("standard layout is contiguous");
        let by_output = kernels.par_chunks_exact(TAPS * weight.shape()[1]).zip(affine);
        let folded = by_output.flat_map_iter(|(kernels, [factor, _])| {
            let kernel = |input: usize| &kernels[TAPS * input..][..TAPS];
            let mut row = Vec::with_capacity(TAPS * inputs);
            for plane in 0..planes {
                for by_view in factors {
                    let mut sum = [0.0; TAPS];
                    for (number, mixed) in by_view.iter().enumerate() {
                        let taps = kernel(number * planes + plane);
                        sum.iter_mut().zip(taps).for_each(|(s, tap)| *s += mixed * f64::from(*tap));
                    }
                    row.extend(sum.map(|value| (value * factor) as f32));
                }
            }
            let others = &kernels[TAPS * virtual_views * planes..];
            row.extend(others.iter().map(|value| (f64::from(*value) * factor) as f32));
            row
        });
        let shape = (weight.shape()[0], inputs, 3, 3);
        Array4::from_shape_vec(shape, folded.collect()).expect("as many values as the shape has")
    }

    fn folded_metadata(
        &self,
        geometry: &ImagingGeometry,
        grid: &Grid,
        views: usize,
    ) -> WeightsMetadata {
        let metadata = &self.metadata;
        let GeneralArchitecture { planes, extremes, last_relu, .. } = metadata.architecture;
        let mut channels = vec![planes * (views + 2 * usize::from(extremes))];
        channels.extend(self.layers.iter().map(|(layer, _)| layer.bias.len()));
        let height = grid.extent().z / planes as f64;
        let altitudes_km =
            (0..planes).map(|plane| grid.origin.z + (plane as f64 + 0.5) * height).collect();
        let mut view_geometry = geometry.views.clone();
        view_geometry.camera_distance_km.resize(views, None);
        WeightsMetadata {
            format_version: FORMAT_VERSION,
            formation: FOLDED.into(),
            architecture: Architecture { channels, last_relu },
            view_geometry,
            target_altitude_km: geometry.target_km[2],
            wavelengths_um: vec![geometry.wavelength_um],
            image_layout: ImageLayout::Planes(Planes { altitudes_km, extremes }),
            horizontal_spacing_km: [grid.spacing.x, grid.spacing.y],
            levels: Levels {
                bottom_km: grid.origin.z,
                count: grid.shape[0],
                spacing_km: grid.spacing.z,
            },
            outputs: metadata.outputs.clone(),
            input_scale: metadata.input_scale,
            output_scale: metadata.output_scale * metadata.voxel_km / grid.spacing.x,
            effective_radius_scale: None,
            training: metadata.training.clone(),
            scores: metadata.scores.clone(),
            program: metadata.program.clone(),
            configuration: metadata.configuration.clone(),
        }
    }
}
