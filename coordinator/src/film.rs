//! `octopus film`: an episode as a moving picture.

use std::path::{Path, PathBuf};

use clap::Args;
use lab::film::{EpisodeSettings, HandGoal, Look, Made, make};
use lab::trained::{Trained, open_checkpoint};
use output::grouped;
use proto::tasks::Aim;
use proto::{ExitCode, ExitError};
use rendering::{Format, View};
use serde::Serialize;
use simulator::step::StepOptions;
use store::files;
use store::outputs::Output;

use crate::values::whole;

const EXAMPLES: &str = "\
Examples:
  octopus film runs/trajectory-20260101-120000 --out robot.gif
  octopus film runs/a:best --out robot.webp --episode 3 --size 960x640
  octopus film runs/a --out robot.png --steps 60 --speed 4 --orbit 90
  octopus film runs/b --out turn.gif --base-goal 0.2,-0.1,0.3

The robot plays an episode of `octopus eval` and is drawn as it collides: capsules, cylinders and \
boxes. Every arm has a colour, which its trail and the ring around its goal have, too. Axes are \
those of goals and hands, x red, y green, z blue. Where bodies touch there is a dot, and a ring \
where they begin to. The caption says how much time has passed in the episode, how much faster \
the film is, and the mean errors of the hands, or that of the base. Neither a GPU nor a browser \
is needed. GIF has 255 colours and plays everywhere; APNG (.png, .apng) and WebP have all, and \
their files are larger.";

/// Options of `octopus film`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct FilmArgs {
    /// A run directory, whose last checkpoint is taken; RUN_DIR:best for the one with the lowest
    /// score; or any other checkpoint, as `octopus checkpoints --help` lists them.
    #[arg(value_name = "RUN_DIR|CHECKPOINT")]
    pub policy: PathBuf,
    /// The film: a .gif, .png, .apng or .webp.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write over files of another kind, too, and into a run's directory; what is read stays. A file of
    /// this command's own kind is replaced without it.
    #[arg(long)]
    pub force: bool,
    /// Another robot than the policy's own: `paper`, `release`, or a robot file.
    #[arg(long, allow_negative_numbers = true, value_name = "NAME|FILE", help_heading = "Episode")]
    pub robot: Option<String>,
    /// Seed of the goals.
    #[arg(long, value_name = "S", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX), help_heading = "Episode")]
    pub seed: u64,
    /// Which episode of that seed, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0, allow_hyphen_values = true, value_parser = whole::<u32>(0, 999_999), help_heading = "Episode")]
    pub episode: u32,
    /// Control steps.
    #[arg(long, value_name = "N", default_value_t = 200, allow_hyphen_values = true, value_parser = whole::<u32>(1, 100_000), help_heading = "Episode")]
    pub steps: u32,
    /// Another goal of a hand: arm, position in the world (m), Euler angles (rad). May be repeated.
    #[arg(long, value_name = "ARM,X,Y,Z,A,B,C", allow_hyphen_values = true, value_parser = hand_goal, help_heading = "Episode")]
    pub hand_goal: Vec<HandGoal>,
    /// Another goal of the base: Euler angles (rad).
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = base_goal, help_heading = "Episode")]
    pub base_goal: Option<BaseGoal>,
    /// Size of the picture (px).
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "640x640", allow_hyphen_values = true, value_parser = size, help_heading = "Picture")]
    pub size: Size,
    /// Pictures a second.
    #[arg(long, value_name = "N", default_value_t = 25, allow_hyphen_values = true, value_parser = whole::<u32>(1, 50), help_heading = "Picture")]
    pub fps: u32,
    /// Seconds of the episode in a second of the film.
    #[arg(long, value_name = "FACTOR", default_value_t = 10.0, allow_hyphen_values = true, value_parser = factor, help_heading = "Picture")]
    pub speed: f64,
    /// From where it is seen: degrees around the vertical, and above the horizon.
    #[arg(long, value_name = "AZIMUTH,ELEVATION", default_value = "36,21", allow_hyphen_values = true, value_parser = view, help_heading = "Picture")]
    pub view: Degrees,
    /// How far the camera goes around the robot in the film (degrees).
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true, value_parser = turn, help_heading = "Picture")]
    pub orbit: f64,
    /// How much larger everything is than if all of the episode just fits.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_hyphen_values = true, value_parser = factor, help_heading = "Picture")]
    pub zoom: f64,
    /// Leave time and errors out.
    #[arg(long, help_heading = "Picture")]
    pub no_caption: bool,
    /// Print what was made as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Columns and rows (px).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size([usize; 2]);

