//! Resampling of the images onto horizontal planes, row by row as the first layer reads them.

use super::{ImageLayout, WeightsMetadata};
use crate::conv::{Source, SourceRow};
use crate::error::{Error, Result};
use crate::math::{DVec3, towards};
use rayon::prelude::*;

/// Smallest number of pixels for which a parallel task is worthwhile.
const PIXELS_PER_TASK: usize = 4096;

/// Resamples the images of a formation onto horizontal planes.
#[derive(Debug, Clone)]
pub(super) struct PlaneResampler {
    /// The views of the first band, then those of the next one.
    views: Vec<View>,
    /// Voxel size along y and x (km).
    spacing: [f64; 2],
    scale: f32,
    /// Number of planes, if the minimum and the maximum over the views are further channels.
    extremes: Option<usize>,
    /// Number of voxels by which the resampled image of a view (its ground) extends beyond the
    /// field on each side, along y and x: the largest parallax of any plane in any view.
    margin: [usize; 2],
}

/// The images that are resampled: their size and where their centres are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<'a> {
    /// Number of rows and columns.
    pub(super) size: [usize; 2],
    /// [`ImagingGeometry::shifts`](crate::image::ImagingGeometry::shifts).
    pub(super) shifts: &'a [[f64; 2]],
}

impl Frame<'_> {
    /// The position of the target in the image of a view, `[row, col]`.
    fn target(&self, view: usize) -> [f64; 2] {
        let shift = self.shifts.get(view).copied().unwrap_or_default();
        [0, 1].map(|axis| 0.5 * self.size[axis] as f64 - shift[axis])
    }
}

/// The voxels that are computed, relative to the target.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    /// Number of rows and columns of voxels.
    pub(super) size: [usize; 2],
    /// Position of their centre with respect to the target, along y and x (km).
    pub(super) center: [f64; 2],
}

/// One view of one band: the projection from the plane of the target to its image, and the offsets of its
/// planes.
#[derive(Debug, Clone)]
struct View {
    camera: Camera,
    /// The offset of each plane, `[row, col]` (voxels), from the first row and column of the
    /// margin.
    offsets: Vec<[usize; 2]>,
}

/// The projection of a camera, from a point `(x, y)` (km) on the plane of the target, relative to
/// the target, to pixels relative to the centre of the image. The row is
/// `row · (x, y) / (1 - depth · (x, y))`, and the column is found correspondingly.
#[derive(Debug, Clone, Copy)]
struct Camera {
    row: [f64; 2],
    col: [f64; 2],
    depth: [f64; 2],
}

impl Camera {
    /// Creates the camera in the direction `towards`, at a distance (km) or with parallel rays.
    fn new(towards: DVec3, pixel: f64, distance: Option<f64>) -> Self {
        let Some(distance) = distance else {
            return Self { row: [0.0, 1.0 / pixel], col: [1.0 / pixel, 0.0], depth: [0.0, 0.0] };
        };
        let col = (DVec3::X - DVec3::X.dot(towards) * towards).normalize();
        let row = towards.cross(col);
        Self {
            row: [row.x / pixel, row.y / pixel],
            col: [col.x / pixel, col.y / pixel],
            depth: [towards.x / distance, towards.y / distance],
        }
    }

    /// Row and column, relative to the centre of the image.
    #[inline]
    fn project(&self, x: f64, y: f64) -> [f64; 2] {
        let along = |axis: [f64; 2]| axis[0] * x + axis[1] * y;
        // No point should be behind the camera. The limit keeps the result finite for extremely
        // wide fields.
        let scale = 1.0 / (1.0 - along(self.depth)).max(1e-3);
        [along(self.row) * scale, along(self.col) * scale]
    }
}

