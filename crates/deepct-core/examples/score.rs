//! Scores of three simple estimates: the truth multiplied by 0.8, the truth shifted by one voxel to
//! the east, and zero everywhere.
//!
//! `cargo run --release --example score`

use deepct_core::Result;
use deepct_core::grid::{Grid, Volume};
use deepct_core::math::DVec3;
use deepct_core::metrics::score;
use ndarray::Array3;

fn main() -> Result<()> {
    let grid = Grid::new(DVec3::ZERO, DVec3::new(0.05, 0.05, 0.04), [16, 16, 16])?;
    let ball = |shift: DVec3| {
        let extinction = |(k, j, i)| {
            let distance = (grid.voxel_center([k, j, i]) - shift).distance(grid.center());
            (60.0 * (1.0 - distance / 0.25)).max(0.0) as f32
        };
        Volume::new(grid, Array3::from_shape_fn(grid.shape, extinction))
    };
    let truth = ball(DVec3::ZERO)?;
    let answers = [
        ("four fifths", Volume::new(grid, &truth.values * 0.8)?),
        ("too far east", ball(DVec3::new(0.05, 0.0, 0.0))?),
        ("nothing", Volume::constant(grid, 0.0)),
    ];
    println!("answer        epsilon   delta  rmse (km-1)  correlation");
    for (name, estimate) in answers {
        let scores = score(&truth, &estimate)?;
        println!(
            "{name:12}  {:7.3}  {:6.3}  {:11.3}  {:?}",
            scores.relative_error,
            scores.mass_error,
            scores.root_mean_square_error,
            scores.correlation
        );
    }
    Ok(())
}
