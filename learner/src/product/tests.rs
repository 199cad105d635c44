use tch::{Device, Kind, Tensor};

use super::{Activations, Biases, Gradients, Left, Native, Out, Packed, multiply};
use crate::memory::numbers;
use crate::number::{Bf16, Number};
use crate::unit::Unit;

/// Numbers of order 1 that differ from place to place.
fn matrix(seed: usize, len: usize) -> Vec<Bf16> {
    let number = |i: usize| ((i * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0;
    (0..len).map(|i| Bf16::round(number(i))).collect()
}

fn transposed(matrix: &[Bf16], rows: usize, columns: usize) -> Vec<Bf16> {
    (0..columns).flat_map(|c| (0..rows).map(move |r| matrix[r * columns + c])).collect()
}

/// Whole tiles and panels and parts of them, in pairs and odd.
const SIZES: [[usize; 3]; 12] = [
    [8, 2, 32],
    [1, 1, 1],
    [5, 3, 33],
    [16, 237, 128],
    [237, 50, 31],
    [62, 81, 64],
    [30, 24, 20],
    [200, 128, 100],
    [64, 300, 70],
    [32, 256, 96],
    [96, 40, 64],
    [40, 17, 70],
];

#[test]
fn products_are_sums_of_products() {
    // Packed twice: what was there is not added to.
    let (mut right, mut left_packed) = (Packed::default(), Packed::default());
    for [m, k, n] in SIZES {
        let (a, b) = (matrix(1, m * k), matrix(2, k * n));
        let expected: Vec<f64> = (0..m * n)
            .map(|i| {
                let (row, column) = (i / n, i % n);
                let x = |i: usize| f64::from(a[row * k + i].widen());
                (0..k).map(|i| x(i) * f64::from(b[i * n + column].widen())).sum()
            })
            .collect();
        let ways = [[false, false], [true, false], [false, true], [true, true]];
        for (native, [left_is, right_is]) in
            Native::all().into_iter().flat_map(|native| ways.map(|way| (native, way)))
        {
            if right_is {
                right.pack_transposed(&transposed(&b, k, n), k, n);
            } else {
                right.pack(&b, k, n);
            }
            left_packed.pack(&transposed(&a, m, k), k, m);
            let left = || if left_is { Left::Transposed(&left_packed) } else { Left::Rows(&a) };
            let mut rounded = vec![Bf16(0x7fc0); m * n];
            multiply(native, left(), &right, Out::Rounded(&mut rounded));
            let mut widened = vec![f32::NAN; m * n];
            multiply(native, left(), &right, Out::Widened(&mut widened));
            let mut added = vec![100.0; m * n];
            multiply(native, left(), &right, Out::Added(&mut added));
            for i in 0..m * n {
                assert_eq!(rounded[i].widen(), widened[i]);
                assert_eq!(widened[i] + 100.0, added[i]);
                let error = (f64::from(widened[i]) - expected[i]).abs();
                // A rounding to bfloat16, and those of K / 2 sums of order 10 in f32.
                assert!(
                    error < expected[i].abs() * 2f64.powi(-8) + 1e-4,
                    "{native:?}, {m}×{k}×{n}: {error}"
                );
            }
        }
    }
}

/// To the bit, but where libtorch sums a long inner index in parts: there a last place differs now and then.
#[test]
#[expect(unsafe_code, reason = "libtorch's numbers are read")]
fn products_are_those_of_libtorch() {
    let mut right = Packed::default();
    for [m, k, n] in SIZES.into_iter().chain([[800, 256, 256], [256, 800, 256], [237, 200, 128]]) {
        let (a, b) = (matrix(3, m * k), matrix(4, k * n));
        let tensor = |numbers: &[Bf16], rows: usize, columns: usize| {
            let wide: Vec<f32> = numbers.iter().map(|x| x.widen()).collect();
            let wide = Tensor::from_slice(&wide).view([1, rows as i64, columns as i64]);
            wide.to_kind(Kind::BFloat16)
        };
        let theirs = tensor(&a, m, k).bmm(&tensor(&b, k, n)).contiguous();
        assert_eq!(theirs.device(), Device::Cpu);
        right.pack(&b, k, n);
        // SAFETY: filled, and nobody writes.
        let theirs: &[Bf16] = unsafe { numbers(&theirs) };
        for native in Native::all() {
            let mut ours = vec![Bf16(0); m * n];
            multiply(native, Left::Rows(&a), &right, Out::Rounded(&mut ours));
            let differ = ours.iter().zip(theirs).filter(|(ours, theirs)| ours != theirs).count();
            assert!(differ * 100 <= m * n, "{native:?}, {m}×{k}×{n}: {differ} differ");
        }
    }
}

/// To the bit what units make of products that lie in memory, number by number, forward and back: whole tiles and panels and parts of them, with a
/// bias for each of several actors and with one for all.
#[cfg(unix)]
#[test]
fn products_through_units_are_those_of_products_in_memory() {
    use super::guarded::Guarded;

    let mut right = Packed::default();
    for ([m, k, n], unit) in SIZES.into_iter().flat_map(|s| [(s, Unit::Relu), (s, Unit::Elu)]) {
        let (a, b) = (matrix(5, m * k), matrix(6, k * n));
        right.pack(&b, k, n);
        for (native, actors) in Native::all().into_iter().flat_map(|n| [(n, 1), (n, 3)]) {
            // Of the second of two networks, whose actors' biases alternate.
            let biases = Biases { first: n, step: 2 * n, actors };
            let bias: Vec<f32> =
                matrix(7, 2 * actors * n).iter().map(|x| 3.0 * x.widen()).collect();
            let (a, bias) = (Guarded::new(&a), Guarded::new(&bias));
            let zeros = || Guarded::new(&vec![Bf16(0); m * n]);
            let mut product = zeros();
            multiply(native, Left::Rows(&a), &right, Out::Rounded(&mut product));

            let mut hidden = zeros();
            let out = Activations { unit, bias: &bias, biases, out: &mut hidden };
            multiply(native, Left::Rows(&a), &right, Out::Activations(out));
            let at = |i: usize| biases.of(i / n) + i % n;
            for i in 0..m * n {
                let x = product[i].widen() + bias[at(i)];
                let expected = Bf16::round(unit.of(x));
                assert_eq!(hidden[i], expected, "{native:?}, {unit:?}, {m}×{k}×{n}: {x}");
            }

            let (mut gradient, mut bias_gradient) = (zeros(), Guarded::new(&bias));
            let out = Gradients {
                unit,
                hidden: &hidden,
                bias_gradient: &mut bias_gradient,
                biases,
                out: &mut gradient,
            };
            multiply(native, Left::Rows(&a), &right, Out::Gradients(out));
            let mut expected = bias.to_vec();
            for i in 0..m * n {
                let (y, d) = (hidden[i].widen(), product[i].widen());
                let d = unit.back_from_result(y, d);
                expected[at(i)] += d;
                assert_eq!(gradient[i], Bf16::round(d), "{native:?}, {unit:?}, {m}×{k}×{n}");
            }
            let differ = bias_gradient.iter().zip(&expected).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "{native:?}, {unit:?}, {m}×{k}×{n}, {actors} actors");
        }
    }
}

/// A layer that has fewer biases than actors is refused before anything is multiplied.
#[test]
#[should_panic(expected = "fewer biases")]
fn biases_that_are_missing_are_not_read() {
    let (a, b) = (matrix(1, 40 * 20), matrix(2, 20 * 30));
    let mut right = Packed::default();
    right.pack(&b, 20, 30);
    let (bias, mut hidden) = ([0.0; 59], vec![Bf16(0); 40 * 30]);
    let biases = Biases { first: 0, step: 30, actors: 2 };
    let out = Activations { unit: Unit::Elu, bias: &bias, biases, out: &mut hidden };
    multiply(Native::Plain, Left::Rows(&a), &right, Out::Activations(out));
}
