//! The page of a folder: of `deepct demo`, of files of the processing chain, or of an experiment.

use super::contents::{MAX_VOXELS, add_scores, add_sheet, exhibit, file_name};
use super::exhibit::Exhibit;
use super::markdown;
use super::page::Report;
use crate::error::{Error, Result};
use crate::files;
use crate::grid::Volume;
use crate::io::{Drawing, Field, read_drawing, read_extinction, read_light};
use crate::scene::Light;
use std::path::{Path, PathBuf};

/// Upper limit of the number of volumes in the page of a folder.
const MAX_VOLUMES: usize = 12;
/// Upper limit of the number of sheets of images, and of the pictures that are not part of a text.
const MAX_PICTURES: usize = 12;
/// Upper limit of the size of a picture (bytes).
const MAX_PICTURE_BYTES: u64 = 1 << 24;
/// Names of files that contain the truth.
const TRUTHS: [&str; 2] = ["truth.nc", "cloud.nc"];

/// The page of a folder. `truth` is the file of the truth; by default it is the only cloud with
/// droplets in the folder, or else the file `truth.nc` or `cloud.nc`.
///
/// # Errors
/// A folder that cannot be read or contains nothing that can be shown; a truth that cannot be read.
pub fn folder_report(folder: impl AsRef<Path>, truth: Option<&Path>) -> Result<Report> {
    let folder = folder.as_ref();
    let mut report = Report::new(&file_name(folder));
    let is_experiment =
        folder.join("experiment.toml").is_file() && folder.join("report.md").is_file();
    if is_experiment {
        add_experiment(&mut report, folder)?;
    } else {
        add_chain(&mut report, folder, truth)?;
    }
    Ok(report)
}

/// The files of a folder with an ending, sorted by name.
fn files_in(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    if folder.is_file() {
        let remedy = "give a folder, or show this file alone with `deepct view`";
        return Err(Error::file(folder, "folder", "is a file", remedy));
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        let matches = path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending));
        if matches && path.is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn picture(path: &Path) -> Option<Vec<u8>> {
    files::read(path, MAX_PICTURE_BYTES).ok()
}

/// A volume or mask of the folder.
struct Found {
    path: PathBuf,
    name: String,
    field: Field,
    light: Option<Light>,
}

