//! Tests of the cloud generator.

use super::*;

fn water(cloud: &Cloud) -> &Array3<f32> {
    &cloud.microphysics.as_ref().unwrap().liquid_water_content
}

#[test]
fn the_same_seed_is_the_same_cloud_for_any_number_of_threads() {
    let make = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let small = FieldSettings { shape: [24, 48, 48], ..FieldSettings::default() };
            let small = FieldSettings { widths_km: [0.15, 0.8], ..small };
            (cumulus(&CumulusSettings::default(), seed), field(&small, seed))
        })
    };
    let (first, second) = (make(1, 5), make(3, 5));
    assert_eq!(first.0.unwrap(), second.0.unwrap());
    assert_eq!(first.1.unwrap(), second.1.unwrap());
    assert_ne!(make(1, 6).0.unwrap(), make(1, 5).0.unwrap());
}

/// Water occurs only between the cloud base and the top level and never in the outermost columns,
/// it does not exceed the adiabatic value, and the optical depth is typical of shallow cumuli.
#[test]
fn cumuli_look_like_cumuli() {
    let settings = CumulusSettings::default();
    for seed in 0..30 {
        let cloud = cumulus(&settings, seed).unwrap();
        let [nz, ny, nx] = cloud.grid.shape;
        let mut path = ndarray::Array2::<f32>::zeros((ny, nx));
        let mut lowest = nz;
        for ((k, j, i), &water) in water(&cloud).indexed_iter() {
            if water == 0.0 {
                continue;
            }
            let height = cloud.grid.voxel_center([k, j, i]).z - settings.base_km;
            assert!(f64::from(water) <= adiabatic_liquid_water(height), "seed {seed}");
            assert!(k < nz - 1 && (1..ny - 1).contains(&j) && (1..nx - 1).contains(&i));
            lowest = lowest.min(k);
            path[[j, i]] += 1500.0 * water / crate::cloud::effective_radius(water, 100.0) * 0.04;
        }
        // Level 2 is the first whose centre is above the base at 0.56 km.
        assert_eq!(lowest, 2, "seed {seed} has no flat base");
        let thickest = path.iter().copied().fold(0.0, f32::max);
        assert!((10.0..100.0).contains(&thickest), "seed {seed}: optical depth {thickest}");
    }
}

#[test]
fn a_field_has_the_wanted_cover() {
    let settings = FieldSettings { cover: 0.12, ..FieldSettings::default() };
    let cloud = field(&settings, 4).unwrap();
    let highest = water(&cloud).fold_axis(Axis(0), 0.0_f32, |most, water| most.max(*water));
    let cover = highest.iter().filter(|most| **most > 0.0).count() as f64 / 128.0 / 128.0;
    // The last cloud, at most 1 km wide, may exceed the prescribed cover by its own area.
    assert!((0.12..0.18).contains(&cover), "cover {cover}");
}

#[test]
fn sizes_follow_the_power_law() {
    // The integral of the density D^-1.7 between 0.1 and 1 gives its median.
    let mut rng = stream(1, Purpose::Cloud, &[]);
    let mut widths: Vec<_> = (0..20_001).map(|_| power_law(&mut rng, [0.1, 1.0], -1.7)).collect();
    widths.sort_by(f64::total_cmp);
    let cumulative = |d: f64| (0.1_f64.powf(-0.7) - d.powf(-0.7)) / (0.1_f64.powf(-0.7) - 1.0);
    assert!((cumulative(widths[10_000]) - 0.5).abs() < 0.015);
    assert!(widths[0] >= 0.1 && widths[20_000] <= 1.0);
}

#[test]
fn the_adiabatic_water_is_that_of_the_table() {
    for (height, water) in [(-0.1, 0.0), (0.0, 0.0), (0.1, 0.26), (0.25, 0.62), (1.0, 2.26)] {
        assert!((adiabatic_liquid_water(height) - water).abs() < 1e-12);
    }
    assert!((adiabatic_liquid_water(0.75) - 1.73).abs() < 1e-12);
    assert!(adiabatic_liquid_water(1.5) > 2.26);
}

#[test]
fn settings_out_of_range_are_refused() {
    let default = CumulusSettings::default;
    for wrong in [
        CumulusSettings { shape: [0, 1, 1], ..default() },
        CumulusSettings { spacing_km: [0.05, -0.05, 0.04], ..default() },
        CumulusSettings { base_km: 0.3, ..default() },
        CumulusSettings { base_km: f64::NAN, ..default() },
        CumulusSettings { width_km: Some(2.0), ..default() },
        CumulusSettings { depth_km: Some(0.0), ..default() },
        CumulusSettings { droplets_per_cm3: 0.0, ..default() },
        CumulusSettings { adiabatic_fraction: 1.1, ..default() },
        CumulusSettings { turbulence: -0.1, ..default() },
    ] {
        assert!(cumulus(&wrong, 1).is_err(), "{wrong:?}");
    }
    let default = FieldSettings::default;
    for wrong in [
        FieldSettings { cover: 0.0, ..default() },
        FieldSettings { widths_km: [0.5, 0.2], ..default() },
        FieldSettings { widths_km: [0.5, 9.0], ..default() },
    ] {
        assert!(field(&wrong, 1).is_err(), "{wrong:?}");
    }
}
