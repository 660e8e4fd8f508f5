//! Convolutions one after another.

use super::Conv2d;
use super::shape::{LINE, Plane};
use crate::error::{Error, Result};
use rayon::prelude::*;

/// Layers that feed each other, and what they need to run.
#[derive(Debug, Clone)]
pub struct Stack {
    layers: Vec<Conv2d>,
}

impl Stack {
    /// A stack of layers, first to last.
    ///
    /// # Errors
    /// No layers, or one that does not read as many channels as the one before writes.
    pub fn new(layers: Vec<Conv2d>) -> Result<Self> {
        if layers.is_empty() {
            return Err(Error::out_of_range("number of layers", 0, "at least 1"));
        }
        for (index, pair) in layers.windows(2).enumerate() {
            let (written, read) = (pair[0].output_channels(), pair[1].input_channels());
            if written != read {
                let what = format!("number of channels into layer {}", index + 1);
                let remedy = "let each layer read what the one before it writes";
                return Err(Error::mismatch(what, written, read, remedy));
            }
        }
        Ok(Self { layers })
    }

    /// Channels that the first layer reads.
    pub fn input_channels(&self) -> usize {
        self.layers[0].input_channels()
    }

    /// Channels that the last layer writes.
    pub fn output_channels(&self) -> usize {
        self.layers[self.layers.len() - 1].output_channels()
    }

    /// The number of floats of scratch that [`Stack::run`] needs for images of
    /// `[rows, cols]`: two sets of planes, and for each thread of the pool that this is
    /// called in the columns and sums of a panel.
    pub fn scratch_len(&self, [rows, cols]: [usize; 2]) -> usize {
        let plane = Plane { rows, cols };
        let workers = rayon::current_num_threads();
        LINE + 2 * self.most_channels() * plane.len() + workers * self.worker_scratch_len()
    }

    /// Run all layers on `input`, `[input channel, row, col]`, and write `output`,
    /// `[output channel, row, col]`. What is in `scratch` does not matter, before or
    /// after. Nothing is allocated. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// Slices that are not of these shapes, or a scratch that is too short for the
    /// pool of threads that this is called in.
    pub fn run(
        &self,
        input: &[f32],
        size: [usize; 2],
        output: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<()> {
        self.check(input.len(), size, output.len(), scratch.len())?;
        let [rows, cols] = size;
        let plane = Plane { rows, cols };
        // Rows of columns that start on a cache line are read in one piece.
        let aligned = scratch.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE);
        let scratch = &mut scratch[aligned..];
        let planes_len = self.most_channels() * plane.len();
        let (mut front, scratch) = scratch.split_at_mut(planes_len);
        let (mut back, scratch) = scratch.split_at_mut(planes_len);
        let workers = rayon::current_num_threads();
        let scratch = &mut scratch[..workers * self.worker_scratch_len()];

        let images = input.par_chunks_exact(rows * cols);
        let planes = front.par_chunks_exact_mut(plane.len());
        planes.zip(images).for_each(|(padded, image)| plane.pad(image, padded));
        let planes = front.par_chunks_exact_mut(plane.len()).skip(self.input_channels());
        planes.chain(back.par_chunks_exact_mut(plane.len())).for_each(|p| plane.clear_border(p));
        for layer in &self.layers {
            layer.run(plane, front, back, scratch, workers);
            std::mem::swap(&mut front, &mut back);
        }
        let planes = front.par_chunks_exact(plane.len());
        let images = output.par_chunks_exact_mut(rows * cols);
        planes.zip(images).for_each(|(padded, image)| plane.unpad(padded, image));
        Ok(())
    }

    fn check(&self, input: usize, size: [usize; 2], output: usize, scratch: usize) -> Result<()> {
        let pixels = size[0].checked_mul(size[1]).unwrap_or(0);
        if pixels == 0 {
            let range = "at least 1 by 1, and countable";
            return Err(Error::out_of_range("image size [row, col]", format!("{size:?}"), range));
        }
        for (what, channels, found) in [
            ("number of values of the input", self.input_channels(), input),
            ("number of values of the output", self.output_channels(), output),
        ] {
            if channels.checked_mul(pixels) != Some(found) {
                let expected = format!("{channels} x {} x {}", size[0], size[1]);
                let remedy = "give an array [channel, row, col] of the network's channels";
                return Err(Error::mismatch(what, expected, found, remedy));
            }
        }
        let needed = self.scratch_len(size);
        if scratch < needed {
            let remedy = "take its length from scratch_len, in the same pool of threads";
            return Err(Error::mismatch("length of the scratch", needed, scratch, remedy));
        }
        Ok(())
    }

    fn most_channels(&self) -> usize {
        let channels = |layer: &Conv2d| layer.input_channels().max(layer.output_channels());
        self.layers.iter().map(channels).max().unwrap_or(0)
    }

