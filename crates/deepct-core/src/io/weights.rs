//! Weights files: safetensors with metadata in the header that specify their range of application.
//!
//! # The file
//! A safetensors file of little-endian `F32` tensors in C order:
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `layers.{i}.weight` | `[out, in, 3, 3]` | the filters of convolution `i` (0 is the first), as `Conv2d.weight` of PyTorch |
//! | `layers.{i}.bias` | `[out]` | the biases of convolution `i` |
//!
//! The batch norm of a layer is folded into these two tensors (in f64, rounded once). A file may
//! instead contain the batch norm separately; it is then folded when the file is read. In this
//! case the four tensors `layers.{i}.batch_norm.weight`, `.bias`, `.running_mean` and
//! `.running_var`, each `[out]`, are required; the epsilon is
//! [`BATCH_NORM_EPSILON`](crate::network::BATCH_NORM_EPSILON). The file must not contain other
//! tensors.
//!
//! The header's `__metadata__` has the single key `deepct`. Its value is a JSON object of the
//! following form, shown for 10 views in two bands and 3 layers. All keys are required except for
//! `effective_radius_scale`, other keys are not permitted, and all numbers must be finite:
//!
//! ```json
//! {
//!   "format_version": 5,
//!   "formation": "cloudct-10",
//!   "architecture": { "channels": [80, 48, 48, 96], "last_relu": true },
//!   "view_geometry": {
//!     "sun_zenith_deg": 30.0,
//!     "sun_azimuth_deg": 45.0,
//!     "view_zenith_deg": [46.0, 34.0, 26.0, 18.0, 9.0, 0.0, 9.0, 18.0, 26.0, 34.0],
//!     "view_azimuth_deg": [180.0, 180.0, 180.0, 180.0, 180.0, 0.0, 0.0, 0.0, 0.0, 0.0],
//!     "pixel_km": [0.069, 0.059, 0.055, 0.052, 0.051, 0.050, 0.051, 0.052, 0.055, 0.059],
//!     "camera_distance_km": [827.1, 710.1, 660.9, 628.0, 606.8, 600.0, 606.8, 628.0, 660.9, 710.1]
//!   },
//!   "target_altitude_km": 1.0,
//!   "wavelength_um": [0.672, 2.13],
//!   "image_layout": { "planes": { "altitudes_km": [0.56, 0.88, 1.2, 1.52] } },
//!   "horizontal_spacing_km": [0.05, 0.05],
//!   "levels": { "bottom_km": 0.4, "count": 32, "spacing_km": 0.04 },
//!   "outputs": ["extinction", "uncertainty", "effective_radius"],
//!   "input_scale": 10.0,
//!   "output_scale": 1.0,
//!   "effective_radius_scale": 10.0,
//!   "training": { "data": "bomex", "identity": "SHA-256 of the manifest", "samples": 1000, "seed": 1 },
//!   "scores": { "epsilon": 0.5, "delta": 0.1 },
//!   "program": "weights_tools 0.1.0",
//!   "configuration": { "epochs": 100 }
//! }
//! ```
//!
//! Earlier versions can also be read. Version 3 has one band and no effective radius; version 2 has no
//! `outputs`, of which the extinction is the only one; version 1 supports only the image layout
//! `"camera"` and has no `camera_distance_km`.
//!
//! | key | meaning |
//! |---|---|
//! | `architecture.channels` | numbers of channels before, between and after the layers: the first is the number of views, multiplied by the number of bands, and by the number of planes if there are planes; the last is `levels.count` multiplied by the number of outputs |
//! | `architecture.last_relu` | whether a ReLU follows the last layer; a ReLU follows every other layer |
//! | `view_geometry` | as [`ViewGeometry`](crate::image::ViewGeometry): angles at the scene in degrees, zenith angles in `[0, 90)`, azimuths clockwise from north towards the Sun or the satellite; pixel size at the target and distance of the camera from it (km; `null` for parallel rays); lists have one entry per view, in the order of the input channels; all bands have the same views |
//! | `wavelength_um` | the wavelength of the images, or a list with that of each band; the input channels are the views of the first band, then those of the next one (on each plane) |
//! | `outputs` | `"extinction"`, then `"uncertainty"`, the expected absolute error of the extinction, and `"effective_radius"`, each optional |
//! | `target_altitude_km` | altitude of the point at the centre of every image (km) |
//! | `image_layout` | `"camera"`: the images are used in the camera geometry; `{"planes": {"altitudes_km": [...]}}`: the images are first resampled onto these horizontal planes, see [`Planes`](crate::network::Planes) |
//! | `horizontal_spacing_km` | voxel size along x and y (km): one output pixel is one column of voxels |
//! | `levels` | channel `k` of each output is the layer from `bottom_km + k * spacing_km` to `bottom_km + (k + 1) * spacing_km` |
//! | `input_scale` | network input = radiance (1/sr) x `input_scale` |
//! | `output_scale` | extinction and uncertainty (1/km) = network output x `output_scale` |
//! | `effective_radius_scale` | effective radius (um) = network output x `effective_radius_scale`, limited to 1 to 25 um; required if it is an output |
//! | `scores` | scores with arbitrary names; `epsilon` and `delta` are those of the validation set, as fractions |
//! | `configuration` | the resolved configuration of the training, as arbitrary JSON |

