//! Tests of the scene illumination and of its table.

use super::*;
use crate::grid::Grid;
use crate::math::DVec3;
use crate::optics::Scattering;
use crate::scene::Waves;
use std::collections::BTreeMap;

fn grid() -> Grid {
    Grid::new(DVec3::new(0.0, 0.0, 0.5), DVec3::splat(0.1), [2, 2, 2]).unwrap()
}

/// The values read from a file equal those written, to the last bit.
#[test]
fn a_table_gives_the_same_light_again() {
    let mut light = Light::realistic();
    light.sun = Sun::from_degrees(41.3, 271.7).unwrap();
    light.surface.waves = Some(Waves::new(7.3).unwrap());
    light.surface.altitude = 0.1;
    light.boundary = Boundary::Periodic;
    light.optics.effective_radius = Some(8.1);
    light.optics.bandwidth = 0.02;
    let text = toml::to_string(&light).unwrap();
    assert_eq!(toml::from_str::<Light>(&text).unwrap(), light);
    assert_eq!(toml::from_str::<Light>("").unwrap(), Light::default());
    let json = serde_json::to_string(&light).unwrap();
    assert_eq!(serde_json::from_str::<Light>(&json).unwrap(), light);
}

#[test]
fn values_out_of_range_and_unknown_keys_are_refused() {
    for text in [
        "sun_zenith_deg = 95.0",
        "solar_irradiance = 0.0",
        "wavelength = -0.6",
        "surface_albedo = 1.5",
        "wind_speed = 100.0",
        "gas_optical_depth = -0.1",
        "gas_optical_depth = 90.0",
        "air = true\nwavelength = 80.0",
        "optics.asymmetry = 1.5",
        "optics.single_scattering_albedo = 2.0",
        "optics.effective_radius = 500.0",
        "optics.phase = \"rayleigh\"",
        "optics.bandwidth = 0.02",
        "optics.effective_variance = 0.05",
        "sun_zenit_deg = 3.0",
    ] {
        assert!(toml::from_str::<Light>(text).is_err(), "{text}");
    }
}

#[test]
fn keys_are_those_of_the_table() {
    let mut light = Light::realistic();
    light.gas_optical_depth = 0.03;
    light.surface.waves = Some(Waves::new(5.0).unwrap());
    light.optics.effective_radius = Some(8.0);
    light.optics.effective_variance = Some(0.2);
    let values = light.values();
    let mut keys = Light::keys().to_vec();
    keys.sort_unstable();
    assert_eq!(values.keys().collect::<Vec<_>>(), keys);
    assert_eq!(Light::default().with_values(&values).unwrap(), light);
    for key in Light::required_keys() {
        assert!(Light::default().values().contains_key(*key), "{key}");
    }
    let one = |key: &str, value: toml::Value| BTreeMap::from([(key.to_owned(), value)]);
    let windy = light.with_values(&one("wind_speed", 7.into())).unwrap();
    assert_eq!(windy.surface.waves.unwrap().wind_speed(), 7.0);
    for (key, value) in [("wind", 3.0.into()), ("optics.phase.x", 1.0.into()), ("air", 3.into())] {
        assert!(light.with_values(&one(key, value)).is_err(), "{key}");
    }
}

/// With a prescribed effective radius, an extinction scatters as droplets of this size.
#[test]
fn an_extinction_scatters_as_droplets_of_the_given_size() {
    let mut light = Light::realistic();
    let extinction = Volume::constant(grid(), 20.0);
    assert!(light.scene_of(extinction.clone()).is_err(), "no effective radius");
    light.optics.effective_radius = Some(9.0);
    let scene = light.scene_of(extinction.clone()).unwrap();
    assert_eq!(scene.medium.extinction, extinction);
    assert!(scene.air.is_some());
    let Scattering::Droplets { effective_radius, table } = &scene.medium.scattering else {
        panic!("no droplets");
    };
    assert_eq!(effective_radius[[1, 1, 1]], 9.0);
    assert_eq!(table.nodes().len(), 1);
    // A cloud with droplets conflicts with a prescribed effective radius.
    let mut cloud = Cloud::from_extinction(extinction).unwrap();
    cloud.microphysics = Some(Microphysics::of_one_size([2, 2, 2], 7.0));
    assert!(light.scene(&cloud).is_err());
    light.optics.effective_radius = None;
    assert!(light.scene(&cloud).is_ok());
}
