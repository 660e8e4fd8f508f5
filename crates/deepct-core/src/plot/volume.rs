//! The figure of a volume: slices, projections, volume renderings and, if the truth is known, a
//! scatter plot.

use super::figure::{Anchor, Figure, Frame, LABEL, TITLE};
use super::panel::{ColourBar, ColourScale, Panel, PanelAxis, robust_limit};
use super::scatter::{check_pair, draw_scatter};
use super::shade::draw_solid;
use crate::error::{Error, Result};
use crate::grid::{Grid, Mask, Volume};
use crate::math::DVec3;
use ndarray::{Array2, Array3, ArrayView2, Axis};

/// Space to the left of a panel for its tick labels and axis label (pixels).
const LEFT: i32 = 84;
/// Space above a panel for its title (pixels).
const ABOVE: i32 = 40;
/// Space below a panel for its tick labels and axis label (pixels).
const BELOW: i32 = 62;
/// Space to the right of a group of panels for its colour bar with its labels (pixels).
const BAR: i32 = 130;
/// Space for the title of the page (pixels).
const HEAD: i32 = 70;
/// Length of the longest horizontal side of the grid in the figure (pixels).
const LONGEST: f64 = 300.0;
/// Minimum side length of a panel (pixels). The vertical sections of a flat field are stretched.
const LEAST_HEIGHT: i32 = 90;
/// Side length of a volume rendering and of the scatter plot (pixels).
const SOLID: i32 = 340;

const EXTINCTION: &str = "extinction (km\u{207b}\u{b9})";
const DIFFERENCE: &str = "estimate \u{2212} truth (km\u{207b}\u{b9})";
const DEPTH: &str = "optical depth";

/// What a figure shows. All fields are on one grid, and there is an extinction or a mask.
#[derive(Debug, Clone, Copy, Default)]
pub struct VolumeFields<'a> {
    /// The extinction of a cloud or an estimate (1/km).
    pub extinction: Option<&'a Volume>,
    /// The true extinction (1/km), with which the other is compared.
    pub truth: Option<&'a Volume>,
    /// The expected absolute error of the extinction (1/km).
    pub uncertainty: Option<&'a Volume>,
    /// The voxels that may contain cloud.
    pub mask: Option<&'a Mask>,
    /// The point through which the slices are taken (km); by default each is the one with the most
    /// extinction.
    pub through: Option<DVec3>,
}

impl VolumeFields<'_> {
    /// The voxel `[k, j, i]` on the slices with the most extinction or, without one, of the mask.
    fn fullest(&self) -> [usize; 3] {
        match (self.truth.or(self.extinction), self.mask) {
            (Some(volume), _) => fullest(&volume.values),
            (None, Some(mask)) => fullest(&mask.values.mapv(|inside| f32::from(u8::from(inside)))),
            (None, None) => [0; 3],
        }
    }
}

