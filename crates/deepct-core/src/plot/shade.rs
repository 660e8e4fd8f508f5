//! Volume rendering: a view from the south-west and above along parallel rays through a coloured
//! medium whose opacity is proportional to the extinction.

use super::figure::{Anchor, Colour, Figure, Frame, Picture, TICK, draw_arrow};
use super::panel::ColourScale;
use crate::grid::{Grid, Volume};
use crate::math::{DVec3, corner_weights, towards};
use glam::DVec2;
use rayon::prelude::*;

/// Zenith angle of the viewer (radians).
const ZENITH: f64 = 1.13;
/// Azimuth of the viewer, clockwise from north (radians): south-south-west.
const AZIMUTH: f64 = 3.54;
/// Optical depth of the rendered medium along the diagonal of a grid that is filled with the
/// extinction at the top of the colour scale.
const FOG_DEPTH: f64 = 100.0;
/// Number of steps of a ray along the shortest side of a voxel.
const STEPS_PER_VOXEL: f64 = 2.0;
/// Fraction of the brightness of a surface that does not depend on its orientation.
const AMBIENT: f64 = 0.6;
/// The colour of the edges of the grid.
const GREY: Colour = [150, 150, 150];

/// The position of the viewer and the projection of points to pixels.
struct Viewpoint {
    towards: DVec3,
    right: DVec3,
    up: DVec3,
    center: DVec3,
    middle: DVec2,
    pixels_per_km: f64,
}

impl Viewpoint {
    /// A viewpoint from which the whole grid fits in the frame.
    fn new(grid: &Grid, frame: Frame) -> Self {
        let towards = towards(ZENITH, AZIMUTH);
        let right = DVec3::Z.cross(towards).normalize();
        let up = towards.cross(right);
        let half = 0.5 * grid.extent();
        let reach = |axis: DVec3| 2.0 * half.dot(axis.abs());
        let pixels_per_km =
            (f64::from(frame.width) / reach(right)).min(f64::from(frame.height - 20) / reach(up));
        let middle = DVec2::new(f64::from(frame.middle()), f64::from(frame.half_way()));
        Self { towards, right, up, center: grid.center(), middle, pixels_per_km }
    }

    /// The position of a point in the figure (pixels).
    fn pixel(&self, point: DVec3) -> DVec2 {
        let offset = self.pixels_per_km * (point - self.center);
        self.middle + DVec2::new(offset.dot(self.right), -offset.dot(self.up))
    }

    /// The point of a pixel in the plane through the centre of the grid normal to the rays.
    fn point(&self, x: i32, y: i32) -> DVec3 {
        let right = (f64::from(x) + 0.5 - self.middle.x) / self.pixels_per_km;
        let up = (self.middle.y - f64::from(y) - 0.5) / self.pixels_per_km;
        self.center + right * self.right + up * self.up
    }
}

/// Draw the rendering into `frame`: first the far edges of the grid, then the medium.
pub(super) fn draw_solid(figure: &mut Figure, frame: Frame, volume: &Volume, scale: ColourScale) {
    let viewpoint = Viewpoint::new(&volume.grid, frame);
    draw_far_edges(figure, &volume.grid, &viewpoint);
    let north = viewpoint.pixel(volume.grid.center() + DVec3::Y) - viewpoint.middle;
    let corner = DVec2::new(f64::from(frame.right()) - 20.0, f64::from(frame.bottom()) - 20.0);
    draw_arrow(figure, corner, north, "N");
    let lines: Vec<Vec<Seen>> = (frame.top..frame.bottom())
        .into_par_iter()
        .map(|y| {
            let shown = |x| march(volume, viewpoint.point(x, y), &viewpoint, scale);
            (frame.left..frame.right()).map(shown).collect()
        })
        .collect();
    let cells = lines.into_iter().flatten().map(Seen::cell).collect();
    let [rows, cols] = [frame.height, frame.width].map(|side| side as usize);
    figure.picture(Picture { frame, rows, cols, cells });
}

/// The colour and opacity accumulated along a ray.
#[derive(Clone, Copy, Default)]
struct Seen {
    colour: [f64; 3],
    opacity: f64,
}

impl Seen {
    /// The colour and the opacity of a cell. The accumulated colour is weighted with the opacity, with
    /// which the colour of a cell is blended with what is behind it.
    fn cell(self) -> [u8; 4] {
        let part = |value: f64| (value / self.opacity.max(f64::MIN_POSITIVE)).round() as u8;
        let [red, green, blue] = self.colour.map(part);
        [red, green, blue, (255.0 * self.opacity).round() as u8]
    }
}

/// Accumulate colour and opacity along the line of sight through `point`.
fn march(volume: &Volume, point: DVec3, viewpoint: &Viewpoint, scale: ColourScale) -> Seen {
    let grid = &volume.grid;
    let diagonal = grid.extent().length();
    let step = grid.spacing.min_element() / STEPS_PER_VOXEL;
    let fog = FOG_DEPTH / (scale.high * diagonal);
    let mut seen = Seen::default();
    for number in 0..(diagonal / step) as usize {
        let at = point + (0.5 * diagonal - step * number as f64) * viewpoint.towards;
        let extinction = trilinear(volume, at);
        if extinction <= 0.0 {
            continue;
        }
        let opacity = (1.0 - seen.opacity) * -(-fog * extinction * step).exp_m1();
        let colour = scale.colour(extinction);
        let light = opacity * brightness(volume, at, viewpoint);
        for (sum, channel) in seen.colour.iter_mut().zip(colour) {
            *sum += light * f64::from(channel);
        }
        seen.opacity += opacity;
        if seen.opacity > 0.995 {
            break;
        }
    }
    seen
}

