//! Whatever a client sends: never a panic, never an answer that blames the service.

use axum::body::Body;
use axum::http::Request;
use proptest::prelude::*;
use tokio::runtime::Runtime;

use super::{Bench, TOKEN};
use crate::http::limits::Limits;
use crate::live::LiveRun;

thread_local! {
    /// One service for all cases of a test; none of them may change what is there. It goes with the
    /// thread of the test: its directory would outlive one for all tests, which nobody drops.
    static BENCH: (Runtime, Bench) = {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let live = LiveRun::new();
        live.close();
        let bench = Bench::with(&[1], Some(live), Limits::default());
        (runtime.expect("a runtime"), bench)
    };

    /// The checkpoint of that service as it travels.
    static ARCHIVE: Vec<u8> = BENCH.with(|(_, bench)| {
        let mut archive = Vec::new();
        let name = "iteration-00000001".parse().expect("a name");
        bench.store.export(&name, &mut archive).expect("exports");
        archive
    });
}

/// Sends what may not even be a request; `None` if it is none.
fn status(method: &str, path: &str, range: &[u8], body: Vec<u8>) -> Option<u16> {
    let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
    request = request.header("authorization", format!("Bearer {TOKEN}"));
    if let Ok(range) = axum::http::HeaderValue::from_bytes(range) {
        request = request.header("range", &range).header("if-none-match", range);
    }
    let request = request.body(Body::from(body)).ok()?;
    let answer = BENCH.with(|(runtime, bench)| runtime.block_on(bench.request(request)));
    if answer.status.is_client_error() && method != "HEAD" {
        answer.error();
    }
    Some(answer.status.as_u16())
}

/// Texts that come close to paths.
fn path() -> impl Strategy<Value = String> {
    let segment = prop_oneof![
        Just("v1".to_owned()),
        Just("checkpoints".to_owned()),
        Just("latest".to_owned()),
        Just("iteration-00000001".to_owned()),
        Just("files".to_owned()),
        Just("state.safetensors".to_owned()),
        Just("tags".to_owned()),
        Just("..".to_owned()),
        Just("%2e%2e%2f".to_owned()),
        Just("%00".to_owned()),
        Just("%ff%fe".to_owned()),
        Just("%".to_owned()),
        Just(String::new()),
        "[ -~]{0,12}",
        "\\PC{0,8}",
    ];
    prop::collection::vec(segment, 0..7).prop_map(|parts| format!("/{}", parts.join("/")))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..Default::default() })]

    #[test]
    fn paths_and_headers(
        method in prop_oneof![Just("GET"), Just("HEAD"), Just("PUT"), Just("POST"), Just("BREW")],
        path in path(),
        range in prop_oneof![
            prop::collection::vec(any::<u8>(), 0..20),
            "bytes=[0-9,-]{0,30}".prop_map(String::into_bytes),
        ],
    ) {
        let status = status(method, &path, &range, Vec::new());
        prop_assert!(status.is_none_or(|status| status < 500), "{method} {path:?}: {status:?}");
    }

    #[test]
    fn bodies(
        path in prop_oneof![
            Just("/v1/workers"),
            Just("/v1/checkpoints/new"),
            Just("/v1/checkpoints/iteration-00000001"),
        ],
        body in prop::collection::vec(any::<u8>(), 0..3000),
    ) {
        let status = status("PUT", path, b"", body);
        prop_assert!(status.is_some_and(|status| (400..500).contains(&status)), "{status:?}");
    }

    /// Archives that begin well: one byte of a whole one is another.
    #[test]
    fn archives_with_a_wrong_byte(at in 0usize..8192, byte in any::<u8>()) {
        let mut archive = ARCHIVE.with(Vec::clone);
        archive[at] = byte;
        let status = status("PUT", "/v1/checkpoints/iteration-00000001", b"", archive);
        prop_assert!(status.is_some_and(|status| status < 500), "{at} {byte}: {status:?}");
        // What a refused upload had written goes by itself, if not at once.
        let inventory = || BENCH.with(|(_, bench)| bench.inventory());
        let mut names = inventory();
        for _ in 0..500 {
            if names == ["iteration-00000001"] {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
            names = inventory();
        }
        prop_assert_eq!(names, ["iteration-00000001"]);
    }
}
