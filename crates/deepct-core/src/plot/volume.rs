//! The figure of a volume: slices, projections, volume renderings and, if the truth is known, a
//! scatter plot.

use super::page::{Anchor, Frame, LABEL, Page, TITLE};
use super::panel::{ColourBar, ColourScale, Panel, PanelAxis};
use super::scatter::{check_pair, draw_scatter};
use super::shade::draw_solid;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use ndarray::{Array2, Axis};
use std::path::Path;

/// Space to the left of a panel for its tick labels and axis label (pixels).
const LEFT: i32 = 84;
/// Space above a panel for its title (pixels).
const ABOVE: i32 = 44;
/// Space below a panel for its tick labels and axis label (pixels).
const BELOW: i32 = 62;
/// Space to the right of the last panel for the colour bar with its labels (pixels).
const BAR: i32 = 130;
/// Space for the title of the page (pixels).
const HEAD: i32 = 70;
/// Length of the longest horizontal side of the grid on the page (pixels).
const LONGEST: f64 = 300.0;
/// Minimum side length of a panel (pixels). The vertical sections of a flat field are stretched.
const LEAST_HEIGHT: i32 = 90;

/// Draw a volume as a PNG file: three slices through its maximum, the optical depth along each
/// axis and a volume rendering. If the truth is given, its panels are shown in addition with the
/// same colour scales, together with a scatter plot.
///
/// # Errors
/// Returns an error if the volumes are on different grids, if values are negative or not finite,
/// or if the file cannot be written.
pub fn volume_figure(
    path: impl AsRef<Path>,
    estimate: &Volume,
    truth: Option<&Volume>,
    title: &str,
) -> Result<()> {
    let path = path.as_ref();
    estimate.check_non_negative("extinction")?;
    let mut rows = vec![Row { name: "", volume: estimate }];
    if let Some(truth) = truth {
        check_pair(truth, estimate)?;
        let name = |name, volume| Row { name, volume };
        rows = vec![name("truth", truth), name("estimate", estimate)];
    }
    let figure = Figure::new(&rows);
    let mut page = Page::new(figure.size())?;
    figure.draw(&mut page, title);
    page.write(path)
}

/// A volume and its name, which is empty for a single volume.
struct Row<'a> {
    name: &'static str,
    volume: &'a Volume,
}

impl Row<'_> {
    fn title(&self, what: &str) -> String {
        if self.name.is_empty() { what.to_owned() } else { format!("{}, {what}", self.name) }
    }
}

/// The sections of a grid: horizontal, west-east and south-north.
#[derive(Clone, Copy)]
enum Section {
    Map,
    EastWest,
    NorthSouth,
}

const SECTIONS: [Section; 3] = [Section::Map, Section::EastWest, Section::NorthSouth];

impl Section {
    /// The array axis normal to the section, along which optical depth is summed.
    fn axis(self) -> Axis {
        match self {
            Self::Map => Axis(0),
            Self::EastWest => Axis(1),
            Self::NorthSouth => Axis(2),
        }
    }

    /// The horizontal and vertical axes of the panel.
    fn panel_axes(self, grid: &Grid) -> [PanelAxis; 2] {
        let (lower, upper) = (grid.lower(), grid.upper());
        let x = PanelAxis { label: "x, east (km)", range: lower.x..upper.x };
        let y = PanelAxis { label: "y, north (km)", range: lower.y..upper.y };
        let z = PanelAxis { label: "altitude (km)", range: lower.z..upper.z };
        match self {
            Self::Map => [x, y],
            Self::EastWest => [x, z],
            Self::NorthSouth => [y, z],
        }
    }
}

/// The layout of the figure.
struct Figure<'a> {
    rows: &'a [Row<'a>],
    grid: Grid,
    /// The voxel `[k, j, i]` through which the slices are taken.
    through: [usize; 3],
    /// Size of the panel of each section on the page (pixels).
    sizes: [[i32; 2]; 3],
}

