//! Numbers, sizes and times as a person reads them.

use indicatif::HumanCount;

/// A count with its thousands set apart: `1,664,000`.
pub fn grouped(count: u64) -> String {
    HumanCount(count).to_string()
}

/// A count and what is counted: `1 worker`, `1,200 workers`.
pub fn counted(count: u64, noun: &str) -> String {
    format!("{} {noun}{}", grouped(count), if count == 1 { "" } else { "s" })
}

/// Bytes with a unit of powers of ten.
pub fn size(bytes: u64) -> String {
    let bytes = bytes as f64;
    let units = [(1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    match units.into_iter().find(|(unit, _)| bytes >= *unit) {
        Some((unit, name)) => format!("{:.1} {name}", bytes / unit),
        None => format!("{bytes} B"),
    }
}

/// A duration in its largest unit.
pub fn age(seconds: u64) -> String {
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min", seconds / 60),
        3600..86400 => format!("{} h", seconds / 3600),
        _ => format!("{} d", seconds / 86400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_set_apart() {
        let counts = [0, 999, 1000, 1_664_000, u64::MAX].map(grouped);
        assert_eq!(counts, ["0", "999", "1,000", "1,664,000", "18,446,744,073,709,551,615"]);
    }

    #[test]
    fn sizes_and_ages_have_their_largest_unit() {
        assert_eq!([size(999), size(1000), size(12_345_678)], ["999 B", "1.0 kB", "12.3 MB"]);
        assert_eq!([age(59), age(60), age(7200), age(200_000)], ["59 s", "1 min", "2 h", "2 d"]);
    }
}
