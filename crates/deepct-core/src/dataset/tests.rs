//! Tests with data sets of a small simulation.

use super::*;
use crate::cloud::{Cloud, Microphysics};
use crate::error::Result;
use crate::grid::Grid;
use crate::io::{self, Provenance};
use crate::math::DVec3;
use crate::network::Levels;
use crate::scene::Light;
use ndarray::Array3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Write a simulation of one snapshot with two box-shaped clouds, one of them across the periodic
/// boundary, and return settings that include both.
fn simulation(folder: &Path) -> DatasetSettings {
    let spacing = DVec3::new(0.05, 0.05, 0.04);
    let grid = Grid::new(DVec3::new(0.0, 0.0, 0.48), spacing, [6, 24, 24]).unwrap();
    let box_of_cloud = |k: usize, j: usize, i: usize| {
        let across = (i + 2) % 24 < 4 && (3..7).contains(&j);
        let inside = (8..14).contains(&i) && (14..19).contains(&j);
        (across || inside) && (1..4).contains(&k)
    };
    let water = Array3::from_shape_fn(
        grid.shape,
        |(k, j, i)| {
            if box_of_cloud(k, j, i) { 0.5 } else { 0.0 }
        },
    );
    let droplets = Microphysics::from_droplet_number(water, 100.0).unwrap();
    let field = Cloud::from_microphysics(grid, droplets).unwrap();
    let provenance = Provenance {
        title: "a test".into(),
        configuration: "".into(),
        seed: 0,
        ..Provenance::default()
    };
    io::write_cloud(folder.join("field.nc"), &field, &provenance).unwrap();
    DatasetSettings {
        seed: 5,
        formation: "cloudct-10".into(),
        light: Light::realistic(),
        bands: Vec::new(),
        droplets_per_cm3: [100.0, 100.0],
        water_share: 1.0,
        solver: SolverSettings {
            zenith_angles: 4,
            tolerance: 1e-2,
            cell_depth: 10.0,
            most_parts: 1,
        },
        columns: 12,
        column_km: 0.05,
        levels: Levels { bottom_km: 0.48, count: 6, spacing_km: 0.04 },
        isolated: true,
        minimum_columns: 10,
        minimum_water_path: 20.0,
        counts: BTreeMap::new(),
        sources: vec![Source {
            file: "field.nc".into(),
            split: Split::Train,
            first: 0,
            last: 0,
            every: 1,
            clouds: 9,
            isolated: None,
            variation: None,
            light: None,
        }],
    }
}

/// Plan a data set and generate it or a share of it.
fn make(
    settings: &DatasetSettings,
    folder: &Path,
    out: &Path,
    share: Option<&str>,
) -> Result<Generated> {
    let share = share.map(|share| share.parse().unwrap());
    generate(&plan(settings, folder, out, &|_| ())?, folder, out, share, &|_| ())
}

#[test]
fn a_data_set_is_made_once_checked_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let settings = simulation(folder.path());
    let out = folder.path().join("set");
    let run = |settings| make(settings, folder.path(), &out, None);
    assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 2 });
    let manifest = check(&out, &|_| ()).unwrap();

    // One cloud has 16 columns and 3 levels of 0.5 g/m3, the other 30 columns and 3 levels.
    let extinction = |sample: &Sample| {
        let volume = io::read_volume(out.join(&sample.file)).unwrap();
        volume.values.iter().map(|value| f64::from(*value)).sum::<f64>()
    };
    let radius = f64::from(crate::cloud::effective_radius(0.5, 100.0));
    for (sample, voxels) in manifest.samples.iter().zip([48.0, 90.0]) {
        // Twice the geometric cross-section plus the edge effect (Nussenzveig and Wiscombe 1980).
        let edge = 0.9962 * (2.0 * std::f64::consts::PI * radius / 0.672).powf(-2.0 / 3.0);
        let expected = voxels * 1500.0 * 0.5 / radius * (1.0 + edge);
        assert!((extinction(sample) / expected - 1.0).abs() < 5e-3);
        let cloud = io::read_cloud(out.join(&sample.file)).unwrap();
        assert!((cloud.mean_effective_radius().unwrap() / radius - 1.0).abs() < 1e-6);
    }

    // A second run generates nothing; a deleted sample is generated again with the same contents.
    assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 0 });
    std::fs::remove_file(out.join(&manifest.samples[1].file)).unwrap();
    assert_eq!(run(&settings).unwrap(), Generated { samples: 2, made: 1 });
    assert_eq!(check(&out, &|_| ()).unwrap(), manifest);
}

