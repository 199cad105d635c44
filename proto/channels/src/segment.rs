//! Segments of shared memory: files in the domain's own directory, all of whose pages are there.
//!
//! A file in memory that has a length has no pages yet. Each is found when it is first touched, and
//! where none is left the process that touched it dies of SIGBUS, in the middle of something that is
//! not to blame. So a segment gets all its pages when it is made, or is not made, and what was short
//! can be [asked for](take_shortage).
//!
//! The mapping and everything in it are iceoryx2's [`file::Storage`]; this wraps its creation. It also
//! never passes on that a segment is for all users of the machine, as iceoryx2 wants one of them to be.

#![expect(
    unsafe_code,
    reason = "iceoryx2's traits have unsafe methods; each hands its arguments to the storage inside, \
              under the conditions that it was called under itself"
)]

use std::cell::Cell;
use std::fmt::Debug;
use std::fs::File;
use std::mem::MaybeUninit;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::time::Duration;

use iceoryx2::prelude::{FileName, Path as IpcPath, ZeroCopySend};
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_memory::bump_allocator::BumpAllocator;
use iceoryx2_bb_posix::access_mode::AccessMode;
use iceoryx2_cal::dynamic_storage::{
    DynamicStorage, DynamicStorageBuilder, DynamicStorageCreateError, DynamicStorageOpenError,
    DynamicStorageOpenOrCreateError, file,
};
use iceoryx2_cal::named_concept::{
    NamedConcept, NamedConceptBuilder, NamedConceptConfiguration, NamedConceptDoesExistError,
    NamedConceptListError, NamedConceptMgmt, NamedConceptPathHintRemoveError,
    NamedConceptRemoveError,
};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::io::Errno;

/// Where less than this is free (bytes), shared memory is full, whatever else an error says.
pub(crate) const MARGIN: u64 = 1 << 20;
/// iceoryx2 puts its version before the content, and tmpfs deals in pages.
const HEADER: u64 = 64;
const PAGE: u64 = 4096;

/// Shared memory that was not there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shortage {
    /// Bytes that were asked for.
    pub(crate) needed: u64,
    /// Bytes that were free.
    pub(crate) free: u64,
}

thread_local! {
    /// iceoryx2's errors have no room for a reason. Ports stay on their thread, so that what was short
    /// on it belongs to the call that failed.
    static SHORTAGE: Cell<Option<Shortage>> = const { Cell::new(None) };
}

/// What this thread could not have since this was asked the last time.
pub(crate) fn take_shortage() -> Option<Shortage> {
    SHORTAGE.take()
}

/// Notes that a segment of `needed` bytes cannot be made where `free` are.
fn note_shortage(needed: u64, free: u64) {
    SHORTAGE.set(Some(Shortage { needed, free }));
}

/// Bytes that are free where `directory` lies.
pub(crate) fn free_space(directory: &Path) -> rustix::io::Result<u64> {
    let space = statvfs(directory)?;
    Ok(space.f_bavail * space.f_frsize)
}

/// Gives the file at `path` all its pages. Where the file system cannot, things are as they were.
fn reserve(path: &Path) -> std::io::Result<()> {
    let file = File::options().write(true).open(path)?;
    let len = file.metadata()?.len();
    loop {
        match fallocate(&file, FallocateFlags::empty(), 0, len) {
            // A signal came; what it had got is kept.
            Err(Errno::INTR) => {}
            Ok(()) | Err(Errno::OPNOTSUPP | Errno::NOSYS) => return Ok(()),
            Err(error) => {
                if error == Errno::NOSPC {
                    note_shortage(len, free_space(path).unwrap_or(0));
                }
                return Err(error.into());
            }
        }
    }
}

/// A `T` in shared memory, and what follows it.
#[derive(Debug)]
pub(crate) struct Segment<T: Debug + Send + Sync + ZeroCopySend>(file::Storage<T>);

