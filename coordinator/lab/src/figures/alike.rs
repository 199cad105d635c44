//! Which runs learn the same but for their seeds.

use proto::config::Config;

/// Whether two configurations differ in what does not change what is learned, at most.
pub(super) fn learn_alike(one: &Config, other: &Config) -> bool {
    // The budget does: the learning rate falls over it.
    one.run.continues(&other.run)
        && one.run.env_steps == other.run.env_steps
        && *one == Config { run: one.run.clone(), ..other.clone() }
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset};

    use super::*;

    fn config(set: &str) -> Config {
        let layers = Layers::new(Preset::Tuned, None).set(set).expect("well formed");
        layers.resolve().expect("valid")
    }

    #[test]
    fn seeds_and_housekeeping_alone_make_no_other_family() {
        let plain = config("run.seed=1");
        for alike in ["run.keep_every=7", "run.checkpoint_every=3", "run.evaluate_every=1"] {
            assert!(learn_alike(&config(alike), &plain), "{alike}");
        }
        for other in ["run.env_steps=9_000_000", "run.overlap=1", "algorithm.gamma=0.5"] {
            assert!(!learn_alike(&config(other), &plain), "{other}");
        }
    }
}
