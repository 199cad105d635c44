//! Views between Rust slices and libtorch's memory.
//!
//! A block that a worker wrote lies in shared memory. [`view`] makes a tensor of it in place, so
//! the first operation that touches the numbers is already a computation. [`bytes`], [`numbers`] and
//! [`numbers_mut`] go the other way.
//!
//! A tensor is a counted handle: `view`, `narrow`, `permute` or `shallow_clone` give further handles of
//! the same storage, and a shared reference to any of them is enough to write through it. So the borrow
//! checker sees neither who keeps a memory alive nor who writes it, and every function here is unsafe:
//! its caller knows which other handles there are, and says so.
#![expect(unsafe_code, reason = "libtorch takes and gives raw pointers")]

use tch::{Device, Kind, Tensor};

use crate::number::Bf16;

/// Views `data` as a row-major tensor of `shape`, without copying.
///
/// # Safety
/// The result, and every tensor that shares its memory, is gone before `data` is; none of them is
/// written to.
///
/// # Panics
/// If `shape` does not have as many elements as `data`.
pub(crate) unsafe fn view(data: &[f32], shape: &[i64]) -> Tensor {
    assert!(shape.iter().all(|&size| size >= 0), "shape {shape:?} has a negative size");
    let len: i64 = shape.iter().product();
    assert_eq!(len, data.len() as i64, "shape {shape:?} does not fit {} numbers", data.len());
    let strides: Vec<i64> = (0..shape.len()).map(|dim| shape[dim + 1..].iter().product()).collect();
    // SAFETY: the pointer is valid for `len` reads of f32 as long as `data` lives, which the caller
    // lets outlive the result; no size is negative and the strides are those of a row-major array, so
    // no access leaves the slice; libtorch does not free the memory, and the caller does not write it.
    unsafe {
        Tensor::from_blob(data.as_ptr().cast::<u8>(), shape, &strides, Kind::Float, Device::Cpu)
    }
}

/// The bytes of a contiguous tensor on the CPU, in place.
///
/// # Safety
/// The tensor's memory has been written since it was made (`empty` does not), and no handle of its
/// storage writes while the result lives.
///
/// # Panics
/// If the tensor is elsewhere or has gaps.
pub(crate) unsafe fn bytes(tensor: &Tensor) -> &[u8] {
    assert_eq!(tensor.device(), Device::Cpu, "the bytes must be on the CPU");
    assert!(tensor.is_contiguous(), "the bytes must lie one after the other");
    let len = tensor.numel() * tensor.kind().elt_size_in_bytes();
    if len == 0 {
        return &[];
    }
    // SAFETY: a contiguous tensor's memory starts at `data_ptr` and holds `numel` elements; it
    // lives as long as the tensor, which the result borrows. Plain numbers have no invalid bytes. That
    // they are there and stay as they are is the caller's promise.
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
/// # Safety
/// As for [`bytes`].
///
/// # Panics
/// If the tensor is elsewhere, of another kind or has gaps.
pub(crate) unsafe fn numbers<T: Element>(tensor: &Tensor) -> &[T] {
    let len = check::<T>(tensor);
    if len == 0 {
        return &[];
    }
    // SAFETY: as for `bytes`; the kind was compared.
    unsafe { std::slice::from_raw_parts(tensor.data_ptr().cast::<T>(), len) }
}

/// As [`numbers`], to be written.
///
/// # Safety
/// The tensor's memory has been written since it was made. While the result lives, no other handle of
/// this part of its storage is read or written, and no other slice of it is there: a `&mut Tensor` does
/// not show that.
pub(crate) unsafe fn numbers_mut<T: Element>(tensor: &mut Tensor) -> &mut [T] {
    let len = check::<T>(tensor);
    if len == 0 {
        return &mut [];
    }
    // SAFETY: as for `numbers`; that nobody else uses this memory is the caller's promise.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast::<T>(), len) }
}

/// The sums over rows of `[R, C]`, one a column, in libtorch's order. Up to four rows that is one after the other.
pub(crate) fn sum_over_rows(numbers: &[f32], columns: usize) -> Vec<f32> {
    if numbers.len() <= 4 * columns {
        let mut sums = vec![0.0; columns];
        for row in numbers.chunks_exact(columns) {
            sums.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
        }
        return sums;
    }
    sum_over_rows_by_libtorch(numbers, columns)
}

fn sum_over_rows_by_libtorch(numbers: &[f32], columns: usize) -> Vec<f32> {
    let rows = Tensor::from_slice(numbers).view([-1, columns as i64]);
    Vec::try_from(rows.sum_dim_intlist(&[0i64][..], false, Kind::Float)).expect("f32")
}

/// Whether no two of these contiguous tensors on the CPU share a byte.
pub(crate) fn are_apart(tensors: &[&Tensor]) -> bool {
    let range = |tensor: &Tensor| {
        let start = tensor.data_ptr() as usize;
        start..start + tensor.numel() * tensor.kind().elt_size_in_bytes()
    };
    tensors.iter().enumerate().all(|(i, a)| {
        let a = range(a);
        tensors[..i].iter().map(|b| range(b)).all(|b| a.end <= b.start || b.end <= a.start)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_reads_the_slices_own_memory() {
        let data: Vec<f32> = (0..24).map(|i| i as f32).collect();
        // SAFETY: the view is gone before `data`, and nobody writes.
        let view = unsafe { view(&data, &[2, 3, 4]) };
        assert_eq!(view.data_ptr() as usize, data.as_ptr() as usize);
        assert_eq!(view.double_value(&[1, 2, 3]), 23.0);
        assert_eq!(view.double_value(&[0, 1, 0]), 4.0);
    }

    #[test]
    #[should_panic(expected = "negative size")]
    fn a_negative_size_is_no_shape_though_the_product_fits() {
        // SAFETY: there is no view, which is what is tested.
        let _ = unsafe { view(&[0.0; 4], &[-2, -2]) };
    }

    #[test]
    fn bytes_are_the_tensors_own() {
        let tensor = Tensor::from_slice(&[1.5f32, -2.0]);
        // SAFETY: filled, and nobody writes.
        let bytes = unsafe { bytes(&tensor) };
        assert_eq!(bytes, bytemuck::bytes_of(&[1.5f32, -2.0]));
        assert_eq!(bytes.as_ptr() as usize, tensor.data_ptr() as usize);
    }

    #[test]
    fn few_rows_are_summed_as_libtorch_does() {
        let numbers: Vec<f32> = (0..400).map(|i| (i as f32).sin()).collect();
        for rows in 1..=4 {
            for columns in [1, 2, 3, 7, 8, 33, 100] {
                let numbers = &numbers[..rows * columns];
                let theirs = sum_over_rows_by_libtorch(numbers, columns);
                assert_eq!(sum_over_rows(numbers, columns), theirs, "{rows} × {columns}");
            }
        }
    }

    #[test]
    fn tensors_that_share_a_number_are_not_apart() {
        let all = Tensor::zeros([6], (Kind::Float, Device::Cpu));
        let [first, middle, last] =
            [(0, 3), (2, 2), (3, 3)].map(|(at, len)| all.narrow(0, at, len));
        assert!(are_apart(&[&first, &last]));
        assert!(!are_apart(&[&first, &last, &middle]));
        assert!(!are_apart(&[&all, &last]));
        assert!(!are_apart(&[&first, &first.shallow_clone()]));
    }
}
