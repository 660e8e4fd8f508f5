//! The ways to compute a 3x3 convolution.

use super::kernels::{Kernel, Tile};
use super::shape::{BAND, Bands, TAPS};
use crate::error::{Error, Result};

/// How a convolution is computed. All give the same sums but for rounding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Algorithm {
    /// The values that the taps see are gathered as rows of a matrix, which is multiplied
    /// with the weights: the readable reference.
    Im2col,
    /// The same product, with the values read where they are.
    Direct,
    /// Winograd's minimal filtering F(2x2, 3x3): 2.25 times fewer multiplications.
    WinogradF2,
    /// Winograd's minimal filtering F(4x4, 3x3): 4 times fewer multiplications, and errors
    /// of rounding that are several times larger.
    WinogradF4,
}

impl Algorithm {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Im2col, Self::Direct, Self::WinogradF2, Self::WinogradF4];

    /// Its name: `im2col`, `direct`, `winograd-f2` or `winograd-f4`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Im2col => "im2col",
            Self::Direct => "direct",
            Self::WinogradF2 => "winograd-f2",
            Self::WinogradF4 => "winograd-f4",
        }
    }

    /// The algorithm of that name.
    ///
    /// # Errors
    /// Another name.
    pub fn from_name(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|algorithm| algorithm.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::out_of_range("algorithm of the convolution", name, format!("one of {names}"))
        })
    }
}

/// What the products of Winograd's filtering are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Precision {
    /// Floats.
    #[default]
    Single,
    /// Factors rounded to bfloat16, which has 8 bits, and sums of floats: twice as many
    /// products at a time where the processor has the instruction.
    Bfloat16,
}

impl Precision {
    /// Its name: `single` or `bfloat16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Bfloat16 => "bfloat16",
        }
    }

    /// The precision of that name.
    ///
    /// # Errors
    /// Another name.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::Single, Self::Bfloat16];
        all.into_iter().find(|precision| precision.name() == name).ok_or_else(|| {
            let range = "single or bfloat16";
            Error::out_of_range("precision of the convolution", name, range)
        })
    }
}

/// How a layer is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Method {
    pub(super) algorithm: Algorithm,
    pub(super) precision: Precision,
}

impl Method {
    /// The tiles of Winograd's filtering.
    pub(super) fn tile(self) -> Option<Tile> {
        match self.algorithm {
            Algorithm::Im2col | Algorithm::Direct => None,
            Algorithm::WinogradF2 => Some(Tile::Two),
            Algorithm::WinogradF4 => Some(Tile::Four),
        }
    }

    /// The fastest for a layer on an image: the one with the fewest operations on vectors.
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
            // Transforms read, compute and write each point of a vector of channels: as long
            // as five products.
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
