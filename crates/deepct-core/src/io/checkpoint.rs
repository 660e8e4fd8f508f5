//! Checkpoints of inversions: a safetensors file of `F64` tensors with further data in the header,
//! followed by the SHA-256 (32 bytes) of all bytes before it, so that no damage remains unnoticed.
//!
//! | tensor | shape | |
//! |---|---|---|
//! | `x`, `gradient` | `[variables]` | the current point and the gradient there |
//! | `began_at` | `[variables]` | the point for which the model was created |
//! | `probed_at` | `[variables]` | the point at which the second derivatives were estimated |
//! | `steps`, `changes` | `[pairs, variables]` | the stored pairs of the optimiser, oldest first |

use crate::error::{Error, Result};
use crate::inversion::{Checkpoint, Pair, Point, Problem, Record, Start};
use ndarray::Array3;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::path::Path;

/// The key of the header's metadata that contains the data of deepct.
const KEY: &str = "deepct";

/// Length of the checksum at the end of the file.
const DIGEST_BYTES: usize = 32;

/// The data in the header.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    /// Identity of the inversion problem: an inversion of another problem cannot resume from this
    /// checkpoint.
    identity: String,
    stage: usize,
    iteration: usize,
    value: f64,
    offsets: Vec<Vec<[f64; 2]>>,
    history: Vec<Record>,
}

/// Text that identifies an inversion in a checkpoint: its `configuration` and a checksum of the
/// contents of its images, mask and start.
pub fn inversion_identity(problem: &Problem, start: &Start, configuration: &str) -> String {
    let Problem { bands, mask, .. } = problem;
    let mut fields: Vec<&Array3<f32>> = Vec::new();
    for band in *bands {
        fields.push(&band.images.values);
        fields.extend(band.standard_error.as_ref().map(|errors| &errors.values));
    }
    if let Start::Estimate(estimate) = start {
        fields.push(&estimate.extinction.values);
        let others = [&estimate.uncertainty, &estimate.effective_radius].into_iter().flatten();
        fields.extend(others.map(|volume| &volume.values));
    }
    let mut parts: Vec<Vec<u8>> =
        fields.iter().map(|field| field.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    parts.push(mask.values.iter().map(|inside| u8::from(*inside)).collect());
    for band in *bands {
        let saturated = band.saturated.iter().flatten();
        parts.push(saturated.map(|saturated| u8::from(*saturated)).collect());
        parts.push(format!("{:?} {:?}", band.views, band.light).into_bytes());
    }
    parts.push(format!("{:?}", mask.grid).into_bytes());
    let digest = crate::files::sha256_of(parts.iter().map(Vec::as_slice));
    format!("{configuration}sha256 = \"{digest}\"\n")
}

/// Write a checkpoint, first under a temporary name. `identity` is an arbitrary text that
/// identifies the inversion problem.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_checkpoint(
    path: impl AsRef<Path>,
    checkpoint: &Checkpoint,
    identity: &str,
) -> Result<()> {
    let path = path.as_ref();
    let Checkpoint { began_at, probed_at, point, pairs, .. } = checkpoint;
    let header = Header {
        identity: identity.to_owned(),
        stage: checkpoint.stage,
        iteration: checkpoint.iteration,
        value: point.value,
        offsets: checkpoint.offsets.clone(),
        history: checkpoint.history.clone(),
    };
    let header = serde_json::to_string(&header).expect("plain numbers and text");
    let joined = |part: fn(&Pair) -> &[f64]| -> Vec<f64> {
        pairs.iter().flat_map(|pair| part(pair).iter().copied()).collect()
    };
    let (steps, changes) = (joined(|pair| &pair.step), joined(|pair| &pair.change));
    let (one, all) = (vec![probed_at.len()], vec![pairs.len(), probed_at.len()]);
    let tensors = [
        ("began_at", began_at, &one),
        ("probed_at", probed_at, &one),
        ("x", &point.x, &one),
        ("gradient", &point.gradient, &one),
        ("steps", &steps, &all),
        ("changes", &changes, &all),
    ];
    let views = tensors.map(|(name, values, shape)| {
        let view = TensorView::new(Dtype::F64, shape.clone(), bytemuck::cast_slice(values));
        (name, view.expect("the number of values matches the shape"))
    });
    let metadata = HashMap::from([(KEY.to_owned(), header)]);
    let bytes = safetensors::serialize(views, Some(metadata)).map_err(|problem| {
        Error::file(path, "checkpoint", problem.to_string(), "report this as a bug")
    })?;
    let digest = Sha256::digest(&bytes);
    crate::files::write(path, [&bytes[..], &digest[..]].concat())
}

