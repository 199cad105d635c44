//! Goals of a person's own, and goals that were drawn, as files.
//!
//! An episode a row. As CSV with a header: `hand1_x … hand1_c` to `hand4_c` (position in the world in m, Euler angles x-y-z in rad) and
//! `base_a, base_b, base_c` (Euler angles, rad), in any order; a hand without columns, or with empty cells, keeps the goal that is drawn. As
//! JSON the same: a list of `{"hands": [[x, y, z, a, b, c] or null, …], "base": [a, b, c] or null}`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use proto::config::TaskName;
use proto::tasks::Aim;
use proto::{ExitCode, ExitError};
use serde::{Deserialize, Serialize};
use simulator::experiment::{EvaluationGoals, FixedGoals};
use simulator::rollout::World;
use store::regular_files;

/// Longest file that is read (bytes).
const LONGEST: u64 = 256 << 20;

/// Episodes of a file, at most.
const MOST_EPISODES: usize = 1_000_000;

/// Largest number of a goal: nothing that can be reached is farther away (m), or turned so often (rad).
const LARGEST: f64 = 1000.0;

const HAND: [&str; 6] = ["x", "y", "z", "a", "b", "c"];
const BASE: [&str; 3] = ["a", "b", "c"];

/// Goals of one episode, as files have them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Row {
    hands: Vec<Option<[f64; 6]>>,
    base: Option<[f64; 3]>,
}

/// Where a number of a column belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Hand(usize, usize),
    Base(usize),
}

/// Goals of a person's own.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnGoals {
    /// Where they are from.
    pub file: PathBuf,
    /// An entry an episode.
    pub given: Vec<FixedGoals>,
    /// Arms of the robot that they are for.
    n_arms: usize,
}

impl OwnGoals {
    /// Goals for a robot with so many arms, from a file whose name says what it is.
    pub fn read(path: &Path, n_arms: usize) -> Result<Self, ExitError> {
        Ok(Self { file: path.to_owned(), given: read(path, n_arms)?, n_arms })
    }

    /// Refuses goals none of which one of `tasks` moves to.
    pub fn check(&self, tasks: impl Iterator<Item = TaskName>) -> Result<(), ExitError> {
        let mut wanted = Vec::new();
        for task in tasks {
            let reaches = |arm| task.reaches() && task.aim(arm, self.n_arms) == Aim::Hand;
            let is_met = |goals: &FixedGoals| {
                let mut hands = goals.hands.iter().enumerate();
                hands.any(|(arm, goal)| goal.is_some() && reaches(arm))
                    || task.turns() && goals.base.is_some()
            };
            if self.given.iter().any(is_met) {
                return Ok(());
            }
            let what = match (task.reaches(), task.turns()) {
                (true, true) => "hands or the base",
                (true, false) => "hands",
                (false, _) => "the base",
            };
            wanted.push(format!("goals of {what}, which `{}` has", task.as_str()));
        }
        let message = format!("{}: expected {}", self.file.display(), wanted.join(" or "));
        Err(ExitError::new(ExitCode::BadInput, message))
    }

    /// So many of them are played: all, unless fewer are asked for.
    pub fn episodes(&self, asked: Option<u32>) -> Result<u32, ExitError> {
        let n = self.given.len();
        let all = u32::try_from(n).unwrap_or(u32::MAX);
        match asked {
            Some(asked) if asked > all => {
                let message = format!(
                    "--episodes {asked}: {} has goals of {}",
                    self.file.display(),
                    output::counted(n as u64, "episode")
                );
                Err(ExitError::new(ExitCode::Usage, message))
            }
            asked => Ok(asked.unwrap_or(all)),
        }
    }
}

fn read(path: &Path, n_arms: usize) -> Result<Vec<FixedGoals>, ExitError> {
    let bad =
        |what: String| ExitError::new(ExitCode::BadInput, format!("{}: {what}", path.display()));
    let json = is_json(path).map_err(bad)?;
    let bytes = regular_files::read(path, LONGEST)
        .map_err(|error| bad(format!("cannot be read: {error}")))?;
    parse(&bytes, json, n_arms).map_err(bad)
}

/// Whether a file's name says JSON; CSV otherwise.
fn is_json(path: &Path) -> Result<bool, String> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("json") => Ok(true),
        Some("csv") => Ok(false),
        _ => Err("is a file of goals CSV or JSON? expected a name in .csv or .json".to_owned()),
    }
}

