//! Whether arms are built alike, as those of a robot here must be.

use simulator::robot::description::{CapsuleDescription, DiscDescription, LinkDescription};

use crate::error::UrdfError;

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
    /// Refuses another arm that is not built alike.
    pub(crate) fn check(&self, other: &Self) -> Result<(), UrdfError> {
        let mut links = self.links.iter().zip(&other.links).enumerate();
        let unlike = links.find_map(|(i, (a, b))| difference(i + 1, a, b));
        let what = unlike.or_else(|| {
            if (self.left_over - other.left_over).abs() > SAME_TURN {
                return Some("hands are turned otherwise on the last link".to_owned());
            }
            let [here, there] = [self.tool, other.tool];
            (!same(&here, &there, 1.0))
                .then(|| format!("hands stand at {here:?} and {there:?} on the last link"))
        });
        what.map_or(Ok(()), |what| {
            let found = format!("arms `{}` and `{}` differ: {what}", self.name, other.name);
            Err(UrdfError::robot(found, "all arms of a robot must be built alike"))
        })
    }
}

/// How the links of a number differ, and the joints that move them.
fn difference(number: usize, a: &LinkDescription, b: &LinkDescription) -> Option<String> {
    let row = |link: &LinkDescription| [link.dh.a, link.dh.d];
    let limits = |link: &LinkDescription| [link.servo.max_rate, link.servo.max_torque];
    let degrees = (a.dh.alpha_deg - b.dh.alpha_deg).abs();
    if !same(&row(a), &row(b), 1.0) || degrees.min(360.0 - degrees) > SAME_TWIST {
        return Some(format!("joint {number} stands at {:?} here and at {:?} there", a.dh, b.dh));
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
