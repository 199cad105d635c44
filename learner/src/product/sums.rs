//! What becomes of sums.
#![expect(unsafe_code, reason = "instructions of detected processor features")]

use std::arch::x86_64::{__m512, _mm512_add_ps};
use std::marker::PhantomData;

use super::registers::{BOTH, add, load, load_widened, rounded, store, store_rounded};
use super::units::{Activations, Biases, Gradients};
use crate::lanes::{Avx512, Registers};
use crate::number::Bf16;
use crate::unit::{Elu, Nonlinearity, Relu};

/// Units of a panel's row.
pub(super) type ReluUnits = Relu<Registers<2>>;
pub(super) type EluUnits = Elu<Registers<2>>;

/// Some rows of a product at some columns, which are put one after the other.
#[derive(Clone, Copy)]
pub(super) struct Rows {
    /// How many.
    pub(super) count: usize,
    pub(super) first: usize,
    /// The first column: of a panel, or of what there is of one.
    pub(super) column: usize,
    /// Of the product.
    pub(super) columns: usize,
}

impl Rows {
    /// Columns of this panel: 32, or fewer in the last one.
    #[inline(always)]
    fn len(self) -> usize {
        BOTH.min(self.columns - self.column)
    }

    /// Where they begin.
    ///
    /// # Panics
    /// If they are not within so many numbers.
    #[inline(always)]
    fn begin(self, numbers: usize) -> usize {
        let begin = self.first * self.columns + self.column;
        if self.count > 0 {
            let end = begin + (self.count - 1) * self.columns + self.len();
            assert!(end <= numbers, "the product has fewer rows");
        }
        begin
    }
}

/// Takes sums over, row by row: an [`Out`](super::operands::Out), as loops are compiled for it.
pub(super) trait Put {
    /// Where the next row belongs, and what is known of those that come.
    type Next;

    /// Before some rows are put.
    ///
    /// # Safety
    /// Called from code that is compiled for AVX-512 with bfloat16.
    unsafe fn begin(&mut self, rows: Rows) -> Self::Next;

    /// Puts a row's sums, as many as there are columns of its panel, and goes on to the next row.
    ///
    /// # Safety
    /// As for [`Self::begin`], and after it, at most as often as there are rows. Meanwhile nobody else uses what is written.
    unsafe fn put(next: &mut Self::Next, sums: [__m512; 2]);
}

/// A place among rows, and how far it is to that in the next row.
#[derive(Clone, Copy)]
pub(super) struct Place<T> {
    at: *mut T,
    columns: usize,
    len: usize,
}

impl<T> Place<T> {
    #[inline(always)]
    fn new(numbers: &mut [T], rows: Rows) -> Self {
        let begin = rows.begin(numbers.len());
        Self {
            at: numbers.as_mut_ptr().wrapping_add(begin),
            columns: rows.columns,
            len: rows.len(),
        }
    }

    #[inline(always)]
    fn go_on(&mut self) {
        self.at = self.at.wrapping_add(self.columns);
    }
}

/// The biases of a row, and how far it is to those of the next.
#[derive(Clone, Copy)]
pub(super) struct BiasPlace {
    at: *mut f32,
    step: usize,
    /// Rows after which they begin anew.
    left: usize,
    actors: usize,
}

impl BiasPlace {
    #[inline(always)]
    fn new(numbers: *mut f32, len: usize, biases: Biases, rows: Rows) -> Self {
        let Biases { first, step, actors } = biases;
        let last = first + (actors - 1) * step + rows.column + rows.len();
        assert!(last <= len, "the layer has fewer biases");
        let actor = rows.first % actors;
        let at = first + actor * step + rows.column;
        Self { at: numbers.wrapping_add(at), step, left: actors - actor, actors }
    }

    #[inline(always)]
    fn go_on(&mut self) {
        self.at = self.at.wrapping_add(self.step);
        self.left -= 1;
        if self.left == 0 {
            self.at = self.at.wrapping_sub(self.step * self.actors);
            self.left = self.actors;
        }
    }
}

/// Rounded.
pub(super) struct Rounded<'a>(pub(super) &'a mut [Bf16]);

impl Put for Rounded<'_> {
    type Next = Place<Bf16>;

    #[inline(always)]
    unsafe fn begin(&mut self, rows: Rows) -> Place<Bf16> {
        Place::new(self.0, rows)
    }

    #[inline(always)]
    unsafe fn put(next: &mut Place<Bf16>, sums: [__m512; 2]) {
        // SAFETY: the caller's promise.
        unsafe { store_rounded(sums, next.at, next.len) };
        next.go_on();
    }
}

/// Rounded and widened.
pub(super) struct Widened<'a>(pub(super) &'a mut [f32]);

impl Put for Widened<'_> {
    type Next = Place<f32>;

    #[inline(always)]
    unsafe fn begin(&mut self, rows: Rows) -> Place<f32> {
        Place::new(self.0, rows)
    }

    #[inline(always)]
    unsafe fn put(next: &mut Place<f32>, sums: [__m512; 2]) {
        // SAFETY: the caller's promise.
        unsafe { store(rounded(sums), next.at, next.len) };
        next.go_on();
    }
}

