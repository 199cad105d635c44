//! The commands of the documents: found in their text, and run as they are written.
//!
//! A document is one script: its `sh` and `python` blocks, one after the other, in a fresh directory that looks like the
//! root of a clone after `make build`. Only what stands behind the names `octopus` and `make` differs: an `octopus` that adds
//! a small budget to what takes long, and a `make` that checks its target and then runs what it would run in the end.
//!
//! The environment variable `SPACEOCTOPUS_DOCUMENTS` says which budget ([`Budget`]): `small`, unless it is set, or `whole`
//! for every training, evaluation and measurement at its full length. `whole` takes hours, fewer with
//! `cargo test --release`.
//!
//! `<!-- live: RUN -->` before a block has a training under way in the directory RUN while the block runs.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use anyhow::{Context as _, Result, bail, ensure};

use crate::{SMALL, program, python, wheel};

/// A fenced block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// The line that it begins in, from 1.
    pub line: usize,
    /// Its language.
    pub language: String,
    /// Its text.
    pub text: String,
    /// The run that shall be under way meanwhile.
    pub live: Option<String>,
}

/// Names the [`Budget`] that commands of documents run with.
pub const BUDGET: &str = "SPACEOCTOPUS_DOCUMENTS";

/// How much of what takes long is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Budget {
    /// A few iterations of tiny networks, few and short episodes, short measurements.
    Small,
    /// Everything as it is written.
    Whole,
}

impl Budget {
    /// The one of that name.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "small" => Ok(Self::Small),
            "whole" => Ok(Self::Whole),
            other => bail!("{BUDGET} is {other:?}; expected small or whole"),
        }
    }

    /// The one that the environment names.
    fn of_environment() -> Result<Self> {
        match std::env::var_os(BUDGET) {
            None => Ok(Self::Small),
            Some(name) => Self::named(&name.to_string_lossy()),
        }
    }
}

/// The repository's root.
pub fn repository() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    root.canonicalize().expect("the repository is there")
}

/// The README and the chapters of the guide, in order, from the repository's root.
pub fn documents() -> Result<Vec<String>> {
    let summary = fs::read_to_string(repository().join("deploy/guide/src/SUMMARY.md"))?;
    let chapters = summary.lines().filter_map(|line| {
        let (_, target) = line.split_once("](")?;
        Some(format!("deploy/guide/src/{}", target.trim_end_matches(')')))
    });
    Ok(["README.md".to_owned()].into_iter().chain(chapters).collect())
}

/// The fenced blocks of a text.
pub fn blocks(text: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let mut open: Option<Block> = None;
    let mut live = None;
    for (index, line) in text.lines().enumerate() {
        match (&mut open, line.trim_start().strip_prefix("```")) {
            (None, Some(language)) => {
                let (language, live) = (language.trim().to_owned(), live.take());
                open = Some(Block { line: index + 1, language, text: String::new(), live });
            }
            (Some(_), Some("")) => found.extend(open.take()),
            (Some(block), _) => {
                block.text.push_str(line);
                block.text.push('\n');
            }
            (None, None) => {
                let said =
                    line.strip_prefix("<!-- live: ").and_then(|rest| rest.strip_suffix(" -->"));
                live = said.map(str::to_owned).or(live);
            }
        }
    }
    found
}

/// A directory like the root of a clone, in which a document's commands run.
#[derive(Debug)]
pub struct Clone {
    dir: tempfile::TempDir,
}

impl Clone {
    /// Makes one.
    pub fn new() -> Result<Self> {
        let dir = tempfile::tempdir()?;
        for name in ["deploy", "sim-worker", "tests", "Makefile"] {
            symlink(repository().join(name), dir.path().join(name))?;
        }
        let release = dir.path().join("target/release");
        fs::create_dir_all(&release)?;
        executable(&release.join("octopus"), &octopus(Budget::of_environment()?))?;
        let bin = dir.path().join("bin");
        fs::create_dir(&bin)?;
        executable(&bin.join("make"), MAKE)?;
        let clone = Self { dir };
        clone.take_python(&python())?;
        Ok(clone)
    }

    /// Has documents run this Python.
    fn take_python(&self, python: &Path) -> Result<()> {
        // A link to it would not be seen to belong to its virtual environment.
        let text = format!("#!/bin/sh\nexec '{}' \"$@\"\n", python.display());
        for name in ["bin/python", "bin/python3"] {
            executable(&self.dir.path().join(name), &text)?;
        }
        Ok(())
    }

    /// Runs the blocks of a document; the output names the line that failed.
    pub fn run(&self, blocks: &[Block]) -> Result<Output> {
        let mut script = PROLOGUE.to_owned();
        for Block { line, language, text, live } in blocks {
            let _ = writeln!(script, "\nhere={line}");
            if let Some(run) = live {
                let _ = writeln!(script, "begin {run}");
            }
            match language.as_str() {
                "sh" => script.push_str(text),
                "python" => {
                    let _ = writeln!(script, "python - <<'END_OF_BLOCK'\n{text}END_OF_BLOCK");
                }
                _ => {}
            }
            if live.is_some() {
                script.push_str("end_live\n");
            }
        }
        let file = self.dir.path().join("bin/document");
        fs::write(&file, script)?;
        let path = std::env::var("PATH").context("PATH")?;
        let path = format!("{}:{path}", self.dir.path().join("bin").display());
        let output = Command::new("bash")
            .arg(&file)
            .current_dir(self.dir.path())
            .env("PATH", path)
            // Those of a `make test` that these tests are part of.
            .env_remove("MAKEFLAGS")
            .env_remove("MAKELEVEL")
            .env_remove("CARGO_TARGET_DIR")
            .stdin(Stdio::null())
            .output()?;
        Ok(output)
    }