/// Goals from bytes of CSV or JSON.
///
/// # Errors
/// What is wrong with them.
pub fn parse(bytes: &[u8], json: bool, n_arms: usize) -> Result<Vec<FixedGoals>, String> {
    let rows: Vec<Row> = if json {
        serde_json::from_slice(bytes).map_err(|error| error.to_string())?
    } else {
        from_csv(bytes, n_arms)?
    };
    if rows.is_empty() {
        return Err("has no goals, expected a row for every episode".to_owned());
    }
    if rows.len() > MOST_EPISODES {
        return Err(format!("has {} episodes, expected {MOST_EPISODES} at most", rows.len()));
    }
    for (index, Row { hands, base }) in rows.iter().enumerate() {
        let row = index + 1;
        if hands.len() > n_arms {
            let n = hands.len();
            return Err(format!("row {row} has goals of {n} hands, the robot has {n_arms}"));
        }
        let numbers = hands.iter().flatten().flatten().chain(base.iter().flatten());
        if let Some(number) =
            numbers.into_iter().find(|number| number.is_nan() || number.abs() > LARGEST)
        {
            return Err(format!("row {row}: {number} is no goal, expected -1000 to 1000"));
        }
        if hands.iter().all(Option::is_none) && base.is_none() {
            return Err(format!("row {row} has no goal"));
        }
    }
    Ok(rows.into_iter().map(|Row { hands, base }| FixedGoals { hands, base }).collect())
}

fn from_csv(bytes: &[u8], n_arms: usize) -> Result<Vec<Row>, String> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let header = reader.headers().map_err(|error| error.to_string())?.clone();
    let columns = header.iter().map(|name| column(name, n_arms)).collect::<Result<Vec<_>, _>>()?;
    for (index, column) in columns.iter().enumerate() {
        if columns[..index].contains(column) {
            return Err(format!("column {} is there twice", &header[index]));
        }
    }
    let mut rows = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(|error| error.to_string())?;
        let mut numbers = vec![[None; 6]; n_arms];
        let mut attitude = [None; 3];
        for ((column, cell), name) in columns.iter().zip(&record).zip(&header) {
            if cell.is_empty() {
                continue;
            }
            let number = cell
                .parse::<f64>()
                .map_err(|_| format!("row {}, column {name}: `{cell}` is no number", index + 1))?;
            match *column {
                Column::Hand(arm, at) => numbers[arm][at] = Some(number),
                Column::Base(at) => attitude[at] = Some(number),
            }
        }
        let whole =
            |name: &str| format!("row {}: {name} has some of its numbers, not all", index + 1);
        let hands = numbers.iter().enumerate().map(|(arm, numbers)| {
            all(numbers).map_err(|()| whole(&format!("the goal of hand {}", arm + 1)))
        });
        let base = all(&attitude).map_err(|()| whole("the goal of the base"))?;
        rows.push(Row { hands: hands.collect::<Result<_, _>>()?, base });
    }
    Ok(rows)
}

/// All numbers, or none; an error if there are only some.
fn all<const N: usize>(numbers: &[Option<f64>; N]) -> Result<Option<[f64; N]>, ()> {
    if numbers.iter().all(Option::is_none) {
        return Ok(None);
    }
    let found: Vec<f64> = numbers.iter().flatten().copied().collect();
    found.try_into().map(Some).map_err(|_| ())
}

fn column(name: &str, n_arms: usize) -> Result<Column, String> {
    let wrong = || {
        format!(
            "column {name:?}: expected hand1_x, _y, _z (m), _a, _b, _c (rad) to hand{n_arms}_c, or base_a, base_b, base_c (rad)"
        )
    };
    let place = |names: &[&str], part: &str| names.iter().position(|name| *name == part);
    let (whose, part) = name.rsplit_once('_').ok_or_else(wrong)?;
    let found = if whose == "base" {
        place(&BASE, part).map(Column::Base)
    } else {
        let hand = whose.strip_prefix("hand").and_then(|hand| hand.parse::<usize>().ok());
        let arm = hand.and_then(|hand| hand.checked_sub(1)).filter(|arm| *arm < n_arms);
        arm.and_then(|arm| Some(Column::Hand(arm, place(&HAND, part)?)))
    };
    found.ok_or_else(wrong)
}