/// Rounded, widened and added.
pub(super) struct Added<'a>(pub(super) &'a mut [f32]);

impl Put for Added<'_> {
    type Next = Place<f32>;

    #[inline(always)]
    unsafe fn begin(&mut self, rows: Rows) -> Place<f32> {
        Place::new(self.0, rows)
    }

    #[inline(always)]
    unsafe fn put(next: &mut Place<f32>, sums: [__m512; 2]) {
        // SAFETY: the caller's promise.
        unsafe { add(rounded(sums), next.at, next.len) };
        next.go_on();
    }
}

/// Through units `N`.
pub(super) struct Through<'a, N>(Activations<'a>, PhantomData<N>);

impl<'a, N> Through<'a, N> {
    pub(super) fn new(units: Activations<'a>) -> Self {
        Self(units, PhantomData)
    }
}

impl<N: Nonlinearity<Registers<2>>> Put for Through<'_, N> {
    type Next = (Place<Bf16>, BiasPlace, N);

    #[inline(always)]
    unsafe fn begin(&mut self, rows: Rows) -> Self::Next {
        let Activations { bias, biases, out, .. } = &mut self.0;
        let bias = BiasPlace::new(bias.as_ptr().cast_mut(), bias.len(), *biases, rows);
        // SAFETY: the caller's promise.
        (Place::new(out, rows), bias, N::new(unsafe { Avx512::new() }))
    }

    #[inline(always)]
    unsafe fn put((place, bias, unit): &mut Self::Next, sums: [__m512; 2]) {
        // SAFETY: the caller's promise.
        unsafe {
            let [first, second] = rounded(sums);
            let biases = load(bias.at, place.len);
            let x = [_mm512_add_ps(first, biases[0]), _mm512_add_ps(second, biases[1])];
            let made = unit.of::<true>(Registers::new(Avx512::new(), x)).get();
            store_rounded(made, place.at, place.len);
        }
        place.go_on();
        bias.go_on();
    }
}

/// Back through units `N`.
pub(super) struct Back<'a, N>(Gradients<'a>, PhantomData<N>);

impl<'a, N> Back<'a, N> {
    pub(super) fn new(units: Gradients<'a>) -> Self {
        Self(units, PhantomData)
    }
}

impl<N: Nonlinearity<Registers<2>>> Put for Back<'_, N> {
    type Next = (Place<Bf16>, *const Bf16, BiasPlace, N);

    #[inline(always)]
    unsafe fn begin(&mut self, rows: Rows) -> Self::Next {
        let Gradients { hidden, bias_gradient, biases, out, .. } = &mut self.0;
        let hidden = hidden.as_ptr().wrapping_add(rows.begin(hidden.len()));
        let len = bias_gradient.len();
        let bias = BiasPlace::new(bias_gradient.as_mut_ptr(), len, *biases, rows);
        // SAFETY: the caller's promise.
        (Place::new(out, rows), hidden, bias, N::new(unsafe { Avx512::new() }))
    }

    #[inline(always)]
    unsafe fn put((place, hidden, bias, unit): &mut Self::Next, sums: [__m512; 2]) {
        // SAFETY: the caller's promise.
        unsafe {
            let can = Avx512::new();
            let y = Registers::new(can, load_widened(*hidden, place.len));
            let made = unit.back_from_result(y, Registers::new(can, rounded(sums))).get();
            add(made, bias.at, place.len);
            store_rounded(made, place.at, place.len);
        }
        *hidden = hidden.wrapping_add(place.columns);
        place.go_on();
        bias.go_on();
    }
}

/// Runs `$loops` with an `Out` as the [`Put`] that it is.
macro_rules! for_each_out {
    ($out:expr, $put:ident => $loops:expr) => {{
        use $crate::product::sums::{Added, Back, EluUnits, ReluUnits, Rounded, Through, Widened};
        use $crate::unit::Unit;
        match $out {
            Out::Rounded(out) => {
                let mut $put = Rounded(out);
                $loops
            }
            Out::Widened(out) => {
                let mut $put = Widened(out);
                $loops
            }
            Out::Added(out) => {
                let mut $put = Added(out);
                $loops
            }
            Out::Activations(units) => match units.unit {
                Unit::Relu => {
                    let mut $put = Through::<ReluUnits>::new(units);
                    $loops
                }
                Unit::Elu => {
                    let mut $put = Through::<EluUnits>::new(units);
                    $loops
                }
            },
            Out::Gradients(units) => match units.unit {
                Unit::Relu => {
                    let mut $put = Back::<ReluUnits>::new(units);
                    $loops
                }
                Unit::Elu => {
                    let mut $put = Back::<EluUnits>::new(units);
                    $loops
                }
            },
        }
    }};
}
pub(super) use for_each_out;
