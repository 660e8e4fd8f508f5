//! Volumes as the page contains them: integers, compressed and in base64, with their grid, units and step.

use crate::encoding::{base64, compressed};
use crate::error::Result;
use crate::grid::{Grid, Mask, Volume};
use crate::scene::Sun;
use colorous::Gradient;
use ndarray::{Array3, s};
use serde::Serialize;
use std::collections::BTreeMap;

/// Number of colours of a palette.
const COLOURS: usize = 64;

/// The colour maps, which are those of the figures.
const PALETTES: [(&str, Gradient, bool); 4] = [
    ("extinction", colorous::VIRIDIS, false),
    ("uncertainty", colorous::MAGMA, false),
    // From blue to red, as missing to added extinction.
    ("difference", colorous::RED_BLUE, true),
    ("mask", colorous::GREYS, false),
];

/// The volumes of a page, and which of them are compared.
#[derive(Debug, Serialize)]
pub(super) struct Exhibits {
    palettes: BTreeMap<&'static str, String>,
    volumes: Vec<Exhibit>,
    pairs: Vec<Pair>,
}

/// A volume and its fields, all on one grid.
#[derive(Debug, Serialize)]
pub(super) struct Exhibit {
    name: String,
    /// Number of voxels along z, y, x.
    shape: [usize; 3],
    /// The south-west-bottom corner: x, y, z (km).
    origin: [f64; 3],
    /// Voxel size along x, y, z (km).
    spacing: [f64; 3],
    /// Number of voxels along each side of the blocks that were averaged.
    block: usize,
    fields: BTreeMap<&'static str, Quantised>,
}

/// The values of a field as multiples of a step, in the order `[z, y, x]`.
#[derive(Debug, Serialize)]
struct Quantised {
    step: f64,
    /// Bits of an unsigned integer, which is little endian. The integers are compressed by zlib.
    bits: u8,
    values: String,
}

/// A volume, and the truth if it is known, as indices of volumes.
#[derive(Debug, Serialize)]
struct Pair {
    name: String,
    truth: Option<usize>,
    estimate: usize,
    sun: SunOfPair,
}

/// The Sun by which a volume is lit.
#[derive(Debug, Serialize)]
struct SunOfPair {
    /// Degrees.
    zenith: f64,
    /// Degrees, clockwise from north.
    azimuth: f64,
    /// Where it is stated.
    source: String,
}