//!
//! # General weights, version 4
//! A file for any formation and any Sun has the key `network` with the value `"general"` and the
//! other keys of [`GeneralMetadata`]. Its tensors are `layers.{i}.weight` and `layers.{i}.bias` as
//! above, with the batch norm of every layer; `mixing.{i}.weight` `[out, in]` and
//! `mixing.{i}.bias` `[out]`, the linear layers of the perceptron that mixes the views; and
//! `modulation.{i}.weight` and `.bias`, those of the perceptron that scales and shifts the channels
//! ([`GeneralWeights`]).

use crate::error::{Error, Result};
use crate::network::{
    BatchNorm, GeneralMetadata, GeneralWeights, LayerWeights, Linear, Perceptron, TrainedWeights,
    Weights, WeightsMetadata,
};
use ndarray::{Array, Dimension, IntoDimension};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Maximum size of a weights file (bytes). The two networks of the paper are smaller than 3 MB.
pub const MAX_WEIGHTS_BYTES: u64 = 1 << 30;

/// The key of the header's metadata that contains the data of deepct.
const METADATA_KEY: &str = "deepct";

/// The name of the built-in general weights.
pub const GENERAL_WEIGHTS: &str = "general";

/// The weights built into the program, by name.
const BUILT_IN: [(&str, &[u8]); 3] = [
    (GENERAL_WEIGHTS, include_bytes!("../../weights/general.safetensors")),
    ("cloudct-10", include_bytes!("../../weights/cloudct-10.safetensors")),
    ("pearls-32", include_bytes!("../../weights/pearls-32.safetensors")),
];

/// The names of the built-in weights, which [`load_trained_weights`] accepts instead of a path.
pub fn built_in_weights() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// The contents of the file of built-in weights.
pub fn built_in_contents(name: &str) -> Option<&'static [u8]> {
    BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, bytes)| *bytes)
}

/// Load weights of either kind from a file, or built-in weights by name.
///
/// # Errors
/// Returns an error if there is neither a file nor built-in weights of this name; also as
/// [`read_trained_weights`].
pub fn load_trained_weights(name_or_path: impl AsRef<Path>) -> Result<TrainedWeights> {
    let path = name_or_path.as_ref();
    match BUILT_IN.iter().find(|(name, _)| Path::new(name) == path) {
        Some((_, bytes)) => parse_trained_weights(bytes, path),
        None if path.exists() => read_trained_weights(path),
        None => {
            let names: Vec<_> = built_in_weights().collect();
            let remedy = format!("give a file or one of the built-in {}", names.join(", "));
            Err(Error::file(path, "weights", "there is no such file", remedy))
        }
    }
}

