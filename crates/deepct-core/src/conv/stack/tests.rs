//! Tests of stacks against the definition of the layers, for all algorithms, kernels and
//! precisions.

use super::*;
use crate::conv::{Kernel, Precision};
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

fn stack(layers: &[Layer], settings: Settings) -> Stack {
    let convolution = |(weight, bias, relu): &Layer| {
        Conv2d::new(weight.view(), bias.view(), *relu, settings.kernel).unwrap()
    };
    Stack::new(layers.iter().map(convolution).collect(), settings).unwrap()
}

/// All kernels with every algorithm, and with the automatic choice, in every supported
/// precision.
fn all_settings() -> Vec<Settings> {
    let mut all = Vec::new();
    for kernel in Kernel::available() {
        for algorithm in [None].into_iter().chain(Algorithm::ALL.map(Some)) {
            for precision in [Precision::Single, Precision::Bfloat16] {
                all.push(Settings { kernel, algorithm, precision, ..Settings::default() });
            }
        }
    }
    all.retain(|settings| settings.check().is_ok());
    all
}

/// The definition of the convolution, evaluated in f64 without padding, packing or blocks.
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

fn run(stack: &Stack, input: &[f32], [rows, cols]: [usize; 2]) -> Vec<f32> {
    let count = input.len() / stack.input_channels() / rows / cols;
    let mut output = vec![f32::NAN; count * stack.output_channels() * rows * cols];
    let mut scratch = stack.scratch([count, rows, cols]).unwrap();
    stack.run(input, &mut output, &mut scratch).unwrap();
    output
}

/// The largest error divided by the largest value.
fn error(found: &[f32], expected: &[f64]) -> f64 {
    let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let errors = found.iter().zip(expected).map(|(f, e)| (f64::from(*f) - e).abs());
    errors.fold(0.0, f64::max) / largest
}

/// Bound on the rounding error of a few layers, relative to the largest value. F(4x4) multiplies
/// and divides by up to 64; bfloat16 numbers have 8 significant bits.
fn bound(settings: Settings) -> f64 {
    match (settings.precision, settings.algorithm) {
        (Precision::Bfloat16, Some(Algorithm::WinogradF2)) => 0.02,
        (Precision::Bfloat16, _) => 0.12,
        (_, Some(Algorithm::WinogradF4) | None) => 1e-5,
        _ => 2e-6,
    }
}

#[test]
fn every_algorithm_on_every_kernel_equals_the_definition_for_any_shape() {
    let channels: [&[usize]; 7] =
        [&[1, 1], &[3, 5], &[10, 12, 14], &[32, 32, 32], &[7, 17, 9, 2], &[40, 33], &[2, 70, 3]];
    for channels in channels {
        let layers = layers(channels);
        for size in [[1, 1], [1, 7], [6, 1], [5, 4], [3, 50], [13, 17]] {
            let count = channels[0] * size[0] * size[1];
            let input: Vec<f32> = (0..count).map(|at| value(at + 5)).collect();
            let expected = naive(&layers, &input, size);
            for settings in all_settings() {
                let error = error(&run(&stack(&layers, settings), &input, size), &expected);
                assert!(error < bound(settings), "{settings:?} {channels:?} {size:?}: {error}");
            }
        }
    }
}

/// Covers all possible positions of the image edge within tiles and within rows of sums.
#[test]
fn every_width_is_computed_whole() {
    let layers = layers(&[1, 2]);
    for cols in 1..90 {
        let size = [2, cols];
        let input: Vec<f32> = (0..2 * cols).map(value).collect();
        let expected = naive(&layers, &input, size);
        for settings in all_settings() {
            let error = error(&run(&stack(&layers, settings), &input, size), &expected);
            assert!(error < bound(settings), "{settings:?} {cols}: {error}");
        }
    }
}

/// Neither the number of threads, nor blocks, nor strips, nor a batch change the result, which is
/// identical bit by bit.
#[test]
fn the_way_through_the_image_changes_no_bit() {
    let channels = [10, 12, 14, 16, 9];
    let layers = layers(&channels);
    for algorithm in Algorithm::ALL {
        let settings = Settings { algorithm: Some(algorithm), ..Settings::default() };
        let (narrow, whole) = (Settings { memory: 0, ..settings }, stack(&layers, settings));
        for size in [[13, 41], [70, 90], [3, 150], [500, 400]] {
            let input: Vec<f32> = (0..10 * size[0] * size[1]).map(value).collect();
            let expected = run(&whole, &input, size);
            for threads in [1, 5] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(|| run(&whole, &input, size)), expected);
                let strips = pool.install(|| run(&stack(&layers, narrow), &input, size));
                assert!(strips == expected, "{algorithm:?} {size:?} in strips");
            }
            let batch = run(&whole, &input.repeat(3), size);
            assert!(batch == expected.repeat(3), "{algorithm:?} {size:?} in a batch");
        }
    }
}

