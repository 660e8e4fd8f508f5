//! The optics of droplets as a function of effective radius.

use super::scattering::check_albedo;
use super::{Collision, PhaseFunction};
use crate::error::{Error, Result};

/// The optics of a droplet population at one wavelength: a node of a [`DropletTable`].
#[derive(Debug, Clone, PartialEq)]
pub struct DropletOptics {
    /// Effective radius (um).
    pub effective_radius: f64,
    /// Extinction per liquid water content (1/km per g/m3).
    pub extinction_per_water: f64,
    /// Single-scattering albedo (dimensionless).
    pub single_scattering_albedo: f64,
    /// Phase function.
    pub phase_function: PhaseFunction,
}

/// The optics of droplets at one wavelength and effective variance as a function of effective
/// radius.
#[derive(Debug, Clone, PartialEq)]
pub struct DropletTable {
    nodes: Vec<DropletOptics>,
}

/// Droplets with an effective radius between two nodes of a [`DropletTable`]: a mixture of those
/// of the node `first` and of the next node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mixture {
    /// Index of the node with the smaller radius.
    pub first: usize,
    /// The fraction of the scattered light that is due to the droplets of the second node.
    pub share: f64,
    /// Extinction per liquid water content (1/km per g/m3).
    pub extinction_per_water: f64,
    /// Single-scattering albedo (dimensionless).
    pub single_scattering_albedo: f64,
}

/// The derivative of a [`Mixture`] with respect to its effective radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MixtureDerivative {
    /// That of the extinction per liquid water content (1/km per g/m3, per um).
    pub extinction_per_water: f64,
    /// Those of the probabilities that a collision scatters according to the phase function of the
    /// first and of the second node (1/um).
    pub scattering: [f64; 2],
}

/// Droplets of an effective radius, divided between two nodes.
struct Division<'a> {
    first: usize,
    nodes: [&'a DropletOptics; 2],
    /// Fraction of the liquid water in droplets of the second node, and its derivative (1/um).
    water: f64,
    slope: f64,
}