    fn worker_scratch_len(&self) -> usize {
        self.layers.iter().map(Conv2d::worker_scratch_len).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conv::Kernel;
    use ndarray::{Array1, Array4};

    fn value(index: usize) -> f32 {
        ((index * 7919 + 13) % 127) as f32 / 64.0 - 1.0
    }

    /// Weights of a layer, and whether a ReLU follows.
    type Layer = (Array4<f32>, Array1<f32>, bool);

    fn layers(channels: &[usize]) -> Vec<Layer> {
        let pairs = channels.windows(2).enumerate();
        pairs
            .map(|(index, pair)| {
                let scale = (2.0 / (9.0 * pair[0] as f32)).sqrt();
                let shape = [pair[1], pair[0], 3, 3];
                let count = shape.iter().product();
                let weight = (0..count).map(|at| scale * value(at + 31 * index)).collect();
                let bias = (0..pair[1]).map(|at| 0.3 * value(3 * at + index)).collect();
                let last = index + 2 == channels.len();
                (Array4::from_shape_vec(shape, weight).unwrap(), bias, !last)
            })
            .collect()
    }

    fn stack(layers: &[Layer], kernel: Kernel) -> Stack {
        let convolution = |(weight, bias, relu): &Layer| {
            Conv2d::new(weight.view(), bias.view(), *relu, kernel).unwrap()
        };
        Stack::new(layers.iter().map(convolution).collect()).unwrap()
    }

    /// The definition, in f64: no padding tricks, no packing, no blocks.
    fn naive(layers: &[Layer], input: &[f32], [rows, cols]: [usize; 2]) -> Vec<f64> {
        let mut values: Vec<f64> = input.iter().copied().map(f64::from).collect();
        for (weight, bias, relu) in layers {
            let at = |channel: usize, row: isize, col: isize| {
                let inside = (0..rows as isize).contains(&row) && (0..cols as isize).contains(&col);
                let index = || (channel * rows + row as usize) * cols + col as usize;
                if inside { values[index()] } else { 0.0 }
            };
            let mut next = Vec::new();
            for output in 0..weight.dim().0 {
                for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                    let mut sum = f64::from(bias[output]);
                    for ((o, input, ky, kx), w) in weight.indexed_iter() {
                        if o == output {
                            let (row, col) = ((row + ky) as isize - 1, (col + kx) as isize - 1);
                            sum += f64::from(*w) * at(input, row, col);
                        }
                    }
                    next.push(if *relu { sum.max(0.0) } else { sum });
                }
            }
            values = next;
        }
        values
    }

    fn run(stack: &Stack, input: &[f32], size: [usize; 2]) -> Vec<f32> {
        let mut output = vec![f32::NAN; stack.output_channels() * size[0] * size[1]];
        let mut scratch = vec![f32::NAN; stack.scratch_len(size)];
        stack.run(input, size, &mut output, &mut scratch).unwrap();
        output
    }

    #[test]
    fn every_kernel_equals_the_definition_for_any_shape() {
        let channels: [&[usize]; 7] = [
            &[1, 1],
            &[3, 5],
            &[10, 12, 14],
            &[32, 32, 32],
            &[7, 17, 9, 2],
            &[40, 33],
            &[2, 70, 3],
        ];
        for channels in channels {
            let layers = layers(channels);
            for size in [[1, 1], [1, 7], [6, 1], [5, 4], [3, 50], [13, 17]] {
                let count = channels[0] * size[0] * size[1];
                let input: Vec<f32> = (0..count).map(|at| value(at + 5)).collect();
                let expected = naive(&layers, &input, size);
                let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
                for kernel in Kernel::available() {
                    let found = run(&stack(&layers, kernel), &input, size);
                    for (found, expected) in found.iter().zip(&expected) {
                        let error = (f64::from(*found) - expected).abs() / largest;
                        assert!(error < 2e-6, "{kernel:?} {channels:?} {size:?}: {error}");
                    }
                }
            }
        }
    }

    /// Panels end in every way at the end of the plane.
    #[test]
    fn every_width_is_computed_whole() {
        let layers = layers(&[1, 2]);
        for cols in 1..200 {
            let size = [2, cols];
            let input: Vec<f32> = (0..2 * cols).map(value).collect();
            let expected = naive(&layers, &input, size);
            for kernel in Kernel::available() {
                let found = run(&stack(&layers, kernel), &input, size);
                for (found, expected) in found.iter().zip(&expected) {
                    let error = (f64::from(*found) - expected).abs();
                    assert!(error < 1e-6, "{kernel:?} {cols}: {error}");
                }
            }
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let layers = layers(&[10, 12, 14, 16]);
        let size = [37, 41];
        let input: Vec<f32> = (0..10 * size[0] * size[1]).map(value).collect();
        for kernel in Kernel::available() {
            let stack = stack(&layers, kernel);
            let with = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| run(&stack, &input, size))
            };
            assert_eq!(with(1), with(5));
        }
    }

    #[test]
    fn layers_and_slices_that_do_not_fit_are_refused() {
        let kernel = Kernel::best();
        let mut all = layers(&[2, 3, 4]);
        all.swap(0, 1);
        let chain: Vec<Conv2d> = all
            .iter()
            .map(|(w, b, relu)| Conv2d::new(w.view(), b.view(), *relu, kernel).unwrap())
            .collect();
        let error = Stack::new(chain).unwrap_err().to_string();
        assert!(error.contains("channels into layer 1: expected 4, found 2"), "{error}");
        assert!(Stack::new(Vec::new()).is_err());
        let (weight, bias, _) = &all[0];
        assert!(Conv2d::new(weight.view(), bias.slice(ndarray::s![..1]), true, kernel).is_err());
        let narrow = weight.slice(ndarray::s![.., .., .., ..2]);
        assert!(Conv2d::new(narrow, bias.view(), true, kernel).is_err());

        let stack = stack(&layers(&[2, 3]), kernel);
        let mut scratch = vec![0.0; stack.scratch_len([4, 4])];
        let mut run = |input: usize, size, output: usize, scratch_len: usize| {
            let (input, mut output) = (vec![0.0; input], vec![0.0; output]);
            stack.run(&input, size, &mut output, &mut scratch[..scratch_len])
        };
        let enough = stack.scratch_len([4, 4]);
        run(32, [4, 4], 48, enough).unwrap();
        assert!(run(31, [4, 4], 48, enough).is_err());
        assert!(run(32, [4, 4], 47, enough).is_err());
        assert!(run(32, [4, 4], 48, enough - 1).is_err());
        assert!(run(0, [0, 4], 0, enough).is_err());
        assert!(run(0, [usize::MAX, 2], 0, enough).is_err());
    }
}
