//! Algorithms for a 3x3 convolution.

use super::kernels::{Kernel, Tile};
use super::shape::{BAND, Bands, TAPS};
use crate::error::{Error, Result};

/// Algorithm of a convolution. The results differ only by rounding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Algorithm {
    /// Gathers the input values of the taps as rows of a matrix and multiplies it with the
    /// weights. This is the reference implementation.
    Im2col,
    /// Computes the same product, but reads the input values in place.
    Direct,
    /// Winograd's minimal filtering F(2x2, 3x3): 2.25 times fewer multiplications.
    WinogradF2,
    /// Winograd's minimal filtering F(4x4, 3x3): 4 times fewer multiplications, and rounding
    /// errors that are several times larger.
    WinogradF4,
}

impl Algorithm {
    /// All algorithms.
    pub const ALL: [Self; 4] = [Self::Im2col, Self::Direct, Self::WinogradF2, Self::WinogradF4];

    /// The name: `im2col`, `direct`, `winograd-f2` or `winograd-f4`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Im2col => "im2col",
            Self::Direct => "direct",
            Self::WinogradF2 => "winograd-f2",
            Self::WinogradF4 => "winograd-f4",
        }
    }

    /// The algorithm with the given name.
    ///
    /// # Errors
    /// Returns an error if no algorithm has this name.
    pub fn from_name(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|algorithm| algorithm.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::out_of_range("algorithm of the convolution", name, format!("one of {names}"))
        })
    }
}

/// Number format of the products in Winograd's filtering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Precision {
    /// 32-bit floats.
    #[default]
    Single,
    /// Factors are rounded to bfloat16, which has 8 significant bits, and summed as 32-bit
    /// floats. A processor with the instruction computes twice as many products at a time.
    Bfloat16,
}

impl Precision {
    /// The name: `single` or `bfloat16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Bfloat16 => "bfloat16",
        }
    }

    /// The precision with the given name.
    ///
    /// # Errors
    /// Returns an error if no precision has this name.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::Single, Self::Bfloat16];
        all.into_iter().find(|precision| precision.name() == name).ok_or_else(|| {
            let range = "single or bfloat16";
            Error::out_of_range("precision of the convolution", name, range)
        })
    }
}

/// Algorithm and precision of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Method {
    pub(super) algorithm: Algorithm,
    pub(super) precision: Precision,
}

impl Method {
    /// The tile size of Winograd's filtering, if the algorithm uses it.
    pub(super) fn tile(self) -> Option<Tile> {
        match self.algorithm {
            Algorithm::Im2col | Algorithm::Direct => None,
            Algorithm::WinogradF2 => Some(Tile::Two),
            Algorithm::WinogradF4 => Some(Tile::Four),
        }
    }

    /// The fastest method for a layer and an image size: that with the fewest vector operations.
    pub(super) fn fastest(
        kernel: Kernel,
        bands: Bands,
        [inputs, outputs]: [usize; 2],
        precision: Precision,
    ) -> Self {
        let vectors = outputs.div_ceil(kernel.lanes());
        let input_vectors = inputs.div_ceil(kernel.lanes());
        let winograd = |tile: Tile| {
            let tiles = bands.rows.div_ceil(tile.size()) * bands.cols.div_ceil(tile.size());
            // Transforms read, compute and write each point of a vector of channels, which takes
            // as long as five products.
            let transforms = 5 * tile.points() * (input_vectors + vectors);
            tiles * (tile.points() * inputs * vectors + transforms)
        };
        let direct = match precision {
            Precision::Single => bands.rows * bands.cols * TAPS * inputs * vectors,
            Precision::Bfloat16 => usize::MAX,
        };
        let choices = [
            (winograd(Tile::Four), Algorithm::WinogradF4),
            (winograd(Tile::Two), Algorithm::WinogradF2),
            (direct, Algorithm::Direct),
        ];
        let fastest = choices.into_iter().min_by_key(|(cost, _)| *cost);
        Self { algorithm: fastest.map_or(Algorithm::Direct, |(_, fastest)| fastest), precision }
    }
}

const _: () = assert!(BAND == 4, "a band is one row of tiles of F(4x4)");
