//! Measures the checkpoint service: requests a second and latencies of the list and of a download.
//!
//! ```text
//! octopus serve --store runs/RUN &
//! cargo run --release -p coordinator --example http_load -- \
//!     --token-file runs/RUN/checkpoints/.http.token --connections 16 --seconds 5
//! ```
//!
//! Every connection is kept alive and asks again as soon as it is answered (a closed loop), so the
//! latency includes waiting for the other connections. Loopback only: this measures the service,
//! not a network, and is no tool against somebody else's.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail, ensure};
use clap::Parser;
use proto::statistics::quantile;
use serde::Serialize;

/// Measures the checkpoint service.
#[derive(Debug, Parser)]
struct Args {
    /// Where the service listens.
    #[arg(long, default_value = "127.0.0.1:8270")]
    address: SocketAddr,
    /// The file with the service's token.
    #[arg(long)]
    token_file: PathBuf,
    /// Connections at a time.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=256))]
    connections: u32,
    /// Time for each kind of request.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=60))]
    seconds: u32,
    /// Most requests of each kind and connection.
    #[arg(long, default_value_t = 1_000_000)]
    requests: u64,
    /// The file to download.
    #[arg(long, default_value = "/v1/checkpoints/latest/files/state.safetensors")]
    file: String,
}

/// What one kind of request took.
#[derive(Debug, Serialize)]
struct Measurement {
    path: String,
    connections: u32,
    requests: usize,
    seconds: f64,
    requests_per_s: f64,
    megabytes_per_s: f64,
    body_bytes: u64,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    ensure!(args.address.ip().is_loopback(), "{}: not this machine", args.address);
    let token = std::fs::read_to_string(&args.token_file)
        .with_context(|| args.token_file.display().to_string())?;
    let mut results = Vec::new();
    for path in ["/health", "/v1/checkpoints", &args.file] {
        results.push(measure(&args, path, token.trim())?);
    }
    output::json(&results)
}

fn measure(args: &Args, path: &str, token: &str) -> anyhow::Result<Measurement> {
    let address = args.address;
    let request =
        format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\r\n");
    let time = Duration::from_secs(u64::from(args.seconds));
    let start = Instant::now();
    let results = std::thread::scope(|scope| {
        let client = || client(address, path, &request, start + time, args.requests);
        let clients: Vec<_> = (0..args.connections).map(|_| scope.spawn(client)).collect();
        clients
            .into_iter()
            .map(|client| client.join().unwrap_or_else(|_| bail!("a client panicked")))
            .collect::<anyhow::Result<Vec<_>>>()
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let body_bytes = results.first().map_or(0, |(_, bytes)| *bytes);
    let mut latencies: Vec<f64> =
        results.into_iter().flat_map(|(latencies, _)| latencies).collect();
    latencies.sort_by(f64::total_cmp);
    let requests = latencies.len();
    Ok(Measurement {
        path: path.to_owned(),
        connections: args.connections,
        requests,
        seconds,
        requests_per_s: requests as f64 / seconds,
        megabytes_per_s: requests as f64 * body_bytes as f64 / 1e6 / seconds,
        body_bytes,
        p50_ms: quantile(&latencies, 0.5),
        p99_ms: quantile(&latencies, 0.99),
        max_ms: quantile(&latencies, 1.0),
    })
}

/// Asks until the time is over; returns latencies (ms) and the length of the last body.
fn client(
    address: SocketAddr,
    path: &str,
    request: &str,
    until: Instant,
    most: u64,
) -> anyhow::Result<(Vec<f64>, u64)> {
    let stream = TcpStream::connect(address).with_context(|| format!("{address}: no service"))?;
    stream.set_nodelay(true)?;
    let mut reader = BufReader::with_capacity(256 << 10, stream.try_clone()?);
    let mut writer = stream;
    let (mut latencies, mut body) = (Vec::new(), 0);
    while Instant::now() < until && (latencies.len() as u64) < most {
        let start = Instant::now();
        writer.write_all(request.as_bytes())?;
        body = read_answer(&mut reader).with_context(|| format!("GET {path}"))?;
        latencies.push(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok((latencies, body))
}

/// Reads an answer that must be a success; returns the length of its body.
fn read_answer(reader: &mut BufReader<TcpStream>) -> anyhow::Result<u64> {
    let mut line = String::new();
    reader.read_line(&mut line)?;
    ensure!(line.starts_with("HTTP/1.1 200 "), "answered `{}`", line.trim_end());
    let mut len = None;
    loop {
        line.clear();
        reader.read_line(&mut line)?;
        let field = line.trim_end();
        if field.is_empty() {
            break;
        }
        if let Some((name, value)) = field.split_once(':')
            && name.eq_ignore_ascii_case("content-length")
        {
            len = value.trim().parse::<u64>().ok();
        }
    }
    let len = len.context("an answer of unknown length")?;
    let read = std::io::copy(&mut reader.take(len), &mut std::io::sink())?;
    ensure!(read == len, "the answer ended after {read} of {len} bytes");
    Ok(len)
}
