//! Named arrays: what fields and images consist of in formats that are collections of arrays.

use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use crate::io::arrays::{CORNER, SPACING};
use crate::math::DVec3;
use crate::network::Estimate;
use crate::optics::extinction;
use crate::scene::{Observation, Projection, View};
use ndarray::{Array1, Array2, Array3, ArrayD};

/// Fields on one grid.
#[derive(Debug, Clone)]
pub struct Fields {
    grid: Grid,
    fields: Vec<Field>,
}

/// A field with the name that it has in deepct's own files.
#[derive(Debug, Clone)]
pub struct Field {
    /// The name, such as `extinction`.
    pub name: &'static str,
    /// The unit, such as `km-1`.
    pub unit: &'static str,
    /// The values, array `[z, y, x]`.
    pub values: Array3<f32>,
}

/// An array with its name.
pub(super) struct NamedArray {
    pub(super) name: &'static str,
    pub(super) values: Numbers,
}

/// The values of an array. Logical values are numbers 0 and 1.
pub(super) enum Numbers {
    Single(ArrayD<f32>),
    Double(ArrayD<f64>),
    Byte(ArrayD<u8>),
}

const EXTINCTION: (&str, &str) = ("extinction", "km-1");

impl Fields {
    fn new(grid: Grid, fields: Vec<((&'static str, &'static str), Array3<f32>)>) -> Self {
        let fields = fields.into_iter();
        let fields = fields.map(|((name, unit), values)| Field { name, unit, values }).collect();
        Self { grid, fields }
    }

    /// The fields of a cloud: `extinction` (1/km), from an extinction efficiency of 2 if the cloud is
    /// given by its droplets only, and `lwc` (g/m3), `reff` (um) and `veff` if they are known.
    ///
    /// # Errors
    /// Returns an error if the cloud has neither extinction nor droplets.
    pub fn of_cloud(cloud: &Cloud) -> Result<Self> {
        let mut fields = vec![(EXTINCTION, extinction(cloud)?.values)];
        if let Some(droplets) = &cloud.microphysics {
            fields.extend([
                (("lwc", "g m-3"), droplets.liquid_water_content.clone()),
                (("reff", "um"), droplets.effective_radius.clone()),
                (("veff", "1"), droplets.effective_variance.clone()),
            ]);
        }
        Ok(Self::new(cloud.grid, fields))
    }

    /// The `extinction` (1/km) of an estimate, and its `uncertainty` and `reff` (um) if they are known.
    pub fn of_estimate(estimate: &Estimate) -> Self {
        let Volume { grid, values } = &estimate.extinction;
        let mut fields = vec![(EXTINCTION, values.clone())];
        let uncertainty = estimate.uncertainty.iter();
        fields.extend(uncertainty.map(|volume| (("uncertainty", "km-1"), volume.values.clone())));
        let radius = estimate.effective_radius.iter();
        fields.extend(radius.map(|volume| (("reff", "um"), volume.values.clone())));
        Self::new(*grid, fields)
    }

    /// The `mask`: 1 inside and 0 outside.
    pub fn of_mask(mask: &Mask) -> Self {
        let values = mask.values.mapv(|inside| if inside { 1.0 } else { 0.0 });
        Self::new(mask.grid, vec![(("mask", "1"), values)])
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The fields, the most important one first.
    pub fn iter(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter()
    }

    /// The extinction, or an error for a format that holds nothing else.
    pub(super) fn extinction(&self) -> Result<&Array3<f32>> {
        let found = self.fields.iter().find(|field| field.name == EXTINCTION.0);
        let names: Vec<_> = self.fields.iter().map(|field| field.name).collect();
        found.map(|field| &field.values).ok_or_else(|| {
            Error::mismatch("field", names.join(", "), EXTINCTION.0, "give a cloud or a volume")
        })
    }

    /// The coordinates `x`, `y` and `z` (km, of the centres of the voxels), the lower corner and the size
    /// of a voxel (km, along x, y, z), and the fields.
    pub(super) fn arrays(&self) -> Vec<NamedArray> {
        let axes = ["x", "y", "z"].into_iter().zip(self.grid.axes());
        let axes = axes.map(|(name, centers)| doubles(name, Array1::from(centers).into_dyn()));
        let fields = self.fields.iter().map(|field| NamedArray {
            name: field.name,
            values: Numbers::Single(field.values.clone().into_dyn()),
        });
        let Grid { origin, spacing, .. } = self.grid;
        let grid = [(CORNER, origin), (SPACING, spacing)]
            .map(|(name, point)| doubles(name, Array1::from(point.to_array().to_vec()).into_dyn()));
        axes.chain(grid).chain(fields).collect()
    }
}

fn doubles(name: &'static str, values: ArrayD<f64>) -> NamedArray {
    NamedArray { name, values: Numbers::Double(values) }
}

fn number(name: &'static str, value: f64) -> NamedArray {
    doubles(name, Array1::from_elem(1, value).into_dyn())
}

/// The arrays of images, named as the variables of deepct's own files.
pub(super) fn of_images(observation: &Observation) -> Vec<NamedArray> {
    let views = &observation.views;
    let by_view = |name, value: fn(&View) -> f64| {
        doubles(name, views.iter().map(value).collect::<Array1<f64>>().into_dyn())
    };
    let points = |name, value: fn(&View) -> DVec3| {
        let points: Vec<_> = views.iter().flat_map(|view| value(view).to_array()).collect();
        let points = Array2::from_shape_vec((views.len(), 3), points).expect("three coordinates");
        doubles(name, points.into_dyn())
    };
    let sun = &observation.light.sun;
    let images = |name, values: &Array3<f32>| NamedArray {
        name,
        values: Numbers::Single(values.clone().into_dyn()),
    };
    let mut arrays = vec![
        images("radiance", &observation.images.values),
        by_view("view_zenith_deg", |view| view.zenith().to_degrees()),
        by_view("view_azimuth_deg", |view| view.azimuth().to_degrees()),
        by_view("pixel_km", View::pixel_km),
        points("target", |view| view.target),
        points("camera_position", |view| match view.projection {
            Projection::Perspective { position, .. } => position,
            _ => DVec3::NAN,
        }),
        number("sun_zenith_deg", sun.zenith.to_degrees()),
        number("sun_azimuth_deg", sun.azimuth.to_degrees()),
        number("sun_irradiance", sun.irradiance),
        number("wavelength", observation.light.wavelength),
    ];
    if let Some(error) = &observation.standard_error {
        arrays.push(images("radiance_standard_error", &error.values));
    }
    if let Some(saturated) = &observation.saturated {
        let values = Numbers::Byte(saturated.mapv(u8::from).into_dyn());
        arrays.push(NamedArray { name: "saturated", values });
    }
    arrays
}
