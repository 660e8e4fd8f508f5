//! Space carving: the voxels that can contain cloud according to the images.
//!
//! A pixel is cloudy if its radiance exceeds a threshold, or, above a bright surface, if it is darker than
//! the surface, as shaded sides of clouds are (and shadows, which are then in the mask). A view votes for a voxel if at least one
//! cloudy pixel overlaps the projection of the voxel, and against it if the whole projection is
//! inside the image and no cloudy pixel overlaps it. A view abstains if its image contains only a
//! part of the projection and no cloud there, because the rest of the voxel is outside the frame or in
//! pixels that are missing.

mod footprint;
mod threshold;

pub use threshold::{CloudThreshold, cloud_threshold};

use crate::error::{Error, Result};
use crate::grid::{Grid, Mask};
use crate::scene::{Observation, Projector, View};
use footprint::{CloudyPixels, CornerPixels, Footprint};
use ndarray::{Array2, Array3, ArrayViewMut3, Axis, s};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of space carving.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarveSettings {
    /// Radiance above which a pixel is cloudy (1/sr); `None` uses the [`cloud_threshold`] of each
    /// view.
    pub threshold: Option<f32>,
    /// Smallest share of votes for a voxel, among the views that do not abstain, with which the
    /// voxel is kept, in `[0, 1]`.
    pub agreement: f64,
}

impl Default for CarveSettings {
    /// Automatic thresholds and an agreement of 0.9. On eight single BOMEX clouds with the noise of a
    /// CMV4000 (`benches/carving.py`), this loses 0.8 % of the extinction with ten views and 0.4 % with
    /// 32 views, and it keeps 7 % and 6 % of the voxels, respectively. An agreement of 0.8 loses 0.4 %
    /// and 0.2 % and keeps 9 % and 7 %; an agreement of 1 loses 0.9 % and 1.4 % and keeps 6 % and 4 %.
    fn default() -> Self {
        Self { threshold: None, agreement: 0.9 }
    }
}

impl CarveSettings {
    /// Returns an error unless the settings are valid.
    ///
    /// # Errors
    /// A threshold that is not finite, an agreement outside `[0, 1]`.
    pub fn check(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.agreement) {
            return Err(Error::out_of_range("agreement", self.agreement, "between 0 and 1"));
        }
        match self.threshold {
            Some(threshold) if !threshold.is_finite() => {
                Err(Error::out_of_range("threshold", threshold, "finite (1/sr)"))
            }
            _ => Ok(()),
        }
    }
}

/// A carved mask and the thresholds it was made with.
#[derive(Debug, Clone, PartialEq)]
pub struct Carved {
    /// The voxels that are kept, including those on which all views abstain.
    pub mask: Mask,
    /// The threshold of each view that was used (1/sr).
    pub thresholds: Vec<f32>,
    /// Whether the clear sky is as bright as the clouds, so that the images do not tell where clouds
    /// are: all voxels are kept.
    pub is_bright_ground: bool,
    /// As [`CloudThreshold::contrast`].
    pub contrast: Option<f64>,
    /// Share of the light above the thresholds whose pixels show no voxel of the mask.
    pub beside: f64,
}

/// Share of the light beside the mask from which on the mask is not that of the clouds in the images.
const MOSTLY_BESIDE: f64 = 2.0 / 3.0;

/// Ratio of the brightest pixels to a bright surface below which a mask may lose a part of the clouds:
/// up to a fifth for a cloud of little extinction above an albedo of 0.7.
const FAINT: f64 = 2.0;

impl Carved {
    /// A warning for the user, if the mask is not what was wanted.
    pub fn warning(&self) -> Option<String> {
        if self.is_bright_ground {
            let text = "the clear surface is as bright as the clouds: no voxel was carved away; give a \
                        threshold or a mask";
            return Some(text.into());
        }
        if self.contrast.is_some_and(|contrast| contrast < FAINT) {
            let text = "the clear surface is nearly as bright as the clouds: a part of them may be outside \
                        the mask; give a threshold or a mask";
            return Some(text.into());
        }
        (self.beside > MOSTLY_BESIDE).then(|| {
            format!(
                "{:.0} % of the light of the clouds comes from beside the mask: their lines of sight do not \
                 meet in the grid; images that were registered on the ground need targets at z = 0, and \
                 clouds elsewhere a larger grid",
                100.0 * self.beside
            )
        })
    }
}

