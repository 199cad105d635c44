//! What arms and links are called here.

use std::collections::BTreeMap;

use crate::tree::Arm;

/// Names of arms, and of the links of each: what the links of an arm have in common at the front is the arm's.
pub(crate) fn names(arms: &[Arm<'_>]) -> Vec<(String, Vec<String>)> {
    let own: Vec<Vec<&str>> = arms
        .iter()
        .map(|arm| arm.bodies.iter().map(|body| body[0].0.name.as_str()).collect())
        .collect();
    let fronts: Vec<&str> = own.iter().map(|links| common_front(links)).collect();
    let arm_names = distinct(
        fronts.iter().map(|front| plain(front.trim_end_matches(['_', '-']))).collect(),
        "arm",
    );
    own.iter()
        .zip(&fronts)
        .zip(arm_names)
        .map(|((links, front), arm)| {
            let links = links.iter().map(|link| plain(&link[front.len()..])).collect();
            (arm, distinct(links, "link"))
        })
        .collect()
}

/// The longest beginning that all have, which leaves something of each.
fn common_front<'a>(names: &[&'a str]) -> &'a str {
    let first = names[0];
    let mut end = 0;
    for (at, c) in first.char_indices() {
        let next = at + c.len_utf8();
        if names.iter().any(|name| !name.starts_with(&first[..next]) || name.len() == next) {
            break;
        }
        // Not in the middle of a word.
        if matches!(c, '_' | '-' | '/' | ':' | '.') {
            end = next;
        }
    }
    &first[..end]
}

/// Letters, digits, `-` and `_` of a name.
pub(crate) fn plain(name: &str) -> String {
    let c = |c: char| if c.is_ascii_alphanumeric() || c == '_' || c == '-' { c } else { '_' };
    let name: String = name.chars().map(c).collect();
    if name.is_empty() { "robot".to_owned() } else { name }
}

/// The names if each is another one, and numbered ones otherwise.
fn distinct(names: Vec<String>, kind: &str) -> Vec<String> {
    let mut seen = BTreeMap::new();
    for name in &names {
        *seen.entry(name.as_str()).or_insert(0) += 1;
    }
    let taken = ["mount", "pedestal", "hand", "goal", "robot"];
    if seen.values().all(|&times| times == 1)
        && !names.iter().any(|name| taken.contains(&name.as_str()))
    {
        return names;
    }
    (1..=names.len()).map(|number| format!("{kind}_{number}")).collect()
}
