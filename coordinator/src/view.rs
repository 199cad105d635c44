//! `octopus view`: the robot in a browser.

mod episode;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use lab::trained::open_checkpoint;
use output::note;
use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use run::signals::StopRequests;
use run::start::directory::RUNS;
use serde_json::json;
use service::client::Client;
use service::http::{OwnToken, STORE_TOKEN_FILE, Service, ServiceSpec, Token};
use service::page::{self, Enclosed};
use store::checkpoint::{CONFIG, Checkpoint, CheckpointStore, MANIFEST, Selector};
use store::lock::RunLock;
use store::outputs::{Input, Output};
use store::runs::runs_in;
use store::{files, owned_files};

use self::episode::Episode;
use crate::serve::no_store;
use crate::values::address;

const VIEW_EXAMPLES: &str = "\
Examples:
  octopus view
  octopus view runs/trajectory-20260101-120000
  octopus view runs
  octopus view deploy/policies/trajectory --open
  octopus view runs/trajectory-20260101-120000:best --out robot.html
  octopus view episode.json --policy runs/a:best

Prints an address for a browser of this machine; of a run that goes on it is that of the run itself, and shows it. The \
address holds the token of the service: whoever has it may do what you may. Anything else is served, for looking only, \
until Ctrl-C; of a directory of runs all of them, side by side. With --out the page, the simulator and the policy become one file that needs neither server nor network.

An episode that the page saved plays again, with the policies that took part, in their order. So does one of \
`octopus record`, by the policy that it names; robot viewers show that, too.";

/// Options of `octopus view`.
#[derive(Debug, Clone, Args)]
#[command(after_help = VIEW_EXAMPLES)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
pub struct ViewArgs {
    /// A run, a checkpoint such as RUN:best, the directory of a policy, one of runs, or the file of an episode [default: the
    /// newest run in runs/].
    pub what: Option<PathBuf>,
    /// Let the address change nothing, also that of a run that goes on.
    #[arg(long, conflicts_with = "out")]
    pub read_only: bool,
    /// Open it in the browser.
    #[arg(long, conflicts_with = "out")]
    pub open: bool,
    /// Write one file that shows it without a server.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write over a file of another kind, too; a page that this command made is replaced without it.
    #[arg(long, requires = "out")]
    pub force: bool,
    /// A policy of the episode in the file, once for each of them, in their order.
    #[arg(long = "policy", value_name = "CHECKPOINT")]
    pub policies: Vec<PathBuf>,
    /// Another policy for the arms to choose from, in the file; may be repeated.
    #[arg(long, value_name = "CHECKPOINT", requires = "out")]
    pub with: Vec<PathBuf>,
    /// Where to listen; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", allow_hyphen_values = true, default_value = "127.0.0.1:0", value_parser = address)]
    pub listen: SocketAddr,
    /// A file with a token that clients may show beside the service's own; needed beyond this machine.
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Print the address as JSON.
    #[arg(long, conflicts_with = "out")]
    pub json: bool,
}

/// How often to look whether the user wants to stop.
const TICK: Duration = Duration::from_millis(50);
/// How long a browser has to read the file by which it is opened.
const OPENING: Duration = Duration::from_secs(10);

/// Shows it.
pub fn run(args: &ViewArgs) -> anyhow::Result<()> {
    if !page::is_built() {
        return Err(ExitError::new(ExitCode::Environment, page::MISSING).into());
    }
    let what = match &args.what {
        Some(what) => what.clone(),
        None => newest_run()?,
    };
    let mut episode = Episode::read(&what, &args.policies)?;
    if episode.is_none() && !args.policies.is_empty() {
        let message = format!(
            "--policy: {} is no file of an episode, which alone has policies",
            what.display()
        );
        return Err(ExitError::new(ExitCode::Usage, message).into());
    }
    if let Some(out) = &args.out {
        return write(args, &what, episode.as_mut(), out);
    }
    let token = Token::find(args.token_file.as_deref())?;
    let live = RunLock::own_holder(&RunDir::new(&what).lock());
    if !args.read_only && matches!(live, Ok(Some(ref holder)) if holder.http.is_some()) {
        let address = Client::page_of_run(&what, token)?;
        tell(args, &address)?;
        if args.open {
            let opened = Opened::begin(&address)?;
            std::thread::sleep(OPENING);
            drop(opened);
        }
        return Ok(());
    }
    serve(args, &what, episode.as_mut(), token)
}

/// What a service shows.
struct Shown {
    /// The directory of runs, if it is one.
    runs: Option<PathBuf>,
    store: CheckpointStore,
    /// What the page shows first, as its address says it.
    first: Option<String>,
}

impl Shown {
    fn of(what: &Path, episode: Option<&mut Episode>) -> anyhow::Result<Self> {
        if let Some(episode) = episode {
            let store = episode.store()?;
            let first = Some(format!("play={}", episode.recording.fragment()?));
            return Ok(Self { runs: None, store, first });
        }
        if is_of_runs(what) {
            return Ok(Self { runs: Some(what.to_owned()), store: no_store(what), first: None });
        }
        let selector = Selector::from_path(what).map_err(|message| {
            ExitError::new(ExitCode::Usage, format!("{}: {message}", what.display()))
        })?;
        let (store, name) = selector.locate()?;
        Ok(Self { runs: None, store, first: Some(format!("policy={name}")) })
    }
}

