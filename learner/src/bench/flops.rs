//! How many floating-point operations an update needs.

use proto::config::{AlgorithmName, Config};
use proto::layout::Dimensions;

/// Operations in the matrix products that an update needs for an env-step; everything else counts
/// nothing.
///
/// A product of a row with a matrix of `in × out` takes 2·in·out. Each epoch takes three of them a
/// layer and network: forwards, for the gradient of the weights, and for that of the layer's input,
/// which the first layer has no use for. The critics' values before the first epoch take another
/// pass forwards, over T + 1 of every T steps.
///
/// A sample of MADDPG's batches goes forwards through the target actor and the actor and back through that,
/// forwards through the target critic and twice through the critic, and back through that for its own
/// weights, and for the actor as far as its own actions.
pub fn per_env_step(config: &Config, dimensions: &Dimensions) -> f64 {
    let network = &config.network;
    let products = |input: usize, hidden: &[usize], output: usize| {
        let widths: Vec<f64> = std::iter::once(&input)
            .chain(hidden)
            .chain(std::iter::once(&output))
            .map(|&width| width as f64)
            .collect();
        let all: f64 = widths.windows(2).map(|pair| 2.0 * pair[0] * pair[1]).sum();
        (all, 2.0 * widths[0] * widths[1])
    };
    let (actor, actor_first) =
        products(dimensions.actor_input(), &network.hidden, dimensions.actor_output());
    let n_critics = config.critics(dimensions.n_actors);
    let values_of_each = dimensions.n_actors / n_critics;
    let (critic, critic_first) =
        products(dimensions.critic_input(), network.hidden_of_critics(), values_of_each);
    if config.algorithm.name == AlgorithmName::Maddpg {
        let settings = &config.algorithm.maddpg;
        let samples = settings.updates_per_step * settings.batch_size as f64;
        let actions = 2.0 * (dimensions.n_actions * network.hidden_of_critics()[0]) as f64;
        let actors = 4.0 * actor - actor_first;
        let critics = 6.0 * critic - 2.0 * critic_first + actions;
        return dimensions.n_actors as f64 * samples * (actors + critics);
    }
    let epochs = config.algorithm.epochs as f64;
    let steps = dimensions.n_steps as f64;
    let of_actor = epochs * (3.0 * actor - actor_first);
    let of_critic = epochs * (3.0 * critic - critic_first) + critic * (steps + 1.0) / steps;
    dimensions.n_actors as f64 * of_actor + n_critics as f64 * of_critic
}

#[cfg(test)]
mod tests {
    use proto::agents::Joints;
    use proto::config::{Layers, Preset};

    use super::*;

    /// Of preset `paper` with two layers of 10 and what else is said.
    fn operations(assignments: &[&str]) -> f64 {
        let small = Layers::new(Preset::Paper, None).set("network.hidden=[10,10]");
        let layers = assignments
            .iter()
            .fold(small, |layers, assignment| layers.and_then(|layers| layers.set(assignment)));
        let config = layers.and_then(|layers| layers.resolve()).expect("valid");
        per_env_step(&config, &Dimensions::new(&config, Joints::of_sixes(4)))
    }

    /// Worked by hand: O = 28, S = 8·28 = 224, two layers of 10, T = 4, 3 epochs, 8 agents.
    ///
    /// Actor: 28·10 + 10·10 + 10·3 = 410 weights, 280 of them in the first layer; an epoch is
    /// 6·410 − 2·280 = 1,900. Critic: 2,240 + 100 + 10 = 2,350 weights, 2,240 in the first; an epoch
    /// is 6·2,350 − 2·2,240 = 9,620. Values: 2·2,350·5/4 = 5,875. In all 8·(3·11,520 + 5,875).
    #[test]
    fn operations_are_those_of_the_hand_worked_example() {
        let assignments = ["task.episode_steps=4", "algorithm.epochs=3"];
        assert_eq!(operations(&assignments), 323_480.0);
    }

    /// Worked by hand: as the first, with two critics of 4 outputs, so 2,380 weights: an epoch is 6·2,380 − 2·2,240 = 9,800, values are
    /// 2·2,380·5/4 = 5,950. In all 8·3·1,900 + 2·(3·9,800 + 5,950).
    #[test]
    fn operations_of_shared_critics_are_those_of_the_hand_worked_example() {
        let assignments = [
            "network.shared_critics=true",
            "network.parameter_sharing=roles",
            "task.episode_steps=4",
            "algorithm.epochs=3",
        ];
        assert_eq!(operations(&assignments), 116_300.0);
    }

    /// Worked by hand: as the first, and 24 actions beside the critic state, so 2,590 weights, 2,480 of them in
    /// the first layer. Actor: 4·820 − 560 = 2,720. Critic: 6·5,180 − 2·4,960 + 2·3·10 = 21,220. Half an
    /// update of 20 samples a step: 8·10·23,940.
    #[test]
    fn operations_of_maddpg_are_those_of_the_hand_worked_example() {
        let assignments = [
            "algorithm.name=maddpg",
            "algorithm.maddpg.batch_size=20",
            "algorithm.maddpg.updates_per_step=0.5",
        ];
        assert_eq!(operations(&assignments), 1_915_200.0);
    }
}
