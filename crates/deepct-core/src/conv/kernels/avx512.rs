//! The kernel for AVX-512: 16 floats per register, 32 registers.

use super::vector::{Element, Pair, Vector};
use std::arch::x86_64::{
    __m256bh, __m256i, __m512, __m512bh, __m512i, _mm256_storeu_si256, _mm512_add_ps,
    _mm512_cvtneps_pbh, _mm512_dpbf16_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_loadu_si512,
    _mm512_max_ps, _mm512_mul_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_storeu_ps,
    _mm512_sub_ps,
};
use std::mem::transmute;

// SAFETY: every method is one instruction of AVX-512F.
#[allow(unsafe_code)]
unsafe impl Vector for __m512 {
    const LANES: usize = 16;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_set1_ps(value) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, factor: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_mul_ps(self, factor) }
    }

    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_fmadd_ps(self, factor, addend) }
    }

    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_max_ps(self, other) }
    }
}

// SAFETY: every method is one instruction of AVX-512F or AVX-512 BF16.
#[allow(unsafe_code)]
unsafe impl Element<__m512> for Pair {
    const CHANNELS: usize = 2;

    type Vector = __m512i;

    #[inline(always)]
    unsafe fn splat(self) -> __m512i {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_set1_epi32(self.cast_signed()) }
    }

    #[inline(always)]
    unsafe fn load(from: *const Pair) -> __m512i {
        // SAFETY: upheld by the caller, see the trait.
        unsafe { _mm512_loadu_si512(from.cast()) }
    }

    #[inline(always)]
    unsafe fn store(values: __m512, to: *mut Pair) {
        // SAFETY: upheld by the caller, see the trait; any 256 bits are valid for both types.
        unsafe {
            let rounded = transmute::<__m256bh, __m256i>(_mm512_cvtneps_pbh(values));
            _mm256_storeu_si256(to.cast(), rounded);
        }
    }

    #[inline(always)]
    unsafe fn multiply_add(left: __m512i, right: __m512i, sums: __m512) -> __m512 {
        // SAFETY: upheld by the caller, see the trait; any 512 bits are valid for both types.
        unsafe {
            let [left, right] = [left, right].map(|pairs| transmute::<__m512i, __m512bh>(pairs));
            _mm512_dpbf16_ps(sums, left, right)
        }
    }
}

// 8 rows by 3 vectors are 24 sums, which leaves registers for 3 weights and the value of a row.
super::instantiate!(
    "avx512", __m512, #[target_feature(enable = "avx512f")],
    rows [1, 2, 3, 4, 5, 6, 7, 8], vectors [1, 2, 3]
);
super::instantiate_pairs!(
    __m512, #[target_feature(enable = "avx512f,avx512bf16")],
    rows [1, 2, 3, 4, 5, 6, 7, 8], vectors [1, 2, 3]
);
