//! No archive can be opened, and none written: see this crate's Cargo.toml.

use std::convert::Infallible;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::path::PathBuf;

/// Errors.
pub mod result {
    /// Why there is no archive.
    pub type ZipError = Unsupported;

    /// This program was built without archives.
    #[derive(Debug, Clone, Copy)]
    pub struct Unsupported;

    impl std::fmt::Display for Unsupported {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("this program was built without zip archives (.npz)")
        }
    }

    impl std::error::Error for Unsupported {}
}

/// How an archive is written.
pub mod write {
    /// Nothing to choose.
    #[derive(Debug, Clone, Copy, Default)]
    pub struct FileOptions;

    impl FileOptions {
        /// The same.
        #[must_use]
        pub fn compression_method(self, _: crate::CompressionMethod) -> Self {
            self
        }
    }
}

/// How files are compressed.
#[derive(Debug, Clone, Copy)]
pub enum CompressionMethod {
    /// Not at all.
    Stored,
}

/// An archive to read; there is none.
#[derive(Debug)]
pub struct ZipArchive(Infallible);

impl ZipArchive {
    /// Fails.
    pub fn new<R: Read>(_: R) -> std::result::Result<Self, result::ZipError> {
        Err(result::Unsupported)
    }

    /// Files in it.
    pub fn len(&self) -> usize {
        match self.0 {}
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        match self.0 {}
    }

    /// One of them.
    pub fn by_index(&mut self, _: usize) -> std::result::Result<ZipFile, result::ZipError> {
        match self.0 {}
    }
}

/// A file of an archive; there is none.
#[derive(Debug)]
pub struct ZipFile(Infallible);

impl ZipFile {
    /// Its name.
    pub fn name(&self) -> &str {
        match self.0 {}
    }

    /// Its name without what leads out of a folder.
    pub fn mangled_name(&self) -> PathBuf {
        match self.0 {}
    }

    /// Its size.
    pub fn size(&self) -> u64 {
        match self.0 {}
    }
}

impl Read for ZipFile {
    fn read(&mut self, _: &mut [u8]) -> Result<usize> {
        match self.0 {}
    }
}

/// An archive to write, which takes nothing.
#[derive(Debug)]
pub struct ZipWriter;

impl ZipWriter {
    /// One that takes nothing.
    pub fn new<W: Write>(_: W) -> Self {
        Self
    }

    /// Fails.
    pub fn start_file<S: Into<String>>(
        &mut self,
        _: S,
        _: write::FileOptions,
    ) -> std::result::Result<(), result::ZipError> {
        Err(result::Unsupported)
    }
}

impl Write for ZipWriter {
    fn write(&mut self, _: &[u8]) -> Result<usize> {
        Err(Error::new(ErrorKind::Unsupported, result::Unsupported))
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}
