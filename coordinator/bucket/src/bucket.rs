//! A bucket, opened: where it is, and the client that speaks to it.

use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use proto::bucket_address;
use tokio::runtime::Runtime;

use crate::error::BucketError;
use crate::secrets::hidden;

/// How long to wait for a connection.
const CONNECT: Duration = Duration::from_secs(10);
/// How long a server may be silent within an answer.
const SILENCE: Duration = Duration::from_secs(30);
/// How long one request may take, one of 8 MiB too.
const REQUEST: Duration = Duration::from_mins(5);
/// How long and how often the client tries a request again by itself.
const PATIENCE: Duration = Duration::from_secs(20);
const RETRIES: usize = 3;

/// What a bucket holds below a prefix. Whoever calls waits; a training has a [thread](crate::mirror) for that.
#[derive(Debug)]
pub struct Bucket {
    address: String,
    pub(crate) objects: Arc<dyn ObjectStore>,
    prefix: Path,
    runtime: Runtime,
}

impl Bucket {
    /// Whether a path of the command line is a bucket's address.
    pub fn is_named_by(path: &FilePath) -> bool {
        path.to_str().is_some_and(bucket_address::is_address)
    }

    /// Makes the client; asks nobody yet. Credentials are those of the environment.
    pub fn open(address: &str) -> Result<Self, BucketError> {
        let refuse = |reason: String| {
            let examples = bucket_address::examples();
            let shown: String = address.escape_debug().take(SHOWN).collect();
            BucketError::Refused(format!(
                "`{}` is no address of a bucket: it {reason}; write one as in {examples}",
                before_secrets(&shown)
            ))
        };
        if let Some(problem) = bucket_address::problem(address) {
            return Err(refuse(problem));
        }
        let address = address.trim_end_matches('/').to_owned();
        let url: url::Url =
            address.parse().map_err(|error| refuse(format!("has a flaw: {error}")))?;
        let prefix = Path::from_url_path(url.path())
            .map_err(|error| refuse(format!("has a prefix that cannot be: {error}")))?;
        let objects = client(&address, url.scheme()).map_err(|error| {
            let reason = hidden(&error.to_string());
            BucketError::Refused(format!("{address}: the environment does not fit: {reason}"))
        })?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| BucketError::File(format!("no event loop: {error}")))?;
        Ok(Self { address, objects, prefix, runtime })
    }

    /// Its address, as it was written.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The last part of its prefix: what a run that comes from it may be called.
    pub fn name(&self) -> &str {
        self.address.rsplit('/').next().unwrap_or(&self.address)
    }

    /// The path of an object below the prefix, its parts divided by `/`.
    pub(crate) fn path(&self, below: &str) -> Path {
        below.split('/').fold(self.prefix.clone(), Path::join)
    }

    /// An object's address, for messages.
    pub(crate) fn shown(&self, below: &str) -> String {
        format!("{}/{below}", self.address)
    }

    /// A checkpoint as commands name it.
    pub fn place(&self, name: &store::checkpoint::Name) -> PathBuf {
        format!("{}:{name}", self.address).into()
    }

    pub(crate) fn wait<T>(&self, work: impl Future<Output = T>) -> T {
        self.runtime.block_on(work)
    }
}

/// Longest address that is shown where it is none (characters).
const SHOWN: usize = 100;

/// What was put into an address in the way of a secret is not repeated.
fn before_secrets(address: &str) -> &str {
    let end = address.find(['@', '?', '#']).map(|_| address.find("://").map_or(0, |at| at + 3));
    &address[..end.unwrap_or(address.len())]
}

fn client(address: &str, scheme: &str) -> object_store::Result<Arc<dyn ObjectStore>> {
    // Somebody may have chosen a provider already.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig {
        backoff: BackoffConfig {
            init_backoff: Duration::from_millis(200),
            max_backoff: Duration::from_secs(5),
            base: 2.0,
        },
        max_retries: RETRIES,
        retry_timeout: PATIENCE,
    };
    let options = |plain: &[&str]| {
        // An endpoint without TLS is one only because somebody has named it in so many words.
        let named = plain.iter().filter_map(|name| std::env::var(name).ok());
        let plain =
            named.into_iter().any(|value| value.to_ascii_lowercase().starts_with("http://"));
        ClientOptions::new()
            .with_connect_timeout(CONNECT)
            .with_read_timeout(SILENCE)
            .with_timeout(REQUEST)
            .with_allow_http(plain)
    };
    Ok(match scheme {
        "s3" => Arc::new(
            AmazonS3Builder::from_env()
                .with_url(address)
                .with_retry(retry)
                .with_client_options(options(&[
                    "AWS_ENDPOINT_URL",
                    "AWS_ENDPOINT_URL_S3",
                    "AWS_ENDPOINT",
                ]))
                .build()?,
        ),
        "gs" => Arc::new(
            GoogleCloudStorageBuilder::from_env()
                .with_url(address)
                .with_retry(retry)
                .with_client_options(options(&["GOOGLE_BASE_URL", "STORAGE_EMULATOR_HOST"]))
                .build()?,
        ),
        "az" => Arc::new(
            MicrosoftAzureBuilder::from_env()
                .with_url(address)
                .with_retry(retry)
                .with_client_options(options(&["AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT"]))
                .build()?,
        ),
        _ => Arc::new(LocalFileSystem::new().with_fsync(true)),
    })
}