/// Load weights for one formation from a file, or built-in weights by name.
///
/// # Errors
/// As [`load_trained_weights`]; general weights.
pub fn load_weights(name_or_path: impl AsRef<Path>) -> Result<Weights> {
    let path = name_or_path.as_ref();
    of_one_formation(load_trained_weights(path)?, path)
}

/// Read weights of either kind from a file.
///
/// # Errors
/// Returns an error if the file cannot be read, is larger than [`MAX_WEIGHTS_BYTES`], is truncated
/// or is not safetensors; if metadata are missing, incomplete or out of range; or if a layer is
/// missing or superfluous, has a wrong shape or type, or contains a value that is not finite.
pub fn read_trained_weights(path: impl AsRef<Path>) -> Result<TrainedWeights> {
    let path = path.as_ref();
    let bytes = crate::files::read(path, MAX_WEIGHTS_BYTES)?;
    parse_trained_weights(&bytes, path)
}

/// Read weights for one formation from a file.
///
/// # Errors
/// As [`read_trained_weights`]; general weights.
pub fn read_weights(path: impl AsRef<Path>) -> Result<Weights> {
    let path = path.as_ref();
    of_one_formation(read_trained_weights(path)?, path)
}

fn of_one_formation(weights: TrainedWeights, path: &Path) -> Result<Weights> {
    match weights {
        TrainedWeights::Formation(weights) => Ok(weights),
        TrainedWeights::General(_) => {
            let problem = "are general weights, not those of one formation";
            let remedy = "fold them for a geometry (GeneralWeights::fold), or use an Estimator";
            Err(Error::file(path, "weights", problem, remedy))
        }
    }
}

/// Parse weights for one formation from the bytes of a file; `path` is used in error messages.
///
/// # Errors
/// As [`read_weights`].
pub fn parse_weights(bytes: &[u8], path: &Path) -> Result<Weights> {
    of_one_formation(parse_trained_weights(bytes, path)?, path)
}

/// What a file is that is often given in place of weights, and what to do with it. Safetensors begin with
/// the length of the header, whose last bytes are 0, and the header with a brace.
fn other_kind(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    const EXPORT: &str = "write weights with `python -m weights_tools export`";
    match bytes {
        [_, _, _, _, _, 0, 0, 0, b'{', ..] => None,
        [b'P', b'K', 3, 4, ..] | [0x80, 2, 0x8a, 0x0a, ..] => {
            Some(("a checkpoint of PyTorch", EXPORT))
        }
        [0x08, 1..=32, 0x12, ..] => {
            Some(("a network in ONNX", "give the weights that it was made from"))
        }
        [0x89, b'H', b'D', b'F', ..] | [b'C', b'D', b'F', ..] => Some((
            "a netCDF or HDF5 file",
            "give weights in its place, and this file as the images",
        )),
        _ if is_text(bytes) => Some((
            "text, such as the recipe of a training",
            "train a network by it (`python -m weights_tools train`), and give the weights that \
             `python -m weights_tools export` writes",
        )),
        _ => None,
    }
}

/// Whether the beginning of a file is text.
fn is_text(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(1 << 12)];
    let valid = start.utf8_chunks().next().map_or("", |chunk| chunk.valid());
    // The last character may be cut.
    let is_control = |character: char| character.is_control() && !character.is_whitespace();
    valid.len() + 3 >= start.len() && !valid.is_empty() && !valid.contains(is_control)
}

