use std::collections::BTreeSet;

use super::*;
use crate::ConfigError;

fn resolve(assignments: &[&str]) -> Result<Config, ConfigError> {
    assignments
        .iter()
        .try_fold(Layers::new(Preset::Tuned, None), |layers, assignment| layers.set(assignment))?
        .resolve()
}

fn message(assignments: &[&str]) -> String {
    resolve(assignments).expect_err("the assignment is wrong").to_string()
}

#[test]
fn every_preset_resolves_for_both_tasks_and_survives_its_own_text() {
    for preset in Preset::ALL {
        for task in [TaskName::Trajectory, TaskName::Reorientation] {
            let config = Layers::new(preset, Some(task)).resolve().expect("presets are valid");
            assert_eq!(config.task.name, task);
            let again = Config::from_resolved_toml(&config.to_toml(), "text");
            assert_eq!(again.expect("resolved text is complete"), config);
        }
    }
}

/// A layer is checked against its preset, and a refused table is compared with one: a key that is not there would be
/// unknown, though a configuration has it.
#[test]
fn every_preset_holds_every_key_that_exists() {
    fn keys(table: &toml::Table, prefix: &str, into: &mut BTreeSet<String>) {
        for (name, value) in table {
            let key = format!("{prefix}{name}");
            if let toml::Value::Table(group) = value {
                keys(group, &format!("{key}."), into);
            }
            into.insert(key);
        }
    }
    for preset in Preset::ALL {
        let config = Layers::new(preset, None).resolve().expect("presets are valid");
        let resolved = toml::Table::try_from(&config).expect("a configuration has a TOML form");
        let (written, _) = preset.tables().expect("presets are TOML");
        let [mut exist, mut held] = [BTreeSet::new(), BTreeSet::new()];
        keys(&resolved, "", &mut exist);
        keys(&written, "", &mut held);
        assert_eq!(held, exist, "{}", preset.as_str());
    }
}

#[test]
fn a_task_brings_its_own_changes_and_a_flag_overrides_them() {
    let scale = |task, assignments: &[&str]| {
        assignments
            .iter()
            .fold(Layers::new(Preset::Release, Some(task)), |layers, a| {
                layers.set(a).expect("well formed")
            })
            .resolve()
            .expect("valid")
            .task
            .action_scale
    };
    assert_eq!(scale(TaskName::Trajectory, &[]), 0.8);
    assert_eq!(scale(TaskName::Reorientation, &[]), 0.5);
    assert_eq!(scale(TaskName::Reorientation, &["task.action_scale=0.7"]), 0.7);
}

#[test]
fn an_algorithm_brings_its_own_changes_and_a_later_layer_overrides_them() {
    for preset in Preset::ALL {
        for name in AlgorithmName::ALL {
            let layers = Layers::new(preset, None);
            let layers = layers.set(&format!("algorithm.name={}", name.as_str())).expect("TOML");
            let config = layers.resolve().expect("a preset knows what an algorithm wants");
            assert_eq!(config.algorithm.name, name);
        }
    }
    let own = resolve(&["algorithm.name=ippo"]).expect("valid").network.critic_state;
    assert_eq!(own, CriticState::Own);
    // The last name counts, and nothing stays of the one before.
    let back = resolve(&["algorithm.name=ippo", "algorithm.name=mappo"]).expect("valid");
    assert_eq!(back, resolve(&[]).expect("valid"));
    // A file may have changes for an algorithm, too, and takes them back from the preset.
    let file = "[for.ippo.network]\nhidden = [9]\n[for.ppo.network]\nhidden = [8]";
    let layers = Layers::new(Preset::Tuned, None).text(file, "my.toml").expect("TOML");
    let hidden = |layers: &Layers| layers.resolve().expect("valid").network.hidden;
    assert_eq!(hidden(&layers), [256, 256, 256]);
    assert_eq!(hidden(&layers.set("algorithm.name=ippo").expect("TOML")), [9]);
}

