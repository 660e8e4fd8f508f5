//! Time of the network on the two layouts of the paper, for a cloud of 32 x 32 pixels
//! and a field of 256 x 256. `cargo bench -p deepct-core --bench infer`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use deepct_core::conv::{Conv2d, Conv2dShape, Kernel, Stack};
use deepct_core::network::Architecture;
use ndarray::{Array1, Array4};

/// A number in `[-1, 1)` that looks random.
fn value(index: usize) -> f32 {
    let mixed = (index as u32).wrapping_mul(2_654_435_761) ^ 0x9e37_79b9;
    (mixed.wrapping_mul(2_246_822_519) >> 8) as f32 / (1 << 23) as f32 - 1.0
}

/// A stack with weights under which the signal neither grows nor dies.
fn stack(architecture: &Architecture, kernel: Kernel) -> Stack {
    let layers = architecture.layer_channels().enumerate().map(|(index, (input, output))| {
        let bound = (6.0 / (9.0 * input as f32)).sqrt();
        let mut next = index << 16;
        let weight = Array4::from_shape_fn((output, input, 3, 3), |_| {
            next += 1;
            bound * value(next)
        });
        let bias = Array1::from_shape_fn(output, |channel| 0.1 * value(channel));
        let relu = architecture.relu(index);
        Conv2d::new(weight.view(), bias.view(), relu, kernel).expect("a layer that fits")
    });
    Stack::new(layers.collect()).expect("layers that chain")
}

fn operations(architecture: &Architecture, [rows, cols]: [usize; 2]) -> u64 {
    let layers = architecture.layer_channels();
    layers
        .map(|(input_channels, output_channels)| {
            Conv2dShape { input_channels, output_channels, rows, cols }.operations()
        })
        .sum()
}

fn infer(criterion: &mut Criterion) {
    for (layout, architecture) in [
        ("cloudct-10", Architecture::paper(10, 32, 80)),
        ("pearls-32", Architecture::paper(32, 32, 32)),
    ] {
        let mut group = criterion.benchmark_group(format!("infer/{layout}"));
        for size in [[32, 32], [256, 256]] {
            // Criterion prints "elements" a second: here these are FLOP/s.
            group.throughput(Throughput::Elements(operations(&architecture, size)));
            group.sample_size(if size[0] > 100 { 10 } else { 50 });
            for kernel in Kernel::available() {
                let stack = stack(&architecture, kernel);
                let pixels = size[0] * size[1];
                let input: Vec<f32> =
                    (0..stack.input_channels() * pixels).map(|at| value(at).abs()).collect();
                let mut output = vec![0.0; stack.output_channels() * pixels];
                let mut scratch = vec![0.0; stack.scratch_len(size)];
                let name = BenchmarkId::new(kernel.name(), format!("{}x{}", size[0], size[1]));
                group.bench_function(name, |bencher| {
                    bencher.iter(|| stack.run(&input, size, &mut output, &mut scratch));
                });
            }
        }
        group.finish();
    }
}

criterion_group!(benches, infer);
criterion_main!(benches);
