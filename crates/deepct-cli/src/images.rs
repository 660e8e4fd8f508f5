//! `deepct images check`: what a file of images means to deepct.

use crate::outcome::Outcome;
use crate::summary::print_json;
use deepct_core::carve::cloud_threshold;
use deepct_core::files::check_output;
use deepct_core::io::{GENERAL_WEIGHTS, load_trained_weights, read_derived_observation};
use deepct_core::math::{DVec3, Ray};
use deepct_core::network::Estimator;
use deepct_core::plot::{Format, contact_sheet};
use deepct_core::scene::{Meeting, Observation, View};
use deepct_core::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Check files of images
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Check(CheckArgs),
}

/// Print what a file of images means to deepct: cameras, Sun, radiances, and where the lines of sight
/// meet
///
/// The lines of sight through the centres of the images meet at the target, unless the cameras are
/// pointed at several clouds. Those through the bright parts of the images meet in the cloud. If they
/// do not, the images may be in another order than the views, or the angles may be those of other
/// images. If they meet at an altitude without clouds, the rows or the order of the views may be
/// reversed, or the target may not be the point that the images show in their middle.
#[derive(Debug, clap::Args)]
struct CheckArgs {
    /// File of images
    images: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Also draw the images (.png, .svg or .pdf), with a cross where the point at which the bright parts
    /// meet is in each
    #[arg(long, value_name = "FIG.png")]
    png: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let Verb::Check(args) = &args.verb;
    if let Some(png) = &args.png {
        check_output(png)?;
        Format::of(png, "--png")?;
    }
    let (observation, derived) = read_derived_observation(&args.images)?;
    let summary = Summary::of(&observation, derived).map_err(Error::in_file(&args.images))?;
    if args.json {
        print_json(&summary);
    } else {
        summary.say();
    }
    if let Some(png) = &args.png {
        let point =
            summary.bright_parts_meet.as_ref().map(|found| DVec3::from_array(found.point_km));
        let mark = |view: &View| point.and_then(|point| view.project(point));
        let marks: Vec<_> = observation.views.iter().map(mark).collect();
        let title = args.images.display().to_string();
        contact_sheet(
            &observation.images,
            &observation.geometry(),
            observation.light.wavelength,
            &marks,
            &title,
        )?
        .write(png)?;
    }
    Ok(Outcome::Success)
}

/// What a file of images means.
#[derive(Debug, Serialize)]
struct Summary {
    /// `[view, row, col]`.
    shape: [usize; 3],
    /// Smallest and largest radiance (1/sr).
    radiance: [f32; 2],
    saturated_pixels: usize,
    missing_pixels: usize,
    has_standard_error: bool,
    sun_zenith_deg: f64,
    sun_azimuth_deg: f64,
    sun_irradiance: f64,
    wavelength_um: f64,
    /// Keys of the scene illumination that the file lacks.
    assumed: Vec<String>,
    /// What the file does not state about cameras and images, and what it follows from.
    derived: Vec<String>,
    views: Vec<ViewSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    centres_meet: Option<MeetingSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bright_parts_meet: Option<MeetingSummary>,
    /// Mean radius of the bright parts (pixels).
    bright_radius_pixels: f64,
    /// Whether the general network is for such images, and if not, why.
    general_network: String,
}

#[derive(Debug, Serialize)]
struct ViewSummary {
    zenith_deg: f64,
    azimuth_deg: f64,
    /// `None` for an orthographic camera.
    altitude_km: Option<f64>,
    pixel_km: f64,
    target_km: [f64; 3],
    brightest: f32,
}

/// The point at which lines of sight meet, and their largest distance from it.
#[derive(Debug, Serialize)]
struct MeetingSummary {
    point_km: [f64; 3],
    most_km: f64,
    most_pixels: f64,
}

