use proto::agents::Joints;
use proto::config::{Layers, Preset};
use proto::rng::Purpose;

use super::*;

/// Two shards of two environments, three steps, one arm; room for `slots` episodes.
fn ring(assignments: &[&str], slots: usize) -> (Replay, Dimensions) {
    let (replay, dimensions, _) = configured(assignments, slots);
    (replay, dimensions)
}

fn configured(assignments: &[&str], slots: usize) -> (Replay, Dimensions, Config) {
    let room = format!("algorithm.maddpg.replay_steps={}", 3 * slots + 2);
    let fixed =
        ["algorithm.name=maddpg", "env.n_envs=4", "env.n_shards=2", "task.episode_steps=3", &room];
    let config = fixed
        .iter()
        .chain(assignments)
        .fold(Layers::new(Preset::Tuned, None), |layers, a| layers.set(a).expect("well formed"))
        .resolve()
        .expect("valid");
    let dimensions = Dimensions::new(&config, Joints::of_sixes(1));
    (Replay::new(&config, &dimensions), dimensions, config)
}

/// Blocks whose every number says what and whose it is: array, iteration, environment, step, agent and
/// feature, in decimal places.
fn blocks(dimensions: &Dimensions, iteration: usize) -> Vec<Vec<f32>> {
    let layout = BlockLayout::new(dimensions);
    let Dimensions { n_agents: a, n_steps: t, n_envs: n, observation: o, state: s, .. } =
        *dimensions;
    (0..dimensions.n_shards)
        .map(|shard| {
            let mut block = vec![f32::NAN; layout.len];
            let mut fill = |start: usize, agents: usize, steps: usize, width: usize, array| {
                for (agent, step, env, feature) in every([agents, steps, n, width]) {
                    let at = ((agent * steps + step) * n + env) * width + feature;
                    let env = shard * n + env;
                    block[start + at] = number(array, iteration, env, step, agent, feature);
                }
            };
            fill(layout.observation.start, a, t + 1, o, 1);
            fill(layout.state.start, 1, t + 1, s, 2);
            fill(layout.action.start, a, t, 3, 3);
            fill(layout.reward.start, a, t, 1, 4);
            block[layout.terminated.clone()].fill(0.0);
            block[layout.truncated.clone()].fill(0.0);
            block
        })
        .collect()
}

fn every([a, b, c, d]: [usize; 4]) -> impl Iterator<Item = (usize, usize, usize, usize)> {
    (0..a * b * c * d).map(move |i| (i / (b * c * d), i / (c * d) % b, i / d % c, i % d))
}

fn number(
    array: usize,
    iteration: usize,
    env: usize,
    step: usize,
    agent: usize,
    feature: usize,
) -> f32 {
    // Below 2²⁴, so exact.
    ((((array * 10 + iteration) * 10 + env) * 10 + step) * 2 + agent) as f32 * 160.0
        + feature as f32
}

fn insert(replay: &mut Replay, dimensions: &Dimensions, iteration: usize) {
    let blocks = blocks(dimensions, iteration);
    let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
    replay.insert(dimensions, &shards);
}