/// Makes and opens [segments](Segment).
#[derive(Debug)]
pub(crate) struct Builder<'builder, T: Debug + Send + Sync + ZeroCopySend> {
    inner: file::Builder<'builder, T>,
    name: FileName,
    config: file::Configuration<T>,
    supplementary: usize,
}

impl<T: Debug + Send + Sync + ZeroCopySend> Builder<'_, T> {
    fn path(&self) -> PathBuf {
        PathBuf::from(self.config.path_for(&self.name).as_str())
    }

    /// Whether there is room for it. Asked first, because iceoryx2 writes into the first pages before all
    /// of them can be reserved.
    fn fits(&self, path: &Path) -> bool {
        let needed = (size_of::<T>() + self.supplementary) as u64 + HEADER;
        let needed = needed.next_multiple_of(PAGE);
        // Who cannot be asked will not give it either.
        let free = path.parent().and_then(|root| free_space(root).ok()).unwrap_or(0);
        if free < needed {
            note_shortage(needed, free);
        }
        free >= needed
    }
}

/// `segment` with all its pages; if it cannot have them, it is gone if it was just `made` here, and stays
/// with whoever made it if it was only opened.
fn with_pages<T>(
    segment: file::Storage<T>,
    path: &Path,
    made: bool,
) -> Result<Segment<T>, DynamicStorageCreateError>
where
    T: Debug + Send + Sync + ZeroCopySend,
{
    if reserve(path).is_err() {
        if made {
            // The owner removes it.
            segment.acquire_ownership();
        }
        return Err(DynamicStorageCreateError::InternalError);
    }
    Ok(Segment(segment))
}

impl<T: Debug + Send + Sync + ZeroCopySend> NamedConceptBuilder<Segment<T>> for Builder<'_, T> {
    fn new(name: &FileName) -> Self {
        Self {
            inner: file::Builder::new(name),
            name: *name,
            config: file::Configuration::default(),
            supplementary: 0,
        }
    }

    fn config(self, config: &file::Configuration<T>) -> Self {
        Self { inner: self.inner.config(config), config: config.clone(), ..self }
    }
}

impl<'builder, T: Debug + Send + Sync + ZeroCopySend> DynamicStorageBuilder<'builder, T, Segment<T>>
    for Builder<'builder, T>
{
    fn has_ownership(self, value: bool) -> Self {
        Self { inner: self.inner.has_ownership(value), ..self }
    }

    fn enable_global_access(self, _value: bool) -> Self {
        // No segment is for other users.
        self
    }

    fn supplementary_size(self, value: usize) -> Self {
        Self { inner: self.inner.supplementary_size(value), supplementary: value, ..self }
    }

    fn timeout(self, value: Duration) -> Self {
        Self { inner: self.inner.timeout(value), ..self }
    }

    fn initializer<F: FnMut(&mut MaybeUninit<T>, &mut BumpAllocator) -> bool + 'builder>(
        self,
        value: F,
    ) -> Self {
        Self { inner: self.inner.initializer(value), ..self }
    }

    fn create(self) -> Result<Segment<T>, DynamicStorageCreateError> {
        let path = self.path();
        if !self.fits(&path) {
            return Err(DynamicStorageCreateError::InternalError);
        }
        with_pages(self.inner.create()?, &path, true)
    }

    fn open(self, access_mode: AccessMode) -> Result<Segment<T>, DynamicStorageOpenError> {
        self.inner.open(access_mode).map(Segment)
    }

    fn open_or_create(self) -> Result<Segment<T>, DynamicStorageOpenOrCreateError> {
        let path = self.path();
        if !path.exists() && !self.fits(&path) {
            return Err(DynamicStorageCreateError::InternalError.into());
        }
        let segment = self.inner.open_or_create()?;
        // Who only opened a segment does not own it.
        let made = segment.has_ownership();
        Ok(with_pages(segment, &path, made)?)
    }
}

