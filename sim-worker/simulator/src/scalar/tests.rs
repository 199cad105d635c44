use super::*;

/// Arguments over the useful range of each function, edges included.
fn arguments() -> Vec<f32> {
    let mut xs = vec![
        0.0,
        -0.0,
        1.0,
        -1.0,
        1e-30,
        1e-42,
        -1e-42,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::NAN,
    ];
    let mut state = 1_u64;
    // Miri takes a thousand times longer over each.
    let drawn = if cfg!(miri) { 200 } else { 100_000 };
    for _ in 0..drawn {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let u = (state >> 40) as f32 / (1_u64 << 24) as f32;
        let scale = [0.1_f32, 1.0, 7.0, 90.0, 900.0][(state >> 20) as usize % 5];
        xs.push((2.0 * u - 1.0) * scale);
    }
    // The sign of what is not a number is open, and Miri draws it anew at every conversion.
    xs.retain(|x| !(cfg!(miri) && x.is_nan()));
    while xs.len() % LANES != 0 {
        xs.push(0.5);
    }
    xs
}

#[derive(Clone, Copy)]
struct All<'a>(&'a [f32]);

const FUNCTIONS: usize = 13;

#[inline(always)]
fn all_functions<S: Real>(x: S, y: S) -> [S; FUNCTIONS] {
    let (s, c) = x.sin_cos();
    [
        s,
        c,
        y.atan2(x),
        x.exp(),
        x.ln(),
        x.log10(),
        x.tanh(),
        x.round(),
        x.floor(),
        x.abs().sqrt(),
        x.min(y) + x.max(y) * y.neg_mul_add(x, y),
        S::select(x.lt(y) | !x.le(-y), x / y, x - y),
        x.copy_sign_to(y),
    ]
}

impl LaneFn for All<'_> {
    type Output = Vec<u32>;
    #[inline(always)]
    fn call<S: Real>(self) -> Vec<u32> {
        let mut out = Vec::new();
        let (mut x, mut y) = (S::zero(), S::zero());
        for chunk in self.0.chunks_exact(LANES) {
            let mut columns = [[0; LANES]; FUNCTIONS];
            for first in (0..LANES).step_by(S::LANES) {
                for lane in 0..S::LANES {
                    let i = first + lane;
                    x.set_lane(lane, f64::from(chunk[i]));
                    y.set_lane(lane, f64::from(chunk[(i + 5) % LANES]));
                }
                for (column, f) in columns.iter_mut().zip(all_functions(x, y)) {
                    for lane in 0..S::LANES {
                        column[first + lane] = canonical(f.lane(lane) as f32);
                    }
                }
            }
            out.extend(columns.concat());
        }
        out
    }
}

/// Bits, with one NaN: IEEE leaves a NaN's payload and sign open.
fn canonical(x: f32) -> u32 {
    if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() }
}

#[test]
fn every_back_end_and_lone_f32_give_the_same_bits() {
    let xs = arguments();
    let portable = dispatch_on(Backend::Portable, All(&xs));
    let mut lone = Vec::new();
    for chunk in xs.chunks_exact(LANES) {
        let columns: Vec<_> =
            (0..LANES).map(|i| all_functions(chunk[i], chunk[(i + 5) % LANES])).collect();
        for f in 0..FUNCTIONS {
            lone.extend(columns.iter().map(|c| canonical(c[f])));
        }
    }
    let differing = (0..lone.len()).find(|&i| lone[i] != portable[i]);
    assert_eq!(differing.map(|i| i / LANES % FUNCTIONS), None, "lone f32 and the portable lanes");
    for backend in [Backend::Avx2, Backend::Avx512] {
        if backend.is_available() {
            for other in [dispatch_on(backend, All(&xs)), dispatch_for(8, backend, All(&xs))] {
                let differing = (0..other.len()).find(|&i| other[i] != portable[i]);
                assert_eq!(
                    differing,
                    None,
                    "{backend:?}, function {:?}",
                    differing.map(|i| i / LANES % FUNCTIONS)
                );
            }
        }
    }
}

