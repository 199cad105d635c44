//! The token that every service makes for itself, and the file in which its user's programs find it.
//!
//! Every user of a machine reaches its loopback. So a service asks everybody for a token, also those
//! who came from here, and nobody but its own user can read the file that holds it.

use std::io::{ErrorKind, Read as _};
use std::path::{Path, PathBuf};

use proto::{ExitCode, ExitError};
use store::owned_files::{self, Others};

use super::token::Token;

/// Name of the file, in the directory of a run.
pub const TOKEN_FILE: &str = "http.token";
/// Name of the file, in a store that is served without a run.
pub const STORE_TOKEN_FILE: &str = ".http.token";
/// Random bytes of a token: nobody guesses 256 bits.
const BYTES: usize = 32;

/// A token and its file.
#[derive(Debug)]
pub struct OwnToken {
    token: Token,
    path: PathBuf,
    /// Whether the file holds it.
    kept: bool,
}

impl OwnToken {
    /// The token in the file at `path`, if only this user can have written and read it; else a new
    /// one, which is not in the file yet. So programs that have read it go on when a run is resumed.
    pub fn prepare(path: PathBuf) -> Result<Self, ExitError> {
        if let Ok(token) = Self::read(&path) {
            return Ok(Self { token, path, kept: true });
        }
        let token = random().map_err(|error| {
            let message = format!("/dev/urandom: cannot be read: {error}; a token is made of it");
            ExitError::new(ExitCode::Environment, message)
        })?;
        Ok(Self { token, path, kept: false })
    }

    /// Puts it into its file, whose directory must exist, if it is not there.
    pub fn keep(&mut self) -> Result<(), ExitError> {
        if !self.kept {
            owned_files::replace(&self.path, format!("{}\n", self.token.text()).as_bytes())
                .map_err(|error| {
                    let message = format!("{}: cannot be written: {error}", self.path.display());
                    ExitError::new(ExitCode::RunDirectory, message)
                })?;
            self.kept = true;
        }
        Ok(())
    }

    /// Whether the file holds it.
    pub fn is_kept(&self) -> bool {
        self.kept
    }

    /// The token.
    pub fn token(&self) -> Token {
        self.token.clone()
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the token in the file at `path`.
    pub fn read(path: &Path) -> Result<Token, std::io::Error> {
        let text = owned_files::read_text(path, Others::MayNothing)?;
        Token::parse(&text, &path.display().to_string())
            .map_err(|error| std::io::Error::new(ErrorKind::InvalidData, error.message))
    }
}

fn random() -> std::io::Result<Token> {
    let mut bytes = [0; BYTES];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    let text = blake3::Hash::from_bytes(bytes).to_hex();
    Token::parse(&text, "/dev/urandom").map_err(std::io::Error::other)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};

    use super::*;

    #[test]
    fn a_token_is_kept_for_its_user_alone_and_found_again() {
        let dir = tempfile::tempdir().expect("tempdir");
        let path = dir.path().join(TOKEN_FILE);
        let prepare = || OwnToken::prepare(path.clone()).expect("random");
        let mut first = prepare();
        assert!(!path.exists(), "nothing is written before there is a run");
        assert_ne!(first.token().text(), prepare().token().text(), "each is another");
        first.keep().expect("writes");
        assert_eq!(path.metadata().expect("there").mode() & 0o777, 0o600);
        assert_eq!(prepare().token().text(), first.token().text(), "a resumed run keeps it");
        assert_eq!(first.token().text().len(), 2 * BYTES);

        // What others may have read or written is a secret no more.
        for mode in [0o644, 0o620] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("own");
            assert!(OwnToken::read(&path).is_err(), "{mode:o}");
            let mut another = prepare();
            assert_ne!(another.token().text(), first.token().text(), "{mode:o}");
            another.keep().expect("writes");
            assert_eq!(path.metadata().expect("there").mode() & 0o777, 0o600);
        }
        std::fs::remove_file(&path).expect("there");
        std::fs::create_dir(&path).expect("a directory");
        let error = prepare().keep().expect_err("a directory").to_string();
        assert!(error.contains(TOKEN_FILE), "{error}");
    }
}
