//! The kernel for NEON: 4 floats per register, 32 registers.

use super::vector::Vector;
use std::arch::aarch64::{
    float32x4_t, vaddq_f32, vdupq_n_f32, vfmaq_f32, vld1q_f32, vmaxq_f32, vmulq_f32, vst1q_f32,
    vsubq_f32,
};

// SAFETY: every method is one NEON instruction; `vfmaq_f32` takes the addend first.
#[allow(unsafe_code)]
unsafe impl Vector for float32x4_t {
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vdupq_n_f32(value) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vld1q_f32(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vst1q_f32(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vaddq_f32(self, other) }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vsubq_f32(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, factor: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vmulq_f32(self, factor) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vfmaq_f32(addend, self, factor) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { vmaxq_f32(self, other) }
    }
}

// 6 rows by 4 vectors are 24 sums, which leaves registers for 4 weights and the value of a row.
super::instantiate!(
    "neon", float32x4_t, #[target_feature(enable = "neon")],
    rows [1, 2, 3, 4, 5, 6], vectors [1, 2, 3, 4]
);
