//! Tables of joint rates (rad/s), a row a control step: what `simulate` and `record` execute, and `plan` writes.

use std::path::Path;

use proto::{ExitCode, ExitError};
use store::regular_files;

use crate::trajectories::MAX_BYTES;

/// Reads the commands: one row a control step, `width` numbers each.
pub(crate) fn read(path: &Path, width: usize) -> Result<Vec<Vec<f64>>, ExitError> {
    let shown =
        if path == Path::new("-") { "standard input".into() } else { path.to_string_lossy() };
    let bad = |what: String| ExitError::new(ExitCode::BadInput, format!("{shown}: {what}"));
    let read = if path == Path::new("-") {
        regular_files::drain(std::io::stdin().lock(), MAX_BYTES)
    } else {
        regular_files::read(path, MAX_BYTES)
    };
    let bytes = read.map_err(|error| bad(format!("cannot be read: {error}")))?;
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(bytes.as_slice());
    let mut actions = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let row = index + 1;
        let record = record.map_err(|error| bad(format!("row {row}: {error}")))?;
        if record.len() != width {
            return Err(bad(format!(
                "row {row} has {} numbers, expected {width}: one joint velocity command in rad/s for \
                 every joint, arm after arm",
                record.len()
            )));
        }
        let number = |(column, cell): (usize, &str)| {
            let place = format!("row {row}, column {}", column + 1);
            match cell.parse::<f64>() {
                // In single precision, too, in which robots are simulated.
                Ok(value) if (value as f32).is_finite() => Ok(value),
                Ok(_) => Err(bad(format!("{place}: `{cell}` is not finite, or too large"))),
                Err(_) => Err(bad(format!(
                    "{place}: `{cell}` is no number{}",
                    if row == 1 { "; the file has no header" } else { "" }
                ))),
            }
        };
        actions.push(record.iter().enumerate().map(number).collect::<Result<Vec<_>, _>>()?);
    }
    if actions.is_empty() {
        return Err(bad(format!("is empty, expected rows of {width} joint velocity commands")));
    }
    Ok(actions)
}

/// The commands as `octopus simulate` reads them: every number with as many digits as identify it.
pub(crate) fn write(commands: &[Vec<f32>]) -> anyhow::Result<Vec<u8>> {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    for row in commands {
        writer.write_record(row.iter().map(f32::to_string))?;
    }
    Ok(writer.into_inner().map_err(csv::IntoInnerError::into_error)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The message that `text` is refused with.
    fn refused(text: &str) -> String {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join("in.csv");
        std::fs::write(&path, text).expect("writable");
        let error = read(&path, 3).expect_err("must be refused");
        assert_eq!(error.code, ExitCode::BadInput);
        error.message.split_once("in.csv: ").expect("names the file").1.to_owned()
    }

    #[test]
    fn actions_are_refused_with_row_and_column() {
        let infinite = |cell| format!("row 2, column 3: `{cell}` is not finite, or too large");
        for cell in ["nan", "inf", "-1e39"] {
            assert_eq!(refused(&format!("1,2,3\n1,2,{cell}\n")), infinite(cell));
        }
        assert_eq!(refused("a,b,c\n"), "row 1, column 1: `a` is no number; the file has no header");
        assert!(refused("1,2\n").starts_with("row 1 has 2 numbers, expected 3"));
        assert!(refused("\n\n").starts_with("is empty"));
    }

    #[test]
    fn commands_are_written_to_the_bit() {
        let commands = [vec![0.1_f32, -1.0 / 3.0], vec![1e-8, 0.0]];
        let table = write(&commands).expect("a table");
        let text = String::from_utf8(table).expect("text");
        let back: Vec<Vec<f32>> = text
            .lines()
            .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
            .collect();
        assert_eq!(back, commands);
    }
}
