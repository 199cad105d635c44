//! Something that does one thing at a time, in the order in which it is asked to: a link, a core, a learner.

/// See the module.
#[derive(Debug, Clone, Default)]
pub(super) struct Server {
    free_at: f64,
    busy: f64,
}

impl Server {
    /// Begins when it is free, not before `now`, and takes `duration` (s). When it begins and ends.
    pub(super) fn serve(&mut self, now: f64, duration: f64) -> [f64; 2] {
        let begins = self.free_at.max(now);
        self.free_at = begins + duration;
        self.busy += duration;
        [begins, self.free_at]
    }

    /// Time for which it was, or will have been, busy (s).
    pub(super) fn busy(&self) -> f64 {
        self.busy
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_comes_while_it_is_busy_waits() {
        let mut link = Server::default();
        assert_eq!(link.serve(1.0, 2.0), [1.0, 3.0]);
        assert_eq!(link.serve(2.0, 2.0), [3.0, 5.0]);
        assert_eq!(link.serve(9.0, 1.0), [9.0, 10.0]);
        assert_eq!(link.busy(), 5.0);
    }
}
