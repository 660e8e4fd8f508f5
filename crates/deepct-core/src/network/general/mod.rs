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

/// A view's factors are 3 over the number of views times the output of the mixing perceptron, so
/// that the input of the first layer does not depend on how many views there are.
const MIXING_SCALE: f64 = 3.0;

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
    /// As [`Grid::new`].
    pub fn grid(&self, voxel_km: f64, center: DVec3, [rows, cols]: [usize; 2]) -> Result<Grid> {
        let GeneralLevels { count, height } = self.metadata.levels;
        let spacing = DVec3::new(voxel_km, voxel_km, height * voxel_km);
        let extent = spacing * DVec3::new(cols as f64, rows as f64, count as f64);
        Grid::new(center - 0.5 * extent, spacing, [count, rows, cols])
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
        let features = Features::new(&geometry.views, voxel_km)?;
        let views = features.views.len();
        let scale = MIXING_SCALE / views as f64;
        let factors: Vec<Vec<f64>> =
            features.views.iter().map(|view| self.mixing.apply(view)).collect();
        let modulation = self.modulation.apply(&features.scene);
        let width = self.metadata.architecture.width;
        let last = self.layers.len() - 1;
        let layers = self.layers.iter().enumerate().map(|(index, (layer, norm))| {
            let (scales, shifts) = match index == last {
                true => (None, None),
                false => {
                    let part = &modulation[2 * width * index..][..2 * width];
                    (Some(&part[..width]), Some(&part[width..]))
                }
            };
            let factor = |channel: usize| {
                let deviation = (f64::from(norm.running_var[channel]) + BATCH_NORM_EPSILON).sqrt();
                let modulated = 1.0 + scales.map_or(0.0, |scales| scales[channel]);
                (f64::from(norm.weight[channel]) / deviation, modulated)
            };
            let bias = Array1::from_shape_fn(layer.bias.len(), |channel| {
                let (normal, modulated) = factor(channel);
                let mean = f64::from(norm.running_mean[channel]);
                let centered = f64::from(layer.bias[channel]) - mean;
                let normalized = centered * normal + f64::from(norm.bias[channel]);
                (normalized * modulated + shifts.map_or(0.0, |shifts| shifts[channel])) as f32
            });
            let total = |channel: usize| {
                let (normal, modulated) = factor(channel);
                normal * modulated
            };
            let weight = match index {
                0 => self.fold_views(&layer.weight, &factors, scale, total),
                _ => Array4::from_shape_fn(layer.weight.raw_dim(), |at| {
                    (f64::from(layer.weight[at]) * total(at.0)) as f32
                }),
            };
            LayerWeights { weight, bias }
        });
        let layers = layers.collect();
        Weights::new(self.folded_metadata(geometry, grid, views), layers)
    }

    /// The kernels of the first layer by plane and view, and by plane for the extremes.
    fn fold_views(
        &self,
        weight: &Array4<f32>,
        factors: &[Vec<f64>],
        scale: f64,
        total: impl Fn(usize) -> f64,
    ) -> Array4<f32> {
        let GeneralArchitecture { virtual_views, planes, extremes, .. } =
            self.metadata.architecture;
        let views = factors.len();
        let mixed = virtual_views * planes;
        let inputs = planes * (views + 2 * usize::from(extremes));
        let outputs = weight.shape()[0];
        Array4::from_shape_fn((outputs, inputs, 3, 3), |(output, input, row, col)| {
            let value = if input < planes * views {
                let (plane, view) = (input / views, input % views);
                let by_view = (0..virtual_views).map(|number| {
                    let kernel = weight[[output, number * planes + plane, row, col]];
                    factors[view][number] * f64::from(kernel)
                });
                scale * by_view.sum::<f64>()
            } else {
                f64::from(weight[[output, mixed + input - planes * views, row, col]])
            };
            (value * total(output)) as f32
        })
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
            wavelength_um: geometry.wavelength_um,
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
            training: metadata.training.clone(),
            scores: metadata.scores.clone(),
            program: metadata.program.clone(),
            configuration: metadata.configuration.clone(),
        }
    }
}
