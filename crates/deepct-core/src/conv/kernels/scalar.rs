//! The portable kernel: arrays of four floats, for which the compiler uses the vector
//! instructions of the target. The other kernels are tested against it.

use super::vector::{Element, Pair, Vector, pair};

/// A vector of four floats.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
struct Quad([f32; 4]);

impl Quad {
    #[inline(always)]
    fn zip(self, other: Self, of: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|lane| of(self.0[lane], other.0[lane])))
    }
}

// SAFETY: the methods are plain Rust, which every processor can run.
#[allow(unsafe_code)]
unsafe impl Vector for Quad {
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 4])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: upheld by the caller, see the trait; the array has the alignment of a float.
        Self(unsafe { from.cast::<[f32; 4]>().read() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { to.cast::<[f32; 4]>().write(self.0) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        self.zip(other, |left, right| left + right)
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        self.zip(other, |left, right| left - right)
    }

    #[inline(always)]
    unsafe fn mul(self, factor: Self) -> Self {
        self.zip(factor, |left, right| left * right)
    }

    /// Rounds twice, because a fused operation is a slow function call on targets without the
    /// instruction.
    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        self.zip(factor, |left, right| left * right).zip(addend, |left, right| left + right)
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        self.zip(other, |left, right| if left > right { left } else { right })
    }
}

// SAFETY: the methods are plain Rust, which every processor can run.
#[allow(unsafe_code)]
unsafe impl Element<Quad> for Pair {
    const CHANNELS: usize = 2;

    type Vector = [Pair; 4];

    #[inline(always)]
    unsafe fn splat(self) -> [Pair; 4] {
        [self; 4]
    }

    #[inline(always)]
    unsafe fn load(from: *const Pair) -> [Pair; 4] {
        // SAFETY: upheld by the caller, see the trait; the array has the alignment of a pair.
        unsafe { from.cast::<[Pair; 4]>().read() }
    }

    #[inline(always)]
    unsafe fn store(Quad([a, b, c, d]): Quad, to: *mut Pair) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { to.cast::<[Pair; 2]>().write([pair(a, b), pair(c, d)]) }
    }

    #[inline(always)]
    unsafe fn multiply_add(left: [Pair; 4], right: [Pair; 4], Quad(sums): Quad) -> Quad {
        let (low, high) =
            (|pair| f32::from_bits(pair << 16), |pair| f32::from_bits(pair & !0xffff));
        Quad(std::array::from_fn(|lane| {
            let (left, right) = (left[lane], right[lane]);
            sums[lane] + high(left) * high(right) + low(left) * low(right)
        }))
    }
}

// 4 rows by 2 vectors are 8 sums; the smallest targets have 16 registers.
super::instantiate!(
    "portable", Quad, #[inline(never)],
    rows [1, 2, 3, 4], vectors [1, 2]
);
super::instantiate_pairs!(
    Quad, #[inline(never)],
    rows [1, 2, 3, 4], vectors [1, 2]
);
