use tch::{Device, Kind, Tensor};

use super::{Left, Native, Out, Packed, multiply};
use crate::memory::numbers;
use crate::number::{Bf16, Number};

/// Numbers of order 1 that differ from place to place.
fn matrix(seed: usize, len: usize) -> Vec<Bf16> {
    let number = |i: usize| ((i * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0;
    (0..len).map(|i| Bf16::round(number(i))).collect()
}

fn transposed(matrix: &[Bf16], rows: usize, columns: usize) -> Vec<Bf16> {
    (0..columns).flat_map(|c| (0..rows).map(move |r| matrix[r * columns + c])).collect()
}

/// Whole tiles and panels and parts of them, in pairs and odd.
const SIZES: [[usize; 3]; 11] = [
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
