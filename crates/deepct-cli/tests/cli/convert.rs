//! `deepct convert` and `deepct regrid`. What the files of other programs contain is tested with
//! Python (`weights_tools/tests/test_conversions.py`).

use crate::program::Program;
use deepct_core::io::{read_cloud, read_mask, read_volume};

fn scene() -> Program {
    let program = Program::new();
    program.succeed(
        "cloud generate --seed 5 --set shape=[8,12,14] --set width_km=0.3 --set depth_km=0.16 --out C.nc",
    );
    program.succeed("render C.nc --views cloudct-10 --samples 2 --out I.nc");
    program.succeed("carve I.nc --grid C.nc --out M.nc");
    let grid = "origin_km = [-0.1, -0.1, 0.44]\nspacing_km = [0.1, 0.1, 0.08]\nshape = [6, 8, 9]\n";
    std::fs::write(program.path("G.toml"), grid).unwrap();
    program
}

#[test]
fn wrong_conversions_are_refused() {
    let program = scene();
    program.refuse("convert C.nc C.nc", &["C.nc", "is the input of this command"]);
    program.refuse("convert C.nc D.nc", &["C.nc", "is one of deepct already"]);
    program.refuse("convert C.nc C.tif", &["C.tif", ".vti, .vol, .npz, .mat"]);
    program.refuse("convert I.nc I.vti", &["I.vti", ".npz, .mat, .tif, .png, .exr"]);
    program.refuse("convert M.nc M.vol", &["M.vol", "expected mask, found extinction"]);
    program.refuse("convert none.nc a.vti", &["none.nc", "does not exist"]);
    program.refuse("convert C.nc nowhere/a.vti", &["nowhere", "does not exist"]);
    program.refuse("regrid I.nc --like G.toml --out a.nc", &["I.nc", "images"]);
    program.refuse("regrid C.nc --like none.nc --out a.nc", &["none.nc", "does not exist"]);
    program.refuse("regrid C.nc --like G.toml --out C.nc", &["C.nc", "is an input"]);
}

#[test]
fn a_foreign_cloud_is_converted_as_it_is() {
    let program = Program::new();
    let text =
        "2 parameter LWC file\n3 2 2\n0.03 0.03\n0.5 0.54\n280 280\n1 1 1 0.25 8\n3 2 2 0.5 10\n";
    std::fs::write(program.path("s.lwc"), text).unwrap();
    program.succeed("convert s.lwc s.nc");
    let cloud = read_cloud(program.path("s.nc")).unwrap();
    let droplets = cloud.microphysics.unwrap();
    assert_eq!(cloud.grid.shape, [2, 2, 3]);
    assert_eq!(droplets.liquid_water_content[[0, 0, 0]], 0.25);
    assert_eq!(droplets.effective_radius[[1, 1, 2]], 10.0);
    program.succeed("convert s.lwc s.vti");
}

#[test]
fn a_variable_in_other_units_is_selected() {
    let program = scene();
    program.succeed("convert C.nc D.nc --variable lwc --units lwc=dg/m3");
    program.succeed("regrid C.nc --like C.nc --variable lwc --units lwc=dg/m3 --out E.nc");
    let water = |name| {
        let droplets = read_cloud(program.path(name)).unwrap().microphysics.unwrap();
        f64::from(droplets.liquid_water_content.sum())
    };
    let expected = 0.1 * water("C.nc");
    for name in ["D.nc", "E.nc"] {
        assert!((water(name) / expected - 1.0).abs() < 1e-5, "{name}: {}", water(name));
    }
    program.refuse("convert C.nc F.nc --variable none", &["C.nc", "none"]);
}

#[test]
fn a_coarser_grid_conserves_cloud() {
    let program = scene();
    let printed = program.succeed("regrid C.nc --like G.toml --out D.nc");
    assert!(printed.contains("100.00 %"), "{printed}");
    let (before, after) =
        ["C.nc", "D.nc"].map(|name| read_cloud(program.path(name)).unwrap()).into();
    let water = |cloud: &deepct_core::cloud::Cloud| {
        let droplets = cloud.microphysics.as_ref().unwrap();
        let sum: f64 = droplets.liquid_water_content.iter().map(|value| f64::from(*value)).sum();
        sum * cloud.grid.spacing.element_product()
    };
    assert_eq!(after.grid.shape, [6, 8, 9]);
    assert!((water(&after) / water(&before) - 1.0).abs() < 1e-5);

    // A voxel of the new mask is inside if one of the eight that it overlaps is.
    program.succeed("regrid M.nc --like G.toml --out N.nc");
    let fine = read_mask(program.path("M.nc")).unwrap().values;
    let coarse = read_mask(program.path("N.nc")).unwrap().values;
    for ((k, j, i), inside) in coarse.indexed_iter() {
        // The new grid begins one coarse voxel before the old one along y and x, and half a one
        // along z.
        let any = (0..2).any(|dk| {
            (0..2).any(|dj| {
                (0..2).any(|di| {
                    let at = [
                        (2 * k + dk).checked_sub(1),
                        (2 * j + dj).checked_sub(2),
                        (2 * i + di).checked_sub(2),
                    ];
                    let [Some(k), Some(j), Some(i)] = at else { return false };
                    fine.get([k, j, i]).copied().unwrap_or(false)
                })
            })
        });
        assert_eq!(*inside, any, "{k} {j} {i}");
    }
}

#[test]
fn estimates_of_other_grids_can_be_compared() {
    let program = scene();
    program.succeed("infer I.nc --grid C.nc --out V.nc");
    program.succeed("regrid V.nc --like G.toml --out W.nc");
    program.succeed("regrid C.nc --like G.toml --out D.nc");
    program.succeed("score --truth D.nc W.nc");
    assert_eq!(read_volume(program.path("W.nc")).unwrap().grid.shape, [6, 8, 9]);
}