/// The default scene illumination is recognised by the geometric extinction and by darker images,
/// as it has no molecular atmosphere.
#[test]
fn clouds_are_seen_in_the_light_of_their_source() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = simulation(folder.path());
    let plain = Source { light: Some(Light::default()), ..settings.sources[0].clone() };
    settings.sources.push(plain);
    let out = folder.path().join("set");
    make(&settings, folder.path(), &out, None).unwrap();
    let samples = Manifest::read(&out).unwrap().samples;
    assert_eq!(samples.len(), 4);
    let radius = crate::cloud::effective_radius(0.5, 100.0);
    let [air, none] = [0, 2].map(|number| {
        let path = out.join(&samples[number].file);
        let largest = io::read_volume(&path).unwrap().values.iter().copied().fold(0.0, f32::max);
        (largest, io::read_observation(&path).unwrap().images.values[[5, 11, 11]])
    });
    assert!((none.0 / (1500.0 * 0.5 / radius) - 1.0).abs() < 1e-4 && air.0 > 1.02 * none.0);
    // The nadir view of a pixel on the side of the Sun outside the shadow shows an ocean surface
    // of albedo 0.05 at a solar zenith angle of 30 degrees.
    let ocean = 0.05 * 30.0_f32.to_radians().cos() / std::f32::consts::PI;
    assert!((none.1 / ocean - 1.0).abs() < 0.05 && air.1 > 1.2 * none.1, "{air:?} {none:?}");
}

#[test]
fn a_changed_sample_and_other_settings_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let settings = simulation(folder.path());
    let out = folder.path().join("set");
    let run = |settings, share| make(settings, folder.path(), &out, share);
    let mut other = settings.clone();
    other.light.surface.albedo = 0.1;

    // Both while only shares exist and once there is a manifest.
    run(&settings, Some("1/2")).unwrap();
    for share in [Some("2/2"), None] {
        let problem = run(&other, share).unwrap_err().to_string();
        assert!(problem.contains("plan.json: configuration"), "{problem}");
    }
    run(&settings, None).unwrap();
    std::fs::remove_file(Plan::path(&out)).unwrap();
    let problem = run(&other, Some("2/2")).unwrap_err().to_string();
    assert!(problem.contains("manifest.json: configuration"), "{problem}");
    assert!(!Plan::path(&out).exists());
    let never = Source { every: 0, ..settings.sources[0].clone() };
    let never = DatasetSettings { sources: vec![never], ..settings.clone() };
    assert!(run(&never, None).is_err());

    let sample = out.join(&Manifest::read(&out).unwrap().samples[0].file);
    let mut bytes = std::fs::read(&sample).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&sample, bytes).unwrap();
    let problem = check(&out, &|_| ()).unwrap_err().to_string();
    assert!(problem.contains("checksum"), "{problem}");
}

#[test]
fn shares_make_what_one_process_makes() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = simulation(folder.path());
    // Each source counts as a separate snapshot with other droplet number concentrations.
    settings.droplets_per_cm3 = [50.0, 600.0];
    settings.sources = vec![settings.sources[0].clone(); 3];
    let whole = folder.path().join("whole");
    make(&settings, folder.path(), &whole, None).unwrap();

    let shared = folder.path().join("shared");
    let run = |share| make(&settings, folder.path(), &shared, share).unwrap();
    assert_eq!(run(Some("2/2")), Generated { samples: 2, made: 2 });
    assert!(!Manifest::path(&shared).exists());
    assert_eq!(run(Some("1/2")), Generated { samples: 4, made: 4 });
    assert_eq!(run(Some("5/8")), Generated { samples: 0, made: 0 });
    assert_eq!(run(None), Generated { samples: 6, made: 0 });
    let files = |folder: &Path| {
        let samples = std::fs::read_dir(folder.join("samples")).unwrap();
        let paths = samples.map(|entry| entry.unwrap().path());
        let own = |path: PathBuf| (path.file_name().unwrap().to_owned(), std::fs::read(path));
        let mut files: Vec<_> =
            paths.map(own).map(|(name, bytes)| (name, bytes.unwrap())).collect();
        files.sort();
        files.push(("manifest.json".into(), std::fs::read(Manifest::path(folder)).unwrap()));
        files
    };
    assert!(files(&shared) == files(&whole), "a file differs");
}

#[test]
fn shares_that_cannot_be_are_refused() {
    for share in ["0/8", "9/8", "3", "/", "1/0", "-1/2", "a/b"] {
        assert!(share.parse::<Share>().is_err(), "{share}");
    }
}

