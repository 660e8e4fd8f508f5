//! Space carving: which voxels the images allow to hold cloud.
//!
//! A pixel is cloudy when its radiance exceeds a threshold. A view votes for a voxel
//! when one of its cloudy pixels sees some part of the voxel, and against it when it
//! sees the whole voxel and none of those pixels is cloudy. A view that sees only a
//! part of a voxel, and no cloud there, has no vote: the rest is outside its frame.

use crate::error::{Error, Result};
use crate::grid::{Grid, Mask};
use crate::image::ViewStack;
use crate::math::DVec3;
use crate::scene::{Observation, View};
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut2, Axis};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a cloud is carved out of its images.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarveSettings {
    /// A pixel is cloudy above this radiance (1/sr); `None` takes the
    /// [`cloud_threshold`] of the images.
    pub threshold: Option<f32>,
    /// A voxel is kept when at least this share of the views that have a vote on it
    /// vote for it, in `[0, 1]`.
    pub agreement: f64,
}

impl Default for CarveSettings {
    fn default() -> Self {
        Self { threshold: None, agreement: 0.9 }
    }
}

/// A carved mask and what it was made with.
#[derive(Debug, Clone, PartialEq)]
pub struct Carved {
    /// The voxels that are kept. One that no view has a vote on is kept: nothing
    /// speaks against it.
    pub mask: Mask,
    /// The threshold that was used (1/sr).
    pub threshold: f32,
}

/// Carve `grid` by the images of `observation`.
///
/// # Errors
/// A threshold that is not finite, an agreement outside `[0, 1]`, images in which no
/// threshold can be found.
pub fn carve(observation: &Observation, grid: &Grid, settings: &CarveSettings) -> Result<Carved> {
    if !(0.0..=1.0).contains(&settings.agreement) {
        return Err(Error::out_of_range("agreement", settings.agreement, "between 0 and 1"));
    }
    let threshold = match settings.threshold {
        Some(threshold) if !threshold.is_finite() => {
            return Err(Error::out_of_range("threshold", threshold, "finite (1/sr)"));
        }
        Some(threshold) => threshold,
        None => cloud_threshold(&observation.images)?,
    };
    let cloudy: Vec<Array2<bool>> = (0..observation.views.len())
        .map(|view| observation.images.image(view).mapv(|radiance| radiance > threshold))
        .collect();
    let mut values = Array3::from_elem(grid.shape, false);
    values.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(k, level)| {
        carve_level(grid, k, &observation.views, &cloudy, settings.agreement, level);
    });
    Ok(Carved { mask: Mask::new(*grid, values)?, threshold })
}

/// Votes of the views on one voxel.
#[derive(Debug, Clone, Copy, Default)]
struct Votes {
    yes: u32,
    no: u32,
}

fn carve_level(
    grid: &Grid,
    k: usize,
    views: &[View],
    cloudy: &[Array2<bool>],
    agreement: f64,
    mut level: ArrayViewMut2<'_, bool>,
) {
    let mut votes = Array2::from_elem(level.dim(), Votes::default());
    for (view, cloudy) in views.iter().zip(cloudy) {
        let corners = [corner_pixels(grid, k, view), corner_pixels(grid, k + 1, view)];
        for ((j, i), votes) in votes.indexed_iter_mut() {
            match Footprint::of_voxel(&corners, j, i).and_then(|seen| seen.vote(cloudy.view())) {
                Some(true) => votes.yes += 1,
                Some(false) => votes.no += 1,
                None => {}
            }
        }
    }
    ndarray::Zip::from(&mut level).and(&votes).for_each(|kept, votes| {
        let all = f64::from(votes.yes + votes.no);
        *kept = f64::from(votes.yes) >= agreement * all;
    });
}

/// Where the corners of the voxels at the bottom of level `k` fall in the image, as
/// continuous `(row, col)`; array `[y, x]`, one longer than the grid along each axis.
fn corner_pixels(grid: &Grid, k: usize, view: &View) -> Array2<Option<(f64, f64)>> {
    Array2::from_shape_fn((grid.shape[1] + 1, grid.shape[2] + 1), |(j, i)| {
        view.project(grid.origin + grid.spacing * DVec3::new(i as f64, j as f64, k as f64))
    })
}

/// The corners of a voxel, in the order of [`EDGES`], as they fall in an image.
struct Footprint([(f64, f64); 8]);

/// The corners at the two ends of each edge of a voxel: corner `4 k + 2 j + i`.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];

/// Overlaps thinner than this (pixels) are rounding errors.
const TOUCH: f64 = 1e-6;

