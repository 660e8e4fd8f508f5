//! Macros that compile the loops of a kernel for an instruction set.
//!
//! They are invoked in the file of each instruction set; names that begin with `super::` refer to
//! the parent module of that file.

/// Run `$body` with the constant `$constant` equal to `$value`, which is one of the numbers.
macro_rules! with_constant {
    ($constant:ident = $value:expr, in [$($number:literal),*], $body:expr) => {
        match $value {
            $($number => {
                const $constant: usize = $number;
                $body
            })*
            other => unreachable!("{other} at once"),
        }
    };
}
pub(super) use with_constant;

/// Compile the loops for a vector type as `LOOPS`, given the name of the kernel, the attribute
/// that selects the instruction set, and the numbers of rows and of vectors of sums that the
/// registers can hold.
macro_rules! instantiate {
    ($name:literal, $vector:ty, #[$($attribute:tt)*], rows $rows:tt, vectors $vectors:tt) => {
        use super::multiply::{self, PointProducts, SegmentSum};
        use super::winograd::{self, Four, ProductRow, TileRow, Two};

        pub(super) static LOOPS: super::Loops = super::Loops {
            name: $name,
            lanes: <$vector as Vector>::LANES,
            vectors: super::largest(&$vectors),
            sum_segments,
            products: super::ProductLoops {
                channels: 1,
                input: [input_two, input_four],
                multiply,
            },
            output: [output_two, output_four],
        };

        /// # Safety
        /// The processor must support the instructions, and the slices must have been checked.
        #[allow(unsafe_code)]
        #[$($attribute)*]
        unsafe fn sum_segments(product: &SegmentSum<'_>, out: &mut [f32]) {
            for rows in super::even_parts(product.rows, super::largest(&$rows)) {
                let first = rows.start;
                super::with_constant!(VECTORS = product.vectors, in $vectors, {
                    super::with_constant!(ROWS = rows.len(), in $rows, {
                        // SAFETY: upheld by the caller.
                        unsafe {
                            multiply::segment_block::<$vector, ROWS, VECTORS>(product, first, out)
                        }
                    })
                });
            }
        }

        super::instantiate_products!(
            f32, $vector, #[$($attribute)*], rows $rows, vectors $vectors,
            multiply, input_two, input_four
        );
        super::instantiate_transform!(
            output_two(ProductRow, f32), #[$($attribute)*], winograd::output::<$vector, Two, 4, 2>
        );
        super::instantiate_transform!(
            output_four(ProductRow, f32), #[$($attribute)*], winograd::output::<$vector, Four, 6, 4>
        );
    };
}
pub(super) use instantiate;

/// Compile the loops for pairs of bfloat16 numbers as `PAIR_LOOPS`.
macro_rules! instantiate_pairs {
    ($vector:ty, #[$($attribute:tt)*], rows $rows:tt, vectors $vectors:tt) => {
        pub(super) static PAIR_LOOPS: super::ProductLoops<Pair> = super::ProductLoops {
            channels: 2,
            input: [pair_input_two, pair_input_four],
            multiply: pair_multiply,
        };

        super::instantiate_products!(
            Pair, $vector, #[$($attribute)*], rows $rows, vectors $vectors,
            pair_multiply, pair_input_two, pair_input_four
        );
    };
}
pub(super) use instantiate_pairs;

/// Compile the matrix products for an element type and the transforms that compute their left
/// matrices.
macro_rules! instantiate_products {
    (
        $element:ty, $vector:ty, #[$($attribute:tt)*], rows $rows:tt, vectors $vectors:tt,
        $multiply:ident, $input_two:ident, $input_four:ident
    ) => {
        /// # Safety
        /// The processor must support the instructions, and the slices must have been checked.
        #[allow(unsafe_code)]
        #[$($attribute)*]
        unsafe fn $multiply(products: &PointProducts<'_, $element>, out: &mut [f32]) {
            for rows in super::even_parts(products.rows, super::largest(&$rows)) {
                let first = rows.start;
                super::with_constant!(VECTORS = products.vectors, in $vectors, {
                    super::with_constant!(ROWS = rows.len(), in $rows, {
                        // SAFETY: upheld by the caller.
                        unsafe {
                            multiply::point_block::<$vector, $element, ROWS, VECTORS>(
                                products, first, out,
                            )
                        }
                    })
                });
            }
        }

        super::instantiate_transform!(
            $input_two(TileRow, $element), #[$($attribute)*],
            winograd::input::<$vector, $element, Two, 4, 2>
        );
        super::instantiate_transform!(
            $input_four(TileRow, $element), #[$($attribute)*],
            winograd::input::<$vector, $element, Four, 6, 4>
        );
    };
}
pub(super) use instantiate_products;

/// Compile a transform.
macro_rules! instantiate_transform {
    ($name:ident($source:ident, $out:ty), #[$($attribute:tt)*], $transform:expr) => {
        /// # Safety
        /// The processor must support the instructions, and the slices must have been checked.
        #[allow(unsafe_code)]
        #[$($attribute)*]
        unsafe fn $name(source: &$source<'_>, out: &mut [$out]) {
            // SAFETY: upheld by the caller.
            unsafe { $transform(source, out) }
        }
    };
}
pub(super) use instantiate_transform;
