//! What the inner loops want of a vector of floats: they are written once, over this.

/// A vector register.
///
/// Its methods are inlined into functions that are compiled for the instructions.
///
/// # Safety
/// The methods may run only where the processor has the instructions of the type.
#[allow(unsafe_code)]
pub(super) unsafe trait Vector: Copy {
    /// Number of floats.
    const LANES: usize;

    /// All lanes the same.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn splat(value: f32) -> Self;

    /// The lanes from `from` on, which need no alignment.
    ///
    /// # Safety
    /// That many floats can be read there.
    unsafe fn load(from: *const f32) -> Self;

    /// Write the lanes to `to` on, which needs no alignment.
    ///
    /// # Safety
    /// That many floats can be written there.
    unsafe fn store(self, to: *mut f32);

    /// `self + other`.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn add(self, other: Self) -> Self;

    /// `self - other`.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn sub(self, other: Self) -> Self;

    /// `self * factor`.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn mul(self, factor: Self) -> Self;

    /// `self * factor + addend`, rounded once where the processor can.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self;

    /// The larger of each pair of lanes.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn max(self, other: Self) -> Self;
}

/// What matrices are made of: floats, or pairs of floats rounded to bfloat16, whose
/// products are summed two at a time.
///
/// # Safety
/// As for [`Vector`].
#[allow(unsafe_code)]
pub(super) unsafe trait Element<V: Vector>: Copy {
    /// Channels that an element holds.
    const CHANNELS: usize;

    /// As many elements as `V` has lanes.
    type Vector: Copy;

    /// All lanes the same.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn splat(self) -> Self::Vector;

    /// The lanes from `from` on, which need no alignment.
    ///
    /// # Safety
    /// That many elements can be read there.
    unsafe fn load(from: *const Self) -> Self::Vector;

    /// Write the channels of `values` to `to` on, as `LANES / CHANNELS` elements.
    ///
    /// # Safety
    /// That many elements can be written there.
    unsafe fn store(values: V, to: *mut Self);

    /// `sums` and the products of the channels of two elements in each lane.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn multiply_add(left: Self::Vector, right: Self::Vector, sums: V) -> V;
}

// SAFETY: as for the vector.
#[allow(unsafe_code)]
unsafe impl<V: Vector> Element<V> for f32 {
    const CHANNELS: usize = 1;

    type Vector = V;

    #[inline(always)]
    unsafe fn splat(self) -> V {
        // SAFETY: the trait's promise.
        unsafe { V::splat(self) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> V {
        // SAFETY: the trait's promise.
        unsafe { V::load(from) }
    }

    #[inline(always)]
    unsafe fn store(values: V, to: *mut f32) {
        // SAFETY: the trait's promise.
        unsafe { values.store(to) }
    }

    #[inline(always)]
    unsafe fn multiply_add(left: V, right: V, sums: V) -> V {
        // SAFETY: the trait's promise.
        unsafe { left.mul_add(right, sums) }
    }
}

/// Two numbers rounded to bfloat16, the first in the lower half: the 16 higher bits of a
/// float, rounded to nearest, ties to even.
pub(crate) type Pair = u32;

/// Round two floats.
#[inline(always)]
pub(crate) fn pair(low: f32, high: f32) -> Pair {
    let rounded = |value: f32| u32::from(half::bf16::from_f32(value).to_bits());
    rounded(low) | rounded(high) << 16
}