/// Draw fields: a slice along each axis, and the optical depth. If the truth is given, it is beside the
/// estimate with the same colour scale, followed by the difference; the last row then has volume
/// renderings and a scatter plot.
///
/// # Errors
/// Returns an error if the fields are on different grids, if there is neither an extinction nor a
/// mask, if values are negative or not finite, or if the point of the slices is outside the grid.
pub fn volume_figure(fields: &VolumeFields<'_>, title: &str) -> Result<Figure> {
    let layout = Layout::new(*fields)?;
    let mut figure = Figure::new(title, layout.size())?;
    layout.draw(&mut figure, title);
    Ok(figure)
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
    /// The array axis as a letter.
    fn letter(self) -> char {
        match self {
            Self::Map => 'z',
            Self::EastWest => 'y',
            Self::NorthSouth => 'x',
        }
    }

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

/// Panels of one quantity side by side, with a common colour scale.
struct Group {
    /// The name of each column and its three sections.
    columns: Vec<(&'static str, [Array2<f64>; 3])>,
    /// What the panels of a section show, such as the position of the slice.
    titles: [String; 3],
    scale: ColourScale,
    /// The label of the colour bar; none for a mask.
    label: Option<String>,
}

/// The layout of the figure.
struct Layout<'a> {
    fields: VolumeFields<'a>,
    grid: Grid,
    /// The voxel `[k, j, i]` through which the slices are taken.
    through: [usize; 3],
    /// Groups side by side, in a row for each section; blocks are below each other.
    blocks: Vec<Vec<Group>>,
    /// Size of the panel of each section in the figure (pixels).
    sizes: [[i32; 2]; 3],
    scale: ColourScale,
}

impl<'a> Layout<'a> {
    fn new(fields: VolumeFields<'a>) -> Result<Self> {
        let VolumeFields { extinction, truth, uncertainty, mask, through } = fields;
        let Some(grid) = extinction.map(|volume| volume.grid).or(mask.map(|mask| mask.grid)) else {
            return Err(Error::out_of_range(
                "fields of a figure",
                "none",
                "an extinction or a mask",
            ));
        };
        for (volume, name) in [(extinction, "extinction"), (uncertainty, "uncertainty")] {
            let Some(volume) = volume else { continue };
            volume.check_non_negative(name)?;
            grid.check_same(name, &volume.grid)?;
        }
        mask.map_or(Ok(()), |mask| grid.check_same("the mask", &mask.grid))?;
        if let Some(truth) = truth {
            check_pair(truth, extinction.unwrap_or(&Volume { grid, ..truth.clone() }))?;
        }
        let through = through.map_or_else(|| Ok(fields.fullest()), |point| grid.voxel(point))?;
        let extent = grid.extent();
        let scale = LONGEST / extent.x.max(extent.y);
        let pixels = |length: f64| ((length * scale).round() as i32).max(LEAST_HEIGHT);
        let [x, y, z] = [extent.x, extent.y, extent.z].map(pixels);
        let volumes = [truth, extinction].into_iter().flatten();
        let values = volumes.flat_map(|volume| &volume.values).map(|&value| f64::from(value));
        let scale = ColourScale::new(colorous::VIRIDIS, robust_limit(values));
        let sizes = [[x, y], [x, z], [y, z]];
        let mut layout = Self { fields, grid, through, blocks: Vec::new(), sizes, scale };
        layout.blocks = layout.blocks();
        Ok(layout)
    }

    /// The volumes with their names: the truth and the estimate, or only one of them.
    fn volumes(&self) -> Vec<(&'static str, &'a Volume)> {
        let name = if self.fields.truth.is_some() { "estimate" } else { "" };
        let truth = self.fields.truth.map(|truth| ("truth", truth));
        truth.into_iter().chain(self.fields.extinction.map(|volume| (name, volume))).collect()
    }

    fn blocks(&self) -> Vec<Vec<Group>> {
        let center = self.grid.voxel_center(self.through);
        let at = SECTIONS.map(|section| {
            let place = match section {
                Section::Map => center.z,
                Section::EastWest => center.y,
                Section::NorthSouth => center.x,
            };
            format!("{} = {place:.2} km", section.letter())
        });
        let along = SECTIONS.map(|section| format!("{DEPTH} along {}", section.letter()));
        let volumes = self.volumes();
        let mut slices =
            self.groups(&volumes, EXTINCTION, self.scale, &at, &|values| self.slices(values));
        if let Some(uncertainty) = self.fields.uncertainty {
            let values = uncertainty.values.iter().map(|&value| f64::from(value));
            slices.push(Group {
                columns: vec![("expected error", self.slices(&uncertainty.values))],
                titles: at.clone(),
                scale: ColourScale::new(colorous::MAGMA, robust_limit(values)),
                label: Some("expected absolute error (km\u{207b}\u{b9})".into()),
            });
        }
        if let Some(mask) = self.fields.mask {
            let inside = mask.values.mapv(|inside| if inside { 1.0 } else { 0.0 });
            let scale = ColourScale::new(colorous::GREYS, 1.6);
            let columns = vec![("mask", self.slices(&inside))];
            slices.push(Group { columns, titles: at, scale, label: None });
        }
        let depth_scale = {
            let depths = volumes.iter().flat_map(|(_, volume)| self.depths(&volume.values));
            let most = depths.flat_map(|depths| depths.into_iter()).fold(0.0, f64::max);
            ColourScale::new(colorous::INFERNO, most)
        };
        let depths =
            self.groups(&volumes, DEPTH, depth_scale, &along, &|values| self.depths(values));
        if volumes.len() == 2 {
            return vec![slices, depths];
        }
        vec![slices.into_iter().chain(depths).collect()]
    }

    /// The group of the volumes and, if there are two, that of their difference.
    fn groups(
        &self,
        volumes: &[(&'static str, &Volume)],
        label: &str,
        scale: ColourScale,
        titles: &[String; 3],
        sections: &dyn Fn(&Array3<f32>) -> [Array2<f64>; 3],
    ) -> Vec<Group> {
        let columns: Vec<_> =
            volumes.iter().map(|(name, volume)| (*name, sections(&volume.values))).collect();
        let most = volumes.iter().flat_map(|(_, volume)| &volume.values);
        let most = f64::from(most.copied().fold(0.0, f32::max));
        let label = match label {
            EXTINCTION if most > scale.high => format!("{label}, largest {most:.0}"),
            _ => label.to_owned(),
        };
        let difference = match &columns[..] {
            [(_, truth), (_, estimate)] => {
                let difference: [_; 3] =
                    std::array::from_fn(|number| &estimate[number] - &truth[number]);
                let values = difference.iter().flatten().map(|value| value.abs());
                let scale = ColourScale::diverging(colorous::RED_BLUE, robust_limit(values));
                let label = if label == DEPTH { "difference" } else { DIFFERENCE };
                let columns = vec![("difference", difference)];
                let titles = titles.clone();
                Some(Group { columns, titles, scale: scale.reversed(), label: Some(label.into()) })
            }
            _ => None,
        };
        let titles = titles.clone();
        let group = Group { columns, titles, scale, label: Some(label) };
        let group = (!group.columns.is_empty()).then_some(group);
        group.into_iter().chain(difference).collect()
    }

    fn slices(&self, values: &Array3<f32>) -> [Array2<f64>; 3] {
        std::array::from_fn(|number| {
            values.index_axis(SECTIONS[number].axis(), self.through[number]).mapv(f64::from)
        })
    }

    fn depths(&self, values: &Array3<f32>) -> [Array2<f64>; 3] {
        SECTIONS.map(|section| optical_depth(values, &self.grid, section))
    }

    /// Height of the rows of a block including titles and labels.
    fn block_height(&self) -> i32 {
        self.sizes.iter().map(|size| ABOVE + size[1] + BELOW).sum()
    }

    /// Width of a column: that of its widest section.
    fn column_width(&self) -> i32 {
        LEFT + self.sizes.iter().map(|size| size[0]).max().unwrap_or(0)
    }

    fn width(&self) -> i32 {
        let width = |groups: &Vec<Group>| -> i32 {
            let widths = groups
                .iter()
                .map(|group| group.columns.len() as i32 * self.column_width() + bar(group));
            widths.sum()
        };
        let solids = self.volumes().len() as i32 * (LEFT + SOLID);
        let solids = solids + if self.fields.truth.is_some() { LEFT + SOLID + BAR } else { 0 };
        self.blocks.iter().map(width).max().unwrap_or(0).max(solids) + 20
    }

    fn size(&self) -> [i32; 2] {
        let solids = if self.volumes().is_empty() { 0 } else { ABOVE + SOLID + BELOW };
        [self.width(), HEAD + self.blocks.len() as i32 * self.block_height() + solids]
    }

    fn draw(&self, figure: &mut Figure, title: &str) {
        figure.text(title, TITLE, Anchor::On, self.width() / 2, HEAD / 2);
        let mut top = HEAD;
        for block in &self.blocks {
            self.draw_block(figure, top, block);
            top += self.block_height();
        }
        self.draw_solids(figure, top);
    }

    /// Draw the sections of a block below each other, and its groups side by side.
    fn draw_block(&self, figure: &mut Figure, mut top: i32, groups: &[Group]) {
        for (number, section) in SECTIONS.into_iter().enumerate() {
            let [width, height] = self.sizes[number];
            let mut left = 0;
            for group in groups {
                let mut frame = Frame { left, top: top + ABOVE, width, height };
                for (name, sections) in &group.columns {
                    frame.left = left + LEFT;
                    let [right, up] = section.panel_axes(&self.grid);
                    let title = match *name {
                        "" => group.titles[number].clone(),
                        name => format!("{name}, {}", group.titles[number]),
                    };
                    let values = sections[number].view();
                    Panel { title, values, right, up, scale: group.scale }.draw(figure, frame);
                    left += self.column_width();
                }
                if let Some(label) = &group.label {
                    // The scale is that of the row above, and low panels have no space for its label.
                    let label = if number == 0 { label } else { "" };
                    let bar = Frame { left: frame.right() + 24, width: 18, ..frame };
                    ColourBar::linear(group.scale, label, height).draw(figure, bar);
                }
                left += bar(group);
            }
            top += ABOVE + height + BELOW;
        }
    }

    /// Draw the volume renderings and, if there are two volumes, the scatter plot.
    fn draw_solids(&self, figure: &mut Figure, top: i32) {
        let slot = |number: i32| Frame {
            left: LEFT + number * (SOLID + LEFT),
            top: top + ABOVE,
            width: SOLID,
            height: SOLID,
        };
        let volumes = self.volumes();
        for ((name, volume), number) in volumes.iter().zip(0..) {
            let frame = slot(number);
            draw_solid(figure, frame, volume, self.scale);
            let separator = if name.is_empty() { "" } else { ", " };
            let title = format!("{name}{separator}from the south-west");
            figure.text(&title, LABEL, Anchor::Above, frame.middle(), frame.top - 6);
        }
        if let [(_, truth), (_, estimate)] = volumes[..] {
            draw_scatter(figure, slot(2), truth, estimate);
        }
    }
}

/// Width of the colour bar of a group.
fn bar(group: &Group) -> i32 {
    if group.label.is_some() { BAR } else { 0 }
}

/// The index along each axis of the slice with the largest sum, which is never empty, unlike that through
/// the centre of mass of several clouds; of several such slices, the one nearest to the middle.
fn fullest(values: &Array3<f32>) -> [usize; 3] {
    std::array::from_fn(|axis| {
        let sum = |slice: ArrayView2<'_, f32>| slice.iter().map(|&value| f64::from(value)).sum();
        let sums: Vec<f64> = values.axis_iter(Axis(axis)).map(sum).collect();
        let most = sums.iter().copied().fold(0.0, f64::max);
        let middle = sums.len() / 2;
        let places = (0..sums.len()).filter(|&index| sums[index] == most);
        places.min_by_key(|index| index.abs_diff(middle)).unwrap_or(middle)
    })
}

/// The optical depth across the whole grid along the axis normal to the section.
fn optical_depth(extinction: &Array3<f32>, grid: &Grid, section: Section) -> Array2<f64> {
    let step = match section {
        Section::Map => grid.spacing.z,
        Section::EastWest => grid.spacing.y,
        Section::NorthSouth => grid.spacing.x,
    };
    extinction.map_axis(section.axis(), |line| {
        line.iter().map(|&extinction| f64::from(extinction)).sum::<f64>() * step
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume() -> Volume {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(0.1, 0.2, 0.5), [2, 3, 4]).unwrap();
        let mut volume = Volume::constant(grid, 0.0);
        volume.values[[1, 2, 0]] = 7.0;
        volume.values[[0, 2, 0]] = 1.0;
        volume
    }

    #[test]
    fn slices_are_never_empty() {
        let mut volume = volume();
        assert_eq!(fullest(&volume.values), [1, 2, 0]);
        // Between two clouds is clear air: 7 + 1 in the west, 9 in the east.
        volume.values[[1, 2, 3]] = 9.0;
        assert_eq!(fullest(&volume.values), [1, 2, 3]);
        volume.values.fill(1.0);
        assert_eq!(fullest(&volume.values), [1, 1, 2]);
        volume.values.fill(0.0);
        assert_eq!(fullest(&volume.values), [1, 1, 2]);
    }

    #[test]
    fn slices_are_those_through_a_point() {
        let volume = volume();
        let through = |point| {
            let fields = VolumeFields { extinction: Some(&volume), ..Default::default() };
            let layout = Layout::new(VolumeFields { through: Some(point), ..fields })?;
            let [(_, slices)] = &layout.blocks[0][0].columns[..] else { panic!() };
            Ok::<_, Error>((layout.through, slices[0][[2, 0]], slices[2][[1, 2]]))
        };
        // The voxel with the extinction 7 is in the slices x = 0.05 and z = 0.75 km.
        assert_eq!(through(DVec3::new(0.01, 0.3, 0.6)).unwrap(), ([1, 1, 0], 7.0, 7.0));
        assert_eq!(through(DVec3::new(0.4, 0.6, 0.0)).unwrap(), ([0, 2, 3], 1.0, 0.0));
        for point in [DVec3::new(0.41, 0.3, 0.6), DVec3::new(0.1, 0.3, f64::NAN)] {
            assert!(through(point).unwrap_err().to_string().contains("in the grid"));
        }
    }

    #[test]
    fn optical_depth_is_extinction_times_length() {
        let Volume { grid, values } = volume();
        let depth = |section| optical_depth(&values, &grid, section);
        assert!((depth(Section::Map)[[2, 0]] - 4.0).abs() < 1e-12);
        assert!((depth(Section::EastWest)[[1, 0]] - 1.4).abs() < 1e-12);
        assert!((depth(Section::NorthSouth)[[0, 2]] - 0.1).abs() < 1e-12);
    }

    #[test]
    fn fields_are_beside_each_other() {
        let volume = volume();
        let mask = Mask::new(volume.grid, volume.values.mapv(|value| value > 0.0)).unwrap();
        let columns = |fields| {
            let layout = Layout::new(fields).unwrap();
            let groups = |groups: &Vec<Group>| {
                let columns = groups.iter().flat_map(|group| &group.columns);
                columns.map(|(name, _)| *name).collect::<Vec<_>>().join(" ")
            };
            layout.blocks.iter().map(groups).collect::<Vec<_>>().join("; ")
        };
        let estimate = VolumeFields { extinction: Some(&volume), ..Default::default() };
        assert_eq!(columns(estimate), " ");
        let pair = VolumeFields { truth: Some(&volume), ..estimate };
        assert_eq!(columns(pair), "truth estimate difference; truth estimate difference");
        let all = VolumeFields { uncertainty: Some(&volume), mask: Some(&mask), ..pair };
        let slices = "truth estimate difference expected error mask";
        assert_eq!(columns(all), format!("{slices}; truth estimate difference"));
        let carved = VolumeFields { mask: Some(&mask), ..Default::default() };
        assert_eq!(columns(carved), "mask");
        let compared = VolumeFields { truth: Some(&volume), ..carved };
        assert_eq!(columns(compared), "truth mask truth");
        assert!(Layout::new(VolumeFields::default()).is_err());
    }
}
