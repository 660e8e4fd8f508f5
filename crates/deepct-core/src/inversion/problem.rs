//! The problem that an inversion solves, and its start.

use crate::error::Result;
use crate::grid::{Mask, Volume};
use crate::image::Image;
use crate::math::DVec3;
use crate::network::Estimate;
use crate::scene::{Boundary, Observation, Projector};
use crate::traverse::walk;
use ndarray::{Array3, Zip};

/// The problem: the cloud that one or more observations show, inside a mask.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// The images and their geometry, for each band. The extinction is retrieved in the first one.
    pub bands: &'a [Observation],
    /// The voxels that may contain cloud, and the grid of the solution. The extinction of those that
    /// no image shows is 0 in the solution, see [`shown`].
    pub mask: &'a Mask,
    /// The truth on the same grid, if the history is to contain the error of each iteration.
    pub truth: Option<&'a Volume>,
}

/// A voxel that an image shows by less than this (pixels) only touches it.
const TOUCH: f64 = 1e-6;

/// The voxels of a mask of which at least one image of any band shows a part: their centre, a corner, or
/// what the middle of a pixel shows. In all others the images contain no information, and the
/// extinction is not retrieved. Between periodic sides, lines of sight go on in the next copy, and no voxel is left out.
///
/// # Errors
/// None for the mask of a valid grid.
pub fn shown(mask: &Mask, bands: &[Observation]) -> Result<Mask> {
    let grid = mask.grid;
    if bands.iter().any(|band| band.light.boundary == Boundary::Periodic) {
        return Ok(mask.clone());
    }
    let views = || {
        bands.iter().flat_map(|band| {
            band.views.iter().enumerate().map(|(number, view)| (view, band.images.image(number)))
        })
    };
    let mut crossed = Array3::from_elem(grid.shape, false);
    for (view, image) in views() {
        let known = image.indexed_iter().filter(|(_, radiance)| !radiance.is_nan());
        for ((row, col), _) in known {
            let ray = view.ray(row as f64 + 0.5, col as f64 + 0.5);
            walk(&grid, &ray).for_each(|step| crossed[step.voxel] = true);
        }
    }
    let images: Vec<(Projector, Image<'_>)> =
        views().map(|(view, image)| (view.projector(), image)).collect();
    let shows = |point: DVec3| {
        images.iter().any(|(projector, image)| {
            projector.project(point).is_some_and(|(row, col)| {
                let inside = |at: f64, size: usize| at > TOUCH && at < size as f64 - TOUCH;
                inside(row, image.nrows())
                    && inside(col, image.ncols())
                    && !image[[row as usize, col as usize]].is_nan()
            })
        })
    };
    let mut values = mask.values.clone();
    Zip::indexed(&mut values).par_for_each(|(k, j, i), inside| {
        let corner = |n: usize| {
            let place =
                DVec3::new((i + (n & 1)) as f64, (j + (n >> 1 & 1)) as f64, (k + (n >> 2)) as f64);
            grid.origin + grid.spacing * place
        };
        *inside = *inside
            && (crossed[[k, j, i]]
                || shows(grid.voxel_center([k, j, i]))
                || (0..8).any(|number| shows(corner(number))));
    });
    Mask::new(grid, values)
}

/// The start of an inversion.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Start {
    /// A uniform extinction (1/km) in the mask.
    Constant(f64),
    /// A uniform extinction in the mask, with the value that fits the images best.
    Search,
    /// An extinction on the grid of the mask, from a file or a network. Its uncertainty, if given,
    /// is part of the prior; the unknowns of the effective radius begin at its effective radius, if
    /// that is given.
    Estimate(Box<Estimate>),
}

impl From<Estimate> for Start {
    fn from(estimate: Estimate) -> Self {
        Self::Estimate(Box::new(estimate))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::image::ViewStack;
    use crate::scene::{Sun, View};

    #[test]
    fn voxels_beside_every_image_are_not_shown() {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(0.05), [2, 4, 6]).unwrap();
        let mut mask = Mask::new(grid, Array3::from_elem(grid.shape, true)).unwrap();
        mask.values[[0, 0, 5]] = false;
        let target = DVec3::new(0.25, 0.1, 0.05);
        // The image shows x from 0.2 to 0.3, and the side of the voxels between 0.15 and 0.2.
        let view = View::orthographic(DVec3::Z, target, 0.05, [4, 2]).unwrap();
        let observe = |views: Vec<View>| {
            let (rows, cols) = (views[0].rows, views[0].cols);
            let images = ViewStack::new(Array3::zeros((views.len(), rows, cols))).unwrap();
            Observation::new(Sun::default(), views, images).unwrap()
        };
        let mut missing = observe(vec![view.clone()]);
        missing.images.values.fill(f32::NAN);
        let shown = |observation: &Observation| {
            super::shown(&mask, std::slice::from_ref(observation)).unwrap()
        };
        assert_eq!(shown(&missing).count(), 0);
        let found = shown(&observe(vec![view.clone()]));
        for ((k, j, i), &inside) in found.values.indexed_iter() {
            assert_eq!(inside, i >= 4 && (k, j, i) != (0, 0, 5), "{k} {j} {i}");
        }
        // A slanted view also shows the upper voxels beside them.
        let west = crate::math::towards(45_f64.to_radians(), 270_f64.to_radians());
        let slanted = View::orthographic(west, target, 0.05, [4, 2]).unwrap();
        let mut both = observe(vec![view.clone(), slanted]);
        assert!(shown(&both).values[[1, 2, 3]]);
        // So does another band with this view.
        let bands = [observe(vec![view.clone()]), both.clone()];
        assert_eq!(super::shown(&mask, &bands).unwrap(), shown(&both));
        both.light.boundary = Boundary::Periodic;
        assert_eq!(shown(&both), mask);
        // An image that is smaller than a quarter of a voxel.
        let inside = DVec3::new(0.2625, 0.1125, 0.05);
        let small = View::orthographic(DVec3::Z, inside, 0.001, [4, 4]).unwrap();
        assert_eq!(shown(&observe(vec![small])).count(), 2);
    }
}