impl Footprint {
    /// The footprint of voxel `[j, i]` of a level from the corners below and above
    /// it; `None` when a part is behind the camera.
    fn of_voxel(corners: &[Array2<Option<(f64, f64)>>; 2], j: usize, i: usize) -> Option<Self> {
        let mut footprint = [(0.0, 0.0); 8];
        for (number, corner) in footprint.iter_mut().enumerate() {
            *corner = corners[number >> 2][[j + (number >> 1 & 1), i + (number & 1)]]?;
        }
        Some(Self(footprint))
    }

    /// Whether a cloudy pixel overlaps the footprint; `None` when none does, but the
    /// footprint is not all inside the frame.
    fn vote(&self, cloudy: ArrayView2<'_, bool>) -> Option<bool> {
        let (rows, cols) = (self.range((1.0, 0.0)), self.range((0.0, 1.0)));
        let (row_count, col_count) = cloudy.dim();
        let mut edges = None;
        for row in pixels(rows, row_count) {
            for col in pixels(cols, col_count) {
                if cloudy[[row, col]]
                    && self.overlaps(edges.get_or_insert_with(|| self.edges()), row, col)
                {
                    return Some(true);
                }
            }
        }
        let inside =
            |(low, high): (f64, f64), count: usize| low >= -TOUCH && high <= count as f64 + TOUCH;
        (inside(rows, row_count) && inside(cols, col_count)).then_some(false)
    }

    /// The least and the greatest product of a corner with `normal`.
    fn range(&self, normal: (f64, f64)) -> (f64, f64) {
        self.0.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), corner| {
            let product = corner.0 * normal.0 + corner.1 * normal.1;
            (low.min(product), high.max(product))
        })
    }

    /// Unit normals of the projected edges of the voxel, among them all sides of the
    /// footprint, with the footprint's range along each.
    fn edges(&self) -> Vec<((f64, f64), (f64, f64))> {
        EDGES
            .iter()
            .filter_map(|&(from, to)| {
                let (from, to) = (self.0[from], self.0[to]);
                let (row, col) = (to.0 - from.0, to.1 - from.1);
                let length = row.hypot(col);
                let normal = (col / length, -row / length);
                (length > TOUCH).then(|| (normal, self.range(normal)))
            })
            .collect()
    }

    /// Whether a pixel overlaps the footprint: two convex figures do unless they lie
    /// on different sides of a line along a side of one of them (the pixel's own
    /// sides are tested by the range of pixels looked at).
    fn overlaps(&self, edges: &[((f64, f64), (f64, f64))], row: usize, col: usize) -> bool {
        edges.iter().all(|&((row_part, col_part), (low, high))| {
            let middle = (row as f64 + 0.5) * row_part + (col as f64 + 0.5) * col_part;
            let half = 0.5 * (row_part.abs() + col_part.abs());
            middle + half > low + TOUCH && middle - half < high - TOUCH
        })
    }
}

/// The pixels along one axis of an image that a range overlaps.
fn pixels((low, high): (f64, f64), count: usize) -> std::ops::Range<usize> {
    // A cast from a float saturates, so what is outside the frame comes out empty.
    let first = (low + TOUCH).floor() as usize;
    let last = (high - TOUCH).ceil() as usize;
    first..last.min(count)
}

/// The radiance (1/sr) between clear sky over a dark surface and cloud, from the
/// histogram of all views: the split of the logarithm of radiance into two classes
/// that leaves the least variance within them (Otsu 1979, "A threshold selection
/// method from gray-level histograms").
///
/// # Errors
/// Images in which fewer than two different positive radiances occur.
pub fn cloud_threshold(images: &ViewStack) -> Result<f32> {
    const BINS: usize = 256;
    let logs: Vec<f64> = images
        .values
        .iter()
        .filter(|radiance| **radiance > 0.0)
        .map(|&radiance| f64::from(radiance).ln())
        .collect();
    let low = logs.iter().copied().fold(f64::INFINITY, f64::min);
    let high = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if low.partial_cmp(&high) != Some(std::cmp::Ordering::Less) {
        return Err(Error::out_of_range(
            "radiance",
            format!("{} everywhere", images.brightest()),
            "of at least two positive values where a threshold is to be found; give a threshold",
        ));
    }
    let width = (high - low) / BINS as f64;
    let mut histogram = [0.0_f64; BINS];
    for log in logs {
        histogram[(((log - low) / width) as usize).min(BINS - 1)] += 1.0;
    }
    Ok((low + otsu(&histogram) as f64 * width).exp() as f32)
}

