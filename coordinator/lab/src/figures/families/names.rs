//! What curves are called: by the keys in which their configurations differ, and by no more of them than tell them apart.

use std::collections::{BTreeMap, BTreeSet};

use proto::config::{Config, Run};
use store::checkpoint::flatten;

/// Longest value that a name holds.
const LONGEST: usize = 24;

/// Keys of a configuration and their values.
type Keys = BTreeMap<String, String>;

/// The names of curves whose configurations differ, those of one task among themselves.
pub(super) fn of(configs: &[&Config]) -> Vec<String> {
    let keys: Vec<Keys> = configs.iter().map(|config| keys(config)).collect();
    let mut telling: Vec<Vec<&String>> = vec![Vec::new(); configs.len()];
    let heading = |index: usize| {
        let Config { task, algorithm, .. } = configs[index];
        (task.name.as_str(), algorithm.name.as_str())
    };
    // Those that are called alike get one more key, until there are none, or no key tells them apart.
    loop {
        let mut alike: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (index, telling) in telling.iter().enumerate() {
            let values: Vec<_> = telling.iter().map(|key| keys[index].get(*key)).collect();
            alike.entry((heading(index), telling.clone(), values)).or_default().push(index);
        }
        let groups: Vec<Vec<usize>> = alike.into_values().filter(|group| group.len() > 1).collect();
        let mut told = false;
        for group in groups {
            if let Some(key) = most_telling(&keys, &group) {
                for index in group {
                    telling[index].push(key);
                }
                told = true;
            }
        }
        if !told {
            break;
        }
    }
    let name = |index: usize, shown: fn(&str) -> String| {
        let values = telling[index].iter().map(|key| {
            let value = keys[index].get(*key).map_or("none", String::as_str);
            format!("{}={}", short(key, &keys), shown(value))
        });
        let parts: Vec<String> = [heading(index).1.to_owned()].into_iter().chain(values).collect();
        parts.join(", ")
    };
    let names: Vec<String> = (0..configs.len()).map(|index| name(index, shown)).collect();
    // Two values may look alike where they are cut.
    let is_alone = |index: usize| {
        let alike =
            |other: &usize| heading(*other) == heading(index) && names[*other] == names[index];
        (0..names.len()).filter(alike).count() == 1
    };
    let told = |index| if is_alone(index) { names[index].clone() } else { name(index, bare) };
    (0..configs.len()).map(told).collect()
}

/// What changes what is learned, but for the seed.
fn keys(config: &Config) -> Keys {
    let table = toml::Table::try_from(config).expect("a typed configuration has a TOML form");
    let mut keys = flatten(&table);
    keys.retain(|key, _| {
        let of_run = key.strip_prefix("run.");
        !of_run.is_some_and(|key| key == "seed" || Run::HARMLESS.contains(&key))
    });
    keys
}

/// The key with the most values among those of `group`; of several the first.
fn most_telling<'a>(keys: &'a [Keys], group: &[usize]) -> Option<&'a String> {
    let values = |key: &String| -> BTreeSet<Option<&String>> {
        group.iter().map(|index| keys[*index].get(key)).collect()
    };
    let all: BTreeSet<&String> = group.iter().flat_map(|index| keys[*index].keys()).collect();
    let telling = all.into_iter().map(|key| (values(key).len(), key)).filter(|(n, _)| *n > 1);
    telling.reduce(|best, next| if next.0 > best.0 { next } else { best }).map(|(_, key)| key)
}

/// The last part of a key, if no other key ends so.
fn short<'a>(key: &'a str, keys: &[Keys]) -> &'a str {
    let last = key.rsplit('.').next().unwrap_or(key);
    let ends_so = |other: &&String| other.rsplit('.').next() == Some(last);
    let alike: BTreeSet<&String> =
        keys.iter().flat_map(|keys| keys.keys()).filter(ends_so).collect();
    if alike.len() == 1 { last } else { key }
}