/// Euler angles of the base (rad).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseGoal([f64; 3]);

/// Azimuth and elevation (degrees).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Degrees([f64; 2]);

/// Sides that a picture can have (px).
const SIDES: std::ops::RangeInclusive<usize> = 32..=4096;

fn size(text: &str) -> Result<Size, String> {
    let side = |text: &str| text.parse::<usize>().ok().filter(|side| SIDES.contains(side));
    let sides = text.split_once('x').and_then(|(w, h)| Some([side(w)?, side(h)?]));
    let (least, most) = (SIDES.start(), SIDES.end());
    sides
        .map(Size)
        .ok_or_else(|| format!("wants two whole numbers from {least} to {most}, such as 640x480"))
}

/// So many finite numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number = |text: &str| text.trim().parse().ok().filter(|x: &f64| x.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    numbers?.try_into().ok()
}

fn hand_goal(text: &str) -> Result<HandGoal, String> {
    let wanted = "wants an arm, counted from 1, and six numbers, such as 2,0.4,-1.2,4.2,0,0,0";
    let goal = text.split_once(',').and_then(|(arm, goal)| {
        let arm = arm.trim().parse().ok().filter(|arm| (1..=8).contains(arm))?;
        Some(HandGoal { arm, goal: numbers(goal)? })
    });
    // What lies farther away is not seen with the robot.
    let near = |goal: &HandGoal| goal.goal.iter().all(|x| x.abs() <= 100.0);
    goal.filter(near).ok_or_else(|| wanted.to_owned())
}

fn base_goal(text: &str) -> Result<BaseGoal, String> {
    numbers(text).map(BaseGoal).ok_or_else(|| "wants three numbers, such as 0.1,-0.2,0.3".into())
}

fn view(text: &str) -> Result<Degrees, String> {
    let fit = |[azimuth, elevation]: &[f64; 2]| azimuth.abs() <= 360.0 && elevation.abs() <= 89.0;
    numbers(text).filter(fit).map(Degrees).ok_or_else(|| {
        "wants degrees from -360 to 360 and from -89 to 89, such as 36,21".to_owned()
    })
}

fn turn(text: &str) -> Result<f64, String> {
    let turn = numbers(text).map(|[turn]: [f64; 1]| turn).filter(|turn| turn.abs() <= 3600.0);
    turn.ok_or_else(|| "wants degrees from -3600 to 3600".to_owned())
}

fn factor(text: &str) -> Result<f64, String> {
    let factor = text.parse().ok().filter(|factor: &f64| (0.01..=1000.0).contains(factor));
    factor.ok_or_else(|| "wants a number from 0.01 to 1000".to_owned())
}

/// What is printed: where the film is, and what it shows.
#[derive(Debug, Serialize)]
struct Report<'a> {
    out: &'a Path,
    #[serde(flatten)]
    made: Made,
}

