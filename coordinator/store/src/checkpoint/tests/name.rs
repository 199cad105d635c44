use super::*;

#[test]
fn a_name_is_one_plain_path_component() {
    let longest = "a".repeat(100);
    for good in ["a", "0", "iteration-00000050", "best_of.3", &longest] {
        assert_eq!(good.parse::<Name>().expect(good).as_str(), good);
    }
    let too_long = "a".repeat(101);
    let bad =
        ["", ".", "..", ".hidden", "-rf", "_x", "a/b", "../a", "a\\b", "a b", "a\0", "ä", "a:b"];
    for bad in bad.into_iter().chain([too_long.as_str()]) {
        let error = bad.parse::<Name>().expect_err(bad).to_string();
        assert!(error.contains("letters, digits"), "{error}");
        assert!(!error.contains('\0'), "a terminal must not be fed what the user wrote");
        let json = serde_json::to_string(bad).expect("text");
        assert!(serde_json::from_str::<Name>(&json).is_err(), "{bad:?} came in through JSON");
    }
}

#[test]
fn only_numbers_make_an_iterations_name() {
    assert_eq!(Name::of_iteration(50).as_str(), "iteration-00000050");
    assert_eq!(name("iteration-00000050").iteration(), Some(50));
    assert_eq!(name("iteration-123456789012").iteration(), Some(123_456_789_012));
    for other in ["iteration-", "iteration-5a", "iteration-1.5", "iteration--5", "best"] {
        assert_eq!(name(other).iteration(), None, "{other}");
    }
    assert_eq!(name("iteration-99999999999999999999999").iteration(), None, "more than 64 bits");
}
