//! What a user of a stack may choose.

use super::{Algorithm, Kernel, Precision};
use crate::error::{Error, Result};

/// How layers are run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// The inner loops.
    pub kernel: Kernel,
    /// How every layer is computed; `None` takes the fastest for each layer and image.
    pub algorithm: Option<Algorithm>,
    /// What the products are made of.
    pub precision: Precision,
    /// Memory (bytes) that the bands of one image may take. Wider images are computed in
    /// strips that overlap.
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
    /// Whether the kernel and the algorithm can compute in the precision.
    ///
    /// # Errors
    /// bfloat16 on a kernel or with an algorithm that has no such products.
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

/// Factors of what goes into the first layer and of what comes out of the last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// The first layer sees the input times this.
    pub input: f32,
    /// The output is what the last layer gives times this.
    pub output: f32,
}

impl Default for Scales {
    fn default() -> Self {
        Self { input: 1.0, output: 1.0 }
    }
}