impl PlaneResampler {
    /// The resampler for the planes of the metadata, if there are any.
    pub(super) fn new(metadata: &WeightsMetadata) -> Option<Self> {
        let ImageLayout::Planes(planes) = &metadata.image_layout else { return None };
        let altitudes = &planes.altitudes_km;
        let geometry = &metadata.view_geometry;
        let parallaxes: Vec<Vec<[f64; 2]>> = (0..metadata.views())
            .map(|view| altitudes.iter().map(|&at| metadata.parallax(view, at)).collect())
            .collect();
        let largest = |axis: usize| {
            let all = parallaxes.iter().flatten().map(|parallax| parallax[axis].abs());
            all.fold(0.0, f64::max)
        };
        let margin = [largest(0), largest(1)];
        let of_band = parallaxes.iter().enumerate();
        let images = of_band.cycle().take(metadata.images());
        let views = images.map(|(view, parallaxes)| {
            let zenith = geometry.view_zenith_deg[view].to_radians();
            let azimuth = geometry.view_azimuth_deg[view].to_radians();
            let distance = geometry.camera_distance_km[view];
            let offset = |[row, col]: [f64; 2]| [margin[0] + row, margin[1] + col];
            View {
                camera: Camera::new(towards(zenith, azimuth), geometry.pixel_km[view], distance),
                offsets: parallaxes.iter().map(|&at| offset(at).map(|n| n as usize)).collect(),
            }
        });
        let [dx, dy] = metadata.horizontal_spacing_km;
        Some(Self {
            views: views.collect(),
            spacing: [dy, dx],
            scale: metadata.input_scale as f32,
            extremes: planes.extremes.then_some(altitudes.len()),
            margin: margin.map(|voxels| voxels as usize),
        })
    }

    /// Rows and columns of the ground of a field of `[rows, cols]`.
    fn ground_size(&self, size: [usize; 2]) -> [usize; 2] {
        [0, 1].map(|axis| size[axis] + 2 * self.margin[axis])
    }

    /// Number of floats of the ground for fields of the size `[image, row, col]`.
    ///
    /// # Errors
    /// A size that exceeds the addressable memory.
    pub(super) fn ground_len(&self, [count, rows, cols]: [usize; 3]) -> Result<usize> {
        let [long, wide] = self.ground_size([rows, cols]);
        let product = [count, self.views.len(), long]
            .iter()
            .try_fold(wide, |product: usize, n| product.checked_mul(*n));
        product.filter(|len| *len <= isize::MAX as usize / 64).ok_or_else(|| {
            let size = format!("[{count}, {rows}, {cols}]");
            Error::out_of_range("size [image, row, col]", size, "at least 1 each, and countable")
        })
    }

    /// Resamples `images`, `[image, view, row, col]`, onto the plane of the target. The result has the
    /// axes `[image, view, row, col]`, covers the field and the margins and is multiplied by the scale.
    pub(super) fn resample(
        &self,
        images: &[f32],
        frame: Frame<'_>,
        field: Field,
        ground: &mut [f32],
    ) {
        let [rows, cols] = frame.size;
        let [long, wide] = self.ground_size(field.size);
        let fewest = PIXELS_PER_TASK.div_ceil(wide);
        ground.par_chunks_exact_mut(wide).enumerate().with_min_len(fewest).for_each(
            |(index, line)| {
                let (image, row) = (index / long, index % long);
                let number = image % self.views.len();
                let view = &self.views[number];
                // In most views, the parallax of all planes is smaller than the margin.
                if view.sees(row, field.size[0]) {
                    let image = Raster { values: &images[image * rows * cols..], rows, cols };
                    self.lay_row(&view.camera, image, frame.target(number), field, row, line);
                }
            },
        );
    }

    fn lay_row(
        &self,
        camera: &Camera,
        image: Raster<'_>,
        [target_row, target_col]: [f64; 2],
        field: Field,
        row: usize,
        line: &mut [f32],
    ) {
        // The position of the voxel of number `at` of the ground along an axis (km).
        let place = |axis: usize, at: usize| {
            let voxels = at as f64 + 0.5 - self.margin[axis] as f64 - 0.5 * field.size[axis] as f64;
            field.center[axis] + self.spacing[axis] * voxels
        };
        let y = place(0, row);
        for (col, pixel) in line.iter_mut().enumerate() {
            let [row, col] = camera.project(place(1, col), y);
            *pixel = self.scale * image.at(row + target_row - 0.5, col + target_col - 0.5);
        }
    }