/// Seven slots, four episodes an iteration: after three iterations the last seven episodes are there,
/// the newest where the oldest were.
#[test]
fn the_ring_wraps_around_and_keeps_the_newest_episodes() {
    for state in ["network.critic_state=compact", "network.critic_state=concatenated"] {
        let (mut replay, dimensions, config) = configured(&[state], 7);
        assert_eq!((replay.capacity, replay.len()), (7, 0));
        let numbers: usize = replay.arrays().iter().map(|(_, _, values)| values.len()).sum();
        assert_eq!(4 * numbers as u64, proto::layout::replay_bytes(&config, &dimensions));
        insert(&mut replay, &dimensions, 0);
        assert_eq!(replay.len(), 4 * 3);
        insert(&mut replay, &dimensions, 1);
        assert_eq!(replay.len(), 7 * 3, "no more than there is room for");
        insert(&mut replay, &dimensions, 2);
        assert_eq!((replay.len(), replay.episodes), (7 * 3, 12));

        let stored = state.ends_with("compact");
        assert_eq!(replay.state.is_empty(), !stored, "observations are stored once");
        let rows: Vec<usize> = (0..replay.len()).collect();
        let mut batch = replay.batch(rows.len());
        replay.gather(&rows, &mut batch);
        let (a, o) = (dimensions.n_agents, dimensions.observation);
        for row in rows {
            let (slot, step) = (row / 3, row % 3);
            // Episode e lies in slot e mod 7; of 0…11 the last seven are left.
            let episode = (5..12).find(|episode| episode % 7 == slot).expect("one of them");
            let (iteration, env) = (episode / 4, episode % 4);
            let check = |tensor: &Tensor, column: usize, expected: f32, what: &str| {
                let found = tensor.double_value(&[row as i64, column as i64]) as f32;
                assert_eq!(found, expected, "{what} of row {row}, column {column}");
            };
            for (agent, _, _, feature) in every([a, 1, 1, o]) {
                let seen = |step| number(1, iteration, env, step, agent, feature);
                let column = agent * o + feature;
                check(&batch.observation, column, seen(step), "observation");
                check(&batch.next_observation, column, seen(step + 1), "next observation");
            }
            for feature in 0..if stored { dimensions.state } else { 0 } {
                let seen = |step| number(2, iteration, env, step, 0, feature);
                check(batch.state.as_ref().expect("stored"), feature, seen(step), "state");
                let next = batch.next_state.as_ref().expect("stored");
                check(next, feature, seen(step + 1), "next state");
            }
            for agent in 0..a {
                for u in 0..3 {
                    let expected = number(3, iteration, env, step, agent, u);
                    check(&batch.action, agent * 3 + u, expected, "action");
                }
                check(&batch.reward, agent, number(4, iteration, env, step, agent, 0), "reward");
            }
            assert_eq!(batch.future.double_value(&[row as i64]), 1.0);
        }
    }
}

#[test]
fn an_iteration_that_does_not_fit_leaves_its_last_episodes() {
    let (mut replay, dimensions) = ring(&[], 3);
    insert(&mut replay, &dimensions, 0);
    assert_eq!((replay.len(), replay.episodes), (9, 4));
    let reward = |env| number(4, 0, env, 0, 0, 0);
    let first = |slot: usize| replay.reward[slot * 3 * 2];
    assert_eq!([first(0), first(1), first(2)], [reward(3), reward(1), reward(2)]);
}

#[test]
fn what_ends_for_good_has_no_future_and_a_time_limit_has_one_if_configured() {
    for (bootstrap, expected) in [("true", [0.0, 1.0]), ("false", [0.0, 0.0])] {
        let bootstrap = format!("algorithm.bootstrap_truncated={bootstrap}");
        let (mut replay, dimensions) = ring(&[&bootstrap], 4);
        let layout = BlockLayout::new(&dimensions);
        let mut blocks = blocks(&dimensions, 0);
        // Environment 1 ends after its second step, environment 3 is cut after its third.
        blocks[0][layout.terminated.start + 2 + 1] = 1.0;
        blocks[1][layout.truncated.start + 4 + 1] = 1.0;
        let shards: Vec<&[f32]> = blocks.iter().map(Vec::as_slice).collect();
        replay.insert(&dimensions, &shards);
        let [terminated, truncated] = expected;
        let mut future = [1.0; 12];
        (future[3 + 1], future[9 + 2]) = (terminated, truncated);
        assert_eq!(replay.future, future);
    }
}

#[test]
fn rows_are_drawn_uniformly_from_what_is_there_by_address() {
    let (mut replay, dimensions) = ring(&[], 7);
    insert(&mut replay, &dimensions, 0);
    let address =
        |env| Address { seed: 3, purpose: Purpose::Replay, iteration: 2, env, step: 0, index: 0 };
    let rows = replay.draw(address(0), 12_001);
    assert_eq!(rows.len(), 12_001);
    assert_eq!(rows[..100], replay.draw(address(0), 100));
    assert_ne!(rows[..100], replay.draw(address(1), 100));
    // Twelve steps are there; of each about 1000 draws, five standard errors of √(n p (1 − p)) = 30.
    for row in 0..12 {
        let count = rows.iter().filter(|&&drawn| drawn == row).count();
        assert!(count.abs_diff(1000) < 152, "row {row}: {count}");
    }
    assert!(rows.iter().all(|&row| row < 12));
}