/// Parse weights of either kind from the bytes of a file; `path` is used in error messages.
///
/// # Errors
/// As [`read_trained_weights`].
pub fn parse_trained_weights(bytes: &[u8], path: &Path) -> Result<TrainedWeights> {
    if let Some((what, remedy)) = other_kind(bytes) {
        return Err(Error::file(path, "file", format!("is {what}, not safetensors"), remedy));
    }
    let damaged = |problem: safetensors::SafeTensorError| {
        let remedy = "the file is damaged or not safetensors: export it again";
        Error::file(path, "header", problem.to_string(), remedy)
    };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let metadata = parse_metadata(header.metadata().as_ref(), path)?;
    let tensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let by_name = tensors.tensors().into_iter().collect();
    let mut tensors = Tensors { path, by_name };
    let weights = match metadata {
        Metadata::Formation(metadata) => {
            let layers = metadata.architecture.layer_channels().enumerate();
            let layers =
                layers.map(|(index, (input, output))| tensors.folded(index, input, output));
            let layers = layers.collect::<Result<Vec<_>>>()?;
            Weights::new(metadata, layers).map(TrainedWeights::Formation)
        }
        Metadata::General(metadata) => {
            let layers = metadata.layer_channels().into_iter().enumerate();
            let layers = layers.map(|(index, (input, output))| {
                Ok((tensors.layer(index, input, output)?, tensors.batch_norm(index, output)?))
            });
            let layers = layers.collect::<Result<Vec<_>>>()?;
            let [mixing, modulation] =
                ["mixing", "modulation"].map(|name| tensors.perceptron(name));
            GeneralWeights::new(metadata, mixing?, modulation?, layers).map(TrainedWeights::General)
        }
    };
    tensors.check_used()?;
    weights
        .map_err(|problem| Error::file(path, "weights", problem.to_string(), "export them again"))
}

/// The metadata of either kind of weights.
enum Metadata {
    Formation(WeightsMetadata),
    General(GeneralMetadata),
}

fn parse_metadata(header: Option<&HashMap<String, String>>, path: &Path) -> Result<Metadata> {
    let remedy = "export the weights again, with complete metadata \
                  (`python -m weights_tools export --metadata`)";
    let invalid = |problem: String| Error::file(path, "metadata", problem, remedy);
    let text = header
        .and_then(|header| header.get(METADATA_KEY))
        .ok_or_else(|| invalid(format!("there is no \"{METADATA_KEY}\" in the header")))?;
    let parsed = |problem: serde_json::Error| invalid(problem.to_string());
    let value: serde_json::Value = serde_json::from_str(text).map_err(parsed)?;
    let metadata = if value.get("network").is_some_and(|network| network == GENERAL_WEIGHTS) {
        let metadata: GeneralMetadata = serde_json::from_str(text).map_err(parsed)?;
        metadata.check().map(|()| Metadata::General(metadata))
    } else {
        let metadata: WeightsMetadata = serde_json::from_str(text).map_err(parsed)?;
        metadata.check().map(|()| Metadata::Formation(metadata))
    };
    metadata.map_err(|problem| invalid(problem.to_string()))
}

/// The tensors of a file that have not been used yet.
struct Tensors<'a, 'data> {
    path: &'a Path,
    by_name: BTreeMap<String, TensorView<'data>>,
}

impl Tensors<'_, '_> {
    /// A layer, with its batch norm folded if there is one.
    fn folded(&mut self, index: usize, input: usize, output: usize) -> Result<LayerWeights> {
        let layer = self.layer(index, input, output)?;
        let prefix = format!("layers.{index}.batch_norm.");
        if !self.by_name.keys().any(|name| name.starts_with(&prefix)) {
            return Ok(layer);
        }
        let field = format!("layers.{index}.batch_norm");
        let norm = self.batch_norm(index, output)?;
        norm.fold_into(&layer).map_err(|problem| self.invalid(&field, problem.to_string()))
    }

    fn layer(&mut self, index: usize, input: usize, output: usize) -> Result<LayerWeights> {
        let weight = self.take(&format!("layers.{index}.weight"), (output, input, 3, 3))?;
        Ok(LayerWeights { weight, bias: self.take(&format!("layers.{index}.bias"), output)? })
    }