impl MeetingSummary {
    fn of(lines: &[(Ray, f64)]) -> Option<Self> {
        let rays: Vec<Ray> = lines.iter().map(|(ray, _)| *ray).collect();
        let meeting = Meeting::of(&rays)?;
        let most = |distances: &mut dyn Iterator<Item = f64>| distances.fold(0.0, f64::max);
        let in_pixels =
            meeting.distances.iter().zip(lines).map(|(distance, (_, pixel))| distance / pixel);
        Some(Self {
            point_km: meeting.point.to_array(),
            most_km: most(&mut meeting.distances.iter().copied()),
            most_pixels: most(&mut { in_pixels }),
        })
    }

    fn say(&self, what: &str) {
        let [x, y, z] = self.point_km;
        say!(
            "{what:<14} meet at x {x:.3}, y {y:.3}, z {z:.3} km, within {:.3} km ({:.1} pixels)",
            self.most_km,
            self.most_pixels
        );
    }
}

impl Summary {
    fn of(observation: &Observation, derived: Vec<String>) -> Result<Self> {
        let Observation { light, assumed, views, images, standard_error, saturated, .. } =
            observation;
        let (low, high) =
            images.values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
                (low.min(*value), high.max(*value))
            });
        let saturated_pixels = saturated.iter().flatten().filter(|marked| **marked).count();
        let summaries = views.iter().enumerate().map(|(number, view)| ViewSummary {
            zenith_deg: view.zenith().to_degrees(),
            azimuth_deg: view.azimuth().to_degrees(),
            altitude_km: view
                .distance_km()
                .map(|distance| (view.target + distance * view.towards()).z),
            pixel_km: view.pixel_km(),
            target_km: view.target.to_array(),
            brightest: images.image(number).iter().copied().fold(f32::NEG_INFINITY, f32::max),
        });
        let centre = |view: &View| {
            (view.ray(0.5 * view.rows as f64, 0.5 * view.cols as f64), view.pixel_km())
        };
        let centres: Vec<_> = views.iter().map(centre).collect();
        let parts = bright_parts(observation);
        let lines: Vec<_> = parts.iter().map(|part| (part.ray, part.pixel_km)).collect();
        let radii: f64 = parts.iter().map(|part| part.radius).sum();
        let bright_radius_pixels = radii / parts.len().max(1) as f64;
        Ok(Self {
            shape: images.shape(),
            radiance: [low, high],
            saturated_pixels,
            missing_pixels: images.values.iter().filter(|radiance| radiance.is_nan()).count(),
            has_standard_error: standard_error.is_some(),
            sun_zenith_deg: light.sun.zenith.to_degrees(),
            sun_azimuth_deg: light.sun.azimuth.to_degrees(),
            sun_irradiance: light.sun.irradiance,
            wavelength_um: light.wavelength,
            assumed: assumed.clone(),
            derived,
            views: summaries.collect(),
            centres_meet: MeetingSummary::of(&centres),
            bright_parts_meet: MeetingSummary::of(&lines),
            bright_radius_pixels,
            general_network: general_network(observation)?,
        })
    }

    fn say(&self) {
        let [views, rows, cols] = self.shape;
        let plural = if views == 1 { "" } else { "s" };
        say!("images         {views} view{plural} of {rows} x {cols} pixels");
        let [low, high] = self.radiance;
        let errors = if self.has_standard_error { "with" } else { "without" };
        say!("radiance       {low:.5} to {high:.5} sr-1, {errors} standard errors");
        if self.saturated_pixels + self.missing_pixels > 0 {
            say!(
                "pixels         {} saturated, {} missing",
                self.saturated_pixels,
                self.missing_pixels
            );
        }
        say!(
            "Sun            zenith {:.2}, azimuth {:.2} degrees",
            self.sun_zenith_deg,
            self.sun_azimuth_deg
        );
        if self.sun_irradiance != 1.0 {
            say!("irradiance     {}", self.sun_irradiance);
        }
        say!("wavelength     {} um", self.wavelength_um);
        if !self.assumed.is_empty() {
            say!("assumed        {}", self.assumed.join(", "));
        }
        for text in &self.derived {
            say!("derived        {text}");
        }
        if let Some(meeting) = &self.centres_meet {
            meeting.say("image centres");
        }
        match &self.bright_parts_meet {
            Some(meeting) => meeting.say("bright parts"),
            None => say!(
                "bright parts   fewer than two views show clouds, or all lines of sight are parallel"
            ),
        }
        say!("network        {}", self.general_network);
        say!(
            "view  zenith  azimuth  altitude (km)  pixel (m)  target (km)              brightest (sr-1)"
        );
        for (number, view) in self.views.iter().enumerate() {
            let altitude = view.altitude_km.map_or("parallel".into(), |km| format!("{km:.1}"));
            let [x, y, z] = view.target_km;
            let target = format!("{x:.3} {y:.3} {z:.3}");
            say!(
                "{number:4}  {:6.2}  {:7.2}  {altitude:>13}  {:9.1}  {target:<23}  {:16.5}",
                view.zenith_deg,
                view.azimuth_deg,
                1000.0 * view.pixel_km,
                view.brightest
            );
        }
        // Views see other sides of a cloud, so that the middles differ by a part of its size.
        let meeting = self.bright_parts_meet.as_ref();
        if meeting.is_some_and(|found| found.most_pixels > self.bright_radius_pixels) {
            note!(
                "deepct: warning: the bright parts of the images do not meet: the images may be in \
                 another order than the views, or the angles may be those of other images"
            );
        }
    }
}

