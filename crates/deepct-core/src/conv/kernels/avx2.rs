//! The kernel for AVX2 with FMA: 8 floats per register, 16 registers.

use super::vector::Vector;
use std::arch::x86_64::{
    __m256, _mm256_add_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_mul_ps,
    _mm256_set1_ps, _mm256_storeu_ps, _mm256_sub_ps,
};

// SAFETY: every method is one instruction of AVX and FMA.
#[allow(unsafe_code)]
unsafe impl Vector for __m256 {
    const LANES: usize = 8;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_set1_ps(value) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, factor: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_mul_ps(self, factor) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_fmadd_ps(self, factor, addend) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm256_max_ps(self, other) }
    }
}

// 6 rows by 2 vectors are 12 sums, which leaves registers for 2 weights and the value of a row.
super::instantiate!(
    "avx2", __m256, #[target_feature(enable = "avx2,fma")],
    rows [1, 2, 3, 4, 5, 6], vectors [1, 2]
);
