//! The policies that hosts can have.

use std::collections::VecDeque;

/// How many they are: with overlap workers act with the one before the newest, and an evaluation may still be at the one
/// before that.
const KEPT: usize = 3;

/// See the module; oldest first.
#[derive(Debug, Default)]
pub(super) struct Policies(VecDeque<(u64, Vec<u8>)>);

impl Policies {
    /// A new one has come; the oldest goes.
    pub(super) fn add(&mut self, version: u64, bytes: Vec<u8>) {
        self.0.retain(|(known, _)| *known != version);
        self.0.push_back((version, bytes));
        while self.0.len() > KEPT {
            self.0.pop_front();
        }
    }

    /// Their versions.
    pub(super) fn versions(&self) -> Vec<u64> {
        self.0.iter().map(|(version, _)| *version).collect()
    }

    /// The bytes of one, if it is still here.
    pub(super) fn get(&self, version: u64) -> Option<&[u8]> {
        let found = self.0.iter().find(|(known, _)| *known == version)?;
        Some(&found.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_are_kept_and_one_that_comes_again_is_the_newest() {
        let mut policies = Policies::default();
        for version in [4, 5, 6, 4, 7] {
            policies.add(version, vec![version as u8]);
        }
        assert_eq!(policies.versions(), [6, 4, 7]);
        assert_eq!((policies.get(4), policies.get(5)), (Some(&[4][..]), None));
    }
}