/// Serves what lies on the disk until Ctrl-C; nothing of it can be changed.
fn serve(
    args: &ViewArgs,
    what: &Path,
    episode: Option<&mut Episode>,
    token: Option<Token>,
) -> anyhow::Result<()> {
    let Shown { runs, store, first } = Shown::of(what, episode)?;
    let stop = StopRequests::new();
    stop.listen_and_insist("stopped at once").context("signals cannot be caught")?;
    // Its own, for as long as it serves.
    let home = runs.as_deref().unwrap_or(store.root());
    let own = OwnToken::prepare(home.join(STORE_TOKEN_FILE))?.token();
    let service = Service::start(ServiceSpec {
        address: args.listen,
        token,
        runs,
        read_only: true,
        ..ServiceSpec::new(store, own.clone())
    })?;
    let address = own.page_address(&service.address().to_string(), first.as_deref());
    tell(args, &address)?;
    let opened = args.open.then(|| Opened::begin(&address)).transpose()?;
    while stop.count() == 0 {
        if !service.is_running() {
            let message = "the HTTP service has ended by itself; RUST_LOG=debug shows more";
            return Err(ExitError::new(ExitCode::Failure, message).into());
        }
        std::thread::sleep(TICK);
    }
    drop(opened);
    service.stop();
    Ok(())
}

/// Whether a directory is neither a run nor a checkpoint, and holds runs.
fn is_of_runs(path: &Path) -> bool {
    let holds = |name| path.join(name).exists();
    let is_one = holds(CONFIG) || holds(MANIFEST);
    path.is_dir() && !is_one && runs_in(path).is_ok_and(|runs| !runs.is_empty())
}

fn tell(args: &ViewArgs, address: &str) -> anyhow::Result<()> {
    if args.json {
        output::json_line(&json!({ "address": address }))
    } else {
        output::line(address)
    }
}

/// Writes the one file.
fn write(
    args: &ViewArgs,
    what: &Path,
    episode: Option<&mut Episode>,
    out: &Path,
) -> anyhow::Result<()> {
    let mut inputs = vec![what.to_owned()];
    inputs.extend(args.policies.iter().chain(&args.with).cloned());
    let read: Vec<Input<'_>> = inputs.iter().map(|path| ("CHECKPOINT", path.as_path())).collect();
    Output { flag: "--out", path: out, mark: page::SINGLE_MARK.as_bytes(), force: args.force }
        .check(&read)?;
    let mut policies = match &episode {
        Some(episode) => episode.open()?,
        None => vec![open_checkpoint(what)?],
    };
    let own = policies.len();
    for path in &args.with {
        policies.push(open_checkpoint(path)?);
    }
    let mut enclosed: Vec<Enclosed> = Vec::new();
    let mut names = Vec::new();
    for checkpoint in &policies {
        names.push(name_for(checkpoint, &names));
        let name = names.last().expect("just named");
        enclosed.extend(lab::standalone::enclosed(checkpoint, name)?);
    }
    let names: Vec<&str> = names[..own].iter().map(String::as_str).collect();
    let played = episode.map(|episode| {
        episode.rename(&names, &policies);
        episode.recording.fragment()
    });
    let text = page::single(&enclosed, played.transpose()?.as_deref());
    let text = text.context("the page has no frame")?;
    files::replace_output(out, text.as_bytes())?;
    output::line(&out.display().to_string())
}

/// A checkpoint's own name, told apart from those before it.
fn name_for(checkpoint: &Checkpoint, before: &[String]) -> String {
    let own = checkpoint.dir.file_name().map_or("policy".into(), |name| name.to_string_lossy());
    // One of these many names is free.
    let later = (2..=before.len() + 1).map(|count| format!("{own}-{count}"));
    let mut names = std::iter::once(own.to_string()).chain(later);
    names.find(|name| !before.contains(name)).expect("there are more names than policies")
}

/// The run in `runs/` that was changed last.
fn newest_run() -> anyhow::Result<PathBuf> {
    let runs = runs_in(Path::new(RUNS)).unwrap_or_default();
    let dated = runs.iter().filter_map(|run| {
        let changed = run.lock().metadata().and_then(|there| there.modified());
        Some((changed.ok()?, run.path().to_owned()))
    });
    dated.max().map(|(_, path)| path).ok_or_else(|| {
        let message =
            format!("{RUNS}/ holds no run; name one, a checkpoint, or the directory of a policy");
        ExitError::new(ExitCode::Usage, message).into()
    })
}

/// A file that leads a browser to the address. On the command line of the browser every user of this machine could
/// read the token.
struct Opened(PathBuf);

impl Opened {
    fn begin(address: &str) -> anyhow::Result<Self> {
        let dir =
            std::env::var_os("XDG_RUNTIME_DIR").map_or_else(std::env::temp_dir, PathBuf::from);
        let path = dir.join(format!("octopus-view-{}.html", std::process::id()));
        let text = format!(
            "<!doctype html><meta charset=\"utf-8\"><meta http-equiv=\"refresh\" content=\"0; url={address}\">"
        );
        owned_files::replace(&path, text.as_bytes())
            .with_context(|| format!("{}: cannot be written", path.display()))?;
        let opened = Self(path);
        let child = Command::new("xdg-open")
            .arg(&opened.0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        if let Err(error) = child {
            note(&format!("note: xdg-open cannot be started: {error}; open the address yourself"));
        }
        Ok(opened)
    }
}

impl Drop for Opened {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