/// The bfloat16 instructions and the portable kernel round in the same manner and differ only
/// in the order of summation.
#[test]
fn bfloat16_is_the_same_on_every_kernel() {
    let layers = layers(&[33, 18, 20]);
    let size = [9, 14];
    let input: Vec<f32> = (0..33 * size[0] * size[1]).map(value).collect();
    let with = |kernel| {
        let precision = Precision::Bfloat16;
        let algorithm = Some(Algorithm::WinogradF2);
        let settings = Settings { kernel, algorithm, precision, ..Settings::default() };
        settings.check().is_ok().then(|| run(&stack(&layers, settings), &input, size))
    };
    let results: Vec<_> = Kernel::available().into_iter().filter_map(with).collect();
    let exact = naive(&layers, &input, size);
    let portable: Vec<f64> = results[0].iter().copied().map(f64::from).collect();
    assert!(error(&results[0], &exact) > 1e-4, "nothing was rounded");
    for result in &results {
        let error = error(result, &portable);
        assert!(error < 2e-3, "{error}");
    }
}

#[test]
fn strips_overlap_and_keep_every_column_once() {
    let stack = stack(&layers(&[1, 1, 1]), Settings { memory: 0, ..Settings::default() });
    for cols in 1..200 {
        let plan = stack.plan(Bands { rows: 9, cols });
        let strips: Vec<Strip> = plan.strips().collect();
        let kept: Vec<usize> = strips.iter().flat_map(|strip| strip.kept.clone()).collect();
        assert_eq!(kept, (0..cols).collect::<Vec<_>>());
        for Strip { computed, kept } in strips {
            assert!(computed.len() <= plan.strip && computed.start.is_multiple_of(BAND));
            assert!(computed.start == 0 || kept.start >= computed.start + plan.overlap);
            assert!(computed.end == cols || kept.end + plan.overlap <= computed.end);
        }
    }
}

#[test]
fn layers_and_slices_that_do_not_fit_are_refused() {
    let settings = Settings::default();
    let kernel = settings.kernel;
    let mut all = layers(&[2, 3, 4]);
    all.swap(0, 1);
    let chain: Vec<Conv2d> = all
        .iter()
        .map(|(w, b, relu)| Conv2d::new(w.view(), b.view(), *relu, kernel).unwrap())
        .collect();
    let error = Stack::new(chain, settings).unwrap_err().to_string();
    assert!(error.contains("channels into layer 1: expected 4, found 2"), "{error}");
    assert!(Stack::new(Vec::new(), settings).is_err());
    let (weight, bias, _) = &all[0];
    assert!(Conv2d::new(weight.view(), bias.slice(ndarray::s![..1]), true, kernel).is_err());
    let narrow = weight.slice(ndarray::s![.., .., .., ..2]);
    assert!(Conv2d::new(narrow, bias.view(), true, kernel).is_err());

    let rounded = |algorithm| {
        let precision = Precision::Bfloat16;
        Settings { kernel: Kernel::available()[0], algorithm, precision, ..settings }.check()
    };
    rounded(None).unwrap();
    let error = rounded(Some(Algorithm::Direct)).unwrap_err().to_string();
    assert!(error.contains("winograd-f2 or winograd-f4"), "{error}");

    let small = stack(&layers(&[2, 3]), settings);
    let mut scratch = small.scratch([1, 4, 4]).unwrap();
    let mut run = |stack: &Stack, input: usize, output: usize| {
        stack.run(&vec![0.0; input], &mut vec![0.0; output], &mut scratch)
    };
    run(&small, 32, 48).unwrap();
    assert!(run(&small, 31, 48).is_err());
    assert!(run(&small, 32, 47).is_err());
    let other = stack(&layers(&[2, 5, 3]), settings);
    let error = run(&other, 32, 48).unwrap_err().to_string();
    assert!(error.contains("use the scratch memory of the same stack"), "{error}");
    assert!(small.scratch([1, 0, 4]).is_err());
    assert!(small.scratch([1, usize::MAX, 2]).is_err());
}

/// A source that panics in one thread ends the run in all threads, and the scratch memory remains
/// usable.
#[test]
fn a_panic_of_a_source_reaches_the_caller() {
    struct Broken;
    impl Source for Broken {
        fn read(&self, row: &crate::conv::SourceRow, _: &mut [f32]) {
            assert!(row.row < 40, "row {} is broken", row.row);
        }
    }
    let size = [1, 64, 64];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
    pool.install(|| {
        let stack = stack(&layers(&[2, 3, 4]), Settings::default());
        let mut scratch = stack.scratch(size).unwrap();
        let mut output = vec![0.0; 4 * 64 * 64];
        let run = std::panic::AssertUnwindSafe(|| {
            stack.run_from(&Broken, &mut output, &mut scratch).unwrap();
        });
        assert!(std::panic::catch_unwind(run).is_err());
        let input = vec![0.5; 2 * 64 * 64];
        stack.run(&input, &mut output, &mut scratch).unwrap();
        assert!(output.iter().any(|value| *value != 0.0));
    });
}