/// Makes the film.
pub fn run(args: &FilmArgs) -> anyhow::Result<()> {
    let extension = args.out.extension().unwrap_or_default().to_string_lossy();
    let Some(format) = Format::of_extension(&extension) else {
        let message = format!(
            "--out {}: wants a name that ends in .gif, .png, .apng or .webp, which says how the film is \
             written",
            args.out.display()
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    };
    let mut inputs: Vec<(&'static str, &Path)> = vec![("RUN_DIR|CHECKPOINT", &args.policy)];
    inputs.extend(args.robot.as_deref().map(|robot| ("--robot", Path::new(robot))));
    let output = Output { flag: "--out", path: &args.out, mark: format.mark(), force: args.force };
    output.check(&inputs)?;
    let load = |name| run::robots::load_fit_robot(name, &StepOptions::default());
    let robot = args.robot.as_deref().map(load).transpose()?;
    let trained = Trained::new(open_checkpoint(&args.policy)?, robot.as_ref())?;
    check_goals(args, &trained)?;
    let settings = EpisodeSettings {
        seed: args.seed,
        episode: args.episode,
        steps: args.steps as usize,
        hands: args.hand_goal.clone(),
        base: args.base_goal.map(|goal| goal.0),
    };
    let [azimuth, elevation] = args.view.0.map(f64::to_radians);
    let look = Look {
        size: args.size.0,
        fps: args.fps,
        speed: args.speed,
        view: View { azimuth, elevation },
        orbit: args.orbit.to_radians(),
        zoom: args.zoom,
        caption: !args.no_caption,
    };
    let (film, made) = make(&trained, &settings, &look, format)?;
    files::replace_output(&args.out, &film)?;
    if args.json {
        return output::json(&Report { out: &args.out, made });
    }
    output::line(&format!(
        "{}  {}: {} × {}, {} pictures, {:.1} s, {}",
        args.out.display(),
        made.format,
        made.width,
        made.height,
        grouped(made.pictures),
        made.duration_s,
        output::size(made.bytes as u64)
    ))
}

/// Refuses goals of what there is not, or the policy does not move to goals.
fn check_goals(args: &FilmArgs, trained: &Trained) -> Result<(), ExitError> {
    let (task, aims) = (trained.task(), &trained.world.task.aims);
    let robot = &trained.world.robot;
    if let Some(HandGoal { arm, .. }) = args.hand_goal.iter().find(|goal| goal.arm > robot.n_arms) {
        let hands = output::counted(robot.n_arms as u64, "hand");
        let message = format!("--hand-goal {arm},…: the robot `{}` has {hands}", robot.name);
        return Err(ExitError::new(ExitCode::Usage, message));
    }
    let reaches = |goal: &HandGoal| task.reaches() && aims[goal.arm - 1] == Aim::Hand;
    let base = args.base_goal.is_some() && !task.turns();
    let hand = args.hand_goal.iter().find(|goal| !reaches(goal));
    let flag = match (base, hand) {
        (true, _) => "--base-goal".to_owned(),
        (false, Some(goal)) => format!("--hand-goal of arm {}", goal.arm),
        (false, None) => return Ok(()),
    };
    let message = format!("{flag} has no meaning here: the policy learned `{}`", task.as_str());
    Err(ExitError::new(ExitCode::Usage, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_goals_are_read() {
        assert_eq!(size("640x480"), Ok(Size([640, 480])));
        for wrong in ["640", "640x", "31x64", "64x4097", "-640x480", "640X480", "1e3x64", ""] {
            assert!(size(wrong).is_err_and(|wanted| wanted.contains("640x480")), "{wrong}");
        }
        let goal = hand_goal("2,0.4,-1.2,4.2,0,0.5,0").expect("a goal");
        assert_eq!((goal.arm, goal.goal), (2, [0.4, -1.2, 4.2, 0.0, 0.5, 0.0]));
        for wrong in ["0,0,0,0,0,0,0", "2,0,0,0", "2,0,0,0,0,0,nan", "2,0,0,1e9,0,0,0", "", "a"] {
            assert!(hand_goal(wrong).is_err(), "{wrong}");
        }
        assert_eq!(base_goal("-0.1,0,2"), Ok(BaseGoal([-0.1, 0.0, 2.0])));
        assert!(base_goal("1,2").is_err() && base_goal("1,2,inf").is_err());
        assert_eq!(view("-36,21.5"), Ok(Degrees([-36.0, 21.5])));
        for wrong in ["36", "36,90", "400,0", "a,b"] {
            assert!(view(wrong).is_err(), "{wrong}");
        }
        assert_eq!((turn("-90"), factor("2.5")), (Ok(-90.0), Ok(2.5)));
        assert!(turn("x").is_err() && factor("0").is_err() && factor("nan").is_err());
    }
}