    /// Whether any view shows any column of a field on the plane of the target.
    pub(super) fn shows(&self, field: Field, frame: Frame<'_>) -> bool {
        let place = |axis: usize, at: usize| {
            let voxels = at as f64 + 0.5 - 0.5 * field.size[axis] as f64;
            field.center[axis] + self.spacing[axis] * voxels
        };
        let is_inside = |(number, view): (usize, &View), row: usize, col: usize| {
            let pixel = view.camera.project(place(1, col), place(0, row));
            let target = frame.target(number);
            [0, 1].iter().all(|&axis| {
                (0.0..=frame.size[axis] as f64).contains(&(pixel[axis] + target[axis]))
            })
        };
        let mut columns = (0..field.size[0]).flat_map(|j| (0..field.size[1]).map(move |i| (j, i)));
        columns
            .any(|(row, col)| self.views.iter().enumerate().any(|view| is_inside(view, row, col)))
    }

    /// The images on the plane of the target, `[view, row, col]`, from those with a margin. Rows that
    /// no plane reads are 0.
    pub(super) fn without_margin(&self, ground: &[f32], size: [usize; 2]) -> Vec<f32> {
        let ([long, wide], [first, col]) = (self.ground_size(size), self.margin);
        let images = ground.chunks_exact(long * wide);
        let rows = images.flat_map(|image| image.chunks_exact(wide).skip(first).take(size[0]));
        rows.flat_map(|row| &row[col..][..size[1]]).copied().collect()
    }

    /// The input of the first layer from the images on the ground.
    pub(super) fn source<'a>(&'a self, ground: &'a [f32], size: [usize; 2]) -> PlaneSource<'a> {
        PlaneSource { resampler: self, ground, size: self.ground_size(size) }
    }
}

impl View {
    /// Whether any plane reads this row of the ground of an image with `rows` rows.
    fn sees(&self, row: usize, rows: usize) -> bool {
        self.offsets.iter().any(|&[first, _]| (first..first + rows).contains(&row))
    }
}

/// An image, `[row, col]`.
#[derive(Debug, Clone, Copy)]
struct Raster<'a> {
    values: &'a [f32],
    rows: usize,
    cols: usize,
}

impl Raster<'_> {
    /// Bilinear interpolation between pixel centres, which are at integer positions; beyond the
    /// outermost centres, the edge values continue.
    #[inline]
    fn at(&self, row: f64, col: f64) -> f32 {
        let (row, down) = split(row, self.rows);
        let (col, right) = split(col, self.cols);
        let below = (row + 1).min(self.rows - 1);
        let beside = (col + 1).min(self.cols - 1);
        let line = |row: usize| {
            let line = &self.values[row * self.cols..][..self.cols];
            line[col] + right * (line[beside] - line[col])
        };
        let upper = line(row);
        upper + down * (line(below) - upper)
    }
}

/// The index of the pixel at or before a position among `lines` pixels, and the distance of the
/// position from it.
#[inline]
fn split(position: f64, lines: usize) -> (usize, f32) {
    let position = position.clamp(0.0, (lines - 1) as f64);
    let whole = position as usize;
    (whole, (position - whole as f64) as f32)
}

/// The images on all planes, read from the ground.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlaneSource<'a> {
    resampler: &'a PlaneResampler,
    ground: &'a [f32],
    size: [usize; 2],
}

