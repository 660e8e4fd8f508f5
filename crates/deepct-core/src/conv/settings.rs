//! Settings of a stack.

use super::{Algorithm, Kernel, Precision};
use crate::error::{Error, Result};

/// Settings for the computation of the layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// The inner loops.
    pub kernel: Kernel,
    /// The algorithm of all layers; with `None`, the fastest for each layer and image size.
    pub algorithm: Option<Algorithm>,
    /// The number format of the products.
    pub precision: Precision,
    /// Upper limit of the memory for the bands of one image (bytes). Images that exceed it are
    /// computed in overlapping strips.
    pub memory: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            kernel: Kernel::best(),
            algorithm: None,
            precision: Precision::Single,
            memory: 192 << 20,
        }
    }
}

impl Settings {
    /// Check that the kernel and the algorithm support the precision.
    ///
    /// # Errors
    /// Returns an error if bfloat16 is requested and the kernel or the algorithm does not
    /// support it.
    pub fn check(self) -> Result<()> {
        if self.precision == Precision::Single {
            return Ok(());
        }
        if self.kernel.bfloat16().is_none() {
            let range = "portable, or avx512 on a processor with AVX-512 BF16";
            let what = "kernel of a convolution in bfloat16";
            return Err(Error::out_of_range(what, self.kernel.name(), range));
        }
        match self.algorithm {
            None | Some(Algorithm::WinogradF2 | Algorithm::WinogradF4) => Ok(()),
            Some(algorithm) => {
                let what = "algorithm of a convolution in bfloat16";
                Err(Error::out_of_range(what, algorithm.name(), "winograd-f2 or winograd-f4"))
            }
        }
    }
}

/// Scale factors of the input of the first layer and of the output of the last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// The input of the first layer is the input of the stack times this factor.
    pub input: f32,
    /// The output of the stack is the output of the last layer times this factor.
    pub output: f32,
}

impl Default for Scales {
    fn default() -> Self {
        Self { input: 1.0, output: 1.0 }
    }
}
