//! Directions and rays.
//!
//! Axes are right-handed: x east, y north, z up. Angles are in radians in this module; degrees
//! occur only in inputs and outputs of the program, under names that end in `_deg`.

pub use glam::DVec3;
use pulp::WithSimd;

/// Nodes of the two-point Gauss-Legendre rule on [0, 1], both of weight 1/2.
pub(crate) const GAUSS_TWO: [f64; 2] = [0.211_324_865_405_187_13, 0.788_675_134_594_812_9];

/// Weights of the eight corners of a cell in trilinear interpolation at a position in it, from 0 to 1
/// along x, y, z; bit 0 of a corner's number is its side along x, bit 1 along y, bit 2 along z.
#[inline]
pub(crate) fn corner_weights(at: DVec3) -> [f64; 8] {
    let pairs = [at.x, at.y, at.z].map(|x| [1.0 - x, x]);
    std::array::from_fn(|c| pairs[0][c & 1] * pairs[1][c >> 1 & 1] * pairs[2][c >> 2])
}

/// A half-line in space: `origin + distance * direction`, distance in km.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where the ray starts (km).
    pub origin: DVec3,
    /// Unit vector along the ray.
    pub direction: DVec3,
}

impl Ray {
    /// The point at `distance` km along the ray.
    pub fn at(&self, distance: f64) -> DVec3 {
        self.origin + distance * self.direction
    }
}

/// Unit vector from the scene towards a point seen at the angle `zenith` from +z and at `azimuth`
/// clockwise from north (both in radians).
pub fn towards(zenith: f64, azimuth: f64) -> DVec3 {
    let (sin_zenith, cos_zenith) = zenith.sin_cos();
    let (sin_azimuth, cos_azimuth) = azimuth.sin_cos();
    DVec3::new(sin_zenith * sin_azimuth, sin_zenith * cos_azimuth, cos_zenith)
}

/// The zenith angle and azimuth (radians, azimuth in `[0, 2 pi)`) of a vector that points away from
/// the scene; the inverse of [`towards`].
pub fn zenith_and_azimuth(vector: DVec3) -> (f64, f64) {
    let horizontal = vector.x.hypot(vector.y);
    let zenith = horizontal.atan2(vector.z);
    if horizontal == 0.0 {
        return (zenith, 0.0);
    }
    (zenith, vector.x.atan2(vector.y).rem_euclid(std::f64::consts::TAU))
}

/// Rotates the unit vector `axis` by a polar angle with the given cosine and by an `azimuth`
/// (radians) about the original direction: it applies a scattering angle to a direction of
/// propagation.
///
/// The frame around `axis` is that of Duff et al. (2017), "Building an orthonormal basis,
/// revisited", which needs no special case at the poles.
#[inline]
pub fn deflect(axis: DVec3, cosine: f64, azimuth: f64) -> DVec3 {
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let sign = 1.0_f64.copysign(axis.z);
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    let tangent = DVec3::new(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x);
    let bitangent = DVec3::new(b, sign + axis.y * axis.y * a, -axis.y);
    let (sin_azimuth, cos_azimuth) = azimuth.sin_cos();
    (sine * cos_azimuth * tangent + sine * sin_azimuth * bitangent + cosine * axis).normalize()
}

/// Runs code that is generic over the vector width with the vector instructions of the processor:
/// 256 bits wide on x86-64 processors that support them.
///
/// `pulp::Arch` would also select 512 bits as soon as any crate of the program enables them, but
/// arrays padded to multiples of eight numbers do not allow vectors of sixteen.
#[inline]
pub(crate) fn with_vectors<Op: WithSimd>(op: Op) -> Op::Output {
    #[cfg(target_arch = "x86_64")]
    {
        use pulp::Simd;
        match pulp::x86::V3::try_new() {
            Some(simd) => Simd::vectorize(simd, op),
            None => Simd::vectorize(pulp::Scalar, op),
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    pulp::Arch::new().dispatch(op)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuth_is_clockwise_from_north() {
        let east = towards(std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2);
        assert!((east - DVec3::X).length() < 1e-12);
        let (zenith, azimuth) = zenith_and_azimuth(towards(0.7, 4.0));
        assert!((zenith - 0.7).abs() < 1e-12 && (azimuth - 4.0).abs() < 1e-12);
    }

    #[test]
    fn deflection_keeps_length_and_angle() {
        for axis in [DVec3::Z, -DVec3::Z, DVec3::X, towards(1.1, 2.2)] {
            for cosine in [-1.0, -0.3, 0.0, 0.999, 1.0] {
                let turned = deflect(axis, cosine, 0.8);
                assert!((turned.length() - 1.0).abs() < 1e-12);
                assert!((turned.dot(axis) - cosine).abs() < 1e-12);
            }
        }
    }
}