/// A whole value, words without their quotes.
fn bare(value: &str) -> String {
    value.trim_matches('"').replace(", ", ",")
}

/// A value as a name holds it: words bare, of paths the end, and cut if it is long.
fn shown(value: &str) -> String {
    let bare = bare(value);
    let bare = bare.rsplit('/').next().unwrap_or(&bare).to_owned();
    if bare.chars().count() <= LONGEST {
        return bare;
    }
    bare.chars().take(LONGEST - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use proto::config::{Layers, Preset, TaskName};

    use super::*;

    fn names(task: TaskName, all: &[&[&str]]) -> Vec<String> {
        let config = |sets: &&[&str]| {
            let layers = Layers::new(Preset::Tuned, Some(task));
            let layers = sets.iter().try_fold(layers, |layers, set| layers.set(set));
            layers.and_then(|layers| layers.resolve()).expect("valid")
        };
        let configs: Vec<Config> = all.iter().map(config).collect();
        of(&configs.iter().collect::<Vec<_>>())
    }

    #[test]
    fn curves_are_named_by_what_they_differ_in_and_by_no_more() {
        let trajectory = |all| names(TaskName::Trajectory, all);
        assert_eq!(trajectory(&[&[]]), ["mappo"], "nothing differs");
        // They differ in more than that, but need not be told apart by it.
        assert_eq!(trajectory(&[&[], &["algorithm.name=ppo"]]), ["mappo", "ppo"]);
        assert_eq!(
            trajectory(&[
                &["algorithm.gamma=0.9"],
                &["algorithm.gamma=0.97"],
                &["algorithm.name=ppo"]
            ]),
            ["mappo, gamma=0.9", "mappo, gamma=0.97", "ppo"]
        );
        assert_eq!(
            trajectory(&[
                &["network.hidden=[64,64]", "algorithm.clip=0.1"],
                &["network.hidden=[64,64]", "algorithm.clip=0.2"],
                &["network.hidden=[8]", "algorithm.clip=0.2"],
            ]),
            ["mappo, clip=0.1", "mappo, clip=0.2, hidden=[64,64]", "mappo, clip=0.2, hidden=[8]"]
        );
    }

    #[test]
    fn a_key_whose_end_is_anothers_is_written_whole_and_seeds_are_none() {
        let of = |set: &'static str| vec![set, "run.seed=7", "run.workers=3"];
        let (one, other) = (of("optimizer.epsilon=1e-5"), of("optimizer.epsilon=1e-6"));
        let found = names(TaskName::Trajectory, &[&one, &other]);
        assert!(found[0].starts_with("mappo, optimizer.epsilon="), "{found:?}");
        assert_ne!(found[0], found[1]);
    }

    #[test]
    fn values_that_look_alike_where_they_are_cut_are_written_whole() {
        let found = names(
            TaskName::Trajectory,
            &[
                &["robot.description=a/x.toml"],
                &["robot.description=b/x.toml"],
                &["robot.description=b/y.toml"],
            ],
        );
        let wanted = ["a/x.toml", "b/x.toml", "y.toml"];
        assert_eq!(found, wanted.map(|path| format!("mappo, description={path}")));
        let widths = |last: u32| format!("network.hidden=[1024,1024,1024,1024,1024,{last}]");
        let (one, other) = (widths(1), widths(2));
        let found = names(TaskName::Trajectory, &[&[&one], &[&other]]);
        assert!(found[0].ends_with("1024,1]") && found[1].ends_with("1024,2]"), "{found:?}");
    }

    #[test]
    fn long_values_are_cut_and_paths_end_in_their_file() {
        assert_eq!(shown("\"robots/of/mine/two-arm.toml\""), "two-arm.toml");
        let cut = shown("[1024, 1024, 1024, 1024, 1024, 1024]");
        assert_eq!((cut.chars().count(), cut.chars().last()), (LONGEST, Some('…')));
    }
}
