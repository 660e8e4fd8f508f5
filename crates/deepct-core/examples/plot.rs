//! Draws a volume beside the truth, a scatter plot of the two, and a sheet of images.
//!
//! `cargo run --release --example plot [FOLDER]` writes the figures to the folder, which defaults
//! to the system's folder for temporary files.

use deepct_core::grid::{Grid, Volume};
use deepct_core::image::{ViewGeometry, ViewStack};
use deepct_core::math::DVec3;
use deepct_core::plot::{VolumeFields, contact_sheet, scatter_figure, volume_figure};
use deepct_core::{Error, Result};
use ndarray::Array3;

fn main() -> Result<()> {
    let folder = std::env::args_os().nth(1).map_or_else(std::env::temp_dir, Into::into);
    std::fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.05, 0.05, 0.04), [24, 32, 32])?;
    let puffs = |radius: f64, extinction: f64| {
        let centers = [(0.6, 0.7, 0.8), (0.9, 0.8, 1.0), (0.8, 1.0, 0.75)].map(DVec3::from);
        let value = |(k, j, i)| {
            let point = grid.voxel_center([k, j, i]);
            let fall_off = |center: DVec3| (-(point.distance(center) / radius).powi(2)).exp();
            let value = extinction * centers.map(fall_off).iter().sum::<f64>();
            if value > 2.0 { value as f32 } else { 0.0 }
        };
        Volume::new(grid, Array3::from_shape_fn(grid.shape, value))
    };
    let (truth, estimate) = (puffs(0.15, 60.0)?, puffs(0.19, 35.0)?);

    // Nadir radiances with each column treated as a plane-parallel layer (two-stream approximation
    // of Bohren 1987, asymmetry parameter 0.86), for the Sun of the paper and for half its
    // irradiance.
    let depth = truth.values.sum_axis(ndarray::Axis(0)) * grid.spacing.z as f32;
    let radiance =
        depth.mapv(|depth| 0.866 / std::f32::consts::PI * 0.07 * depth / (1.0 + 0.07 * depth));
    let images = ndarray::stack(ndarray::Axis(0), &[radiance.view(), (&radiance * 0.5).view()]);
    let images = ViewStack::new(images.expect("two images of one size"))?;

    let figure = |name: &str| folder.join(name);
    let fields =
        VolumeFields { extinction: Some(&estimate), truth: Some(&truth), ..Default::default() };
    volume_figure(&fields, "Three puffs, smoothed")?.write(figure("volume.png"))?;
    scatter_figure(&truth, &estimate, "Three puffs, smoothed")?.write(figure("scatter.svg"))?;
    let nadir = ViewGeometry {
        sun_zenith_deg: 30.0,
        sun_azimuth_deg: 45.0,
        view_zenith_deg: vec![0.0; 2],
        view_azimuth_deg: vec![0.0; 2],
        pixel_km: vec![grid.spacing.x; 2],
        camera_distance_km: Vec::new(),
    };
    let title = "Full and half the irradiance";
    contact_sheet(&images, &nadir, 0.672, &[], title)?.write(figure("images.pdf"))?;
    println!("volume.png, scatter.svg and images.pdf are in {}", folder.display());
    Ok(())
}
