//! The command line of `octopus`.

use clap::{Parser, Subcommand};

use crate::{
    bench, certificates, checkpoints, clean, doctor, eval, experiment, export, film, janitor, join,
    mjcf, plan, plot, record, replay, reproduce, resume, robot, rollout, scale, serve, simulate,
    status, sweep, train, urdf, verify, view,
};

/// Exit codes, as `octopus --help` lists them.
const EXIT_CODES: &str = "\
Exit codes:
  0    all went well
  1    something failed while running; the message says what. Or what was
       compared is not the same, or figures of `bench` contradict each other
  2    the command line is wrong
  3    a configuration, robot, actions or other input file is wrong
  4    the machine lacks something: shared memory, descriptors, stack, room in
       a file, libtorch, a device, a free port, programs of the same build as
       the run that it joins, a certificate that this run accepts, or a bucket
       that can be reached
  5    a run directory, checkpoint or result exists already, is in use, is
       missing or is damaged
  6    the learner or a worker failed for good
  130  stopped early: by a second Ctrl-C where a run is going on, by the first
       one elsewhere. Ctrl-C is the normal end of serve, view and join: 0

Results go to standard output, progress and logs to standard error (RUST_LOG=info shows more). \
`octopus COMMAND --help` shows options and examples.";

/// Trains, evaluates and simulates multi-arm space robots.
#[derive(Debug, Clone, Parser)]
#[command(name = "octopus", version, after_help = EXIT_CODES, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Clone, Subcommand)]
pub enum Command {
    /// Train the arms of a robot on a task.
    Train(train::TrainArgs),
    /// Go on with a stopped run from its last checkpoint.
    Resume(resume::ResumeArgs),
    /// Train many configurations and seeds, and find the best.
    Sweep(sweep::SweepArgs),
    /// Measure a policy on goals it never saw.
    Eval(eval::EvalArgs),
    /// Repeat an experiment of the paper, or an episode from the page.
    Experiment(experiment::ExperimentArgs),
    /// Repeat all of the paper's experiments and make a page of them.
    Reproduce(reproduce::ReproduceArgs),
    /// Draw learning curves of runs side by side.
    Plot(plot::PlotArgs),
    /// Make a moving picture of an episode.
    Film(film::FilmArgs),
    /// Find a motion that brings hands to poses.
    Plan(plan::PlanArgs),
    /// Record a motion for robot viewers, as MCAP.
    Record(record::RecordArgs),
    /// Play a recording or a block again, and compare every bit.
    Replay(replay::ReplayArgs),
    /// Integrate given joint commands, open loop.
    Simulate(simulate::SimulateArgs),
    /// Put a policy on a robot: write it as ONNX and as C.
    Export(export::ExportArgs),
    /// Bring a robot of your own from URDF, and check it.
    Robot(robot::RobotArgs),
    /// Write a robot as a MuJoCo model file.
    Mjcf(mjcf::MjcfArgs),
    /// Write a robot as a URDF file.
    Urdf(urdf::UrdfArgs),
    /// Check whether this machine can run a training, and say what to do where it cannot.
    Doctor(doctor::DoctorArgs),
    /// Measure how fast this machine simulates, learns and transports.
    Bench(bench::BenchArgs),
    /// Show how a run is doing, or list all runs.
    Status(status::StatusArgs),
    /// Help a run of another machine with workers of this one.
    Join(join::JoinArgs),
    /// Make certificates by which the machines of a run know each other.
    Certificates(certificates::CertificatesArgs),
    /// Change the number of workers of a live run.
    Scale(scale::ScaleArgs),
    /// Make one block of a run again, alone.
    Rollout(rollout::RolloutArgs),
    /// Compare two runs bit by bit, or a run with its own repetition.
    Verify(verify::VerifyArgs),
    /// List, compare, pin, copy and compose checkpoints.
    Checkpoints(checkpoints::options::CheckpointsArgs),
    /// Serve the checkpoints of a directory over HTTP.
    Serve(serve::ServeArgs),
    /// Show a run or a policy in a browser.
    View(view::ViewArgs),
    /// Remove what killed runs and commands of this user left behind.
    Clean(clean::CleanArgs),
    /// Removes what a killed coordinator leaves; started by every run beside it.
    #[command(hide = true)]
    Janitor(janitor::JanitorArgs),
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::time::Duration;

    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    /// What is proposed must be what the command takes, or whoever follows it ends with a usage error.
    #[test]
    fn remedies_have_flags_that_the_command_has() {
        for (name, remedy) in [
            ("train", &crate::train::REMEDY),
            ("resume", &crate::resume::REMEDY),
            ("verify", &lab::verification::REMEDY),
        ] {
            let command = Cli::command();
            let command = command.find_subcommand(name).expect("a command");
            let has = |flag: &str| {
                let flag = flag.trim_start_matches("--");
                command.get_arguments().any(|argument| argument.get_long() == Some(flag))
            };
            assert!(remedy.flags.iter().all(|flag| has(flag)), "{name}: {:?}", remedy.flags);
        }
    }

