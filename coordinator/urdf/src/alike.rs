//! Whether arms are built alike, and so of one type.

use simulator::robot::description::{CapsuleDescription, DhRow, DiscDescription, LinkDescription};

/// Relative differences below this are rounding.
const SAME: f64 = 1e-4;
/// Twists that differ by less are the same (degrees).
const SAME_TWIST: f64 = 0.01;
/// Likewise, turns of hands (rad).
const SAME_TURN: f64 = 1e-3;

/// How an arm is built.
#[derive(Debug, Clone)]
pub(crate) struct Build {
    pub(crate) name: String,
    pub(crate) links: Vec<LinkDescription>,
    /// The hand's place in the last link's frame (m).
    pub(crate) tool: [f64; 3],
    /// What of the hand's turn that frame does not have (rad).
    pub(crate) left_over: f64,
}

impl Build {
    /// How another arm is built otherwise, if it is.
    pub(crate) fn difference(&self, other: &Self) -> Option<String> {
        let [here, there] = [self, other].map(|build| build.links.len());
        if here != there {
            return Some(format!("{here} joints here and {there} there"));
        }
        let mut links = self.links.iter().zip(&other.links).enumerate();
        let unlike = links.find_map(|(i, (a, b))| difference(i + 1, a, b));
        unlike.or_else(|| {
            if (self.left_over - other.left_over).abs() > SAME_TURN {
                return Some("hands are turned otherwise on the last link".to_owned());
            }
            let [here, there] = [self.tool, other.tool];
            (!same(&here, &there, 1.0))
                .then(|| format!("hands stand at {here:?} and {there:?} on the last link"))
        })
    }
}

/// How the links of a number differ, and the joints that move them.
fn difference(number: usize, a: &LinkDescription, b: &LinkDescription) -> Option<String> {
    let row = |link: &LinkDescription| [link.dh.a, link.dh.d];
    let limits = |link: &LinkDescription| [link.servo.max_rate, link.servo.max_torque];
    let degrees = (a.dh.alpha_deg - b.dh.alpha_deg).abs();
    if !same(&row(a), &row(b), 1.0) || degrees.min(360.0 - degrees) > SAME_TWIST {
        let words = |link: &LinkDescription| {
            let DhRow { a, d, alpha_deg } = link.dh;
            format!("a = {a}, d = {d}, alpha_deg = {alpha_deg}")
        };
        return Some(format!("joint {number} has {} here and {} there", words(a), words(b)));
    }
    if !same(&[a.mass], &[b.mass], 0.0) {
        return Some(format!("link {number} has {} kg here and {} kg there", a.mass, b.mass));
    }
    if !same(&a.com, &b.com, 1.0) {
        let [here, there] = [a.com, b.com];
        return Some(format!(
            "the centre of link {number} is at {here:?} here and {there:?} there"
        ));
    }
    if !same(&a.inertia, &b.inertia, size(&a.inertia)) {
        let [here, there] = [a.inertia, b.inertia];
        return Some(format!("link {number} has the inertia {here:?} here and {there:?} there"));
    }
    if !same(&limits(a), &limits(b), 0.0) {
        return Some(format!("joint {number} has other limits"));
    }
    let counts = |link: &LinkDescription| (link.capsules.len(), link.discs.len());
    if counts(a) != counts(b) || !same(&shapes(a), &shapes(b), 1.0) {
        return Some(format!("link {number} has other shapes"));
    }
    None
}

/// All lengths of a link's shapes.
fn shapes(link: &LinkDescription) -> Vec<f64> {
    let capsule = |c: &CapsuleDescription| [&c.from[..], &c.to[..], &[c.radius]].concat();
    let disc = |d: &DiscDescription| vec![d.radius, d.z[0], d.z[1]];
    let discs = link.discs.iter().flat_map(disc);
    link.capsules.iter().flat_map(capsule).chain(discs).collect()
}

/// Whether numbers differ by rounding alone, of a size of `scale` or of their own.
fn same(a: &[f64], b: &[f64], scale: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME * scale.max(size(&[*a, *b])))
}

fn size(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, x| most.max(x.abs()))
}