/// The released code lowers its noise by 5e-7 a step.
#[test]
fn exploration_and_updates_follow_the_env_steps() {
    let settings = Maddpg { random: 0.2, random_final: 0.1, ..Maddpg::default() };
    let at = |steps| settings.exploration(steps);
    assert_eq!(at(0), Exploration { limit: 10.0, std: 1.0, random: 0.2 });
    let half = at(50_000);
    assert!((half.std - 10.0 * (0.1 - 5e-7 * 50_000.0)).abs() < 1e-12, "{half:?}");
    assert!((half.random - 0.15).abs() < 1e-12, "{half:?}");
    assert_eq!((at(100_000).std, at(9_000_000).std), (0.5, 0.5));
    let settings = Maddpg { learning_starts: 100, updates_per_step: 0.3, ..settings };
    assert_eq!(
        [0, 100, 103, 104, 110, 200].map(|n| settings.updates_until(n)),
        [0, 0, 0, 1, 3, 30]
    );
}

#[test]
fn a_configuration_from_before_maddpg_is_read() {
    let config = resolve(&[]).expect("valid");
    let mut table: toml::Table = config.to_toml().parse().expect("TOML");
    let algorithm = table["algorithm"].as_table_mut().expect("a group");
    algorithm.remove("maddpg").expect("there");
    let read = Config::from_resolved_toml(&table.to_string(), "text").expect("complete");
    assert_eq!(read.algorithm.maddpg, Maddpg::default());
    assert_eq!((read.task, read.network), (config.task, config.network));
}

#[test]
fn changes_for_a_name_that_is_no_task_and_no_algorithm_are_refused() {
    let error = |text: &str| {
        let layers = Layers::new(Preset::Tuned, None).text(text, "my.toml").expect("TOML");
        layers.resolve().expect_err("refused").to_string()
    };
    let unknown = error("[for.mapo.network]\nhidden = [9]");
    assert!(
        unknown.contains("for.mapo") && unknown.contains("did you mean `for.mappo`"),
        "{unknown}"
    );
    let flat = error("[for]\nippo = 3");
    assert!(flat.contains("for.ippo") && flat.contains("a table of groups"), "{flat}");
}

#[test]
fn values_are_toml_and_bare_words_are_strings() {
    let config = resolve(&[
        "network.hidden=[64,64]",
        "run.device=cuda:1",
        "run.env_steps=2e6",
        "algorithm.gamma=1",
        "network.activation=tanh",
    ])
    .expect("valid");
    assert_eq!(config.network.hidden, [64, 64]);
    assert_eq!(config.run.device, "cuda:1");
    assert_eq!(config.run.env_steps, 2_000_000);
    assert_eq!(config.algorithm.gamma, 1.0);
    assert_eq!(config.network.activation, Activation::Tanh);
}

#[test]
fn errors_name_the_layer_the_key_and_the_cure() {
    let unknown = message(&["algorithm.gama=0.9"]);
    assert!(unknown.contains("--set algorithm.gama=0.9"), "{unknown}");
    assert!(unknown.contains("did you mean `algorithm.gamma`"), "{unknown}");

    let wrong = message(&["algorithm.gamma=\"high\""]);
    assert!(wrong.contains("wants a number") && wrong.contains("the string"), "{wrong}");

    let shards = message(&["env.n_envs=10", "env.n_shards=4"]);
    assert!(shards.contains("divides env.n_envs"), "{shards}");

    let range = message(&["run.workers=257"]);
    assert!(range.contains("run.workers") && range.contains("0 to 256"), "{range}");

    let word = message(&["network.activation=sigmoid"]);
    assert!(word.contains("relu") && word.contains("sigmoid"), "{word}");

    let critic = message(&["algorithm.name=ippo", "network.critic_state=compact"]);
    assert!(
        critic.contains("network.critic_state") && critic.contains("own with ippo"),
        "{critic}"
    );
    let unbounded = message(&["algorithm.name=maddpg", "network.squash_mean=false"]);
    assert!(unbounded.contains("network.squash_mean"), "{unbounded}");
    let small = message(&["algorithm.name=maddpg", "algorithm.maddpg.replay_steps=49"]);
    assert!(small.contains("algorithm.maddpg.replay_steps"), "{small}");
    let unknown = message(&["algorithm.maddpg.noize=1"]);
    assert!(unknown.contains("did you mean `algorithm.maddpg.noise`"), "{unknown}");
    let shared = message(&["algorithm.name=ppo", "network.parameter_sharing=all"]);
    assert!(shared.contains("one network that acts for all agents"), "{shared}");
    let name = message(&["algorithm.name=pppo"]);
    assert!(name.contains("pppo") && name.contains("mappo"), "{name}");

    let wide = message(&["network.initial_log_std=3", "network.wrist_log_std_offset=3"]);
    assert!(wide.contains("network.wrist_log_std_offset") && wide.contains("begin at 6"), "{wide}");
    let below = ["network.min_log_std=-1", "network.wrist_log_std_offset=-1.5"];
    assert!(message(&below).contains("network.min_log_std"));
    let one_for_both = [&below[..], &["network.parameter_sharing=all"]].concat();
    assert!(resolve(&one_for_both).is_ok(), "there are no deviations of wrists");

    let nan = message(&["algorithm.gamma=nan"]);
    assert!(nan.contains("algorithm.gamma"), "{nan}");
}

