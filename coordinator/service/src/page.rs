//! The page: the program that browsers run, as `make page` has built it into this one.
//!
//! It holds nothing of any run. What it shows it asks the service for, with a token that its user gives it; or it
//! finds it in the one file that [`single`] makes.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// A file of the page.
#[derive(Debug)]
pub struct Asset {
    /// Its name, `page.js`.
    pub name: &'static str,
    /// Its media type.
    pub kind: &'static str,
    /// Entity tag of its content.
    pub etag: &'static str,
    /// Its content, compressed.
    pub gzip: &'static [u8],
}

/// All files, or none where the page was not built.
pub static ASSETS: &[Asset] = include!(concat!(env!("OUT_DIR"), "/assets.rs"));

/// The frame of the one file.
static SINGLE: Option<&str> = include!(concat!(env!("OUT_DIR"), "/single.rs"));

/// What a program without the page says.
pub const MISSING: &str = "this program was built without the page; `make page` builds it, and the next `make build` \
                           puts it into the program";

/// The file called `name`.
pub fn asset(name: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.name == name)
}

/// Whether the page is what an address asks for by this path.
pub(crate) fn is_at(path: &str) -> bool {
    path == "/" || path.strip_prefix("/page/").is_some_and(|name| asset(name).is_some())
}

/// Whether the page is there.
pub fn is_built() -> bool {
    !ASSETS.is_empty()
}

/// A file of a policy that goes into the one file.
#[derive(Debug)]
pub struct Enclosed {
    /// Name of the policy.
    pub policy: String,
    /// Name of the file.
    pub file: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// What such a file begins with.
pub const SINGLE_MARK: &str = "<!doctype html>\n<!-- made by octopus view -->";

/// One file that is page, simulator and policies, and needs no server and no network; none where the page was not
/// built. It plays `episode`, as an address holds one, unless it is asked for another.
pub fn single(policies: &[Enclosed], episode: Option<&str>) -> Option<String> {
    let frame = SINGLE?;
    let mut data = String::new();
    if let Some(episode) = episode {
        // Base64 for addresses.
        let _ = writeln!(data, "<script type=\"text/plain\" data-play=\"{episode}\"></script>");
    }
    for asset in ASSETS.iter().filter(|asset| asset.name != "index.html") {
        push(&mut data, "asset", asset.name, asset.gzip);
    }
    for enclosed in policies {
        push(
            &mut data,
            "policy",
            &format!("{}/{}", enclosed.policy, enclosed.file),
            &enclosed.bytes,
        );
    }
    Some(frame.replacen("<!-- data -->", &data, 1))
}

/// Adds bytes as text that no browser takes for a script. Names are those of checkpoints and files, which need no
/// escaping; what does is left out.
fn push(out: &mut String, kind: &str, name: &str, bytes: &[u8]) {
    let plain = |c: &char| c.is_ascii_alphanumeric() || "-_./".contains(*c);
    let name: String = name.chars().filter(plain).collect();
    let _ = write!(out, "<script type=\"text/plain\" data-{kind}=\"{name}\">");
    STANDARD.encode_string(bytes, out);
    out.push_str("</script>\n");
}