/// Carves `grid` using the images of `observation`.
///
/// # Errors
/// As [`CarveSettings::check`].
pub fn carve(observation: &Observation, grid: &Grid, settings: &CarveSettings) -> Result<Carved> {
    settings.check()?;
    let count = observation.views.len();
    let found = match settings.threshold {
        Some(threshold) => CloudThreshold {
            by_view: vec![threshold; count],
            shaded_by_view: vec![f32::NEG_INFINITY; count],
            contrast: None,
        },
        None => cloud_threshold(observation),
    };
    let is_bright_ground = found.is_bright_ground();
    let CloudThreshold { by_view: thresholds, shaded_by_view, contrast } = found;
    if is_bright_ground {
        let mask = Mask::new(*grid, Array3::from_elem(grid.shape, true))?;
        return Ok(Carved { mask, thresholds, is_bright_ground, contrast, beside: 0.0 });
    }
    // Saturated pixels show cloud, others whose radiance is not known tell nothing.
    let known = observation.known();
    let is_cloudy = |view: usize| {
        let mut cloudy = observation
            .images
            .image(view)
            .mapv(|radiance| radiance > thresholds[view] || radiance < shaded_by_view[view]);
        let known = known.index_axis(Axis(0), view);
        cloudy.zip_mut_with(&known, |cloudy, known| *cloudy &= known);
        let mut unknown = known.mapv(|known| !known);
        if let Some(saturated) = &observation.saturated {
            let saturated = saturated.index_axis(Axis(0), view);
            cloudy.zip_mut_with(&saturated, |cloudy, saturated| *cloudy |= saturated);
            unknown.zip_mut_with(&saturated, |unknown, saturated| *unknown &= !saturated);
        }
        CloudyPixels::new(cloudy, unknown)
    };
    let cloudy: Vec<CloudyPixels> = (0..observation.views.len()).map(is_cloudy).collect();
    let looks: Vec<_> = observation.views.iter().map(View::projector).zip(cloudy).collect();
    let mut values = Array3::from_elem(grid.shape, false);
    values.axis_chunks_iter_mut(Axis(0), BLOCK).into_par_iter().enumerate().for_each(
        |(number, mut levels)| {
            let [_, rows, cols] = grid.shape;
            let mut room = Vec::new();
            for (j, i) in
                (0..rows).step_by(BLOCK).flat_map(|j| (0..cols).step_by(BLOCK).map(move |i| (j, i)))
            {
                let ends = s![.., j..(j + BLOCK).min(rows), i..(i + BLOCK).min(cols)];
                let block = levels.slice_mut(ends);
                let first = [number * BLOCK, j, i];
                carve_block(grid, first, &looks, settings.agreement, block, &mut room);
            }
        },
    );
    let mask = Mask::new(*grid, values)?;
    let excess = |view: usize| {
        let mut excess =
            observation.images.image(view).mapv(|radiance| (radiance - thresholds[view]).max(0.0));
        excess.zip_mut_with(&known.index_axis(Axis(0), view), |excess, known| {
            *excess = if *known { *excess } else { 0.0 };
        });
        excess
    };
    let beside = share_beside(&mask, &observation.views, &excess);
    Ok(Carved { mask, thresholds, is_bright_ground, contrast, beside })
}

/// The share of the light (1/sr in each pixel of a view) whose pixels show no block of voxels of the mask.
fn share_beside(
    mask: &Mask,
    views: &[View],
    light: &(impl Fn(usize) -> Array2<f32> + Sync),
) -> f64 {
    let shape = mask.grid.shape;
    let firsts = (0..shape[0]).step_by(BLOCK).flat_map(|k| {
        let rows = (0..shape[1]).step_by(BLOCK);
        rows.flat_map(move |j| (0..shape[2]).step_by(BLOCK).map(move |i| [k, j, i]))
    });
    let blocks: Vec<([usize; 3], [usize; 3])> = firsts
        .map(|first| (first, std::array::from_fn(|axis| BLOCK.min(shape[axis] - first[axis]))))
        .filter(|([k, j, i], [nz, ny, nx])| {
            mask.values.slice(s![*k..k + nz, *j..j + ny, *i..i + nx]).iter().any(|kept| *kept)
        })
        .collect();
    let sums: Vec<[f64; 2]> = (0..views.len())
        .into_par_iter()
        .map(|view| {
            let (projector, mut light) = (views[view].projector(), light(view));
            let sum = |light: &Array2<f32>| light.iter().copied().map(f64::from).sum::<f64>();
            let all = sum(&light);
            for (first, shape) in &blocks {
                let footprint = Footprint::of_block(&mask.grid, *first, *shape, &projector);
                let pixels = footprint.map(|footprint| footprint.pixels(light.dim()));
                // Outside of the frame, the ranges are empty, and may begin beyond it.
                if let Some([rows, cols]) =
                    pixels.filter(|pixels| pixels.iter().all(|range| !range.is_empty()))
                {
                    light.slice_mut(s![rows, cols]).fill(0.0);
                }
            }
            [sum(&light), all]
        })
        .collect();
    let [beside, all] = sums.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
    if all > 0.0 { beside / all } else { 0.0 }
}

