//! `deepct plot`: figures of volumes and of images.

use crate::global::Global;
use crate::outcome::Outcome;
use crate::photograph::photograph;
use deepct_core::grid::Volume;
use deepct_core::io::{Drawing, Field, read_drawing, read_extinction};
use deepct_core::math::DVec3;
use deepct_core::plot::{
    Figure, Format, VolumeFields, contact_sheet, photograph_figure, volume_figure,
};
use deepct_core::scene::Light;
use deepct_core::{Error, Result};
use std::path::PathBuf;

/// Draw a volume or a mask, alone or beside the truth, or a sheet of images, as PNG, SVG or PDF
///
/// A volume is drawn in the slices with the most extinction and as optical depths, with its uncertainty
/// and its mask if the file has them. Colour scales end at the 99.8th percentile of the values that are
/// not zero.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File of a volume, a cloud, a mask or images
    file: PathBuf,
    /// File of the true cloud, drawn beside the volume, with the difference and a scatter plot
    #[arg(long, value_name = "C.nc")]
    truth: Option<PathBuf>,
    /// Draw the volume as a camera would see it, in the sunlight that the file states: radiances by
    /// the discrete-ordinates solver, with the shadow on the surface
    #[arg(long)]
    photograph: bool,
    /// The point through which the slices are taken (km); by default each is the one with the most
    /// extinction
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = point,
        allow_hyphen_values = true,
        conflicts_with = "photograph"
    )]
    through: Option<DVec3>,
    /// Title of the figure; by default the name of the file
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// File to write: .png, .svg or .pdf
    #[arg(long, value_name = "FIG.png")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> Result<Outcome> {
    deepct_core::files::check_output(&args.out)?;
    Format::of(&args.out, "--out")?;
    let (content, light) = read_drawing(&args.file, &Light::default())?;
    let light = light.unwrap_or_default();
    let figure = match content {
        Drawing::Field(field) => args.field_figure(&field, &light, global),
        Drawing::Images(_) if args.truth.is_some() || args.photograph || args.through.is_some() => {
            let remedy = "omit --truth, --photograph and --through, or give a volume";
            let problem = "are images, which are drawn as they are";
            Err(Error::file(&args.file, "radiance", problem, remedy))
        }
        Drawing::Images(observation) => contact_sheet(
            &observation.images,
            &observation.geometry(),
            observation.light.wavelength,
            &[],
            &args.title(),
        ),
    }?;
    figure.write(&args.out)?;
    Ok(Outcome::Success)
}

/// A point from its coordinates with commas.
fn point(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
    let point = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    point.map(DVec3::from_array).ok_or("give three numbers with commas, such as 0.8,0.8,1.0".into())
}

impl Args {
    fn title(&self) -> String {
        let name = || self.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.title.clone().unwrap_or_else(name)
    }

    fn field_figure(&self, field: &Field, light: &Light, global: &Global) -> Result<Figure> {
        let truth = self.truth.as_deref().map(|path| read_extinction(path, light)).transpose()?;
        let extinction = field.estimate.as_ref().map(|estimate| &estimate.extinction);
        if self.photograph {
            let Some(extinction) = extinction else {
                let (problem, remedy) = ("is missing", "give a volume or a cloud");
                return Err(Error::file(&self.file, "extinction", problem, remedy));
            };
            return self.photographs(extinction, truth.as_ref(), light, global);
        }
        let fields = VolumeFields {
            extinction,
            truth: truth.as_ref(),
            uncertainty: field.estimate.as_ref().and_then(|one| one.uncertainty.as_ref()),
            mask: field.mask.as_ref(),
            through: self.through,
        };
        volume_figure(&fields, &self.title()).map_err(Error::in_file(&self.file))
    }

    fn photographs(
        &self,
        extinction: &Volume,
        truth: Option<&Volume>,
        light: &Light,
        global: &Global,
    ) -> Result<Figure> {
        let names = truth.map(|truth| ("truth", truth)).into_iter();
        let named = names.chain([(if truth.is_some() { "estimate" } else { "" }, extinction)]);
        let subject = truth.unwrap_or(extinction);
        let mut pictures = Vec::new();
        let mut from = "";
        for (name, volume) in named {
            let photograph = photograph(volume, subject, light, global)?;
            from = photograph.from;
            pictures.push((name, photograph.picture));
        }
        let (zenith, azimuth) = (light.sun.zenith.to_degrees(), light.sun.azimuth.to_degrees());
        let caption = format!(
            "from the {from}; {} \u{b5}m; Sun at zenith {zenith:.0}\u{b0}, azimuth {azimuth:.0}\u{b0}",
            light.wavelength
        );
        photograph_figure(&pictures, &self.title(), &caption)
    }
}
