//! Views between Rust slices and libtorch's memory.
//!
//! A block that a worker wrote lies in shared memory. [`view`] makes a tensor of it in place, so
//! the first operation that touches the numbers is already a computation. The borrow checker keeps
//! the memory alive: a [`View`] cannot outlive the slice.
#![expect(unsafe_code, reason = "libtorch takes and gives raw pointers")]

use std::marker::PhantomData;

use tch::{Device, Kind, Tensor};

use crate::number::Bf16;

/// A tensor that reads memory which Rust owns.
#[derive(Debug)]
pub(crate) struct View<'a> {
    tensor: Tensor,
    memory: PhantomData<&'a [f32]>,
}

impl View<'_> {
    /// The tensor. Operations on it must read only, and what they return must be new memory or
    /// not leave the view's scope.
    pub(crate) fn tensor(&self) -> &Tensor {
        &self.tensor
    }
}

/// Views `data` as a row-major tensor of `shape`, without copying.
///
/// # Panics
/// If `shape` does not have as many elements as `data`.
pub(crate) fn view<'a>(data: &'a [f32], shape: &[i64]) -> View<'a> {
    let len: i64 = shape.iter().product();
    assert_eq!(len, data.len() as i64, "shape {shape:?} does not fit {} numbers", data.len());
    let strides: Vec<i64> = (0..shape.len()).map(|dim| shape[dim + 1..].iter().product()).collect();
    // SAFETY: the pointer is valid for `len` reads of f32 as long as 'a, to which the result is
    // tied; the strides are those of a row-major array, so no access leaves the slice; libtorch
    // neither frees the memory nor writes it, because only reading operations are applied.
    let tensor = unsafe {
        Tensor::from_blob(data.as_ptr().cast::<u8>(), shape, &strides, Kind::Float, Device::Cpu)
    };
    View { tensor, memory: PhantomData }
}

/// The bytes of a contiguous tensor on the CPU, in place.
///
/// # Panics
/// If the tensor is elsewhere or has gaps.
pub(crate) fn bytes(tensor: &Tensor) -> &[u8] {
    assert_eq!(tensor.device(), Device::Cpu, "the bytes must be on the CPU");
    assert!(tensor.is_contiguous(), "the bytes must lie one after the other");
    let len = tensor.numel() * tensor.kind().elt_size_in_bytes();
    if len == 0 {
        return &[];
    }
    // SAFETY: a contiguous tensor's memory starts at `data_ptr` and holds `numel` elements; it
    // lives as long as the tensor, which the result borrows. Plain numbers have no invalid bytes.
    unsafe { std::slice::from_raw_parts(tensor.data_ptr().cast::<u8>(), len) }
}

/// A kind of number that libtorch and Rust hold alike: any bits are one, without gaps.
///
/// # Safety
/// `KIND` names libtorch's kind of the same size and layout.
pub(crate) unsafe trait Element: Copy {
    /// libtorch's name.
    const KIND: Kind;
}

// SAFETY: IEEE single precision in both.
unsafe impl Element for f32 {
    const KIND: Kind = Kind::Float;
}

// SAFETY: sixteen bits in both.
unsafe impl Element for Bf16 {
    const KIND: Kind = Kind::BFloat16;
}

fn check<T: Element>(tensor: &Tensor) -> usize {
    assert_eq!((tensor.device(), tensor.kind()), (Device::Cpu, T::KIND), "another memory or kind");
    assert!(tensor.is_contiguous(), "the numbers must lie one after the other");
    tensor.numel()
}

/// The numbers of a contiguous tensor on the CPU, in place.
///
/// # Panics
/// If the tensor is elsewhere, of another kind or has gaps.
pub(crate) fn numbers<T: Element>(tensor: &Tensor) -> &[T] {
    let len = check::<T>(tensor);
    if len == 0 {
        return &[];
    }
    // SAFETY: as for `bytes`; the kind was compared.
    unsafe { std::slice::from_raw_parts(tensor.data_ptr().cast::<T>(), len) }
}

/// As [`numbers`], to be written. Other tensors that share the memory must not be used meanwhile.
pub(crate) fn numbers_mut<T: Element>(tensor: &mut Tensor) -> &mut [T] {
    let len = check::<T>(tensor);
    if len == 0 {
        return &mut [];
    }
    // SAFETY: as for `numbers`; the caller holds the only tensor in use of this memory.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast::<T>(), len) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_reads_the_slices_own_memory() {
        let data: Vec<f32> = (0..24).map(|i| i as f32).collect();
        let view = view(&data, &[2, 3, 4]);
        assert_eq!(view.tensor().data_ptr() as usize, data.as_ptr() as usize);
        assert_eq!(view.tensor().double_value(&[1, 2, 3]), 23.0);
        assert_eq!(view.tensor().double_value(&[0, 1, 0]), 4.0);
    }

    #[test]
    fn bytes_are_the_tensors_own() {
        let tensor = Tensor::from_slice(&[1.5f32, -2.0]);
        assert_eq!(bytes(&tensor), bytemuck::bytes_of(&[1.5f32, -2.0]));
        assert_eq!(bytes(&tensor).as_ptr() as usize, tensor.data_ptr() as usize);
    }
}