/// The goals that episodes of an evaluation have in a world, as a file of this name has them: those that its task has.
pub fn write(
    path: &Path,
    world: &World,
    goals: EvaluationGoals<'_>,
    episodes: usize,
) -> anyhow::Result<Vec<u8>> {
    let bad = |what| ExitError::new(ExitCode::Usage, format!("{}: {what}", path.display()));
    let json = is_json(path).map_err(bad)?;
    let task = world.task.name;
    let reaches = |arm: usize| world.task.aims[arm] == Aim::Hand;
    let row = |episode: u32| {
        let hand = |arm| reaches(arm).then(|| goals.hand(world, episode, arm));
        let arms = 0..if task.reaches() { world.robot.n_arms } else { 0 };
        Row {
            hands: arms.map(hand).collect(),
            base: task.turns().then(|| goals.base(world, episode)),
        }
    };
    let rows: Vec<Row> = (0..episodes as u32).map(row).collect();
    if json {
        let mut text = serde_json::to_vec_pretty(&rows)?;
        text.push(b'\n');
        return Ok(text);
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    let hands = (0..world.robot.n_arms).filter(|arm| reaches(*arm));
    let hands = hands.flat_map(|arm| HAND.map(|part| format!("hand{}_{part}", arm + 1)));
    let base = BASE.iter().filter(|_| task.turns()).map(|part| format!("base_{part}"));
    let header: Vec<String> = hands.chain(base).collect();
    writer.write_record(header)?;
    for Row { hands, base } in &rows {
        let numbers = hands.iter().flatten().flatten().chain(base.iter().flatten());
        writer.write_record(numbers.map(f64::to_string))?;
    }
    writer.into_inner().context("the table cannot be finished")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(text: &str) -> Result<Vec<FixedGoals>, String> {
        parse(text.as_bytes(), false, 4)
    }

    #[test]
    fn columns_may_stand_in_any_order_and_be_left_out() {
        let goals =
            csv("hand2_x,hand2_y,hand2_z,hand2_b,hand2_a,hand2_c\n1,2,3,5,4,6\n").expect("read");
        assert_eq!(goals.len(), 1);
        assert_eq!(goals[0].hands, vec![None, Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), None, None]);
        let goals = csv("base_a, base_b, base_c\n0.1, 0, -0.2\n").expect("read");
        assert_eq!(goals[0].base, Some([0.1, 0.0, -0.2]));
        let json = br#"[{"hands": [null, [1, 2, 3, 4, 5, 6]]}, {"base": [0.1, 0, 0]}]"#;
        let goals = parse(json, true, 4).expect("read");
        assert_eq!(goals[0].hands[1], Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        assert_eq!(goals[1].base, Some([0.1, 0.0, 0.0]));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, said) in [
            ("", "has no goals"),
            ("base_a,base_b,base_c\n", "has no goals"),
            ("hand5_x\n1\n", "column \"hand5_x\": expected hand1_x"),
            ("hand0_x\n1\n", "expected hand1_x"),
            ("base_x\n1\n", "expected hand1_x"),
            ("base_a,base_a,base_c\n1,2,3\n", "column base_a is there twice"),
            ("base_a,base_b,base_c\n1,x,3\n", "row 1, column base_b: `x` is no number"),
            ("base_a,base_b,base_c\n1,,3\n", "row 1: the goal of the base has some of its numbers"),
            ("base_a,base_b,base_c\n1,nan,3\n", "NaN is no goal"),
            ("base_a,base_b,base_c\n1,1e9,3\n", "1000000000 is no goal"),
            ("base_a,base_b,base_c\n,,\n", "row 1 has no goal"),
        ] {
            let found = csv(text).expect_err(text);
            assert!(found.contains(said), "{text:?}: {found}");
        }
        for (text, said) in [
            ("{}", "invalid type"),
            (r#"[{"hand": []}]"#, "unknown field"),
            (r#"[{"hands": [null, null, null, null, [1,2,3,4,5,6]]}]"#, "goals of 5 hands"),
        ] {
            let found = parse(text.as_bytes(), true, 4).expect_err(text);
            assert!(found.contains(said), "{text:?}: {found}");
        }
        assert!(is_json(Path::new("goals.txt")).is_err());
    }
}