    fn batch_norm(&mut self, index: usize, output: usize) -> Result<BatchNorm> {
        let mut take = |name| self.take(&format!("layers.{index}.batch_norm.{name}"), output);
        Ok(BatchNorm {
            weight: take("weight")?,
            bias: take("bias")?,
            running_mean: take("running_mean")?,
            running_var: take("running_var")?,
        })
    }

    /// The linear layers `{name}.{i}`, as many as there are.
    fn perceptron(&mut self, name: &str) -> Result<Perceptron> {
        let mut layers = Vec::new();
        while let Some(tensor) = self.by_name.get(&format!("{name}.{}.weight", layers.len())) {
            let field = format!("{name}.{}", layers.len());
            let &[output, input] = tensor.shape() else {
                let problem = format!("has the shape {:?}, but must have two axes", tensor.shape());
                return Err(self.invalid(&format!("{field}.weight"), problem));
            };
            let weight = self.take(&format!("{field}.weight"), (output, input))?;
            layers.push(Linear { weight, bias: self.take(&format!("{field}.bias"), output)? });
        }
        Perceptron::new(layers).map_err(|problem| self.invalid(name, problem.to_string()))
    }

    /// Remove a tensor, which must be `F32` and have the given shape.
    fn take<D: Dimension>(
        &mut self,
        name: &str,
        shape: impl IntoDimension<Dim = D>,
    ) -> Result<Array<f32, D>> {
        let shape = shape.into_dimension();
        let Some(tensor) = self.by_name.remove(name) else {
            return Err(self.invalid(name, "is missing".into()));
        };
        if tensor.dtype() != Dtype::F32 {
            return Err(self.invalid(name, format!("is {:?}, but must be F32", tensor.dtype())));
        }
        if tensor.shape() != shape.slice() {
            let (found, expected) = (tensor.shape(), shape.slice());
            let problem = format!("has the shape {found:?}, but must have {expected:?}");
            return Err(self.invalid(name, problem));
        }
        let (values, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            return Err(self.invalid(name, format!("holds {value}")));
        }
        Array::from_shape_vec(shape, values).map_err(|e| self.invalid(name, e.to_string()))
    }

    /// Returns an error if the file has another tensor.
    fn check_used(&self) -> Result<()> {
        match self.by_name.keys().next() {
            None => Ok(()),
            Some(name) => {
                Err(self.invalid(name, "is not a tensor of a network with these layers".into()))
            }
        }
    }

    fn invalid(&self, name: &str, problem: String) -> Error {
        Error::file(self.path, name, problem, "export the weights again")
    }
}

/// Write weights to a file.
///
/// # Errors
/// Returns an error if the folder cannot be written to.
#[cfg(feature = "files")]
pub fn write_weights(path: impl AsRef<Path>, weights: &Weights) -> Result<()> {
    let path = path.as_ref();
    let bytes = weights_to_bytes(weights)
        .map_err(|problem| Error::file(path, "weights", problem, "report this as a bug"))?;
    crate::files::write(path, bytes)
}

