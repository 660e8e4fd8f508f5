//! The report of an experiment: tables, box plots and links to the figures.

use super::{ExperimentSettings, Outcome};
use crate::error::Result;
use crate::files;
use crate::metrics::correlation;
use crate::plot::{BoxGroup, box_figure};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

/// Limits between the classes of clouds by the largest optical depth of a column.
const OPTICAL_DEPTHS: [f64; 2] = [10.0, 30.0];

/// Results of the paper for its own clouds (Sde-Chen et al. 2021).
const PAPER: &str =
    "In the paper (other clouds, similar noise), ε and δ of the network are 86 ± 10 % and 44 ± 16 %
with 10 views, and 82 ± 10 % and 32 ± 16 % with 32 views; the inversion takes about one hour per
cloud on 20 cores.\n";

/// Write `report.md` and the box plots over all clouds.
pub(super) fn write(
    folder: &Path,
    settings: &ExperimentSettings,
    outcomes: &[Outcome],
) -> Result<()> {
    let groups = |value: fn(&Outcome) -> f64| -> Vec<BoxGroup> {
        let methods = settings.methods.iter();
        methods
            .map(|method| {
                let of = outcomes.iter().filter(|one| one.method == *method);
                BoxGroup { name: method.name(), values: of.map(value).collect() }
            })
            .collect()
    };
    let panels = [
        ("relative error \u{3b5} (%)", groups(|one| 100.0 * one.relative_error)),
        ("mass error \u{3b4} (%)", groups(|one| 100.0 * one.mass_error)),
    ];
    let title = match count_clouds(outcomes) {
        1 => "Errors by method, 1 cloud".to_owned(),
        count => format!("Errors by method, {count} clouds"),
    };
    box_figure(&panels, &title)?.write(folder.join("figures/errors.png"))?;
    files::write(&folder.join("report.md"), text(settings, outcomes))
}

fn count_clouds(outcomes: &[Outcome]) -> usize {
    let names: BTreeSet<&str> = outcomes.iter().map(|one| one.cloud.as_str()).collect();
    names.len()
}

/// Mean and standard deviation over the clouds.
fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}