#[test]
fn errors_speak_of_keys_and_values_and_not_of_this_program() {
    let rust = ["usize", "u64", "u32", "i64", "f64", "TOML", "variant", "field", "struct"];
    for (assignment, key, allowed) in [
        ("network.hidden=[64,-1]", "`network.hidden`", "whole numbers, none below 0"),
        ("network.hidden=[64,\"wide\"]", "`network.hidden`", "list of whole numbers"),
        ("network.hidden=[]", "`network.hidden`", "has no layer; give 1 to 16 widths"),
        ("run.workers=-1", "`run.workers`", "a whole number, not below 0"),
        ("run.evaluation_steps=5000000000", "`run.evaluation_steps`", "at most 4294967295"),
        ("network.activation=sigmoid", "`network.activation`", "`relu`, `elu`, `tanh`"),
        ("task.start.share=\"half\"", "`task.start.share`", "a number such as"),
        ("run.pin=1", "`run.pin`", "true or false"),
    ] {
        let error = message(&["run.seed=5", assignment, "run.overlap=0"]);
        assert!(error.contains(key) && error.contains(allowed), "{assignment}: {error}");
        assert!(!rust.iter().any(|word| error.contains(word)), "{assignment}: {error}");
        let others =
            error.contains("preset") || error.contains("seed") || error.contains("overlap");
        assert!(!others, "{assignment} alone is at fault: {error}");
    }
    // Widths may be written as large counts are.
    assert_eq!(resolve(&["network.hidden=[2e2,64]"]).expect("valid").network.hidden, [200, 64]);
}

#[test]
fn a_resolved_text_that_is_none_is_told_by_its_key() {
    let complete = resolve(&[]).expect("valid").to_toml();
    let refused = |text: &str| {
        let error =
            Config::from_resolved_toml(text, "run/config.toml").expect_err(text).to_string();
        assert!(error.starts_with("run/config.toml: "), "{error}");
        error
    };
    let without = |key: &str| {
        let lines: Vec<&str> = complete.lines().filter(|line| !line.starts_with(key)).collect();
        refused(&lines.join("\n"))
    };
    assert!(refused("").ends_with("key `algorithm` is missing"), "{}", refused(""));
    assert!(without("gamma =").contains("key `algorithm.gamma` is missing"));
    let changed = |from: &str, to: &str| {
        assert!(complete.contains(from), "{from}");
        refused(&complete.replace(from, to))
    };
    let word = changed("activation = \"elu\"", "activation = \"elo\"");
    assert!(word.contains("`network.activation` wants one of `relu`, `elu`, `tanh`"), "{word}");
    let count = changed("n_envs = 16", "n_envs = -16");
    assert!(count.contains("`env.n_envs` wants a whole number, not below 0"), "{count}");
    let unknown = changed("gamma =", "gama =");
    assert!(
        unknown.contains("unknown key `algorithm.gama`; did you mean `algorithm.gamma`?"),
        "{unknown}"
    );
    let group = changed("[robot]", "[robots]");
    assert!(group.contains("unknown key `robots`; did you mean `robot`?"), "{group}");
    assert!(refused("[task\n").contains("line 1"));
}