/// The bytes of a weights file.
#[cfg(feature = "files")]
fn weights_to_bytes(weights: &Weights) -> std::result::Result<Vec<u8>, String> {
    let mut tensors = Vec::new();
    for (index, layer) in weights.layers.iter().enumerate() {
        for (name, shape, values) in [
            ("weight", layer.weight.shape(), layer.weight.iter().collect::<Vec<_>>()),
            ("bias", layer.bias.shape(), layer.bias.iter().collect()),
        ] {
            let bytes: Vec<u8> = values.into_iter().flat_map(|v| v.to_le_bytes()).collect();
            tensors.push((format!("layers.{index}.{name}"), shape.to_vec(), bytes));
        }
    }
    let mut views = Vec::new();
    for (name, shape, bytes) in &tensors {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|e| e.to_string())?;
        views.push((name, view));
    }
    let json = serde_json::to_string(&weights.metadata).map_err(|e| e.to_string())?;
    let header = HashMap::from([(METADATA_KEY.to_string(), json)]);
    safetensors::serialize(views, Some(header)).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ViewStack;
    use crate::network::weights;
    use crate::scene::{Observation, Sun};

    /// A file composed by hand, in which each test can introduce one error.
    struct Draft {
        json: serde_json::Value,
        tensors: Vec<(String, Dtype, Vec<usize>, Vec<f32>)>,
    }

    impl Draft {
        fn of(weights: &Weights) -> Self {
            let json = serde_json::to_value(&weights.metadata).unwrap();
            let mut tensors = Vec::new();
            for (index, layer) in weights.layers.iter().enumerate() {
                let shapes = [layer.weight.shape().to_vec(), layer.bias.shape().to_vec()];
                let [weight_shape, bias_shape] = shapes;
                let weight: Vec<f32> = layer.weight.iter().copied().collect();
                tensors.push((format!("layers.{index}.weight"), Dtype::F32, weight_shape, weight));
                let bias = layer.bias.to_vec();
                tensors.push((format!("layers.{index}.bias"), Dtype::F32, bias_shape, bias));
            }
            Self { json, tensors }
        }

        fn bytes(&self) -> Vec<u8> {
            let data: Vec<Vec<u8>> = self
                .tensors
                .iter()
                .map(|(.., values)| values.iter().flat_map(|v| v.to_le_bytes()).collect())
                .collect();
            let views = self.tensors.iter().zip(&data).map(|((name, dtype, shape, _), data)| {
                (name, TensorView::new(*dtype, shape.clone(), data).unwrap())
            });
            let header = HashMap::from([("deepct".to_string(), self.json.to_string())]);
            safetensors::serialize(views, Some(header)).unwrap()
        }

        fn error(&self) -> String {
            parse_weights(&self.bytes(), Path::new("w.safetensors")).unwrap_err().to_string()
        }
    }

    #[cfg(feature = "files")]
    #[test]
    fn what_is_written_is_read() {
        let weights = weights(&[3, 5, 4], 7);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.safetensors");
        write_weights(&path, &weights).unwrap();
        assert_eq!(load_weights(&path).unwrap(), weights);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(parse_weights(&Draft::of(&weights).bytes(), &path).unwrap(), weights);
    }

    #[test]
    fn the_built_in_weights_are_for_the_formations_they_are_named_after() {
        for name in built_in_weights().filter(|name| *name != GENERAL_WEIGHTS) {
            let metadata = load_weights(name).unwrap().metadata;
            let formation = crate::scene::Formation::preset(name).unwrap();
            let target = crate::math::DVec3::new(0.8, 0.8, metadata.target_altitude_km);
            let views = formation.views(target, [32, 32]).unwrap();
            let images = ViewStack::new(ndarray::Array3::zeros((views.len(), 32, 32))).unwrap();
            let observation = Observation::new(Sun::default(), views, images).unwrap();
            metadata.check_images([&observation.imaging_geometry().unwrap()]).unwrap();
            assert_eq!(metadata.formation, name);
            assert!(metadata.scores["epsilon"] < 1.0, "{:?}", metadata.scores);
        }
        assert_eq!(built_in_weights().count(), 3);
        assert!(matches!(load_trained_weights(GENERAL_WEIGHTS), Ok(TrainedWeights::General(_))));
        assert!(load_weights(GENERAL_WEIGHTS).is_err());
    }

    #[test]
    fn a_batch_norm_in_the_file_is_folded() {
        let weights = weights(&[3, 4], 7);
        let mut draft = Draft::of(&weights);
        for (name, values) in [
            ("weight", [1.5, 2.0, 0.5, -1.0]),
            ("bias", [0.1, 0.2, 0.3, 0.4]),
            ("running_mean", [0.0, 1.0, -1.0, 0.5]),
            ("running_var", [1.0, 4.0, 0.25, 9.0]),
        ] {
            let name = format!("layers.0.batch_norm.{name}");
            draft.tensors.push((name, Dtype::F32, vec![4], values.to_vec()));
        }
        let folded = parse_weights(&draft.bytes(), Path::new("w")).unwrap();
        // (bias - mean) / sqrt(var + eps) * gamma + beta, evaluated by hand for channel 1.
        let factor = 2.0 / 4.00001_f64.sqrt();
        let expected = (f64::from(weights.layers[0].bias[1]) - 1.0) * factor + 0.2;
        assert!((f64::from(folded.layers[0].bias[1]) - expected).abs() < 1e-6);
        draft.tensors.pop();
        assert!(draft.error().contains("layers.0.batch_norm.running_var: is missing"));
    }

    #[test]
    fn a_damaged_file_is_refused_with_the_tensor_at_fault() {
        let weights = weights(&[3, 5, 4], 7);
        type Change = fn(&mut Draft);
        let changes: [(Change, &str); 9] = [
            (|d| drop(d.tensors.remove(2)), "layers.1.weight: is missing"),
            (|d| d.tensors[3].1 = Dtype::I32, "layers.1.bias: is I32, but must be F32"),
            (
                |d| d.tensors[0].2 = vec![5, 9, 3, 1],
                "layers.0.weight: has the shape [5, 9, 3, 1], but must have [5, 3, 3, 3]",
            ),
            (|d| d.tensors[2].3[7] = f32::NAN, "layers.1.weight: holds NaN"),
            (
                |d| d.tensors.push(("layers.2.bias".into(), Dtype::F32, vec![1], vec![0.0])),
                "layers.2.bias: is not a tensor of a network with these layers",
            ),
            (
                |d| d.json["architecture"]["channels"] = serde_json::json!([3, 6, 4]),
                "layers.0.weight: has the shape [5, 3, 3, 3], but must have [6, 3, 3, 3]",
            ),
            (|d| d.json["formation"] = serde_json::json!(3), "metadata: invalid type"),
            (|d| d.json["extra"] = serde_json::json!(3), "unknown field `extra`"),
            (|d| d.json["levels"]["count"] = serde_json::json!(5), "levels.count"),
        ];
        for (change, message) in changes {
            let mut draft = Draft::of(&weights);
            change(&mut draft);
            let error = draft.error();
            assert!(error.starts_with("w.safetensors: ") && error.contains(message), "{error}");
        }
    }

    #[test]
    fn bytes_that_are_no_weights_are_refused() {
        let whole = Draft::of(&weights(&[3, 4], 7)).bytes();
        for cut in [0, 7, 8, 50, whole.len() - 1] {
            let error = parse_weights(&whole[..cut], Path::new("w")).unwrap_err().to_string();
            assert!(error.contains("damaged"), "{error}");
        }
        for (start, what) in [
            (&b"PK\x03\x04"[..], "PyTorch"),
            (b"\x80\x02\x8a\x0al\xfc", "PyTorch"),
            (b"\x08\x08\x12\x07pytorch", "ONNX"),
            (b"\x89HDF\r\n\x1a\n", "netCDF"),
            (b"# A recipe\nepochs = 3\n", "recipe of a training"),
        ] {
            let error = parse_weights(start, Path::new("w")).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
        // A header that declares more bytes than fit in any memory.
        let huge = [u64::MAX.to_le_bytes().as_slice(), &whole[8..]].concat();
        assert!(parse_weights(&huge, Path::new("w")).is_err());
        let bare = safetensors::serialize(Vec::<(String, TensorView<'_>)>::new(), None).unwrap();
        let error = parse_weights(&bare, Path::new("w")).unwrap_err().to_string();
        assert!(error.contains("there is no \"deepct\" in the header"), "{error}");
        assert!(matches!(read_weights("no-such-file"), Err(Error::Io { .. })));
        let error = load_weights("no-such-file").unwrap_err().to_string();
        assert!(error.starts_with("no-such-file: weights: there is no such file"), "{error}");
        assert!(built_in_weights().all(|name| error.contains(name)));
    }
}