/// Read a checkpoint of the inversion identified by `identity`.
///
/// # Errors
/// Returns an error if the file is missing, damaged, or belongs to another inversion.
pub fn read_checkpoint(path: impl AsRef<Path>, identity: &str) -> Result<Checkpoint> {
    let path = path.as_ref();
    let remedy = "delete the file and restart the inversion without --resume";
    let damaged = |problem: String| Error::file(path, "checkpoint", problem, remedy);
    let bytes = crate::files::read(path, crate::memory::limit())?;
    let (bytes, digest) = bytes.split_at(bytes.len().saturating_sub(DIGEST_BYTES));
    if digest != &Sha256::digest(bytes)[..] {
        return Err(damaged("is damaged: its checksum is that of other contents".into()));
    }
    let (_, header) =
        SafeTensors::read_metadata(bytes).map_err(|problem| damaged(problem.to_string()))?;
    let header = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
    let header = header.ok_or_else(|| damaged("has no deepct header".into()))?;
    let header: Header =
        serde_json::from_str(header).map_err(|problem| damaged(problem.to_string()))?;
    if header.identity != identity {
        return Err(damaged("belongs to an inversion of other images or settings".into()));
    }
    let tensors =
        SafeTensors::deserialize(bytes).map_err(|problem| damaged(problem.to_string()))?;
    let read = |name: &str| -> Result<Vec<f64>> {
        let tensor = tensors.tensor(name).map_err(|problem| damaged(problem.to_string()))?;
        if tensor.dtype() != Dtype::F64 {
            return Err(damaged(format!("{name} is {:?}, not F64", tensor.dtype())));
        }
        let numbers = tensor.data().chunks_exact(8);
        Ok(numbers.map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect())
    };
    let (probed_at, x, gradient) = (read("probed_at")?, read("x")?, read("gradient")?);
    let (steps, changes) = (read("steps")?, read("changes")?);
    let began_at = read("began_at")?;
    let count = probed_at.len();
    if count == 0
        || began_at.len() != count
        || x.len() != count
        || gradient.len() != count
        || steps.len() != changes.len()
    {
        return Err(damaged("has tensors of inconsistent lengths".into()));
    }
    let pairs = steps.chunks_exact(count).zip(changes.chunks_exact(count));
    let pairs = pairs.map(|(step, change)| Pair { step: step.into(), change: change.into() });
    Ok(Checkpoint {
        stage: header.stage,
        iteration: header.iteration,
        began_at,
        probed_at,
        point: Point { x, value: header.value, gradient },
        pairs: pairs.collect(),
        offsets: header.offsets,
        history: header.history,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint() -> Checkpoint {
        let pair = |from: f64| Pair { step: vec![from, 0.1], change: vec![2.0 * from, -1e-300] };
        let record = Record {
            stage: 1,
            block: 2,
            iteration: 3,
            seconds: 1.25,
            misfit: 7.0,
            value: 3.5,
            evaluations: 5,
            relative_error: Some(0.1 + 0.2),
            mass_error: None,
        };
        Checkpoint {
            stage: 1,
            iteration: 3,
            began_at: vec![0.9, 0.2],
            probed_at: vec![1.0, 0.3],
            point: Point { x: vec![0.7, 1e-17], value: 3.5, gradient: vec![-1.0, 1.0 / 3.0] },
            pairs: vec![pair(1.0), pair(1.0 / 7.0)],
            offsets: vec![vec![[0.1, -0.2], [0.0, 0.0]], vec![[0.3, 1e-9]]],
            history: vec![record],
        }
    }

    #[test]
    fn a_checkpoint_comes_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("V.nc.checkpoint");
        write_checkpoint(&path, &checkpoint(), "these images").unwrap();
        assert_eq!(read_checkpoint(&path, "these images").unwrap(), checkpoint());
        let first = Checkpoint { pairs: vec![], ..checkpoint() };
        write_checkpoint(&path, &first, "these images").unwrap();
        assert_eq!(read_checkpoint(&path, "these images").unwrap(), first);
    }

    #[test]
    fn another_inversion_and_a_damaged_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("V.nc.checkpoint");
        write_checkpoint(&path, &checkpoint(), "these images").unwrap();
        let problem = read_checkpoint(&path, "others").unwrap_err().to_string();
        assert!(problem.contains("other images"), "{problem}");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 5]).unwrap();
        assert!(read_checkpoint(&path, "these images").is_err());
    }

    #[test]
    fn a_change_of_any_byte_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("V.nc.checkpoint");
        write_checkpoint(&path, &checkpoint(), "these images").unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            std::fs::write(&path, changed).unwrap();
            let problem = read_checkpoint(&path, "these images").unwrap_err().to_string();
            assert!(problem.contains("checksum"), "byte {at}: {problem}");
        }
        for length in [0, 5, 31, 32, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(read_checkpoint(&path, "these images").is_err(), "{length} bytes");
        }
    }
}
