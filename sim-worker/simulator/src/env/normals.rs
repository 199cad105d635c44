//! Normal numbers for all lanes of a group, each lane with its environment's own.

use proto::rng::Address;

use crate::scalar::Real;

/// Fills `out` with standard normal numbers; `address_of` is the address of a lane's first four, none for a lane that gets zeros.
/// The others follow it by their index.
#[inline(always)]
pub(crate) fn draw_normals<S: Real>(address_of: impl Fn(usize) -> Option<Address>, out: &mut [S]) {
    for lane in 0..S::LANES {
        let first = address_of(lane);
        for (index, four) in out.chunks_mut(4).enumerate() {
            let normals = first.map_or([0.0; 4], |first| {
                Address { index: first.index + index as u32, ..first }.normals()
            });
            for (slot, normal) in four.iter_mut().zip(normals) {
                slot.set_lane(lane, f64::from(normal));
            }
        }
    }
}
