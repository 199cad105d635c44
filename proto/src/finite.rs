//! Whether numbers that came from elsewhere are numbers.

/// Whether all of `numbers` are finite, fast: a product with zero is zero unless the other factor is infinite or not a number.
pub fn are_finite(numbers: &[f32]) -> bool {
    numbers.iter().map(|x| x * 0.0).sum::<f32>() == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_number_that_is_none_is_found() {
        assert!(are_finite(&[]) && are_finite(&[f32::MAX; 9]));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(!are_finite(&[1.0, bad, 3.0]));
        }
    }
}
