//! The table of a motion: a row a control step, the robot's state after it. `simulate` and `plan` write it, and begin where one ends.

use std::path::Path;

use anyhow::Context as _;
use proto::{ExitCode, ExitError};
use simulator::robot::Robot;
use simulator::simulate::{Precision, SimulationRow};
use simulator::state::State;
use store::regular_files;

/// What a trajectory begins with.
pub(crate) const MARK: &[u8] = b"t,base_x,base_y,base_z,";

/// Longest file that is read (bytes): a million control steps of a large robot.
pub(crate) const MAX_BYTES: u64 = 256 << 20;

/// The names of the columns.
fn header(n_arms: usize, n_joints: usize) -> Vec<String> {
    let numbered = |name: &'static str| (0..n_joints).map(move |joint| format!("{name}{joint}"));
    let fixed = |names: &'static str| names.split(' ').map(str::to_owned);
    fixed("t base_x base_y base_z base_qw base_qx base_qy base_qz")
        .chain(numbered("q"))
        .chain(fixed("base_vx base_vy base_vz base_wx base_wy base_wz"))
        .chain(numbered("qd"))
        .chain(
            (0..n_arms).flat_map(|hand| ["x", "y", "z"].map(|axis| format!("hand{hand}_{axis}"))),
        )
        .chain(fixed("contacts"))
        .collect()
}

/// The trajectory as a table; numbers have as many digits as identify them in their precision.
pub(crate) fn write_table(
    robot: &Robot,
    rows: &[SimulationRow],
    precision: Precision,
) -> anyhow::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(header(robot.n_arms, robot.n_joints()))?;
    for SimulationRow { t, state, hands, contacts } in rows {
        let numbers = state
            .base_position
            .iter()
            .chain(&state.base_quaternion)
            .chain(&state.q)
            .chain(&state.base_linear_velocity)
            .chain(&state.base_angular_velocity)
            .chain(&state.qd)
            .chain(hands.iter().flatten());
        let written = numbers.map(|number| match precision {
            Precision::F32 => (*number as f32).to_string(),
            Precision::F64 => number.to_string(),
        });
        // Sums of control periods would end in many digits of rounding.
        let time = ((t * 1e9).round() / 1e9).to_string();
        writer.write_record([time].into_iter().chain(written).chain([contacts.to_string()]))?;
    }
    writer.into_inner().context("the table cannot be finished")
}

/// The state in which the trajectory in a file ends.
pub(crate) fn last_state(path: &Path, robot: &Robot) -> Result<State<f64>, ExitError> {
    let shown = path.display();
    let bad = |what: String| ExitError::new(ExitCode::BadInput, format!("{shown}: {what}"));
    let bytes = regular_files::read(path, MAX_BYTES)
        .map_err(|error| bad(format!("cannot be read: {error}")))?;
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let wanted = header(robot.n_arms, robot.n_joints());
    let found = reader.headers().map_err(|error| bad(error.to_string()))?.clone();
    if found.iter().ne(wanted.iter().map(String::as_str)) {
        let message = format!(
            "is no trajectory of the robot `{}`: expected the {} columns that `octopus simulate` writes for \
             it, beginning with t, base_x, base_y",
            robot.name,
            wanted.len()
        );
        return Err(bad(message));
    }
    let mut last = None;
    for (index, record) in reader.records().enumerate() {
        last = Some((index + 2, record.map_err(|error| bad(error.to_string()))?));
    }
    let Some((line, record)) = last else {
        return Err(bad("has no row, so no state".to_owned()));
    };
    let mut numbers = Vec::with_capacity(wanted.len());
    for (name, cell) in wanted.iter().zip(&record) {
        let number = cell.parse::<f64>().ok().filter(|number| (*number as f32).is_finite());
        let wrong = || {
            bad(format!("line {line}, column {name}: `{cell}` is no finite number, or too large"))
        };
        numbers.push(number.ok_or_else(wrong)?);
    }
    let state = state_of(&numbers, robot.n_joints());
    let length = state.base_quaternion.iter().map(|x| x * x).sum::<f64>();
    if (length - 1.0).abs() > 1e-3 {
        let message = format!(
            "line {line}: the base's quaternion has the length {}, expected 1",
            length.sqrt()
        );
        return Err(bad(message));
    }
    Ok(state)
}

/// The state in a row of numbers, the time first.
fn state_of(numbers: &[f64], n_joints: usize) -> State<f64> {
    let three = |at: usize| std::array::from_fn(|i| numbers[at + i]);
    let velocity = 8 + n_joints;
    State {
        base_position: three(1),
        base_quaternion: std::array::from_fn(|i| numbers[4 + i]),
        q: numbers[8..velocity].to_vec(),
        base_linear_velocity: three(velocity),
        base_angular_velocity: three(velocity + 3),
        qd: numbers[velocity + 6..velocity + 6 + n_joints].to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use simulator::simulate::simulate;
    use simulator::step::StepOptions;

    use super::*;

    #[test]
    fn columns_are_those_of_the_description() {
        let header = header(4, 24);
        assert_eq!(header.len(), 1 + 7 + 24 + 6 + 24 + 12 + 1);
        assert!(header.join(",").as_bytes().starts_with(MARK));
        assert_eq!(header[8], "q0");
        assert_eq!(
            header[32..38],
            ["base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz"]
        );
        assert_eq!(header[62..65], ["hand0_x", "hand0_y", "hand0_z"]);
    }

    fn round(state: &State<f64>) -> State<f64> {
        let mut rounded = State::<f32>::home(&Robot::builtin("paper").expect("built in"));
        rounded.set_lane(0, state);
        rounded.lane(0)
    }

    #[test]
    fn the_last_state_of_a_table_is_read_to_the_bit() {
        let robot = Robot::builtin("paper").expect("built in");
        let actions = vec![vec![0.3; robot.n_joints()]; 2];
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("out.csv");
        for precision in [Precision::F32, Precision::F64] {
            let rows = simulate(&robot, &actions, precision, &StepOptions::default());
            let table = write_table(&robot, &rows, precision).expect("a table");
            std::fs::write(&path, &table).expect("writable");
            let found = last_state(&path, &robot).expect("a state");
            // The digits identify a number of its precision: rounded to that it is the same.
            let rounded = |state: &State<f64>| match precision {
                Precision::F32 => round(state),
                Precision::F64 => state.clone(),
            };
            assert_eq!(rounded(&found), rounded(&rows[1].state));
        }
        let text = std::fs::read_to_string(&path).expect("readable");
        let lines: Vec<&str> = text.lines().collect();
        let broken = |text: String| {
            std::fs::write(&path, text).expect("writable");
            let error = last_state(&path, &robot).expect_err("must be refused");
            assert_eq!(error.code, ExitCode::BadInput);
            error.message.split_once("out.csv: ").expect("names the file").1.to_owned()
        };
        assert!(broken(lines[0].to_owned()).starts_with("has no row"));
        assert!(broken("a,b\n1,2\n".to_owned()).contains("expected the 75 columns"));
        let row = lines[1].replacen(lines[1].split(',').nth(4).expect("a cell"), "nan", 1);
        let text = format!("{}\n{row}\n", lines[0]);
        assert_eq!(broken(text), "line 2, column base_qw: `nan` is no finite number, or too large");
        let row = lines[1].replacen(lines[1].split(',').nth(4).expect("a cell"), "2", 1);
        assert!(broken(format!("{}\n{row}\n", lines[0])).contains("length"));
    }
}
