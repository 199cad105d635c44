//! Products of matrices of bfloat16, by one thread, on processors that multiply such numbers in pairs (AVX-512 BF16) or in tiles (AMX).
//!
//! libtorch multiplies, too, and does so with several threads, in f32, on other processors and on a GPU. But with matrices as small as a
//! mini-batch's it looks up a kernel for each product, packs both factors each time, and copies what comes out to where it is wanted. Here weights
//! are packed once a step, gradients of weights go to their place at once, networks that see the same share one input,
//! and sums go through a layer's units before they are put: tiles multiply by themselves, and meanwhile vector instructions have nothing else to do.
//!
//! **Arithmetic.** With pairs, an element of a product is one chain of sums in f32, two products a link, in the order of the inner index, rounded to
//! bfloat16 at the end. With tiles, a link is 32 products: the sum of the 16 with an even inner index, one after the other, and that of the others. So which
//! rows and columns go together does not decide a bit. libtorch's products are the same chains, but where the
//! inner index is long: there it sums parts of them, and a last place differs now and then.
//!
//! A panel, 32 columns of the right factor, stays in the first cache, and the sums of some rows with it in registers.

mod multiply;
mod native;
mod operands;
mod packed;
#[cfg(target_arch = "x86_64")]
mod pairs;
mod panel;
#[cfg(test)]
mod plain;
#[cfg(target_arch = "x86_64")]
mod registers;
#[cfg(target_arch = "x86_64")]
mod sums;
#[cfg(target_arch = "x86_64")]
mod tiles;
#[cfg(target_arch = "x86_64")]
mod transposition;
mod units;

pub(crate) use multiply::multiply;
pub(crate) use native::Native;
pub(crate) use operands::{Left, Out};
pub(crate) use packed::Packed;
pub(crate) use units::{Activations, Biases, Gradients};

#[cfg(all(test, unix))]
mod guarded;
#[cfg(test)]
mod tests;