#[test]
fn a_damaged_plan_and_another_simulation_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let settings = simulation(folder.path());
    let out = folder.path().join("set");
    let mut plan = plan(&settings, folder.path(), &out, &|_| ()).unwrap();
    plan.samples[0].corner = [7, 7];
    let problem = generate(&plan, folder.path(), &out, None, &|_| ()).unwrap_err().to_string();
    assert!(problem.contains("field.nc") && problem.contains("[7, 7]"), "{problem}");

    plan.samples[0].source = 1;
    std::fs::write(Plan::path(&out), serde_json::to_string(&plan).unwrap()).unwrap();
    let problem = make(&settings, folder.path(), &out, None).unwrap_err().to_string();
    assert!(problem.contains("plan.json") && problem.contains("source 1"), "{problem}");
}

#[test]
fn fields_keep_all_water() {
    let folder = tempfile::tempdir().unwrap();
    let settings = DatasetSettings {
        minimum_columns: 1,
        minimum_water_path: 0.0,
        ..simulation(folder.path())
    };
    let whole = DatasetSettings { isolated: false, ..settings.clone() };
    let mut own = settings.clone();
    own.sources[0].isolated = Some(false);
    // A data set of fields, and a data set of isolated clouds with a source of fields.
    for (name, settings) in [("whole", whole), ("own", own)] {
        let out = folder.path().join(name);
        make(&settings, folder.path(), &out, None).unwrap();
        let samples = check(&out, &|_| ()).unwrap().samples;
        assert!((1..=4).contains(&samples.len()));
        // All voxels with water have the same value.
        let mut voxels = 0;
        for sample in &samples {
            let values = io::read_volume(out.join(&sample.file)).unwrap().values;
            let wet = values.iter().filter(|value| **value > 0.0).count();
            assert!(wet > 0, "a clear square");
            voxels += wet;
        }
        assert_eq!(voxels, 48 + 90);
    }
}

#[test]
fn each_split_has_the_samples_that_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = simulation(folder.path());
    let of = |split| Source { split, ..settings.sources[0].clone() };
    settings.sources = vec![of(Split::Train), of(Split::Validation), of(Split::Train)];
    let planned = |counts: &[(Split, usize)]| {
        let counts = counts.iter().copied().collect();
        let out = tempfile::tempdir().unwrap();
        plan(&DatasetSettings { counts, ..settings.clone() }, folder.path(), out.path(), &|_| ())
    };
    let all = planned(&[]).unwrap();
    assert_eq!((all.count(Split::Train), all.count(Split::Validation)), (4, 2));
    let some = planned(&[(Split::Train, 3), (Split::Test, 0)]).unwrap();
    assert_eq!((some.count(Split::Train), some.count(Split::Validation)), (3, 2));
    // The samples are in the same order and each occurs at most once.
    let mut rest = all.samples.iter();
    assert!(some.samples.iter().all(|one| rest.any(|other| other == one)));
    assert_eq!(planned(&[(Split::Train, 3), (Split::Test, 0)]).unwrap(), some);
    for (split, count, has) in [(Split::Train, 5, "4"), (Split::Test, 1, "0")] {
        let problem = planned(&[(split, count)]).unwrap_err().to_string();
        assert!(problem.contains(&format!("at most the {has} that")), "{problem}");
    }
}

/// The images of each band are those of a data set of this wavelength alone, and absorption by the
/// droplets makes the second band darker. The extinction is that of the first band.
#[test]
fn samples_are_rendered_in_each_band() {
    let folder = tempfile::tempdir().unwrap();
    let settings = simulation(folder.path());
    let observations = |bands: &[f64], wavelength: f64| {
        let mut settings = DatasetSettings { bands: bands.to_vec(), ..settings.clone() };
        settings.light.wavelength = wavelength;
        let out = folder.path().join(format!("{bands:?} {wavelength}"));
        make(&settings, folder.path(), &out, None).unwrap();
        let file = out.join(&check(&out, &|_| ()).unwrap().samples[0].file);
        (io::read_observations(&file).unwrap(), io::read_cloud(&file).unwrap())
    };
    let (two, cloud) = observations(&[0.672, 2.13], 0.5);
    assert_eq!(two.len(), 2);
    for (band, wavelength) in two.iter().zip([0.672, 2.13]) {
        let (alone, seen) = observations(&[], wavelength);
        assert_eq!(*band, alone[0]);
        assert_eq!(cloud.extinction == seen.extinction, wavelength == 0.672);
        assert_eq!(cloud.microphysics, seen.microphysics);
    }
    assert!(two[1].images.brightest() < 0.95 * two[0].images.brightest());
}

#[test]
fn bands_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let settings = simulation(folder.path());
    for bands in [[0.672, 0.672], [0.672, -1.0], [0.672, f64::NAN]] {
        let settings = DatasetSettings { bands: bands.to_vec(), ..settings.clone() };
        assert!(settings.check(folder.path()).is_err(), "{bands:?}");
    }
}
