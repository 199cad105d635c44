//! The page: the program that browsers run, as `make page` has built it into a folder beside this one.
//!
//! It holds nothing of any run. What it shows it asks the service for, with a token that its user gives it; or it
//! finds it in the one file that [`single`] makes.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// The folder that `make page` fills.
const FOLDER: &str = "octopus-page";
/// Files of the page, as they are served, with their media types. In the folder each is compressed.
const FILES: [(&str, &str); 5] = [
    ("index.html", "text/html; charset=utf-8"),
    ("page.css", "text/css; charset=utf-8"),
    ("page.js", "text/javascript; charset=utf-8"),
    ("worker.js", "text/javascript; charset=utf-8"),
    ("simulator.wasm", "application/wasm"),
];
/// What one file with everything in it is made of.
const SINGLE: &str = "single.html";

/// A file of the page.
#[derive(Debug)]
pub struct Asset {
    /// Its name, `page.js`.
    pub name: &'static str,
    /// Its media type.
    pub kind: &'static str,
    /// Entity tag of its content: names it, so that a browser that has it is not sent it again.
    pub etag: String,
    /// Its content, compressed.
    pub gzip: Vec<u8>,
}

/// What the folder holds.
#[derive(Debug)]
struct Page {
    assets: Vec<Asset>,
    /// The frame of the one file.
    single: String,
}

/// What is said where the page is not there.
pub const MISSING: &str = "the page for browsers is missing: there is no folder octopus-page beside the program or beside the folder that it is in; \
                           `make page` builds it into target/";

/// The page, read when it is first asked for. Where it is not there it is looked for again the next time: it may be built meanwhile.
fn page() -> Option<&'static Page> {
    static PAGE: OnceLock<Page> = OnceLock::new();
    if let Some(page) = PAGE.get() {
        return Some(page);
    }
    let program = std::env::current_exe().ok()?;
    let page = folders(&program).iter().find_map(|folder| Page::read(folder))?;
    Some(PAGE.get_or_init(|| page))
}

/// Where the page may lie: beside the program, or beside the folder that it is in. Programs that cargo makes of tests and
/// examples are a folder deeper than others. No further up: what lies there may be somebody else's.
fn folders(program: &Path) -> Vec<PathBuf> {
    let deeper = |dir: &Path| dir.ends_with("deps") || dir.ends_with("examples");
    let dirs = program.ancestors().skip(1).skip_while(|dir| deeper(dir));
    dirs.take(2).map(|dir| dir.join(FOLDER)).collect()
}

impl Page {
    /// None where a file is missing, or where another folder has taken this one's place meanwhile.
    fn read(folder: &Path) -> Option<Self> {
        let inode = || fs::metadata(folder).ok().map(|folder| folder.ino());
        let before = inode();
        let mut assets = Vec::with_capacity(FILES.len());
        for (name, kind) in FILES {
            let gzip = fs::read(folder.join(format!("{name}.gz"))).ok()?;
            let etag = format!("\"{}\"", blake3::hash(&gzip).to_hex());
            assets.push(Asset { name, kind, etag, gzip });
        }
        let single = fs::read_to_string(folder.join(SINGLE)).ok()?;
        (inode() == before).then_some(Self { assets, single })
    }
}

/// All files, or none where the page is not there.
pub fn assets() -> &'static [Asset] {
    page().map_or(&[], |page| &page.assets)
}

/// The file called `name`.
pub fn asset(name: &str) -> Option<&'static Asset> {
    assets().iter().find(|asset| asset.name == name)
}

/// Whether the page is what an address asks for by this path.
pub(crate) fn is_at(path: &str) -> bool {
    path == "/" || path.strip_prefix("/page/").is_some_and(|name| asset(name).is_some())
}

/// Whether the page is there.
pub fn is_built() -> bool {
    page().is_some()
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

/// One file that is page, simulator and policies, and needs no server and no network; none where the page is not
/// there. It plays `episode`, as an address holds one, unless it is asked for another.
pub fn single(policies: &[Enclosed], episode: Option<&str>) -> Option<String> {
    let Page { assets, single } = page()?;
    let mut data = String::new();
    if let Some(episode) = episode {
        // Base64 for addresses.
        let _ = writeln!(data, "<script type=\"text/plain\" data-play=\"{episode}\"></script>");
    }
    for asset in assets.iter().filter(|asset| asset.name != "index.html") {
        push(&mut data, "asset", asset.name, &asset.gzip);
    }
    for enclosed in policies {
        push(
            &mut data,
            "policy",
            &format!("{}/{}", enclosed.policy, enclosed.file),
            &enclosed.bytes,
        );
    }
    Some(single.replacen("<!-- data -->", &data, 1))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_lies_beside_the_program_or_one_folder_up() {
        let of = |program: &str| folders(Path::new(program));
        let built =
            [PathBuf::from("/r/target/release").join(FOLDER), "/r/target/octopus-page".into()];
        assert_eq!(of("/r/target/release/octopus"), built);
        assert_eq!(of("/r/target/release/deps/it-1"), built);
        assert_eq!(of("/r/target/release/examples/chaos"), built);
    }

    /// Half a page is none.
    #[test]
    fn a_folder_is_read_once_it_is_whole() {
        let dir = tempfile::tempdir().expect("a temporary directory");
        for (name, _) in FILES {
            assert!(Page::read(dir.path()).is_none(), "without {name}");
            fs::write(dir.path().join(format!("{name}.gz")), name).expect("can be written");
        }
        assert!(Page::read(dir.path()).is_none(), "without a frame");
        fs::write(dir.path().join(SINGLE), "<!-- data -->").expect("can be written");
        let page = Page::read(dir.path()).expect("is whole");
        assert_eq!(page.assets.len(), FILES.len());
        assert_eq!(page.assets[2].gzip, b"page.js");
        assert_ne!(page.assets[2].etag, page.assets[3].etag);
    }
}