impl Source for PlaneSource<'_> {
    fn read(&self, wanted: &SourceRow, pixels: &mut [f32]) {
        let [long, wide] = self.size;
        let views = &self.resampler.views;
        let grounds = self.ground.chunks_exact(long * wide).skip(wanted.image * views.len());
        for (number, (view, ground)) in views.iter().zip(grounds).enumerate() {
            for (plane, [row, col]) in view.offsets.iter().enumerate() {
                let line = &ground[(wanted.row + row) * wide + col..][wanted.columns.clone()];
                let first = plane * views.len() + number;
                let pixels = pixels[first..].iter_mut().step_by(wanted.pitch);
                pixels.zip(line).for_each(|(pixel, value)| *pixel = *value);
            }
        }
        if let Some(planes) = self.resampler.extremes {
            let (images, columns) = (planes * views.len(), wanted.columns.len());
            for pixel in pixels.chunks_mut(wanted.pitch).take(columns) {
                let (images, extremes) = pixel.split_at_mut(images);
                for (plane, values) in images.chunks_exact(views.len()).enumerate() {
                    extremes[plane] = values.iter().copied().fold(f32::INFINITY, f32::min);
                    extremes[planes + plane] =
                        values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Network, Planes, fixture};
    use super::*;
    use crate::scene::{Formation, Sun, view_geometry};

    const SIZE: [usize; 2] = [20, 24];
    const ALTITUDES_KM: [f64; 3] = [0.7, 1.0, 1.43];

    /// Cameras along a track and on all sides of it, and one with parallel rays.
    fn views() -> Vec<crate::scene::View> {
        let target = DVec3::new(0.0, 0.0, 1.0);
        let mut views = Formation::cloudct_10().views(target, SIZE).unwrap();
        for azimuth in [0.7, 2.0, 4.4] {
            let position = target + 700.0 * towards(0.9, azimuth);
            views.push(crate::scene::View::perspective(position, target, 8e-5, SIZE).unwrap());
        }
        let parallel = towards(0.6, 1.0);
        views.push(crate::scene::View::orthographic(parallel, target, 0.06, SIZE).unwrap());
        views
    }

    /// Metadata of weights for these views.
    fn metadata() -> WeightsMetadata {
        let views = views();
        let channels = [views.len() * ALTITUDES_KM.len(), 5, 4];
        let mut metadata = fixture::metadata(&channels[..]);
        metadata.view_geometry = view_geometry(&Sun::default(), &views);
        metadata.image_layout =
            ImageLayout::Planes(Planes { altitudes_km: ALTITUDES_KM.into(), extremes: false });
        metadata.horizontal_spacing_km = [0.04, 0.05];
        metadata.check().unwrap();
        metadata
    }

    /// The channels of the first layer, `[channel, row, col]`.
    fn lifted(metadata: &WeightsMetadata, images: &[f32], size: [usize; 2]) -> Vec<f32> {
        let resampler = PlaneResampler::new(metadata).unwrap();
        let mut ground = vec![f32::NAN; resampler.ground_len([1, size[0], size[1]]).unwrap()];
        let frame = Frame { size, shifts: &[] };
        resampler.resample(images, frame, Field { size, center: [0.0, 0.0] }, &mut ground);
        let source = resampler.source(&ground, size);
        let channels = metadata.input_channels();
        let mut values = vec![f32::NAN; channels * size[0] * size[1]];
        for row in 0..size[0] {
            let mut pixels = vec![0.0; channels * size[1]];
            let wanted = SourceRow { image: 0, row, columns: 0..size[1], pitch: channels };
            source.read(&wanted, &mut pixels);
            for (at, value) in pixels.iter().enumerate() {
                let (col, channel) = (at / channels, at % channels);
                values[(channel * size[0] + row) * size[1] + col] = *value;
            }
        }
        values
    }

    /// With images whose pixels hold their own row or column, each voxel reads the position at
    /// which the cameras of a scene observe it, to within half a voxel of parallax.
    #[test]
    fn a_voxel_reads_the_pixel_that_shows_it() {
        let (metadata, views) = (metadata(), views());
        let [rows, cols] = SIZE;
        let image = |axis: usize| {
            let pixel = move |at: usize| [at / cols % rows, at % cols][axis] as f32 + 0.5;
            (0..views.len() * rows * cols).map(pixel).collect::<Vec<f32>>()
        };
        let seen = [0, 1].map(|axis| lifted(&metadata, &image(axis), SIZE));
        let [dx, dy] = metadata.horizontal_spacing_km;
        let mut inside = 0;
        for (channel, pixels) in seen[0].chunks_exact(rows * cols).enumerate() {
            let (plane, view) = (channel / views.len(), &views[channel % views.len()]);
            for at in 0..pixels.len() {
                let x = dx * ((at % cols) as f64 + 0.5 - 0.5 * cols as f64);
                let y = dy * ((at / cols) as f64 + 0.5 - 0.5 * rows as f64);
                let project = |x, y| view.project(DVec3::new(x, y, ALTITUDES_KM[plane])).unwrap();
                let (row, col) = project(x, y);
                let within = |at: f64, lines: usize| (1.0..lines as f64 - 1.0).contains(&at);
                if !(within(row, rows) && within(col, cols)) {
                    continue;
                }
                inside += 1;
                let corners = [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)];
                let corners = corners.map(|(a, b)| project(x + a * dx, y + b * dy));
                let farthest = |part: fn((f64, f64)) -> f64| {
                    let middle = part((row, col));
                    corners.iter().map(|at| (part(*at) - middle).abs()).fold(0.002, f64::max)
                };
                let found = [0, 1].map(|axis| {
                    f64::from(seen[axis][channel * rows * cols + at]) / metadata.input_scale
                });
                let off = [found[0] - row, found[1] - col];
                let limits = [farthest(|at| at.0), farthest(|at| at.1)];
                assert!(off[0].abs() <= limits[0] + 0.002, "{channel} {at}: {off:?} {limits:?}");
                assert!(off[1].abs() <= limits[1] + 0.002, "{channel} {at}: {off:?} {limits:?}");
                if plane == 1 {
                    assert!(off[0].abs() < 1e-4 && off[1].abs() < 1e-4, "{channel} {at}: {off:?}");
                }
            }
        }
        assert!(2 * inside > seen[0].len(), "{inside}");
    }

    #[test]
    fn an_image_goes_on_beyond_its_edge() {
        let metadata = metadata();
        let images: Vec<f32> = (0..metadata.views())
            .flat_map(|view| std::iter::repeat_n(view as f32, SIZE[0] * SIZE[1]))
            .collect();
        let channels = lifted(&metadata, &images, SIZE);
        for (channel, pixels) in channels.chunks_exact(SIZE[0] * SIZE[1]).enumerate() {
            let expected = (channel % metadata.views()) as f32 * metadata.input_scale as f32;
            assert!(pixels.iter().all(|pixel| *pixel == expected), "channel {channel}");
        }
    }

    /// The result is bitwise identical for any number of threads, and for one cloud and several.
    #[test]
    fn threads_and_batches_change_no_bit() {
        let metadata = metadata();
        let weights = super::super::weights(&metadata.architecture.channels, 3);
        let weights = super::super::Weights::new(metadata, weights.layers).unwrap();
        let network = Network::new(&weights).unwrap();
        let size = [33, 70];
        let count = network.views() * size[0] * size[1];
        let images: Vec<f32> = (0..2 * count).map(|at| (at * 7919 % 127) as f32 / 128.0).collect();
        let run = |images: &[f32]| {
            let clouds = images.len() / count;
            let mut scratch = network.scratch([clouds, size[0], size[1]]).unwrap();
            let mut output = vec![f32::NAN; clouds * network.output_channels() * size[0] * size[1]];
            network.run(images, &mut output, &mut scratch).unwrap();
            output
        };
        let expected = run(&images);
        assert!(expected.iter().any(|value| *value > 0.0));
        for threads in [1, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert!(pool.install(|| run(&images)) == expected);
            let halves = images.chunks(count).flat_map(|image| pool.install(|| run(image)));
            assert!(halves.collect::<Vec<_>>() == expected);
        }
        let mut scratch = network.scratch([1, 4, 4]).unwrap();
        let error = network.run(&images, &mut [0.0; 64], &mut scratch).unwrap_err().to_string();
        assert!(error.contains("number of values of the input"), "{error}");
    }
}
