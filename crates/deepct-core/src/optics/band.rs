//! Optics of droplets averaged over a spectral band.

use super::population::{cosines, default_radii};
use super::{DropletOptics, DropletSettings, DropletTable, PhaseFunction};
use crate::error::{Error, Result};
use std::sync::{Arc, Mutex, PoisonError};

/// Number of tables that [`DropletTable::shared`] keeps.
const KEPT_TABLES: usize = 4;

/// A table that was computed, with its settings, the width of its band and its radii.
type KeptTable = (DropletSettings, f64, Vec<f64>, Arc<DropletTable>);

/// The tables computed last, the latest one at the end.
static KEPT: Mutex<Vec<KeptTable>> = Mutex::new(Vec::new());

/// Number of wavelengths in a band.
const WAVELENGTHS: usize = 8;
/// Black-body temperature of the Sun (K), which determines the spectral weights, and Planck's
/// constant times the speed of light over Boltzmann's constant (um K).
const SUN_TEMPERATURE: f64 = 5772.0;
const SECOND_RADIATION: f64 = 14_387.77;

impl DropletTable {
    /// The table of droplets with effective radii from 1 to 25 um, averaged over a band of the
    /// given `width` (um) that is centred on the settings' wavelength and has a uniform spectral
    /// response. The extinction is weighted by the solar spectrum (Planck's law), the
    /// single-scattering albedo by the solar spectrum times the extinction, and the phase function
    /// by the solar spectrum times the scattering coefficient. A width of 0 denotes a single
    /// wavelength.
    ///
    /// # Errors
    /// Returns an error if the width is negative, or if a setting or a wavelength is out of range.
    pub fn of_band(settings: &DropletSettings, width: f64) -> Result<Self> {
        Self::of_radii(settings, width, &default_radii())
    }

    /// The table of [`DropletTable::of_radii`]; by default for the radii of
    /// [`DropletTable::of_band`]. The process keeps the last four tables, because a table takes
    /// seconds to compute and programs that render many scenes need the same one again and again.
    ///
    /// # Errors
    /// As [`DropletTable::of_band`].
    pub fn shared(
        settings: &DropletSettings,
        width: f64,
        radii: Option<&[f64]>,
    ) -> Result<Arc<Self>> {
        let radii = radii.map_or_else(default_radii, <[f64]>::to_vec);
        let kept = || KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let contains = |(other, width_of_other, radii_of_other, _): &&KeptTable| {
            other == settings && *width_of_other == width && radii_of_other.starts_with(&radii)
        };
        if let Some((.., table)) = kept().iter().find(contains) {
            // A node depends on the smallest radius, where the integration begins, but not on the
            // largest one.
            return match table.nodes().len() == radii.len() {
                true => Ok(table.clone()),
                false => Ok(Arc::new(Self::new(table.nodes()[..radii.len()].to_vec())?)),
            };
        }
        let table = Arc::new(Self::of_radii(settings, width, &radii)?);
        let mut kept = kept();
        if kept.len() == KEPT_TABLES {
            kept.remove(0);
        }
        kept.push((*settings, width, radii, table.clone()));
        Ok(table)
    }

    /// The nodes of [`DropletTable::of_band`] up to the first one from `largest` (um) on, as from
    /// [`DropletTable::shared`]. Small droplets take a fraction of the time.
    ///
    /// # Errors
    /// As [`DropletTable::of_band`].
    pub fn shared_up_to(settings: &DropletSettings, width: f64, largest: f64) -> Result<Arc<Self>> {
        let radii = default_radii();
        let below = radii.partition_point(|radius| *radius < largest);
        Self::shared(settings, width, Some(&radii[..radii.len().min(below + 1)]))
    }

    /// As [`DropletTable::of_band`], for the given ascending effective radii (um).
    ///
    /// # Errors
    /// As [`DropletTable::of_band`].
    pub fn of_radii(settings: &DropletSettings, width: f64, radii: &[f64]) -> Result<Self> {
        if width == 0.0 {
            return Self::mie(settings, radii);
        }
        if !(width > 0.0 && width < 2.0 * settings.wavelength) {
            let range = "from 0 to less than twice the wavelength (um)";
            return Err(Error::out_of_range("width of the band", width, range));
        }
        let mut sum: Vec<Sum> = Vec::new();
        for number in 0..WAVELENGTHS {
            let place = (number as f64 + 0.5) / WAVELENGTHS as f64 - 0.5;
            let wavelength = settings.wavelength + place * width;
            let table = Self::mie(&DropletSettings { wavelength, ..*settings }, radii)?;
            let light = sunlight(wavelength);
            sum.resize_with(table.nodes().len(), Sum::default);
            sum.iter_mut().zip(table.nodes()).for_each(|(sum, node)| sum.add(light, node));
        }
        Self::new(sum.into_iter().map(Sum::mean).collect::<Result<_>>()?)
    }
}

