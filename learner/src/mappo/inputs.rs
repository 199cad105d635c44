//! What networks see, from a block into the rows of samples: normalised, and rounded to the products' kind.
//!
//! In plain Rust it is one pass over the numbers. On a GPU, and where an input is standardised by itself, it goes operation by operation of libtorch, which
//! is also the twin that tests the other.
//!
//! Letters as in [`super`].

use tch::{Device, Kind, Tensor};

use crate::actors::Actors;
use crate::features::{Features, Loop, run_for};
use crate::input_norm::Normalisation;
use crate::memory::{Element, numbers_mut, view};
use crate::number::{Bf16, Number};

/// Inputs as a block has them: `[R, G, T + 1, N, F]`, N environments of a shard.
#[derive(Clone, Copy)]
pub(super) struct Inputs<'a> {
    /// Those of the R that are wanted.
    pub(super) actors: Actors,
    /// G, T + 1, N, F.
    pub(super) size: [usize; 4],
    pub(super) normalisation: Normalisation,
    /// Mean and inverse deviation in force, of all R: `[R, G·F]` each.
    pub(super) moments: Option<&'a (Vec<f32>, Vec<f32>)>,
}

impl Inputs<'_> {
    /// Room for the rows of E environments, `[(T + 1)·E, A·G·F]`.
    pub(super) fn rows(&self, envs: usize, kind: (Kind, Device)) -> Tensor {
        let [agents, steps, _, features] = self.size;
        let [rows, width] = [steps * envs, self.actors.len * agents * features];
        Tensor::zeros([rows as i64, width as i64], kind)
    }

    /// Brings a shard's into `rows`, made by [`Self::rows`], where its environments begin with `first`.
    pub(super) fn put(&self, block: &[f32], first: usize, rows: &mut Tensor) {
        match rows.kind() {
            Kind::BFloat16 => self.put_in_a_pass::<Bf16>(block, first, rows),
            _ => self.put_in_a_pass::<f32>(block, first, rows),
        }
    }

    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    fn put_in_a_pass<T: Number + Element>(&self, block: &[f32], first: usize, rows: &mut Tensor) {
        let envs = rows.size()[0] as usize / self.size[1];
        // SAFETY: made of zeros for the samples, of which nobody has a slice yet; blocks lie elsewhere.
        let rows: &mut [T] = unsafe { numbers_mut(rows) };
        run_for(Features::detect(), Pass { inputs: *self, block, first, envs, rows });
    }

    /// The same operation by operation.
    #[expect(unsafe_code, reason = "only here is it known how long a block's tensors live")]
    pub(super) fn put_by_operations(&self, block: &[f32], first: usize, rows: &Tensor) {
        let [agents, steps, envs, features] = self.size.map(|size| size as i64);
        let all = block.len() as i64 / (agents * steps * envs * features);
        let (a, width) = (self.actors.len as i64, agents * features);
        let moments = self.moments.map(|(mean, inverse_std)| {
            let part = |values: &[f32]| {
                let all = Tensor::from_slice(values).view([-1, 1, 1, width]);
                self.actors.rows(&all).to_device(rows.device())
            };
            (part(mean), part(inverse_std))
        });
        // SAFETY: the block outlives this function. What is made of it is read, copied into `rows`, and gone at its end.
        let block = unsafe { view(block, &[all, agents, steps, envs, features]) };
        // With one agent an actor, bringing G beside the features moves nothing.
        let seen = self.actors.rows(&block).to_device(rows.device()).permute([0, 2, 3, 1, 4]);
        let seen = seen.reshape([a, steps, envs, width]);
        let x = self.normalisation.normalise(&seen, moments.as_ref());
        let mut slot = rows.view([steps, -1, a, width]).narrow(1, first as i64, envs);
        slot.copy_(&x.permute([1, 2, 0, 3]));
    }
}

/// Arguments of [`Inputs::put`].
struct Pass<'a, T> {
    inputs: Inputs<'a>,
    block: &'a [f32],
    first: usize,
    /// E.
    envs: usize,
    rows: &'a mut [T],
}

impl<T: Number> Loop for Pass<'_, T> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { inputs: Inputs { actors, size, normalisation, moments }, block, .. } = self;
        let [agents, steps, envs, features] = size;
        let width = actors.len * agents * features;
        for (index, actor) in actors.iter().enumerate() {
            for agent in 0..agents {
                let moments = moments.map(|moments| {
                    let from = (actor * agents + agent) * features;
                    [&moments.0[from..][..features], &moments.1[from..][..features]]
                });
                let column = (index * agents + agent) * features;
                for step in 0..steps {
                    let from = ((actor * agents + agent) * steps + step) * envs * features;
                    let seen = block[from..][..envs * features].chunks_exact(features);
                    let first = (step * self.envs + self.first) * width;
                    let rows = self.rows[first..][..envs * width].chunks_exact_mut(width);
                    for (x, row) in seen.zip(rows) {
                        normalisation.normalise_each(x, moments, &mut row[column..][..features]);
                    }
                }
            }
        }
    }
}