/// The number of bins in the lower class of Otsu's split.
fn otsu(histogram: &[f64]) -> usize {
    let total: f64 = histogram.iter().sum();
    let moment: f64 = histogram.iter().enumerate().map(|(bin, count)| bin as f64 * count).sum();
    let (mut below, mut moment_below) = (0.0, 0.0);
    let mut best = (0.0, 1);
    for (bin, count) in histogram.iter().enumerate() {
        below += count;
        moment_below += bin as f64 * count;
        let above = total - below;
        if below > 0.0 && above > 0.0 {
            let difference = moment_below / below - (moment - moment_below) / above;
            let between = below * above * difference * difference;
            if between > best.0 {
                best = (between, bin + 1);
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Volume;
    use crate::metrics::score_mask;
    use crate::scene::{Formation, Sun};
    use crate::traverse::walk;

    fn grid() -> Grid {
        Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.05, 0.06, 0.04), [14, 13, 16]).unwrap()
    }

    fn sphere(grid: Grid, radius: f64) -> Volume {
        let mut sphere = Volume::constant(grid, 0.0);
        for ((k, j, i), value) in sphere.values.indexed_iter_mut() {
            if grid.voxel_center([k, j, i]).distance(grid.center()) < radius {
                *value = 10.0;
            }
        }
        sphere
    }

    /// Rays per pixel along each axis in the brute force.
    const RAYS: usize = 8;

    /// What each ray of a pixel passes.
    fn rays(view: &View, row: usize, col: usize) -> impl Iterator<Item = crate::math::Ray> {
        let part = |index: usize| (index as f64 + 0.5) / RAYS as f64;
        (0..RAYS * RAYS).map(move |number| {
            view.ray(row as f64 + part(number / RAYS), col as f64 + part(number % RAYS))
        })
    }

    /// Images with the longest path through the volume of any ray in a pixel.
    fn paths(volume: &Volume, views: &[View]) -> ViewStack {
        let shape = (views.len(), views[0].rows, views[0].cols);
        let longest = |(view, row, col): (usize, usize, usize)| {
            rays(&views[view], row, col)
                .map(|ray| {
                    walk(&volume.grid, &ray)
                        .map(|step| volume.values[step.voxel] * (step.exit - step.enter) as f32)
                        .sum()
                })
                .fold(0.0, f32::max)
        };
        ViewStack::new(Array3::from_shape_fn(shape, longest)).unwrap()
    }

    /// Votes by walking the rays of every pixel: a voxel touched by a cloudy pixel's
    /// ray has a yes; one touched, but only by clear pixels, a no.
    fn brute_force(observation: &Observation, grid: &Grid, agreement: f64) -> Array3<bool> {
        let mut yes = Array3::<u32>::zeros(grid.shape);
        let mut seen = Array3::<u32>::zeros(grid.shape);
        for (number, view) in observation.views.iter().enumerate() {
            let mut touched = Array3::from_elem(grid.shape, 0_u8);
            for ((row, col), &radiance) in observation.images.image(number).indexed_iter() {
                let mark = 1 + u8::from(radiance > 0.0);
                for ray in rays(view, row, col) {
                    walk(grid, &ray)
                        .for_each(|step| touched[step.voxel] = touched[step.voxel].max(mark));
                }
            }
            yes.zip_mut_with(&touched, |yes, &mark| *yes += u32::from(mark == 2));
            seen.zip_mut_with(&touched, |seen, &mark| *seen += u32::from(mark > 0));
        }
        ndarray::Zip::from(&yes)
            .and(&seen)
            .map_collect(|&yes, &seen| f64::from(yes) >= agreement * f64::from(seen))
    }

    fn observe(volume: &Volume, views: Vec<View>) -> Observation {
        let images = paths(volume, &views);
        Observation::new(Sun::default(), views, images).unwrap()
    }

    fn settings(threshold: f32, agreement: f64) -> CarveSettings {
        CarveSettings { threshold: Some(threshold), agreement }
    }

    /// The rays are a sample of what a pixel sees: a voxel that they find must be
    /// kept, and one that they miss may be kept when a pixel sees a sliver of it.
    #[test]
    fn what_the_rays_of_cloudy_pixels_touch_is_kept() {
        let grid = grid();
        let volume = sphere(grid, 0.2);
        for formation in [Formation::cloudct_10(), Formation::pearls_32()] {
            let views = formation.views(grid.center(), [26, 26]).unwrap();
            let observation = observe(&volume, views);
            let expected = brute_force(&observation, &grid, 1.0);
            let carved = carve(&observation, &grid, &settings(0.0, 1.0)).unwrap().mask;
            assert!(carved.values.iter().zip(&expected).all(|(kept, touched)| *kept || !touched));
            let scores = score_mask(&volume, &carved).unwrap();
            assert_eq!(scores.extinction_missed, 0.0);
            assert!(scores.false_positive < 0.25, "{scores:?}");
        }
    }

    /// Twice the signed area spanned by three points.
    fn turn(a: (f64, f64), b: (f64, f64), c: (f64, f64)) -> f64 {
        (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)
    }

    /// The convex hull of points (Andrew 1979), counter-clockwise.
    fn hull(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let half = |points: &mut dyn Iterator<Item = (f64, f64)>| {
            let mut chain: Vec<(f64, f64)> = Vec::new();
            for point in points {
                while let [.., a, b] = chain[..]
                    && turn(a, b, point) <= 0.0
                {
                    chain.pop();
                }
                chain.push(point);
            }
            chain.pop();
            chain
        };
        let mut chain = half(&mut points.iter().copied());
        chain.extend(half(&mut points.iter().rev().copied()));
        chain
    }

    /// The area that a convex polygon shares with a pixel, by cutting the polygon off
    /// at each side of the pixel (Sutherland and Hodgman 1974).
    fn shared_area(mut polygon: Vec<(f64, f64)>, row: f64, col: f64) -> f64 {
        let corners = [(row, col), (row + 1.0, col), (row + 1.0, col + 1.0), (row, col + 1.0)];
        for side in 0..4 {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let mut cut = Vec::new();
            for (index, &point) in polygon.iter().enumerate() {
                let before = polygon[(index + polygon.len() - 1) % polygon.len()];
                let (a, b) = (turn(from, to, before), turn(from, to, point));
                if (a < 0.0) != (b < 0.0) {
                    let share = a / (a - b);
                    let between = |a: f64, b: f64| a + share * (b - a);
                    cut.push((between(before.0, point.0), between(before.1, point.1)));
                }
                if b >= 0.0 {
                    cut.push(point);
                }
            }
            polygon = cut;
        }
        let origin = (row, col);
        polygon
            .iter()
            .zip(polygon.iter().cycle().skip(1))
            .map(|(&a, &b)| turn(origin, a, b))
            .sum::<f64>()
            / 2.0
    }

    #[test]
    fn the_pixels_of_a_voxel_are_those_that_share_area_with_it() {
        let grid = grid();
        for view in Formation::pearls_32().views(grid.center(), [26, 26]).unwrap() {
            for k in [0, 9] {
                let corners = [corner_pixels(&grid, k, &view), corner_pixels(&grid, k + 1, &view)];
                for (j, i) in [(0, 0), (4, 11), (8, 3), (12, 15)] {
                    let footprint = Footprint::of_voxel(&corners, j, i).unwrap();
                    let polygon = hull(footprint.0.to_vec());
                    for (row, col) in (0..26).flat_map(|row| (0..26).map(move |col| (row, col))) {
                        let mut cloudy = Array2::from_elem((26, 26), false);
                        cloudy[[row, col]] = true;
                        let shared = shared_area(polygon.clone(), row as f64, col as f64);
                        let vote = footprint.vote(cloudy.view()) == Some(true);
                        assert_eq!(
                            vote,
                            shared > 1e-12,
                            "{view:?} {k} {j} {i} {row} {col} {shared}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_view_speaks_only_of_what_it_sees() {
        let grid = grid();
        let volume = Volume::constant(grid, 0.0);
        // Four pixels of 50 m over the middle: x from 0.3 to 0.5, y from 0.29 to 0.49.
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let carved = carve(&observe(&volume, vec![view]), &grid, &settings(0.0, 1.0)).unwrap().mask;
        for ((_, j, i), &kept) in carved.values.indexed_iter() {
            // Rows of voxels are 60 m wide: those from 0.30 to 0.48 are seen whole.
            let seen = (6..10).contains(&i) && (5..8).contains(&j);
            assert_eq!(kept, !seen, "y {j}, x {i}");
        }
    }

    #[test]
    fn a_vote_share_equal_to_the_agreement_is_enough() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 4, 4]).unwrap();
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let mut images = Array3::zeros((10, 4, 4));
        images.slice_mut(ndarray::s![..7, 1, 2]).fill(1.0);
        images.slice_mut(ndarray::s![..6, 3, 0]).fill(1.0);
        let images = ViewStack::new(images).unwrap();
        let observation = Observation::new(Sun::default(), vec![view; 10], images).unwrap();
        let carved = carve(&observation, &grid, &settings(0.5, 0.7)).unwrap().mask;
        assert_eq!(carved.count(), 1);
        assert!(carved.values[[0, 1, 2]]);
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let grid = grid();
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let dark = observe(&Volume::constant(grid, 0.0), vec![view]);
        assert!(carve(&dark, &grid, &settings(0.0, 1.1)).is_err());
        assert!(carve(&dark, &grid, &settings(f32::NAN, 0.9)).is_err());
        assert!(carve(&dark, &grid, &CarveSettings::default()).is_err());
    }
}
