//! Numbers right before memory that nobody may touch: whoever reads or writes one too many is killed.
#![expect(unsafe_code, reason = "memory of its own, with protected pages")]

use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

const PAGE: usize = 65_536;

/// A copy of numbers that ends where a protected page begins.
pub(super) struct Guarded<T> {
    base: *mut u8,
    bytes: usize,
    len: usize,
    numbers: PhantomData<T>,
}

impl<T: Copy> Guarded<T> {
    pub(super) fn new(numbers: &[T]) -> Self {
        let bytes = size_of_val(numbers).next_multiple_of(PAGE) + PAGE;
        let (access, kind) =
            (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
        // SAFETY: new memory, of which the last page is protected.
        let base = unsafe {
            let base = libc::mmap(std::ptr::null_mut(), bytes, access, kind, -1, 0);
            assert_ne!(base, libc::MAP_FAILED);
            assert_eq!(libc::mprotect(base.byte_add(bytes - PAGE), PAGE, libc::PROT_NONE), 0);
            base.cast()
        };
        let mut guarded = Self { base, bytes, len: numbers.len(), numbers: PhantomData };
        guarded.copy_from_slice(numbers);
        guarded
    }

    fn first(&self) -> *mut T {
        self.base.wrapping_add(self.bytes - PAGE - self.len * size_of::<T>()).cast()
    }
}

impl<T: Copy> Deref for Guarded<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: so many numbers fit before the protected page, and any bits are a number.
        unsafe { std::slice::from_raw_parts(self.first(), self.len) }
    }
}

impl<T: Copy> DerefMut for Guarded<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above; it is this one's memory alone.
        unsafe { std::slice::from_raw_parts_mut(self.first(), self.len) }
    }
}

impl<T> Drop for Guarded<T> {
    fn drop(&mut self) {
        // SAFETY: mapped by `new`, and nobody has a slice any more.
        unsafe { libc::munmap(self.base.cast(), self.bytes) };
    }
}