/// What may differ between two runs that end with the same bits is decided by whoever adds a key.
#[test]
fn every_key_of_the_run_is_known_to_matter_or_not() {
    let run = resolve(&[]).expect("valid").run;
    let table = toml::Table::try_from(&run).expect("TOML");
    let matter = ["seed", "env_steps", "overlap", "device", "precision", "learner_threads"];
    let keys: BTreeSet<&str> = table.keys().map(String::as_str).collect();
    assert_eq!(keys, Run::HARMLESS.into_iter().chain(matter).collect());
    assert!(Run::CHANGEABLE.iter().all(|key| matter.contains(key)));
}

#[test]
fn a_run_goes_on_with_other_housekeeping_but_not_with_another_course() {
    let run = |assignment: &str| resolve(&[assignment]).expect("valid").run;
    let plain = resolve(&[]).expect("valid").run;
    for harmless in ["run.workers=7", "run.pin=true", "run.evaluate_every=3", "run.env_steps=9e9"] {
        assert!(run(harmless).continues(&plain), "{harmless}");
    }
    for fixed in ["run.seed=9", "run.overlap=1", "run.precision=bf16", "run.learner_threads=7"] {
        assert!(!run(fixed).continues(&plain), "{fixed}");
    }
}

#[test]
fn without_housekeeping_only_harmless_keys_change() {
    let run = resolve(&["run.time_limit_s=9", "run.milestone_every_s=9", "run.keep_every=9"]);
    let run = run.expect("valid").run;
    let table = |run: &Run| toml::Table::try_from(run).expect("TOML");
    let (before, after) = (table(&run), table(&run.clone().without_housekeeping()));
    let changed: Vec<&String> =
        before.iter().filter(|(key, value)| after[*key] != **value).map(|(key, _)| key).collect();
    assert!(changed.len() >= 3, "{changed:?}");
    assert!(changed.iter().all(|key| Run::HARMLESS.contains(&key.as_str())), "{changed:?}");
}

#[test]
fn a_file_is_named_in_its_errors() {
    let layers = Layers::new(Preset::Paper, None);
    let error = layers.text("[task\n", "my.toml").expect_err("broken").to_string();
    assert!(error.contains("my.toml") && error.contains("line 1"), "{error}");
}

proptest::proptest! {
    #[test]
    fn any_assignment_resolves_or_is_refused(key in "[a-z.]{0,20}", value in ".{0,30}") {
        let _ = Layers::new(Preset::Tuned, None).set(&format!("{key}={value}")).map(|l| l.resolve());
    }
}

#[test]
fn a_deadline_that_healthy_processes_would_miss_is_refused_with_the_least_one() {
    for seconds in ["0.1", "1.49", "-1.0"] {
        let error = message(&[&format!("run.order_deadline_s={seconds}")]);
        assert!(error.contains("`run.order_deadline_s`"), "{error}");
    }
    let error = message(&["run.order_deadline_s=0.1"]);
    assert!(error.contains("every 0.5 s") && error.contains("1.5 s or more"), "{error}");
    let least = resolve(&["run.order_deadline_s=1.5"]).expect("long enough");
    assert_eq!(least.run.order_deadline_s, 1.5);
}

/// A shell takes the quotes that TOML wants, and addresses and paths have more than plain letters.
#[test]
fn a_key_that_wants_text_takes_what_is_no_toml() {
    for text in ["file:///a,b", "file:///a+b%20", "file:///it's", "file:///[x]"] {
        let config = resolve(&[&format!("run.checkpoints={text}")]).expect(text);
        assert_eq!(config.run.checkpoints, text);
    }
    let config = resolve(&["robot.description=my robot #2.toml"]).expect("a name");
    assert_eq!(config.robot.description, "my robot #2.toml");
    let quoted = resolve(&["run.checkpoints=\"file:///a,b\""]).expect("TOML");
    assert_eq!(quoted.run.checkpoints, "file:///a,b");
    for wrong in ["algorithm.gamma=a,b", "run.checkpoints=\"file:///a"] {
        let message = message(&[wrong]);
        assert!(message.starts_with(&format!("--set {wrong}: not valid TOML")), "{message}");
        assert!(!message.contains("value ="), "{message}");
    }
    // Of what is misspelt the key is wrong.
    let message = message(&["run.chekpoints=file:///a,b"]);
    assert!(message.contains("unknown key `run.chekpoints`; did you mean"), "{message}");
}