impl Exhibits {
    /// No volumes.
    pub(super) fn new() -> Self {
        let palettes = PALETTES.map(|(name, gradient, reversed)| {
            let colour = |index: usize| {
                let index = if reversed { COLOURS - 1 - index } else { index };
                let colour = gradient.eval_rational(index, COLOURS);
                format!("{:02x}{:02x}{:02x}", colour.r, colour.g, colour.b)
            };
            (name, (0..COLOURS).map(colour).collect())
        });
        Self { palettes: palettes.into(), volumes: Vec::new(), pairs: Vec::new() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Add a volume and return its index.
    pub(super) fn add(&mut self, exhibit: Exhibit) -> usize {
        self.volumes.push(exhibit);
        self.volumes.len() - 1
    }

    /// Show a volume, beside the truth if there is one. `source` tells where the Sun is stated.
    pub(super) fn show(&mut self, truth: Option<usize>, estimate: usize, sun: &Sun, source: &str) {
        let sun = SunOfPair {
            zenith: sun.zenith.to_degrees(),
            azimuth: sun.azimuth.to_degrees(),
            source: source.into(),
        };
        let name = self.volumes[estimate].name.clone();
        self.pairs.push(Pair { name, truth, estimate, sun });
    }

    /// How the values are stored, as a sentence for the reader.
    pub(super) fn storage(&self) -> String {
        let fields = self.volumes.iter().flat_map(|volume| volume.fields.values());
        let steps = fields.filter(|field| field.bits == 16).map(|field| field.step);
        let mut text = match steps.reduce(f64::max) {
            None => String::new(),
            Some(step) => format!(
                "Values are stored as multiples of 1/65535 of the largest value of each field, at \
                 most {step:.2e} km\u{207b}\u{b9}."
            ),
        };
        if let Some(block) = self.volumes.iter().map(|one| one.block).find(|block| *block > 1) {
            text += &format!(
                " Large volumes are shown as means over blocks of {block} x {block} x {block} \
                 voxels; scores are those of all voxels."
            );
        }
        text
    }
}

impl Exhibit {
    /// A volume without fields, which is averaged over blocks if it has more than `most_voxels`.
    pub(super) fn new(name: &str, grid: &Grid, most_voxels: usize) -> Self {
        let block = (1..).find(|block| {
            grid.shape.iter().map(|n| n.div_ceil(*block)).product::<usize>() <= most_voxels.max(1)
        });
        let block = block.unwrap_or(1);
        Self {
            name: name.into(),
            shape: grid.shape.map(|n| n.div_ceil(block)),
            origin: grid.origin.into(),
            spacing: (grid.spacing * block as f64).into(),
            block,
            fields: BTreeMap::new(),
        }
    }

    /// Add a field of a known name: `extinction` or `uncertainty` (1/km).
    ///
    /// # Errors
    /// Values that are negative or not finite.
    pub(super) fn with(mut self, name: &'static str, volume: &Volume) -> Result<Self> {
        volume.check_non_negative(name)?;
        let values = self.averaged(&volume.values);
        let most = values.iter().copied().fold(0.0, f32::max);
        let step = f64::from(most) / f64::from(u16::MAX);
        let integer = |value: f32| (f64::from(value) / step).round() as u16;
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|&value| if step > 0.0 { integer(value) } else { 0 }.to_le_bytes())
            .collect();
        let field = Quantised { step, bits: 16, values: base64(&compressed(&bytes)) };
        self.fields.insert(name, field);
        Ok(self)
    }

    /// Add a mask.
    pub(super) fn with_mask(mut self, mask: &Mask) -> Self {
        let values = self.averaged(&mask.values.mapv(|inside| if inside { 1.0 } else { 0.0 }));
        let bytes: Vec<u8> =
            values.iter().map(|share| (share * f32::from(u8::MAX)).round() as u8).collect();
        let step = 1.0 / f64::from(u8::MAX);
        let field = Quantised { step, bits: 8, values: base64(&compressed(&bytes)) };
        self.fields.insert("mask", field);
        self
    }

    /// The means over blocks; a block at the end that is not full contains clear air there.
    fn averaged(&self, values: &Array3<f32>) -> Array3<f32> {
        if self.block == 1 {
            return values.clone();
        }
        let block = self.block;
        let range = |index: usize, n: usize| index * block..((index + 1) * block).min(n);
        let (nz, ny, nx) = values.dim();
        Array3::from_shape_fn(self.shape, |(k, j, i)| {
            let part = values.slice(s![range(k, nz), range(j, ny), range(i, nx)]);
            part.sum() / (block * block * block) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    #[test]
    fn values_are_multiples_of_the_step() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 3]).unwrap();
        let values = Array3::from_shape_vec(grid.shape, vec![0.0, 50.0, 100.0]).unwrap();
        let volume = Volume::new(grid, values).unwrap();
        let exhibit = Exhibit::new("volume", &grid, 1 << 22).with("extinction", &volume).unwrap();
        let field = &exhibit.fields["extinction"];
        assert!((field.step * 65535.0 - 100.0).abs() < 1e-9);
        // 0, 32768 (32767.5 rounded away from zero) and 65535, little endian.
        assert_eq!(field.values, base64(&compressed(&[0, 0, 0, 0x80, 0xff, 0xff])));
        let wrong = Volume::constant(grid, f32::NAN);
        assert!(Exhibit::new("volume", &grid, 1 << 22).with("extinction", &wrong).is_err());
        assert!(
            Exhibit::new("volume", &grid, 1 << 22)
                .with("extinction", &Volume::constant(grid, 0.0))
                .is_ok()
        );
    }

    #[test]
    fn large_volumes_are_averaged() {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.1, 0.2, 0.4), [2, 3, 5]).unwrap();
        let mut exhibit = Exhibit::new("volume", &grid, 1 << 22);
        assert_eq!((exhibit.block, exhibit.shape), (1, grid.shape));
        (exhibit.block, exhibit.shape) = (2, [1, 2, 3]);
        let means =
            exhibit.averaged(&Array3::from_shape_fn(grid.shape, |(k, _, i)| (k + i) as f32));
        // (0 + 1 + 1 + 2) / 4 of full blocks; half of it where the block is half outside.
        assert_eq!(means[[0, 0, 0]], 1.0);
        assert_eq!(means[[0, 1, 0]], 0.5);
        let large = Grid::new(DVec3::ZERO, DVec3::ONE, [200, 256, 256]).unwrap();
        let exhibit = Exhibit::new("volume", &large, 1 << 22);
        assert_eq!((exhibit.block, exhibit.shape, exhibit.spacing), (2, [100, 128, 128], [2.0; 3]));
    }
}
