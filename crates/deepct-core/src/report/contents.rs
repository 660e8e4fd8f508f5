//! The contents of files, and the page of one file.

use super::exhibit::Exhibit;
use super::page::Report;
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::io::{Drawing, Field, read_drawing, read_extinction};
use crate::metrics::{score, score_mask};
use crate::network::Estimate;
use crate::plot::contact_sheet;
use crate::scene::{Light, Observation};
use std::path::Path;

/// A field as the page contains it.
///
/// # Errors
/// Values that are negative or not finite.
pub(super) fn exhibit(field: &Field, name: &str) -> Result<Exhibit> {
    let mut exhibit = Exhibit::new(name, field.grid());
    if let Some(Estimate { extinction, uncertainty }) = &field.estimate {
        exhibit = exhibit.with("extinction", extinction)?;
        if let Some(uncertainty) = uncertainty {
            exhibit = exhibit.with("uncertainty", uncertainty)?;
        }
    }
    Ok(match &field.mask {
        Some(mask) => exhibit.with_mask(mask),
        None => exhibit,
    })
}

/// The page of one file: of images a sheet, of other files the view in 3D, with the scores if the
/// truth is given.
///
/// # Errors
/// A file that cannot be read or has no extinction, mask or images; a truth on another grid, or
/// beside images.
pub fn file_report(path: impl AsRef<Path>, truth: Option<&Path>) -> Result<Report> {
    let path = path.as_ref();
    let name = file_name(path);
    let mut report = Report::new(&name);
    let (content, stated) = read_drawing(path, &Light::default())?;
    let field = match content {
        Drawing::Images(_) if truth.is_some() => {
            let problem = "are images, which cannot be compared with a truth";
            return Err(Error::file(path, "radiance", problem, "omit --truth, or give a volume"));
        }
        Drawing::Images(observation) => {
            add_sheet(&mut report, &observation, &name)?;
            return Ok(report);
        }
        Drawing::Field(field) => field,
    };
    let source = if stated.is_some() { "as the file states" } else { "assumed" };
    let light = stated.unwrap_or_default();
    let truth = truth.map(|truth| Ok((truth, read_extinction(truth, &light)?))).transpose()?;
    if let Some((of, truth)) = &truth {
        if !truth.grid.matches(field.grid()) {
            let problem = format!("is on another grid than {}", of.display());
            let remedy = "resample it first: deepct regrid FILE --like TRUTH --out NEW";
            return Err(Error::file(path, "grid", problem, remedy));
        }
        add_scores(&mut report, truth, &[(name.as_str(), &field)]);
    }
    let exhibits = report.exhibits();
    let left = truth
        .as_ref()
        .map(|(_, truth)| Exhibit::new("truth", &truth.grid).with("extinction", truth))
        .transpose()?
        .map(|exhibit| exhibits.add(exhibit));
    let right = exhibits.add(exhibit(&field, &name).map_err(Error::in_file(path))?);
    exhibits.show(left, right, &light.sun, source);
    report.viewer();
    Ok(report)
}

/// The name of a file without its folder.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Add the tables of the scores of volumes and masks on the grid of the truth.
pub(super) fn add_scores(report: &mut Report, truth: &Volume, fields: &[(&str, &Field)]) {
    let volumes: Vec<_> = fields
        .iter()
        .filter_map(|(name, field)| {
            let scores = score(truth, &field.estimate.as_ref()?.extinction).ok()?;
            let correlation = scores.correlation.map_or("-".into(), |value| format!("{value:.4}"));
            Some(vec![
                (*name).to_owned(),
                format!("{:.4}", scores.relative_error),
                format!("{:.4}", scores.mass_error),
                format!("{:.3}", scores.root_mean_square_error),
                correlation,
            ])
        })
        .collect();
    let masks: Vec<_> = fields
        .iter()
        .filter_map(|(name, field)| {
            let scores = score_mask(truth, field.mask.as_ref()?).ok()?;
            let share = |value: f64| format!("{value:.4}");
            Some(vec![
                (*name).to_owned(),
                share(scores.kept),
                share(scores.extinction_missed),
                share(scores.false_positive),
                share(scores.false_negative),
            ])
        })
        .collect();
    if volumes.is_empty() && masks.is_empty() {
        return;
    }
    report.heading("Scores");
    let unit = "root mean square error (km\u{207b}\u{b9})";
    report.table(&["volume", "\u{3b5}", "\u{3b4}", unit, "correlation"], &volumes);
    if !volumes.is_empty() {
        report.note(
            "\u{3b5}: sum of |estimate \u{2212} truth| over the sum of the truth. \u{3b4}: sum of \
             truth \u{2212} estimate over the sum of the truth, positive where extinction is missing.",
        );
    }
    let head = ["mask", "kept", "extinction missed", "false positive", "false negative"];
    report.table(&head, &masks);
    if !masks.is_empty() {
        report.note(
            "Kept: share of the voxels inside the mask. Extinction missed: share of the extinction \
             outside. False positive: share of the clear voxels inside. False negative: share of the \
             cloudy voxels outside.",
        );
    }
}

/// Add the sheet of the images of a file.
///
/// # Errors
/// Images that do not fit on a sheet; no folder for temporary files.
pub(super) fn add_sheet(report: &mut Report, observation: &Observation, name: &str) -> Result<()> {
    let folder = std::env::temp_dir();
    let folder = tempfile::tempdir_in(&folder).map_err(Error::io(folder))?;
    let path = folder.path().join("sheet.png");
    let wavelength = observation.light.wavelength;
    contact_sheet(&path, &observation.images, &observation.geometry(), wavelength, &[], name)?;
    report.picture(&std::fs::read(&path).map_err(Error::io(&path))?, name);
    Ok(())
}