impl<T: Debug + Send + Sync + ZeroCopySend> Abandonable for Segment<T> {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller hands over a valid segment that nobody uses any more, and with it the
        // storage inside.
        unsafe { file::Storage::abandon_in_place(NonNull::from_mut(&mut this.as_mut().0)) };
    }
}

impl<T: Debug + Send + Sync + ZeroCopySend> NamedConcept for Segment<T> {
    fn name(&self) -> &FileName {
        self.0.name()
    }
}

impl<T: Debug + Send + Sync + ZeroCopySend> NamedConceptMgmt for Segment<T> {
    type Configuration = file::Configuration<T>;

    unsafe fn remove_cfg(
        name: &FileName,
        config: &Self::Configuration,
    ) -> Result<bool, NamedConceptRemoveError> {
        // SAFETY: the caller knows that no process uses it.
        unsafe { file::Storage::<T>::remove_cfg(name, config) }
    }

    fn does_exist_cfg(
        name: &FileName,
        config: &Self::Configuration,
    ) -> Result<bool, NamedConceptDoesExistError> {
        file::Storage::<T>::does_exist_cfg(name, config)
    }

    fn list_cfg(config: &Self::Configuration) -> Result<Vec<FileName>, NamedConceptListError> {
        file::Storage::<T>::list_cfg(config)
    }

    fn remove_path_hint(value: &IpcPath) -> Result<(), NamedConceptPathHintRemoveError> {
        file::Storage::<T>::remove_path_hint(value)
    }
}

impl<T: Debug + Send + Sync + ZeroCopySend> DynamicStorage<T> for Segment<T> {
    type Builder<'builder> = Builder<'builder, T>;

    fn does_support_persistency() -> bool {
        file::Storage::<T>::does_support_persistency()
    }

    fn has_ownership(&self) -> bool {
        self.0.has_ownership()
    }

    fn release_ownership(&self) {
        self.0.release_ownership();
    }

    fn acquire_ownership(&self) {
        self.0.acquire_ownership();
    }

    fn get(&self) -> &T {
        self.0.get()
    }

    unsafe fn __internal_set_type_name_in_config(
        config: &mut Self::Configuration,
        type_name: &str,
    ) {
        // SAFETY: the caller knows that `type_name` is that of `T`.
        unsafe { file::Storage::<T>::__internal_set_type_name_in_config(config, type_name) };
    }
}

#[cfg(test)]
mod tests {
    use iceoryx2::prelude::SemanticString as _;

    use super::*;
    use crate::Domain;

    /// A domain that leaves nothing, also when a test fails.
    struct TestDomain(Domain);

    impl Drop for TestDomain {
        fn drop(&mut self) {
            let _ = self.0.remove_leftovers();
        }
    }

    #[test]
    fn a_segment_without_pages_goes_only_if_it_was_made_here() {
        let domain = TestDomain(Domain::fresh());
        domain.0.make_root().expect("made");
        let root = domain.0.root();
        let at = IpcPath::new(root.as_os_str().as_encoded_bytes()).expect("a path");
        let config = file::Configuration::<u64>::default().path_hint(&at);
        let name = FileName::new(b"segment").expect("a name");
        let builder = || {
            <Builder<'_, u64> as NamedConceptBuilder<Segment<u64>>>::new(&name)
                .config(&config)
                .initializer(|data, _| {
                    data.write(7);
                    true
                })
        };
        let first = builder().open_or_create().expect("made");
        let path = builder().path();
        // Pages cannot be had for a file that is not there.
        let nowhere = root.join("nowhere");
        let second = builder().inner.open_or_create().expect("opened");
        let made = second.has_ownership();
        assert!(first.has_ownership() && !made);
        with_pages(second, &nowhere, made).expect_err("no pages");
        assert!(path.exists(), "it is the first one's");
        assert_eq!(*first.get(), 7);
        drop(first);
        assert!(!path.exists());

        let third = builder().inner.open_or_create().expect("made");
        let made = third.has_ownership();
        with_pages(third, &nowhere, made).expect_err("no pages");
        assert!(!path.exists());
    }
}