fn text(settings: &ExperimentSettings, outcomes: &[Outcome]) -> String {
    let mut text = String::new();
    let mut line = |words: String| {
        writeln!(text, "{words}").expect("writing to a string cannot fail");
    };
    line("# Comparison of reconstruction methods\n".into());
    line(format!(
        "{} clouds, weights `{}`, sensor `{}`. Mean and standard deviation over the clouds.\n",
        count_clouds(outcomes),
        settings.weights.display(),
        settings.sensor
    ));
    line("| method | ε (%) | δ (%) | mean of abs(δ) (%) | time (s) | steps |".into());
    line("|---|---|---|---|---|---|".into());
    for method in &settings.methods {
        let of = |value: fn(&Outcome) -> f64| {
            let values: Vec<f64> =
                outcomes.iter().filter(|one| one.method == *method).map(value).collect();
            mean_and_spread(&values)
        };
        let (epsilon, delta) = (of(|one| one.relative_error), of(|one| one.mass_error));
        let (seconds, steps) = (of(|one| one.seconds), of(|one| one.steps as f64));
        line(format!(
            "| {} | {:.1} ± {:.1} | {:.1} ± {:.1} | {:.1} | {:.3} ± {:.3} | {:.1} |",
            method.name(),
            100.0 * epsilon.0,
            100.0 * epsilon.1,
            100.0 * delta.0,
            100.0 * delta.1,
            100.0 * of(|one| one.mass_error.abs()).0,
            seconds.0,
            seconds.1,
            steps.0
        ));
    }
    line(format!("\n{PAPER}"));
    line("![Errors by method](figures/errors.png)\n".into());
    line("## By optical depth\n".into());
    line(
        "Mean ε (%) and δ (%), and number of clouds, by the largest optical depth of a column.\n"
            .into(),
    );
    let [thin, thick] = OPTICAL_DEPTHS;
    let classes = [(0.0, thin), (thin, thick), (thick, f64::INFINITY)];
    line(format!(
        "| method | below {thin} | {thin} to {thick} | above {thick} |\n|---|---|---|---|"
    ));
    for method in &settings.methods {
        let cells = classes.map(|(least, most)| {
            let class = |one: &&Outcome| {
                one.method == *method && (least..most).contains(&one.optical_depth)
            };
            let of = |value: fn(&Outcome) -> f64| -> Vec<f64> {
                outcomes.iter().filter(class).map(value).collect()
            };
            let epsilon = of(|one| 100.0 * one.relative_error);
            let (delta, _) = mean_and_spread(&of(|one| 100.0 * one.mass_error));
            match epsilon.len() {
                0 => "no cloud".into(),
                count => format!("{:.1}, {delta:.1} ({count})", mean_and_spread(&epsilon).0),
            }
        });
        line(format!("| {} | {} |", method.name(), cells.join(" | ")));
    }
    line(String::new());
    let expected: Vec<(f64, f64)> = outcomes
        .iter()
        .filter_map(|one| Some((100.0 * one.expected_relative_error?, 100.0 * one.relative_error)))
        .collect();
    if expected.len() > 1 {
        let predicted: Vec<f64> = expected.iter().map(|(predicted, _)| *predicted).collect();
        line(format!(
            "Before the carving, the network expected an ε of {:.1} % in the mean; over the \
             clouds, the expected and actual ε have a correlation of {:.2}.\n",
            mean_and_spread(&predicted).0,
            correlation(expected.iter().copied()).unwrap_or(f64::NAN)
        ));
    }
    line("## By cloud\n".into());
    line("| cloud | method | ε (%) | δ (%) | time (s) | steps | misfit | figure |".into());
    line("|---|---|---|---|---|---|---|---|".into());
    for one in outcomes {
        let misfit = one.misfit.map_or("-".into(), |misfit| format!("{misfit:.2}"));
        line(format!(
            "| {} | {} | {:.1} | {:.1} | {:.3} | {} | {misfit} | [figure](figures/{}-{}.png) |",
            one.cloud,
            one.method.name(),
            100.0 * one.relative_error,
            100.0 * one.mass_error,
            one.seconds,
            one.steps,
            one.cloud,
            one.method.name()
        ));
    }
    line(
        "\nEach figure has slices, projections and renderings of the estimate and the truth,"
            .into(),
    );
    line("and a scatter plot of the two.\n".into());
    line("## Configuration\n".into());
    line(format!("deepct {}\n", env!("CARGO_PKG_VERSION")));
    let configuration = toml::to_string(settings).expect("plain numbers and text");
    line(format!("```toml\n{configuration}```"));
    text
}

#[cfg(test)]
mod tests {
    use super::super::Method;
    use super::*;

    #[test]
    fn the_table_has_mean_and_spread() {
        let outcome = |cloud: &str, method, epsilon: f64| Outcome {
            cloud: cloud.into(),
            method,
            optical_depth: if cloud == "a" { 12.0 } else { 40.0 },
            relative_error: epsilon,
            mass_error: -0.1,
            expected_relative_error: (method == Method::Network).then_some(epsilon + 0.05),
            seconds: 2.0,
            steps: 3,
            misfit: None,
            ending: None,
        };
        let outcomes = [
            outcome("a", Method::Network, 0.3),
            outcome("a", Method::Hybrid, 0.2),
            outcome("b", Method::Network, 0.5),
            outcome("b", Method::Hybrid, 0.2),
        ];
        let methods = vec![Method::Network, Method::Hybrid];
        let text = text(&ExperimentSettings { methods, ..Default::default() }, &outcomes);
        // The sample standard deviation of 30 and 50 is 20 / sqrt(2).
        assert!(
            text.contains("| network | 40.0 ± 14.1 | -10.0 ± 0.0 | 10.0 | 2.000 ± 0.000 | 3.0 |")
        );
        assert!(text.contains("2 clouds, weights `cloudct-10`"));
        assert!(text.contains("expected an ε of 45.0 % in the mean"));
        assert!(text.contains("have a correlation of 1.00."));
        assert!(text.contains("| network | no cloud | 30.0, -10.0 (1) | 50.0, -10.0 (1) |"));
        assert!(text.contains("(figures/b-hybrid.png)"));
    }
}