/// The brightness of a surface of constant extinction, lit from above and to the left of the
/// viewer.
fn brightness(volume: &Volume, at: DVec3, viewpoint: &Viewpoint) -> f64 {
    let spacing = volume.grid.spacing;
    let slope = |axis: DVec3| {
        trilinear(volume, at + axis * spacing) - trilinear(volume, at - axis * spacing)
    };
    let gradient = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)) / spacing;
    let light = (viewpoint.towards + viewpoint.up - 0.7 * viewpoint.right).normalize();
    AMBIENT + (1.0 - AMBIENT) * (-gradient.normalize_or_zero().dot(light)).max(0.0)
}

/// The trilinearly interpolated value between voxel centres; zero outside the grid.
fn trilinear(volume: &Volume, point: DVec3) -> f64 {
    let at = (point - volume.grid.origin) / volume.grid.spacing - 0.5;
    let low = at.floor();
    let part = at - low;
    let [nz, ny, nx] = volume.grid.shape.map(|n| n as i64);
    let (i, j, k) = (low.x as i64, low.y as i64, low.z as i64);
    if i < -1 || j < -1 || k < -1 || i >= nx || j >= ny || k >= nz {
        return 0.0;
    }
    let mut sum = 0.0;
    for (corner, weight) in corner_weights(part).into_iter().enumerate() {
        let side = |axis: usize| (corner >> axis & 1) as i64;
        let (i, j, k) = (i + side(0), j + side(1), k + side(2));
        if (0..nx).contains(&i) && (0..ny).contains(&j) && (0..nz).contains(&k) {
            sum += weight * f64::from(volume.values[[k as usize, j as usize, i as usize]]);
        }
    }
    sum
}

/// Draw the edges of the grid, except the three that meet at the corner nearest to the viewer, and
/// label the axes with their ranges.
fn draw_far_edges(figure: &mut Figure, grid: &Grid, viewpoint: &Viewpoint) {
    let corner = |bits: usize| {
        let side = DVec3::new((bits & 1) as f64, (bits >> 1 & 1) as f64, (bits >> 2) as f64);
        grid.lower() + side * grid.extent()
    };
    let nearest = (0..8)
        .max_by(|a, b| {
            let depth = |bits: &usize| corner(*bits).dot(viewpoint.towards);
            depth(a).total_cmp(&depth(b))
        })
        .unwrap_or(0);
    for from in 0..8_usize {
        for to in [1, 2, 4].map(|bit| from | bit).into_iter().filter(|to| *to != from) {
            if from != nearest && to != nearest {
                let [from, to] = [from, to].map(|bits| viewpoint.pixel(corner(bits)));
                figure.line(from, to, 1.0, GREY);
            }
        }
    }
    // Draw the ranges at the centres of unobstructed edges.
    let edge = |x: f64, y: f64, z: f64| grid.lower() + DVec3::new(x, y, z) * grid.extent();
    let (lower, upper) = (grid.lower(), grid.upper());
    let range = |axis: &str, from: f64, to: f64| format!("{axis} {from:.1}\u{2013}{to:.1} km");
    for (middle, text, anchor) in [
        (edge(0.5, 0.0, 0.0), range("x", lower.x, upper.x), Anchor::Below),
        (edge(0.0, 0.5, 0.0), range("y", lower.y, upper.y), Anchor::LeftOf),
        (edge(0.0, 1.0, 0.5), range("z", lower.z, upper.z), Anchor::UpwardsLeftOf),
    ] {
        let at = viewpoint.pixel(middle).as_ivec2();
        let (dx, dy) = if anchor == Anchor::Below { (0, 8) } else { (-10, 8) };
        figure.text(&text, TICK, anchor, at.x + dx, at.y + dy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn trilinear_values_are_exact_for_a_linear_field() {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.1, 0.2, 0.3), [4, 5, 6]).unwrap();
        let field = |point: DVec3| 1.0 + 2.0 * point.x + 3.0 * point.y - 0.5 * point.z;
        let values = Array3::from_shape_fn(grid.shape, |(k, j, i)| {
            field(grid.voxel_center([k, j, i])) as f32
        });
        let volume = Volume::new(grid, values).unwrap();
        for point in [DVec3::new(0.3, 0.5, 0.7), DVec3::new(0.11, 0.89, 0.99)] {
            assert!((trilinear(&volume, point) - field(point)).abs() < 1e-6);
        }
        assert_eq!(trilinear(&volume, DVec3::new(-0.2, 0.5, 0.5)), 0.0);
    }

    #[test]
    fn the_grid_fits_the_frame_and_east_is_right_of_west() {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.1, 0.1, 0.1), [4, 50, 60]).unwrap();
        let frame = Frame { left: 20, top: 30, width: 300, height: 300 };
        let viewpoint = Viewpoint::new(&grid, frame);
        for bits in 0..8 {
            let side = DVec3::new((bits & 1) as f64, (bits >> 1 & 1) as f64, (bits >> 2) as f64);
            let pixel = viewpoint.pixel(grid.lower() + side * grid.extent());
            assert!((pixel - DVec2::new(170.0, 180.0)).abs().max_element() < 150.01, "{pixel}");
        }
        let [west, east] =
            [-1.0, 1.0].map(|x| viewpoint.pixel(grid.center() + DVec3::new(x, 0.0, 0.0)));
        assert!(east.x > west.x);
    }
}
