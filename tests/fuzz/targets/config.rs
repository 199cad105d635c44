//! Configurations: resolved ones, layers over a preset, and what is computed from valid ones.

#![no_main]

use channels::ChannelSizes;
use libfuzzer_sys::fuzz_target;
use proto::agents::Joints;
use proto::config::{Config, Layers, Preset};
use proto::layout::{ActorLayout, Dimensions};

fn check(config: &Config) {
    let text = config.to_toml();
    let again = Config::from_resolved_toml(&text, "again").expect("what was written is read");
    assert_eq!(again.to_toml(), text);
    // Sizes of anything valid can be computed; whether they fit is another question.
    let dimensions = Dimensions::new(config, Joints::of_sixes(4));
    let sizes = ChannelSizes::new(config, &dimensions);
    let _ = (sizes.shared_memory(config.run.workers), ActorLayout::new(config, &dimensions));
    let _ = config.planned_iterations();
}

fn seeds() -> Vec<Vec<u8>> {
    let layer = "[network]\nhidden = [8, 8]\n[run]\nenv_steps = 2e6\n\
                 [for.trajectory.task]\naction_scale = 0.5\n";
    let sets = ["algorithm.gamma=0.5", "run.device=cuda:0", "network.hidden=[1, 2]"];
    let whole = fuzz::small_config().to_toml();
    [whole.as_str(), layer].into_iter().chain(sets).map(|text| text.as_bytes().to_vec()).collect()
}

fuzz_target!(
    init: fuzz::write_seeds(seeds),
    |text: &str| {
        if let Ok(config) = Config::from_resolved_toml(text, "input") {
            check(&config);
        }
        for layers in [
            Layers::new(Preset::Tuned, None).text(text, "input"),
            Layers::new(Preset::Paper, None).set(text),
        ] {
            if let Ok(config) = layers.and_then(|layers| layers.resolve()) {
                check(&config);
            }
        }
    }
);