/// The bright part of a view: the cloudy pixels, weighted by how much brighter than clear ones they
/// are.
struct BrightPart {
    /// The line of sight through its middle.
    ray: Ray,
    pixel_km: f64,
    /// Root mean square distance from its middle (pixels).
    radius: f64,
}

/// The bright parts of the views that have one.
fn bright_parts(observation: &Observation) -> Vec<BrightPart> {
    let thresholds = cloud_threshold(observation).by_view;
    let views = observation.views.iter().zip(thresholds).enumerate();
    views
        .filter_map(|(number, (view, threshold))| {
            let (mut sum, mut rows, mut cols, mut squares) = (0.0, 0.0, 0.0, 0.0);
            for ((row, col), radiance) in observation.images.image(number).indexed_iter() {
                let excess = f64::from((radiance - threshold).max(0.0));
                let (row, col) = (row as f64 + 0.5, col as f64 + 0.5);
                sum += excess;
                rows += excess * row;
                cols += excess * col;
                squares += excess * (row * row + col * col);
            }
            if sum <= 0.0 {
                return None;
            }
            let (row, col) = (rows / sum, cols / sum);
            let radius = (squares / sum - row * row - col * col).max(0.0).sqrt();
            Some(BrightPart { ray: view.ray(row, col), pixel_km: view.pixel_km(), radius })
        })
        .collect()
}

/// Whether the general network is for such images.
fn general_network(observation: &Observation) -> Result<String> {
    let estimator = Estimator::new(load_trained_weights(GENERAL_WEIGHTS)?);
    let ideal = observation.on_ideal_cameras();
    let (observation, geometry) = match ideal.and_then(|ideal| {
        let geometry = ideal.imaging_geometry()?;
        Ok((ideal, geometry))
    }) {
        Ok(found) => found,
        Err(problem) => return Ok(format!("cannot be used: {problem}")),
    };
    let estimate = match estimator.estimate(&observation.images, &geometry, None) {
        Ok(estimate) => estimate,
        Err(problem) => return Ok(format!("cannot be used: {problem}")),
    };
    let unusual = estimator.unusual(&observation.images, &geometry, &estimate)?;
    Ok(match unusual.as_slice() {
        [] => "the images are like those of its training".into(),
        unusual => {
            let all: Vec<_> = unusual.iter().map(ToString::to_string).collect();
            format!("was not trained on such images: {}", all.join("; "))
        }
    })
}
