//! Files of learning curves: what is taken goes out as it came in, and is drawn, whatever its numbers.

#![no_main]

use lab::figures::families::{Over, families};
use lab::figures::learning::learning;
use lab::figures::recorded::{parse, to_json};
use libfuzzer_sys::fuzz_target;
use run::report::evaluations::HeldOut;
use run::report::points::Point;
use run::report::row::Row as _;
use serde_json::{Value, json};

fn seeds() -> Vec<Vec<u8>> {
    let config = serde_json::to_value(fuzz::small_config()).expect("a configuration is JSON");
    let columns = |names: [&str; 8]| -> Value {
        names.into_iter().map(|name| (name.to_owned(), json!([1.0, 2.5]))).collect()
    };
    let curve = json!({
        "run": "a", "commit": null, "processor": "b", "digest": null, "config": config,
        "points": columns(Point::NAMES), "held_out": columns(HeldOut::NAMES),
    });
    let mut other = curve.clone();
    other["config"]["task"]["name"] = json!("reorientation");
    let file = |curves: Value| json!({ "curves": curves }).to_string().into_bytes();
    vec![file(json!([curve])), file(json!([curve, curve, other])), file(json!([]))]
}

fuzz_target!(
    init: {
        for seed in seeds() {
            if let Err(error) = parse(&seed) {
                panic!("a seed is refused: {error}");
            }
        }
        fuzz::write_seeds(seeds);
    },
    |bytes: &[u8]| {
        let Ok(curves) = parse(bytes) else { return };
        let again = to_json(&curves).expect("what came in goes out");
        assert_eq!(parse(&again).expect("and comes in again"), curves);
        for over in [Over::EnvSteps, Over::Time] {
            let families = families(&curves, over);
            if !families.is_empty() {
                learning(&families, over).expect("drawn");
            }
        }
    }
);
