//! Export of images as OpenEXR for viewers of high-dynamic-range images.

use crate::error::{Error, Result};
use crate::scene::Observation;
use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer};
use exr::meta::attribute::{AttributeValue, IntegerBounds, Text};
use exr::meta::header::{ImageAttributes, LayerAttributes};
use exr::prelude::{SmallVec, WritableImage};
use std::path::Path;

/// Write images as OpenEXR with one layer per view, named `view_00`, `view_01` and so on. Each
/// layer has the channel `Y`, the radiance (1/sr) as 32-bit floats, and the attributes
/// `view_zenith_deg` and `view_azimuth_deg`. North is up: the first line of the OpenEXR image is
/// the last row of the array.
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_exr(path: impl AsRef<Path>, observation: &Observation) -> Result<()> {
    let path = path.as_ref();
    let [views, rows, cols] = observation.images.shape();
    let layers: SmallVec<_> = (0..views).map(|view| layer(observation, view)).collect();
    let window = IntegerBounds::from_dimensions((cols, rows));
    let image = Image::from_layers(ImageAttributes::new(window), layers);
    let output = crate::files::Output::create(path)?;
    image.write().to_file(output.temporary()).map_err(|problem| {
        Error::file(
            path,
            "file",
            format!("cannot be written: {problem}"),
            "check that the disk has room and the folder can be written",
        )
    })?;
    output.finish()
}

fn layer(observation: &Observation, number: usize) -> Layer<AnyChannels<FlatSamples>> {
    let image = observation.images.image(number);
    let (rows, cols) = image.dim();
    // OpenEXR lines are ordered downwards, array rows northwards.
    let pixels = image.rows().into_iter().rev().flatten().copied().collect();
    let channel = AnyChannel::new("Y", FlatSamples::F32(pixels));
    let mut attributes = LayerAttributes::named(format!("view_{number:02}").as_str());
    let view = &observation.views[number];
    for (name, angle) in [("view_zenith_deg", view.zenith()), ("view_azimuth_deg", view.azimuth())]
    {
        let value = AttributeValue::F64(angle.to_degrees());
        attributes.other.insert(Text::new_or_panic(name), value);
    }
    let channels = AnyChannels::sort(SmallVec::from_vec(vec![channel]));
    Layer::new((cols, rows), attributes, Encoding::FAST_LOSSLESS, channels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ViewStack;
    use crate::math::{DVec3, towards};
    use crate::scene::{Sun, View};
    use ndarray::Array3;

    #[test]
    fn every_view_is_a_layer_with_north_up() {
        let angles = [(0.0, 0.0), (0.7, 2.0)];
        let views = angles.map(|(zenith, azimuth)| {
            View::orthographic(towards(zenith, azimuth), DVec3::ZERO, 0.05, [3, 5]).unwrap()
        });
        let radiance = Array3::from_shape_fn((2, 3, 5), |(v, r, c)| (50 * v + 10 * r + c) as f32);
        let images = ViewStack::new(radiance).unwrap();
        let observation = Observation::new(Sun::default(), views.to_vec(), images).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write_exr(&path, &observation).unwrap();
        let read = exr::prelude::read_all_flat_layers_from_file(&path).unwrap();
        assert_eq!(read.layer_data.len(), 2);
        let second = &read.layer_data[1];
        assert_eq!(second.attributes.layer_name, Some(Text::from("view_01")));
        assert_eq!((second.size.width(), second.size.height()), (5, 3));
        let channel = &second.channel_data.list[0];
        assert_eq!(channel.name, Text::from("Y"));
        let pixels: Vec<_> = channel.sample_data.values_as_f32().collect();
        assert_eq!(pixels[..5], [70.0, 71.0, 72.0, 73.0, 74.0]);
        assert_eq!(pixels[10..], [50.0, 51.0, 52.0, 53.0, 54.0]);
        let zenith = &second.attributes.other[&Text::from("view_zenith_deg")];
        let AttributeValue::F64(zenith) = zenith else { panic!("{zenith:?}") };
        assert!((zenith - 0.7_f64.to_degrees()).abs() < 1e-9);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
