//! Goals of a person's own, as CSV or JSON; the first byte chooses which. Whatever they say, nothing panics, and what is taken can be played.

#![no_main]

use lab::goals::parse;
use libfuzzer_sys::fuzz_target;

fn seeds() -> Vec<Vec<u8>> {
    [
        "chand1_x,hand1_y,hand1_z,hand1_a,hand1_b,hand1_c\n0.1,-1,4.2,1.6,0,1.5\n,,,,,\n",
        "cbase_a, base_b, base_c\n0.1, -2e-1, 0\n",
        r#"j[{"hands": [null, [0.4, -1.1, 4.2, 1.6, 0.0, 1.5]]}, {"base": [0.1, 0, 0]}]"#,
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |bytes: &[u8]| {
        let Some((kind, bytes)) = bytes.split_first() else { return };
        let Ok(goals) = parse(bytes, *kind == b'j', 4) else { return };
        assert!(!goals.is_empty());
        for goal in goals {
            assert!(goal.hands.len() <= 4);
            let numbers = goal.hands.iter().flatten().flatten().chain(goal.base.iter().flatten());
            assert!(numbers.clone().count() > 0);
            assert!(numbers.into_iter().all(|x| x.abs() <= 1000.0));
        }
    }
);
