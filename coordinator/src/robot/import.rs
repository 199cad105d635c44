//! `octopus robot import`: a robot file from a URDF.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use proto::{ExitCode, ExitError};
use simulator::robot::{FARTHEST_HOME, Robot};
use store::outputs::Output;
use store::{files, regular_files};

use crate::values::amount;

const EXAMPLES: &str = "\
Examples:
  octopus robot import satellite.urdf --out satellite.toml
  octopus robot import satellite.urdf --hand gripper --out satellite.toml
  octopus robot import satellite.urdf --home elbow=1.57 --out satellite.toml
  octopus robot check satellite.toml
  octopus train --robot satellite.toml

The root link is the base, which floats. Every chain of two to seven joints that turn, revolute or \
continuous, is an arm; arms that are built alike are of one type. What is fixed to a link belongs to it. The \
URDF's zero is the home pose unless --home says another; arms that are stretched there reach few goals. Joint angles of \
the robot file count from the zero of its Denavit-Hartenberg rows. Joints turn without end: position limits are dropped. What is left out or added is said, and stands in \
the file as comments.";

/// Options of `octopus robot import`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct ImportArgs {
    /// The URDF.
    #[arg(value_name = "FILE.urdf")]
    pub urdf: PathBuf,
    /// The robot file [default: standard output].
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// The link at each arm's end that is its hand, or how its name ends [default: the last link].
    #[arg(long, value_name = "LINK", allow_hyphen_values = true)]
    pub hand: Option<String>,
    /// Angles at home (rad), as the URDF counts them, of joints by their names or how these end [default: 0].
    #[arg(long, value_name = "JOINT=RAD,…", value_delimiter = ',', allow_hyphen_values = true, value_parser = angle)]
    pub home: Vec<(String, f64)>,
    /// Where the base is at home: its height (m) in the world.
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = height, default_value_t = 4.0)]
    pub height: f64,
    /// Write over a file that is there already, and into a run's directory; what is read stays.
    #[arg(long)]
    pub force: bool,
}

fn height(text: &str) -> Result<f64, String> {
    let height = amount(text).ok().filter(|height| *height <= FARTHEST_HOME);
    height.ok_or_else(|| format!("wants a height from 0 to {FARTHEST_HOME} m"))
}

/// A joint and its angle.
fn angle(text: &str) -> Result<(String, f64), String> {
    let angle = text.rsplit_once('=').and_then(|(joint, angle)| {
        let angle = angle.parse::<f64>().ok().filter(|angle| angle.is_finite())?;
        (!joint.is_empty()).then(|| (joint.to_owned(), angle))
    });
    angle.ok_or_else(|| "wants JOINT=RAD, such as elbow=1.57".to_owned())
}

/// Reads, says what was lost, writes.
pub(super) fn run(args: &ImportArgs) -> anyhow::Result<()> {
    if let Some(path) = &args.out {
        // No mark: what was imported is completed by hand.
        Output { flag: "--out", path, mark: b"", force: args.force }
            .check_or_stdout(&[("FILE.urdf", &args.urdf)])?;
    }
    let shown = args.urdf.display();
    let refused = |reason: &dyn std::fmt::Display| {
        ExitError::new(ExitCode::BadInput, format!("{shown}: {reason}"))
    };
    let text = regular_files::read_text(&args.urdf, regular_files::TEXT)
        .map_err(|error| refused(&error))?;
    if text.trim().is_empty() {
        return Err(refused(&"is empty; give a URDF").into());
    }
    if Robot::from_toml(&text, &args.urdf).is_ok() {
        let robot = output::quoted(&args.urdf);
        let is = format!("is a robot file already; `octopus robot check {robot}` looks at it");
        return Err(refused(&is).into());
    }
    let home = [0.0, 0.0, args.height];
    let mut imported = ::urdf::import(&text, args.hand.as_deref(), home)
        .and_then(|imported| imported.at_home(&args.home))
        .map_err(|error| refused(&error))?;
    if args.home.is_empty() {
        imported.notes.push(
            "all joints are at home where the URDF has them at zero; --home says other angles"
                .to_owned(),
        );
    }
    let name = args.urdf.file_name().unwrap_or_default().to_string_lossy();
    let mut file = head(&name, &imported.notes);
    let robot = imported.robot(&args.urdf)?;
    file.push('\n');
    file.push_str(&robot.to_toml());
    for note in &imported.notes {
        output::note(note);
    }
    match args.out.as_deref() {
        Some(path) if path != Path::new("-") => Ok(files::replace_output(path, file.as_bytes())?),
        _ => output::write(file.as_bytes()),
    }
}

