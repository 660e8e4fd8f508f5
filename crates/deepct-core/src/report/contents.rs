//! The contents of files, and the page of one file.

use super::exhibit::Exhibit;
use super::page::Report;
use crate::error::{Error, Result};
use crate::grid::Volume;
use crate::io::{Drawing, Field, read_drawing, read_extinction};
use crate::metrics::{score, score_mask};
use crate::network::Estimate;
use crate::plot::{Format, contact_sheet};
use crate::scene::{Light, Observation};
use std::path::Path;

/// Upper limit of the number of voxels of a volume in the page of a file. Larger ones are averaged over
/// blocks.
pub const MAX_VOXELS: usize = 1 << 22;

/// A field as the page contains it, with at most `most_voxels`.
///
/// # Errors
/// Values that are negative or not finite.
pub(super) fn exhibit(field: &Field, name: &str, most_voxels: usize) -> Result<Exhibit> {
    let mut exhibit = Exhibit::new(name, field.grid(), most_voxels);
    if let Some(Estimate { extinction, uncertainty, .. }) = &field.estimate {
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
    let (content, stated) = read_drawing(path, &Light::default())?;
    let field = match &content {
        Drawing::Images(_) if truth.is_some() => {
            let problem = "are images, which cannot be compared with a truth";
            return Err(Error::file(path, "radiance", problem, "omit --truth, or give a volume"));
        }
        Drawing::Images(_) => None,
        Drawing::Field(field) => Some(field),
    };
    let light = stated.clone().unwrap_or_default();
    let read = |of: &Path| {
        let truth = read_extinction(of, &light)?;
        if field.is_some_and(|field| !truth.grid.matches(field.grid())) {
            let problem = format!("is on another grid than {}", of.display());
            let remedy = "resample it first: deepct regrid FILE --like TRUTH --out NEW";
            return Err(Error::file(path, "grid", problem, remedy));
        }
        Ok(truth)
    };
    let truth = truth.map(read).transpose()?;
    drawing_report(&file_name(path), &content, stated.as_ref(), truth.as_ref(), MAX_VOXELS)
        .map_err(Error::in_file(path))
}

/// The page of images or of a field, as [`file_report`]. Without a `light`, that of the default is
/// assumed. Volumes of more than `most_voxels` are averaged over blocks.
///
/// # Errors
/// A truth on another grid, or beside images; values that are negative or not finite.
pub fn drawing_report(
    name: &str,
    content: &Drawing,
    light: Option<&Light>,
    truth: Option<&Volume>,
    most_voxels: usize,
) -> Result<Report> {
    let mut report = Report::new(name);
    let field = match content {
        Drawing::Images(_) if truth.is_some() => {
            let range = "none beside images, which cannot be compared with it";
            return Err(Error::out_of_range("truth", "given", range));
        }
        Drawing::Images(observation) => {
            add_sheet(&mut report, observation, name)?;
            return Ok(report);
        }
        Drawing::Field(field) => field,
    };
    let source = if light.is_some() { "as stated" } else { "assumed" };
    let sun = light.map_or_else(|| Light::default().sun, |light| light.sun);
    if let Some(truth) = truth {
        field.grid().check_same("the truth", &truth.grid)?;
        add_scores(&mut report, truth, &[(name, field)]);
    }
    let exhibits = report.exhibits();
    let of_truth =
        |truth: &Volume| Exhibit::new("truth", &truth.grid, most_voxels).with("extinction", truth);
    let left = truth.map(of_truth).transpose()?.map(|exhibit| exhibits.add(exhibit));
    let right = exhibits.add(exhibit(field, name, most_voxels)?);
    exhibits.show(left, right, &sun, source);
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
/// Images that do not fit on a sheet.
pub(super) fn add_sheet(report: &mut Report, observation: &Observation, name: &str) -> Result<()> {
    let wavelength = observation.light.wavelength;
    let sheet = contact_sheet(&observation.images, &observation.geometry(), wavelength, &[], name)?;
    report.picture(&sheet.encode(Format::Png)?, name);
    Ok(())
}