/// What stood in further lines was dropped.
#[test]
fn an_assignment_is_of_one_key() {
    for wrong in [
        "algorithm.gamma=0.9\nalgorithm.clip=0.1",
        "run.seed=1\nfoo=2",
        "algorithm.gamma=0.9,algorithm.clip=0.1",
        "run.seed=1 run.workers=2",
        "network.hidden=[64,64]; run.seed=2",
        // Of keys that want a text.
        "run.device=cpu,run.seed=2",
        "run.checkpoints=file:///a run.seed=2",
    ] {
        let message = message(&[wrong]);
        assert!(message.contains("expected one KEY=VALUE; write --set once"), "{message}");
        assert!(!message.contains("TOML"), "{message}");
    }
    let trial = "file:///sweeps/gamma=0.9,run=5,seed=2";
    let config = resolve(&[&format!("run.checkpoints={trial}")]).expect("no key has such a name");
    assert_eq!(config.run.checkpoints, trial);
    let quoted = resolve(&["run.checkpoints=\"file:///a,run.seed=2\""]).expect("a text");
    assert_eq!(quoted.run.checkpoints, "file:///a,run.seed=2");
    let lines = resolve(&["network.hidden=[64,\n64]"]).expect("one value");
    assert_eq!(lines.network.hidden, [64, 64]);
}

#[test]
fn a_whole_number_beyond_those_of_toml_is_called_too_large() {
    let large = ["9223372036854775808", "99999999999999999999", "-9223372036854775809", "1e400"];
    for value in large {
        let message = message(&[&format!("run.seed={value}")]);
        assert!(message.contains("too large") && !message.contains("string"), "{message}");
    }
    // What is nothing is no number.
    assert!(message(&["run.workers="]).contains("wants a whole number"));
}

#[test]
fn secrets_in_addresses_are_not_repeated() {
    let keys = ["run.checkpoints", "run.device", "run.workers", "no.such", "task.name", "for"];
    for key in keys.into_iter().chain(["s3://user:secret@bucket/x", "for.s3://user:secret@b"]) {
        let message = message(&[&format!("{key}=s3://user:secret@bucket/x")]);
        assert!(!message.contains("secret"), "{message}");
    }
    let file = "[run]\ncheckpoints = s3://user:secret@bucket/x";
    let error = Layers::new(Preset::Tuned, None).text(file, "my.toml").expect_err("no quotes");
    let message = error.to_string();
    assert!(message.contains("line 2") && !message.contains("secret"), "{message}");
}

#[test]
fn a_divergence_that_nobody_would_find_is_no_aim() {
    let resolved = |name: &str, [epochs, mini_batches, overlap]: [&str; 3]| {
        let assignments = [
            format!("algorithm.name={name}"),
            format!("algorithm.epochs={epochs}"),
            format!("algorithm.mini_batches={mini_batches}"),
            format!("run.overlap={overlap}"),
            "optimizer.target_kl=0.01".to_owned(),
        ];
        let layers = assignments.iter().fold(Layers::new(Preset::Paper, None), |layers, text| {
            layers.set(text).expect("well formed")
        });
        layers.resolve().map_err(|error| error.to_string())
    };
    let message = resolved("mappo", ["1", "1", "0"]).expect_err("one step");
    assert!(message.contains("optimizer.target_kl") && message.contains("one step"), "{message}");
    let config = resolved("mappo", ["1", "2", "0"]).expect("two steps");
    resolved("mappo", ["1", "1", "1"]).expect("the update before is found");
    resolved("maddpg", ["1", "1", "0"]).expect("it asks for no divergence");
    // What a run began with it may go on with.
    let text =
        toml::to_string(&config).expect("TOML").replace("mini_batches = 2", "mini_batches = 1");
    let old = Config::from_resolved_toml(&text, "config.toml").expect("a run's own");
    assert_eq!(old.algorithm.mini_batches, 1);
}
