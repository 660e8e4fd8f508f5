//! Portable: arrays of four floats that the compiler turns into whatever vectors the
//! target has. The twin that the other kernels are tested against.

use super::vector::{Element, Pair, Vector, pair};

/// Four floats.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
struct Quad([f32; 4]);

impl Quad {
    #[inline(always)]
    fn zip(self, other: Self, of: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|lane| of(self.0[lane], other.0[lane])))
    }
}

// SAFETY: plain Rust, which every processor runs.
#[allow(unsafe_code)]
unsafe impl Vector for Quad {
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 4])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the trait's promise; floats need no more alignment than they have.
        Self(unsafe { from.cast::<[f32; 4]>().read() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the trait's promise.
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

    /// Rounded twice: a fused operation is a slow function call on targets without the
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

// SAFETY: plain Rust, which every processor runs.
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
        // SAFETY: the trait's promise; words need no more alignment than they have.
        unsafe { from.cast::<[Pair; 4]>().read() }
    }

    #[inline(always)]
    unsafe fn store(Quad([a, b, c, d]): Quad, to: *mut Pair) {
        // SAFETY: the trait's promise.
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

// 4 rows by 2 vectors are 8 sums of the 16 registers that the smallest targets have.
super::instantiate!(
    "portable", Quad, #[inline(never)],
    rows [1, 2, 3, 4], vectors [1, 2]
);
super::instantiate_pairs!(
    Quad, #[inline(never)],
    rows [1, 2, 3, 4], vectors [1, 2]
);
