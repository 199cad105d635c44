//! The critics' loss on a CPU: a pass over the samples in plain Rust, with the bits of the twin. Sums are libtorch's.

use tch::{Device, Kind, Tensor};

use super::operations::CriticLoss;
use crate::features::{Features, Loop, run_for};
use crate::limits::{clamp, maximum};
use crate::memory::{are_apart, numbers, numbers_mut};

/// Room for the critics' loss of a chunk.
#[derive(Debug)]
pub(crate) struct CriticRoom {
    /// As the outputs: `[C, A / C, B]`.
    gradient: Tensor,
    /// `[A, B]` and `[A]`: losses, and their sums over samples.
    loss: Tensor,
    sums: Tensor,
}

impl Default for CriticRoom {
    fn default() -> Self {
        Self::new([0; 3])
    }
}

impl CriticRoom {
    fn new([critics, each, b]: [i64; 3]) -> Self {
        let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        Self {
            gradient: zeros(&[critics, each, b]),
            loss: zeros(&[critics * each, b]),
            sums: zeros(&[critics * each]),
        }
    }
}

impl CriticLoss {
    /// [`CriticLoss::gradient`] in a pass: the gradient by the outputs `[C, A / C, B]` of the mean loss over a critic's agents, and the sum of the losses
    /// over samples of each agent. Critic c is that of the agents c, c + C, c + 2C … `columns` is `[A, 2, B]`.
    #[expect(unsafe_code, reason = "only here is it known which tensors share memory")]
    pub(crate) fn gradient_in_a_pass<'p>(
        &self,
        room: &'p mut CriticRoom,
        output: &Tensor,
        columns: &[f32],
        batch: usize,
    ) -> (&'p Tensor, &'p [f32]) {
        let (critics, each, b) = output.size3().expect("[C, A / C, B]");
        let size = [critics, each, b];
        let [critics, each, b] = size.map(|size| size as usize);
        assert_eq!(columns.len(), critics * each * 2 * b, "other samples");
        if room.gradient.size() != size {
            *room = CriticRoom::new(size);
        }
        assert!(are_apart(&[&room.gradient, output]), "outputs lie in the room");
        // SAFETY: outputs are the caller's, filled and apart from the gradient, which was made of zeros. libtorch does nothing until the pass has ended.
        let pass = unsafe {
            ValuePass {
                critics,
                each,
                samples: b,
                clip: (self.clip != 0.0).then_some(self.clip as f32),
                huber_delta: (self.huber_delta != 0.0).then_some(self.huber_delta as f32),
                scale: (self.coefficient / batch as f64) as f32,
                output: numbers(output),
                columns,
                gradient: numbers_mut(&mut room.gradient),
                loss: numbers_mut(&mut room.loss),
            }
        };
        run_for(Features::detect(), pass);
        let CriticRoom { gradient, loss, sums } = room;
        let _ = loss.sum_intlist_out(sums, &[1i64][..], false, Kind::Float);
        // SAFETY: as above; what stands in the room is in tensors of its own.
        let sums: &mut [f32] = unsafe { numbers_mut(sums) };
        for sum in &mut *sums {
            *sum *= self.coefficient as f32;
        }
        (gradient, sums)
    }
}

/// The critics' losses and their gradients.
struct ValuePass<'a> {
    /// C.
    critics: usize,
    /// A / C.
    each: usize,
    /// B.
    samples: usize,
    clip: Option<f32>,
    huber_delta: Option<f32>,
    /// c / B.
    scale: f32,
    /// `[C, A / C, B]`.
    output: &'a [f32],
    /// `[A, 2, B]`.
    columns: &'a [f32],
    /// Out: `[C, A / C, B]`.
    gradient: &'a mut [f32],
    /// Out: `[A, B]`.
    loss: &'a mut [f32],
}

impl ValuePass<'_> {
    /// The loss's derivative by the error.
    #[inline(always)]
    fn slope(huber_delta: Option<f32>, error: f32) -> f32 {
        huber_delta.map_or(error, |delta| clamp(error, [-delta, delta]))
    }

    /// The loss of an error.
    #[inline(always)]
    fn penalty(huber_delta: Option<f32>, error: f32) -> f32 {
        if huber_delta.is_none() {
            return error * error * 0.5;
        }
        let inner = Self::slope(huber_delta, error);
        inner * (error - inner * 0.5)
    }
}

impl Loop for ValuePass<'_> {
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let Self { critics, each, samples: b, clip, huber_delta, scale, output, columns, .. } =
            self;
        for (agent, loss) in self.loss.chunks_exact_mut(b).enumerate() {
            let at = (agent % critics * each + agent / critics) * b;
            let (value, gradient) = (&output[at..][..b], &mut self.gradient[at..][..b]);
            let (old, target) = columns[agent * 2 * b..][..2 * b].split_at(b);
            for i in 0..b {
                let error = value[i] - target[i];
                let plain = Self::penalty(huber_delta, error);
                let slope = Self::slope(huber_delta, error);
                let Some(clip) = clip else {
                    (loss[i], gradient[i]) = (plain, slope * scale);
                    continue;
                };
                let change = value[i] - old[i];
                let small = clamp(change, [-clip, clip]);
                let limited = Self::penalty(huber_delta, old[i] + small - target[i]);
                let moves = plain >= limited || small == change;
                loss[i] = maximum(plain, limited);
                gradient[i] = slope * f32::from(u8::from(moves)) * scale;
            }
            if each > 1 {
                for gradient in gradient {
                    *gradient /= each as f32;
                }
            }
        }
    }
}