/// Spectrally weighted sums of the optics of droplets of one effective radius.
#[derive(Debug, Default)]
struct Sum {
    effective_radius: f64,
    light: f64,
    extinction: f64,
    scattering: f64,
    densities: Vec<f64>,
}

impl Sum {
    fn add(&mut self, light: f64, node: &DropletOptics) {
        let extinction = light * node.extinction_per_water;
        let scattering = extinction * node.single_scattering_albedo;
        let cosines = cosines();
        self.effective_radius = node.effective_radius;
        self.light += light;
        self.extinction += extinction;
        self.scattering += scattering;
        self.densities.resize(cosines.len(), 0.0);
        for (sum, cosine) in self.densities.iter_mut().zip(cosines) {
            *sum += scattering * node.phase_function.density(cosine);
        }
    }

    fn mean(self) -> Result<DropletOptics> {
        Ok(DropletOptics {
            effective_radius: self.effective_radius,
            extinction_per_water: self.extinction / self.light,
            single_scattering_albedo: (self.scattering / self.extinction).min(1.0),
            phase_function: PhaseFunction::tabulated(cosines(), self.densities)?,
        })
    }
}

/// Planck's law for the temperature of the Sun as a function of wavelength (um), up to a constant.
fn sunlight(wavelength: f64) -> f64 {
    wavelength.powi(-5) / (SECOND_RADIATION / (wavelength * SUN_TEMPERATURE)).exp_m1()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The maximum of Planck's law is at 2897.77 um K divided by the temperature (Wien's law).
    /// A table is computed once, and settings that differ have different tables.
    #[test]
    fn a_table_is_shared_by_equal_settings() {
        let settings = DropletSettings::water(0.61);
        let table = |radius: f64| DropletTable::shared(&settings, 0.0, Some(&[radius])).unwrap();
        assert!(Arc::ptr_eq(&table(2.0), &table(2.0)));
        assert_eq!(*table(3.0), DropletTable::of_radii(&settings, 0.0, &[3.0]).unwrap());
        let first = table(2.0);
        (0..KEPT_TABLES).for_each(|number| drop(table(4.0 + number as f64)));
        assert!(!Arc::ptr_eq(&first, &table(2.0)));
    }

    /// The nodes up to a radius are those of the whole table, whichever is computed first.
    #[test]
    fn a_part_of_a_table_has_the_same_nodes() {
        let settings = DropletSettings::water(0.87);
        let part = DropletTable::shared_up_to(&settings, 0.0, 4.0).unwrap();
        let last = part.nodes().len() - 1;
        assert!(part.nodes()[last].effective_radius >= 4.0);
        assert!(part.nodes()[last - 1].effective_radius < 4.0);
        let whole = DropletTable::shared(&settings, 0.0, None).unwrap();
        assert_eq!(whole.nodes().len(), 41);
        assert_eq!(part.nodes(), &whole.nodes()[..=last]);
        let part = DropletTable::shared_up_to(&settings, 0.0, 2.0).unwrap();
        assert_eq!(part.nodes(), &whole.nodes()[..part.nodes().len()]);
        assert_eq!(DropletTable::shared_up_to(&settings, 0.0, 30.0).unwrap(), whole);
    }

    #[test]
    fn the_sun_shines_most_in_the_green() {
        let peak = 2897.77 / SUN_TEMPERATURE;
        assert!(sunlight(peak) > sunlight(0.99 * peak) && sunlight(peak) > sunlight(1.01 * peak));
        // Planck's law at twice the wavelength of the maximum, relative to the maximum.
        let ratio = sunlight(2.0 * peak) / sunlight(peak);
        let x = 4.965_114;
        let exact = (f64::exp(x) - 1.0) / ((f64::exp(0.5 * x) - 1.0) * 32.0);
        assert!((ratio - exact).abs() < 1e-5, "{ratio} {exact}");
    }

    /// A narrow band reproduces the single wavelength; the extinction of a wide band lies between
    /// those of its outermost wavelengths.
    #[test]
    fn a_band_is_the_mean_of_its_wavelengths() {
        let at = |wavelength, width| {
            let settings = DropletSettings::water(wavelength);
            DropletTable::of_radii(&settings, width, &[11.0]).unwrap().nodes()[0].clone()
        };
        let (one, narrow) = (at(0.67, 0.0), at(0.67, 1e-6));
        assert!((one.extinction_per_water / narrow.extinction_per_water - 1.0).abs() < 1e-5);
        let cosine = 140_f64.to_radians().cos();
        let [a, b] = [&one, &narrow].map(|node| node.phase_function.density(cosine));
        assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
        let (band, ends) = (at(0.67, 0.2), [at(0.5825, 0.0), at(0.7575, 0.0)]);
        let inside = ends[0].extinction_per_water..ends[1].extinction_per_water;
        assert!(inside.contains(&band.extinction_per_water), "{band:?}");
        let settings = DropletSettings::water(0.67);
        assert!(DropletTable::of_band(&settings, -0.1).is_err());
        assert!(DropletTable::of_band(&settings, 1.4).is_err());
    }
}
