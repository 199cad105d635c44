//! What both comparisons say in the same words.

use super::differences::ProvenanceDifference;

/// The differences of provenance as a table below an empty line, or nothing.
pub(super) fn provenance_table(differences: &[ProvenanceDifference], sides: [&str; 2]) -> String {
    if differences.is_empty() {
        return String::new();
    }
    let joined = |values: &std::collections::BTreeSet<String>| {
        values.iter().map(String::as_str).collect::<Vec<_>>().join(" | ")
    };
    let rows = differences
        .iter()
        .map(|difference| [difference.field.into(), joined(&difference.a), joined(&difference.b)]);
    format!("\n\n{}", output::table(["provenance", sides[0], sides[1]], rows))
}

/// What the promise says to a result.
pub(super) fn promise(promised: bool, same: bool, gpu: bool) -> String {
    let sentence = match (promised, same) {
        (true, true) => return String::new(),
        (true, false) => {
            "The same bits are promised here: either a file was changed, or this is a defect of \
             SpaceOctopus that its authors want to know of."
        }
        (false, true) if gpu => "The same bits are not promised on a GPU; here they are the same.",
        (false, false) if gpu => "The same bits are not promised on a GPU.",
        (false, true) => "With these differences the same bits are not promised; here they are.",
        (false, false) => "With these differences the same bits are not promised.",
    };
    format!("\n\n{}", output::wrap(sentence))
}

/// `1 iteration`, `2 iterations`.
pub(super) fn iterations(count: u64) -> String {
    output::counted(count, "iteration")
}
