//! The gateway of a machine that helps: the child that speaks with the run.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

use proto::gateway::Said;
use proto::message::HostId;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};

use super::spec::JoinSpec;
use crate::supervisor::{child_exit_code, log_tail};
use crate::{environment, signal_isolation};

/// What is heard of the gateway.
pub(super) enum Word {
    Joined(HostId),
    /// So many workers are wanted.
    Scale(u32),
    /// It has ended with this code, and why.
    Ended(ExitCode, String),
}

/// The child that speaks with the run. It is killed when this is dropped.
pub(super) struct Gateway {
    child: Child,
    words: Receiver<Said>,
    log: PathBuf,
    /// Why it ends, as far as it has said so.
    why: Option<String>,
}

impl Gateway {
    pub(super) fn start(spec: &JoinSpec, run_dir: &RunDir) -> Result<Self, ExitError> {
        let fail = |what: &str, error: &std::io::Error| {
            ExitError::new(ExitCode::Environment, format!("{what}: {error}"))
        };
        let log = run_dir.logs().join("gateway.log");
        let file = File::create(&log)
            .map_err(|error| fail(&format!("{}: cannot be written", log.display()), &error))?;
        let mut command = Command::new(&spec.gateway);
        environment::clean(&mut command);
        command.args(["host", "--connect", &spec.endpoint]);
        if let Some(dir) = &spec.certificates {
            command.arg("--certificates").arg(dir);
        }
        command
            .args(["--workers", &spec.workers.to_string()])
            .arg(format!("--name={}", spec.name))
            .arg(format!("--processor={}", store::provenance::processor_type()))
            .args(["--wait", &spec.wait.as_secs_f64().to_string()])
            .arg("--sim-worker")
            .arg(&spec.programs.sim_worker)
            .arg("--run-dir")
            .arg(run_dir.path())
            .args(["--parent", &std::process::id().to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(file)
            // Ctrl-C on the terminal is not for it.
            .process_group(0);
        let mut child = signal_isolation::spawn(&mut command)
            .map_err(|error| fail("cannot start the gateway", &error))?;
        let (sender, words) = mpsc::channel();
        let out = child.stdout.take();
        let listen = move || {
            let lines = out.into_iter().flat_map(|out| BufReader::new(out).lines());
            for line in lines.map_while(Result::ok) {
                // What is no word of it, or comes when nobody listens, is for nobody.
                let said = serde_json::from_str(&line).ok();
                let _ = said.map(|said: Said| sender.send(said));
            }
        };
        let gateway = Self { child, words, log, why: None };
        std::thread::Builder::new()
            .name("gateway".to_owned())
            .spawn(listen)
            .map_err(|error| fail("cannot start a thread", &error))?;
        Ok(gateway)
    }

    /// Says something to it. A gateway that is no more is noticed by itself.
    pub(super) fn tell(&mut self, what: &impl serde::Serialize) {
        if let (Some(pipe), Ok(text)) = (&mut self.child.stdin, serde_json::to_string(what)) {
            let _ = writeln!(pipe, "{text}");
        }
    }

    /// The next word, if one comes within `patience`.
    pub(super) fn wait(&mut self, patience: Duration) -> Option<Word> {
        match self.words.recv_timeout(patience) {
            Ok(Said::Joined(host)) => return Some(Word::Joined(host)),
            Ok(Said::Scale(workers)) => return Some(Word::Scale(workers)),
            Ok(Said::Failed(why)) => {
                self.why = Some(why);
                return None;
            }
            Err(RecvTimeoutError::Timeout) => return None,
            // Its standard output is closed: it ends, or has.
            Err(RecvTimeoutError::Disconnected) => {}
        }
        let status = self.child.try_wait().ok()??;
        Some(Word::Ended(code(status), self.reason(status)))
    }

    fn reason(&self, status: ExitStatus) -> String {
        self.why.clone().unwrap_or_else(|| {
            let last = log_tail(&self.log, 1);
            format!("the gateway ended ({status}): {last}")
        })
    }
}

/// What a gateway ended with; a signal is none of the codes.
fn code(status: ExitStatus) -> ExitCode {
    match status.code() {
        Some(0) => ExitCode::Success,
        Some(1) => ExitCode::Failure,
        _ => child_exit_code(status),
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