/// Distance in units of the last place of the true value.
fn ulps(value: f32, truth: f64) -> f64 {
    let t = truth as f32;
    if !t.is_finite() || !value.is_finite() {
        return if t == value || (t.is_nan() && value.is_nan()) { 0.0 } else { f64::INFINITY };
    }
    let ulp = f64::from(t.abs().max(f32::MIN_POSITIVE)) * f64::from(f32::EPSILON);
    (f64::from(value) - truth).abs() / ulp
}

#[test]
fn elementary_functions_are_accurate() {
    let mut worst = [0.0_f64; 7];
    for x in arguments() {
        let d = f64::from(x);
        if x.abs() <= 1000.0 {
            let (s, c) = Real::sin_cos(x);
            // Near a zero the reduction leaves an absolute error, so ulps count from 1e-2 on.
            let near = |v: f32, t: f64| {
                (f64::from(v) - t).abs() / (t.abs().max(1e-2) * f64::from(f32::EPSILON))
            };
            worst[0] = worst[0].max(near(s, d.sin()));
            worst[1] = worst[1].max(near(c, d.cos()));
            let y = x.mul_add(0.37, 0.2);
            worst[2] = worst[2].max(ulps(Real::atan2(y, x), f64::from(y).atan2(d)));
        }
        if x.is_finite() {
            // Results below the normal numbers have a coarser last place.
            worst[3] = worst[3].max(if d > -87.0 { ulps(Real::exp(x), d.exp()) } else { 0.0 });
            worst[4] = worst[4].max(ulps(Real::ln(x), d.ln()));
            worst[5] = worst[5].max(ulps(Real::log10(x), d.log10()));
            worst[6] = worst[6].max(ulps(Real::tanh(x), d.tanh()));
        }
    }
    let limits = [2.0, 2.0, 3.0, 2.0, 2.0, 3.0, 2.0];
    for (i, (w, l)) in worst.iter().zip(limits).enumerate() {
        assert!(*w <= l, "function {i}: {worst:?} ulp");
    }
}

#[test]
fn edges_of_exponential_and_logarithm() {
    assert_eq!(Real::exp(f32::NEG_INFINITY), 0.0);
    assert_eq!(Real::exp(f32::INFINITY), f32::INFINITY);
    assert_eq!(Real::exp(0.0_f32), 1.0);
    assert!(Real::exp(f32::NAN).is_nan());
    assert_eq!(Real::ln(0.0_f32), f32::NEG_INFINITY);
    assert!(Real::ln(-1.0_f32).is_nan());
    assert_eq!(Real::ln(1.0_f32), 0.0);
    assert_eq!(Real::log10(1.0_f32), 0.0);
}

#[test]
fn exponentials_of_negative_numbers_are_those_of_all() {
    for x in arguments().into_iter().filter(|x| *x <= 0.0) {
        let (quick, exact) = (elementary::exp_of_negative(x), Real::exp(x));
        assert_eq!((quick - 1.0).to_bits(), (exact - 1.0).to_bits(), "{x}");
        assert!(x < -87.0 || quick.to_bits() == exact.to_bits(), "{x}");
    }
}

#[test]
fn masks_set_and_read_single_lanes() {
    struct M;
    impl LaneFn for M {
        type Output = ();
        #[inline(always)]
        fn call<S: Real>(self) {
            let mut m = S::Mask::splat(false);
            assert!(!m.any());
            m.set_lane(3, true);
            assert!(m.any() && !m.all() && m.lane(3) && !m.lane(4));
            assert!((m | !m).all());
            m.set_lane(3, false);
            assert!(!m.any());
        }
    }
    for b in [Backend::Portable, Backend::Avx2, Backend::Avx512] {
        if b.is_available() {
            dispatch_on(b, M);
            dispatch_for(8, b, M);
        }
    }
}