impl<'a> Figure<'a> {
    fn new(rows: &'a [Row<'a>]) -> Self {
        let grid = rows[0].volume.grid;
        let extent = grid.extent();
        let scale = LONGEST / extent.x.max(extent.y);
        let pixels = |length: f64| ((length * scale).round() as i32).max(LEAST_HEIGHT);
        let [x, y, z] = [extent.x, extent.y, extent.z].map(pixels);
        Self { rows, grid, through: greatest(rows[0].volume), sizes: [[x, y], [x, z], [y, z]] }
    }

    /// Height of a row of sections including titles and labels.
    fn row_height(&self) -> i32 {
        ABOVE + self.sizes.iter().map(|size| size[1]).max().unwrap_or(0) + BELOW
    }

    /// Side length of a volume rendering and of the scatter plot, which share the page width.
    fn solid_side(&self) -> i32 {
        (self.width() - BAR - 3 * LEFT) / 3
    }

    fn width(&self) -> i32 {
        self.sizes.iter().map(|size| LEFT + size[0]).sum::<i32>() + BAR
    }

    fn size(&self) -> [i32; 2] {
        let sections = 2 * self.rows.len() as i32 * self.row_height();
        [self.width(), HEAD + sections + ABOVE + self.solid_side() + BELOW]
    }

    fn draw(&self, page: &mut Page, title: &str) {
        page.text(title, TITLE, Anchor::On, self.width() / 2, HEAD / 2);
        let extinction = self.extinction_scale();
        let mut top = HEAD;
        for row in self.rows {
            self.draw_slices(page, top, row, extinction);
            top += self.row_height();
        }
        let depth = self.depth_scale();
        for row in self.rows {
            self.draw_depths(page, top, row, depth);
            top += self.row_height();
        }
        self.draw_solids(page, top, extinction);
    }

    /// The colour scale of extinction, common to all volumes.
    fn extinction_scale(&self) -> ColourScale {
        let values = self.rows.iter().flat_map(|row| &row.volume.values);
        ColourScale::new(colorous::VIRIDIS, f64::from(values.copied().fold(0.0, f32::max)))
    }

    fn draw_slices(&self, page: &mut Page, top: i32, row: &Row<'_>, scale: ColourScale) {
        let [k, j, i] = self.through;
        let center = self.grid.voxel_center(self.through);
        let sections = [
            (k, format!("z = {:.2} km", center.z)),
            (j, format!("y = {:.2} km", center.y)),
            (i, format!("x = {:.2} km", center.x)),
        ];
        let panels = std::array::from_fn(|number| {
            let (index, at) = &sections[number];
            let slice = row.volume.values.index_axis(SECTIONS[number].axis(), *index);
            (slice.mapv(f64::from), row.title(at))
        });
        self.draw_sections(page, top, &panels, (scale, "extinction (km\u{207b}\u{b9})"));
    }

    fn draw_depths(&self, page: &mut Page, top: i32, row: &Row<'_>, scale: ColourScale) {
        let along = ["along z", "along y", "along x"];
        let panels = std::array::from_fn(|number| {
            let depth = optical_depth(row.volume, SECTIONS[number]);
            (depth, row.title(along[number]))
        });
        self.draw_sections(page, top, &panels, (scale, "optical depth"));
    }

    /// The colour scale of optical depth, common to all volumes and directions.
    fn depth_scale(&self) -> ColourScale {
        let depths = self.rows.iter().flat_map(|row| {
            SECTIONS.map(|section| optical_depth(row.volume, section).fold(0.0, |a, &b| b.max(a)))
        });
        ColourScale::new(colorous::INFERNO, depths.fold(0.0, f64::max))
    }

    /// Draw the three sections side by side, aligned at the bottom, and a colour bar.
    fn draw_sections(
        &self,
        page: &mut Page,
        top: i32,
        panels: &[(Array2<f64>, String); 3],
        (scale, label): (ColourScale, &str),
    ) {
        let bottom = top + self.row_height() - BELOW;
        let mut left = 0;
        for (number, (values, title)) in panels.iter().enumerate() {
            let [width, height] = self.sizes[number];
            left += LEFT;
            let [right, up] = SECTIONS[number].panel_axes(&self.grid);
            let panel = Panel { title: title.clone(), values: values.view(), right, up, scale };
            panel.draw(page, Frame { left, top: bottom - height, width, height });
            left += width;
        }
        let height = self.row_height() - ABOVE - BELOW;
        let frame = Frame { left: left + 24, top: bottom - height, width: 18, height };
        ColourBar::linear(scale, label, height).draw(page, frame);
    }

    /// Draw the volume renderings and, if there are two volumes, the scatter plot.
    fn draw_solids(&self, page: &mut Page, top: i32, scale: ColourScale) {
        let side = self.solid_side();
        let slot = |number: i32| Frame {
            left: LEFT + number * (side + LEFT),
            top: top + ABOVE,
            width: side,
            height: side,
        };
        // A single volume is drawn in the middle.
        let slots = if self.rows.len() == 1 { [1, 1] } else { [0, 1] };
        for (row, number) in self.rows.iter().zip(slots) {
            let frame = slot(number);
            draw_solid(page, frame, row.volume, scale);
            let title = row.title("from the south-west");
            page.text(&title, LABEL, Anchor::Above, frame.middle(), frame.top - 6);
        }
        if let [truth, estimate] = self.rows {
            draw_scatter(page, slot(2), truth.volume, estimate.volume);
        }
    }
}

/// The voxel with the maximum value; the first if there are several.
fn greatest(volume: &Volume) -> [usize; 3] {
    let mut best = ([0; 3], f32::NEG_INFINITY);
    for ((k, j, i), &value) in volume.values.indexed_iter() {
        if value > best.1 {
            best = ([k, j, i], value);
        }
    }
    best.0
}

/// The optical depth across the whole grid along the axis normal to the section.
fn optical_depth(volume: &Volume, section: Section) -> Array2<f64> {
    let spacing = volume.grid.spacing;
    let step = match section {
        Section::Map => spacing.z,
        Section::EastWest => spacing.y,
        Section::NorthSouth => spacing.x,
    };
    volume.values.map_axis(section.axis(), |line| {
        line.iter().map(|&extinction| f64::from(extinction)).sum::<f64>() * step
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    fn volume() -> Volume {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.1, 0.2, 0.5), [2, 3, 4]).unwrap();
        let mut volume = Volume::constant(grid, 0.0);
        volume.values[[1, 2, 0]] = 7.0;
        volume.values[[0, 2, 0]] = 1.0;
        volume
    }

    #[test]
    fn slices_go_through_the_greatest_value() {
        assert_eq!(greatest(&volume()), [1, 2, 0]);
    }

    #[test]
    fn optical_depth_is_extinction_times_length() {
        let volume = volume();
        assert!((optical_depth(&volume, Section::Map)[[2, 0]] - 4.0).abs() < 1e-12);
        assert!((optical_depth(&volume, Section::EastWest)[[1, 0]] - 1.4).abs() < 1e-12);
        assert!((optical_depth(&volume, Section::NorthSouth)[[0, 2]] - 0.1).abs() < 1e-12);
    }
}
