//! The arrays that a page reads: everything that is drawn or plotted, in one piece of memory that never moves.
//!
//! A, J, B are arms, joints and bodies, B = 1 + J; body 0 is the base, 1 + l is link l, arm-major. World axes, m, rad, s, N. Poses are 4×4
//! matrices, column-major, as WebGL has them.
//!
//! | name | shape | |
//! |---|---|---|
//! | `state` | 13 + 2 J | base position, quaternion (w, x, y, z; base to world), linear velocity, angular velocity (base axes), joint angles, joint rates |
//! | `bodies` | B, 16 | poses of the bodies' frames |
//! | `hands` | A, 16 | poses of the hands |
//! | `hand_goals` | A, 6 | position, Euler angles: R = Rx(a) Ry(b) Rz(c) |
//! | `base_goal` | 3 | Euler angles |
//! | `hand_errors` | A, 6 | goal − actual: position, Euler angles |
//! | `base_errors` | 3 | goal − actual: Euler angles |
//! | `position_error` | A | norm |
//! | `orientation_error` | A | norm of the difference of Euler angles |
//! | `base_error` | 1 | likewise |
//! | `actions` | J | clipped, before scaling, of the last step |
//! | `commands` | J | joint rates commanded in the last step |
//! | `torques` | J | of the servos at the end of the last step (N m) |
//! | `touching` | A + 4 | touching pairs by arm, then by kind: with the base, a mount, the own arm, another arm |
//! | `contacts` | 64, 8 | contacts that pushed at the end of the last step: point, force on the first body, first body, second body |
//! | `counters` | 4 | rows of `contacts`, control steps since the start, effects in force, delay (control steps) |

use simulator::experiment::Episode;
use simulator::robot::Robot;

/// Most contacts that are told.
const MOST_CONTACTS: usize = 64;

/// Names and lengths.
#[derive(Debug)]
pub(crate) struct Arrays {
    parts: Vec<(&'static str, usize)>,
    values: Vec<f32>,
}

impl Arrays {
    /// Zeros for a robot.
    pub(crate) fn new(robot: &Robot) -> Self {
        let (a, j) = (robot.n_arms, robot.n_joints());
        let parts = vec![
            ("state", 13 + 2 * j),
            ("bodies", 16 * (1 + j)),
            ("hands", 16 * a),
            ("hand_goals", 6 * a),
            ("base_goal", 3),
            ("hand_errors", 6 * a),
            ("base_errors", 3),
            ("position_error", a),
            ("orientation_error", a),
            ("base_error", 1),
            ("actions", j),
            ("commands", j),
            ("torques", j),
            ("touching", a + 4),
            ("contacts", 8 * MOST_CONTACTS),
            ("counters", 4),
        ];
        let len = parts.iter().map(|(_, len)| len).sum();
        Self { parts, values: vec![0.0; len] }
    }

    /// Name, address (bytes) and length of each.
    pub(crate) fn places(&self) -> impl Iterator<Item = (&'static str, usize, usize)> {
        let mut at = self.values.as_ptr().addr();
        self.parts.iter().map(move |&(name, len)| {
            let place = (name, at, len);
            at += len * size_of::<f32>();
            place
        })
    }

    /// The numbers of one.
    #[cfg(test)]
    pub(crate) fn get(&self, name: &str) -> &[f32] {
        let before = self.parts.iter().take_while(|(other, _)| *other != name);
        let at = before.map(|(_, len)| len).sum();
        let (_, len) = self.parts.iter().find(|(other, _)| *other == name).expect("an array");
        &self.values[at..at + len]
    }

    /// Fills all with an episode as it stands.
    pub(crate) fn fill(&mut self, episode: &Episode) {
        let mut out = Writer(&mut self.values);
        for part in episode.state().parts() {
            out.put(part);
        }
        for body in 0..=episode.state().q.len() {
            let (axes, origin) = episode.body(body);
            out.put(&matrix(&axes, origin));
        }
        for hand in episode.hands() {
            out.put(&matrix(&hand.rotation, hand.position));
        }
        let (goals, errors) = (episode.goals(), episode.errors());
        out.put(goals.hands.as_flattened());
        out.put(&goals.base);
        out.put(errors.hands.as_flattened());
        out.put(&errors.base);
        out.put(&errors.position_norm);
        out.put(&errors.orientation_norm);
        out.put(&[errors.base_norm]);
        out.put(episode.actions());
        out.put(episode.commands());
        out.put(episode.torques());
        let touching = episode.touching();
        out.put(&touching.by_arm[..goals.hands.len()]);
        out.put(&touching.by_kind);
        let pushes = &episode.pushes()[..episode.pushes().len().min(MOST_CONTACTS)];
        let mut contacts = [[0.0; 8]; MOST_CONTACTS];
        for (row, push) in contacts.iter_mut().zip(pushes) {
            row[..3].copy_from_slice(&push.point);
            row[3..6].copy_from_slice(&push.force);
            row[6] = (1 + push.on) as f32;
            row[7] = push.by.map_or(0, |link| 1 + link) as f32;
        }
        out.put(contacts.as_flattened());
        let counters = [pushes.len(), episode.steps(), episode.effects(), episode.delay()];
        out.put(&counters.map(|count| count as f32));
        assert!(out.0.is_empty(), "every array is filled");
    }
}

/// Fills a slice from its start.
struct Writer<'a>(&'a mut [f32]);

impl Writer<'_> {
    fn put(&mut self, values: &[f32]) {
        let (part, rest) = std::mem::take(&mut self.0).split_at_mut(values.len());
        part.copy_from_slice(values);
        self.0 = rest;
    }
}

fn matrix(axes: &[[f32; 3]; 3], [x, y, z]: [f32; 3]) -> [f32; 16] {
    let [[a, b, c], [d, e, f], [g, h, i]] = *axes;
    [a, d, g, 0.0, b, e, h, 0.0, c, f, i, 0.0, x, y, z, 1.0]
}