/// Add the files of the processing chain.
fn add_chain(report: &mut Report, folder: &Path, truth: Option<&Path>) -> Result<()> {
    let paths = files_in(folder, "nc")?;
    let pictures = files_in(folder, "png")?;
    if paths.is_empty() && pictures.is_empty() {
        let problem = "has no netCDF files (.nc) and no pictures (.png)";
        let remedy = "give a folder with files of deepct, such as that of `deepct demo`";
        return Err(Error::file(folder, "folder", problem, remedy));
    }
    // The illumination of the first file that states one is used for files that state none.
    let stated = |path: &PathBuf| Some((file_name(path), read_light(path).ok()??.0));
    let usual = paths.iter().find_map(stated);
    let otherwise = usual.as_ref().map_or_else(Light::default, |(_, light)| light.clone());
    let (mut found, mut images, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for path in paths {
        let name = file_name(&path);
        match read_drawing(&path, &otherwise) {
            Ok((Drawing::Images(observation), _)) => images.push((name, observation)),
            Ok((Drawing::Field(field), light)) => {
                found.push(Found { path, name, field: *field, light });
            }
            Err(problem) => rows.push(vec![name, problem.to_string()]),
        }
    }
    if !rows.is_empty() {
        report.heading("Files that could not be read");
        report.table(&["file", "problem"], &rows);
    }
    let truth = find_truth(&found, truth, &otherwise)?;
    if let Some(Truth { name, volume, .. }) = &truth {
        let fields =
            found.iter().filter(|one| one.name != *name && volume.grid.matches(one.field.grid()));
        let fields: Vec<_> = fields.map(|one| (one.name.as_str(), &one.field)).collect();
        add_scores(report, volume, &fields);
        report.note(&format!("The truth is {name}."));
    }
    add_volumes(report, &found, truth.as_ref(), usual)?;
    report.viewer();
    if !images.is_empty() {
        report.heading("Images");
    }
    for (name, observation) in images.iter().take(MAX_PICTURES) {
        add_sheet(report, observation, name)?;
    }
    note_of_more(report, "files of images", images.len(), MAX_PICTURES);
    if !pictures.is_empty() {
        report.heading("Pictures in the folder");
    }
    for path in pictures.iter().take(MAX_PICTURES) {
        match picture(path) {
            Some(png) => report.picture(&png, &file_name(path)),
            None => report.note(&format!("{} could not be read.", file_name(path))),
        }
    }
    note_of_more(report, "pictures", pictures.len(), MAX_PICTURES);
    Ok(())
}

/// States that not all are shown.
fn note_of_more(report: &mut Report, what: &str, number: usize, most: usize) {
    if number > most {
        report.note(&format!("The first {most} of {number} {what} are shown."));
    }
}

struct Truth {
    name: String,
    volume: Volume,
}

/// The truth that is given, or one of the files that were found.
fn find_truth(found: &[Found], given: Option<&Path>, light: &Light) -> Result<Option<Truth>> {
    if let Some(path) = given {
        let volume = read_extinction(path, light)?;
        return Ok(Some(Truth { name: file_name(path), volume }));
    }
    let mut droplets = found.iter().filter(|one| one.field.has_droplets);
    let only = droplets.next().filter(|_| droplets.next().is_none());
    let named = || TRUTHS.iter().find_map(|name| found.iter().find(|one| one.name == *name));
    let truth = only.or_else(named);
    Ok(truth.and_then(|one| {
        let volume = one.field.estimate.as_ref()?.extinction.clone();
        Some(Truth { name: one.name.clone(), volume })
    }))
}

/// Add the volumes and masks to the view, beside the truth where they are on its grid.
fn add_volumes(
    report: &mut Report,
    found: &[Found],
    truth: Option<&Truth>,
    usual: Option<(String, Light)>,
) -> Result<()> {
    let mut others: Vec<_> =
        found.iter().filter(|one| truth.is_none_or(|truth| truth.name != one.name)).collect();
    // Masks come last, as the first one is what the page shows at first.
    others.sort_by_key(|one| one.field.estimate.is_none());
    let exhibits = report.exhibits();
    let left = truth
        .map(|Truth { name, volume }| {
            Exhibit::new(&format!("truth ({name})"), &volume.grid, MAX_VOXELS)
                .with("extinction", volume)
        })
        .transpose()?
        .map(|exhibit| exhibits.add(exhibit));
    let default = Light::default();
    let sun_of = |one: Option<&Found>| match (one.and_then(|one| one.light.as_ref()), &usual) {
        (Some(light), _) => (light.sun, "as its file states".to_owned()),
        (None, Some((name, light))) => (light.sun, format!("as {name} states")),
        (None, None) => (default.sun, "assumed".to_owned()),
    };
    for one in others.iter().take(MAX_VOLUMES) {
        let (sun, source) = sun_of(Some(one));
        let comparable = truth.is_some_and(|truth| truth.volume.grid.matches(one.field.grid()));
        let right =
            exhibit(&one.field, &one.name, MAX_VOXELS).map_err(Error::in_file(&one.path))?;
        let right = exhibits.add(right);
        exhibits.show(left.filter(|_| comparable), right, &sun, &source);
    }
    if let (true, Some(left)) = (others.is_empty(), left) {
        let (sun, source) = sun_of(None);
        exhibits.show(None, left, &sun, &source);
    }
    note_of_more(report, "volumes", others.len(), MAX_VOLUMES);
    Ok(())
}

/// Add the text of an experiment, and its volumes beside their truth.
fn add_experiment(report: &mut Report, folder: &Path) -> Result<()> {
    let text = files::read_text(&folder.join("report.md"))?;
    let (head, rest) = text.split_once("\n## ").unwrap_or((&text, ""));
    let figure = |path: &str| picture(&folder.join(path));
    markdown::add(report, head, &figure);
    let clouds = files_in(&folder.join("clouds"), "nc")?;
    let volumes = files_in(&folder.join("volumes"), "nc")?;
    let mut shown: Vec<(usize, usize, Volume)> = Vec::new();
    for path in volumes.iter().take(MAX_VOLUMES) {
        let (Drawing::Field(field), light) = read_drawing(path, &Light::default())? else {
            continue;
        };
        let light = light.unwrap_or_default();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        // The names are those of a cloud and of a method; the longest cloud that fits is meant.
        let cloud = clouds
            .iter()
            .enumerate()
            .filter(|(_, cloud)| {
                let name = cloud.file_stem().unwrap_or_default().to_string_lossy();
                stem.starts_with(&format!("{name}-"))
            })
            .max_by_key(|(_, cloud)| cloud.as_os_str().len());
        let truth = match cloud {
            None => None,
            Some((number, cloud)) => {
                if !shown.iter().any(|(of, ..)| *of == number) {
                    let volume = read_extinction(cloud, &light)?;
                    let name = format!("truth ({})", file_name(cloud));
                    let exhibit = Exhibit::new(&name, &volume.grid, MAX_VOXELS)
                        .with("extinction", &volume)?;
                    let index = report.exhibits().add(exhibit);
                    shown.push((number, index, volume));
                }
                shown.iter().find(|(of, ..)| *of == number)
            }
        };
        let left = truth
            .filter(|(_, _, volume)| volume.grid.matches(field.grid()))
            .map(|(_, index, _)| *index);
        let exhibits = report.exhibits();
        let right = exhibits.add(exhibit(&field, &stem, MAX_VOXELS).map_err(Error::in_file(path))?);
        exhibits.show(left, right, &light.sun, "as the file states");
    }
    report.viewer();
    note_of_more(report, "volumes", volumes.len(), MAX_VOLUMES);
    if !rest.is_empty() {
        markdown::add(report, &format!("## {rest}"), &figure);
    }
    let figures = files_in(&folder.join("figures"), "png")?;
    let cases: Vec<_> = figures.iter().filter(|path| !path.ends_with("errors.png")).collect();
    if !cases.is_empty() {
        report.heading("Figures");
    }
    for path in cases.iter().take(MAX_PICTURES) {
        match picture(path) {
            Some(png) => report.picture(&png, &file_name(path)),
            None => report.note(&format!("{} could not be read.", file_name(path))),
        }
    }
    note_of_more(report, "figures", cases.len(), MAX_PICTURES);
    Ok(())
}
