//! Where others see a run and ask it for something.

use std::net::SocketAddr;
use std::path::Path;

use proto::run_dir::RunDir;
use service::http::{OwnToken, Service, ServiceSpec, TOKEN_FILE, Token};
use service::live::LiveRun;
use store::checkpoint::CheckpointStore;

/// Where others see the run and ask it for something: its HTTP service, if it is to have one.
///
/// Opened before a run writes any file, so that an address or a token that is wrong leaves nothing.
#[derive(Debug)]
pub struct RunService {
    pub(super) live: LiveRun,
    pub(super) listening: Option<Listening>,
}

/// A service, and the token of its own.
#[derive(Debug)]
pub(super) struct Listening {
    pub(super) service: Service,
    pub(super) token: OwnToken,
}

impl RunService {
    /// Begins to listen at `address`, if one is given; a token of the user's own stands in `token_file`. With
    /// `read_only` nobody may change anything, whatever they show.
    pub fn open(
        address: Option<SocketAddr>,
        token_file: Option<&Path>,
        read_only: bool,
        run_dir: &RunDir,
    ) -> anyhow::Result<Self> {
        let live = LiveRun::new();
        let Some(address) = address else { return Ok(Self { live, listening: None }) };
        let token = Token::find(token_file)?;
        let own = OwnToken::prepare(run_dir.path().join(TOKEN_FILE))?;
        let store = CheckpointStore::new(run_dir.checkpoints());
        let start = |address| {
            let spec = ServiceSpec::new(store.clone(), own.token());
            let (token, live) = (token.clone(), Some(live.clone()));
            Service::start(ServiceSpec { address, token, live, read_only, ..spec })
        };
        // Where nobody has chosen one, the port is the run's own if it is free.
        let service = match address.port() {
            0 => {
                start(SocketAddr::new(address.ip(), own.token().port())).or_else(|_| start(address))
            }
            _ => start(address),
        };
        let service = service?;
        Ok(Self { live, listening: Some(Listening { service, token: own }) })
    }
}