    /// Where commands run.
    pub fn path(&self) -> &Path {
        self.dir.path()
    }
}

fn executable(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755))?;
    Ok(())
}

/// Stops at the first command that fails, and says in which block it stands.
const PROLOGUE: &str = r#"set -euo pipefail
here=0
live=
end_live() { kill -INT "$live"; wait "$live" || true; live=; }
finish() {
  status=$?
  if [ -n "$live" ]; then end_live; fi
  if [ $status != 0 ]; then echo "the block of line $here failed" >&2; fi
}
trap finish EXIT
begin() {
  octopus train --run-dir "$1" --quiet --set run.env_steps=1_000_000_000 &
  live=$!
  until [ -s "$1/metrics.jsonl" ]; do kill -0 "$live"; sleep 0.1; done
}
"#;

/// `make` as documents call it: the target must be there, and the programs that it would build are. What it would run of
/// ours is run.
const MAKE: &str = r#"#!/usr/bin/env bash
set -euo pipefail
steps=$(command -p make --dry-run "$@")
while read -r step; do
  case $step in
    target/release/octopus\ train*) eval "$step" ;;
  esac
done <<<"$steps"
"#;

/// The program. With a small budget small settings stand before the document's own, and episodes are few.
fn octopus(budget: Budget) -> String {
    let program = program("octopus");
    if budget == Budget::Whole {
        return format!("#!/bin/sh\nexec '{}' \"$@\"\n", program.display());
    }
    // Without the seed, which documents choose.
    let small: Vec<String> = SMALL
        .iter()
        .filter(|flag| flag.starts_with("--set"))
        .map(|flag| format!("'{flag}'"))
        .collect();
    format!(
        r#"#!/usr/bin/env bash
set -euo pipefail
small=({} --set=run.env_steps=256 --set=run.evaluate_every=1 --set=run.evaluation_episodes=1 --set=run.evaluation_steps=20)
arguments=()
for argument; do
  case "${{arguments[*]: -1}}" in
    --episodes) argument=2 ;;
    --size) argument=48x48 ;;
  esac
  arguments+=("$argument")
done
set -- "${{arguments[@]}}"
# A document's own sweep gets a small budget in its file: the trials are begun by the program itself.
if [[ "${{1-}}" = sweep && "$2" != deploy/* ]] && ! grep -q '^# small$' "$2"; then
  sed -i 's/^env_steps = .*/env_steps = 1024/' "$2"
  printf '%s\n' '' '# small' '[evaluation]' 'episodes = 2' 'steps = 20' '[set]' >>"$2"
  for set in "${{small[@]}}"; do
    case $set in *run.env_steps* | *evaluate_every=0) ;; *) set=${{set#--set=}}; echo "${{set%%=*}} = ${{set#*=}}" >>"$2" ;; esac
  done
fi
case "${{1-}} ${{2-}}" in
  train*) set -- train --no-eval "${{small[@]}}" "${{@:2}}" ;;
  "resume "*) set -- "$@" --no-eval ;;
  "eval "*) set -- "$@" --steps 20 ;;
  # What has a size got a smaller one above.
  "film "*) [[ " $* " = *" --size "* ]] || set -- "$@" --size 48x48 ;;
  "experiment base-mass") set -- "$@" --episodes 2 --steps 20 ;;
  "experiment disturbance") set -- "$@" --steps 90 ;;
  "experiment reassembly") set -- "$@" --steps 80 ;;
  "experiment "*) set -- "$@" --steps 20 ;;
  "bench "*) set -- "$@" --seconds 0.2 ;;
  "reproduce "*) set -- "$@" --episodes 1 --steps 90 ;;
esac
exec '{}' "$@"
"#,
        small.join(" "),
        program.display()
    )
}

/// Runs the document at `path`, from the repository's root, and panics with all that it said if a command fails.
pub fn run(path: &str) -> Result<Clone> {
    let text = fs::read_to_string(repository().join(path)).with_context(|| path.to_owned())?;
    let blocks = blocks(&text);
    ensure!(blocks.iter().any(|block| block.language == "sh"), "{path} has no commands");
    let clone = Clone::new()?;
    if text.contains("\nmake wheel\n") {
        clone.take_python(wheel::python())?;
    }
    let output = clone.run(&blocks)?;
    let [said, complained] =
        [&output.stdout, &output.stderr].map(|out| String::from_utf8_lossy(out));
    ensure!(output.status.success(), "{path}: {}\n{said}\n{complained}", output.status);
    Ok(clone)
}