impl DropletTable {
    /// A table of nodes.
    ///
    /// # Errors
    /// Returns an error if there is no node, if the radii do not ascend or are not positive, if an
    /// extinction is not positive, or if a single-scattering albedo is outside `[0, 1]`.
    pub fn new(nodes: Vec<DropletOptics>) -> Result<Self> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        for node in &nodes {
            check_albedo(node.single_scattering_albedo)?;
            if !positive(node.extinction_per_water) {
                let range = "positive (1/km per g/m3)";
                let value = node.extinction_per_water;
                return Err(Error::out_of_range(
                    "extinction per liquid water content",
                    value,
                    range,
                ));
            }
        }
        let radii: Vec<f64> = nodes.iter().map(|node| node.effective_radius).collect();
        if radii.is_empty() || !radii.is_sorted_by(|a, b| a < b) || !positive(radii[0]) {
            return Err(Error::out_of_range(
                "effective radii of a droplet table",
                format!("{radii:?}"),
                "one or more that ascend (um)",
            ));
        }
        Ok(Self { nodes })
    }

    /// The nodes in order of ascending effective radius.
    pub fn nodes(&self) -> &[DropletOptics] {
        &self.nodes
    }

    /// Droplets of an effective radius (um) as a mixture of those of the two adjacent nodes, or
    /// those of the first or last node if the radius is beyond the table.
    ///
    /// The liquid water is divided between the two nodes such that the mixture has the given
    /// effective radius. Because the effective radius is three times the volume over the surface
    /// area, its inverse is linear in the fraction of the water, and so is the extinction.
    #[inline]
    pub fn mixture(&self, effective_radius: f64) -> Mixture {
        let Division { first, nodes: [a, b], water, .. } = self.division(effective_radius);
        let (from_a, from_b) =
            ((1.0 - water) * a.extinction_per_water, water * b.extinction_per_water);
        let extinction_per_water = from_a + from_b;
        let scattered_by_b = from_b * b.single_scattering_albedo;
        let scattered = from_a * a.single_scattering_albedo + scattered_by_b;
        Mixture {
            first,
            share: if scattered_by_b > 0.0 { scattered_by_b / scattered } else { 0.0 },
            extinction_per_water,
            single_scattering_albedo: (scattered / extinction_per_water).min(1.0),
        }
    }

    /// The derivative of [`DropletTable::mixture`] with respect to the effective radius, which is
    /// that of the interval above the radius at a node, and 0 beyond the table.
    pub fn mixture_derivative(&self, effective_radius: f64) -> MixtureDerivative {
        let Division { nodes: [a, b], water, slope, .. } = self.division(effective_radius);
        let extinction = (1.0 - water) * a.extinction_per_water + water * b.extinction_per_water;
        // Of the extinction, the second node has the fraction water * b / extinction.
        let change =
            slope * a.extinction_per_water * b.extinction_per_water / (extinction * extinction);
        MixtureDerivative {
            extinction_per_water: slope * (b.extinction_per_water - a.extinction_per_water),
            scattering: [-change * a.single_scattering_albedo, change * b.single_scattering_albedo],
        }
    }

    #[inline]
    fn division(&self, effective_radius: f64) -> Division<'_> {
        let above = self.nodes.partition_point(|node| node.effective_radius <= effective_radius);
        let first = above.saturating_sub(1).min(self.nodes.len().saturating_sub(2));
        let nodes = [&self.nodes[first], &self.nodes[self.second(first)]];
        let [least, most] = nodes.map(|node| node.effective_radius);
        let inverse = 1.0 / effective_radius.clamp(least, most);
        let (from, to) = (1.0 / least, 1.0 / most);
        let (water, slope) = match from > to {
            true => ((from - inverse) / (from - to), inverse * inverse / (from - to)),
            false => (0.0, 0.0),
        };
        let inside = (least..=most).contains(&effective_radius);
        Division { first, nodes, water, slope: if inside { slope } else { 0.0 } }
    }

    /// The scattering properties of a mixture.
    #[inline]
    pub fn collision(&self, mixture: &Mixture) -> Collision<'_> {
        let second = self.second(mixture.first);
        let phase = |node: usize| &self.nodes[node].phase_function;
        Collision {
            single_scattering_albedo: mixture.single_scattering_albedo,
            phase_functions: [phase(mixture.first), phase(second)],
            share: mixture.share,
        }
    }

    /// The index of the next node, or of the same node if it is the last.
    pub(super) fn second(&self, first: usize) -> usize {
        (first + 1).min(self.nodes.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Scattering;
    use std::sync::Arc;

    fn table() -> DropletTable {
        let node = |effective_radius, extinction_per_water, single_scattering_albedo, asymmetry| {
            let phase_function = PhaseFunction::henyey_greenstein(asymmetry).unwrap();
            DropletOptics {
                effective_radius,
                extinction_per_water,
                single_scattering_albedo,
                phase_function,
            }
        };
        DropletTable::new(vec![
            node(5.0, 320.0, 1.0, 0.84),
            node(10.0, 156.0, 0.95, 0.86),
            node(20.0, 77.0, 0.9, 0.87),
        ])
        .unwrap()
    }

    /// Two populations computed by hand: of 1 g/m3 of water, the fraction `share` is in droplets of
    /// 10 um and the rest in droplets of 5 um. The surface area is 3 volume / reff.
    #[test]
    fn a_mixture_is_two_populations_of_droplets() {
        let share = 0.3;
        let surface = 3.0 * (1.0 - share) / 5.0 + 3.0 * share / 10.0;
        let found = table().mixture(3.0 / surface);
        let extinction = (1.0 - share) * 320.0 + share * 156.0;
        let scattering = (1.0 - share) * 320.0 + share * 156.0 * 0.95;
        assert_eq!(found.first, 0);
        assert!((found.extinction_per_water - extinction).abs() < 1e-9);
        assert!((found.single_scattering_albedo - scattering / extinction).abs() < 1e-12);
        assert!((found.share - share * 156.0 * 0.95 / scattering).abs() < 1e-12);
    }

    #[test]
    fn nodes_are_themselves_and_the_ends_go_on() {
        let table = table();
        for (radius, expected) in
            [(5.0, 320.0), (10.0, 156.0), (20.0, 77.0), (2.0, 320.0), (50.0, 77.0), (0.0, 320.0)]
        {
            let found = table.mixture(radius);
            assert!((found.extinction_per_water - expected).abs() < 1e-9, "{radius} um");
        }
        let asymmetry = table.collision(&table.mixture(20.0)).asymmetry();
        assert!((asymmetry - 0.87).abs() < 1e-12);
    }

    /// The probabilities of scattering are linear in the mixture of two populations, and the
    /// derivative is that of central differences.
    #[test]
    fn mixtures_have_their_derivatives() {
        let table = table();
        let values = |radius: f64| {
            let found = table.mixture(radius);
            let albedo = found.single_scattering_albedo;
            [found.extinction_per_water, albedo * (1.0 - found.share), albedo * found.share]
        };
        for radius in [5.3, 8.0, 11.0, 19.0] {
            let [above, below] = [radius + 1e-4, radius - 1e-4].map(values);
            let MixtureDerivative { extinction_per_water, scattering: [a, b] } =
                table.mixture_derivative(radius);
            for (n, found) in [extinction_per_water, a, b].into_iter().enumerate() {
                let difference = (above[n] - below[n]) / 2e-4;
                assert!((found / difference - 1.0).abs() < 1e-6, "{radius}: {found} {difference}");
            }
        }
        for beyond in [0.0, 4.9, 20.1] {
            assert_eq!(table.mixture_derivative(beyond).scattering, [0.0; 2]);
        }
    }

    #[test]
    fn a_collision_is_the_weighted_sum_of_two() {
        let table = table();
        let collision = table.collision(&Mixture { share: 0.25, ..table.mixture(15.0) });
        let [a, b] = [1, 2].map(|node| table.nodes()[node].phase_function.density(0.9));
        assert!((collision.density(0.9) - (0.75 * a + 0.25 * b)).abs() < 1e-12);
        // Half of the share of each phase function is mapped to below its median.
        let [a, b] = [1, 2].map(|node| table.nodes()[node].phase_function.sample(0.5));
        assert!((collision.sample(0.125) - b).abs() < 1e-12);
        assert!((collision.sample(0.625) - a).abs() < 1e-12);
    }

    #[test]
    fn shares_are_what_a_collision_does() {
        let effective_radius = ndarray::array![[[5.0, 7.0, 15.0, 30.0]]];
        let scattering = Scattering::Droplets { effective_radius, table: Arc::new(table()) };
        let functions = scattering.phase_functions();
        for i in 0..4 {
            let collision = scattering.at([0, 0, i]);
            let shares = scattering.shares([0, 0, i]);
            let density: f64 =
                shares.iter().map(|(n, share)| share * functions[*n].density(0.3)).sum();
            let expected = collision.single_scattering_albedo * collision.density(0.3);
            assert!((density - expected).abs() < 1e-12, "{i}: {density} {expected}");
        }
    }

    #[test]
    fn tables_without_order_are_refused() {
        let nodes = table().nodes().to_vec();
        assert!(DropletTable::new(Vec::new()).is_err());
        assert!(DropletTable::new(nodes.iter().rev().cloned().collect()).is_err());
        assert!(DropletTable::new(nodes[..1].to_vec()).unwrap().mixture(7.0).share == 0.0);
    }
}