/// Number of voxels along each side of a block, which is tested as a whole before its voxels are.
const BLOCK: usize = 4;

/// Whether a voxel with these numbers of votes is kept. A share of votes that equals the agreement
/// up to rounding errors is sufficient.
fn enough(yes: usize, no: usize, agreement: f64) -> bool {
    yes as f64 >= agreement * (yes + no) as f64 - 1e-9
}

/// Carves a block of voxels, of which `first` is the lowest. A view that contains the whole block
/// and no cloud in its rows and columns votes against every voxel of it; a view that contains only
/// cloud there votes for every voxel. Only the remaining views are evaluated voxel by voxel.
fn carve_block(
    grid: &Grid,
    first: [usize; 3],
    looks: &[(Projector, CloudyPixels)],
    agreement: f64,
    mut kept: ArrayViewMut3<'_, bool>,
    room: &mut Vec<CornerPixels>,
) {
    let (nz, ny, nx) = kept.dim();
    let mut open = Vec::with_capacity(looks.len());
    let (mut for_all, mut against_all) = (0, 0);
    for (projector, cloudy) in looks {
        let whole = Footprint::of_block(grid, first, [nz, ny, nx], projector);
        match whole.and_then(|whole| whole.vote_of_all(cloudy)) {
            Some(true) => for_all += 1,
            Some(false) => against_all += 1,
            None => open.push((projector, cloudy)),
        }
    }
    if !enough(for_all + open.len(), against_all, agreement) {
        return;
    }
    room.resize_with(looks.len(), CornerPixels::default);
    for ((projector, _), corners) in open.iter().zip(room.iter_mut()) {
        corners.find(grid, first, [nz + 1, ny + 1, nx + 1], projector);
    }
    for ((k, j, i), kept) in kept.indexed_iter_mut() {
        let (mut yes, mut no) = (for_all, against_all);
        for (number, ((_, cloudy), corners)) in open.iter().zip(room.iter()).enumerate() {
            match corners.footprint([k, j, i]).and_then(|seen| seen.vote(cloudy)) {
                Some(true) => yes += 1,
                Some(false) => no += 1,
                None => {}
            }
            if !enough(yes + open.len() - 1 - number, no, agreement) {
                break;
            }
        }
        *kept = enough(yes, no, agreement);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Volume;
    use crate::image::ViewStack;
    use crate::math::DVec3;
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

    /// Number of rays per pixel along each axis in the brute-force test.
    const RAYS: usize = 8;

    /// The rays of a pixel.
    fn rays(view: &View, row: usize, col: usize) -> impl Iterator<Item = crate::math::Ray> {
        let part = |index: usize| (index as f64 + 0.5) / RAYS as f64;
        (0..RAYS * RAYS).map(move |number| {
            view.ray(row as f64 + part(number / RAYS), col as f64 + part(number % RAYS))
        })
    }

    /// Images whose pixels hold the largest optical depth of the volume along any ray of the pixel.
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

    /// Votes found by tracing the rays of every pixel: a view votes for a voxel that a ray of a
    /// cloudy pixel crosses, and against a voxel that only rays of clear pixels cross.
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

    /// Carves a sphere that the views observe. The rays of the brute-force search only sample what a pixel
    /// observes: a voxel that they find must be kept, and a voxel that they miss may be kept if a pixel
    /// observes a small part of it. `false_positive` is the largest share of such voxels.
    fn check_carving(views: Vec<View>, false_positive: f64) {
        let volume = sphere(grid(), 0.2);
        let observation = observe(&volume, views);
        let expected = brute_force(&observation, &volume.grid, 1.0);
        let carved = carve(&observation, &volume.grid, &settings(0.0, 1.0)).unwrap().mask;
        assert!(carved.values.iter().zip(&expected).all(|(kept, touched)| *kept || !touched));
        let scores = score_mask(&volume, &carved).unwrap();
        assert_eq!(scores.extinction_missed, 0.0);
        assert!(scores.false_positive < false_positive, "{scores:?}");
    }

    #[test]
    fn what_the_rays_of_cloudy_pixels_touch_is_kept() {
        for formation in [Formation::cloudct_10(), Formation::pearls_32()] {
            check_carving(formation.views(grid().center(), [26, 26]).unwrap(), 0.25);
        }
    }

    /// Cameras below and beside the cloud, which look up, carve as satellites do, and say nothing of
    /// what is below them.
    #[test]
    fn cameras_that_look_up_carve() {
        let (center, low) = (grid().center(), grid().lower());
        let up = crate::math::towards(2.6, 1.0);
        let views = vec![
            View::looking_up(up, center.with_z(low.z + 0.05), 0.05, [40, 40]).unwrap(),
            View::perspective(low.with_z(0.05), center, 0.05, [40, 40]).unwrap(),
            View::perspective(low + DVec3::splat(0.02), center, 0.05, [40, 40]).unwrap(),
        ];
        check_carving(views, 0.35);
    }

    /// Pixels whose standard error is above the radiance of the clouds are neither cloud nor clear sky.
    #[test]
    fn a_pixel_that_tells_nothing_carves_nothing() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 4, 4]).unwrap();
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let mut images = Array3::zeros((1, 4, 4));
        images[[0, 2, 2]] = 0.2;
        let images = ViewStack::new(images).unwrap();
        let mut observation = Observation::new(Sun::default(), vec![view], images).unwrap();
        for (error, kept) in [(0.01, 1), (0.3, 2), (1e3, 2), (f32::INFINITY, 2)] {
            let mut errors = Array3::from_elem((1, 4, 4), 0.01);
            errors[[0, 1, 0]] = error;
            observation.standard_error = Some(ViewStack { values: errors });
            assert_eq!(carve(&observation, &grid, &settings(0.1, 1.0)).unwrap().mask.count(), kept);
        }
    }

    /// A view without the pixels of a voxel is as if it did not show it, even where most views see clear sky.
    #[test]
    fn a_missing_pixel_does_not_vote() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [1, 4, 4]).unwrap();
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let kept = |agreement: f64, values: [f32; 3]| {
            let mut images = Array3::zeros((3, 4, 4));
            images.slice_mut(s![.., 0, 0]).fill(1.0);
            values.iter().enumerate().for_each(|(view, value)| images[[view, 2, 1]] = *value);
            let images = ViewStack::with_missing(images).unwrap();
            let seen = Observation::new(Sun::default(), vec![view.clone(); 3], images).unwrap();
            carve(&seen, &grid, &settings(0.5, agreement)).unwrap().mask.values[[0, 2, 1]]
        };
        let missing = f32::NAN;
        for (agreement, values, expected) in [
            (0.5, [1.0, 0.0, missing], true),
            (0.6, [1.0, 0.0, missing], false),
            (0.6, [1.0, 0.0, 1.0], true),
            (1.0, [1.0, missing, missing], true),
            (0.1, [0.0, missing, missing], false),
            (1.0, [missing; 3], true),
        ] {
            assert_eq!(kept(agreement, values), expected, "{agreement} {values:?}");
        }
    }

    /// Images that are registered on the ground, with targets at the height of the cloud.
    #[test]
    fn light_from_beside_the_mask_is_told() {
        let grid = grid();
        let volume = sphere(grid, 0.1);
        let carved = |height: f64| {
            let below = grid.center() - DVec3::new(0.0, 0.0, height);
            let views = Formation::cloudct_10().views(below, [60, 60]).unwrap();
            let mut observation = observe(&volume, views);
            observation.views = Formation::cloudct_10().views(grid.center(), [60, 60]).unwrap();
            carve(&observation, &grid, &settings(0.0, 0.9)).unwrap()
        };
        assert_eq!((carved(0.0).beside, carved(0.0).warning()), (0.0, None));
        // A part of the mask that no image shows.
        let mut beyond = grid;
        beyond.origin.x += 50.0;
        let views = Formation::cloudct_10().views(grid.center(), [26, 26]).unwrap();
        let observation = observe(&volume, views);
        assert_eq!(carve(&observation, &beyond, &settings(0.0, 0.9)).unwrap().beside, 1.0);
        let found = carved(0.7);
        assert!(found.beside > 0.8, "{}", found.beside);
        assert!(found.warning().unwrap().contains("need targets at z = 0"));
    }

    #[test]
    fn a_view_speaks_only_of_what_it_sees() {
        let grid = grid();
        let volume = Volume::constant(grid, 0.0);
        // Four pixels of 50 m over the centre: x from 0.3 to 0.5, y from 0.29 to 0.49.
        let view = View::orthographic(DVec3::Z, grid.center(), 0.05, [4, 4]).unwrap();
        let carved = carve(&observe(&volume, vec![view]), &grid, &settings(0.0, 1.0)).unwrap().mask;
        for ((_, j, i), &kept) in carved.values.indexed_iter() {
            // Rows of voxels are 60 m wide: those from 0.30 to 0.48 are completely inside the
            // image.
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
        // Without a bright pixel there is no cloud.
        let carved = carve(&dark, &grid, &CarveSettings::default()).unwrap();
        assert!(carved.mask.count() < grid.len() && carved.thresholds == [0.0]);
    }
}