/// What the file begins with: comments, each on a line of its own whatever stands in names.
fn head(name: &str, notes: &[String]) -> String {
    let in_a_line = |text: &str| output::printable::printable(text).replace('\n', "\\n");
    let mut head = format!(
        "# Made by `octopus robot import` from {}.\n# Units: m, kg, kg m\u{b2}, rad, N m; fixed rotations in degrees.\n",
        in_a_line(name)
    );
    for note in notes {
        let _ = writeln!(head, "# * {}", in_a_line(note));
    }
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_line_breaks_end_no_comment() {
        let notes = ["link `a\nb\r[base]` has no mass".to_owned()];
        let head = head("a\nmass = 1\n.urdf", &notes);
        assert_eq!(head.lines().count(), 3, "{head}");
        assert!(head.lines().all(|line| line.starts_with('#')), "{head}");
        assert!(head.contains("a\\nmass"), "{head}");
    }

    #[test]
    fn heights_are_those_that_a_robot_may_have() {
        assert_eq!((height("0"), height("100")), (Ok(0.0), Ok(100.0)));
        for wrong in ["5000", "-1", "nan", "x"] {
            assert!(height(wrong).is_err_and(|wanted| wanted.contains("0 to 100 m")), "{wrong}");
        }
    }

    #[test]
    fn homes_are_joints_with_angles() {
        assert_eq!(angle("elbow=-1.57"), Ok(("elbow".to_owned(), -1.57)));
        for wrong in ["elbow", "=1", "elbow=", "elbow=nan", "elbow=inf"] {
            assert!(angle(wrong).is_err_and(|wanted| wanted.contains("elbow=1.57")), "{wrong}");
        }
    }

    #[test]
    fn what_is_no_urdf_is_said_to_be_what_it_is() {
        let dir = tempfile::tempdir().expect("tempdir");
        let urdf = dir.path().join("r.toml");
        let robot = Robot::builtin("paper").expect("built in").to_toml();
        for (text, said) in [
            ("\n", "r.toml: is empty; give a URDF"),
            (&*robot, "is a robot file already; `octopus robot check"),
        ] {
            std::fs::write(&urdf, text).expect("written");
            let args = ImportArgs {
                urdf: urdf.clone(),
                out: None,
                hand: None,
                home: Vec::new(),
                height: 4.0,
                force: false,
            };
            let told = run(&args).expect_err("no URDF").to_string();
            assert!(told.contains(said), "{told}");
        }
    }

    /// People complete it.
    #[test]
    fn a_robot_that_was_made_before_is_kept() {
        let dir = tempfile::tempdir().expect("tempdir");
        let [urdf, out] = ["r.urdf", "r.toml"].map(|name| dir.path().join(name));
        std::fs::write(&urdf, "<robot/>").expect("written");
        std::fs::write(&out, "# Made by `octopus robot import` from r.urdf.\n").expect("written");
        let args = ImportArgs {
            urdf,
            out: Some(out),
            hand: None,
            home: Vec::new(),
            height: 4.0,
            force: false,
        };
        let told = run(&args).expect_err("it is there").to_string();
        assert!(told.contains("is there already; --force writes over it"), "{told}");
    }
}
