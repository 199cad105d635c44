//! Talks to the HTTP service beside a live run, for `octopus scale` and `octopus status`.
//!
//! A run writes the address of its service into its lock file, and the token for it beside that;
//! [`Client::of_run`] finds them there. A token goes to nobody but a process of this user
//! ([`crate::peer`]). The service is on this machine, so deadlines are short and no proxy is asked.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use proto::run_dir::RunDir;
use proto::{ExitCode, ExitError};
use serde::de::DeserializeOwned;
use store::lock::{LockError, RunLock};
use ureq::http::Response;
use ureq::{Agent, Body};

use crate::http::{
    CommitAnswer, ErrorBody, OwnToken, ScaleAnswer, ScaleRequest, TOKEN_FILE, TOKEN_VARIABLE, Token,
};
use crate::live::LiveStatus;
use crate::peer;

/// Time to connect to loopback.
const CONNECT_TIME: Duration = Duration::from_secs(2);
/// Time for an answer that the service has at hand.
const ANSWER_TIME: Duration = Duration::from_secs(5);
/// Time for an answer that waits for the run's loop; longer than the service itself waits.
const COMMAND_TIME: Duration = Duration::from_secs(70);
/// Longest answer that is read (bytes).
const MAX_ANSWER: u64 = 16 << 20;

/// A client of one service.
#[derive(Debug)]
pub struct Client {
    agent: Agent,
    base: String,
    token: Option<Token>,
}

/// Why a service did not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// It cannot be reached or does not answer in time.
    #[error("{url}: no answer: {reason}")]
    Unreachable {
        /// What was asked.
        url: String,
        /// How it showed.
        reason: String,
    },
    /// It refused.
    #[error("{message}")]
    Refused {
        /// The status code of the answer.
        status: u16,
        /// Its own words.
        message: String,
    },
    /// Its answer is not one of this program's service.
    #[error("{url}: an answer that is not understood: {reason}; is it the same version?")]
    Answer {
        /// What was asked.
        url: String,
        /// How it showed.
        reason: String,
    },
}

impl ClientError {
    /// What ends the program, or is told instead of an answer. `token_file` is where the command
    /// line said that the token is.
    pub fn explained(self, token_file: Option<&Path>) -> ExitError {
        let message = match self {
            Self::Refused { status: 401, message } => message,
            error => return ExitError::new(ExitCode::Failure, error.to_string()),
        };
        let shown = token_file.map_or_else(String::new, |path| format!("{}: ", path.display()));
        let cure = format!(
            "without --token-file the one in {TOKEN_FILE} of the run directory is shown, or that in \
             {TOKEN_VARIABLE} where there is no such file"
        );
        ExitError::new(ExitCode::Usage, format!("{shown}{message}; {cure}"))
    }
}