    #[test]
    fn at_most_one_limit() {
        let parse = |line: &str| Cli::try_parse_from(line.split(' '));
        assert!(parse("octopus train --iterations 3 --time-limit 1m").is_err());
        assert!(parse("octopus train --iterations 3").is_ok());
        assert!(parse("octopus train --no-eval --eval").is_ok());
    }

    #[test]
    fn what_people_try_first_is_taken_or_answered() {
        let parse = |line: &str| Cli::try_parse_from(line.split(' '));
        let Ok(Cli { command: Command::Train(args) }) = parse("octopus train --iters 4") else {
            panic!("--iters is --iterations")
        };
        assert_eq!(args.limits.iterations, Some(4));
        let error = parse("octopus resume runs/x --seed 3").expect_err("refused").to_string();
        assert!(error.contains("`octopus train --seed 3` begins another one"), "{error}");
        assert!(!error.contains("-- --seed"), "{error}");
    }

    #[test]
    fn what_is_watched_may_stand_before_or_after_the_flag() {
        let parse = |line: &str| {
            let Command::Status(args) = Cli::try_parse_from(line.split(' ')).expect(line).command
            else {
                panic!("{line} is another command")
            };
            (args.run_dir, args.watch)
        };
        let run = || Some(PathBuf::from("runs/x"));
        for (line, seconds) in [
            ("octopus status --watch runs/x", 2),
            ("octopus status runs/x --watch", 2),
            ("octopus status --watch=1m runs/x", 60),
            ("octopus status runs/x --watch=10", 10),
        ] {
            assert_eq!(parse(line), (run(), Some(Duration::from_secs(seconds))), "{line}");
        }
    }

    /// The guide promises it.
    #[test]
    fn every_command_has_examples() {
        fn check(command: &clap::Command, path: &str) {
            let shown = command.get_subcommands().filter(|command| !command.is_hide_set());
            for command in shown {
                let path = format!("{path} {}", command.get_name());
                let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
                assert!(after.contains("Examples:\n  octopus"), "{path}: {after}");
                check(command, &path);
            }
        }
        check(&Cli::command(), "octopus");
    }

    #[test]
    fn help_texts() {
        // Not that of the terminal that the test happens to run in.
        let mut command = Cli::command().term_width(100);
        insta::assert_snapshot!("help", command.render_help());
        let train = command.find_subcommand_mut("train").expect("exists");
        insta::assert_snapshot!("help_train", train.render_help());
    }

    /// Calls `check` with every command but the hidden ones, and how it is called.
    fn each_command(check: &mut dyn FnMut(&mut clap::Command, &str)) {
        fn below(
            command: &mut clap::Command,
            path: &str,
            check: &mut dyn FnMut(&mut clap::Command, &str),
        ) {
            check(command, path);
            for command in command.get_subcommands_mut().filter(|command| !command.is_hide_set()) {
                let path = format!("{path} {}", command.get_name());
                below(command, &path, check);
            }
        }
        let mut root = Cli::command();
        root.build();
        below(&mut root, "octopus", check);
    }

    #[test]
    fn help_fits_in_80_columns() {
        each_command(&mut |command, path| {
            let help = command.clone().term_width(80).render_long_help().to_string();
            for line in help.lines() {
                assert!(line.chars().count() <= 80, "{path}: {line}");
            }
        });
    }

