//! The vector interface over which the inner loops are generic.

/// A vector register.
///
/// The methods are inlined into functions that are compiled for the instruction set.
///
/// # Safety
/// The methods may be called only if the processor supports the instructions of the type.
#[allow(unsafe_code)]
pub(super) unsafe trait Vector: Copy {
    /// Number of floats.
    const LANES: usize;

    /// A vector whose lanes are all equal to `value`.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn splat(value: f32) -> Self;

    /// Load the lanes from the address `from`, which need not be aligned.
    ///
    /// # Safety
    /// `LANES` floats must be readable there.
    unsafe fn load(from: *const f32) -> Self;

    /// Write the lanes to the address `to`, which need not be aligned.
    ///
    /// # Safety
    /// `LANES` floats must be writable there.
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

    /// `self * factor + addend`, rounded once if the processor supports it.
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

/// An element of a matrix: a float, or a pair of floats rounded to bfloat16, whose products are
/// summed two at a time.
///
/// # Safety
/// As for [`Vector`].
#[allow(unsafe_code)]
pub(super) unsafe trait Element<V: Vector>: Copy {
    /// Number of channels in an element.
    const CHANNELS: usize;

    /// A vector of as many elements as `V` has lanes.
    type Vector: Copy;

    /// A vector whose lanes are all equal to `self`.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn splat(self) -> Self::Vector;

    /// Load the lanes from the address `from`, which need not be aligned.
    ///
    /// # Safety
    /// As many elements as `V` has lanes must be readable there.
    unsafe fn load(from: *const Self) -> Self::Vector;

    /// Write the channels of `values` to the address `to`, as `LANES / CHANNELS` elements.
    ///
    /// # Safety
    /// That many elements must be writable there.
    unsafe fn store(values: V, to: *mut Self);

    /// `sums` plus the products of the channels of two elements, lane by lane.
    ///
    /// # Safety
    /// As for the trait.
    unsafe fn multiply_add(left: Self::Vector, right: Self::Vector, sums: V) -> V;
}

// SAFETY: the methods call those of the vector.
#[allow(unsafe_code)]
unsafe impl<V: Vector> Element<V> for f32 {
    const CHANNELS: usize = 1;

    type Vector = V;

    #[inline(always)]
    unsafe fn splat(self) -> V {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { V::splat(self) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> V {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { V::load(from) }
    }

    #[inline(always)]
    unsafe fn store(values: V, to: *mut f32) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { values.store(to) }
    }

    #[inline(always)]
    unsafe fn multiply_add(left: V, right: V, sums: V) -> V {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { left.mul_add(right, sums) }
    }
}

/// Two bfloat16 numbers, the first in the lower half. A bfloat16 number consists of the 16 higher
/// bits of a float, rounded to nearest, ties to even.
pub(crate) type Pair = u32;

/// Round two floats to bfloat16 and pack them.
#[inline(always)]
pub(crate) fn pair(low: f32, high: f32) -> Pair {
    let rounded = |value: f32| u32::from(half::bf16::from_f32(value).to_bits());
    rounded(low) | rounded(high) << 16
}