impl Client {
    /// A client of the service at `address`, `127.0.0.1:8270`, which has no token yet.
    pub fn new(address: &str) -> Self {
        let agent = Agent::config_builder()
            .proxy(None)
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(CONNECT_TIME))
            .timeout_global(Some(ANSWER_TIME))
            .build()
            .into();
        Self { agent, base: format!("http://{address}"), token: None }
    }

    /// Shows this token with every request.
    #[must_use]
    pub fn with_token(mut self, token: Option<Token>) -> Self {
        self.token = token;
        self
    }

    /// A client of the service beside the run that goes on in `run_dir`. It shows `token`, or else
    /// the one in the run directory, or else that of the environment. Whatever the lock file says,
    /// the token goes to no process but one of this user.
    pub fn of_run(run_dir: &Path, token: Option<Token>) -> Result<Self, ExitError> {
        let (address, token) = service_of(run_dir, token)?;
        Ok(Self::new(&address.to_string()).with_token(token))
    }

    /// The address of the page of the run that goes on in `run_dir`, with the token that [`Self::of_run`] would show.
    pub fn page_of_run(run_dir: &Path, token: Option<Token>) -> Result<String, ExitError> {
        let (address, token) = service_of(run_dir, token)?;
        let address = address.to_string();
        Ok(token.map_or_else(
            || format!("http://{address}/"),
            |token| token.page_address(&address, None),
        ))
    }

    /// What the run is doing.
    pub fn status(&self) -> Result<LiveStatus, ClientError> {
        let (url, request) = self.request("GET", "/v1/status");
        answer(&url, self.send(request, ANSWER_TIME, ()))
    }

    /// Has the run work with this many workers from now on, of `host` if one is named.
    pub fn scale(&self, workers: usize, host: Option<&str>) -> Result<ScaleAnswer, ClientError> {
        let wish = ScaleRequest { workers, host: host.map(str::to_owned) };
        let body = serde_json::to_vec(&wish).expect("it has a JSON form");
        let (url, request) = self.request("PUT", "/v1/workers");
        let request = request.header("content-type", "application/json");
        answer(&url, self.send(request, COMMAND_TIME, &body[..]))
    }

    /// Has the run commit a checkpoint after the iteration that it is training on; waits for it
    /// for a minute.
    pub fn checkpoint_now(&self) -> Result<CommitAnswer, ClientError> {
        let (url, request) = self.request("POST", "/v1/checkpoints");
        answer(&url, self.send(request, COMMAND_TIME, ()))
    }

    fn request(&self, method: &str, path: &str) -> (String, ureq::http::request::Builder) {
        let url = format!("{}{path}", self.base);
        let mut request = ureq::http::Request::builder().method(method).uri(&url);
        if let Some(token) = &self.token {
            request = request.header("authorization", token.authorization());
        }
        (url, request)
    }

    fn send(
        &self,
        request: ureq::http::request::Builder,
        time: Duration,
        body: impl ureq::AsSendBody,
    ) -> Result<Response<Body>, ureq::Error> {
        let request = self.agent.configure_request(request.body(body)?);
        self.agent.run(request.timeout_global(Some(time)).build())
    }
}

/// Where the service of a run is and what to show it; whatever the lock file says, a token goes to no process but
/// one of this user.
fn service_of(
    run_dir: &Path,
    token: Option<Token>,
) -> Result<(SocketAddr, Option<Token>), ExitError> {
    let refuse = |what: String| ExitError::new(ExitCode::RunDirectory, what);
    let place = run_dir.display();
    let lock = RunDir::new(run_dir).lock();
    let holder = RunLock::own_holder(&lock)
        .map_err(|error: LockError| refuse(error.to_string()))?
        .ok_or_else(|| {
            refuse(format!(
                "{place}: no run is going on in this directory; `octopus status` lists the runs"
            ))
        })?;
    let announced = holder.http.as_deref().ok_or_else(|| {
        refuse(format!(
            "{place}: the run has no HTTP service, or not yet: it is still starting, or was \
                 started without one"
        ))
    })?;
    let address = peer::address(&holder, announced).map_err(|reason| {
        refuse(format!("{}: {reason}; the token is not sent there", lock.display()))
    })?;
    let token = match token {
        Some(token) => Some(token),
        None => own_token(run_dir)?,
    };
    Ok((address, token))
}

/// The token that the run in `run_dir` has made for itself; without one, that of the environment.
fn own_token(run_dir: &Path) -> Result<Option<Token>, ExitError> {
    let path = run_dir.join(TOKEN_FILE);
    match OwnToken::read(&path) {
        Ok(token) => Ok(Some(token)),
        Err(error) if error.kind() == ErrorKind::NotFound => Token::from_environment(),
        Err(error) => {
            let message = format!(
                "{}: is not believed: {error}; --token-file FILE names another",
                path.display()
            );
            Err(ExitError::new(ExitCode::RunDirectory, message))
        }
    }
}

fn answer<T: DeserializeOwned>(
    url: &str,
    response: Result<Response<Body>, ureq::Error>,
) -> Result<T, ClientError> {
    let unreachable = |error: ureq::Error| ClientError::Unreachable {
        url: url.to_owned(),
        reason: error.to_string(),
    };
    let mut response = response.map_err(unreachable)?;
    let status = response.status();
    let body = response.body_mut().with_config().limit(MAX_ANSWER);
    let bytes = body.read_to_vec().map_err(unreachable)?;
    let misunderstood = |error: serde_json::Error| ClientError::Answer {
        url: url.to_owned(),
        reason: error.to_string(),
    };
    if status.is_success() {
        return serde_json::from_slice(&bytes).map_err(misunderstood);
    }
    let refusal: ErrorBody = serde_json::from_slice(&bytes).map_err(misunderstood)?;
    Err(ClientError::Refused { status: status.as_u16(), message: refusal.error })
}