    /// What is wrapped by hand as well as by the terminal's width ends in ragged lines: a paragraph is one
    /// line, and what begins with spaces is as wide as the narrowest terminal at most.
    #[test]
    fn help_is_wrapped_once() {
        each_command(&mut |command, path| {
            let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let lines: Vec<&str> = after.lines().collect();
            let prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
            for pair in lines.windows(2) {
                assert!(
                    !(prose(pair[0]) && prose(pair[1])),
                    "{path}: two lines of one paragraph: {pair:?}"
                );
            }
            for line in lines.iter().filter(|line| line.starts_with(' ')) {
                assert!(line.chars().count() <= 80, "{path}: {line}");
            }
        });
    }

    /// `--masses -1,2` is a wrong value, not an unknown flag. A path may be forgotten before another flag, and
    /// that one shall not be taken for it.
    #[test]
    fn a_value_may_begin_with_a_minus_sign() {
        use clap::builder::ValueParser;
        let paths = [ValueParser::path_buf().type_id(), ValueParser::string().type_id()];
        let mut seen = 0;
        each_command(&mut |command, path| {
            for option in command
                .get_opts()
                .filter(|option| !option.is_require_equals_set() && !option.is_hide_set())
            {
                let words = !option.get_possible_values().is_empty();
                let parser = option.get_value_parser().type_id();
                if parser == paths[0] {
                    continue;
                }
                if words || parser == paths[1] {
                    let taken = option.is_allow_negative_numbers_set()
                        || option.is_allow_hyphen_values_set();
                    assert!(taken, "{path} {option}");
                    continue;
                }
                let several = option.get_num_args().is_some_and(|range| range.max_values() > 1);
                assert!(several || option.is_allow_hyphen_values_set(), "{path} {option}");
                seen += 1;
            }
        });
        assert!(seen > 20, "{seen}");
        for (line, wanted) in [
            ("octopus experiment noise --sensors -0.3,1", "wants numbers, 0 or more"),
            ("octopus experiment noise --arm-masses 0,1", "wants numbers above 0"),
            ("octopus experiment reassembly --action-scale 0", "wants a number above 0"),
            ("octopus experiment disturbance --force -inf", "wants a number, 0 or more"),
            ("octopus train --time-limit -10m", "wants a time such as"),
            ("octopus train --seed --json", "wants a whole number"),
        ] {
            let error = Cli::try_parse_from(line.split(' ')).expect_err(line);
            assert_eq!(error.kind(), clap::error::ErrorKind::ValueValidation, "{line}");
            assert!(error.to_string().contains(wanted), "{error}");
        }
        // clap asks for what an option requires only where nothing that is given excludes that.
        for line in [
            "octopus reproduce --policies a --set b=1",
            "octopus reproduce --controller jacobian --seeds 2",
            "octopus reproduce --runs a --baselines ppo",
            "octopus record a --out b --seed 1 --env 2",
            "octopus record --plan a --out b --policy c",
            "octopus record a --out b --robot release",
            "octopus record a --out b --state c",
        ] {
            let error = Cli::try_parse_from(line.split(' ')).expect_err(line);
            assert_eq!(error.kind(), clap::error::ErrorKind::ArgumentConflict, "{line}");
        }
        for (line, said) in [
            ("octopus train --preset -1", "possible values: guided, tuned, paper, release, robust"),
            ("octopus mjcf --robot paper --contacts -1", "possible values: on, off"),
        ] {
            let error = Cli::try_parse_from(line.split(' ')).expect_err(line);
            assert_eq!(error.kind(), clap::error::ErrorKind::InvalidValue, "{line}");
            assert!(error.to_string().contains(said), "{error}");
        }
        assert!(Cli::try_parse_from(["octopus", "train", "--device", "-1"]).is_ok(), "a value");
        assert!(Cli::try_parse_from(["octopus", "train", "--device", "--json"]).is_err());
        for line in ["octopus train --set network.min_log_std=-3", "octopus train --run-dir --json"]
        {
            let parsed = Cli::try_parse_from(line.split(' '));
            assert_eq!(parsed.is_ok(), line.contains("--set"), "{line}");
        }
    }
}
