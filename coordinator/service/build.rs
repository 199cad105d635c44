//! Puts the page into the service, if `make page` has built it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

/// Files of the page, as they are served, with what they are.
const FILES: [(&str, &str); 5] = [
    ("index.html", "text/html; charset=utf-8"),
    ("page.css", "text/css; charset=utf-8"),
    ("page.js", "text/javascript; charset=utf-8"),
    ("worker.js", "text/javascript; charset=utf-8"),
    ("simulator.wasm", "application/wasm"),
];
/// What one file with everything in it is made of.
const SINGLE: &str = "single.html";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let manifest = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let built = manifest.join("../web/dist");
    // The folder is always there, and what comes into it later is noticed.
    println!("cargo::rerun-if-changed={}", built.display());

    let compressed = |name: &str| built.join(format!("{name}.gz"));
    let whole =
        FILES.iter().all(|(name, _)| compressed(name).is_file()) && built.join(SINGLE).is_file();
    let mut text = String::from("&[\n");
    if whole {
        for (name, kind) in FILES {
            let path = compressed(name);
            let etag = etag(&path);
            let path = path.display();
            writeln!(
                text,
                "Asset {{ name: {name:?}, kind: {kind:?}, etag: {etag:?}, gzip: include_bytes!({path:?}) }},",
                path = path.to_string()
            )
            .expect("writes to a string");
        }
    }
    text.push(']');
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("set by cargo"));
    fs::write(out.join("assets.rs"), text).expect("cargo's own directory");
    let single = if whole {
        format!("Some(include_str!({:?}))", built.join(SINGLE).display().to_string())
    } else {
        "None".to_owned()
    };
    fs::write(out.join("single.rs"), single).expect("cargo's own directory");
}

/// Names the content, so that a browser that has it is not sent it again.
fn etag(path: &Path) -> String {
    let bytes = fs::read(path).expect("is a file");
    format!("\"{}\"", blake3::hash(&bytes).to_hex())
}
