//! Time of the convolution: single layers for each algorithm, and the two networks of the paper for
//! each kernel. The images are one cloud of 32 x 32 pixels, 32 such clouds, and a field of
//! 256 x 256 pixels.
//!
//! `cargo bench -p deepct-core --bench infer` writes the results to `benches/runs/DATE-COMMIT.md`,
//! with the processor and the command.

use criterion::{BenchmarkId, Criterion, Throughput};
use deepct_core::conv::{Algorithm, Conv2d, Conv2dShape, Kernel, Precision, Settings, Stack};
use deepct_core::network::Architecture;
use ndarray::{Array1, Array4};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// A pseudo-random number in `[-1, 1)`.
fn value(index: usize) -> f32 {
    let mixed = (index as u32).wrapping_mul(2_654_435_761) ^ 0x9e37_79b9;
    (mixed.wrapping_mul(2_246_822_519) >> 8) as f32 / (1 << 23) as f32 - 1.0
}

/// A stack with weights that preserve the magnitude of the signal.
fn stack(architecture: &Architecture, settings: Settings) -> Stack {
    let layers = architecture.layer_channels().enumerate().map(|(index, (input, output))| {
        let bound = (6.0 / (9.0 * input as f32)).sqrt();
        let mut next = index << 16;
        let weight = Array4::from_shape_fn((output, input, 3, 3), |_| {
            next += 1;
            bound * value(next)
        });
        let bias = Array1::from_shape_fn(output, |channel| 0.1 * value(channel));
        let relu = architecture.relu(index);
        Conv2d::new(weight.view(), bias.view(), relu, settings.kernel).expect("a layer that fits")
    });
    Stack::new(layers.collect(), settings).expect("layers that chain")
}

fn operations(architecture: &Architecture, [count, rows, cols]: [usize; 3]) -> u64 {
    let of = |(input_channels, output_channels)| {
        Conv2dShape { input_channels, output_channels, rows, cols }.operations()
    };
    count as u64 * architecture.layer_channels().map(of).sum::<u64>()
}

/// Measure the time of one architecture for images of size `[image, row, col]`.
fn time(
    criterion: &mut Criterion,
    [group, name]: [&str; 2],
    architecture: &Architecture,
    settings: Settings,
    size: [usize; 3],
) {
    let stack = stack(architecture, settings);
    let pixels: usize = size.iter().product();
    let input: Vec<f32> = (0..stack.input_channels() * pixels).map(|at| value(at).abs()).collect();
    let mut output = vec![0.0; stack.output_channels() * pixels];
    let mut scratch = stack.scratch(size).expect("a size that fits");
    let mut group = criterion.benchmark_group(group);
    // Criterion prints elements per second, which here are FLOP/s of the direct summation.
    group.throughput(Throughput::Elements(operations(architecture, size)));
    let id = BenchmarkId::new(name, size.map(|n| n.to_string()).join("x"));
    group.bench_function(id, |bencher| {
        bencher.iter(|| stack.run(&input, &mut output, &mut scratch));
    });
    group.finish();
}

fn layers(criterion: &mut Criterion) {
    for (inputs, outputs) in [(32, 32), (12, 14)] {
        let architecture = Architecture { channels: vec![inputs, outputs], last_relu: true };
        for size in [[1, 32, 32], [1, 256, 256]] {
            for algorithm in Algorithm::ALL {
                let settings = Settings { algorithm: Some(algorithm), ..Settings::default() };
                let group = format!("layer-{inputs}-{outputs}");
                time(criterion, [&group, algorithm.name()], &architecture, settings, size);
            }
        }
    }
}

fn networks(criterion: &mut Criterion) {
    for (name, architecture) in [
        ("pearls-32", Architecture::paper(32, 32, 32)),
        ("cloudct-10", Architecture::paper(10, 32, 80)),
    ] {
        for size in [[1, 32, 32], [32, 32, 32], [1, 256, 256]] {
            for kernel in Kernel::available() {
                let settings = Settings { kernel, ..Settings::default() };
                time(criterion, [name, kernel.name()], &architecture, settings, size);
            }
            let settings = Settings { precision: Precision::Bfloat16, ..Settings::default() };
            if settings.check().is_ok() {
                time(criterion, [name, "bfloat16"], &architecture, settings, size);
            }
        }
    }
}

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    layers(&mut criterion);
    networks(&mut criterion);
    criterion.final_summary();
    // `cargo test` runs each benchmark once without measuring.
    if std::env::args().any(|argument| argument == "--bench") {
        record();
    }
}

/// Write the results of this run to a new file.
fn record() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(root.join("target"), PathBuf::from);
    let mut rows = Vec::new();
    collect(&target.join("criterion"), &mut rows);
    rows.sort();
    let commit = output("git", &["rev-parse", "--short", "HEAD"]);
    let date = output("date", &["--utc", "+%F"]);
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let processor = cpuinfo.lines().find_map(|line| line.strip_prefix("model name"));
    let processor =
        processor.map_or("unknown processor", |name| name.trim_matches([' ', '\t', ':']));
    let threads = rayon::current_num_threads();
    let mut text = format!(
        "# {date}, commit {commit}\n\n`cargo bench -p deepct-core --bench infer` on {processor}, \
         {threads} threads. Medians.\n\n| what | images | ms | GFLOP/s of the plain sum |\n\
         |---|---|---|---|\n"
    );
    for (name, milliseconds, rate) in rows {
        let (what, size) = name.rsplit_once('/').unwrap_or((&name, ""));
        text.push_str(&format!("| {what} | {size} | {milliseconds} | {rate} |\n"));
    }
    let folder = root.join("benches/runs");
    std::fs::create_dir_all(&folder).expect("a folder for the record");
    let path = folder.join(format!("{date}-{commit}.md"));
    std::fs::write(&path, text).expect("a record of the run");
    println!("wrote {}", path.display());
}

/// Add the name, median and rate of every benchmark with results in `folder` to `rows`.
fn collect(folder: &Path, rows: &mut Vec<(String, String, String)>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        if !path.is_dir() {
            continue;
        }
        if path.file_name().is_none_or(|name| name != "new") {
            collect(&path, rows);
            continue;
        }
        let read = |name: &str| -> Option<serde_json::Value> {
            serde_json::from_str(&std::fs::read_to_string(path.join(name)).ok()?).ok()
        };
        let (Some(estimates), Some(about)) = (read("estimates.json"), read("benchmark.json"))
        else {
            continue;
        };
        let nanoseconds = estimates["median"]["point_estimate"].as_f64().unwrap_or(f64::NAN);
        let operations = about["throughput"]["Elements"].as_f64().unwrap_or(f64::NAN);
        let name = about["full_id"].as_str().unwrap_or("unknown").to_string();
        let rate = format!("{:.0}", operations / nanoseconds);
        rows.push((name, format!("{:.3}", nanoseconds / 1e6), rate));
    }
}

fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output();
    let text = output.ok().and_then(|output| String::from_utf8(output.stdout).ok());
    text.map_or_else(|| "unknown".into(), |text| text.trim().to_string())
}
